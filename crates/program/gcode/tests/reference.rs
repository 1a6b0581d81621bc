//! Programs and the results of LinuxCNC 2.9's interpreter for them, stored by `tools/compare-rs274 --store`.
//!
//! `tests/programs/NAME.ngc` is a program, `NAME.canon` the output of `rs274 -g` for it: one event per line,
//! and after ` | ` the tolerance of its numbers, because rs274 prints four decimals of the active unit.
//! Errors are equal if both interpreters reject the same line and all events before it are equal; rs274 may
//! have executed part of the rejected line. `post-NAME.ngc` are written as the post-processors of Fusion, FreeCAD, Vectric,
//! SheetCAM, pcb2gcode and programmers of Fanuc's controls write. `known.txt` lists the programs that differ, and why;
//! `earlier.txt` those that are rejected here at an earlier line.

#[path = "common/canon.rs"]
mod canon;

use std::path::Path;

use evolvent_gcode::{MachineFeatures, Settings, ToolTable};

/// Our output has six decimals.
const OURS_MM: f64 = 0.6e-6;

/// An event's words, and the tolerance of its numbers: mm, degrees, mm/min.
fn split(line: &str) -> (Vec<&str>, [f64; 3]) {
    let (text, tolerances) = line.split_once(" | ").unwrap_or((line, ""));
    let mut limits = [1e-6, 1e-6, 1e-4];
    for (limit, word) in limits.iter_mut().zip(tolerances.split(' ')) {
        *limit = word.parse().unwrap_or(*limit);
    }
    (text.split(' ').collect(), limits)
}

/// Whether two events are equal, number by number. In cycles corners are exact here, where rs274 blends.
fn same(theirs: &str, ours: &str, cycles: bool) -> bool {
    let ((mut left, tolerances), (mut right, _)) = (split(theirs), split(ours));
    let blended = left.len().checked_sub(3).filter(|index| left[*index] == "blend");
    if let (true, Some(index), Some(&"exact")) = (cycles, blended, right.last()) {
        left.truncate(index);
        right.pop();
    }
    left.len() == right.len()
        && left[0] == right[0]
        && left.iter().zip(&right).enumerate().all(|(index, (left, right))| {
            let number = |word: &str| {
                let bare = word.trim_start_matches(['F', 'K']);
                let mark = &word[..word.len() - bare.len()];
                bare.parse::<f64>().ok().map(|value| (mark.to_owned(), value))
            };
            match (number(left), number(right)) {
                (Some((mark, left)), Some((other_mark, right))) if mark == other_mark => {
                    let limit = match index {
                        _ if mark == "F" => tolerances[2],
                        4..=6 => tolerances[1],
                        _ => tolerances[0],
                    };
                    left == right || (left - right).abs() <= limit + OURS_MM
                }
                _ => left == right,
            }
        })
}

/// Whether an event is a move that vanishes in four decimals.
fn is_still(lines: &[String], index: usize, tolerance: f64) -> bool {
    let coordinates = |index: usize| -> Option<Vec<f64>> {
        let (words, _) = split(lines.get(index)?);
        let moves = ["rapid", "feed", "arc"].contains(&words[0]);
        let figures = words.get(1..7)?.iter().map(|word| word.parse().ok());
        if moves { figures.collect() } else { None }
    };
    let line = lines.get(index).is_some_and(|line| !line.starts_with("arc"));
    let before = index.checked_sub(1).and_then(coordinates);
    match (line, before, coordinates(index)) {
        (true, Some(before), Some(now)) => before
            .iter()
            .zip(&now)
            .all(|(a, b)| (a - b).abs() <= 2.0 * tolerance),
        _ => false,
    }
}

/// The relation of two interpretations of a program.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Relation {
    Equal,
    /// Equal up to this line, which is rejected here; rs274 rejects a later one.
    Earlier(u32),
    /// The first difference.
    Different(String),
}

/// Maximum number of moves per hole, in any cycle except pecking.
const MAX_MOVES_PER_HOLE: usize = 12;

/// Whether rs274 may have produced these events from part of a line that it then rejects: a move is the last
/// event of a line and is complete or absent, except in a cycle.
fn is_part_of_line(events: &[String], program: &str, line: u32) -> bool {
    let lines: Vec<_> = program.lines().take(line as usize).collect();
    let text = lines.last().copied().unwrap_or_default();
    let is_move = |event: &&String| {
        let kind = event.split(' ').next().unwrap_or_default();
        ["rapid", "feed", "arc", "spline", "thread", "tap", "probe"].contains(&kind)
    };
    let moves = events.iter().filter(is_move).count();
    let words = text.chars().filter(char::is_ascii_alphabetic).count();
    let max_moves = if has_cycle(&lines.join("\n")) {
        MAX_MOVES_PER_HOLE
    } else {
        0
    };
    moves <= max_moves && events.len() - moves <= words
}

/// The relation of our events to those of rs274, for a program with this text.
fn relation(theirs: &[String], ours: &[String], program: &str) -> Relation {
    let cycles = has_cycle(program);
    let (mut a, mut b) = (0, 0);
    while a < theirs.len() || b < ours.len() {
        let event =
            |list: &[String], index: usize| list.get(index).map_or("(nothing)", |line| line).to_owned();
        let (left, right) = (event(theirs, a), event(ours, b));
        // The end of a program without M2 is not compared.
        if left == "end" && (right == "end" || right.starts_with("spindle stop") || right == "coolant 0 0") {
            return Relation::Equal;
        }
        if right.starts_with("error") {
            // Here a line is executed completely or not at all; rs274 may have executed part of it.
            let last = theirs.last().map_or("", |line| line);
            let line = |text: &str| text.split(' ').nth(1).and_then(|word| word.parse::<u32>().ok());
            let rejected = line(last).filter(|_| last.starts_with("error"));
            let rest = theirs.get(a..theirs.len().saturating_sub(1)).unwrap_or_default();
            return match (rejected, line(&right)) {
                (Some(rejected), Some(here)) if rejected == here && is_part_of_line(rest, program, here) => {
                    Relation::Equal
                }
                (Some(rejected), Some(here)) if 0 < here && here < rejected => Relation::Earlier(here),
                _ => Relation::Different(format!(
                    "rs274 {} more events and {last:?}, here {right:?}",
                    rest.len()
                )),
            };
        }
        if same(&left, &right, cycles) {
            (a, b) = (a + 1, b + 1);
            continue;
        }
        let tolerance = split(&left).1[0];
        if is_still(ours, b, tolerance) {
            b += 1;
        } else if is_still(theirs, a, tolerance) {
            a += 1;
        } else {
            let text = format!("event {}: rs274 {left:?}, here {right:?}", a + 1);
            return Relation::Different(text);
        }
    }
    Relation::Equal
}

/// Whether the program has a cycle.
fn has_cycle(program: &str) -> bool {
    let cycle = |rest: &str| {
        let digits = |text: &str| text.bytes().take_while(u8::is_ascii_digit).count();
        let number: u32 = rest[..digits(rest)].parse().unwrap_or(0);
        matches!(number, 70..=73 | 76 | 81..=89)
    };
    let mut codes = program.split(['G', 'g']);
    codes.next();
    codes.any(cycle)
}

/// A program that is rejected here at an earlier line: its name and that line. The reason follows.
fn rejected_earlier(line: &str) -> Option<(&str, u32)> {
    let (name, rest) = line.split_once(':').filter(|_| !line.starts_with('#'))?;
    let (line, reason) = rest.split_once(": ")?;
    assert!(!reason.is_empty(), "{name} without a reason");
    Some((name, line.parse().ok()?))
}

#[test]
fn programs_match_linuxcnc_results() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/programs");
    let tools = ToolTable::parse(&std::fs::read_to_string(folder.join("tools.tbl")).unwrap()).unwrap();
    let known = std::fs::read_to_string(folder.join("known.txt")).unwrap();
    let known: Vec<_> = known.lines().filter_map(|line| line.split_once(": ")).collect();
    let earlier = std::fs::read_to_string(folder.join("earlier.txt")).unwrap();
    let mut earlier: Vec<_> = earlier.lines().filter_map(rejected_earlier).collect();
    let mut count = 0;
    let mut differences = Vec::new();
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "ngc") {
            continue;
        }
        count += 1;
        let program = std::fs::read(&path).unwrap();
        let stored = std::fs::read_to_string(path.with_extension("canon")).unwrap();
        let theirs: Vec<String> = stored.lines().map(str::to_owned).collect();
        let settings = Settings {
            tools: Some(tools.clone()),
            block_delete: false,
            features: MachineFeatures {
                user_codes: (100..200).collect(),
                ..MachineFeatures::default()
            },
            ..Settings::default()
        };
        let ours = canon::canon(&program[..], settings);
        let found = relation(&theirs, &ours, &String::from_utf8_lossy(&program));
        let reason = known.iter().find(|(name, _)| path.ends_with(name));
        let named = earlier.iter().position(|(name, _)| path.ends_with(name));
        let named = named.map(|index| earlier.swap_remove(index).1);
        match (found, reason) {
            (Relation::Earlier(line), None) if named == Some(line) => {}
            (Relation::Equal, None) if named.is_none() => {}
            (Relation::Different(_), Some(_)) if named.is_none() => {}
            (found, reason) => differences.push(format!(
                "{}: {found:?}, known {reason:?}, earlier {named:?}",
                path.display()
            )),
        }
    }
    assert!(earlier.is_empty(), "of no program: {earlier:?}");
    assert!(count >= 200, "{count} programs");
    assert!(
        differences.is_empty(),
        "{} of {count} differ:\n{}",
        differences.len(),
        differences.join("\n")
    );
}

#[test]
fn the_comparison_detects_differences() {
    let lines = |text: &[&str]| text.iter().map(|line| (*line).to_owned()).collect::<Vec<_>>();
    let good = lines(&[
        "rapid 1 2 3 0 0 0 blend 0 0 | 0.00005 0.00005 0.0001",
        "feed 2 2 3 0 0 0 F100.0 blend 0 0 | 0.00005 0.00005 0.0001",
        "end",
    ]);
    assert_eq!(relation(&good, &good, "M2"), Relation::Equal);
    let rapid = "rapid 1 2 3 0 0 0 blend 0 0";
    let feed = "feed 2 2 3 0 0 0 F100.0 blend 0 0";
    for equal in [
        &["rapid 1 2 3.00005 0 0 0 blend 0 0", feed, "end"][..],
        &[rapid, "feed 2 2 3 0 0 0.00005 F100.0001 blend 0 0", "end"],
        &[rapid, "rapid 1 2.00009 3 0 0 0 blend 0 0", feed, "end"],
    ] {
        assert_eq!(relation(&good, &lines(equal), "M2"), Relation::Equal, "{equal:?}");
    }
    for bad in [
        &[rapid, "feed 2.0001 2 3 0 0 0 F100.0 blend 0 0", "end"][..],
        &[rapid, "feed 2 2 3 0 0 0 F100.0002 blend 0 0", "end"],
        &[rapid, "feed 2 2 3 0 0 0 F100.0 blend 0.01 0", "end"],
        &[rapid, "feed 2 2 3 0 0 0 F100.0 exact", "end"],
        &["rapid 1 2 3 0 0 0 stop", feed, "end"],
        &[feed, "end"],
        &[rapid, "rapid 2 2 3 0 0 0 blend 0 0", "end"],
        &[rapid, "end"],
        &[rapid, feed, "stop always", "end"],
        &[rapid, feed, "print 1", "end"],
        &[rapid, feed, "error 3 3:1: G0705"],
    ] {
        let found = relation(&good, &lines(bad), "M2");
        assert!(matches!(found, Relation::Different(_)), "{bad:?}");
    }
    // Cycles are exact here.
    let cycle = lines(&["rapid 1 2 3 0 0 0 exact", feed, "end"]);
    assert_ne!(relation(&good, &cycle, "M2"), Relation::Equal);
    assert_eq!(relation(&good, &cycle, "G81 Z1"), Relation::Equal);
    assert!(has_cycle("G0\nG81 Z1") && !has_cycle("G80\nG17 G0 X81"));
}

#[test]
fn motion_lost_before_an_error_is_a_difference() {
    let lines = |text: &[&str]| text.iter().map(|line| (*line).to_owned()).collect::<Vec<_>>();
    let (first, second) = ("rapid 1 2 3 0 0 0 blend 0 0", "feed 2 2 3 0 0 0 F100.0 blend 0 0");
    let program = "G0 X1\nS1\n(a)\n(b)\nM3 G1 Y?\n";
    let failed = lines(&[first, "spindle cw 1", "error 5 x"]);
    let equal = Relation::Equal;
    let assert_relation = |theirs: &[String], events: &[&str], program: &str, expected: &Relation| {
        let found = relation(theirs, &lines(events), program);
        let same = matches!(
            (&found, expected),
            (Relation::Different(_), Relation::Different(_))
        );
        assert!(same || found == *expected, "{events:?}: {found:?}");
    };
    let different = Relation::Different(String::new());
    // rs274 may have executed part of the rejected line.
    assert_relation(&failed, &[first, "error 5 5:1: G0301"], program, &equal);
    assert_relation(
        &failed,
        &[first, "spindle cw 1", "error 5 5:1: G0301"],
        program,
        &equal,
    );
    assert_relation(
        &failed,
        &["rapid 1 2 4 0 0 0 blend 0 0", "error 5 5:1: G0301"],
        program,
        &different,
    );
    assert_relation(&failed, &[first, "error 6 6:1: G0705"], program, &different);
    assert_relation(&failed, &[first, "spindle cw 1", "end"], program, &different);
    assert_relation(
        &failed,
        &[first, "error 4 4:1: G0301"],
        program,
        &Relation::Earlier(4),
    );
    // Moves of earlier lines are not part of it.
    assert_relation(&failed, &["error 5 5:1: G0301"], program, &different);
    let moved = lines(&[first, second, "error 5 x"]);
    assert_relation(&moved, &[first, "error 5 5:1: G0301"], program, &different);
    // Moves of a cycle are.
    assert_relation(
        &moved,
        &[first, "error 5 5:1: G0301"],
        "G0 X1\n\n\n\nG81 Z1\n",
        &equal,
    );
    let many: Vec<_> = (0..21)
        .map(|x| format!("rapid {x} 2 3 0 0 0 blend 0 0"))
        .collect();
    let many: Vec<&str> = many.iter().map(String::as_str).chain(["error 5 x"]).collect();
    assert_relation(&lines(&many), &["error 5 5:1: G0301"], program, &different);
    assert_relation(
        &lines(&many),
        &["error 5 5:1: G0301"],
        "\n\n\n\nG81 Z1\n",
        &different,
    );
    // Events before an earlier line are equal; otherwise it is a difference.
    let differences = "rapid 1 2 9 0 0 0 blend 0 0";
    assert_relation(&moved, &[differences, "error 3 3:1: G0705"], program, &different);
    assert_relation(
        &moved,
        &[first, second, "error 3 3:1: G0705"],
        program,
        &Relation::Earlier(3),
    );
}

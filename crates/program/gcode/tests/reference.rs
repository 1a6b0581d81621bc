//! Programs and what LinuxCNC 2.9's interpreter makes of them, stored by `tools/compare-rs274 --store`.
//!
//! `tests/programs/NAME.ngc` is a program of ours, `NAME.canon` what `rs274 -g` says to it: an event a line, and after
//! ` | ` how far its figures may be off, because rs274 prints four decimals of the unit in force. Errors are equal where
//! both refuse the same line. `known.txt` names the programs that differ, and why.

#[path = "common/canon.rs"]
mod canon;

use std::path::Path;

use evolvent_gcode::{MachineFeatures, Settings, ToolTable};

/// Ours has six decimals.
const OURS_MM: f64 = 0.6e-6;

/// An event's words, and how far its figures may be off: mm, degrees, mm/min.
fn split(line: &str) -> (Vec<&str>, [f64; 3]) {
    let (text, slack) = line.split_once(" | ").unwrap_or((line, ""));
    let mut limits = [1e-6, 1e-6, 1e-4];
    for (limit, word) in limits.iter_mut().zip(slack.split(' ')) {
        *limit = word.parse().unwrap_or(*limit);
    }
    (text.split(' ').collect(), limits)
}

/// Whether two events are equal, figure by figure. In cycles corners are exact here, where rs274 blends.
fn same(theirs: &str, ours: &str, cycles: bool) -> bool {
    let ((mut left, slack), (mut right, _)) = (split(theirs), split(ours));
    let blended = left.len().checked_sub(3).filter(|place| left[*place] == "blend");
    if let (true, Some(place), Some(&"exact")) = (cycles, blended, right.last()) {
        left.truncate(place);
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
                (Some((mark, left)), Some((also, right))) if mark == also => {
                    let limit = match index {
                        _ if mark == "F" => slack[2],
                        4..=6 => slack[1],
                        _ => slack[0],
                    };
                    left == right || (left - right).abs() <= limit + OURS_MM
                }
                _ => left == right,
            }
        })
}

/// Whether an event is a move that is none in four decimals.
fn is_still(lines: &[String], index: usize, slack: f64) -> bool {
    let place = |index: usize| -> Option<Vec<f64>> {
        let (words, _) = split(lines.get(index)?);
        let moves = ["rapid", "feed", "arc"].contains(&words[0]);
        let figures = words.get(1..7)?.iter().map(|word| word.parse().ok());
        if moves { figures.collect() } else { None }
    };
    let line = lines.get(index).is_some_and(|line| !line.starts_with("arc"));
    let before = index.checked_sub(1).and_then(place);
    match (line, before, place(index)) {
        (true, Some(before), Some(now)) => before.iter().zip(&now).all(|(a, b)| (a - b).abs() <= 2.0 * slack),
        _ => false,
    }
}

/// The first difference.
fn difference(theirs: &[String], ours: &[String], cycles: bool) -> Option<String> {
    let (mut a, mut b) = (0, 0);
    while a < theirs.len() || b < ours.len() {
        let event =
            |list: &[String], index: usize| list.get(index).map_or("(nothing)", |line| line).to_owned();
        let (left, right) = (event(theirs, a), event(ours, b));
        // How a program ends without M2 is not compared.
        if left == "end" && (right == "end" || right.starts_with("spindle stop") || right == "coolant 0 0") {
            return None;
        }
        if right.starts_with("error") {
            // Here a line counts as a whole or not at all: rs274 may have done a part of it.
            let last = theirs.last()?;
            let line = |text: &str| text.split(' ').nth(1).and_then(|word| word.parse::<u32>().ok());
            let (refused, here) = (line(last), line(&right));
            let earlier = right.contains("G0705") && here < refused && here > Some(0);
            // A move too short for the tool is told when it comes, by rs274 when the move after it ends.
            let equal = last.starts_with("error") && (here == refused || earlier);
            return (!equal).then(|| format!("rs274 {last:?}, here {right:?}"));
        }
        if same(&left, &right, cycles) {
            (a, b) = (a + 1, b + 1);
            continue;
        }
        let slack = split(&left).1[0];
        if is_still(ours, b, slack) {
            b += 1;
        } else if is_still(theirs, a, slack) {
            a += 1;
        } else {
            return Some(format!("event {}: rs274 {left:?}, here {right:?}", a + 1));
        }
    }
    None
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

#[test]
fn programs_mean_what_they_mean_to_linuxcnc() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/programs");
    let tools = ToolTable::parse(&std::fs::read_to_string(folder.join("tools.tbl")).unwrap()).unwrap();
    let known = std::fs::read_to_string(folder.join("known.txt")).unwrap();
    let known: Vec<_> = known.lines().filter_map(|line| line.split_once(": ")).collect();
    let mut count = 0;
    let mut wrong = Vec::new();
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
        let cycles = has_cycle(&String::from_utf8_lossy(&program));
        let found = difference(&theirs, &ours, cycles);
        let reason = known.iter().find(|(name, _)| path.ends_with(name));
        match (found, reason) {
            (Some(text), None) => wrong.push(format!("{}: {text}", path.display())),
            (None, Some((name, reason))) => wrong.push(format!("{name}: known ({reason}), and equal")),
            _ => {}
        }
    }
    assert!(count >= 200, "{count} programs");
    assert!(
        wrong.is_empty(),
        "{} of {count} differ:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

#[test]
fn the_comparison_sees_what_it_is_for() {
    let lines = |text: &[&str]| text.iter().map(|line| (*line).to_owned()).collect::<Vec<_>>();
    let good = lines(&[
        "rapid 1 2 3 0 0 0 blend 0 0 | 0.00005 0.00005 0.0001",
        "feed 2 2 3 0 0 0 F100.0 blend 0 0 | 0.00005 0.00005 0.0001",
        "end",
    ]);
    assert_eq!(difference(&good, &good, false), None);
    let rapid = "rapid 1 2 3 0 0 0 blend 0 0";
    let feed = "feed 2 2 3 0 0 0 F100.0 blend 0 0";
    for equal in [
        &["rapid 1 2 3.00005 0 0 0 blend 0 0", feed, "end"][..],
        &[rapid, "feed 2 2 3 0 0 0.00005 F100.0001 blend 0 0", "end"],
        &[rapid, "rapid 1 2.00009 3 0 0 0 blend 0 0", feed, "end"],
    ] {
        assert_eq!(difference(&good, &lines(equal), false), None, "{equal:?}");
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
        assert!(difference(&good, &lines(bad), false).is_some(), "{bad:?}");
    }
    // Cycles are exact here.
    let cycle = lines(&["rapid 1 2 3 0 0 0 exact", feed, "end"]);
    assert!(difference(&good, &cycle, false).is_some());
    assert_eq!(difference(&good, &cycle, true), None);
    assert!(has_cycle("G0\nG81 Z1") && !has_cycle("G80\nG17 G0 X81"));
    // Errors are equal at the same line, and what comes before them counts.
    let failed = lines(&["rapid 1 2 3 0 0 0 blend 0 0", "spindle cw 1", "error 5 x"]);
    for (events, equal) in [
        (&[rapid, "error 5 5:1: G0301"][..], true),
        (&[rapid, "spindle cw 1", "error 5 5:1: G0301"], true),
        (&["rapid 1 2 4 0 0 0 blend 0 0", "error 5 5:1: G0301"], false),
        (&[rapid, "error 4 4:1: G0301"], false),
        (&[rapid, "error 6 6:1: G0705"], false),
        (&[rapid, "error 4 4:1: G0705"], true),
        (&[rapid, "spindle cw 1", "end"], false),
    ] {
        let found = difference(&failed, &lines(events), false);
        assert_eq!(found.is_none(), equal, "{events:?}: {found:?}");
    }
}

//! Programs and what LinuxCNC 2.9's interpreter makes of them, stored by `tools/compare-rs274 --store`.
//!
//! `tests/programs/NAME.ngc` is a program of ours, `NAME.canon` what `rs274 -g` says to it. Figures there have
//! four decimals of the active unit, and offsets add up, hence the tolerance.

#[path = "common/canon.rs"]
mod canon;

use std::path::Path;

use evolvent_gcode::{Settings, ToolTable};

/// Whether two events are equal, figure by figure.
fn same(theirs: &str, ours: &str, unit_mm: f64) -> bool {
    let (left, right): (Vec<_>, Vec<_>) = (theirs.split(' ').collect(), ours.split(' ').collect());
    left.len() == right.len()
        && left.iter().zip(&right).all(|(left, right)| {
            let number = |word: &str| {
                let bare = word.trim_start_matches(['F', 'K']);
                let length = word.len() - bare.len();
                bare.parse::<f64>().ok().map(|value| (length, value))
            };
            match (number(left), number(right)) {
                (Some((marked, left)), Some((also, right))) if marked == also => {
                    let rate = if marked == 1 {
                        1e-4 * left.abs().max(right.abs())
                    } else {
                        0.0
                    };
                    (left - right).abs() <= 4e-4 * unit_mm + rate
                }
                _ => left == right,
            }
        })
}

/// Leaves out moves that are none in four decimals.
fn moving(lines: &[String], unit_mm: f64) -> Vec<&str> {
    let mut at: Option<Vec<f64>> = None;
    let mut kept = Vec::new();
    for line in lines {
        let words: Vec<_> = line.split(' ').collect();
        match words[0] {
            "rapid" | "feed" => {
                let place: Vec<f64> = words[1..7].iter().filter_map(|word| word.parse().ok()).collect();
                let still = at.as_ref().is_some_and(|at| {
                    at.iter()
                        .zip(&place)
                        .all(|(a, b)| (a - b).abs() < 1.5e-4 * unit_mm)
                });
                if still {
                    continue;
                }
                at = Some(place);
            }
            "arc" | "spline" | "thread" | "probe" => at = None,
            _ => {}
        }
        kept.push(line.as_str());
    }
    kept
}

/// The first difference.
fn difference(theirs: &[String], ours: &[String], unit_mm: f64) -> Option<String> {
    let (mut theirs, mut ours) = (moving(theirs, unit_mm), moving(ours, unit_mm));
    if theirs.last().is_some_and(|line| line.starts_with("error")) {
        let theirs_says = theirs.pop();
        if !ours.last().is_some_and(|line| line.starts_with("error")) {
            return Some(format!("rs274 says {theirs_says:?}, nothing is wrong here"));
        }
        ours.pop();
        // Here a line counts as a whole or not at all, so it may end a few events earlier.
        theirs.truncate(ours.len());
    }
    for index in 0..theirs.len().max(ours.len()) {
        let event = |list: &[&str]| list.get(index).map_or("(nothing)", |line| *line).to_owned();
        let (left, right) = (event(&theirs), event(&ours));
        // How a program ends without M2 is not compared.
        if left == "end" && (right == "end" || right.starts_with("spindle stop") || right == "coolant 0 0") {
            return None;
        }
        if !same(&left, &right, unit_mm) {
            return Some(format!("event {}: rs274 {left:?}, here {right:?}", index + 1));
        }
    }
    None
}

#[test]
fn programs_mean_what_they_mean_to_linuxcnc() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/programs");
    let tools = ToolTable::parse(&std::fs::read_to_string(folder.join("tools.tbl")).unwrap()).unwrap();
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
            user_codes: (100..200).collect(),
            ..Settings::default()
        };
        let ours = canon::canon(&program[..], settings);
        let inches = String::from_utf8_lossy(&program).contains("G20");
        if let Some(text) = difference(&theirs, &ours, if inches { 25.4 } else { 1.0 }) {
            wrong.push(format!("{}: {text}", path.display()));
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
    let good = lines(&["rapid 1 2 3 0 0 0", "feed 2 2 3 0 0 0 F100.0", "end"]);
    assert_eq!(difference(&good, &good, 1.0), None);
    for bad in [
        &["rapid 1 2 3 0 0 0", "feed 2.001 2 3 0 0 0 F100.0", "end"][..],
        &["rapid 1 2 3 0 0 0", "feed 2 2 3 0 0 0 F101.0", "end"],
        &["feed 2 2 3 0 0 0 F100.0", "end"],
        &["rapid 1 2 3 0 0 0", "rapid 2 2 3 0 0 0", "end"],
        &["rapid 1 2 3 0 0 0", "end"],
        &[
            "rapid 1 2 3 0 0 0",
            "feed 2 2 3 0 0 0 F100.0",
            "stop always",
            "end",
        ],
        &["rapid 1 2 3 0 0 0", "feed 2 2 3 0 0 0 F100.0", "error 3"],
    ] {
        assert!(difference(&good, &lines(bad), 1.0).is_some(), "{bad:?}");
    }
    // A difference after an error counts too.
    let failed = lines(&["rapid 1 2 3 0 0 0", "error x"]);
    assert!(difference(&failed, &lines(&["rapid 1 2 4 0 0 0", "error y"]), 1.0).is_some());
    assert_eq!(difference(&failed, &lines(&["error y"]), 1.0), None);
}

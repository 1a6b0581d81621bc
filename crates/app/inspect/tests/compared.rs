//! Two runs, aligned by path length: which was slower, where, and why.
#![allow(clippy::expect_used, reason = "tests fail as tests do")]

use crate::common::{PROGRAM, altered, record};
use evolvent_inspect::compare;
use evolvent_path::AxisLetter;
use evolvent_runtime::Clock;

#[test]
fn a_run_is_like_itself() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, outcome) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let same = compare(&trace, &trace).expect("a comparison");
    // Rounding of an interpolation between two equal numbers.
    assert!(
        same.max_deviation_mm < 1e-12 && same.first_deviation.is_none(),
        "{same:?}"
    );
    assert!(same.lines.is_empty() && same.notes.is_empty(), "{same:?}");
    assert!((same.common_path_mm - outcome.summary.path_length_mm).abs() < 1e-6);
    assert_eq!(same.common_s[0], same.common_s[1]);
}

#[test]
fn the_slower_run_is_named_with_lines_and_the_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let (fast, a) = record(folder.path(), "fast", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let (slow, b) = record(folder.path(), "slow", PROGRAM, Clock::Virtual, 0.5, |_| {});
    let found = compare(&fast, &slow).expect("a comparison");
    let lost = b.summary.duration_s - a.summary.duration_s;
    assert!(lost > 0.2);
    assert!((found.duration_s[1] - found.duration_s[0] - lost).abs() < 1e-9);
    let lag = found.lag.last().expect("a curve").1;
    assert!((lag - lost).abs() < 0.05, "{lag} of {lost}");
    let worst = &found.lines[0];
    assert!(
        worst.b_s > worst.a_s && worst.why.contains("override"),
        "{worst:?}"
    );
    assert!(
        found.notes.iter().any(|note| note.starts_with("feed_override")),
        "{:?}",
        found.notes
    );
}

#[test]
fn a_bump_in_one_run_is_found_at_its_place() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let mut position = 0.0;
    let bumped = altered(
        &trace,
        "bumped",
        |_| {},
        |cycle| {
            if (300..310).contains(&cycle.sequence) {
                cycle.position[1] += 0.01;
                position = cycle.path_mm;
            }
            true
        },
    );
    let found = compare(&trace, &bumped).expect("a comparison");
    assert!(
        (found.max_deviation_mm - 0.01).abs() < 1e-6,
        "{}",
        found.max_deviation_mm
    );
    assert!(
        (found.deviation_at_mm - position).abs() < 2.0,
        "{} for {position}",
        found.deviation_at_mm
    );
}

#[test]
fn rotary_and_secondary_axes_are_compared() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let with = |name: &str, letter: AxisLetter, value: f64| {
        altered(
            &trace,
            name,
            |run| run.axes.push(letter),
            |cycle| {
                if cycle.sequence >= 400 {
                    cycle.position[letter.index()] = value;
                }
                true
            },
        )
    };
    let (at_0, at_20) = (with("a0", AxisLetter::A, 0.0), with("a20", AxisLetter::A, 20.0));
    let same = compare(&at_20, &at_20).expect("a comparison");
    assert_eq!(
        (same.first_deviation, same.max_rotary_deviation_deg),
        (None, Some(0.0))
    );
    let found = compare(&at_0, &at_20).expect("a comparison");
    assert!(found.first_deviation.is_some(), "{found:?}");
    let degrees = found.max_rotary_deviation_deg.expect("a rotary axis");
    assert!(
        (degrees - 20.0).abs() < 1e-9 && found.max_deviation_mm < 1e-9,
        "{found:?}"
    );
    let found =
        compare(&with("u0", AxisLetter::U, 0.0), &with("u3", AxisLetter::U, 3.0)).expect("a comparison");
    assert!((found.max_deviation_mm - 3.0).abs() < 1e-9, "{found:?}");
    assert_eq!(found.max_rotary_deviation_deg, None);
}

#[test]
fn a_move_without_path_is_compared_at_the_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let last = crate::common::cycles(&trace).last().expect("cycles").sequence;
    let turned = |name: &str, degrees: f64| {
        altered(
            &trace,
            name,
            |run| run.axes.push(AxisLetter::A),
            |cycle| {
                if cycle.sequence == last {
                    cycle.position[AxisLetter::A.index()] = degrees;
                }
                true
            },
        )
    };
    let found = compare(&turned("a", 0.0), &turned("b", 5.0)).expect("a comparison");
    assert_eq!(found.max_rotary_deviation_deg, Some(5.0), "{found:?}");
}

#[test]
fn comparing_a_whole_service_trace_adds_a_note() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let serve = |run: &mut evolvent_trace::RunInfo| {
        run.extra.insert("served".to_owned(), "true".to_owned());
    };
    let served = altered(&trace, "served", serve, |_| true);
    let found = compare(&trace, &served).expect("a comparison");
    assert!(
        found
            .notes
            .iter()
            .any(|note| note.starts_with("B is a service") && note.ends_with("--job-b")),
        "{:?}",
        found.notes
    );
    assert!(
        !found.notes.iter().any(|note| note.starts_with("A is")),
        "{:?}",
        found.notes
    );
}

#[test]
fn lines_of_two_programs_are_shown_with_both_texts() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = |name: &str, text: &str| record(folder.path(), name, text, Clock::Virtual, 1.0, |_| {}).0;
    let one = run("one", "G21\nG1 X10 F600\nM2\n");
    let other = run("other", "G21\nG1 X10 F300\nG1 X11\nM2\n");
    let found = compare(&one, &other).expect("a comparison");
    let line = |number: u32| {
        found
            .lines
            .iter()
            .find(|line| line.line == number)
            .expect("the line")
    };
    assert_eq!(line(2).text, "G1 X10 F600");
    assert_eq!(line(2).b_text.as_deref(), Some("G1 X10 F300"));
    assert_eq!(line(3).b_text.as_deref(), Some("G1 X11"));
    assert!(
        found
            .notes
            .iter()
            .any(|note| note.contains("one.ngc against other.ngc")),
        "{:?}",
        found.notes
    );
}

//! Two runs, aligned by place: which was slower, where, and why.
#![allow(clippy::expect_used, reason = "tests fail as tests do")]

use crate::common::{PROGRAM, altered, record};
use evolvent_inspect::compare;
use evolvent_runtime::Clock;

#[test]
fn a_run_is_like_itself() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, outcome) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let same = compare(&trace, &trace).expect("a comparison");
    // What interpolation between two equal numbers rounds.
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
    let mut place = 0.0;
    let bumped = altered(
        &trace,
        "bumped",
        |_| {},
        |cycle| {
            if (300..310).contains(&cycle.sequence) {
                cycle.position[1] += 0.01;
                place = cycle.path_mm;
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
        (found.deviation_at_mm - place).abs() < 2.0,
        "{} for {place}",
        found.deviation_at_mm
    );
}

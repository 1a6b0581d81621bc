//! A recorded run is recomputed exactly, and every change of the record is found.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

use std::time::{Duration, Instant};

use crate::common::{PROGRAM, altered, cycles, long_program, record};
use evolvent_replay::verify;
use evolvent_runtime::Clock;
use evolvent_trace::inputs;

#[test]
fn runs_with_the_virtual_clock_come_out_the_same() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, program, feed_override) in [
        ("mixed", PROGRAM.to_owned(), 1.0),
        ("slow", PROGRAM.to_owned(), 0.37),
        ("fast", long_program(2), 1.4),
        (
            "wrong",
            format!("{}G1 X9999\n", PROGRAM.trim_end_matches("M30\n")),
            1.0,
        ),
    ] {
        let (trace, outcome) = record(
            folder.path(),
            name,
            &program,
            Clock::Virtual,
            feed_override,
            |_| {},
        );
        let verified = verify(&trace).expect("a readable trace");
        assert!(verified.holds(), "{name}: {verified:?}");
        assert!(verified.recomputed && !verified.lacks_data());
        assert_eq!(
            (verified.cycles, verified.compared),
            (outcome.summary.cycles, outcome.summary.cycles)
        );
        let error = verified.max_path_error_mm;
        assert!(error.is_some(), "{verified:?}");
        assert!(
            error.is_none_or(|error| error <= 0.020_000_1),
            "{name}: {error:?}"
        );
    }
}

#[test]
fn an_operated_real_time_run_recomputes_exactly() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, outcome) = record(
        folder.path(),
        "held",
        &long_program(20),
        Clock::Realtime,
        1.0,
        |controls| {
            // By the run's own time, with cycles of 1 ms, since the time of its start is unknown.
            let (begin, mut until) = (Instant::now(), 0);
            let mut wait = |cycles| {
                until += cycles;
                while controls.progress().cycles < until && begin.elapsed() < Duration::from_secs(60) {
                    std::thread::sleep(Duration::from_millis(1));
                }
                until = until.max(controls.progress().cycles);
            };
            wait(400);
            controls.set_override(0.6);
            wait(300);
            controls.set_hold(true);
            wait(400);
            controls.set_override(1.3);
            wait(150);
            controls.set_hold(false);
            wait(500);
            controls.set_hold(true);
            wait(20);
            controls.set_hold(false);
            wait(400);
            controls.set_override(0.0);
            wait(300);
            controls.set_override(1.0);
            wait(300);
            controls.stop();
        },
    );
    assert_eq!(outcome.summary.outcome.name(), "stopped");
    let found = cycles(&trace);
    let held = found
        .iter()
        .filter(|cycle| cycle.inputs & inputs::HOLD != 0)
        .count();
    assert!(held > 300, "{held} cycles with the hold recorded");
    assert!(found.iter().any(|cycle| cycle.inputs & inputs::STOP != 0));
    let waited = found
        .iter()
        .filter(|cycle| cycle.inputs & inputs::WAITED != 0)
        .count();
    let verified = verify(&trace).expect("a readable trace");
    println!(
        "{waited} cycles waited for the planner, {} starved",
        outcome.summary.starved_cycles
    );
    let refused = found
        .iter()
        .filter(|cycle| cycle.inputs & inputs::REFUSED != 0)
        .count();
    println!("{refused} answers came to nothing");
    let missed = found
        .iter()
        .any(|cycle| cycle.inputs & (inputs::WAITED | inputs::REFUSED) != 0 && cycle.feed_mm_s > 0.0);
    if !verified.holds() && (outcome.summary.starved_cycles > 0 || missed) {
        // On a host that is too busy; differences must at least be explained.
        println!("not measured: the planner was too slow on this machine");
        assert!(!verified.explanations.is_empty(), "{verified:?}");
    } else {
        assert!(verified.holds(), "{verified:?}");
    }
}

#[test]
fn first_differing_cycle_block_and_quantity_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let all = cycles(&trace);
    // One bit of one number of one cycle.
    let victim = all
        .iter()
        .find(|cycle| cycle.line == 7 && cycle.feed_mm_s > 10.0)
        .expect("a cycle of line 7")
        .sequence;
    let nudged = altered(
        &trace,
        "nudged",
        |_| {},
        |cycle| {
            if cycle.sequence == victim {
                cycle.acceleration[1] = f64::from_bits(cycle.acceleration[1].to_bits() ^ 1);
            }
            true
        },
    );
    let verified = verify(&nudged).expect("a readable trace");
    assert!(!verified.holds());
    assert_eq!(verified.differing, 1);
    let difference = verified.first_difference.expect("a difference");
    assert_eq!(
        (
            difference.sequence,
            difference.line,
            difference.text.as_str(),
            difference.quantity.as_str()
        ),
        (victim, 7, "G1 X0", "acceleration Y")
    );
    assert!(
        verified.explanations.is_empty(),
        "nothing explains it: {:?}",
        verified.explanations
    );
    // A micrometre does not only change bits: jerk shows it without any planner.
    let moved = altered(
        &trace,
        "moved",
        |_| {},
        |cycle| {
            if cycle.sequence == victim {
                cycle.position[0] += 1e-3;
            }
            true
        },
    );
    let verified = verify(&moved).expect("a readable trace");
    assert!(verified.limit_violations > 0);
    assert!(
        verified.violations[0].contains("axis X"),
        "{:?}",
        verified.violations
    );
    assert!((verified.greatest_difference - 1e-3).abs() < 1e-9);
}

#[test]
fn version_platform_and_machine_file_explain_a_change() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let copy = altered(
        &trace,
        "old",
        |info| {
            info.versions.insert("evolvent".to_owned(), "0.0.7".to_owned());
            info.extra.insert("platform".to_owned(), "m68k-amiga".to_owned());
            info.machine_file = info
                .machine_file
                .replace("max_jerk_m_s3 = 200", "max_jerk_m_s3 = 100");
        },
        |_| true,
    );
    let verified = verify(&copy).expect("a readable trace");
    assert!(
        verified.first_difference.is_some(),
        "half of the jerk is another motion"
    );
    let text = verified.explanations.join("\n");
    for part in ["0.0.7", "m68k-amiga", "machine file"] {
        assert!(text.contains(part), "{part} is not in {text}");
    }
}

#[test]
fn missing_cycles_are_counted_and_the_rest_compared() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, outcome) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let gap = altered(
        &trace,
        "gap",
        |_| {},
        |cycle| !(100..150).contains(&cycle.sequence),
    );
    let verified = verify(&gap).expect("a readable trace");
    assert!(verified.holds(), "{verified:?}");
    assert!(verified.lacks_data());
    assert_eq!(
        (verified.missing, verified.cycles),
        (50, outcome.summary.cycles - 50)
    );
}

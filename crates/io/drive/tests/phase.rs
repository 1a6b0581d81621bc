//! The phase lock: range, speed and steadiness, with drift, jitter and delayed feedback.

#![allow(clippy::expect_used, reason = "a test may fail")]

use std::collections::VecDeque;

use evolvent_drive::{MAX_CORRECTION_RATIO, PhaseLock, PhaseSettings};
use evolvent_random::Random;

/// Cycles until the drift stays known to a tenth, if errors arrive only every `row`th cycle.
fn cycles_to_the_drift(row: usize, delay: usize) -> usize {
    const PERIOD_NS: u64 = 28_571;
    const DRIFT: f64 = 100e-6;
    let mut lock = PhaseLock::new(PhaseSettings {
        period_ns: PERIOD_NS,
        delay_cycles: delay as u32,
        target_ns: 0,
    });
    let mut in_transit: VecDeque<f64> = VecDeque::new();
    let (mut error, mut known_from) = (0.0, None);
    for cycle in 0..200_000 {
        in_transit.push_back(error);
        let newest = (in_transit.len() > delay)
            .then(|| in_transit.pop_front())
            .flatten()
            .filter(|_| cycle % row == 0);
        error += PERIOD_NS as f64 * DRIFT - lock.step(newest.map(|measured| measured as i64)) as f64;
        let is_known = (lock.drift_ratio() - DRIFT).abs() < 0.1 * DRIFT;
        known_from = is_known.then(|| known_from.unwrap_or(cycle));
    }
    known_from.expect("the drift is never found")
}

/// At 35 kHz the loop computes nine cycles in a row, with feedback in the first of them. By the loop's
/// equation this adds only the delay of up to a row; an integral per error would take several times as long.
#[test]
fn one_error_per_row_finds_drift_as_fast_as_per_cycle() {
    for delay in [20, 80] {
        let each = cycles_to_the_drift(1, delay);
        for row in [2, 9, 18] {
            let in_rows = cycles_to_the_drift(row, delay);
            let ratio = in_rows as f64 / each as f64;
            assert!(
                (0.7..=1.3).contains(&ratio),
                "delay {delay}, row {row}: {in_rows} cycles against {each}"
            );
        }
    }
}

/// An error after a long silence does not apply to all of it.
#[test]
fn error_after_silence_counts_at_most_for_the_delay() {
    let settings = PhaseSettings {
        period_ns: 1_000_000,
        delay_cycles: 10,
        target_ns: 0,
    };
    let drift_after = |silence: usize| {
        let mut lock = PhaseLock::new(settings);
        for _ in 0..silence {
            lock.step(None);
        }
        lock.step(Some(1000));
        lock.drift_ratio()
    };
    assert!((drift_after(4) / drift_after(0) - 5.0).abs() < 1e-9);
    assert!((drift_after(100_000) / drift_after(0) - 10.0).abs() < 1e-9);
}

struct Run {
    /// Phase errors in ns, one per cycle.
    errors: Vec<f64>,
    corrections: Vec<i64>,
}

/// A loop of `cycles` cycles: drives whose period is longer by `drift_ppm`, that begin `start_ns` late and are measured with
/// `jitter_ns` (uniform, both ways), `delay` cycles late.
fn run(period_ns: u64, delay: usize, drift_ppm: f64, start_ns: f64, jitter_ns: f64, cycles: usize) -> Run {
    let mut random = Random::new();
    let mut lock = PhaseLock::new(PhaseSettings {
        period_ns,
        delay_cycles: delay as u32,
        target_ns: 0,
    });
    let mut in_transit: VecDeque<i64> = VecDeque::new();
    let mut error = start_ns;
    let mut result = Run {
        errors: Vec::new(),
        corrections: Vec::new(),
    };
    for _ in 0..cycles {
        in_transit.push_back((error + random.between(-jitter_ns, jitter_ns)) as i64);
        let measured = (in_transit.len() > delay)
            .then(|| in_transit.pop_front())
            .flatten();
        let correction = lock.step(measured);
        error += period_ns as f64 * drift_ppm * 1e-6 - correction as f64;
        result.errors.push(error);
        result.corrections.push(correction);
    }
    result
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |max, value| max.max(value.abs()))
}

#[test]
fn period_changes_by_at_most_a_thousandth() {
    for (period_ns, delay) in [(28_571, 8), (1_000_000, 4), (4_000_000, 2)] {
        let limit = (period_ns as f64 * MAX_CORRECTION_RATIO) as i64;
        for start_ns in [-1e9, -5e5, 0.0, 5e5, 1e9] {
            let run = run(period_ns, delay, 100.0, start_ns, 2e4, 3000);
            assert!(run.corrections.iter().all(|correction| correction.abs() <= limit));
        }
        let mut lock = PhaseLock::new(PhaseSettings {
            period_ns,
            delay_cycles: 1,
            target_ns: i64::MIN,
        });
        assert!(lock.step(Some(i64::MAX)).abs() <= limit);
        assert!(lock.step(Some(i64::MIN)).abs() <= limit);
    }
}

#[test]
fn drift_of_200_ppm_is_removed_from_half_a_period() {
    for (period_ns, delay) in [
        (28_571, 4),
        (125_000, 4),
        (1_000_000, 4),
        (1_000_000, 20),
        (4_000_000, 10),
    ] {
        for drift_ppm in [-200.0, 0.0, 200.0] {
            let start_ns = 0.5 * period_ns as f64;
            let settled = run(period_ns, delay, drift_ppm, start_ns, 0.0, 20_000);
            let tail = &settled.errors[15_000..];
            // Whole ns a cycle leave a ripple of a few ns.
            assert!(
                largest(tail) < 5.0 + 1e-4 * period_ns as f64,
                "{period_ns} ns, {drift_ppm} ppm: {}",
                largest(tail)
            );
        }
    }
}

/// The remainder when the lock reports that it has settled: computed independently, with real numbers, at
/// most 1.2e-4 of a period and 0.27 ppm for these delays, from half a period away.
#[test]
fn a_lock_that_has_settled_knows_drift_and_phase() {
    for (period_ns, delay) in [(125_000, 4), (2_000_000, 20), (2_000_000, 62)] {
        for drift_ppm in [-200.0, 200.0] {
            let mut lock = PhaseLock::new(PhaseSettings {
                period_ns,
                delay_cycles: delay as u32,
                target_ns: 0,
            });
            let mut in_transit: VecDeque<i64> = VecDeque::new();
            let (mut error, mut settled) = (0.5 * period_ns as f64, 0);
            for _ in 0..20_000 {
                in_transit.push_back(error as i64);
                let measured = (in_transit.len() > delay)
                    .then(|| in_transit.pop_front())
                    .flatten();
                let correction = lock.step(measured);
                error += period_ns as f64 * drift_ppm * 1e-6 - correction as f64;
                if lock.is_settled() {
                    settled += 1;
                    assert!(error.abs() < 5.0 + 2e-4 * period_ns as f64, "{error} ns");
                    assert!((1e6 * lock.drift_ratio() - drift_ppm).abs() < 0.5);
                    assert!((1e6 * lock.correction_ratio() - drift_ppm).abs() < 2.0);
                }
            }
            assert!(settled > 10_000, "{settled}");
            // After a long silence the phase is unknown again.
            for _ in 0..10_000 {
                lock.step(None);
            }
            assert!(!lock.is_settled());
            lock.step(Some(0));
            assert!(!lock.is_settled());
        }
    }
}

/// From half a period away at a thousandth per cycle, 500 cycles pass before the lock can settle; anti-windup
/// keeps the overshoot after that small. By the loop's equation: saturation ends at an error of 50 us with
/// the full speed of 1 us a cycle, from where a critically damped loop of 0.01 a cycle overshoots by 50 us /
/// e^2 = 6.8 us, 1.4 % of the start. An integral wound up to the limit would give 7 %.
#[test]
fn saturation_does_not_wind_the_integral_up() {
    let period_ns = 1_000_000;
    let run = run(period_ns, 4, 0.0, 0.5 * period_ns as f64, 0.0, 6000);
    let overshoot = run.errors.iter().fold(0.0, |min: f64, error| min.min(*error));
    assert!(-overshoot < 0.03 * 0.5 * period_ns as f64, "{overshoot}");
    assert!(largest(&run.errors[4000..]) < 0.01 * period_ns as f64);
}

#[test]
fn jitter_of_the_measurement_is_damped() {
    // Uniform jitter of +-50 us has a standard deviation of 28.9 us.
    let jitter_ns = 50_000.0;
    let run = run(1_000_000, 4, 30.0, 0.0, jitter_ns, 40_000);
    let tail = &run.errors[10_000..];
    let deviation = (tail.iter().map(|error| error * error).sum::<f64>() / tail.len() as f64).sqrt();
    assert!(deviation < 0.25 * jitter_ns / 3.0_f64.sqrt(), "{deviation}");
}

#[test]
fn without_news_the_drift_that_was_found_is_kept() {
    let period_ns = 1_000_000_u64;
    let mut lock = PhaseLock::new(PhaseSettings {
        period_ns,
        delay_cycles: 2,
        target_ns: 0,
    });
    let mut error = 0.0;
    for _ in 0..20_000 {
        error += period_ns as f64 * 80e-6 - lock.step(Some(error as i64)) as f64;
    }
    assert!(
        (lock.drift_ratio() - 80e-6).abs() < 2e-6,
        "{}",
        lock.drift_ratio()
    );
    let before = error;
    for _ in 0..10_000 {
        error += period_ns as f64 * 80e-6 - lock.step(None) as f64;
    }
    // 10 s later the two clocks are at most 2 ppm apart.
    assert!((error - before).abs() < 20_000.0, "{}", error - before);
}

/// A delay of 4 cycles gives w = 0.01: an error of 20 ns is corrected by 2 w of it, 0.4 ns per cycle, until
/// the 4 / w = 400th cycle without an error; after that only the integral is left, w^2 of 20 ns.
#[test]
fn fractional_ns_accumulate_and_old_correction_ends() {
    let mut lock = PhaseLock::new(PhaseSettings {
        period_ns: 1_000_000,
        delay_cycles: 4,
        target_ns: 500,
    });
    // At the target no correction is needed.
    assert_eq!((0..100).map(|_| lock.step(Some(500))).sum::<i64>(), 0);
    assert_eq!(lock.drift_ratio(), 0.0);
    let first = lock.step(Some(520));
    let held: i64 = (0..400).map(|_| lock.step(None)).sum();
    assert!((159..=161).contains(&(first + held)), "{first} and {held}");
    let behind: i64 = (0..400).map(|_| lock.step(None)).sum();
    assert!((0..=2).contains(&behind), "{behind}");
}

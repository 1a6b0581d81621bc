//! The phase lock: how far, how fast, how steadily, with drift, jitter and old feedback.

mod common;

use std::collections::VecDeque;

use common::Random;
use evolvent_drive::{MAX_CORRECTION_RATIO, PhaseLock, PhaseSettings};

struct Run {
    /// Phase errors in ns, one a cycle.
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
    let mut on_the_way: VecDeque<i64> = VecDeque::new();
    let mut error = start_ns;
    let mut result = Run {
        errors: Vec::new(),
        corrections: Vec::new(),
    };
    for _ in 0..cycles {
        on_the_way.push_back((error + random.between(-jitter_ns, jitter_ns)) as i64);
        let seen = (on_the_way.len() > delay)
            .then(|| on_the_way.pop_front())
            .flatten();
        let correction = lock.step(seen);
        error += period_ns as f64 * drift_ppm * 1e-6 - correction as f64;
        result.errors.push(error);
        result.corrections.push(correction);
    }
    result
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most, value| most.max(value.abs()))
}

#[test]
fn the_period_is_never_changed_by_more_than_a_thousandth() {
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
fn drift_of_200_ppm_is_taken_out_from_half_a_period_away() {
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

/// From half a period away at a thousandth a cycle 500 cycles go by before anything can be settled; anti-windup keeps the
/// overshoot behind that small. By the loop's equation: saturation ends at an error of 50 us with the full speed of 1 us a
/// cycle, from where a critically damped loop of 0.01 a cycle overshoots by 50 us / e^2 = 6.8 us, 1.4 % of the start. An integral
/// that was wound up to the limit would give 7 %.
#[test]
fn saturation_does_not_wind_the_integral_up() {
    let period_ns = 1_000_000;
    let run = run(period_ns, 4, 0.0, 0.5 * period_ns as f64, 0.0, 6000);
    let overshoot = run.errors.iter().fold(0.0, |least: f64, error| least.min(*error));
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

/// A delay of 4 cycles gives w = 0.01: an error of 20 ns corrects by 2 w of it, 0.4 ns a cycle, until the 4 / w = 400th cycle without
/// news; what is left then is the integral, w^2 of 20 ns.
#[test]
fn parts_of_a_ns_add_up_and_a_correction_without_news_ends() {
    let mut lock = PhaseLock::new(PhaseSettings {
        period_ns: 1_000_000,
        delay_cycles: 4,
        target_ns: 500,
    });
    // Nothing is wanted but the target.
    assert_eq!((0..100).map(|_| lock.step(Some(500))).sum::<i64>(), 0);
    assert_eq!(lock.drift_ratio(), 0.0);
    let first = lock.step(Some(520));
    let held: i64 = (0..400).map(|_| lock.step(None)).sum();
    assert!((159..=161).contains(&(first + held)), "{first} and {held}");
    let behind: i64 = (0..400).map(|_| lock.step(None)).sum();
    assert!((0..=2).contains(&behind), "{behind}");
}

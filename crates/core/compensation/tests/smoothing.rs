//! The smoothed direction: its values and bounds.

use evolvent_compensation::{Direction, TripleAverage};
use evolvent_random::Random;

/// The integral of the quadratic B-spline over three intervals of length 1.
fn smooth_step(t: f64) -> f64 {
    if t >= 3.0 {
        return 1.0;
    }
    let piece = |t: f64| t.max(0.0).powi(3) / 6.0;
    piece(t) - 3.0 * piece(t - 1.0) + 3.0 * piece(t - 2.0) - piece(t - 3.0)
}

#[test]
fn three_averages_are_a_sum_of_smooth_steps() {
    let mut random = Random::seeded(16_702);
    for _ in 0..50 {
        let n = random.below(40) + 1;
        let length = n as f64;
        let mut average = TripleAverage::new(n, 0);
        let mut steps: Vec<(f64, f64)> = Vec::new();
        let mut signal = 0_i64;
        let mut past = [0.0; 3];
        for period in 0..600 {
            let wish = [-1, 0, 1][random.below(3)];
            // Rarely, often, and at every period.
            let pause = n * random.below(3);
            if random.below(1 + pause) == 0 && wish != signal {
                steps.push((f64::from(period), (wish - signal) as f64));
                signal = wish;
            }
            average.step(signal);
            let now = f64::from(period + 1);
            let expected: f64 = steps
                .iter()
                .map(|(at, height)| height * smooth_step((now - at) / length))
                .sum();
            let at = average.at();
            assert!(
                (at[0] - expected).abs() <= 1e-9,
                "n {n}, period {period}: {} not {expected}",
                at[0]
            );
            let bounds = [1.0, 1.5 / length, 4.0 / (length * length), 8.0 / length.powi(3)];
            for (value, bound) in at.iter().zip(bounds) {
                assert!(value.abs() <= bound * (1.0 + 1e-12), "n {n}: {at:?}");
            }
            // Differences of the published values have the same bounds.
            let d1 = at[0] - past[0];
            let d2 = at[0] - 2.0 * past[0] + past[1];
            let d3 = at[0] - 3.0 * past[0] + 3.0 * past[1] - past[2];
            for (value, bound) in [d1, d2, d3].iter().zip(&bounds[1..]) {
                assert!(
                    value.abs() <= bound + 1e-12,
                    "n {n}: difference {value}, bound {bound}"
                );
            }
            past = [at[0], past[0], past[1]];
        }
    }
}

#[test]
fn years_of_reversals_leave_no_drift() {
    let mut random = Random::seeded(16_703);
    let mut average = TripleAverage::new(37, 1);
    let mut sign = 1;
    for _ in 0..2_000_000 {
        if random.below(90) == 0 {
            sign = -sign;
        }
        average.step(sign);
    }
    for _ in 0..3 * 37 {
        average.step(1);
    }
    assert_eq!(average.at(), [1.0, 0.0, 0.0, 0.0]);
}

#[test]
fn a_direction_changes_only_after_the_width() {
    let mut direction = Direction::new(0.001, 5.0);
    for (position, expected) in [
        (5.0009, 0),
        (4.9995, 0),
        (5.0011, 1),
        (6.0, 1),
        (5.9991, 1),
        (6.5, 1),
        (6.4995, 1),
        (6.4989, -1),
        (6.4998, -1),
        (6.4, -1),
        (6.4009, -1),
        (6.4011, 1),
    ] {
        assert_eq!(direction.update(position), expected, "at {position}");
    }
    direction.rebase_position(0.0);
    assert_eq!(direction.update(-0.0009), 1);
    assert_eq!(direction.update(-0.0011), -1);
}

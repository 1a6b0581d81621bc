//! Corrects pieces of constant jerk so that they end exactly at the target.
//!
//! The error at the end, `e = (position, velocity, acceleration)`, is linear in the jerks. Of all corrections
//! that remove it, the one with the minimum integral of the squared jerk correction is taken. With the effect
//! `m_k` (three numbers) of the jerk of piece `k`, which lasts `t_k`, it is `d_k = m_k . x / t_k` where `(sum
//! of m_k m_k^T / t_k) x = e`. Durations do not change, so synchronised axes stay synchronised.

use crate::state::AxisState;

/// Steps `(duration, jerk)` of one axis.
pub(crate) type Steps = Vec<(f64, f64)>;

/// Pieces longer than this fraction of the total are divided into three: a correction has three unknowns.
const LONGEST_FRACTION: f64 = 1.0 / 3.0;
/// Number of passes. Each corrects the rounding of the one before.
const PASSES: usize = 3;

/// Corrects the jerks of `steps` so that they lead from `start` to `end`.
pub(crate) fn land(steps: &mut Steps, start: AxisState, end: AxisState) {
    steps.retain(|step| step.0 > 0.0);
    let whole: f64 = steps.iter().map(|step| step.0).sum();
    if !(whole > 0.0) {
        return;
    }
    let mut divided = Steps::with_capacity(steps.len() + 4);
    for &(duration, jerk) in steps.iter() {
        let parts = if duration > LONGEST_FRACTION * whole { 3 } else { 1 };
        for _ in 0..parts {
            divided.push((duration / f64::from(parts), jerk));
        }
    }
    *steps = divided;
    // Relative to the start: the last digit of a position far from zero would take much jerk in a short move.
    let (start, end) = (
        AxisState { p: 0.0, ..start },
        AxisState {
            p: end.p - start.p,
            ..end
        },
    );
    for _ in 0..PASSES {
        let reached = steps
            .iter()
            .fold(start, |state, &(duration, jerk)| state.after(duration, jerk));
        // Scaled by the total time, so that the three equations have the same weight.
        let missing = [
            end.p - reached.p,
            (end.v - reached.v) * whole,
            (end.a - reached.a) * whole * whole,
        ];
        let Some(x) = multipliers(steps, whole, missing) else {
            return;
        };
        let mut left = 1.0;
        for step in steps.iter_mut() {
            let t = step.0 / whole;
            left -= t;
            let m = effect(t, left);
            let correction = (m[0] * x[0] + m[1] * x[1] + m[2] * x[2]) / t;
            step.1 += correction / (whole * whole * whole);
        }
    }
}

/// The effect of one unit of jerk over `t`, followed by `left`, on position, velocity and acceleration at the
/// end.
fn effect(t: f64, left: f64) -> [f64; 3] {
    [
        t * (t * t / 6.0 + left * (0.5 * t + 0.5 * left)),
        t * (0.5 * t + left),
        t,
    ]
}

/// Solves the three normal equations by elimination; `None` if they are singular.
fn multipliers(steps: &Steps, whole: f64, missing: [f64; 3]) -> Option<[f64; 3]> {
    let mut matrix = [[0.0; 4]; 3];
    let mut left = 1.0;
    for step in steps {
        let t = step.0 / whole;
        left -= t;
        let m = effect(t, left);
        for row in 0..3 {
            for column in 0..3 {
                matrix[row][column] += m[row] * m[column] / t;
            }
        }
    }
    for row in 0..3 {
        matrix[row][3] = missing[row];
    }
    // Symmetric and positive definite: no pivoting needed.
    for k in 0..3 {
        let pivot = matrix[k][k];
        if !(pivot > 0.0) {
            return None;
        }
        for row in k + 1..3 {
            let fraction = matrix[row][k] / pivot;
            for column in k..4 {
                matrix[row][column] -= fraction * matrix[k][column];
            }
        }
    }
    let mut x = [0.0; 3];
    for k in (0..3).rev() {
        let known: f64 = (k + 1..3).map(|column| matrix[k][column] * x[column]).sum();
        x[k] = (matrix[k][3] - known) / matrix[k][k];
    }
    x.iter().all(|value| value.is_finite()).then_some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::tests::Random;

    fn run(start: AxisState, steps: &Steps) -> AxisState {
        steps.iter().fold(start, |state, &(t, jerk)| state.after(t, jerk))
    }

    #[test]
    fn an_end_state_error_is_corrected_with_little_jerk() {
        let mut random = Random::from_state(0x1a_0001);
        for case in 0..2000 {
            let count = 1 + (random.unit() * 12.0) as usize;
            let jerk = random.log(1e2, 1e6);
            let mut steps: Steps = (0..count)
                .map(|_| (random.log(1e-7, 1.0), jerk * (2.0 * random.unit() - 1.0)))
                .collect();
            let whole: f64 = steps.iter().map(|step| step.0).sum();
            let start = AxisState {
                p: 0.0,
                v: jerk * whole * whole * random.unit(),
                a: 0.0,
            };
            // The error that a relative change of the jerk of 1e-7 would cause.
            let mut end = run(start, &steps);
            let off = 1e-7 * jerk;
            end.p += off * whole.powi(3) * (random.unit() - 0.5);
            end.v += off * whole.powi(2) * (random.unit() - 0.5);
            end.a += off * whole * (random.unit() - 0.5);
            let before = steps.clone();
            land(&mut steps, start, end);
            let reached = run(start, &steps);
            let scale = (jerk * whole.powi(3)).max(end.p.abs());
            assert!((reached.p - end.p).abs() < 1e-12 * scale, "case {case}");
            assert!((reached.v - end.v).abs() * whole < 1e-12 * scale, "case {case}");
            assert!(
                (reached.a - end.a).abs() * whole * whole < 1e-12 * scale,
                "case {case}"
            );
            let max = |steps: &Steps| steps.iter().map(|step| step.1.abs()).fold(0.0, f64::max);
            // Three equal pieces would need about a hundred times 1e-7 in the worst case.
            assert!(
                max(&steps) <= max(&before) + 200.0 * off,
                "case {case}: {} pieces",
                before.len()
            );
        }
    }

    #[test]
    fn a_short_move_far_from_zero_needs_no_extra_jerk() {
        // Half a millisecond at 300 mm: the last digit of the position is 1e-5 of the distance.
        let mut steps = vec![(1e-4, 2e5), (1e-4, -2e5), (1e-4, -2e5), (1e-4, 2e5)];
        let mut end = run(AxisState::default(), &steps);
        (end.p, end.v, end.a) = (300.0 + end.p, 0.0, 0.0);
        let start = AxisState {
            p: 300.0,
            ..AxisState::default()
        };
        land(&mut steps, start, end);
        let max = steps.iter().map(|step| step.1.abs()).fold(0.0, f64::max);
        assert!((max / 2e5 - 1.0).abs() < 1e-3, "{max}");
    }

    #[test]
    fn times_stay_as_they_are() {
        let mut steps = vec![(0.5, 1.0), (0.0, 9.0), (0.2, -3.0), (0.3, 2.0)];
        land(
            &mut steps,
            AxisState::default(),
            AxisState {
                p: 1.0,
                v: 2.0,
                a: 3.0,
            },
        );
        let whole: f64 = steps.iter().map(|step| step.0).sum();
        assert!((whole - 1.0).abs() < 1e-15);
        let mut none = Steps::new();
        land(&mut none, AxisState::default(), AxisState::default());
        assert!(none.is_empty());
    }
}

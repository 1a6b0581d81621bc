//! Makes pieces of constant jerk end at the target exactly.
//!
//! What is missing at the end, `e = (position, velocity, acceleration)`, is linear in the jerks. Of all corrections
//! that make it up, the one with the least integral of their square is taken: with the effect `m_k` (three numbers)
//! of the jerk of piece `k`, which lasts `t_k`, it is `d_k = m_k . x / t_k` where `(sum of m_k m_k^T / t_k) x = e`.
//! Times stay as they are, so synchronised axes stay synchronised.

use crate::state::AxisState;

/// Steps `(duration, jerk)` of one axis.
pub(crate) type Steps = Vec<(f64, f64)>;

/// Pieces longer than this share of the whole are divided in three: a correction needs three numbers to play with.
const LONGEST_SHARE: f64 = 1.0 / 3.0;
/// A second pass mops up the rounding of the first.
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
        let parts = if duration > LONGEST_SHARE * whole { 3 } else { 1 };
        for _ in 0..parts {
            divided.push((duration / f64::from(parts), jerk));
        }
    }
    *steps = divided;
    for _ in 0..PASSES {
        let reached = steps
            .iter()
            .fold(start, |state, &(duration, jerk)| state.after(duration, jerk));
        // In units of the whole time, so that the three equations weigh alike.
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

/// What one unit of jerk over `t`, followed by `left`, does to position, velocity and acceleration at the end.
fn effect(t: f64, left: f64) -> [f64; 3] {
    [
        t * (t * t / 6.0 + left * (0.5 * t + 0.5 * left)),
        t * (0.5 * t + left),
        t,
    ]
}

/// Solves the three normal equations by elimination; none where they say nothing.
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
    // Symmetric and positive definite: no pivoting.
    for k in 0..3 {
        let pivot = matrix[k][k];
        if !(pivot > 0.0) {
            return None;
        }
        for row in k + 1..3 {
            let share = matrix[row][k] / pivot;
            for column in k..4 {
                matrix[row][column] -= share * matrix[k][column];
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

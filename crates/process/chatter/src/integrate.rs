//! Integration in time: an embedded Runge-Kutta pair of order 5(4) with step control and events.
//!
//! The coefficients are those of J. R. Dormand, P. J. Prince, "A family of embedded Runge-Kutta formulae"
//! (1980). The error of a step is below `relative |x| + absolute` in each component; the error at the end is
//! of that order times the number of oscillations. An event (a function of the state that changes its sign)
//! is located by a cubic through the ends of the step. The step is then shortened to end there, so that no
//! step has stages on both sides of it.

use nalgebra::SVector;

use crate::error::ChatterError;

/// The accuracy of an integration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// Permitted error of a step, relative to each component.
    pub relative: f64,
    /// ... and absolute, in the component's unit.
    pub absolute: f64,
    /// Maximum step, s.
    pub longest_step_s: f64,
}

impl Accuracy {
    /// For motions of a size, m, that close after a period to 1e-9 of it.
    pub(crate) fn of_cycles(size_m: f64, period_s: f64) -> Self {
        Self {
            relative: 1e-10,
            absolute: 1e-12 * size_m,
            longest_step_s: period_s / 64.0,
        }
    }
}

/// Maximum number of steps.
const MAX_STEPS: usize = 5_000_000;

const A: [[f64; 6]; 6] = [
    [1.0 / 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [3.0 / 40.0, 9.0 / 40.0, 0.0, 0.0, 0.0, 0.0],
    [44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0, 0.0, 0.0, 0.0],
    [
        19372.0 / 6561.0,
        -25360.0 / 2187.0,
        64448.0 / 6561.0,
        -212.0 / 729.0,
        0.0,
        0.0,
    ],
    [
        9017.0 / 3168.0,
        -355.0 / 33.0,
        46732.0 / 5247.0,
        49.0 / 176.0,
        -5103.0 / 18656.0,
        0.0,
    ],
    [
        35.0 / 384.0,
        0.0,
        500.0 / 1113.0,
        125.0 / 192.0,
        -2187.0 / 6784.0,
        11.0 / 84.0,
    ],
];
/// Difference of the two orders.
const E: [f64; 7] = [
    71.0 / 57600.0,
    0.0,
    -71.0 / 16695.0,
    71.0 / 1920.0,
    -17253.0 / 339_200.0,
    22.0 / 525.0,
    -1.0 / 40.0,
];

/// Integrates an autonomous system; keeps its step between calls.
#[derive(Clone, Debug)]
pub struct Integrator<const N: usize> {
    accuracy: Accuracy,
    step_s: f64,
    steps: usize,
}

impl<const N: usize> Integrator<N> {
    /// Creates an integrator with an accuracy.
    #[must_use]
    pub fn new(accuracy: Accuracy) -> Self {
        Self {
            accuracy,
            step_s: 0.1 * accuracy.longest_step_s,
            steps: 0,
        }
    }

    /// Number of steps so far, including rejected ones.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// The state after `duration_s`. `rate` gives the time derivative; a step ends where `event` changes its
    /// sign.
    ///
    /// # Errors
    /// Errors of `rate`; a step that would be too small.
    pub fn run(
        &mut self,
        mut state: SVector<f64, N>,
        duration_s: f64,
        rate: &mut impl FnMut(&SVector<f64, N>) -> Result<SVector<f64, N>, ChatterError>,
        event: &impl Fn(&SVector<f64, N>) -> f64,
    ) -> Result<SVector<f64, N>, ChatterError> {
        let smallest = 1e-13 * duration_s.max(self.accuracy.longest_step_s);
        let mut time = 0.0;
        let mut first = rate(&state)?;
        let mut side = event(&state);
        // Set where a step has to end at an event.
        let mut until_event: Option<f64> = None;
        let mut located = 0;
        while time < duration_s {
            let wanted = self.step_s.min(self.accuracy.longest_step_s);
            let left = duration_s - time;
            // Avoids a tiny step at the end.
            let whole = if left <= wanted * 1.001 {
                left
            } else if left < 2.0 * wanted {
                0.5 * left
            } else {
                wanted
            };
            let h = until_event.unwrap_or(whole).min(whole);
            self.steps += 1;
            if self.steps > MAX_STEPS || h < smallest {
                return Err(ChatterError::Integration {
                    time_s: time,
                    steps: self.steps,
                });
            }
            let (next, last, error) = self.attempt(&state, &first, h, rate)?;
            if error > 1.0 {
                let factor = if error.is_finite() {
                    (0.9 * libm::pow(error, -0.2)).max(0.2)
                } else {
                    0.2
                };
                self.step_s = h * factor;
                until_event = None;
                continue;
            }
            let there = event(&next);
            if until_event.is_none() && side * there < 0.0 && located < 2 && h > 16.0 * smallest {
                // The step crosses the event: shorten it to end just after the event.
                let (d0, d1) = (slope(event, &state, &first, h), slope(event, &next, &last, h));
                let s = crossing(side, there, h * d0, h * d1);
                until_event = Some((h * s).clamp(4.0 * smallest, h));
                located += 1;
                continue;
            }
            if until_event.is_none() || h >= 0.999 * whole {
                let factor = if error > 0.0 {
                    (0.9 * libm::pow(error, -0.2)).clamp(0.2, 5.0)
                } else {
                    5.0
                };
                self.step_s = (h * factor).min(self.accuracy.longest_step_s);
            }
            until_event = None;
            located = 0;
            time = if h >= left { duration_s } else { time + h };
            (state, first) = (next, last);
            // Exactly on the event, the motion decides on which side the state is.
            if there != 0.0 {
                side = there;
            }
        }
        Ok(state)
    }

    fn attempt(
        &self,
        state: &SVector<f64, N>,
        first: &SVector<f64, N>,
        h: f64,
        rate: &mut impl FnMut(&SVector<f64, N>) -> Result<SVector<f64, N>, ChatterError>,
    ) -> Result<(SVector<f64, N>, SVector<f64, N>, f64), ChatterError> {
        let mut k = [*first; 7];
        let mut next = *state;
        for (stage, row) in A.iter().enumerate() {
            next = *state;
            for (weight, k) in row.iter().zip(&k).take(stage + 1) {
                if *weight != 0.0 {
                    next += k * (h * weight);
                }
            }
            k[stage + 1] = rate(&next)?;
        }
        let mut error = 0.0_f64;
        for i in 0..N {
            let miss: f64 = E.iter().zip(&k).map(|(weight, k)| weight * k[i]).sum();
            let size = state[i].abs().max(next[i].abs());
            let scale = self.accuracy.absolute + self.accuracy.relative * size;
            let part = (h * miss / scale).abs();
            // `max` would ignore NaN.
            error = if part.is_nan() {
                f64::INFINITY
            } else {
                error.max(part)
            };
        }
        Ok((next, k[6], error))
    }
}

/// Derivative of the event function along the motion.
fn slope<const N: usize>(
    event: &impl Fn(&SVector<f64, N>) -> f64,
    state: &SVector<f64, N>,
    rate: &SVector<f64, N>,
    h: f64,
) -> f64 {
    let by = 1e-6 * h;
    (event(&(state + rate * by)) - event(&(state - rate * by))) / (2.0 * by)
}

/// Zero in (0, 1) of the cubic with two values of different sign and two slopes, rounded to just after it.
fn crossing(from: f64, to: f64, d0: f64, d1: f64) -> f64 {
    let value = |s: f64| {
        let r = 1.0 - s;
        r * r * ((1.0 + 2.0 * s) * from + s * d0) + s * s * ((3.0 - 2.0 * s) * to - r * d1)
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if value(middle) * from > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

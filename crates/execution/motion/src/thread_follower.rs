//! The follower of a thread: a jerk for each axis and period, within every limit.
//!
//! The course that it follows may end exactly at a limit of the travel, but the follower itself is beside the
//! course: by the noise of the angle, by the ripple that it does not follow, and by the rounding of corners
//! to whole periods. A period is therefore driven only if the axis could stop after it within its travel and
//! its velocity, at its acceleration and jerk. Otherwise the axis is driven by the stop that was possible
//! before, so such a stop exists at every moment.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, Jet};
use evolvent_planner::{Profile, ScalarLimits, ScalarState};

use crate::guard::TRAVEL_SLACK;
use crate::thread_cam::ThreadLeg;

/// Rate at which the follower corrects small errors, 1/s: three equal poles. At most [`FOLLOW_FRACTION`]
/// of the control rate.
const FOLLOW_RATE: f64 = 200.0;
const FOLLOW_FRACTION: f64 = 0.3;
/// Minimum fraction of the jerk that counts as left for corrections: where a course needs most of the jerk by its
/// ripple, a lower rate would follow it less well than a truncated jerk.
const MIN_JERK_LEFT: f64 = 0.5;
/// Ratio of two rates that are tried, and their number.
const RATE_STEP: f64 = 1.1;
const RATES: i32 = 33;
/// Rounding of a stop that is computed again in each of its periods, mm or degrees. The guard tolerates
/// [`TRAVEL_SLACK`].
const STOP_ROUNDING: f64 = 0.25 * TRAVEL_SLACK;
/// The same for velocities, relative.
const SPEED_ROUNDING: f64 = 1e-9;

/// Limits of the axes in a pass.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ThreadFollower {
    limits: Limits,
    low: Axes,
    high: Axes,
}

impl ThreadFollower {
    /// A follower of a pass between these positions, which are within the travel except for rounding.
    pub(crate) fn new(limits: &Limits, start: &Axes, legs: &[ThreadLeg]) -> Self {
        let (mut low, mut high) = (*start, *start);
        for leg in legs {
            (low, high) = (low.inf(&leg.end), high.sup(&leg.end));
        }
        Self {
            limits: *limits,
            low: low.inf(&limits.travel_min).map(|low| low - STOP_ROUNDING),
            high: high.sup(&limits.travel_max).map(|high| high + STOP_ROUNDING),
        }
    }

    /// The positions between which an axis remains.
    pub(crate) fn range(&self, axis: usize) -> (f64, f64) {
        (self.low[axis], self.high[axis])
    }

    /// Whether a course leaves the travel: an axis could not stop in it any more. Real-time safe.
    pub(crate) fn leaves_travel(&self, course: &Jet) -> bool {
        (0..AXES).any(|axis| {
            let state = ScalarState {
                x: course.position[axis],
                v: course.first[axis],
                a: course.second[axis],
            };
            self.limits.present[axis] && !self.stops_within(axis, self.low[axis], state)
        })
    }

    /// One period towards a course, whose state at the end of the period is `want`. Real-time safe.
    pub(crate) fn advance(&self, before: &Jet, want: &Jet, period_s: f64) -> Jet {
        let t = period_s;
        let rate = FOLLOW_RATE.min(FOLLOW_FRACTION / t);
        let mut jet = *before;
        for axis in 0..AXES {
            // The position one period ago on the same course.
            let [x, v, a, j] = [
                want.position[axis],
                want.first[axis],
                want.second[axis],
                want.third[axis],
            ];
            let from = ScalarState {
                x: before.position[axis],
                v: before.first[axis],
                a: before.second[axis],
            };
            let errors = [
                x - t * v + 0.5 * t * t * a - t * t * t * j / 6.0 - from.x,
                v - t * a + 0.5 * t * t * j - from.v,
                a - t * j - from.a,
            ];
            let (limit_a, limit_j) = (self.limits.acceleration[axis], self.limits.jerk[axis]);
            let left = (limit_j - j.abs()).max(MIN_JERK_LEFT * limit_j);
            let jerk = j + correction(&errors, rate_for(&errors, rate, left));
            let max = ((limit_a - from.a) / t).min(limit_j);
            let min = ((-limit_a - from.a) / t).max(-limit_j);
            let jerk = if min <= max { jerk.clamp(min, max) } else { 0.0 };
            let free = from.after(t, jerk);
            let (state, jerk) = if !self.limits.present[axis] || self.can_stop(axis, from.x, free) {
                (free, jerk)
            } else {
                self.stop(axis, from, t)
            };
            jet.position[axis] = state.x;
            jet.first[axis] = state.v;
            jet.second[axis] = state.a;
            jet.third[axis] = jerk;
        }
        jet
    }

    fn scalar_limits(&self, axis: usize) -> ScalarLimits {
        ScalarLimits {
            velocity: self.limits.velocity[axis],
            acceleration: self.limits.acceleration[axis],
            jerk: self.limits.jerk[axis],
        }
    }

    /// Whether the axis can stop from this state within its travel and velocity.
    fn can_stop(&self, axis: usize, before: f64, from: ScalarState) -> bool {
        let limits = self.scalar_limits(axis);
        // The speed at which a stop has removed the acceleration, in both directions.
        let gained = from.a * from.a / (2.0 * limits.jerk);
        let extreme = if from.v * from.a >= 0.0 {
            from.v.abs() + gained
        } else {
            from.v.abs().max(gained - from.v.abs())
        };
        if extreme > limits.velocity * (1.0 + SPEED_ROUNDING) {
            return false;
        }
        // No stop is longer than this: the acceleration is removed, the speed is, and then as much again.
        let peak = from.v.abs() + gained;
        let duration = from.a.abs() / limits.jerk
            + peak / limits.acceleration
            + 2.0 * limits.acceleration.min((peak * limits.jerk).sqrt()) / limits.jerk;
        let (low, high) = self.range(axis);
        let bound = peak * duration;
        from.x - bound >= low && from.x + bound <= high || self.stops_within(axis, before, from)
    }

    /// Whether the stop from this state is within the travel, or at least not beyond the position before, by
    /// whose rounding the axis may be outside.
    fn stops_within(&self, axis: usize, before: f64, from: ScalarState) -> bool {
        let limits = self.scalar_limits(axis);
        let (sign, from) = mirrored(from);
        let profile = Profile::brake(ScalarState { x: 0.0, ..from }, f64::INFINITY, 0.0, &limits);
        let end = profile.end().x;
        // An axis whose deceleration is more than its speed needs turns back, and then stops behind.
        let below = from.a * from.a - 2.0 * limits.jerk * from.v;
        let ahead = if from.a < 0.0 && below > 0.0 {
            let turn_s = (-from.a - below.sqrt()) / limits.jerk;
            ScalarState { x: 0.0, ..from }.after(turn_s, limits.jerk).x
        } else {
            end
        };
        let (low, high) = self.range(axis);
        let [ahead, behind] = [ahead, end.min(0.0)].map(|distance| from.x + sign * distance);
        ahead.max(behind) <= high.max(before) && ahead.min(behind) >= low.min(before)
    }

    /// One period of the stop from this state.
    fn stop(&self, axis: usize, from: ScalarState, period_s: f64) -> (ScalarState, f64) {
        let (sign, state) = mirrored(from);
        let at_zero = ScalarState { x: 0.0, ..state };
        let profile = Profile::brake(at_zero, f64::INFINITY, 0.0, &self.scalar_limits(axis));
        let (now, jerk) = profile.at(period_s);
        let state = ScalarState {
            x: from.x + sign * now.x,
            v: sign * now.v,
            a: sign * now.a,
        };
        (state, sign * jerk)
    }
}

/// Jerk that corrects errors of position, velocity and acceleration at a rate, with three equal poles.
fn correction(errors: &[f64; 3], rate: f64) -> f64 {
    rate * (3.0 * errors[2] + rate * (3.0 * errors[1] + rate * errors[0]))
}

/// The rate at which errors are corrected: the usual one, or a lower one where that would need more than this
/// jerk. With the jerk merely truncated the axis would swing about its course more and more, because it would
/// approach the course faster than it can stop there. So every lower rate keeps within the jerk, too.
fn rate_for(errors: &[f64; 3], usual: f64, jerk: f64) -> f64 {
    if correction(errors, usual).abs() <= jerk {
        return usual;
    }
    let mut rate = usual / RATE_STEP.powi(RATES);
    for _ in 0..RATES {
        let next = rate * RATE_STEP;
        if correction(errors, next).abs() > jerk {
            break;
        }
        rate = next;
    }
    rate
}

/// The state with the velocity forwards, and its direction. The position is not mirrored.
fn mirrored(from: ScalarState) -> (f64, ScalarState) {
    let sign = if from.v < 0.0 { -1.0 } else { 1.0 };
    let state = ScalarState {
        x: from.x,
        v: sign * from.v,
        a: sign * from.a,
    };
    (sign, state)
}

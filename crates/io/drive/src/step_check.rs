//! Whether the axes can get from one setpoint to the next.

use evolvent_wire::flags;

use crate::follower_settings::FollowerSettings;
use crate::phase::MAX_CORRECTION_RATIO;
use crate::point::Point;

/// Factor by which a setpoint may exceed the velocity of an axis: rounding, and the guard's tolerance of a
/// thousandth.
const TOLERATED: f64 = 1.1;
/// The same for its acceleration: following a spindle, and corrections of the axes, add some percent; nothing
/// doubles it.
pub(crate) const TOLERATED_ACCELERATION: f64 = 2.0;
/// Number of periods by which the due times of setpoints in motion may be farther apart than their sequence
/// numbers: the core changes its period by at most a thousandth.
const TOLERATED_DELAY: f64 = 0.5;
/// Rounding of two due times together, s.
const CLOCK_ROUNDING_S: f64 = 2e-9;
/// Rounding of a position, as a fraction of it, as in the core's guard.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// Checks each setpoint against the last one that was accepted.
///
/// With the acceleration `a` of an axis at most `A`, over the time `h` from one setpoint to the next,
/// `p1 - p0 - h (v0 + v1) / 2` is the integral of `(h/2 - t) a(t)`, and so at most `A h^2 / 4` in magnitude;
/// `v1 - v0` is at most `A h`. This holds for every motion within the limits, however many setpoints are
/// missing in between.
///
/// The bound grows with time, so that a persistent jump would be within it after some periods. Setpoints that
/// continue a rejected one are therefore rejected too. After the second setpoint in a row that cannot be
/// reached, all are rejected until following begins again. A single wild setpoint counts as missing.
#[derive(Clone, Debug, Default)]
pub(crate) struct StepCheck {
    /// The setpoint since the last accepted one that the axes cannot reach.
    unreached: Option<Point>,
    is_jumping: bool,
}

impl StepCheck {
    /// Resets the check when following begins or ends.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Whether no setpoint since the last accepted one was out of reach.
    pub(crate) const fn is_clear(&self) -> bool {
        self.unreached.is_none()
    }

    /// Whether `to` can be followed after `from`, which is followed, and has the same datum. Real-time safe.
    pub(crate) fn accepts(&mut self, settings: &FollowerSettings, from: &Point, to: &Point) -> bool {
        if self.is_jumping || !is_possible(settings, to) || !is_timely(settings, from, to) {
            return false;
        }
        let is_reached = reaches(settings, from, to);
        match &self.unreached {
            // A repetition.
            Some(unreached) if to.sequence <= unreached.sequence => return is_reached,
            Some(unreached) if !is_reached || reaches(settings, unreached, to) => {
                self.is_jumping = true;
                return false;
            }
            None if !is_reached => {
                self.unreached = Some(*to);
                return false;
            }
            _ => {}
        }
        self.unreached = None;
        true
    }
}

/// Whether the axes can have the velocity and acceleration of a setpoint.
fn is_possible(settings: &FollowerSettings, point: &Point) -> bool {
    settings.axes.axes().all(|axis| {
        point.velocity[axis].abs() <= TOLERATED * settings.max_velocity[axis]
            && point.acceleration[axis].abs() <= TOLERATED_ACCELERATION * settings.max_acceleration[axis]
    })
}

/// The time from one setpoint to the next by their sequence numbers, plus the tolerance, s.
fn longest_s(settings: &FollowerSettings, from: &Point, to: &Point) -> f64 {
    let periods = (to.sequence - from.sequence) as f64;
    (periods + TOLERATED_DELAY) * settings.period_ns as f64 * 1e-9
}

fn interval_s(from: &Point, to: &Point) -> f64 {
    to.due_ns.saturating_sub(from.due_ns) as f64 * 1e-9
}

/// Whether the due times match the sequence numbers. At rest the core may pause.
fn is_timely(settings: &FollowerSettings, from: &Point, to: &Point) -> bool {
    interval_s(from, to) <= longest_s(settings, from, to) || (from.stands() && to.stands())
}

/// Whether every axis can get from one setpoint to a later one within the tolerated limits.
fn reaches(settings: &FollowerSettings, from: &Point, to: &Point) -> bool {
    let h = interval_s(from, to).min(longest_s(settings, from, to));
    settings.axes.axes().all(|axis| {
        let [p0, p1] = [from.position[axis], to.position[axis]];
        let [v0, v1] = [from.velocity[axis], to.velocity[axis]];
        let rounding = ROUNDING * p0.abs().max(p1.abs()).max(1.0);
        let step = p1 - p0;
        // The core's guard stops an axis at the end of its travel at once, at its position.
        if to.flags & flags::GUARD != 0 && v1 == 0.0 && step.abs() <= rounding {
            return true;
        }
        let hardest = TOLERATED_ACCELERATION * settings.max_acceleration[axis];
        // The core computes with its nominal period, and changes the due times to follow the clock of the
        // drives.
        let clock = v0.abs().max(v1.abs()) * (MAX_CORRECTION_RATIO * h + CLOCK_ROUNDING_S);
        let bend = (step - 0.5 * h * (v0 + v1)).abs();
        step.abs() <= TOLERATED * settings.max_velocity[axis] * h
            && bend <= 0.25 * hardest * h * h + clock + rounding
            && (v1 - v0).abs() <= hardest * h + rounding
    })
}

//! A setpoint that a bridge keeps until it is due, and the motion after it.

use evolvent_path::AxisMask;
use evolvent_wire::{AXES, Setpoint};

use crate::brake::BrakeState;
use crate::index_latch::IndexRequest;
use crate::power::PowerRequest;

/// A received setpoint.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Point {
    pub(crate) sequence: u64,
    pub(crate) due_ns: u64,
    pub(crate) position: [f64; AXES],
    pub(crate) velocity: [f64; AXES],
    pub(crate) acceleration: [f64; AXES],
    pub(crate) flags: u32,
    pub(crate) power: PowerRequest,
    pub(crate) fault_reset: u32,
    pub(crate) datum: u64,
    pub(crate) index: IndexRequest,
}

impl Point {
    /// Reads a setpoint of the bus; axes without a drive are 0.
    pub(crate) fn of(setpoint: &Setpoint, axes: AxisMask) -> Self {
        let mut point = Self {
            sequence: setpoint.sequence,
            due_ns: setpoint.due_time_ns,
            position: setpoint.position,
            velocity: setpoint.velocity,
            acceleration: setpoint.acceleration,
            flags: setpoint.flags,
            power: PowerRequest::from_number(setpoint.power_request),
            fault_reset: setpoint.fault_reset,
            datum: setpoint.datum,
            index: IndexRequest {
                number: setpoint.index_request,
                axis: setpoint.index_axis as usize,
            },
        };
        for axis in AxisMask::ALL.without(axes).axes() {
            (
                point.position[axis],
                point.velocity[axis],
                point.acceleration[axis],
            ) = (0.0, 0.0, 0.0);
        }
        point
    }

    pub(crate) fn stands(&self) -> bool {
        self.velocity.iter().all(|velocity| velocity.abs() <= 1e-9)
    }

    /// The motion that continues after a setpoint: the acceleration is reduced to zero with full jerk. A
    /// motion within its limits could do so at any moment, so this neither exceeds a velocity nor reverses.
    pub(crate) fn onward(&self, axis: usize, max_jerk: f64, time_s: f64) -> BrakeState {
        let (position, velocity, acceleration) =
            (self.position[axis], self.velocity[axis], self.acceleration[axis]);
        let fading_s = if max_jerk > 0.0 {
            acceleration.abs() / max_jerk
        } else {
            0.0
        };
        let jerk = -max_jerk.copysign(acceleration);
        let t = time_s.min(fading_s);
        let faded = BrakeState {
            position: position + t * (velocity + t * (0.5 * acceleration + t * jerk / 6.0)),
            velocity: velocity + t * (acceleration + 0.5 * t * jerk),
            acceleration: if time_s < fading_s {
                acceleration + t * jerk
            } else {
                0.0
            },
        };
        BrakeState {
            position: faded.position + (time_s - t) * faded.velocity,
            ..faded
        }
    }

    /// Between this setpoint and the next: the quintic with position, velocity and acceleration of both.
    pub(crate) fn between(&self, next: &Self, axis: usize, time_s: f64, interval_s: f64) -> BrakeState {
        let h = interval_s;
        let u = (time_s / h).clamp(0.0, 1.0);
        let (p0, v0, a0) = (
            self.position[axis],
            self.velocity[axis] * h,
            self.acceleration[axis] * h * h,
        );
        let (p1, v1, a1) = (
            next.position[axis],
            next.velocity[axis] * h,
            next.acceleration[axis] * h * h,
        );
        // Remainders at u = 1 for the three highest coefficients.
        let dp = p1 - p0 - v0 - 0.5 * a0;
        let dv = v1 - v0 - a0;
        let da = a1 - a0;
        let c3 = 10.0 * dp - 4.0 * dv + 0.5 * da;
        let c4 = -15.0 * dp + 7.0 * dv - da;
        let c5 = 6.0 * dp - 3.0 * dv + 0.5 * da;
        BrakeState {
            position: p0 + u * (v0 + u * (0.5 * a0 + u * (c3 + u * (c4 + u * c5)))),
            velocity: (v0 + u * (a0 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / h,
            acceleration: (a0 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))) / (h * h),
        }
    }
}

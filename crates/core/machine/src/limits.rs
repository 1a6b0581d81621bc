//! The limits of all nine axes as vectors.

use evolvent_path::{AXES, Axes};

use crate::machine::Axis;

/// The limits of all nine axes in the order X Y Z A B C U V W, in mm or degrees and seconds.
///
/// For an absent axis `present` is false and all limits are zero. `Copy`, so that the cycle has its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// The axes of the machine.
    pub present: [bool; AXES],
    /// Maximum velocity, mm/s or degrees/s.
    pub velocity: Axes,
    /// Maximum acceleration, mm/s2 or degrees/s2.
    pub acceleration: Axes,
    /// Maximum jerk, mm/s3 or degrees/s3.
    pub jerk: Axes,
    /// Minimum position, mm or degrees.
    pub travel_min: Axes,
    /// Maximum position, mm or degrees.
    pub travel_max: Axes,
    /// Position after homing, mm or degrees.
    pub home: Axes,
}

impl Limits {
    pub(crate) fn of(axes: &[Axis]) -> Self {
        let mut limits = Self {
            present: [false; AXES],
            velocity: Axes::zeros(),
            acceleration: Axes::zeros(),
            jerk: Axes::zeros(),
            travel_min: Axes::zeros(),
            travel_max: Axes::zeros(),
            home: Axes::zeros(),
        };
        for axis in axes {
            let i = axis.letter.index();
            limits.present[i] = true;
            limits.velocity[i] = axis.max_velocity;
            limits.acceleration[i] = axis.max_acceleration;
            limits.jerk[i] = axis.max_jerk;
            limits.travel_min[i] = axis.travel_min;
            limits.travel_max[i] = axis.travel_max;
            limits.home[i] = axis.home;
        }
        limits
    }
}

//! Limits of all nine axes as vectors.

use evolvent_path::{AXES, Axes};

use crate::machine::Axis;

/// Limits of all nine axes in the order X Y Z A B C U V W, in mm or degrees and seconds.
///
/// An axis that the machine has not has `present == false` and zeros everywhere. `Copy`, so that the cycle owns its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Which axes the machine has.
    pub present: [bool; AXES],
    /// Largest velocity, mm/s or degrees/s.
    pub velocity: Axes,
    /// Largest acceleration, mm/s2 or degrees/s2.
    pub acceleration: Axes,
    /// Largest jerk, mm/s3 or degrees/s3.
    pub jerk: Axes,
    /// Lowest position, mm or degrees.
    pub travel_min: Axes,
    /// Highest position, mm or degrees.
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

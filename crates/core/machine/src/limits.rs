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

    /// The velocity of a path parameter at which the first axis reaches its limit, for the first derivatives
    /// of the axes by the parameter; infinite where no axis moves.
    ///
    /// ```
    /// use evolvent_path::Axes;
    ///
    /// let machine = evolvent_machine::Machine::load("../../../config/machines/mill-3axis.toml".as_ref())?;
    /// let limits = machine.limits();
    /// let mut diagonal = Axes::zeros();
    /// (diagonal[0], diagonal[1]) = (0.6, 0.8);
    /// assert_eq!(limits.velocity_along(&diagonal), limits.velocity[1] / 0.8);
    /// # Ok::<(), evolvent_machine::MachineError>(())
    /// ```
    #[must_use]
    pub fn velocity_along(&self, first: &Axes) -> f64 {
        self.along(&self.velocity, first)
    }

    /// The same for the acceleration along a straight line, which is less on a curve.
    #[must_use]
    pub fn acceleration_along(&self, first: &Axes) -> f64 {
        self.along(&self.acceleration, first)
    }

    /// The same for the jerk along a straight line.
    #[must_use]
    pub fn jerk_along(&self, first: &Axes) -> f64 {
        self.along(&self.jerk, first)
    }

    fn along(&self, limit: &Axes, first: &Axes) -> f64 {
        (0..AXES)
            .filter(|&i| self.present[i])
            .map(|i| limit[i] / first[i].abs())
            .fold(f64::INFINITY, f64::min)
    }
}

//! The control rate that a plan requires.

use std::fmt::{self, Display, Formatter};

use evolvent_machine::{Machine, rate_for};
use evolvent_motion::Setpoint;
use serde::Serialize;

use crate::limiting::bend;

/// The control rate that the plan of a program requires: equation (4) with the planned feed and the actual
/// curvature.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct NeededRate {
    /// The rate that keeps the permitted chord error along this plan.
    pub needed_rate_hz: f64,
    /// Program line that requires it.
    pub needed_at_line: u32,
    /// Radius of curvature there; 0 on straight paths.
    pub needed_at_radius_mm: f64,
    /// Feed there.
    pub needed_at_feed_mm_min: f64,
}

impl NeededRate {
    /// Takes the next setpoint of a plan.
    pub fn see(&mut self, setpoint: &Setpoint, machine: &Machine) {
        let (speed, curvature) = bend(setpoint);
        if curvature <= 0.0 {
            return;
        }
        let radius = 1.0 / curvature;
        let rate = rate_for(
            speed,
            radius,
            machine.increments_per_mm,
            machine.path.chord_error_increments,
        );
        if rate > self.needed_rate_hz && rate.is_finite() {
            *self = Self {
                needed_rate_hz: rate,
                needed_at_line: setpoint.line,
                needed_at_radius_mm: radius,
                needed_at_feed_mm_min: 60.0 * speed,
            };
        }
    }
}

impl Display for NeededRate {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        if self.needed_rate_hz <= 0.0 {
            return write!(f, "any control rate is sufficient: this program has no curves");
        }
        write!(
            f,
            "this plan needs a control rate of {:.2} Hz: line {}, radius {:.4} mm at {:.1} mm/min",
            self.needed_rate_hz, self.needed_at_line, self.needed_at_radius_mm, self.needed_at_feed_mm_min
        )
    }
}

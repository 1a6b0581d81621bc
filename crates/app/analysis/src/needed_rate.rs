//! The control rate that a plan requires.

use std::fmt::{self, Display, Formatter};

use evolvent_machine::{Machine, rate_for};
use evolvent_motion::Setpoint;
use serde::Serialize;

use crate::limiting::bend;

/// Lower rates are not reported, Hz. The curvature of a slanted line is the rounding error of its setpoints,
/// eps a / v^2, which would require sqrt(eps a / (8 e)): 1e-4 Hz at an acceleration of 100 m/s2 and a chord
/// error of 1 um. A machine runs at 250 Hz or more.
const MIN_RATE_HZ: f64 = 0.01;

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
        if rate > self.needed_rate_hz.max(MIN_RATE_HZ) && rate.is_finite() {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limiting::tests::{mill, moving};

    #[test]
    fn a_slanted_line_needs_no_rate_and_a_curve_does() {
        let machine = mill();
        let seen = |acceleration: [f64; 3]| {
            let setpoint = moving([46.1, 18.4, 6.5], acceleration, [0.0; 3]);
            let mut needed = NeededRate::default();
            needed.see(&setpoint, &machine);
            needed
        };
        // Along the path, except for the last bits.
        let line = seen([461.0, 184.0 + 3e-14, 65.0]);
        assert_eq!(line, NeededRate::default());
        assert!(line.to_string().contains("no curves"));
        let curve = seen([0.0, 100.0, 0.0]);
        assert!(
            curve.needed_rate_hz > 10.0 && curve.needed_at_line == 1,
            "{curve}"
        );
    }
}

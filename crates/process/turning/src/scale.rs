//! The reading of a sensor as a function of the cutting force: a force, a torque, a power or a current, and
//! its value in air.

use evolvent_machine::LoadSample;

/// Converts the cutting force to a sensor's reading and back: `reading = idle + per_n force`. For a sensor in
/// the spindle's drive `per_n` is proportional to the diameter that is cut.
///
/// ```
/// use evolvent_turning::{Lever, LoadScale};
/// // 2000 N at a diameter of 60 mm are 60 N m; 4 N m turn the spindle in air.
/// let torque = LoadScale { idle: 4.0, per_n: 0.5e-3, lever: Lever::Longitudinal { diameter_mm: 60.0 } };
/// assert_eq!(torque.reading(2000.0, [0.0, 0.0], 0.0), 64.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadScale {
    /// Reading in air at the speed of the job, in the sensor's unit.
    pub idle: f64,
    /// Reading per 1 N above the idle one; with a lever, per 1 N at a diameter of 1 mm.
    pub per_n: f64,
    /// Diameter at which the force acts.
    pub lever: Lever,
}

/// The diameter at which the cutting force acts on the spindle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lever {
    /// None: a sensor at the tool shows the force at any diameter.
    None,
    /// The diameter at the tip or farther outwards.
    Longitudinal {
        /// Diameter of the final size, mm.
        diameter_mm: f64,
    },
    /// Towards the axis. The edge leads, so the force acts nearer to the axis than the tip.
    Facing {
        /// Diameter at which the tool enters, mm.
        diameter_mm: f64,
        /// Lead of the edge per mm of depth: the cotangent of the lead angle.
        lead_per_depth: f64,
        /// The deepest cut that is taken, mm.
        depth_max_mm: f64,
    },
}

impl Lever {
    /// Diameter at which the force acts for a tip at a position (along the cut and above the final size, mm)
    /// and a depth, mm; 1 without a lever.
    fn at_mm(&self, [along_mm, out_mm]: [f64; 2], depth_mm: f64) -> f64 {
        match *self {
            Self::None => 1.0,
            Self::Longitudinal { diameter_mm } => diameter_mm + 2.0 * (out_mm + 0.5 * depth_mm).max(0.0),
            Self::Facing {
                diameter_mm,
                lead_per_depth,
                ..
            } => {
                let lever_position = along_mm.max(0.0) + 0.5 * depth_mm * lead_per_depth;
                (diameter_mm - 2.0 * lever_position).max(MIN_LEVER_FRACTION * diameter_mm)
            }
        }
    }

    /// Minimum diameter at which a force may act for an unknown depth, mm.
    fn min_mm(&self, position_mm: [f64; 2]) -> f64 {
        match *self {
            Self::Facing { depth_max_mm, .. } => self.at_mm(position_mm, depth_max_mm),
            _ => self.at_mm(position_mm, 0.0),
        }
    }
}

/// Minimum fraction of the outer diameter for facing with a sensor in the spindle's drive. Nearer to the axis
/// its noise and idle reading hide the force.
pub(crate) const MIN_LEVER_FRACTION: f64 = 0.2;

impl LoadScale {
    /// A sensor of the force itself, in N.
    pub const FORCE: Self = Self {
        idle: 0.0,
        per_n: 1.0,
        lever: Lever::None,
    };

    /// Reading for a force in N, in the middle of a cut `depth_mm` deep with the tip at a position: mm along
    /// the cut, and mm above the final size.
    #[must_use]
    pub fn reading(&self, force_n: f64, position_mm: [f64; 2], depth_mm: f64) -> f64 {
        self.idle + self.per_n * self.lever.at_mm(position_mm, depth_mm) * force_n
    }

    /// The force in N of a reading, and the force at the end of the sensor's range. The depth is unknown, so
    /// the smallest possible diameter is used: the force is never underestimated. Real-time safe.
    #[must_use]
    pub fn force(&self, sample: LoadSample, position_mm: [f64; 2]) -> LoadSample {
        let per_n = self.per_n * self.lever.min_mm(position_mm);
        LoadSample {
            value: (sample.value - self.idle) / per_n,
            range_max: (sample.range_max - self.idle) / per_n,
            ..sample
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torque_power_and_current_tell_the_force() {
        // 2000 N at a diameter of 60 mm and 500 rev/min: 60 N m, 3141.6 W.
        let torque = LoadScale {
            idle: 4.0,
            per_n: 0.5e-3,
            lever: Lever::Longitudinal { diameter_mm: 60.0 },
        };
        assert!((torque.reading(2000.0, [0.0, 0.0], 0.0) - 64.0).abs() < 1e-12);
        let power = LoadScale {
            idle: 800.0,
            per_n: std::f64::consts::PI * 500.0 / 60_000.0,
            lever: Lever::Longitudinal { diameter_mm: 60.0 },
        };
        assert!(
            (power.reading(2000.0, [0.0, 0.0], 0.0) - (800.0 + 1000.0 * std::f64::consts::PI)).abs() < 1e-9
        );
        for scale in [LoadScale::FORCE, torque, power] {
            for (out, depth) in [(0.0, 0.0), (3.0, 0.0), (1.0, 4.0)] {
                let value = scale.reading(1500.0, [0.0, out], depth);
                let sample = LoadSample {
                    sequence: 1,
                    value,
                    range_max: 1e6,
                };
                let force = scale.force(sample, [0.0, out]).value;
                // The unknown depth may only raise the force.
                let max = 1500.0 * (1.0 + depth / 60.0) + 1e-9;
                assert!(force >= 1500.0 - 1e-9 && force <= max, "{force} by {scale:?}");
            }
            // In air.
            let air = LoadSample {
                sequence: 2,
                value: scale.idle,
                range_max: 1e6,
            };
            assert_eq!(scale.force(air, [0.0, 2.0]).value, 0.0);
        }
    }
}

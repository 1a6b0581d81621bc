//! What a sensor shows of the cutting force: a force, a torque, a power or a current, and what it shows in
//! air.

use evolvent_machine::LoadSample;

/// From the cutting force to a sensor's reading and back: `reading = idle + per_n force`, with `per_n` in
/// proportion to the diameter that is cut where the sensor is in the spindle's drive.
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
    /// Reading for 1 N beyond the idle one; of 1 N at a diameter of 1 mm where there is a lever.
    pub per_n: f64,
    /// At which diameter the force acts.
    pub lever: Lever,
}

/// The diameter at which the cutting force acts on the spindle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lever {
    /// None: a sensor at the tool shows the force at any diameter.
    None,
    /// The diameter at the tip or farther out.
    Longitudinal {
        /// Diameter of the final size, mm.
        diameter_mm: f64,
    },
    /// Towards the axis. The edge leads, so the force acts farther in than the tip.
    Facing {
        /// Diameter at which the tool comes in, mm.
        diameter_mm: f64,
        /// How far the edge leads per mm of depth: the cotangent of the lead angle.
        lead_per_depth: f64,
        /// The deepest cut that is taken, mm.
        depth_max_mm: f64,
    },
}

impl Lever {
    /// Diameter at which the force acts for a tip at a place (along the cut and above the final size, mm) and
    /// a depth, mm; 1 without a lever.
    fn at_mm(&self, [along_mm, out_mm]: [f64; 2], depth_mm: f64) -> f64 {
        match *self {
            Self::None => 1.0,
            Self::Longitudinal { diameter_mm } => diameter_mm + 2.0 * (out_mm + 0.5 * depth_mm).max(0.0),
            Self::Facing {
                diameter_mm,
                lead_per_depth,
                ..
            } => {
                let place = along_mm.max(0.0) + 0.5 * depth_mm * lead_per_depth;
                (diameter_mm - 2.0 * place).max(MIN_LEVER_FRACTION * diameter_mm)
            }
        }
    }

    /// The smallest diameter at which a force may act, mm: of a depth that is not known.
    fn least_mm(&self, place_mm: [f64; 2]) -> f64 {
        match *self {
            Self::Facing { depth_max_mm, .. } => self.at_mm(place_mm, depth_max_mm),
            _ => self.at_mm(place_mm, 0.0),
        }
    }
}

/// Fraction of the outer diameter to which facing may go by a sensor in the spindle's drive: farther in it
/// shows so little of the force that its noise and idle reading hide it.
pub(crate) const MIN_LEVER_FRACTION: f64 = 0.2;

impl LoadScale {
    /// A sensor that shows the force itself, in N.
    pub const FORCE: Self = Self {
        idle: 0.0,
        per_n: 1.0,
        lever: Lever::None,
    };

    /// What the sensor shows of a force in N, in the middle of a cut `depth_mm` deep whose tip is at a place:
    /// mm along the cut, and mm above the final size.
    #[must_use]
    pub fn reading(&self, force_n: f64, place_mm: [f64; 2], depth_mm: f64) -> f64 {
        self.idle + self.per_n * self.lever.at_mm(place_mm, depth_mm) * force_n
    }

    /// The force in N that a reading tells of, and the force at the end of the sensor's range. The depth is
    /// not known, so the force is taken to act at the smallest diameter that it may act at: it is never
    /// reckoned too small. Real-time safe.
    #[must_use]
    pub fn force(&self, sample: LoadSample, place_mm: [f64; 2]) -> LoadSample {
        let per_n = self.per_n * self.lever.least_mm(place_mm);
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
                // By the depth too high at most.
                let most = 1500.0 * (1.0 + depth / 60.0) + 1e-9;
                assert!(force >= 1500.0 - 1e-9 && force <= most, "{force} by {scale:?}");
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

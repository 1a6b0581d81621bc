//! What a sensor shows of the cutting force: a force, a torque, a power or a current, and what it shows in air.

use crate::sensor::LoadSample;

/// From the cutting force to a sensor's reading and back: `reading = idle + per_n force`, with `per_n` in proportion to
/// the diameter that is cut where the sensor is in the spindle's drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadScale {
    /// Reading in air at the speed of the job, in the sensor's unit.
    pub idle: f64,
    /// Reading for 1 N beyond the idle one; of 1 N at a diameter of 1 mm where `diameter_mm` is given.
    pub per_n: f64,
    /// Diameter of the final size in mm; none for a sensor at the tool, which shows the force at any diameter.
    pub diameter_mm: Option<f64>,
}

impl LoadScale {
    /// A sensor that shows the force itself, in N.
    pub const FORCE: Self = Self {
        idle: 0.0,
        per_n: 1.0,
        diameter_mm: None,
    };

    fn per_n_at(&self, height_mm: f64) -> f64 {
        let lever = self
            .diameter_mm
            .map_or(1.0, |diameter| diameter + 2.0 * height_mm.max(0.0));
        self.per_n * lever
    }

    /// What the sensor shows of a force in N, in the middle of a cut `depth_mm` deep whose tip is `out_mm` above the final
    /// size.
    #[must_use]
    pub fn reading(&self, force_n: f64, out_mm: f64, depth_mm: f64) -> f64 {
        self.idle + self.per_n_at(out_mm + 0.5 * depth_mm) * force_n
    }

    /// The force in N that a reading tells of, and the force at the end of the sensor's range. The depth is not known, so
    /// the force is taken to act at the tip: it is never reckoned too small. Real-time safe.
    #[must_use]
    pub fn force(&self, sample: LoadSample, out_mm: f64) -> LoadSample {
        let per_n = self.per_n_at(out_mm);
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
            diameter_mm: Some(60.0),
        };
        assert!((torque.reading(2000.0, 0.0, 0.0) - 64.0).abs() < 1e-12);
        let power = LoadScale {
            idle: 800.0,
            per_n: std::f64::consts::PI * 500.0 / 60_000.0,
            diameter_mm: Some(60.0),
        };
        assert!((power.reading(2000.0, 0.0, 0.0) - (800.0 + 1000.0 * std::f64::consts::PI)).abs() < 1e-9);
        for scale in [LoadScale::FORCE, torque, power] {
            for (out, depth) in [(0.0, 0.0), (3.0, 0.0), (1.0, 4.0)] {
                let value = scale.reading(1500.0, out, depth);
                let sample = LoadSample {
                    sequence: 1,
                    value,
                    range_max: 1e6,
                };
                let force = scale.force(sample, out).value;
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
            assert_eq!(scale.force(air, 2.0).value, 0.0);
        }
    }
}

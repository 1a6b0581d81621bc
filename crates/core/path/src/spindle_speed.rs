//! The spindle speed that a program commands: constant, or a constant surface speed.

use std::f64::consts::TAU;

/// Maximum spindle speed, rpm: at the centre a constant surface speed would need an infinite one.
const MAX_RPM: f64 = 1e6;

/// A commanded spindle speed.
///
/// ```
/// use evolvent_path::{SpindleSpeed, SurfaceSpeed};
///
/// let surface = SurfaceSpeed { speed_m_min: 200.0, max_rpm: 3000.0, centre_mm: -5.0 };
/// let speed = SpindleSpeed::Surface(surface);
/// // 25 mm from the centre: 1000 * 200 / (2 pi * 25) rpm.
/// assert!((speed.rpm_at(20.0) - 1273.239_544_735).abs() < 1e-9);
/// // Near the centre the maximum applies.
/// assert_eq!(speed.rpm_at(-5.0), 3000.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpindleSpeed {
    /// The same speed everywhere (G97).
    Constant {
        /// Not negative.
        rpm: f64,
    },
    /// A constant surface speed (G96).
    Surface(SurfaceSpeed),
}

/// A constant surface speed (G96): the spindle speed is inversely proportional to the distance from the
/// centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceSpeed {
    /// Surface speed, m/min, not negative.
    pub speed_m_min: f64,
    /// Maximum spindle speed, rpm; infinite without a limit.
    pub max_rpm: f64,
    /// X of the spindle's centre in machine coordinates, mm: where the program's X is 0.
    pub centre_mm: f64,
}

impl SpindleSpeed {
    /// The speed in rpm with the tool at X in machine coordinates, mm. Finite, not negative. Real-time safe.
    #[must_use]
    pub fn rpm_at(&self, x_mm: f64) -> f64 {
        self.overridden_rpm_at(x_mm, 1.0, MAX_RPM)
    }

    /// The same with an override (`ratio`, 1 at 100 %) and at most `max_rpm` of the spindle. No override
    /// exceeds the maximum of a surface speed, which is that of the chuck. Real-time safe.
    #[must_use]
    pub fn overridden_rpm_at(&self, x_mm: f64, ratio: f64, max_rpm: f64) -> f64 {
        let rpm = match self {
            Self::Constant { rpm } => ratio * rpm,
            Self::Surface(surface) => surface.rpm_at(x_mm, ratio),
        };
        rpm.min(max_rpm).clamp(0.0, MAX_RPM)
    }

    /// The maximum of a surface speed, rpm: nearer to the centre the speed is constant. Infinite for a
    /// constant speed.
    #[must_use]
    pub fn max_rpm(&self) -> f64 {
        match self {
            Self::Constant { .. } => f64::INFINITY,
            Self::Surface(surface) => surface.max_rpm.min(MAX_RPM),
        }
    }

    /// Minimum and maximum speed in rpm between two X in machine coordinates, mm, the smaller X first.
    /// Real-time safe.
    #[must_use]
    pub fn range_rpm(&self, x_mm: (f64, f64)) -> (f64, f64) {
        let ends = (self.rpm_at(x_mm.0), self.rpm_at(x_mm.1));
        let (slow, fast) = (ends.0.min(ends.1), ends.0.max(ends.1));
        match self {
            Self::Surface(surface) if x_mm.0 < surface.centre_mm && surface.centre_mm < x_mm.1 => {
                (slow, self.rpm_at(surface.centre_mm))
            }
            _ => (slow, fast),
        }
    }
}

impl SurfaceSpeed {
    fn rpm_at(&self, x_mm: f64, ratio: f64) -> f64 {
        let radius_mm = (x_mm - self.centre_mm).abs();
        let speed_m_min = ratio * self.speed_m_min;
        if speed_m_min <= 0.0 {
            // At the centre too.
            return 0.0;
        }
        (1000.0 * speed_m_min / (TAU * radius_mm)).min(self.max_rpm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surface(max_rpm: f64) -> SpindleSpeed {
        SpindleSpeed::Surface(SurfaceSpeed {
            speed_m_min: 100.0,
            max_rpm,
            centre_mm: 2.0,
        })
    }

    #[test]
    fn surface_speed_holds_on_both_sides_up_to_the_limit() {
        for radius_mm in [0.5, 7.0, 123.0] {
            for x_mm in [2.0 - radius_mm, 2.0 + radius_mm] {
                let rpm = surface(f64::INFINITY).rpm_at(x_mm);
                let metres_per_minute = rpm * TAU * radius_mm / 1000.0;
                assert!((metres_per_minute - 100.0).abs() < 1e-9, "{metres_per_minute}");
            }
        }
        assert_eq!(surface(1500.0).rpm_at(2.0), 1500.0);
        assert_eq!(surface(f64::INFINITY).rpm_at(2.0), MAX_RPM);
        let still = SurfaceSpeed {
            speed_m_min: 0.0,
            max_rpm: 1500.0,
            centre_mm: 2.0,
        };
        assert_eq!(SpindleSpeed::Surface(still).rpm_at(2.0), 0.0);
    }

    #[test]
    fn override_scales_surface_speed_up_to_maximum() {
        let free = surface(f64::INFINITY).rpm_at(30.0);
        let limited = surface(500.0);
        for ratio in [0.0, 0.3, 0.8, 1.0, 1.5, 2.0] {
            let rpm = limited.overridden_rpm_at(30.0, ratio, 3000.0);
            assert!((rpm - (ratio * free).min(500.0)).abs() < 1e-9, "{rpm} at {ratio}");
            assert_eq!(
                limited.overridden_rpm_at(2.0, ratio, 400.0),
                if ratio > 0.0 { 400.0 } else { 0.0 },
                "{ratio} at the centre"
            );
        }
        let constant = SpindleSpeed::Constant { rpm: 300.0 };
        assert_eq!(constant.overridden_rpm_at(0.0, 1.5, 3000.0), 450.0);
        assert_eq!(constant.overridden_rpm_at(0.0, 1.5, 400.0), 400.0);
    }

    #[test]
    fn a_range_across_the_centre_reaches_the_limit() {
        let speed = surface(1500.0);
        assert_eq!(speed.range_rpm((-30.0, 40.0)), (speed.rpm_at(40.0), 1500.0));
        assert_eq!(
            speed.range_rpm((20.0, 40.0)),
            (speed.rpm_at(40.0), speed.rpm_at(20.0))
        );
    }
}

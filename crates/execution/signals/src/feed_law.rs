//! What the feed refers to: time, or revolutions of the spindle (G95).

use evolvent_path::SpindleSpeed;

/// What the feed of the plan refers to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum FeedLaw {
    /// Time alone.
    #[default]
    Time,
    /// Revolutions of a spindle: the plan assumes this speed, and the feed is scaled by the actual speed over
    /// it.
    Revolution {
        /// The number of the spindle.
        spindle: u32,
        /// The speed that the plan assumes.
        speed: SpindleSpeed,
    },
}

impl FeedLaw {
    /// The spindle to which the feed refers, if any. Real-time safe.
    #[must_use]
    pub const fn spindle(&self) -> Option<u32> {
        match self {
            Self::Time => None,
            Self::Revolution { spindle, .. } => Some(*spindle),
        }
    }

    /// The factor on the feed of the plan with the tool at X in machine coordinates, mm. `measured_rpm` is
    /// the measured speed of the spindle. Without it the commanded speed counts, with the spindle override
    /// and limited to `max_rpm`. Real-time safe.
    #[must_use]
    pub fn ratio(&self, x_mm: f64, measured_rpm: Option<f64>, spindle_override: f64, max_rpm: f64) -> f64 {
        let Self::Revolution { speed, .. } = self else {
            return 1.0;
        };
        let planned = speed.rpm_at(x_mm);
        if planned <= 0.0 {
            return 1.0;
        }
        let turns = measured_rpm.unwrap_or_else(|| speed.overridden_rpm_at(x_mm, spindle_override, max_rpm));
        turns / planned
    }
}

#[cfg(test)]
mod tests {
    use evolvent_path::SurfaceSpeed;

    use super::*;

    fn of_first(speed: SpindleSpeed) -> FeedLaw {
        FeedLaw::Revolution { spindle: 0, speed }
    }

    #[test]
    fn the_feed_is_proportional_to_the_spindle_speed() {
        assert_eq!(FeedLaw::Time.ratio(3.0, Some(0.0), 0.5, 100.0), 1.0);
        let constant = of_first(SpindleSpeed::Constant { rpm: 800.0 });
        assert_eq!(constant.ratio(3.0, Some(600.0), 2.0, 1000.0), 0.75);
        assert_eq!(
            constant.ratio(3.0, Some(0.0), 1.0, 1000.0),
            0.0,
            "it does not turn"
        );
        assert_eq!(constant.ratio(3.0, None, 0.5, 1000.0), 0.5);
        assert_eq!(
            constant.ratio(3.0, None, 2.0, 1000.0),
            1.25,
            "up to its highest speed"
        );
        let surface = of_first(SpindleSpeed::Surface(SurfaceSpeed {
            speed_m_min: std::f64::consts::TAU * 10.0,
            max_rpm: 2000.0,
            centre_mm: 1.0,
        }));
        // 10 000 mm/min of circumference over 10 mm of radius: 1000 rpm.
        assert!((surface.ratio(11.0, Some(900.0), 1.0, 5000.0) - 0.9).abs() < 1e-12);
        let still = of_first(SpindleSpeed::Constant { rpm: 0.0 });
        assert_eq!(still.ratio(3.0, Some(0.0), 1.0, 1000.0), 1.0, "no speed to go by");
    }
}

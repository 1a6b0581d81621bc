//! Values of a job that follow from its settings.

use crate::settings::TurningSettings;
use crate::watch::SMOOTHING_S;

/// Values computed once at set-up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct JobConstants {
    /// Cost of a pass beside its cut, in revolutions.
    pub(crate) overhead_rev: f64,
    /// Depth from which two passes are faster than one, mm.
    pub(crate) split_mm: f64,
    /// Distance that the tool enters the stock before the load shows contact, mm.
    pub(crate) detection_mm: f64,
}

impl JobConstants {
    /// Computes the values of checked settings.
    pub(crate) fn new(settings: &TurningSettings) -> Self {
        let (regime, turn_s) = (&settings.regime, settings.turn_s());
        let overhead_s = settings.length_mm / settings.rapid_mm_s
            + 2.0 * (settings.clear_out_mm + regime.depth_back_off_mm) / settings.out_speed_mm_s
            + 3.0 * settings.clear_along_mm / settings.speed_mm_s(regime.feed_max_mm_rev)
            + turn_s;
        let overhead_rev = overhead_s / turn_s;
        Self {
            overhead_rev,
            split_mm: Self::split_depth(settings, overhead_rev),
            detection_mm: Self::detection(settings),
        }
    }

    /// Distance that the tool enters the stock at the entry feed before the load shows contact, mm. Within
    /// the first revolution the chip is as thick as the distance fed; sensor and smoothing add their lag.
    fn detection(settings: &TurningSettings) -> f64 {
        let feed = settings.strategy.entry_feed_mm_rev;
        let step_mm = settings.speed_mm_s(feed) * settings.period_s;
        let fraction = |lag_s: f64| 1.0 - libm::exp(-settings.period_s / lag_s.max(1e-9));
        let (lag, smoothing) = (fraction(settings.sensor_lag_s), fraction(SMOOTHING_S));
        let (mut distance, mut read, mut smooth) = (0.0, 0.0, 0.0);
        while smooth < settings.contact_load_n && distance < 4.0 * feed {
            distance += step_mm;
            let depth = distance * settings.tool.slope();
            let chip = if distance < feed {
                0.5 * distance
            } else {
                feed * (1.0 - 0.5 * feed / distance)
            };
            read += lag * (settings.regime.law.load(depth, chip) - read);
            smooth += smoothing * (read - smooth);
        }
        distance
    }

    /// The depth from which two passes are faster than one, mm.
    fn split_depth(settings: &TurningSettings, overhead_rev: f64) -> f64 {
        let regime = &settings.regime;
        let (mut low, mut high) = (regime.depth_full_feed_mm, regime.depth_max_mm);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if regime.fastest_passes(middle, settings.length_mm, overhead_rev) > 1 {
                high = middle;
            } else {
                low = middle;
            }
        }
        high
    }
}

//! The core's phase lock: records of one cycle, and totals.

use crate::histogram::Histogram;
use crate::schema::evolvent;

/// The phase lock in a cycle with a new phase error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhaseRecord {
    /// The drives' time minus the due time of the setpoint, ns: positive if the drives run late.
    pub error_ns: i64,
    /// Excess of this computer's clock rate over the drives', as known so far, ppm.
    pub drift_ppm: f64,
    /// Excess of the period over the nominal one, ppm.
    pub correction_ppm: f64,
    /// Whether the lock has had time to determine drift and phase.
    pub is_settled: bool,
}

/// Totals of the phase lock over many cycles. Recording allocates nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PhaseTally {
    magnitudes: Histogram,
    settled: u64,
    sum_ns: f64,
    sum_of_squares: f64,
    drift: Spread,
    correction: Spread,
}

/// Sum, minimum and maximum of some numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Spread {
    sum: f64,
    min: f64,
    max: f64,
}

impl Default for Spread {
    fn default() -> Self {
        Self {
            sum: 0.0,
            min: f64::INFINITY,
            max: f64::NEG_INFINITY,
        }
    }
}

impl Spread {
    fn record(&mut self, value: f64) {
        self.sum += value;
        self.min = self.min.min(value);
        self.max = self.max.max(value);
    }

    fn add(&mut self, other: &Self) {
        self.sum += other.sum;
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
    }
}

/// Results of the phase lock, for summaries.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct PhaseFigures {
    /// Number of phase errors.
    pub errors: u64,
    /// Mean excess of this computer's clock rate over the drives', ppm.
    pub drift_ppm: f64,
    /// Minimum of the drift, ppm.
    pub drift_min_ppm: f64,
    /// Maximum of the drift, ppm.
    pub drift_max_ppm: f64,
    /// Mean phase error, ns: positive if the drives run late.
    pub phase_mean_ns: f64,
    /// Standard deviation of the phase error, ns.
    pub phase_scatter_ns: f64,
    /// Magnitude that half of the phase errors do not exceed, ns, too large by at most a sixteenth.
    pub phase_p50_ns: i64,
    /// The same for 99.9 % of them.
    pub phase_p999_ns: i64,
    /// The largest magnitude.
    pub phase_max_ns: i64,
}

impl PhaseTally {
    /// Counts one cycle.
    pub fn record(&mut self, record: &PhaseRecord) {
        let error_ns = record.error_ns as f64;
        self.magnitudes.record(record.error_ns.saturating_abs());
        self.settled += u64::from(record.is_settled);
        self.sum_ns += error_ns;
        self.sum_of_squares += error_ns * error_ns;
        self.drift.record(record.drift_ppm);
        self.correction.record(record.correction_ppm);
    }

    /// Adds all cycles of another tally.
    pub fn add(&mut self, other: &Self) {
        self.magnitudes.add(&other.magnitudes);
        self.settled += other.settled;
        self.sum_ns += other.sum_ns;
        self.sum_of_squares += other.sum_of_squares;
        self.drift.add(&other.drift);
        self.correction.add(&other.correction);
    }

    /// Removes all counts.
    pub fn clear(&mut self) {
        self.magnitudes.clear();
        self.settled = 0;
        (self.sum_ns, self.sum_of_squares) = (0.0, 0.0);
        (self.drift, self.correction) = (Spread::default(), Spread::default());
    }

    /// The results; `None` without a phase error.
    #[must_use]
    pub fn figures(&self) -> Option<PhaseFigures> {
        let errors = self.magnitudes.count();
        if errors == 0 {
            return None;
        }
        let mean_ns = self.sum_ns / errors as f64;
        let variance = self.sum_of_squares / errors as f64 - mean_ns * mean_ns;
        Some(PhaseFigures {
            errors,
            drift_ppm: self.drift.sum / errors as f64,
            drift_min_ppm: self.drift.min,
            drift_max_ppm: self.drift.max,
            phase_mean_ns: mean_ns,
            phase_scatter_ns: variance.max(0.0).sqrt(),
            phase_p50_ns: self.magnitudes.percentile_ns(50.0),
            phase_p999_ns: self.magnitudes.percentile_ns(99.9),
            phase_max_ns: self.magnitudes.max_ns(),
        })
    }

    pub(crate) fn message(&self) -> Option<evolvent::PhaseLock> {
        let figures = self.figures()?;
        Some(evolvent::PhaseLock {
            errors: figures.errors,
            settled: self.settled,
            mean_ns: figures.phase_mean_ns,
            scatter_ns: figures.phase_scatter_ns,
            magnitude: Some(self.magnitudes.message()),
            drift_ppm: figures.drift_ppm,
            correction_min_ppm: self.correction.min,
            correction_max_ppm: self.correction.max,
        })
    }
}

impl PhaseFigures {
    /// The figures by their names.
    pub(crate) fn named(&self) -> [(&'static str, String); 9] {
        let decimals = |value: f64| format!("{value:.3}");
        [
            ("phase_errors", self.errors.to_string()),
            ("clock_drift_ppm", decimals(self.drift_ppm)),
            ("clock_drift_min_ppm", decimals(self.drift_min_ppm)),
            ("clock_drift_max_ppm", decimals(self.drift_max_ppm)),
            ("phase_mean_ns", decimals(self.phase_mean_ns)),
            ("phase_scatter_ns", decimals(self.phase_scatter_ns)),
            ("phase_p50_ns", self.phase_p50_ns.to_string()),
            ("phase_p999_ns", self.phase_p999_ns.to_string()),
            ("phase_max_ns", self.phase_max_ns.to_string()),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(error_ns: i64, drift_ppm: f64) -> PhaseRecord {
        PhaseRecord {
            error_ns,
            drift_ppm,
            correction_ppm: drift_ppm + error_ns as f64,
            is_settled: error_ns > 0,
        }
    }

    /// The deviation of 2, 4, 4, 4, 5, 5, 7, 9 is 2, of the textbooks; here by their differences from 12.
    #[test]
    fn mean_scatter_and_magnitude_are_those_of_the_errors() {
        let errors = [2, 4, 4, 4, 5, 5, 7, 9].map(|ns| ns - 12);
        let (mut whole, mut half, mut rest) = (
            PhaseTally::default(),
            PhaseTally::default(),
            PhaseTally::default(),
        );
        assert!(whole.figures().is_none() && whole.message().is_none());
        for (i, error) in errors.into_iter().enumerate() {
            let record = record(error, i as f64);
            whole.record(&record);
            let part = if i < 3 { &mut half } else { &mut rest };
            part.record(&record);
        }
        half.add(&rest);
        assert_eq!(half, whole);
        let figures = whole.figures().expect("figures");
        assert_eq!((figures.phase_mean_ns, figures.phase_scatter_ns), (-7.0, 2.0));
        assert_eq!((figures.phase_p50_ns, figures.phase_max_ns), (7, 10));
        assert_eq!(
            (figures.drift_min_ppm, figures.drift_ppm, figures.drift_max_ppm),
            (0.0, 3.5, 7.0)
        );
        let message = whole.message().expect("a message");
        assert_eq!((message.errors, message.settled), (8, 0));
        assert_eq!(
            (message.correction_min_ppm, message.correction_max_ppm),
            (-10.0, 4.0)
        );
        whole.clear();
        assert_eq!(whole, PhaseTally::default());
    }
}

//! An offset that comes from outside, made a motion.

use crate::triple_average::TripleAverage;

/// Offsets are counted in millionths of a micrometre.
pub(crate) const UNITS_PER_MM: f64 = 1e9;

/// Follows an offset with a bounded rate, smoothly.
#[derive(Clone, Debug)]
pub(crate) struct ThermalOffset {
    /// Units a period.
    step: i64,
    /// Units.
    most: f64,
    target: i64,
    now: i64,
    average: TripleAverage,
}

impl ThermalOffset {
    pub(crate) fn new(rate: f64, most: f64, period_s: f64, n: usize) -> Self {
        Self {
            step: ((rate * period_s * UNITS_PER_MM) as i64).max(1),
            most: most * UNITS_PER_MM,
            target: 0,
            now: 0,
            average: TripleAverage::new(n, 0),
        }
    }

    /// Limits it; what is no number leaves the one before.
    pub(crate) fn aim(&mut self, offset: f64) {
        if !offset.is_nan() {
            self.target = (offset * UNITS_PER_MM).clamp(-self.most, self.most).round() as i64;
        }
    }

    pub(crate) fn step(&mut self) {
        self.now += (self.target - self.now).clamp(-self.step, self.step);
        self.average.step(self.now);
    }

    /// In mm, by periods.
    pub(crate) fn at(&self) -> [f64; 4] {
        self.average.at().map(|value| value / UNITS_PER_MM)
    }
}

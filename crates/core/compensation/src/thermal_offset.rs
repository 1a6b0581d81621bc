//! Turns an external offset into a smooth motion.

use crate::triple_average::TripleAverage;

/// Offsets are counted in units of 1e-6 um.
pub(crate) const UNITS_PER_MM: f64 = 1e9;

/// Follows an offset smoothly, at a bounded rate.
#[derive(Clone, Debug)]
pub(crate) struct ThermalOffset {
    /// Units per period.
    step: i64,
    /// Maximum magnitude, in units.
    max: f64,
    target: i64,
    now: i64,
    average: TripleAverage,
}

impl ThermalOffset {
    pub(crate) fn new(rate: f64, max: f64, period_s: f64, n: usize) -> Self {
        Self {
            step: ((rate * period_s * UNITS_PER_MM) as i64).max(1),
            max: max * UNITS_PER_MM,
            target: 0,
            now: 0,
            average: TripleAverage::new(n, 0),
        }
    }

    /// Sets the target, clamped to the maximum. NaN keeps the previous target.
    pub(crate) fn aim(&mut self, offset: f64) {
        if !offset.is_nan() {
            self.target = (offset * UNITS_PER_MM).clamp(-self.max, self.max).round() as i64;
        }
    }

    pub(crate) fn step(&mut self) {
        self.now += (self.target - self.now).clamp(-self.step, self.step);
        self.average.step(self.now);
    }

    /// Value and derivatives by periods, mm.
    pub(crate) fn at(&self) -> [f64; 4] {
        self.average.at().map(|value| value / UNITS_PER_MM)
    }
}

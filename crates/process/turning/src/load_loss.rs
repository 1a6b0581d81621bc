//! Lost loads, and interruptions of the cut.

/// Duration of a lost load, and the load before.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LoadLoss {
    /// Time without load in a cut, s.
    pub(crate) air_s: f64,
    /// Time without load where there must be stock, s.
    pub(crate) missing_s: f64,
    /// The load before, N.
    pub(crate) before_n: f64,
    /// Remaining time for which the cut counts as interrupted, s: a load vanished and returned within a
    /// revolution.
    pub(crate) interrupted_s: f64,
    /// Longest distance of such an interruption, mm.
    pub(crate) interruption_mm: f64,
}

impl LoadLoss {
    /// No load is missing; the previous load is kept.
    pub(crate) fn begin(&mut self) {
        *self = Self {
            before_n: self.before_n,
            ..Self::default()
        };
    }
}

//! A load that has gone, and interruptions of the cut.

/// How long a load has been missing, and what was there before.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LoadLoss {
    /// Time without load in a cut, s.
    pub(crate) air_s: f64,
    /// Time without load where stock must stand, s.
    pub(crate) missing_s: f64,
    /// The load before, N.
    pub(crate) before_n: f64,
    /// Time for which the cut counts as interrupted, s: a load has gone and come back within a revolution.
    pub(crate) interrupted_s: f64,
    /// The longest way of such an interruption, mm.
    pub(crate) interruption_mm: f64,
}

impl LoadLoss {
    /// Nothing is missing; what was felt before stays known.
    pub(crate) fn begin(&mut self) {
        *self = Self {
            before_n: self.before_n,
            ..Self::default()
        };
    }
}

//! Inputs of a handwheel in one cycle.

/// Inputs of the handwheel; empty without a handwheel.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct HandwheelView {
    /// `None` while unknown.
    pub counts: Option<f64>,
    /// Bit i: digital input i is known to be on.
    pub digital: u64,
}

impl HandwheelView {
    /// Whether the count is unknown, in which case the wheel counts as not turned.
    pub(crate) fn is_silent(&self) -> bool {
        self.counts.is_none()
    }
}

//! What the inputs of a handwheel say in a cycle.

/// What the inputs of the handwheel say; nothing where there is none.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct HandwheelView {
    /// None while they are not known.
    pub counts: Option<f64>,
    /// Bit i: digital input i is known to be on.
    pub digital: u64,
}

impl HandwheelView {
    /// The wheel is not known, so it is taken as not turned.
    pub(crate) fn is_silent(&self) -> bool {
        self.counts.is_none()
    }
}

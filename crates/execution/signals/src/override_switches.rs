//! Which overrides are enabled (M48 to M53).

use evolvent_machine::MAX_SPINDLES;

/// The overrides and holds of the operator that a program enables, from one moment on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OverrideSwitches {
    /// Feed and rapid override are enabled (M50); otherwise both are 1.
    pub feed: bool,
    /// The spindle override is enabled (M51), by spindle; otherwise it is 1.
    pub spindles: [bool; MAX_SPINDLES as usize],
    /// Adaptive feed is enabled (M52). `None` if the program has not set it: it is then enabled if the job
    /// was started with it.
    pub adaptive: Option<bool>,
    /// A feed hold is enabled (M53); otherwise a hold waits until it is enabled again.
    pub feed_stop: bool,
}

impl Default for OverrideSwitches {
    /// The state at the start of a program: everything is enabled.
    fn default() -> Self {
        Self {
            feed: true,
            spindles: [true; MAX_SPINDLES as usize],
            adaptive: None,
            feed_stop: true,
        }
    }
}

//! Which overrides count (M48 to M53).

use evolvent_machine::MAX_SPINDLES;

/// Which of the operator's overrides and holds a program lets count, from one moment on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OverrideSwitches {
    /// Feed and rapid override count (M50); otherwise both are 1.
    pub feed: bool,
    /// The spindle override counts (M51), by spindle; otherwise it is 1.
    pub spindles: [bool; MAX_SPINDLES as usize],
    /// Adaptive feed counts (M52); none where the program has not said: then it counts where the job was
    /// started with it.
    pub adaptive: Option<bool>,
    /// A feed hold counts (M53); otherwise it waits until it does.
    pub feed_stop: bool,
}

impl Default for OverrideSwitches {
    /// As at the start of a program: all count.
    fn default() -> Self {
        Self {
            feed: true,
            spindles: [true; MAX_SPINDLES as usize],
            adaptive: None,
            feed_stop: true,
        }
    }
}

//! The state of protection between cycles.

use crate::settings::TurningSettings;
use crate::state::TurningState;

/// Durations of an overload and of implausible readings, holds, and the start.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProtectionState {
    /// Time above the overload limit, s.
    pub(crate) overload_s: f64,
    /// Time without a plausible reading, s, ...
    pub(crate) blind_s: f64,
    /// ... and the longest such time for which the feed continues.
    pub(crate) blind_max_s: f64,
    /// The state in which the hold began.
    pub(crate) before_hold: TurningState,
    /// The start input has not been cleared since the last start.
    pub(crate) start_seen: bool,
}

impl ProtectionState {
    /// The initial state.
    pub(crate) fn new(settings: &TurningSettings) -> Self {
        Self {
            overload_s: 0.0,
            blind_s: 0.0,
            blind_max_s: settings.blind_s().min(0.5 * settings.turn_s()),
            before_hold: TurningState::Idle,
            start_seen: false,
        }
    }
}

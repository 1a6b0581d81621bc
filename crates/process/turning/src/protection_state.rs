//! What protection remembers from cycle to cycle.

use crate::settings::TurningSettings;
use crate::state::TurningState;

/// Times of an overload and of a sensor that cannot be believed, holds, and the start.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProtectionState {
    /// Time above the overload limit, s.
    pub(crate) overload_s: f64,
    /// Time without a reading that can be believed, s, ...
    pub(crate) blind_s: f64,
    /// ... and the longest that the feed goes on.
    pub(crate) blind_max_s: f64,
    /// The state in which a hold came.
    pub(crate) before_hold: TurningState,
    /// The start has not been let go since the last one.
    pub(crate) start_seen: bool,
}

impl ProtectionState {
    /// Nothing has happened.
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

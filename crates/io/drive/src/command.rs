//! What the core commands at one instant, as the watch needs it.

use evolvent_path::AxisMask;
use evolvent_wire::{AXES, Setpoint};

use crate::power::PowerRequest;

/// One setpoint, without what only people want to know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Index of the setpoint.
    pub sequence: u64,
    /// Position, mm or degrees.
    pub position: [f64; AXES],
    /// Velocity, mm/s or degrees/s.
    pub velocity: [f64; AXES],
    /// By which datum the position is named.
    pub datum: u64,
    /// What the power stages shall do.
    pub power: PowerRequest,
    /// The counter of fault resets.
    pub fault_reset: u32,
    /// Bit i set: limit switches of axis i are looked at by somebody else, as in homing.
    pub switches_expected: AxisMask,
}

impl Command {
    /// What a setpoint of the bus commands; no limit switch is expected.
    #[must_use]
    pub const fn of(setpoint: &Setpoint) -> Self {
        Self {
            sequence: setpoint.sequence,
            position: setpoint.position,
            velocity: setpoint.velocity,
            datum: setpoint.datum,
            power: PowerRequest::from_number(setpoint.power_request),
            fault_reset: setpoint.fault_reset,
            switches_expected: AxisMask::NONE,
        }
    }
}

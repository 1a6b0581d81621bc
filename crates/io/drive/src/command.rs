//! The core's command at one instant, as the monitoring needs it.

use evolvent_path::AxisMask;
use evolvent_wire::{AXES, Setpoint};

use crate::power::PowerRequest;

/// One setpoint, without the fields for displays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveSetpoint {
    /// Index of the setpoint.
    pub sequence: u64,
    /// Position, mm or degrees.
    pub position: [f64; AXES],
    /// Velocity, mm/s or degrees/s.
    pub velocity: [f64; AXES],
    /// The datum that the position refers to.
    pub datum: u64,
    /// Requested state of the power stages.
    pub power: PowerRequest,
    /// The counter of fault resets.
    pub fault_reset: u32,
    /// Bit i set: the limit switch at the negative, and at the positive end of axis i is checked elsewhere,
    /// as in homing.
    pub switches_expected: [AxisMask; 2],
}

impl DriveSetpoint {
    /// The command of a setpoint on the bus; no limit switch is expected.
    #[must_use]
    pub const fn of(setpoint: &Setpoint) -> Self {
        Self {
            sequence: setpoint.sequence,
            position: setpoint.position,
            velocity: setpoint.velocity,
            datum: setpoint.datum,
            power: PowerRequest::from_number(setpoint.power_request),
            fault_reset: setpoint.fault_reset,
            switches_expected: [AxisMask::NONE; 2],
        }
    }
}

//! Setpoints on their way from the cycle to the bus.

use evolvent_drive::{IndexRequest, PowerRequest};
use evolvent_gcode::SPINDLES;
use evolvent_motion::Setpoint;
use evolvent_path::{Axes, Jet};

/// A factor for the commanded speed of each spindle.
pub(crate) type SpindleOverrides = [f64; SPINDLES];

/// A setpoint on its way to the bus.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DueSetpoint {
    /// As it was planned: of a machine without errors.
    pub setpoint: Setpoint,
    /// What the drives are sent, where that is something else.
    pub corrected: Option<Jet>,
    /// When it counts, ns.
    pub due_time_ns: u64,
    pub drive: DriveRequest,
    /// The job to whose program it belongs, or to whose program the last one did.
    pub job: u64,
    /// By what the commanded speed of each spindle is multiplied: the override of the operator, where it
    /// counts.
    pub spindle_overrides: SpindleOverrides,
    /// Spindles for which the program has switched that off.
    pub override_off_mask: u32,
    /// Whether it belongs to a program, and not to a jog, to homing or to rest.
    pub is_of_program: bool,
}

impl DueSetpoint {
    /// Position, velocity and acceleration that the drives are sent.
    pub(crate) fn sent(&self) -> [Axes; 3] {
        let setpoint = &self.setpoint;
        match &self.corrected {
            Some(jet) => [jet.position, jet.first, jet.second],
            None => [setpoint.position, setpoint.velocity, setpoint.acceleration],
        }
    }
}

/// Requests to the drives that accompany a setpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DriveRequest {
    pub power: PowerRequest,
    pub fault_reset: u32,
    pub datum: u64,
    /// The index pulse that is to be latched.
    pub index: IndexRequest,
}

impl DriveRequest {
    /// Follow.
    pub(crate) const ON: Self = Self {
        power: PowerRequest::On,
        fault_reset: 0,
        datum: 0,
        index: IndexRequest::NONE,
    };
    /// Without power.
    pub(crate) const OFF: Self = Self {
        power: PowerRequest::Off,
        fault_reset: 0,
        datum: 0,
        index: IndexRequest::NONE,
    };
}

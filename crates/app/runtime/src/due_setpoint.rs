//! Setpoints on their way from the cycle to the bus.

use evolvent_drive::{IndexRequest, PowerRequest};
use evolvent_gcode::SPINDLES;
use evolvent_motion::Setpoint;
use evolvent_path::{Axes, Jet};

/// Factors on the commanded speed of the spindles.
pub(crate) type SpindleOverrides = [f64; SPINDLES];

/// A setpoint on its way to the bus.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DueSetpoint {
    /// As planned, without corrections for the machine's errors.
    pub setpoint: Setpoint,
    /// The setpoint sent to the drives, if it differs.
    pub corrected: Option<Jet>,
    /// When it takes effect, ns.
    pub due_time_ns: u64,
    pub drive: DriveRequest,
    /// The job of the program that it belongs to, or of the last program.
    pub job: u64,
    /// Factor on the commanded speed of each spindle: the operator's override where it is in force.
    pub spindle_overrides: SpindleOverrides,
    /// Spindles whose override the program has switched off.
    pub override_off_mask: u32,
    /// Whether it belongs to a program rather than to a jog, homing or rest.
    pub is_of_program: bool,
}

impl DueSetpoint {
    /// Position, velocity and acceleration sent to the drives.
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
    /// The index pulse to latch.
    pub index: IndexRequest,
}

impl DriveRequest {
    /// The drives follow.
    pub(crate) const ON: Self = Self {
        power: PowerRequest::On,
        fault_reset: 0,
        datum: 0,
        index: IndexRequest::NONE,
    };
    /// The drives have no power.
    pub(crate) const OFF: Self = Self {
        power: PowerRequest::Off,
        fault_reset: 0,
        datum: 0,
        index: IndexRequest::NONE,
    };
}

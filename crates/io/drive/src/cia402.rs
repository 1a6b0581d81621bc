//! The bridge's side of CiA 402: the control words that bring a drive to the state that the core requests.

use crate::power::PowerRequest;
use crate::status_word::DriveState;

/// Modes of operation (object 6060h): cyclic synchronous position, the only one used here.
pub const CYCLIC_SYNCHRONOUS_POSITION: i8 = 8;

/// Control words (object 6040h), one per command of the standard.
pub mod control {
    /// Transitions 7, 9, 10 and 12: no torque, switch on disabled.
    pub const DISABLE_VOLTAGE: u16 = 0x00;
    /// Transitions 7, 10 and 11: brake by the quick stop ramp.
    pub const QUICK_STOP: u16 = 0x02;
    /// Transitions 2, 6 and 8: ready to switch on.
    pub const SHUTDOWN: u16 = 0x06;
    /// Transition 3, and 5 back from operation (disable operation): powered, without torque.
    pub const SWITCH_ON: u16 = 0x07;
    /// Transitions 4 and 16: torque on, follow the target.
    pub const ENABLE_OPERATION: u16 = 0x0F;
    /// Transition 15, at the rising edge.
    pub const FAULT_RESET: u16 = 0x80;
}

/// Maximum time for which a drive may brake by itself while no power is requested, s. Then the voltage is
/// removed at any speed. Twice the braking time of a large machine, from 500 mm/s at 500 mm/s2.
const MAX_BRAKING_S: f64 = 2.0;

/// State of a drive that may be braking by itself, in one period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Braking {
    /// The period, s.
    pub period_s: f64,
    /// Whether the motor is at standstill; `None` if its velocity is not known.
    pub is_standing: Option<bool>,
}

/// Commands to one drive for one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveOrder {
    /// Object 6040h.
    pub control_word: u16,
    /// Object 6060h.
    pub mode_of_operation: i8,
    /// Object 607Ah, in the unit of the arguments: the actual position until operation is enabled, then the
    /// setpoint.
    pub target_position: f64,
    /// Whether the drive follows the setpoint in this period.
    pub follows: bool,
}

/// Brings one drive to the requested power state, one transition per period, and supplies its targets.
///
/// Rules that prevent unexpected motion:
/// - until operation is enabled the target is the actual position, so that enabling causes no motion;
/// - after a fault or a quick stop power stays off until the request has once been *off*;
/// - a fault is reset only when the counter of resets of one core has grown, by one edge;
/// - a drive that brakes by its quick stop ramp or its fault reaction keeps its voltage until it has stopped,
///   leaves that state by itself, or has braked for 2 s without power being requested: without voltage the
///   axis would coast.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cia402 {
    /// The last counter of the core; `None` before the first, and between two cores.
    counter: Option<u32>,
    resets_done: u32,
    reset_requested: bool,
    reset_edge: bool,
    locked_out: bool,
    /// Time for which it has been braking without a request for a quick stop, ns.
    braking_ns: u64,
}

impl Cia402 {
    /// A drive in an unknown state. What a core has requested before its first count counts as done.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            counter: None,
            resets_done: 0,
            reset_requested: false,
            reset_edge: false,
            locked_out: false,
            braking_ns: 0,
        }
    }

    /// The last reset that was executed.
    #[must_use]
    pub const fn resets_done(&self) -> u32 {
        self.resets_done
    }

    /// Whether power stays off until the request has once been *off*.
    #[must_use]
    pub const fn is_locked_out(&self) -> bool {
        self.locked_out
    }

    /// One period: from the drive's status word and the core's request to the commands of the drive.
    ///
    /// `fault_reset` is the core's counter, `None` without a core and in the first period of another one;
    /// `setpoint` and `actual` are in one unit; `braking` is needed while the drive brakes by itself. A
    /// status word that matches no state removes the voltage.
    pub fn step(
        &mut self,
        status_word: u16,
        request: PowerRequest,
        fault_reset: Option<u32>,
        setpoint: f64,
        actual: f64,
        braking: Braking,
    ) -> DriveOrder {
        let state = DriveState::decode(status_word);
        self.take_counter(fault_reset);
        let has_stopped = matches!(
            state,
            Some(DriveState::Fault | DriveState::FaultReactionActive | DriveState::QuickStopActive)
        );
        match request {
            // Without a core nobody requests it.
            PowerRequest::Off if fault_reset.is_none() => {}
            PowerRequest::Off => self.locked_out = false,
            PowerRequest::QuickStop => self.locked_out = true,
            PowerRequest::On => self.locked_out |= has_stopped,
        }
        let wants_power = request == PowerRequest::On && !self.locked_out;
        let control_word = match state {
            Some(DriveState::Fault) => self.fault_word(),
            None | Some(DriveState::NotReadyToSwitchOn) => control::DISABLE_VOLTAGE,
            Some(DriveState::SwitchOnDisabled) if wants_power => control::SHUTDOWN,
            Some(DriveState::SwitchOnDisabled) => control::DISABLE_VOLTAGE,
            Some(DriveState::ReadyToSwitchOn) if wants_power => control::SWITCH_ON,
            Some(DriveState::ReadyToSwitchOn) => control::DISABLE_VOLTAGE,
            Some(DriveState::SwitchedOn) if wants_power => control::ENABLE_OPERATION,
            Some(DriveState::SwitchedOn) => control::SHUTDOWN,
            Some(DriveState::OperationEnabled) => match request {
                PowerRequest::On if wants_power => control::ENABLE_OPERATION,
                PowerRequest::On | PowerRequest::Off => control::SWITCH_ON,
                PowerRequest::QuickStop => control::QUICK_STOP,
            },
            // Never by transition 16 back into motion: after a stop the drive is switched on again.
            Some(DriveState::QuickStopActive | DriveState::FaultReactionActive) => {
                if request == PowerRequest::QuickStop || self.may_brake(braking) {
                    control::QUICK_STOP
                } else {
                    control::DISABLE_VOLTAGE
                }
            }
        };
        if !matches!(
            state,
            Some(DriveState::QuickStopActive | DriveState::FaultReactionActive)
        ) {
            self.braking_ns = 0;
        }
        if state != Some(DriveState::Fault) {
            // Nothing to reset: the request is done.
            (self.reset_requested, self.reset_edge) = (false, false);
        }
        let follows = state == Some(DriveState::OperationEnabled)
            && control_word == control::ENABLE_OPERATION
            && setpoint.is_finite();
        DriveOrder {
            control_word,
            mode_of_operation: CYCLIC_SYNCHRONOUS_POSITION,
            target_position: if follows { setpoint } else { actual },
            follows,
        }
    }

    /// Counts one period of braking without a request for it. Returns whether braking may continue.
    fn may_brake(&mut self, braking: Braking) -> bool {
        // At least a nanosecond, so that braking also ends with an unknown period.
        let period_ns = (braking.period_s * 1e9).max(1.0) as u64;
        self.braking_ns = self.braking_ns.saturating_add(period_ns);
        braking.is_standing != Some(true) && self.braking_ns as f64 <= MAX_BRAKING_S * 1e9
    }

    /// Accepts the counter. Only its growth within one core is a request: a restarted core may begin with any
    /// value.
    const fn take_counter(&mut self, fault_reset: Option<u32>) {
        match (self.counter, fault_reset) {
            (Some(before), Some(count)) if count == before => {}
            (Some(before), Some(count)) => {
                self.reset_requested = count.wrapping_sub(before).cast_signed() > 0;
                self.resets_done = count;
            }
            (None, Some(count)) => self.resets_done = count,
            (_, None) => self.reset_requested = false,
        }
        self.counter = fault_reset;
    }

    /// One period with the edge for each growth of the counter, low in between.
    const fn fault_word(&mut self) -> u16 {
        self.reset_edge = !self.reset_edge && core::mem::replace(&mut self.reset_requested, false);
        if self.reset_edge {
            control::FAULT_RESET
        } else {
            control::DISABLE_VOLTAGE
        }
    }
}

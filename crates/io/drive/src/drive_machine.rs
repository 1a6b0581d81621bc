//! The drive's own side of CiA 402: its reaction to control words. For simulated drives and tests.

use crate::status_word::{DriveState, bits};

/// Quick stop option code (object 605Ah), as far as it affects states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum QuickStopOption {
    /// Codes 1 to 4: brake, then switch on disabled.
    #[default]
    ThenDisabled,
    /// Codes 5 to 8: brake, then stay in quick stop active, under torque.
    ThenStay,
}

/// The drive's inputs in one period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveEvents {
    /// The self-test has ended.
    pub ready: bool,
    /// A present fault: its error code (object 603Fh).
    pub fault: Option<u16>,
    /// The axis is at rest.
    pub at_rest: bool,
}

/// The state machine of one drive. The numbers in the code are the standard's transition numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveMachine {
    state: DriveState,
    option: QuickStopOption,
    error_code: u16,
    last_control_word: u16,
}

impl DriveMachine {
    /// A drive that was just supplied with power: transition 0.
    #[must_use]
    pub const fn new(option: QuickStopOption) -> Self {
        Self {
            state: DriveState::NotReadyToSwitchOn,
            option,
            error_code: 0,
            last_control_word: 0,
        }
    }

    /// The state.
    #[must_use]
    pub const fn state(&self) -> DriveState {
        self.state
    }

    /// Object 603Fh: the last fault's code; 0 after its reset.
    #[must_use]
    pub const fn error_code(&self) -> u16 {
        self.error_code
    }

    /// Whether the power stage gives torque: in operation and while it brakes.
    #[must_use]
    pub const fn has_torque(&self) -> bool {
        self.state.has_torque()
    }

    /// One period: at most one transition.
    pub fn step(&mut self, control_word: u16, events: DriveEvents) -> DriveState {
        use DriveState as S;
        let edge = !self.last_control_word & control_word & 0x80 != 0;
        self.last_control_word = control_word;
        if let Some(code) = events.fault
            && !self.state.is_fault()
        {
            self.error_code = code;
            self.state = S::FaultReactionActive; // 13
            return self.state;
        }
        let voltage = control_word & 0x02 != 0;
        let no_quick_stop = control_word & 0x04 != 0;
        let switch_on = control_word & 0x01 != 0;
        let enable = control_word & 0x08 != 0;
        // Shutdown: bits 1 and 2 without bit 0; the others by their names.
        let shutdown = voltage && no_quick_stop && !switch_on;
        let on = voltage && no_quick_stop && switch_on;
        let quick_stop = voltage && !no_quick_stop;
        self.state = match self.state {
            S::NotReadyToSwitchOn if events.ready => S::SwitchOnDisabled, // 1
            S::SwitchOnDisabled if shutdown => S::ReadyToSwitchOn,        // 2
            S::ReadyToSwitchOn if on => S::SwitchedOn,                    // 3
            S::ReadyToSwitchOn if quick_stop || !voltage => S::SwitchOnDisabled, // 7
            S::SwitchedOn if on && enable => S::OperationEnabled,         // 4
            S::SwitchedOn if shutdown => S::ReadyToSwitchOn,              // 6
            S::SwitchedOn if quick_stop || !voltage => S::SwitchOnDisabled, // 10
            S::OperationEnabled if on && !enable => S::SwitchedOn,        // 5
            S::OperationEnabled if shutdown => S::ReadyToSwitchOn,        // 8
            S::OperationEnabled if !voltage => S::SwitchOnDisabled,       // 9
            S::OperationEnabled if quick_stop => S::QuickStopActive,      // 11
            S::QuickStopActive if !voltage => S::SwitchOnDisabled,        // 12
            S::QuickStopActive if events.at_rest && self.option == QuickStopOption::ThenDisabled => {
                S::SwitchOnDisabled // 12
            }
            S::QuickStopActive if on && enable && self.option == QuickStopOption::ThenStay => {
                S::OperationEnabled // 16
            }
            S::FaultReactionActive if events.at_rest => S::Fault, // 14
            S::Fault if edge && events.fault.is_none() => {
                self.error_code = 0;
                S::SwitchOnDisabled // 15
            }
            state => state,
        };
        self.state
    }

    /// The status word, with the bits that a drive in cyclic synchronous position sets.
    #[must_use]
    pub const fn status_word(&self) -> u16 {
        let mut word = self.state.code() | bits::REMOTE;
        if matches!(
            self.state,
            DriveState::SwitchedOn | DriveState::OperationEnabled | DriveState::QuickStopActive
        ) {
            word |= bits::VOLTAGE_ENABLED;
        }
        if matches!(self.state, DriveState::OperationEnabled) {
            word |= bits::FOLLOWS_TARGET;
        }
        // Set while there is no quick stop, also if the state does not require it.
        if matches!(self.state, DriveState::SwitchOnDisabled) {
            word |= bits::QUICK_STOP;
        }
        word
    }
}

//! The status word (object 6041h) of CiA 402: the state of a drive.

/// Bits of the status word.
pub mod bits {
    /// Ready to switch on.
    pub const READY_TO_SWITCH_ON: u16 = 1 << 0;
    /// Switched on.
    pub const SWITCHED_ON: u16 = 1 << 1;
    /// Operation enabled.
    pub const OPERATION_ENABLED: u16 = 1 << 2;
    /// Fault.
    pub const FAULT: u16 = 1 << 3;
    /// High voltage is applied to the power stage.
    pub const VOLTAGE_ENABLED: u16 = 1 << 4;
    /// Set while no quick stop is active.
    pub const QUICK_STOP: u16 = 1 << 5;
    /// Switch on disabled.
    pub const SWITCH_ON_DISABLED: u16 = 1 << 6;
    /// A warning that stops nothing.
    pub const WARNING: u16 = 1 << 7;
    /// The control word is taken into account.
    pub const REMOTE: u16 = 1 << 9;
    /// An internal limit is active: position range, current, torque.
    pub const INTERNAL_LIMIT: u16 = 1 << 11;
    /// In cyclic synchronous position: the drive follows the target; clear, it ignores it.
    pub const FOLLOWS_TARGET: u16 = 1 << 12;
    /// In cyclic synchronous position: the drive's own following error window was left.
    pub const FOLLOWING_ERROR: u16 = 1 << 13;
}

/// States of the power drive system's state machine (IEC 61800-7-201, CiA 402-2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DriveState {
    /// Self-test, initialisation.
    NotReadyToSwitchOn,
    /// Initialised; the power must not be switched on.
    SwitchOnDisabled,
    /// The power may be switched on.
    ReadyToSwitchOn,
    /// Powered, without torque.
    SwitchedOn,
    /// Torque is on; the drive follows its target.
    OperationEnabled,
    /// Braking by the quick stop ramp, or at rest after it.
    QuickStopActive,
    /// Braking because of a fault.
    FaultReactionActive,
    /// Faulted, without torque.
    Fault,
}

impl DriveState {
    /// All states with the mask applied to a status word and the resulting value.
    pub const TABLE: [(Self, u16, u16); 8] = [
        (Self::NotReadyToSwitchOn, 0x4F, 0x00),
        (Self::SwitchOnDisabled, 0x4F, 0x40),
        (Self::ReadyToSwitchOn, 0x6F, 0x21),
        (Self::SwitchedOn, 0x6F, 0x23),
        (Self::OperationEnabled, 0x6F, 0x27),
        (Self::QuickStopActive, 0x6F, 0x07),
        (Self::FaultReactionActive, 0x4F, 0x0F),
        (Self::Fault, 0x4F, 0x08),
    ];

    /// The state of a status word; none if the bits match no state.
    #[must_use]
    pub fn decode(status_word: u16) -> Option<Self> {
        Self::TABLE
            .iter()
            .find(|(_, mask, value)| status_word & mask == *value)
            .map(|(state, _, _)| *state)
    }

    /// A status word of this state, with every unrelated bit clear.
    #[must_use]
    pub const fn code(self) -> u16 {
        match self {
            Self::NotReadyToSwitchOn => 0x00,
            Self::SwitchOnDisabled => 0x40,
            Self::ReadyToSwitchOn => 0x21,
            Self::SwitchedOn => 0x23,
            Self::OperationEnabled => 0x27,
            Self::QuickStopActive => 0x07,
            Self::FaultReactionActive => 0x0F,
            Self::Fault => 0x08,
        }
    }

    /// Whether the power stage gives torque: in operation and while it brakes.
    #[must_use]
    pub const fn has_torque(self) -> bool {
        matches!(
            self,
            Self::OperationEnabled | Self::QuickStopActive | Self::FaultReactionActive
        )
    }

    /// Whether the drive is in a fault, or braking because of one.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        matches!(self, Self::FaultReactionActive | Self::Fault)
    }
}

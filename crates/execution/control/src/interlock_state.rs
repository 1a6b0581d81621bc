//! The state of the machine on which interlocks depend.

/// Whether the drives may move. The numbers are those on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum MachineState {
    /// Emergency stop: only its reset is accepted.
    Estop = 0,
    /// The drives are without power.
    Off = 1,
    /// The drives are enabled.
    On = 2,
}

/// The source of commands. The numbers are those on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Mode {
    /// From a program.
    Auto = 0,
    /// By hand: jog and homing.
    Manual = 1,
    /// From single blocks.
    Mdi = 2,
}

impl Mode {
    /// The mode with this number.
    #[must_use]
    pub const fn from_number(number: u32) -> Option<Self> {
        match number {
            0 => Some(Self::Auto),
            1 => Some(Self::Manual),
            2 => Some(Self::Mdi),
            _ => None,
        }
    }

    /// The name of the mode.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Manual => "manual",
            Self::Mdi => "mdi",
        }
    }
}

/// The kind of job that moves the axes. The numbers are those on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Activity {
    /// Nothing: at rest.
    None = 0,
    /// A program.
    Program = 1,
    /// A block of MDI.
    Mdi = 2,
    /// A jog.
    Jog = 3,
    /// A homing sequence.
    Homing = 4,
}

/// Everything that the interlocks depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InterlockState {
    /// Emergency stop, off or on.
    pub machine: MachineState,
    /// Automatic, manual or MDI.
    pub mode: Mode,
    /// The kind of job that moves the axes.
    pub activity: Activity,
    /// A program is loaded.
    pub is_loaded: bool,
    /// Every axis is homed.
    pub is_homed: bool,
    /// An alarm is latched.
    pub has_alarm: bool,
    /// The axes are at rest in a feed hold or at a program stop, or on their way there.
    pub is_held: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_come_back_from_their_numbers() {
        for mode in [Mode::Auto, Mode::Manual, Mode::Mdi] {
            assert_eq!(Mode::from_number(mode as u32), Some(mode));
        }
        assert_eq!(Mode::from_number(3), None);
    }
}

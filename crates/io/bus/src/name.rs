//! Names on the bus: machines and channels.

use thiserror::Error;

/// The longest name of a machine, in characters.
pub const MAX_MACHINE_NAME: usize = 64;

/// Why a name is not valid in a service name.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum NameError {
    /// There is no name.
    #[error(
        "the machine's name is empty: give it one of 1 to {MAX_MACHINE_NAME} letters, digits, '-' or '_'"
    )]
    Empty,
    /// The name is too long.
    #[error("the machine's name has {length} characters: shorten it to {MAX_MACHINE_NAME}")]
    TooLong {
        /// Number of characters.
        length: usize,
    },
    /// The name contains an invalid character.
    #[error(
        "the machine's name contains {character:?} at position {position}: use letters a-z A-Z, digits, '-' \
         and '_' only"
    )]
    Character {
        /// The character.
        character: char,
        /// Its position, counted from 1.
        position: usize,
    },
}

/// Checks that a name is valid for a machine: 1 to 64 of `a-z A-Z 0-9 - _`.
///
/// # Errors
/// The rule that the name violates.
pub fn check_machine_name(name: &str) -> Result<(), NameError> {
    if name.is_empty() {
        return Err(NameError::Empty);
    }
    let good = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if let Some((i, character)) = name.chars().enumerate().find(|&(_, c)| !good(c)) {
        return Err(NameError::Character {
            character,
            position: i + 1,
        });
    }
    if name.len() > MAX_MACHINE_NAME {
        return Err(NameError::TooLong { length: name.len() });
    }
    Ok(())
}

/// A channel of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Setpoints, from the core.
    Setpoint,
    /// The drives' feedback, to the core.
    Feedback,
    /// Cutting loads, to the core.
    Load,
    /// Outputs, from the core.
    Output,
    /// Inputs, to the core.
    Input,
    /// Angles and speeds of spindles, to the core.
    Spindle,
    /// Snapshots, from the core.
    Status,
    /// Wake-ups and faults, from the core.
    Event,
    /// Commands and answers, to and from the core.
    Control,
}

impl Channel {
    /// The last part of the service's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Setpoint => "setpoint",
            Self::Feedback => "feedback",
            Self::Load => "load",
            Self::Output => "output",
            Self::Input => "input",
            Self::Spindle => "spindle",
            Self::Status => "status",
            Self::Event => "event",
            Self::Control => "control",
        }
    }

    /// The full name of the iceoryx2 service: `evolvent/NAME/CHANNEL`.
    ///
    /// # Errors
    /// The rule that the machine's name violates.
    pub fn service_name(self, machine_name: &str) -> Result<String, NameError> {
        check_machine_name(machine_name)?;
        Ok(format!("evolvent/{machine_name}/{}", self.name()))
    }
}

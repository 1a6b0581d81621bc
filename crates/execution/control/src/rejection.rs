//! Why a command is not accepted.

use crate::alarm::Alarm;
use crate::command_code::CommandCode;
use crate::interlocks::mode_needed;

/// Why a command is not accepted: a number for programs, a sentence for the operator.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct Rejection {
    /// The number.
    pub alarm: Alarm,
    /// The problem and its remedy.
    pub text: String,
}

impl Rejection {
    /// A rejection with its own sentence.
    #[must_use]
    pub fn new(alarm: Alarm, text: impl Into<String>) -> Self {
        Self {
            alarm,
            text: text.into(),
        }
    }

    /// The rejection of a command by the interlocks.
    #[must_use]
    pub fn by_rule(alarm: Alarm, command: CommandCode) -> Self {
        match (alarm, mode_needed(command)) {
            (Alarm::WrongMode, Some(mode)) => Self::new(
                alarm,
                format!("this needs mode {0}; change to it with `mode {0}`", mode.name()),
            ),
            _ => alarm.into(),
        }
    }
}

impl From<Alarm> for Rejection {
    fn from(alarm: Alarm) -> Self {
        Self::new(alarm, alarm.sentence())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rejection_for_the_mode_names_the_required_mode() {
        let refusal = Rejection::by_rule(Alarm::WrongMode, CommandCode::Mdi);
        assert!(refusal.text.contains("mode mdi"), "{refusal}");
        assert_eq!(
            Rejection::by_rule(Alarm::IsOff, CommandCode::Mdi).text,
            Alarm::IsOff.sentence()
        );
    }
}

//! Bounds of a check, and the part of the program that they leave unchecked.

use std::fmt;

use evolvent_gcode::LoopStart;

/// Bounds of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CheckBounds {
    /// Number of errors after which the check ends.
    pub errors: usize,
    /// Maximum number of commands.
    pub commands: u64,
    /// Maximum number of commands without reaching a later line. Without this bound a loop that makes parts
    /// until it is stopped would never end.
    pub round: u64,
    /// Whether the executables of user-defined M codes (M100 to M199) must exist.
    pub user_codes: bool,
    /// Whether an operator can confirm a tool change.
    pub confirms_tools: bool,
}

impl CheckBounds {
    /// Commands in a loop for a check that no client waits for.
    pub const LOOP_COMMANDS: u64 = 1_000_000;

    /// Checks up to the end, with at most a million commands in a loop.
    #[must_use]
    pub fn whole(errors: usize) -> Self {
        Self {
            errors,
            commands: u64::MAX,
            round: Self::LOOP_COMMANDS,
            user_codes: true,
            confirms_tools: true,
        }
    }

    /// Bounds while a client waits, about one second: a million commands, a hundred thousand of them in a
    /// loop.
    #[must_use]
    pub fn while_one_waits(errors: usize) -> Self {
        Self {
            errors,
            commands: 1_000_000,
            round: 100_000,
            user_codes: true,
            confirms_tools: true,
        }
    }
}

/// The part of a program that was not checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unchecked {
    /// The last line of the program that was checked.
    pub up_to: u32,
    /// Why the check ended there.
    pub bound: CheckBound,
}

impl Unchecked {
    /// Names the loop as the reason if the line with many commands is part of one.
    pub(crate) fn name_loop(&mut self, start: Option<LoopStart>) {
        if let (CheckBound::Line { commands, .. }, Some(start)) = (&self.bound, start) {
            self.bound = CheckBound::Loop {
                start,
                commands: *commands,
            };
        }
    }
}

impl fmt::Display for Unchecked {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "checked up to line {}: {}", self.up_to, self.bound)
    }
}

/// What ends a check before the end of the program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CheckBound {
    /// The maximum number of errors was found, or an error ended the reading of the program.
    Errors,
    /// A loop exceeds its number of commands.
    Loop {
        /// The start of the loop.
        start: LoopStart,
        /// The maximum number.
        commands: u64,
    },
    /// A line without a loop exceeds the number of commands, for example M98 with L.
    Line {
        /// The program line.
        line: u32,
        /// The maximum number.
        commands: u64,
    },
    /// The whole program exceeds the number of commands.
    Commands {
        /// The maximum number.
        commands: u64,
    },
    /// The result is no longer needed.
    Cancelled,
}

impl CheckBound {
    /// The name in JSON.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Errors => "errors",
            Self::Loop { .. } => "loop",
            Self::Line { .. } => "line",
            Self::Commands { .. } => "commands",
            Self::Cancelled => "cancelled",
        }
    }

    /// Whether a larger [`CheckBounds::round`] would let the check continue.
    #[must_use]
    pub fn is_of_loops(&self) -> bool {
        matches!(self, Self::Loop { .. } | Self::Line { .. })
    }
}

impl fmt::Display for CheckBound {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Errors => formatter.write_str("the maximum number of errors is reached"),
            Self::Loop { start, commands } => {
                write!(formatter, "the loop that begins on line {}", start.line)?;
                if let Some(file) = &start.file {
                    write!(formatter, " of {file}")?;
                }
                write!(formatter, " has more than {commands} commands")
            }
            Self::Line { line, commands } => {
                write!(formatter, "line {line} has more than {commands} commands")
            }
            Self::Commands { commands } => {
                write!(formatter, "the program has more than {commands} commands")
            }
            Self::Cancelled => formatter.write_str("the check was cancelled"),
        }
    }
}

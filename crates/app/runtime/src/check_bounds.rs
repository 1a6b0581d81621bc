//! How far a program is checked, and what a bound leaves unchecked.

use std::fmt;

use evolvent_gcode::LoopPlace;

/// How far a program is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CheckBounds {
    /// Errors after which nothing more is looked at.
    pub errors: usize,
    /// Commands for the machine in all.
    pub commands: u64,
    /// Commands after which no line farther down has been reached: a loop that makes parts until it is
    /// stopped would be followed for ever.
    pub round: u64,
    /// Whether the programs of user-defined M codes (M100 to M199) have to be there.
    pub user_codes: bool,
    /// Whether an operator can confirm a tool change.
    pub confirms_tools: bool,
}

impl CheckBounds {
    /// Commands of a loop in a check that nobody waits for.
    pub const LOOP_COMMANDS: u64 = 1_000_000;

    /// To its end, unless it goes round for a million commands.
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

    /// As far as can be looked at while a client waits, about a second at most: a million commands, a hundred
    /// thousand of them in a loop.
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

/// What was not looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unchecked {
    /// The last line of the program that was checked.
    pub up_to: u32,
    /// Why nothing after it was.
    pub bound: CheckBound,
}

impl Unchecked {
    /// A line that takes many commands may be one of a loop: then the loop is the reason.
    pub(crate) fn name_loop(&mut self, place: Option<LoopPlace>) {
        if let (CheckBound::Line { commands, .. }, Some(place)) = (&self.bound, place) {
            self.bound = CheckBound::Loop {
                place,
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
    /// There are as many errors as are looked for, or an error ends the reading of the program.
    Errors,
    /// A loop has too many commands.
    Loop {
        /// Where it begins.
        place: LoopPlace,
        /// The bound.
        commands: u64,
    },
    /// A line without a loop has too many commands, such as M98 with L.
    Line {
        /// The line of the program.
        line: u32,
        /// The bound.
        commands: u64,
    },
    /// The program as a whole has too many.
    Commands {
        /// The bound.
        commands: u64,
    },
    /// Nobody needs the result any more.
    Cancelled,
}

impl CheckBound {
    /// Its name in JSON.
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

    /// Whether a larger bound for loops ([`CheckBounds::round`]) would let the check go on.
    #[must_use]
    pub fn is_of_loops(&self) -> bool {
        matches!(self, Self::Loop { .. } | Self::Line { .. })
    }
}

impl fmt::Display for CheckBound {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Errors => formatter.write_str("no further errors are looked for"),
            Self::Loop { place, commands } => {
                write!(formatter, "the loop that begins on line {}", place.line)?;
                if let Some(file) = &place.file {
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

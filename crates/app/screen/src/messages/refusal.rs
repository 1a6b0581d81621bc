//! Why the server itself refuses a command: by name, so that a page says it in its language.

use serde::Serialize;
use ts_rs::TS;

/// Why a command did not reach the core.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, TS)]
#[serde(rename_all = "snake_case")]
pub enum Refusal {
    /// The address permits watching only.
    WatchOnly,
    /// The page does not have control.
    NoControl,
    /// It has lost control since it sent the command.
    LostControl,
    /// It has seen nothing of the machine for too long.
    OutOfDate,
    /// The jog that it changes has ended.
    JogEnded,
    /// The command waited for too long.
    TooLate,
    /// Too many commands wait.
    Busy,
    /// The server ends.
    Ending,
    /// The name of the program is not allowed.
    BadName,
    /// The program is too large.
    TooLarge,
    /// Another program is being received.
    Receiving,
    /// The upload paused for too long.
    Paused,
    /// The page has lost control while its program arrived.
    NotLoaded,
}

impl Refusal {
    /// The same in English, for the log and for other clients.
    #[must_use]
    pub fn sentence(self) -> &'static str {
        match self {
            Self::WatchOnly => "this page may only watch",
            Self::NoControl => "this page does not have control; take it first",
            Self::LostControl => "this page lost control in the meantime; the command was not sent",
            Self::OutOfDate => "the page was out of date; check the machine and press again",
            Self::JogEnded => "the jog has ended; press again",
            Self::TooLate => "the command arrived too late and was not sent",
            Self::Busy => "too many commands wait for the core; try again",
            Self::Ending => "the server is ending",
            Self::BadName => {
                "this is not a valid program name: use letters, digits and . _ - + ( ), up to 100 bytes"
            }
            Self::TooLarge => "programs have at most 256 MiB",
            Self::Receiving => "another program is being received; try again afterwards",
            Self::Paused => "the upload paused for too long",
            Self::NotLoaded => "this page lost control in the meantime; the program was not loaded",
        }
    }
}

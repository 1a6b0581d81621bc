//! What the server itself logs: by code and fields, so that a page says it in its language.

use serde::Serialize;
use ts_rs::TS;

use super::Refusal;

/// What happened. Pages have their numbers on this service.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, TS)]
#[serde(tag = "code", rename_all = "snake_case")]
pub enum LogFact {
    /// A command of a page was accepted.
    Accepted {
        /// As in docs/contract.md.
        command: String,
        /// Its number.
        #[ts(type = "number")]
        page: u64,
    },
    /// A command of a page was rejected. The number of the entry is that of the core.
    Rejected {
        /// As in docs/contract.md.
        command: String,
        /// Its number.
        #[ts(type = "number")]
        page: u64,
        /// Why, in English.
        reason: String,
        /// Why, where the server itself refused it and has a name for that.
        refusal: Option<Refusal>,
    },
    /// An upload was loaded.
    Loaded {
        /// Its name.
        program: String,
    },
    /// An upload was not loaded. The number of the entry is that of the core.
    NotLoaded {
        /// Its name.
        program: String,
        /// Why, in English.
        reason: String,
        /// Why, where the server itself refused it and has a name for that.
        refusal: Option<Refusal>,
    },
    /// The file of the loaded program was changed.
    ProgramChanged {
        /// Its name.
        program: String,
    },
    /// Another client of the core has loaded a program.
    LoadedElsewhere {
        /// Its name.
        program: String,
    },
    /// A page took control.
    ControlTaken {
        /// Its number.
        #[ts(type = "number")]
        page: u64,
        /// The page that had it.
        #[ts(type = "number | null")]
        from: Option<u64>,
    },
    /// A page returned control.
    ControlReturned {
        /// Its number.
        #[ts(type = "number")]
        page: u64,
    },
    /// A page had control, sent nothing for 3 s, and lost it.
    ControlExpired {
        /// Its number.
        #[ts(type = "number")]
        page: u64,
    },
    /// A page had control and has disconnected.
    ControlDisconnected {
        /// Its number.
        #[ts(type = "number")]
        page: u64,
    },
    /// A page sent too many messages and was disconnected.
    TooManyMessages {
        /// Its number.
        #[ts(type = "number")]
        page: u64,
    },
}

impl LogFact {
    /// The same in English, for other clients.
    #[must_use]
    pub fn sentence(&self) -> String {
        match self {
            Self::Accepted { command, page } => format!("{command} by page {page}"),
            Self::Rejected {
                command,
                page,
                reason,
                ..
            } => format!("{command} by page {page} was rejected: {reason}"),
            Self::Loaded { program } => format!("LOAD {program}: accepted"),
            Self::NotLoaded { program, reason, .. } => format!("LOAD {program}: {reason}"),
            Self::ProgramChanged { program } => format!("{program} has changed"),
            Self::LoadedElsewhere { program } => format!("{program} was loaded by another client"),
            Self::ControlTaken { page, from: None } => format!("page {page} took control"),
            Self::ControlTaken {
                page,
                from: Some(from),
            } => format!("page {page} took control from page {from}"),
            Self::ControlReturned { page } => format!("page {page} returned control"),
            Self::ControlExpired { page } => {
                format!("page {page} has sent nothing for 3 s and has lost control")
            }
            Self::ControlDisconnected { page } => {
                format!("page {page}, which had control, has disconnected")
            }
            Self::TooManyMessages { page } => {
                format!("page {page} sent too many messages and was disconnected")
            }
        }
    }
}

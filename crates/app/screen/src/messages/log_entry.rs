//! The log of the screen.

use serde::Serialize;
use ts_rs::TS;

use super::LogFact;

/// What an entry is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, TS)]
#[serde(rename_all = "snake_case")]
pub enum LogKind {
    /// An alarm came.
    Alarm,
    /// A warning came.
    Warning,
    /// A command was accepted or rejected.
    Command,
    /// A program's message to the operator.
    Message,
    /// Pages came, went, took the lease.
    Link,
}

/// One entry. The server keeps the newest for pages that come later.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct LogEntry {
    /// Grows by one.
    #[ts(type = "number")]
    pub id: u64,
    /// ms since 1970.
    #[ts(type = "number")]
    pub at: u64,
    /// What it is about.
    pub kind: LogKind,
    /// Number of the alarm.
    pub number: Option<u32>,
    /// What happened, in English.
    pub text: String,
    /// The same by code and fields, where it is the server that says it: the sentences of alarms and messages
    /// are of the core.
    pub fact: Option<LogFact>,
    /// What to do.
    pub cure: Option<String>,
}

//! A recorded run in the list of traces.

use serde::Serialize;
use ts_rs::TS;

/// A file of the trace folder.
#[derive(Clone, Debug, Default, PartialEq, Serialize, TS)]
pub struct TraceEntry {
    /// Its file's name.
    pub name: String,
    /// Its size.
    #[ts(type = "number")]
    pub bytes: u64,
    /// When it was written last, ms since 1970.
    #[ts(type = "number")]
    pub modified: u64,
    /// It is being written.
    pub is_open: bool,
    /// Name of the machine.
    pub machine: String,
    /// Name of the program; empty for the session of a served machine.
    pub program: String,
    /// When it began, ms since 1970; 0 where that is not known.
    #[ts(type = "number")]
    pub started: u64,
    /// Its length, s; 0 where that is not known.
    pub duration_s: f64,
    /// Why it cannot be read; empty where it can.
    pub problem: String,
}

/// A program or block of MDI in the trace of a served machine.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct TraceJob {
    /// Its number.
    pub job: u32,
    /// What it was.
    pub name: String,
    /// When it began, s from the beginning of the trace.
    pub start_s: f64,
}

//! Errors and warnings of a program.

use serde::Serialize;
use ts_rs::TS;

/// One error or warning, with its place, as `evolvent check --json` gives it.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct Finding {
    /// Physical line, from 1.
    pub line: u32,
    /// Column, from 1; 0 where the line is meant.
    pub column: u32,
    /// Characters concerned.
    pub length: u32,
    /// Stable number such as `G0103`; empty for a warning.
    pub code: String,
    /// One sentence with the figures in it.
    pub message: String,
    /// What to write instead.
    pub help: String,
    /// The file, where it is one of a subroutine.
    pub file: Option<String>,
}

//! The loaded program.

use serde::Serialize;
use ts_rs::TS;

use super::Finding;

/// The program that pages show: the one that the core has loaded, or an upload that it has rejected.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct ProgramInfo {
    /// Its file's name.
    pub name: String,
    /// Number of its text, of uploads that of the upload: another one is another text, even of the same name
    /// and size.
    #[ts(type = "number")]
    pub upload: u64,
    /// Its file, as START names it and the status tells it; the status truncates a long one.
    pub file: String,
    /// Why its text cannot be shown, and so is not started from a page; none where it can.
    pub problem: Option<String>,
    /// Its size.
    #[ts(type = "number")]
    pub bytes: u64,
    /// What is wrong.
    pub errors: Vec<Finding>,
    /// What is probably not meant.
    pub warnings: Vec<Finding>,
    /// Whether it has been checked.
    pub checked: bool,
    /// Planned time, s, once it is known.
    pub planned_s: Option<f64>,
}

//! The loaded program.

use serde::Serialize;
use ts_rs::TS;

use super::Finding;

/// The program that was loaded from a page.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct ProgramInfo {
    /// Its file's name.
    pub name: String,
    /// Number of its upload: another one is another text, even of the same name and size.
    #[ts(type = "number")]
    pub upload: u64,
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

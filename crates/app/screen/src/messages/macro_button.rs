//! Macros: blocks of MDI behind a button.

use serde::Serialize;
use ts_rs::TS;

/// A button.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, TS)]
pub struct MacroButton {
    /// Its label.
    pub name: String,
    /// What it does, for the operator.
    pub note: String,
    /// Blocks of MDI, run one after the other.
    pub blocks: Vec<String>,
    /// The operator is asked first.
    pub confirm: bool,
}

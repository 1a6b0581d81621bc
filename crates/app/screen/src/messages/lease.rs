//! Who may command.

use serde::Serialize;
use ts_rs::TS;

/// Who may command, as one page sees it.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct Lease {
    /// This page may.
    pub mine: bool,
    /// Name of the page that may, if any does.
    pub holder: Option<String>,
    /// This page may only watch.
    pub read_only: bool,
}

//! Who may command.

use serde::Serialize;
use ts_rs::TS;

/// Who may command, as one page sees it.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct Lease {
    /// This page may.
    pub mine: bool,
    /// Number of this page. An upload names it.
    #[ts(type = "number")]
    pub page: u64,
    /// Number of the page that may, if any does.
    #[ts(type = "number | null")]
    pub holder: Option<u64>,
    /// This page may only watch.
    pub read_only: bool,
}

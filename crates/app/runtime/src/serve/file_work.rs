//! What other threads read, check and write for the operator.

use std::sync::mpsc::Receiver;

use super::checking::Checking;
use super::files::{Readers, Reading};
use super::state_store::Saved;

/// Work on files that is under way.
#[derive(Default)]
pub(super) struct FileWork {
    pub(super) readers: Readers,
    /// The command whose files are being read.
    pub(super) reading: Option<Reading>,
    /// The check of a program that is long, or has a long loop.
    pub(super) checking: Option<Checking>,
    /// What of programs could not be checked, for the log.
    pub(super) cautions: Vec<String>,
    /// The way to the middle of the program, on its way.
    pub(super) way: Option<Receiver<String>>,
    /// The tool in the spindle is being written.
    pub(super) tool_savings: Vec<Receiver<Saved>>,
}

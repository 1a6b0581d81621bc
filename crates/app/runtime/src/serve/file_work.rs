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
    /// The check of a long program.
    pub(super) checking: Option<Checking>,
    /// The way to the middle of the program, on its way.
    pub(super) way: Option<Receiver<String>>,
    /// The tool in the spindle is being written.
    pub(super) tool_savings: Vec<Receiver<Saved>>,
}

//! Work that other threads do on files for the operator.

use std::sync::mpsc::Receiver;

use super::checking::Checking;
use super::files::{Readers, Reading};
use super::state_store::Saved;

/// File work in progress.
#[derive(Default)]
pub(super) struct FileWork {
    pub(super) readers: Readers,
    /// The command whose files are being read.
    pub(super) reading: Option<Reading>,
    /// The check of a program that is long or has a long loop.
    pub(super) checking: Option<Checking>,
    /// Parts of programs that could not be checked, for the log.
    pub(super) cautions: Vec<String>,
    /// The approach to a line in the middle of the program, while it is being computed.
    pub(super) approach: Option<Receiver<String>>,
    /// Records of the tool in the spindle that are being written.
    pub(super) tool_savings: Vec<Receiver<Saved>>,
}

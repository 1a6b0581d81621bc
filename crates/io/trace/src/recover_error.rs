//! Errors of a recovery, and the remedy.

use std::io;
use std::path::{Path, PathBuf};

use crate::read_error::{is_wrong_name, unreadable};

/// Why a trace could not be recovered. The original is untouched.
#[derive(Debug, thiserror::Error)]
pub enum RecoverError {
    /// The file cannot be opened or read.
    #[error("{}", unreadable(.path, .source))]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A running recorder holds the file.
    #[error("{} is still being written; end that run first", .path.display())]
    InUse {
        /// The file.
        path: PathBuf,
    },
    /// Not an MCAP file, or nothing of it is left.
    #[error("{}", nothing_left(.path, *.bytes))]
    NotATrace {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// The recovered file cannot be written.
    #[error("{} cannot be written: {source}; free some space or name another file with -o", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

impl RecoverError {
    /// Whether the name is wrong rather than the file.
    #[must_use]
    pub fn is_wrong_name(&self) -> bool {
        match self {
            Self::Read { source, .. } => is_wrong_name(source),
            Self::NotATrace { path, .. } => !is_part(path),
            _ => false,
        }
    }
}

/// Whether the name is that of an unfinished recording.
fn is_part(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "part")
}

fn nothing_left(path: &Path, bytes: u64) -> String {
    let name = path.display();
    if is_part(path) {
        return format!(
            "{name} has {bytes} bytes, but they do not start as a trace: the run was aborted before \
             anything was written; there is nothing to recover, remove it"
        );
    }
    format!(
        "{name} is not a trace: its {bytes} bytes do not start as an MCAP file; name a truncated trace, such \
         as the NAME.mcap.part of an aborted run"
    )
}

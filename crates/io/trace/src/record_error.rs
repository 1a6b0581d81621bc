//! Errors of recording, and the state of the file after them.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;

/// The state of a trace whose recording failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Remains {
    /// The file was cut back to its last complete chunk and closed: it is readable and indexed, under its
    /// final name.
    Complete,
    /// The file could not be closed; it must be recovered.
    NeedsRecovery,
}

impl std::fmt::Display for Remains {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Complete => "what was written before is complete and readable",
            Self::NeedsRecovery => "recover what was written before with `evolvent trace recover`",
        })
    }
}

/// Why recording failed. Cheap to clone: a failed recorder returns the same error from every call.
#[derive(Clone, Debug, thiserror::Error)]
pub enum RecordError {
    /// The run's description cannot be recorded.
    #[error("the run cannot be recorded: {reason}; correct the machine file or the caller")]
    Invalid {
        /// What is wrong, with its number.
        reason: String,
    },
    /// There is a part file of this name already.
    #[error(
        "{} is left over from an earlier run or written by another one; recover it with \
         `evolvent trace recover`, remove it or choose another name", .part.display()
    )]
    LeftOver {
        /// The part file.
        part: PathBuf,
    },
    /// The name belongs to a folder.
    #[error("{} is a folder, and a trace is one file: name it, as in \
     {}", .path.display(), .path.join("session.mcap").display())]
    Folder {
        /// As it was given.
        path: PathBuf,
    },
    /// The file cannot be created.
    #[error("the trace {} cannot be created: {source}; choose another file with --trace", .path.display())]
    Create {
        /// The part file.
        path: PathBuf,
        /// Why.
        source: Arc<io::Error>,
    },
    /// The program cannot be read for its attachment.
    #[error("{} cannot be attached to the trace: {source}; make it readable", .path.display())]
    Attach {
        /// The program's file.
        path: PathBuf,
        /// Why.
        source: Arc<io::Error>,
    },
    /// The disk is full.
    #[error(
        "no space left for the trace {} after {bytes} bytes: {source}; free some or choose another disk \
         with --trace; {remains}", .path.display()
    )]
    DiskFull {
        /// The file as it is named now.
        path: PathBuf,
        /// Bytes that are complete.
        bytes: u64,
        /// Whether the file is readable.
        remains: Remains,
        /// The error of the operating system.
        source: Arc<io::Error>,
    },
    /// Writing failed for another reason.
    #[error("the trace {} cannot be written after {bytes} bytes: {source}; check the disk; {remains}", .path.display())]
    Write {
        /// The file as it is named now.
        path: PathBuf,
        /// Bytes that are complete.
        bytes: u64,
        /// Whether the file is readable.
        remains: Remains,
        /// The error of the operating system.
        source: Arc<io::Error>,
    },
    /// The finished file could not get its name.
    #[error("the trace is complete in {}, but cannot be renamed to {}: {source}; rename it", .from.display(), .to.display())]
    Rename {
        /// The part file.
        from: PathBuf,
        /// The name it should have.
        to: PathBuf,
        /// Why.
        source: Arc<io::Error>,
    },
}

fn is_full(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge
    )
}

/// The error of a failed write: a full disk, or another reason.
pub(crate) fn write_error(
    path: PathBuf,
    bytes: u64,
    remains: Remains,
    source: Arc<io::Error>,
) -> RecordError {
    if is_full(&source) {
        RecordError::DiskFull {
            path,
            bytes,
            remains,
            source,
        }
    } else {
        RecordError::Write {
            path,
            bytes,
            remains,
            source,
        }
    }
}

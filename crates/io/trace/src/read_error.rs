//! Why a trace cannot be read, and the remedy.

use std::io;
use std::path::{Path, PathBuf};

use crate::recorder::part_path;

/// Why a trace cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("{}", unreadable(.path, .source))]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not an MCAP file.
    #[error("{} is not a trace: {}; give a file written by `evolvent run` or `evolvent serve`", .path.display(), no_trace(*.bytes))]
    NotATrace {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// The file has no end: it is still being written or truncated.
    #[error("{}", unfinished(.path, *.is_being_written))]
    Unfinished {
        /// The file.
        path: PathBuf,
        /// A recorder holds it.
        is_being_written: bool,
    },
    /// A part of the file is damaged.
    #[error(
        "{} is damaged at byte {offset}: {what}; save the intact part with `evolvent trace recover`", .path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where.
        offset: u64,
        /// What is damaged.
        what: &'static str,
    },
    /// An MCAP file of another program, or one whose description was lost.
    #[error(
        "{} does not contain what was run: its metadata `evolvent.run` is missing; the file is from another \
         program, or the metadata was lost before the recovery: use another copy", .path.display()
    )]
    NoRun {
        /// The file.
        path: PathBuf,
    },
}

impl ReadError {
    /// Whether the name is wrong rather than the file.
    #[must_use]
    pub fn is_wrong_name(&self) -> bool {
        match self {
            Self::NotATrace { .. } => true,
            Self::Io { source, .. } => is_wrong_name(source),
            _ => false,
        }
    }
}

/// Whether there is no file of that name.
pub(crate) fn is_wrong_name(source: &io::Error) -> bool {
    matches!(
        source.kind(),
        io::ErrorKind::NotFound
            | io::ErrorKind::IsADirectory
            | io::ErrorKind::NotADirectory
            | io::ErrorKind::InvalidInput
    )
}

fn unfinished(path: &Path, is_being_written: bool) -> String {
    let name = path.display();
    if is_being_written {
        format!(
            "{name} is still being written: it is complete when its run ends; to read it now, copy it and \
             run `evolvent trace recover` on the copy"
        )
    } else {
        format!(
            "{name} has no end: its run was aborted, or it was truncated; run `evolvent trace recover` on it"
        )
    }
}

fn no_trace(bytes: u64) -> &'static str {
    match bytes {
        0 => "it is empty",
        _ => "it does not start as an MCAP file",
    }
}

/// Why a file cannot be opened or read, and the remedy.
pub(crate) fn unreadable(path: &Path, source: &io::Error) -> String {
    let name = path.display();
    let part = part_path(path);
    match source.kind() {
        io::ErrorKind::NotFound if part.exists() => {
            let part = part.display();
            format!(
                "{name} does not exist, but {part} does: its run continues, or was aborted; end the run, or \
                 save the recorded part with `evolvent trace recover {part}`"
            )
        }
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => format!(
            "{name} does not exist; check the name: runs write traces/PROGRAM-TIME.mcap in the folder where \
             they were started, unless --trace names another file"
        ),
        io::ErrorKind::IsADirectory => format!("{name} is a folder; name one of the traces in it"),
        // A pipe or a device.
        io::ErrorKind::InvalidInput => format!("{name} is not a trace: {source}"),
        io::ErrorKind::PermissionDenied => {
            format!(
                "{name} cannot be read by this user: {source}; ask its owner to make it readable, or copy it"
            )
        }
        _ => format!("{name} cannot be read: {source}; check its disk or network, and try again"),
    }
}

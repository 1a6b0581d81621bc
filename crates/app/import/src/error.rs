//! Why a configuration cannot become a machine file.

use std::path::PathBuf;

/// Why a configuration cannot become a machine file, with the position and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// A file cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// An unusable line.
    #[error("{}:{line}: {what}; {advice}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: u32,
        /// The error.
        what: String,
        /// The remedy.
        advice: String,
    },
    /// Something that the whole configuration lacks.
    #[error("{}: {what}; {advice}", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The error.
        what: String,
        /// The remedy.
        advice: String,
    },
    /// The resulting machine file is invalid.
    #[error("{}: the values give no valid machine: {reason}", path.display())]
    Machine {
        /// The INI file.
        path: PathBuf,
        /// The message of the machine file's own check.
        reason: String,
    },
    /// A file cannot be written.
    #[error("{}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file of that name exists.
    #[error("{} exists already; give another name with --output, or --force to replace it", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// A file to write is one that was read, or two of them are one file; `--force` does not permit this.
    #[error(transparent)]
    Conflict(#[from] evolvent_config::OutputConflict),
    /// The machine file has another extension and could have the name of one of its tables.
    #[error("{}: a machine file has the extension .toml; name another file with --output", path.display())]
    Extension {
        /// The machine file.
        path: PathBuf,
    },
}

//! Why a configuration cannot become a machine file.

use std::path::PathBuf;

/// Why a configuration cannot become a machine file, with the place and what to do.
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
    /// A line that cannot be used.
    #[error("{}:{line}: {what}; {advice}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: u32,
        /// What is wrong.
        what: String,
        /// What to do.
        advice: String,
    },
    /// Something that the whole configuration lacks.
    #[error("{}: {what}; {advice}", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
        /// What to do.
        advice: String,
    },
    /// The machine file that came out is not accepted.
    #[error("{}: the values give no valid machine: {reason}", path.display())]
    Machine {
        /// The INI file.
        path: PathBuf,
        /// What the machine file's own check says.
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
}

//! Why a file was refused.

use thiserror::Error;

/// Why a file was refused. Each message names the place and says what to do.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ConfigError {
    /// The text is not TOML, or not JSON.
    #[error("{file}:{line}:{column}: not valid {format}: {what}")]
    Syntax {
        /// The file as given.
        file: String,
        /// "TOML" or "JSON".
        format: &'static str,
        /// Line, from 1.
        line: usize,
        /// Column in characters, from 1.
        column: usize,
        /// What the parser expected.
        what: String,
    },
    /// A key is unknown, missing or of the wrong kind, or its value makes no sense.
    #[error("{file}:{line}:{column}: {key}: {what}; {advice}")]
    Key {
        /// The file as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Column in characters, from 1.
        column: usize,
        /// Dotted key: `mode[1].frequency_hz`.
        key: String,
        /// What is wrong, with the numbers.
        what: String,
        /// What to do.
        advice: String,
    },
}

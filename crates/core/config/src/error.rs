//! Errors of configuration files.

use thiserror::Error;

/// The reason why a file is rejected. Each message names the position and the remedy.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ConfigError {
    /// The text is not TOML, or not JSON.
    #[error("{file}:{line}:{column}: not valid {format}: {what}")]
    Syntax {
        /// The file name.
        file: String,
        /// "TOML" or "JSON".
        format: &'static str,
        /// Line, from 1.
        line: usize,
        /// Column in characters, from 1.
        column: usize,
        /// The message of the parser.
        what: String,
    },
    /// A key is unknown, missing or of the wrong type, or its value is invalid.
    #[error("{file}:{line}:{column}: {key}: {what}; {advice}")]
    Key {
        /// The file name.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Column in characters, from 1.
        column: usize,
        /// Dotted key: `mode[1].frequency_hz`.
        key: String,
        /// The problem, with its numbers.
        what: String,
        /// The remedy.
        advice: String,
    },
}

//! Errors of machine files and of control rates.

use evolvent_config::ConfigError;

use crate::machine::{MAX_RATE_HZ, MIN_RATE_HZ};
use crate::rate::RateError;

/// The reason why a machine file is rejected. Each message names the position and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum MachineError {
    /// The file cannot be read.
    #[error("{file}: cannot read the machine file: {source}; check the path and its permissions")]
    Read {
        /// The file name.
        file: String,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file exceeds the maximum length.
    #[error("{file}: longer than {limit_bytes} bytes, so it is not a machine file; check the path")]
    TooLong {
        /// The file name.
        file: String,
        /// The maximum length.
        limit_bytes: u64,
    },
    /// The file is not text.
    #[error("{file}: not UTF-8 text at byte {byte}; save the file as UTF-8")]
    NotText {
        /// The file name.
        file: String,
        /// Offset of the first invalid byte.
        byte: usize,
    },
    /// The text is not TOML; or a key is unknown, missing or of the wrong type, or its value is invalid.
    #[error(transparent)]
    ConfigDocument(#[from] ConfigError),
}

/// The reason why a control rate is not possible.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PeriodError {
    /// The rate is out of range.
    #[error(
        "a control rate of {rate_hz} Hz is outside {MIN_RATE_HZ} to {MAX_RATE_HZ} Hz: choose one between, \
         or \"rational\""
    )]
    OutOfBounds {
        /// The requested rate, Hz.
        rate_hz: f64,
    },
    /// The machine's limits give no rational rate.
    #[error(transparent)]
    Rational(#[from] RateError),
}

//! What can be wrong with a machine file, and with a control rate.

use evolvent_config::ConfigError;

use crate::machine::{MAX_RATE_HZ, MIN_RATE_HZ};
use crate::rate::RateError;

/// Why a machine file was refused. Each message names the place and says what to do.
#[derive(Debug, thiserror::Error)]
pub enum MachineError {
    /// The file cannot be read.
    #[error("{file}: cannot read the machine file: {source}; check the path and its permissions")]
    Read {
        /// The file as given.
        file: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is longer than any machine file.
    #[error("{file}: longer than {limit_bytes} bytes: this is no machine file; check the path")]
    TooLong {
        /// The file as given.
        file: String,
        /// The limit.
        limit_bytes: u64,
    },
    /// The file is not text.
    #[error("{file}: not UTF-8 text at byte {byte}; save the file as UTF-8")]
    NotText {
        /// The file as given.
        file: String,
        /// The first byte that is not text.
        byte: usize,
    },
    /// The text is no TOML; or a key is unknown, missing or of the wrong kind, or its value makes no sense.
    #[error(transparent)]
    ConfigDocument(#[from] ConfigError),
}

/// Why a control rate cannot be run.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PeriodError {
    /// Outside what the loop runs.
    #[error(
        "a control rate of {rate_hz} Hz is outside {MIN_RATE_HZ} to {MAX_RATE_HZ} Hz: choose one between, or \"rational\""
    )]
    OutOfBounds {
        /// As asked for, Hz.
        rate_hz: f64,
    },
    /// The machine's limits give no rational rate.
    #[error(transparent)]
    Rational(#[from] RateError),
}

//! Reads user-written configuration files, with errors that name file, line, column and key, and writes
//! results whole.
//!
//! Input: the text of a TOML or JSON file. Output: a deserialized type, or a [`ConfigError`] that says what
//! is wrong, where, and what to do. [`ConfigDocument`] keeps the positions of all keys, so that checks after
//! deserialization can name them too. [`shortened`] and [`plain`] format values in messages.
//!
//! ```
//! use evolvent_config::ConfigDocument;
//! #[derive(serde::Deserialize)]
//! struct Mode {
//!     frequency_hz: f64,
//! }
//! let document = ConfigDocument::parse("frequency_hz = -3.0", "mode.toml")?;
//! let mode: Mode = document.read()?;
//! let error = document.number("frequency_hz", mode.frequency_hz, 0.1, 1e5).unwrap_err();
//! assert_eq!(
//!     error.to_string(),
//!     "mode.toml:1:1: frequency_hz: -3 is out of range; give a number from 0.1 to 100000"
//! );
//! # Ok::<(), evolvent_config::ConfigError>(())
//! ```
//!
//! [`open_regular`], [`read_regular`] and [`read_text`] open regular files only, with a time limit.
//! [`OutputFile`], [`write_whole`] and [`write_new`] write a file completely or not at all; [`check_outputs`] compares the
//! files that a command writes with those that it reads. [`ProgramNumber`] writes numbers of part programs.
//!
//! # Guarantees
//!
//! No input panics. Messages are single lines of bounded length. Everything allocates: use it at start-up,
//! not in the cycle.

mod config_document;
mod error;
mod file;
mod output_conflict;
mod output_file;
mod position;
mod program_number;
mod text_file;
mod words;

pub use config_document::ConfigDocument;
pub use error::ConfigError;
pub use file::{FILE_TIMEOUT, no_reply, open_regular, read_regular, within};
pub use output_conflict::{OutputConflict, check_outputs};
pub use output_file::{OutputFile, is_stream, write_new, write_whole};
pub use program_number::ProgramNumber;
pub use text_file::{TextFileError, read_text};
pub use words::{plain, shortened};

//! Files that people write, read so that every error names file, line, column and key.
//!
//! [`ConfigDocument`] reads a TOML or JSON text as a type and checks numbers by their dotted keys. [`shortened`] and [`plain`]
//! format values in messages.
//!
//! ```
//! use evolvent_config::ConfigDocument;
//! #[derive(serde::Deserialize)]
//! struct Mode {
//!     frequency_hz: f64,
//! }
//! let sheet = ConfigDocument::parse("frequency_hz = -3.0", "mode.toml")?;
//! let mode: Mode = sheet.read()?;
//! let refused = sheet.number("frequency_hz", mode.frequency_hz, 0.1, 1e5).unwrap_err();
//! assert_eq!(
//!     refused.to_string(),
//!     "mode.toml:1:1: frequency_hz: -3 is out of range; give a number from 0.1 to 100000"
//! );
//! # Ok::<(), evolvent_config::ConfigError>(())
//! ```
//!
//! Files are opened by [`open_regular`] and [`read_regular`]: regular ones only, with a time limit.
//!
//! All of it allocates: for start-up, not for the cycle.

mod config_document;
mod error;
mod file;
mod place;
mod words;

pub use config_document::ConfigDocument;
pub use error::ConfigError;
pub use file::{FILE_TIMEOUT, no_reply, open_regular, read_regular, within};
pub use words::{plain, shortened};

//! Setups without a program.

use std::path::Path;

use evolvent_machine::{ControlRate, Machine};
use evolvent_runtime::Setup;

use crate::error::AnalysisError;
use crate::user_file::read_text;

/// Reads and checks a machine file without a program, at the given rate or that of the file.
///
/// # Errors
/// An unreadable or invalid file.
pub fn load_setup(file: &Path, rate: Option<ControlRate>) -> Result<Setup, AnalysisError> {
    let usage = |text: String| AnalysisError::Input(text);
    let machine = Machine::load(file).map_err(|error| usage(error.to_string()))?;
    let text = read_text(file, "machine file")?;
    Setup::new(machine, file.to_path_buf(), text, rate).map_err(|error| usage(error.to_string()))
}

//! User-written files: regular files only, with a time limit and a maximum size.

use std::path::Path;

use crate::error::AnalysisError;

/// Maximum size of a settings file, bytes: as for the machine file.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// The text of a settings file; `kind` names it in errors.
///
/// # Errors
/// A file that cannot be read in time, is not a regular file, is too long, or is not text.
pub fn read_text(file: &Path, kind: &str) -> Result<String, AnalysisError> {
    evolvent_config::read_text(file, MAX_FILE_BYTES, kind)
        .map(|(text, _)| text)
        .map_err(|error| AnalysisError::Input(error.to_string()))
}

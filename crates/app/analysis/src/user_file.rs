//! User-written files: regular files only, with a time limit and a maximum size. Results are written
//! atomically.

use std::io::Write as _;
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

/// Writes a file atomically: into a temporary file beside it, which is then renamed.
///
/// # Errors
/// The directory is not writable, or the disk is full.
pub fn write_whole(file: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut name = std::ffi::OsString::from(".");
    name.push(file.file_name().unwrap_or_default());
    name.push(format!(".{}.part", std::process::id()));
    let beside = file.with_file_name(name);
    let written = std::fs::File::create(&beside).and_then(|mut part| {
        part.write_all(bytes)?;
        part.sync_all()?;
        std::fs::rename(&beside, file)
    });
    if written.is_err() {
        // A second failure adds nothing: the first error gives the cause.
        let _ = std::fs::remove_file(&beside);
    }
    written
}

//! User-written files: regular files only, with a time limit and a maximum size. Results are written
//! atomically.

use std::io::Write as _;
use std::path::Path;

use evolvent_config::read_regular;

use crate::error::AnalysisError;

/// Maximum size of a settings file, bytes: as for the machine file.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// The text of a settings file; `kind` names it in errors.
///
/// # Errors
/// A file that cannot be read in time, is not a regular file, is too long, or is not text.
pub fn read_text(file: &Path, kind: &str) -> Result<String, AnalysisError> {
    let usage = |what: String| AnalysisError::Input(format!("{}: {what}", file.display()));
    let bytes = read_regular(file, MAX_FILE_BYTES).map_err(|error| {
        usage(format!(
            "cannot read the {kind}: {error}; check the path and its permissions"
        ))
    })?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(usage(format!(
            "longer than {MAX_FILE_BYTES} bytes: this is no {kind}; check the path"
        )));
    }
    String::from_utf8(bytes).map_err(|error| {
        let byte = error.utf8_error().valid_up_to();
        usage(format!("not UTF-8 text at byte {byte}; save the file as UTF-8"))
    })
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

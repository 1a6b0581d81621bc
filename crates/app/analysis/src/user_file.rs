//! User-written files: regular ones only, within a time limit, as long as such a file can be. Results: whole files or none.

use std::io::Write as _;
use std::path::Path;

use evolvent_config::read_regular;

use crate::error::AnalysisError;

/// Longest file of settings, bytes: as of the machine file.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// The text of a file of settings; `kind` names it in errors.
///
/// # Errors
/// A file that cannot be read in time, is no regular file, is too long, or is no text.
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

/// Writes a file so that there is the old one or the whole new one, never a part: beside it, then renamed.
///
/// # Errors
/// The folder cannot be written to, or the disk is full.
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
        // Nothing to add if this fails too: the first error says why.
        let _ = std::fs::remove_file(&beside);
    }
    written
}

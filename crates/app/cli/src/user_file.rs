//! Files that users write and name on the command line: regular ones only, within a time limit, as long as such a file can be.

use std::path::Path;

use evolvent_config::{FILE_TIMEOUT, open_regular, read_regular, within};

use crate::CommandError;

/// Longest file of settings, bytes: as of the machine file.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// The text of a file of settings; `kind` names it in errors.
///
/// # Errors
/// A file that cannot be read in time, is no regular file, is too long, or is no text.
pub(crate) fn read_text(file: &Path, kind: &str) -> Result<String, CommandError> {
    let usage = |what: String| CommandError::Usage(format!("{}: {what}", file.display()));
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

/// Makes sure that a program can be opened in time.
///
/// # Errors
/// It cannot.
pub(crate) fn try_program(file: &Path) -> Result<(), CommandError> {
    let path = file.to_path_buf();
    within(FILE_TIMEOUT, move || open_regular(&path).map(drop)).map_err(|error| {
        CommandError::Usage(format!(
            "{}: {error}; name a readable part program",
            file.display()
        ))
    })
}

//! Files that outlive a run: read whole and bounded, written aside and renamed.

use std::ffi::OsString;
use std::fs::File;
use std::io::{Error, Write as _};
use std::path::Path;

use crate::{ParameterFileError, ToolTableError};

/// Longest file of tools or parameters, in bytes.
const MAX_BYTES: u64 = 4 << 20;

/// Why a file of tools or parameters cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// It cannot be read.
    #[error("{file}: {source}; name a file that can be read")]
    Read {
        /// The file.
        file: String,
        /// Why not.
        source: Error,
    },
    /// It is too long to be one.
    #[error("{file} is longer than {limit_bytes} bytes; is it the right file?")]
    TooLong {
        /// The file.
        file: String,
        /// The limit.
        limit_bytes: u64,
    },
    /// It is no text.
    #[error("{file} is no text from byte {byte} on; save it as UTF-8")]
    NotText {
        /// The file.
        file: String,
        /// How many bytes are.
        byte: usize,
    },
    /// It is no tool table.
    #[error("{file}: {source}")]
    Tools {
        /// The file.
        file: String,
        /// What is wrong.
        source: ToolTableError,
    },
    /// It is no parameter file.
    #[error("{file}: {source}")]
    Parameters {
        /// The file.
        file: String,
        /// What is wrong.
        source: ParameterFileError,
    },
    /// It cannot be written; what was there before is still there.
    #[error("{file} cannot be written: {source}; free room or name another place")]
    Write {
        /// The file.
        file: String,
        /// Why not.
        source: Error,
    },
}

/// The text of a file; `None` where there is no such file.
pub(crate) fn read_text(path: &Path) -> Result<Option<String>, StoreError> {
    let file = || path.display().to_string();
    let failed = |source| StoreError::Read { file: file(), source };
    let bytes = match evolvent_config::read_regular(path, MAX_BYTES) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(failed(error)),
    };
    if bytes.len() as u64 > MAX_BYTES {
        return Err(StoreError::TooLong {
            file: file(),
            limit_bytes: MAX_BYTES,
        });
    }
    String::from_utf8(bytes)
        .map(Some)
        .map_err(|error| StoreError::NotText {
            file: file(),
            byte: error.utf8_error().valid_up_to(),
        })
}

/// Replaces a file, or leaves it as it is: whoever reads it sees the old or the new text, also after a power cut.
///
/// # Errors
/// It cannot be written.
pub fn replace_file(path: &Path, text: &str) -> Result<(), StoreError> {
    // A link stays one.
    let target = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    let mut name = OsString::from(".");
    name.push(target.file_name().unwrap_or_default());
    name.push(format!(".{}.part", std::process::id()));
    let beside = target.with_file_name(name);
    let written = File::create(&beside)
        .and_then(|mut part| {
            part.write_all(text.as_bytes())?;
            part.sync_all()
        })
        .and_then(|()| std::fs::rename(&beside, &target));
    if let Err(source) = written {
        // Nothing to add if this fails too: the first error says why.
        let _ = std::fs::remove_file(&beside);
        return Err(StoreError::Write {
            file: path.display().to_string(),
            source,
        });
    }
    // Some file systems cannot sync a folder; the new text is complete all the same.
    if let Some(folder) = target.parent() {
        let folder = if folder.as_os_str().is_empty() {
            Path::new(".")
        } else {
            folder
        };
        let _ = File::open(folder).and_then(|folder| folder.sync_all());
    }
    Ok(())
}

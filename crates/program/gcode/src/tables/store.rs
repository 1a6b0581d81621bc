//! Files that outlive a run: read completely with a size limit, and replaced atomically.

use std::io::Error;
use std::path::Path;

use evolvent_config::write_whole;

use crate::{ParameterFileError, ToolTableError};

/// Maximum size of a tool table or parameter file, in bytes.
const MAX_BYTES: u64 = 4 << 20;

/// The reason why a tool table or parameter file cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// It cannot be read.
    #[error("{file}: {source}; name a readable file")]
    Read {
        /// The file.
        file: String,
        /// The error of the operating system.
        source: Error,
    },
    /// It exceeds the maximum size.
    #[error("{file} is longer than {limit_bytes} bytes; is it the right file?")]
    TooLong {
        /// The file.
        file: String,
        /// The limit.
        limit_bytes: u64,
    },
    /// It is not text.
    #[error("{file} is not text at byte {byte}; save it as UTF-8")]
    NotText {
        /// The file.
        file: String,
        /// Offset of the first invalid byte.
        byte: usize,
    },
    /// It is not a tool table.
    #[error("{file}: {source}")]
    Tools {
        /// The file.
        file: String,
        /// The error.
        source: ToolTableError,
    },
    /// It is not a parameter file.
    #[error("{file}: {source}")]
    Parameters {
        /// The file.
        file: String,
        /// The error.
        source: ParameterFileError,
    },
    /// It cannot be written; the old contents are unchanged.
    #[error("{file} cannot be written: {source}; free disk space or name another file")]
    Write {
        /// The file.
        file: String,
        /// The error of the operating system.
        source: Error,
    },
}

/// The text of a file; `None` if it does not exist.
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

/// Replaces a file atomically: readers see either the old or the new text, also after a power failure.
///
/// # Errors
/// [`StoreError`] if it cannot be written.
pub fn replace_file(path: &Path, text: &str) -> Result<(), StoreError> {
    write_whole(path, text.as_bytes()).map_err(|source| StoreError::Write {
        file: path.display().to_string(),
        source,
    })
}

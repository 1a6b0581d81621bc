//! The text of a user-written file.

use std::io;
use std::path::Path;

use thiserror::Error;

use crate::file::read_regular;

/// Why a file cannot be read as text.
#[derive(Debug, Error)]
pub enum TextFileError {
    /// The file cannot be read.
    #[error("{file}: cannot read the {kind}: {source}; check the path and its permissions")]
    Read {
        /// The file as given.
        file: String,
        /// Kind of file, for example "board file".
        kind: String,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file is too long.
    #[error("{file}: longer than {max_bytes} bytes, too long for the {kind}; check the path")]
    TooLong {
        /// The file as given.
        file: String,
        /// Kind of file.
        kind: String,
        /// Maximum size.
        max_bytes: u64,
    },
    /// It is not UTF-8.
    #[error("{file}: not UTF-8 text at byte {byte}; save the file as UTF-8")]
    NotText {
        /// The file as given.
        file: String,
        /// Offset of the first invalid byte.
        byte: usize,
    },
}

/// The text of a regular file of at most `max_bytes`, and the name of the file for messages. `kind` is the
/// kind of file, for messages.
///
/// # Errors
/// The file cannot be read in time, is too long, or is not UTF-8.
pub fn read_text(path: &Path, max_bytes: u64, kind: &str) -> Result<(String, String), TextFileError> {
    let file = path.display().to_string();
    let bytes = match read_regular(path, max_bytes) {
        Ok(bytes) => bytes,
        Err(source) => {
            return Err(TextFileError::Read {
                file,
                kind: kind.to_owned(),
                source,
            });
        }
    };
    if bytes.len() as u64 > max_bytes {
        return Err(TextFileError::TooLong {
            file,
            kind: kind.to_owned(),
            max_bytes,
        });
    }
    match String::from_utf8(bytes) {
        Ok(text) => Ok((text, file)),
        Err(error) => Err(TextFileError::NotText {
            file,
            byte: error.utf8_error().valid_up_to(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_gives_no_text_is_named_with_its_cure() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("net.toml");
        let error = |max| {
            let text = read_text(&path, max, "network file").unwrap_err().to_string();
            text.replace(&format!("{}: ", path.display()), "")
        };
        assert!(error(9).starts_with("cannot read the network file: "));
        std::fs::write(&path, b"a = 1\n# \xff").unwrap();
        assert_eq!(error(9), "not UTF-8 text at byte 8; save the file as UTF-8");
        assert_eq!(
            error(8),
            "longer than 8 bytes, too long for the network file; check the path"
        );
        std::fs::write(&path, "a = 1").unwrap();
        assert_eq!(read_text(&path, 5, "network file").unwrap().0, "a = 1");
    }
}

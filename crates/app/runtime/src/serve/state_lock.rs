//! The lock of a state folder: only one core at a time writes to it.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read as _, Write as _};
use std::path::Path;

use crate::start_error::StartError;

/// Name of the file in the folder. The lock is the kernel's and ends with the process, however that ends.
const FILE: &str = "core.lock";
/// Maximum length of the file's text that is shown, bytes.
const MAX_BYTES: u64 = 200;

/// Keeps the folder locked until it is dropped.
#[derive(Debug)]
pub(crate) struct StateLock {
    /// `None` if the folder cannot be written: then nothing is written that two cores could mix up.
    _file: Option<File>,
}

impl StateLock {
    /// Locks the folder for the machine of this name.
    ///
    /// # Errors
    /// Another core has locked it.
    pub(crate) fn take(folder: &Path, machine_name: &str) -> Result<Self, StartError> {
        // If this fails, opening the file fails too, and writing reports why.
        let _ = std::fs::create_dir_all(folder);
        let opened = OpenOptions::new()
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .open(folder.join(FILE));
        let Ok(mut file) = opened else {
            return Ok(Self { _file: None });
        };
        if let Err(TryLockError::WouldBlock) = file.try_lock() {
            let mut holder = String::new();
            let _unread = (&file).take(MAX_BYTES).read_to_string(&mut holder);
            return Err(StartError::StateInUse {
                folder: folder.to_owned(),
                holder: holder.trim().to_owned(),
            });
        }
        // Used only in the error message of another core.
        let _unwritten = file
            .set_len(0)
            .and_then(|()| writeln!(file, "{machine_name}, process {}", std::process::id()));
        Ok(Self { _file: Some(file) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_has_one_core_and_the_next_one_after_it() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("made/on/demand");
        let first = StateLock::take(&inner, "mill").unwrap();
        let second = StateLock::take(&inner, "lathe").unwrap_err().to_string();
        assert!(
            second.contains("mill, process") && second.contains("--state"),
            "{second}"
        );
        drop(first);
        assert!(StateLock::take(&inner, "lathe").is_ok());
    }
}

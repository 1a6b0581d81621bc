//! The lock of a state folder: one core at a time writes it.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read as _, Write as _};
use std::path::Path;

use crate::start_error::StartError;

/// Name of the file in the folder. The lock is the kernel's: it ends with the process, however that ends.
const FILE: &str = "core.lock";
/// Longest text that is shown of the file, bytes.
const MAX_BYTES: u64 = 200;

/// Holds the folder until it is dropped.
#[derive(Debug)]
pub(crate) struct StateLock {
    /// None where the folder cannot be written: then nothing is written that two cores could mix.
    _file: Option<File>,
}

impl StateLock {
    /// Takes the folder for the machine of this name.
    ///
    /// # Errors
    /// Another core has it.
    pub(crate) fn take(folder: &Path, machine_name: &str) -> Result<Self, StartError> {
        // Where this fails, so does the file, and writing says why.
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
        // Only for the message of another core.
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

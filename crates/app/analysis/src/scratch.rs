//! A folder for the time of a command.

use std::path::{Path, PathBuf};

/// A folder of its own among the temporary ones; removed at the end.
pub(crate) struct Folder(PathBuf);

impl Folder {
    /// A new folder, whose name begins as said.
    ///
    /// # Errors
    /// The temporary folder cannot be written to.
    pub(crate) fn new(name: &str) -> std::io::Result<Self> {
        for number in 0..1000 {
            let folder = std::env::temp_dir().join(format!("{name}-{}-{number}", std::process::id()));
            match std::fs::create_dir(&folder) {
                Ok(()) => return Ok(Self(folder)),
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
        Err(std::io::Error::other("no room for a folder in the temporary one"))
    }

    /// Where it is.
    pub(crate) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What cannot be removed is left to who keeps the temporary folder.
        let _left = std::fs::remove_dir_all(&self.0);
    }
}

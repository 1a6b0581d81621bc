//! A temporary directory.

use std::path::{Path, PathBuf};

/// A unique temporary directory, removed on drop.
pub(crate) struct Folder(PathBuf);

impl Folder {
    /// Creates a directory whose name begins with the given prefix.
    ///
    /// # Errors
    /// The temporary directory is not writable.
    pub(crate) fn new(name: &str) -> std::io::Result<Self> {
        for number in 0..1000 {
            let folder = std::env::temp_dir().join(format!("{name}-{}-{number}", std::process::id()));
            match std::fs::create_dir(&folder) {
                Ok(()) => return Ok(Self(folder)),
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
        Err(std::io::Error::other(
            "the temporary folder has no free name for a folder",
        ))
    }

    /// The path.
    pub(crate) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // A directory that cannot be removed is left to the system's cleanup.
        let _left = std::fs::remove_dir_all(&self.0);
    }
}

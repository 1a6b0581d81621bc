use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

/// A file that is written either completely or not at all.
///
/// The bytes go to a hidden file in the same folder, which [`OutputFile::finish`] syncs to disk and renames.
/// Dropping it earlier removes the hidden file. A replaced file keeps its permissions, and a symbolic link
/// stays a link.
///
/// A device, a pipe or a socket is written directly: it has no content to protect, and a rename would replace
/// `/dev/null` by an ordinary file.
///
/// Not for the cycle: it waits for the disk.
///
/// ```
/// # use std::io::Write as _;
/// use evolvent_config::OutputFile;
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("table.csv");
/// let mut table = OutputFile::create(&path)?;
/// table.write_all(b"t_s,x_mm\n")?;
/// assert!(!path.exists());
/// assert_eq!(table.finish()?, 9);
/// assert_eq!(std::fs::read(&path)?, b"t_s,x_mm\n");
/// # Ok::<(), std::io::Error>(())
/// ```
#[derive(Debug)]
pub struct OutputFile {
    target: Target,
    bytes: u64,
}

#[derive(Debug)]
enum Target {
    /// Written to a temporary file beside the final path.
    Beside(NamedTempFile, PathBuf),
    Stream(File),
}

impl OutputFile {
    /// Starts to write; the present file remains until the end.
    ///
    /// # Errors
    /// The folder does not exist or is not writable, `path` is a folder, or the device cannot be opened.
    pub fn create(path: &Path) -> io::Result<Self> {
        let target = if is_stream(path) {
            Target::Stream(OpenOptions::new().write(true).open(path)?)
        } else {
            let path = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
            if path.is_dir() {
                return Err(io::ErrorKind::IsADirectory.into());
            }
            Target::Beside(hidden_file(&path)?, path)
        };
        Ok(Self { target, bytes: 0 })
    }

    /// Writes everything to disk under its final name; returns the number of bytes.
    ///
    /// # Errors
    /// The disk is full, or the file cannot be renamed. The previous file is then unchanged.
    pub fn finish(self) -> io::Result<u64> {
        match self.target {
            Target::Stream(mut stream) => stream.flush()?,
            Target::Beside(aside, path) => {
                aside.as_file().sync_all()?;
                aside.persist(&path).map_err(|error| error.error)?;
                // Some file systems cannot sync a folder; the file is complete in any case.
                let _ = File::open(folder_of(&path)).and_then(|folder| folder.sync_all());
            }
        }
        Ok(self.bytes)
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = match &mut self.target {
            Target::Beside(aside, _) => aside.write(bytes)?,
            Target::Stream(stream) => stream.write(bytes)?,
        };
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        match &mut self.target {
            Target::Beside(aside, _) => aside.flush(),
            Target::Stream(stream) => stream.flush(),
        }
    }
}

/// Writes a file completely, or leaves it unchanged; see [`OutputFile`].
///
/// # Errors
/// As [`OutputFile::create`] and [`OutputFile::finish`].
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut output = OutputFile::create(path)?;
    output.write_all(bytes)?;
    output.finish().map(drop)
}

/// Writes a file that does not exist, completely or not at all.
///
/// # Errors
/// The file exists, or the disk is full. An existing file is unchanged.
pub fn write_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut aside = hidden_file(path)?;
    aside.write_all(bytes)?;
    aside.as_file().sync_all()?;
    aside.persist_noclobber(path).map_err(|error| error.error)?;
    Ok(())
}

/// Whether a path names a device, a pipe or a socket instead of a file.
#[must_use]
pub fn is_stream(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir())
}

fn hidden_file(path: &Path) -> io::Result<NamedTempFile> {
    let mut prefix = OsString::from(".");
    prefix.push(path.file_name().ok_or(io::ErrorKind::InvalidFilename)?);
    prefix.push(".");
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // By default a temporary file is private to its owner; a new file gets the permissions of the user's
        // umask.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let aside = builder.tempfile_in(folder_of(path))?;
    if let Ok(earlier) = std::fs::metadata(path) {
        aside.as_file().set_permissions(earlier.permissions())?;
    }
    Ok(aside)
}

fn folder_of(path: &Path) -> &Path {
    path.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _, symlink};

    #[test]
    fn a_new_file_replaces_none_and_leaves_no_part() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("network.toml");
        write_new(&path, b"first").unwrap();
        let error = write_new(&path, b"second").unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(std::fs::read(&path).unwrap(), b"first");
        assert_eq!(names(folder.path()), ["network.toml"]);
        assert!(write_new(&folder.path().join("absent/network.toml"), b"first").is_err());
    }

    fn names(folder: &Path) -> Vec<OsString> {
        let mut names: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_that_is_dropped_leaves_the_earlier_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, "earlier").unwrap();
        let mut output = OutputFile::create(&path).unwrap();
        output.write_all(b"half").unwrap();
        drop(output);
        assert_eq!(std::fs::read(&path).unwrap(), b"earlier");
        assert_eq!(names(folder.path()), ["a"]);
    }

    #[test]
    fn a_device_stays_a_device() {
        // Uses its own device node if the user may create one: the test must not risk the host's /dev/null.
        let folder = tempfile::tempdir().unwrap();
        let node = folder.path().join("null");
        let made = std::process::Command::new("mknod")
            .args([node.as_os_str(), "c".as_ref(), "1".as_ref(), "3".as_ref()])
            .status()
            .is_ok_and(|status| status.success());
        if !made || OpenOptions::new().write(true).open(&node).is_err() {
            eprintln!("not measured: no device can be made here");
            return;
        }
        write_whole(&node, b"gone").unwrap();
        let found = std::fs::metadata(&node).unwrap();
        assert!(found.file_type().is_char_device());
        assert_eq!(names(folder.path()), ["null"]);
    }

    #[test]
    fn a_pipe_receives_the_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(
            std::process::Command::new("mkfifo")
                .arg(&pipe)
                .status()
                .unwrap()
                .success()
        );
        let (sender, received) = std::sync::mpsc::channel();
        let source = pipe.clone();
        std::thread::spawn(move || sender.send(std::fs::read(source).unwrap()));
        write_whole(&pipe, b"through").unwrap();
        let bytes = received.recv_timeout(std::time::Duration::from_secs(20));
        assert_eq!(bytes.expect("through the pipe"), b"through");
        assert!(std::fs::metadata(&pipe).unwrap().file_type().is_fifo());
        assert_eq!(names(folder.path()), ["pipe"]);
    }

    #[test]
    fn a_link_and_the_rights_of_its_file_stay() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        std::fs::write(&file, "earlier").unwrap();
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o640)).unwrap();
        symlink(&file, &link).unwrap();
        write_whole(&link, b"new").unwrap();
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(std::fs::read(&file).unwrap(), b"new");
        assert_eq!(
            std::fs::metadata(&file).unwrap().permissions().mode() & 0o777,
            0o640
        );
    }

    #[test]
    fn a_new_file_is_an_ordinary_one() {
        let folder = tempfile::tempdir().unwrap();
        let (made, plain) = (folder.path().join("made"), folder.path().join("plain"));
        write_whole(&made, b"").unwrap();
        std::fs::write(&plain, "").unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&made), mode(&plain));
    }

    #[test]
    fn a_folder_is_refused_and_nothing_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("inner");
        std::fs::create_dir(&inner).unwrap();
        let error = write_whole(&inner, b"x").unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::IsADirectory);
        assert!(write_whole(&folder.path().join("missing/file"), b"x").is_err());
        assert_eq!(names(folder.path()), ["inner"]);
        assert!(names(&inner).is_empty());
    }
}

//! Opening and reading files that people name: regular files only, and never without a time limit.

use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read as _, Result};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

/// How long opening and reading one file may take. A local disk takes milliseconds and a slow network share less than a
/// second; an NFS server that does not reply lets a reader hang for minutes, or for ever.
pub const FILE_TIMEOUT: Duration = Duration::from_secs(5);

/// Time between two attempts to open a file that another program holds with a lease.
const LEASE_POLL: Duration = Duration::from_millis(20);

/// Opens a regular file for reading.
///
/// Pipes, sockets, devices and folders are refused without being opened: opening a pipe waits for its writer. The call may
/// still hang where the file system does; threads that must not wait call [`within`].
///
/// # Errors
/// The operating system's reason, [`ErrorKind::InvalidInput`] for what is not a regular file, and
/// [`ErrorKind::TimedOut`] where another program does not release its lease in [`FILE_TIMEOUT`].
pub fn open_regular(path: &Path) -> Result<File> {
    let begin = Instant::now();
    loop {
        // Before it is opened, because opening a device may already do something.
        refuse_special(&std::fs::metadata(path)?)?;
        // Without waiting: the file may have been replaced by a pipe meanwhile.
        let opened = OpenOptions::new()
            .read(true)
            .custom_flags(libc::O_NONBLOCK)
            .open(path);
        match opened {
            Ok(file) => {
                refuse_special(&file.metadata()?)?;
                return Ok(file);
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                if begin.elapsed() >= FILE_TIMEOUT {
                    return Err(no_reply(FILE_TIMEOUT));
                }
                thread::sleep(LEASE_POLL);
            }
            Err(error) => return Err(error),
        }
    }
}

fn refuse_special(facts: &std::fs::Metadata) -> Result<()> {
    if facts.is_file() {
        return Ok(());
    }
    let what = if facts.is_dir() {
        "it is a folder"
    } else {
        "it is a pipe or a device, which may never end; save its content to a file first"
    };
    Err(Error::new(ErrorKind::InvalidInput, what))
}

/// Reads a regular file of at most `max_bytes`; of a longer one, `max_bytes + 1` bytes, so that the caller can tell.
///
/// It is read by another thread, which is left behind where the file system does not reply.
///
/// # Errors
/// As [`open_regular`], and [`ErrorKind::TimedOut`] after [`FILE_TIMEOUT`].
pub fn read_regular(path: &Path, max_bytes: u64) -> Result<Vec<u8>> {
    let path = path.to_path_buf();
    within(FILE_TIMEOUT, move || {
        let mut bytes = Vec::new();
        open_regular(&path)?.take(max_bytes + 1).read_to_end(&mut bytes)?;
        Ok(bytes)
    })
}

/// Does something with files on another thread, which is left behind where it does not end in time.
///
/// # Errors
/// What `work` returns, and [`ErrorKind::TimedOut`] after `timeout`.
pub fn within<T: Send + 'static>(
    timeout: Duration,
    work: impl FnOnce() -> Result<T> + Send + 'static,
) -> Result<T> {
    let (sender, receiver) = mpsc::channel();
    thread::Builder::new().name("files".into()).spawn(move || {
        let _too_late = sender.send(work());
    })?;
    match receiver.recv_timeout(timeout) {
        Ok(result) => result,
        Err(RecvTimeoutError::Timeout) => Err(no_reply(timeout)),
        Err(RecvTimeoutError::Disconnected) => Err(Error::other("its reader has panicked; please report it")),
    }
}

/// What is said of a file that cannot be read in time.
#[must_use]
pub fn no_reply(timeout: Duration) -> Error {
    let seconds = timeout.as_secs_f64();
    let text = format!(
        "no reply within {seconds} s; a network drive hangs or another program holds the file: copy it to a local disk"
    );
    Error::new(ErrorKind::TimedOut, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> std::path::PathBuf {
        let folder = std::env::temp_dir().join(format!("evolvent-config-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn pipes_devices_and_folders_are_refused_at_once() {
        let folder = folder("special");
        let pipe = folder.join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status().unwrap();
        assert!(made.success());
        let begin = Instant::now();
        for path in [&pipe, Path::new("/dev/zero"), &folder] {
            let error = read_regular(path, 100).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::InvalidInput, "{}", path.display());
        }
        assert!(begin.elapsed() < FILE_TIMEOUT, "{:?}", begin.elapsed());
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_file_is_read_up_to_one_byte_beyond_the_bound() {
        let folder = folder("bound");
        let file = folder.join("ten");
        std::fs::write(&file, b"0123456789").unwrap();
        assert_eq!(read_regular(&file, 10).unwrap(), b"0123456789");
        assert_eq!(read_regular(&file, 3).unwrap(), b"0123");
        let gone = read_regular(&folder.join("none"), 3).unwrap_err();
        assert_eq!(gone.kind(), ErrorKind::NotFound);
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn who_waits_for_a_reader_that_hangs_goes_on_in_time() {
        let begin = Instant::now();
        let hangs = || {
            thread::sleep(Duration::from_secs(600));
            Ok(())
        };
        let error = within(Duration::from_millis(50), hangs).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::TimedOut);
        assert!(begin.elapsed() < Duration::from_secs(60), "{:?}", begin.elapsed());
    }
}

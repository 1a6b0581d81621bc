//! Opens and reads user-supplied files: regular files only, and always with a time limit.

use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read as _, Result};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

/// Time limit for opening and reading one file. A local disk takes milliseconds and a slow network share less
/// than a second; an NFS server that does not respond blocks a reader for minutes or forever.
pub const FILE_TIMEOUT: Duration = Duration::from_secs(5);

/// Interval between attempts to open a file on which another program holds a lease.
const LEASE_POLL: Duration = Duration::from_millis(20);

/// Opens a regular file for reading.
///
/// Pipes, sockets, devices and folders are rejected without being opened: opening a pipe waits for its
/// writer. The call can still block if the file system does; threads that must not wait call [`within`].
///
/// # Errors
/// The error of the operating system, [`ErrorKind::InvalidInput`] for anything but a regular file, and
/// [`ErrorKind::TimedOut`] if another program does not release its lease within [`FILE_TIMEOUT`].
pub fn open_regular(path: &Path) -> Result<File> {
    let begin = Instant::now();
    loop {
        // Checked before opening, because opening a device may already have an effect.
        reject_special(&std::fs::metadata(path)?)?;
        // Non-blocking: a pipe may have replaced the file meanwhile.
        let opened = OpenOptions::new()
            .read(true)
            .custom_flags(libc::O_NONBLOCK)
            .open(path);
        match opened {
            Ok(file) => {
                reject_special(&file.metadata()?)?;
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

fn reject_special(facts: &std::fs::Metadata) -> Result<()> {
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

/// Reads a regular file of at most `max_bytes`; of a longer file, `max_bytes + 1` bytes, so that the caller
/// can detect it.
///
/// Another thread reads it; that thread is abandoned if the file system does not respond.
///
/// # Errors
/// Those of [`open_regular`], and [`ErrorKind::TimedOut`] after [`FILE_TIMEOUT`].
pub fn read_regular(path: &Path, max_bytes: u64) -> Result<Vec<u8>> {
    let path = path.to_path_buf();
    within(FILE_TIMEOUT, move || {
        let mut bytes = Vec::new();
        open_regular(&path)?.take(max_bytes + 1).read_to_end(&mut bytes)?;
        Ok(bytes)
    })
}

/// Runs `work` on another thread, which is abandoned if it does not finish in time.
///
/// # Errors
/// Those of `work`, and [`ErrorKind::TimedOut`] after `timeout`.
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
        Err(RecvTimeoutError::Disconnected) => {
            Err(Error::other("the reader thread panicked; please report this"))
        }
    }
}

/// The error for a file that cannot be read in time.
#[must_use]
pub fn no_reply(timeout: Duration) -> Error {
    let seconds = timeout.as_secs_f64();
    let text = format!(
        "no reply within {seconds} s; the network drive does not respond or another program holds the file: \
         copy it to a local disk"
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
    fn pipes_devices_and_folders_are_rejected_at_once() {
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
    fn a_caller_of_a_blocked_reader_continues_in_time() {
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

//! The destination of a trace: a file that is synchronized in the background, or another sink, such as a
//! test's.

use std::fs::File;
use std::io::{self, Seek as _, SeekFrom, Write as _};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// Accepts the bytes of a trace in order.
///
/// A trace is only ever appended to, so the disk is valid at every moment up to the last complete record;
/// nothing is written twice.
pub trait TraceSink: Send {
    /// Appends all bytes. `reserve` more may be needed to end the file; a sink that knows that the disk
    /// cannot take both fails at once and appends nothing, so that the file can still be ended.
    ///
    /// # Errors
    /// The reason why the bytes could not all be appended; some of them may have been.
    fn append(&mut self, bytes: &[u8], reserve: u64) -> io::Result<()>;

    /// Drops everything from `length` on; the next append starts there. Called after a failed append, to
    /// remove its incomplete output.
    ///
    /// # Errors
    /// The reason why the sink cannot be truncated.
    fn truncate(&mut self, length: u64) -> io::Result<()>;

    /// Makes the appended bytes survive a loss of power: soon, and without delaying the caller.
    ///
    /// # Errors
    /// A failure of this or of an earlier synchronization.
    fn sync(&mut self) -> io::Result<()>;

    /// The file is complete: waits until all of it survives a loss of power.
    ///
    /// # Errors
    /// The reason why it may not survive.
    fn end(&mut self) -> io::Result<()>;
}

/// The file is allocated in steps of this size.
#[cfg(target_os = "linux")]
const ALLOCATION_STEP_BYTES: u64 = 1 << 20;

/// A file. Its end is allocated on the disk before each append if the file system supports it, so that a
/// trace on a full disk still receives its index. A separate thread synchronizes it with the disk, because on
/// a slow disk that takes longer than the queue to the recorder lasts.
#[derive(Debug)]
pub struct FileSink {
    file: File,
    length: u64,
    /// How far the file is allocated; `None` if the file system does not support it.
    allocated: Option<u64>,
    requests: Option<SyncSender<()>>,
    failure: Arc<Mutex<Option<io::Error>>>,
    thread: Option<JoinHandle<()>>,
}

impl FileSink {
    /// Takes an empty file that is open for writing.
    ///
    /// # Errors
    /// If the file handle cannot be duplicated or the thread cannot be started.
    pub fn new(file: File) -> io::Result<Self> {
        let twin = file.try_clone()?;
        let (requests, inbox) = sync_channel::<()>(1);
        let failure = Arc::new(Mutex::new(None));
        let report = Arc::clone(&failure);
        let thread = std::thread::Builder::new()
            .name("trace-sync".to_owned())
            .spawn(move || {
                while inbox.recv().is_ok() {
                    if let Err(error) = sync_data(&twin) {
                        *report.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                    }
                }
            })?;
        Ok(Self {
            file,
            length: 0,
            allocated: Some(0),
            requests: Some(requests),
            failure,
            thread: Some(thread),
        })
    }
}

impl FileSink {
    /// Allocates the file up to `end`, or more.
    #[cfg(target_os = "linux")]
    fn allocate(&mut self, end: u64) -> io::Result<()> {
        use rustix::fs::{FallocateFlags, fallocate};
        use rustix::io::Errno;
        let Some(allocated) = self.allocated else {
            return Ok(());
        };
        if end <= allocated {
            return Ok(());
        }
        // The step first; on an almost full disk only the necessary amount.
        for goal in [end.saturating_add(ALLOCATION_STEP_BYTES), end] {
            match fallocate(&self.file, FallocateFlags::KEEP_SIZE, allocated, goal - allocated) {
                Ok(()) => {
                    self.allocated = Some(goal);
                    return Ok(());
                }
                Err(Errno::NOSPC | Errno::DQUOT | Errno::FBIG) => {}
                Err(_) => {
                    // A device or a file system without support: appends fail when it is full.
                    self.allocated = None;
                    return Ok(());
                }
            }
        }
        Err(io::ErrorKind::StorageFull.into())
    }

    #[cfg(not(target_os = "linux"))]
    #[expect(clippy::unnecessary_wraps, reason = "fails on other systems")]
    fn allocate(&mut self, _end: u64) -> io::Result<()> {
        self.allocated = None;
        Ok(())
    }
}

/// Devices such as pipes and /dev/null cannot be synchronized, which is not a failure.
fn sync_data(file: &File) -> io::Result<()> {
    match file.sync_data() {
        Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
        result => result,
    }
}

impl TraceSink for FileSink {
    fn append(&mut self, bytes: &[u8], reserve: u64) -> io::Result<()> {
        self.allocate((self.length + bytes.len() as u64).saturating_add(reserve))?;
        // Counted before: after a failed write an unknown part is in the file.
        self.length += bytes.len() as u64;
        self.file.write_all(bytes)
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        // Only if necessary: it releases the allocation.
        if length != self.length {
            self.file.set_len(length)?;
            self.file.seek(SeekFrom::Start(length))?;
            self.length = length;
            self.allocated = self.allocated.map(|_| length);
        }
        Ok(())
    }

    fn end(&mut self) -> io::Result<()> {
        // Releases the unused allocation.
        if self.allocated.is_some() {
            self.file.set_len(self.length)?;
        }
        sync_data(&self.file)
    }

    fn sync(&mut self) -> io::Result<()> {
        if let Some(error) = self.failure.lock().unwrap_or_else(PoisonError::into_inner).take() {
            return Err(error);
        }
        match self.requests.as_ref().map(|requests| requests.try_send(())) {
            // A full queue means that a synchronization is already due, which will cover these bytes too.
            None | Some(Ok(()) | Err(TrySendError::Full(()))) => Ok(()),
            Some(Err(TrySendError::Disconnected(()))) => sync_data(&self.file),
        }
    }
}

impl Drop for FileSink {
    fn drop(&mut self) {
        self.requests = None;
        if let Some(thread) = self.thread.take() {
            // Its only result is the failure slot, which nobody reads any more.
            let _ = thread.join();
        }
    }
}

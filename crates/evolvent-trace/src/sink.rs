//! Where a trace goes: a file that is synchronised in the background, or whatever a test puts in its place.

use std::fs::File;
use std::io::{self, Seek as _, SeekFrom, Write as _};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// Takes the bytes of a trace in order.
///
/// A trace is only ever appended to, so that what is on disk is right at every moment up to the last complete
/// record; no place is written twice.
pub trait TraceSink: Send {
    /// Appends all bytes.
    ///
    /// # Errors
    /// The reason why they could not all be written; some of them may have been.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Forgets everything from `length` on; what is appended next begins there. Called after a failed
    /// append, to cut off what it left half done.
    ///
    /// # Errors
    /// The reason why the sink cannot forget.
    fn truncate(&mut self, length: u64) -> io::Result<()>;

    /// Makes what has been appended survive a loss of power: at once if `wait`, else soon and without
    /// holding the caller up.
    ///
    /// # Errors
    /// A failure of this or of an earlier synchronisation.
    fn sync(&mut self, wait: bool) -> io::Result<()>;
}

/// A file; its synchronisation with the disk runs in a thread of its own, because on a slow disk it takes longer
/// than the queue before the recorder lasts.
#[derive(Debug)]
pub struct FileSink {
    file: File,
    requests: Option<SyncSender<()>>,
    failure: Arc<Mutex<Option<io::Error>>>,
    thread: Option<JoinHandle<()>>,
}

impl FileSink {
    /// Takes over a file that is open for writing, at its end.
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
            requests: Some(requests),
            failure,
            thread: Some(thread),
        })
    }
}

/// Devices such as pipes and /dev/null cannot be synchronised, which is no failure of theirs.
fn sync_data(file: &File) -> io::Result<()> {
    match file.sync_data() {
        Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
        result => result,
    }
}

impl TraceSink for FileSink {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.file.set_len(length)?;
        self.file.seek(SeekFrom::Start(length)).map(|_| ())
    }

    fn sync(&mut self, wait: bool) -> io::Result<()> {
        if let Some(error) = self.failure.lock().unwrap_or_else(PoisonError::into_inner).take() {
            return Err(error);
        }
        if wait {
            return sync_data(&self.file);
        }
        match self.requests.as_ref().map(|requests| requests.try_send(())) {
            // A full queue means that a synchronisation is already due, which will cover these bytes too.
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

//! The text of a long program for the recorder, copied into the state folder by a separate thread. The
//! recorder must not wait for the program's file system, and the file may have changed by the time the
//! recorder needs it.

use std::fs::{File, OpenOptions};
use std::io::{Read, Result, Write as _};
use std::os::unix::fs::{FileExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Instant;

use evolvent_config::{FILE_TIMEOUT, no_reply, open_regular};

use crate::rt::take_turns;

/// Number of bytes copied at once.
const PIECE_BYTES: usize = 1 << 20;

/// The text of a program for the recorder.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ProgramText {
    Whole(Arc<[u8]>),
    Copy(Arc<ProgramCopy>),
}

/// A copy in progress.
#[derive(Debug)]
pub(crate) struct ProgramCopy {
    pub(crate) path: PathBuf,
    state: Mutex<State>,
}

#[derive(Debug)]
enum State {
    /// In progress; the time of the last data.
    Copying(Instant),
    Done(Arc<File>),
    Failed(String),
}

impl PartialEq for ProgramCopy {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self, other)
    }
}

impl ProgramCopy {
    /// Starts to copy a program into an unnamed file in a folder.
    pub(crate) fn begin(program: &Path, folder: &Path) -> Arc<Self> {
        let (from, folder) = (program.to_path_buf(), folder.to_path_buf());
        Self::begin_from(program, &folder, move || open_regular(&from))
    }

    fn begin_from<R: Read>(
        program: &Path,
        folder: &Path,
        open: impl FnOnce() -> Result<R> + Send + 'static,
    ) -> Arc<Self> {
        let copy = Arc::new(Self {
            path: program.to_path_buf(),
            state: Mutex::new(State::Copying(Instant::now())),
        });
        let (worker, folder) = (Arc::clone(&copy), folder.to_path_buf());
        let spawned = thread::Builder::new().name("files".into()).spawn(move || {
            take_turns();
            let done = open().and_then(|from| worker.copy(from, &folder));
            worker.set(match done {
                Ok(file) => State::Done(Arc::new(file)),
                Err(error) => State::Failed(error.to_string()),
            });
        });
        if let Err(error) = spawned {
            copy.set(State::Failed(error.to_string()));
        }
        copy
    }

    fn copy(&self, mut from: impl Read, folder: &Path) -> Result<File> {
        let mut to = unnamed_file(folder)?;
        let mut piece = vec![0; PIECE_BYTES];
        loop {
            let count = from.read(&mut piece)?;
            if count == 0 {
                return Ok(to);
            }
            to.write_all(&piece[..count])?;
            self.set(State::Copying(Instant::now()));
        }
    }

    fn set(&self, new: State) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        // A copy that was given up stays so: the recorder has reported it.
        if matches!(*state, State::Copying(_)) {
            *state = new;
        }
    }

    /// The copy, or the reason why there is none; `None` while data still arrives.
    pub(crate) fn poll(&self) -> Option<std::result::Result<Arc<File>, String>> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let State::Copying(since) = &*state
            && since.elapsed() > FILE_TIMEOUT
        {
            *state = State::Failed(no_reply(FILE_TIMEOUT).to_string());
        }
        match &*state {
            State::Copying(_) => None,
            State::Done(file) => Some(Ok(Arc::clone(file))),
            State::Failed(reason) => Some(Err(reason.clone())),
        }
    }
}

/// A file that is deleted with its last descriptor.
fn unnamed_file(folder: &Path) -> Result<File> {
    std::fs::create_dir_all(folder)?;
    let mut options = OpenOptions::new();
    options.read(true).write(true);
    let made = options.clone().custom_flags(libc::O_TMPFILE).open(folder);
    // Some file systems do not support this.
    made.or_else(|_| {
        let path = folder.join(format!(".program-{}", std::process::id()));
        let file = options.create_new(true).open(&path)?;
        std::fs::remove_file(&path)?;
        Ok(file)
    })
}

/// Reads a file from its beginning, independent of other readers' positions.
pub(crate) struct FromStart {
    pub(crate) file: Arc<File>,
    pub(crate) at: u64,
}

impl Read for FromStart {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let count = self.file.read_at(buffer, self.at)?;
        self.at += count as u64;
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn wait(copy: &ProgramCopy) -> std::result::Result<Arc<File>, String> {
        loop {
            if let Some(found) = copy.poll() {
                return found;
            }
            thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn a_copy_has_the_text_of_when_it_was_begun() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("long.ngc");
        let text = "G0 X1\n".repeat(500_000);
        std::fs::write(&program, &text).unwrap();
        let copy = ProgramCopy::begin(&program, &folder.path().join("state"));
        let file = wait(&copy).unwrap();
        std::fs::write(&program, "another").unwrap();
        for _ in 0..2 {
            let mut read = String::new();
            let file = Arc::clone(&file);
            FromStart { file, at: 0 }.read_to_string(&mut read).unwrap();
            assert!(read == text);
        }
        assert_eq!(std::fs::read_dir(folder.path().join("state")).unwrap().count(), 0);
    }

    #[test]
    fn a_hanging_file_times_out_and_a_pipe_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let hangs = || -> Result<File> {
            loop {
                thread::park();
            }
        };
        let copy = ProgramCopy::begin_from(Path::new("hangs"), folder.path(), hangs);
        assert!(copy.poll().is_none());
        copy.set(State::Copying(
            Instant::now().checked_sub(2 * FILE_TIMEOUT).unwrap(),
        ));
        assert!(copy.poll().unwrap().unwrap_err().contains("no reply"));
        let pipe = folder.path().join("pipe");
        assert!(
            std::process::Command::new("mkfifo")
                .arg(&pipe)
                .status()
                .unwrap()
                .success()
        );
        assert!(
            wait(&ProgramCopy::begin(&pipe, folder.path()))
                .unwrap_err()
                .contains("pipe")
        );
    }
}

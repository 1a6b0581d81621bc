//! Files that commands need. Another thread opens, reads and checks them, so the control thread never waits
//! for a disk.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use evolvent_bus::ControlRequest;
use evolvent_config::{no_reply, open_regular, read_regular};
use evolvent_control::{Alarm, OperatorCommand, Rejection};
use evolvent_gcode::{MdiPreamble, PersistentParameters, Settings, ToolTable};

use super::checking::{CheckVerdict, Coverage, judge};
use super::modes::{After, simulate_modes};
use super::programs::sentence;
use super::state_store::Saved;
use crate::check_bounds::CheckBounds;
use crate::job::Setup;
use crate::memory::ProgramMemory;
use crate::rt::take_turns;

/// Maximum length of programs that are checked completely while the client waits, bytes.
const SHORT: u64 = 64 * 1024;

/// Time limit for the files of one command. A single file has a limit of 5 s
/// ([`evolvent_config::FILE_TIMEOUT`]), and its error names it; this limit is for a folder that does not
/// respond and for a check on a busy host.
pub(super) const READING_TIMEOUT: Duration = Duration::from_secs(8);

/// Maximum number of threads that hang in a file system at the same time. Each occupies a stack and an open
/// file until the file system responds.
const MAX_HUNG: usize = 8;

/// Metadata of a program file. Different metadata means a different program.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FileVersion {
    pub(super) file: PathBuf,
    pub(super) bytes: u64,
    pub(super) changed: Option<SystemTime>,
}

/// A program file as read by the reading thread.
#[derive(Debug)]
pub(super) struct ProgramFile {
    pub(super) version: FileVersion,
    /// The text of a short program, for the trace.
    pub(super) text: Option<Vec<u8>>,
    /// The verdict on a short program. A program that is long or has a long loop is checked while no client
    /// waits.
    pub(super) verdict: Option<CheckVerdict>,
    /// Notes for the operator, whatever the verdict.
    pub(super) notes: Vec<String>,
}

impl ProgramFile {
    /// Opens a file. Its text is read if it has at most `whole_bytes`.
    fn open(file: &Path, whole_bytes: u64) -> Result<Self, Rejection> {
        let wrong = |error| {
            let text = format!("{}: {error}; name a readable part program", file.display());
            Rejection::new(Alarm::File, text)
        };
        let metadata = open_regular(file)
            .and_then(|opened| opened.metadata())
            .map_err(wrong)?;
        let version = FileVersion {
            file: file.to_path_buf(),
            bytes: metadata.len(),
            changed: metadata.modified().ok(),
        };
        let text = if version.bytes <= whole_bytes {
            Some(read_regular(file, whole_bytes).map_err(wrong)?)
        } else {
            None
        };
        Ok(Self {
            version,
            text,
            verdict: None,
            notes: Vec::new(),
        })
    }

    /// Checks a short program. It has no verdict if the bounds end the check before the end of the program.
    fn judged(mut self, setup: &Setup, lines_before: u32, bounds: CheckBounds) -> Self {
        if self.text.is_some() {
            let verdict = judge(&self.version.file, setup, lines_before, bounds, || true);
            self.verdict = (!matches!(verdict, Ok(Coverage::Part(_)))).then_some(verdict);
        }
        self
    }
}

/// Result of the reading thread.
#[derive(Debug)]
pub(super) enum Found {
    Program(ProgramFile),
    Mdi {
        after: Box<After>,
        file: ProgramFile,
        restored: MdiPreamble,
    },
    /// `None` if there is no file.
    Tools(Option<ToolTable>),
    /// What was saved.
    Saved(Box<ProgramMemory>),
}

/// Opens a program and checks a short one.
pub(super) fn read_program(file: &Path, setup: &Setup) -> Result<Found, Rejection> {
    let bounds = CheckBounds::while_one_waits(1);
    let mut file = ProgramFile::open(file, SHORT)?.judged(setup, 0, bounds);
    let missing = setup.missing_folders();
    file.notes = missing.iter().map(ToString::to_string).collect();
    Ok(Found::Program(file))
}

/// A block of MDI: what it leaves, and the file to plan it from.
pub(super) struct MdiBlock {
    /// Lines that restore the present modes in an interpreter.
    pub(super) preamble: String,
    pub(super) text: String,
    pub(super) settings: Settings,
    pub(super) kept: PersistentParameters,
    pub(super) folder: PathBuf,
    pub(super) setup: Setup,
}

impl MdiBlock {
    pub(super) fn read(self) -> Result<Found, Rejection> {
        let lines = self.preamble.lines().count() as u32;
        let whole = format!("{}{}\n", self.preamble, self.text);
        let after = simulate_modes(&whole, &self.settings, &self.kept)
            .map_err(|error| Rejection::new(Alarm::BadProgram, sentence(&error, lines)))?;
        let path = self.folder.join("mdi.ngc");
        std::fs::create_dir_all(&self.folder)
            .and_then(|()| std::fs::write(&path, &whole))
            .map_err(|error| Rejection::new(Alarm::File, format!("{}: {error}", path.display())))?;
        // However many parameters earlier blocks have set: this file is replaced with the next block.
        let mut bounds = CheckBounds::while_one_waits(1);
        // A block is checked completely or not at all, since nobody reads a caution after its answer.
        bounds.round = bounds.commands;
        let file = ProgramFile::open(&path, whole.len() as u64)?.judged(&self.setup, lines, bounds);
        match file.verdict {
            Some(Ok(_)) => {}
            Some(Err(refusal)) => return Err(refusal),
            None => {
                let text = format!(
                    "the block has more than {} commands, too many to check; write a program and load it",
                    bounds.commands
                );
                return Err(Rejection::new(Alarm::BadProgram, text));
            }
        }
        Ok(Found::Mdi {
            after: Box::new(after),
            file,
            restored: self.setup.restored,
        })
    }
}

/// Reads the tool table again.
pub(super) fn read_tools(file: Option<&Path>) -> Result<Found, Rejection> {
    let Some(file) = file else {
        return Ok(Found::Tools(None));
    };
    if let Err(error) = open_regular(file)
        && error.kind() == std::io::ErrorKind::NotFound
    {
        return Ok(Found::Tools(None));
    }
    ToolTable::load(file)
        .map(|table| Found::Tools(Some(table)))
        .map_err(|error| Rejection::new(Alarm::File, error.to_string()))
}

/// Waits until offsets or tools were written.
pub(super) fn written(saving: &Receiver<Saved>) -> Result<Found, Rejection> {
    match saving.recv() {
        Ok(Ok(memory)) => Ok(Found::Saved(Box::new(memory))),
        Ok(Err(error)) => Err(Rejection::new(Alarm::File, error.to_string())),
        Err(_) => Err(Rejection::new(
            Alarm::File,
            "no thread to write with; restart the core",
        )),
    }
}

/// A command whose files are being read.
#[derive(Debug)]
pub(super) struct Reading {
    /// The request as it came.
    pub(super) request: ControlRequest,
    pub(super) command: OperatorCommand,
    /// Start of the error message if the file system does not respond.
    about: String,
    begun: Instant,
    /// A stop came while the files were being read.
    pub(super) is_cancelled: bool,
    result: Receiver<Result<Found, Rejection>>,
}

/// Starts reading threads, and counts those that hang.
#[derive(Debug, Default)]
pub(super) struct Readers {
    /// Each thread holds a clone.
    alive: Arc<()>,
}

impl Readers {
    /// Starts a reading thread.
    pub(super) fn begin(
        &self,
        request: &ControlRequest,
        command: &OperatorCommand,
        about: String,
        work: impl FnOnce() -> Result<Found, Rejection> + Send + 'static,
    ) -> Result<Reading, Rejection> {
        if Arc::strong_count(&self.alive) > MAX_HUNG {
            let text = format!(
                "{MAX_HUNG} files are still being read; repair or unmount the file system that does not \
                 reply, or restart the core"
            );
            return Err(Rejection::new(Alarm::File, text));
        }
        let (sender, result) = mpsc::channel();
        let alive = Arc::clone(&self.alive);
        let spawned = thread::Builder::new().name("files".into()).spawn(move || {
            take_turns();
            let _too_late = sender.send(work());
            drop(alive);
        });
        spawned.map_err(|error| Rejection::new(Alarm::File, format!("no thread to read with: {error}")))?;
        Ok(Reading {
            request: *request,
            command: command.clone(),
            about,
            begun: Instant::now(),
            is_cancelled: false,
            result,
        })
    }
}

impl Reading {
    /// The result; `None` while it is pending and there is time left.
    pub(super) fn poll(&self) -> Option<Result<Found, Rejection>> {
        if self.is_cancelled {
            let text = format!(
                "{}: a stop came while it was read; the command has no effect",
                self.about
            );
            return Some(Err(Rejection::new(Alarm::File, text)));
        }
        match self.result.try_recv() {
            Ok(found) => Some(found),
            Err(TryRecvError::Empty) if self.begun.elapsed() < READING_TIMEOUT => None,
            Err(TryRecvError::Empty) => {
                let text = format!("{}: {}", self.about, no_reply(READING_TIMEOUT));
                Some(Err(Rejection::new(Alarm::File, text)))
            }
            Err(TryRecvError::Disconnected) => {
                let text = format!("{}: its check ended unexpectedly; please report this", self.about);
                Some(Err(Rejection::new(Alarm::BadProgram, text)))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::bench::Bench;
    use super::*;

    #[test]
    fn each_program_reports_a_missing_subroutine_folder() {
        let mut bench = Bench::new();
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("part.ngc");
        std::fs::write(&program, "G21\nM2\n").unwrap();
        let mut setup = bench.operator.setup.clone();
        let Ok(Found::Program(file)) = read_program(&program, &setup) else {
            panic!("a program")
        };
        assert_eq!(file.notes, [""; 0]);
        setup.machine.program.subroutines = vec![folder.path().to_path_buf(), "gone".into()];
        let Ok(Found::Program(file)) = read_program(&program, &setup) else {
            panic!("a program")
        };
        bench.operator.load(&file).unwrap();
        let text = bench.operator.message.text();
        assert!(
            text.contains("program.subroutines[1]: there is no folder"),
            "{text}"
        );
        assert_eq!(bench.operator.take_cautions().len(), 1);
    }

    fn reading(work: impl FnOnce() -> Result<Found, Rejection> + Send + 'static) -> Reading {
        Readers::default()
            .begin(
                &ControlRequest::default(),
                &OperatorCommand::Stop,
                "a file".to_owned(),
                work,
            )
            .unwrap()
    }

    #[test]
    fn a_cancelled_read_has_no_effect_even_if_it_hangs() {
        let mut reading = reading(|| {
            loop {
                thread::park();
            }
        });
        assert!(reading.poll().is_none());
        reading.is_cancelled = true;
        let refusal = reading.poll().unwrap().unwrap_err();
        assert_eq!(refusal.alarm, Alarm::File);
    }

    #[test]
    fn a_hanging_read_is_refused_after_its_timeout() {
        let mut reading = reading(|| {
            loop {
                thread::park();
            }
        });
        reading.begun = Instant::now().checked_sub(READING_TIMEOUT).unwrap();
        let refusal = reading.poll().unwrap().unwrap_err();
        assert!(refusal.text.contains("no reply within 8 s"), "{refusal}");
    }

    #[test]
    fn readers_that_hang_are_not_joined_by_more_and_more() {
        let readers = Readers::default();
        let begin = || {
            let hangs = || loop {
                thread::park();
            };
            readers.begin(
                &ControlRequest::default(),
                &OperatorCommand::Stop,
                String::new(),
                hangs,
            )
        };
        let hung: Vec<_> = (0..MAX_HUNG).map(|_| begin().unwrap()).collect();
        assert_eq!(begin().unwrap_err().alarm, Alarm::File);
        drop(hung);
    }
}

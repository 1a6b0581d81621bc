//! Files written by programs: `(LOGOPEN,..)`, `(LOG,..)`, `(PROBEOPEN ..)`.
//!
//! A separate thread writes them, so no planner waits for a disk. A file is written under a temporary name
//! and renamed when it is closed or the program is over: readers find whole lines and never an incomplete
//! file.

use std::fs::File;
use std::io::{BufWriter, ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, SyncSender, TrySendError};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use evolvent_config::read_regular;
use evolvent_gcode::LogAction;

use crate::rt::take_turns;

/// Maximum size of a file, bytes: an hour of probing at ten points per second is 3 MB.
pub(crate) const MAX_BYTES: u64 = 16 << 20;

/// Maximum length of a name, bytes.
const MAX_NAME: usize = 100;

/// Maximum number of lines that wait for the disk.
const MAX_WAITING: usize = 4096;

/// Time limit for the disk.
const PATIENCE: Duration = Duration::from_secs(5);

/// Poll interval for the disk.
const LOOK_EVERY: Duration = Duration::from_millis(2);

/// The reason why a program may not write this file: message and help.
pub(crate) fn log_objection(action: &LogAction) -> Option<(String, String)> {
    let (LogAction::Open(name) | LogAction::Append(name) | LogAction::OpenProbes(name)) = action else {
        return None;
    };
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._- ".contains(&byte);
    let is_name = !name.is_empty()
        && name.len() <= MAX_NAME
        && name.bytes().all(is_plain)
        && !name.starts_with(['.', ' '])
        && !name.ends_with(' ');
    (!is_name).then(|| {
        let help = format!(
            "write a name without a folder, of at most {MAX_NAME} letters, digits, spaces, \".\", \"-\" \
             and \"_\": log files go to the folder program.log_folder of the machine file"
        );
        (format!("\"{name}\" is not a name of a log file"), help)
    })
}

/// The two files that a program may have open at the same time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LogKind {
    /// LOG.
    Lines,
    /// Positions of G38.2 to G38.5.
    Probes,
}

enum Order {
    Open {
        kind: LogKind,
        name: String,
        appends: bool,
    },
    Line(LogKind, String),
    Close(LogKind),
}

/// The channel to the writing thread.
#[derive(Debug)]
pub(crate) struct LogFiles {
    orders: Option<SyncSender<Order>>,
    failure: Arc<Mutex<Option<String>>>,
    thread: Option<JoinHandle<()>>,
    is_open: [bool; 2],
}

impl LogFiles {
    /// Writes files in this folder, which is created if necessary.
    pub(crate) fn new(folder: PathBuf) -> Self {
        let (sender, orders) = mpsc::sync_channel(MAX_WAITING);
        let failure = Arc::new(Mutex::new(None));
        let of_writer = Arc::clone(&failure);
        let thread = thread::Builder::new().name("log".into()).spawn(move || {
            take_turns();
            Writer::new(folder, of_writer).run(&orders);
        });
        // Without its thread every order returns an error.
        let thread = thread.ok();
        Self {
            orders: thread.is_some().then_some(sender),
            failure,
            thread,
            is_open: [false; 2],
        }
    }

    /// Whether a file of this kind is open.
    pub(crate) fn is_open(&self, kind: LogKind) -> bool {
        self.is_open[kind as usize]
    }

    /// Carries out a comment. Returns the error of this or an earlier order, if any.
    pub(crate) fn act(&mut self, action: &LogAction) -> Result<(), String> {
        let (lines, probes) = (LogKind::Lines, LogKind::Probes);
        match action {
            LogAction::Open(name) => self.open(lines, name, false),
            LogAction::Append(name) => self.open(lines, name, true),
            LogAction::OpenProbes(name) => self.open(probes, name, false),
            LogAction::Line(text) => self.line(lines, text.clone()),
            LogAction::Close => self.close(lines),
            LogAction::CloseProbes => self.close(probes),
        }
    }

    fn open(&mut self, kind: LogKind, name: &str, appends: bool) -> Result<(), String> {
        self.is_open[kind as usize] = true;
        let name = name.to_owned();
        self.order(Order::Open { kind, name, appends })
    }

    /// Writes a line if a file is open.
    pub(crate) fn line(&mut self, kind: LogKind, text: String) -> Result<(), String> {
        if self.is_open(kind) {
            self.order(Order::Line(kind, text))
        } else {
            Ok(())
        }
    }

    fn close(&mut self, kind: LogKind) -> Result<(), String> {
        self.is_open[kind as usize] = false;
        self.order(Order::Close(kind))
    }

    fn failed(&self) -> Option<String> {
        let failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        failure.clone()
    }

    fn order(&mut self, order: Order) -> Result<(), String> {
        if let Some(failure) = self.failed() {
            return Err(failure);
        }
        let begun = Instant::now();
        let mut order = order;
        while let Some(orders) = &self.orders {
            match orders.try_send(order) {
                Ok(()) => return Ok(()),
                Err(TrySendError::Full(back)) if begun.elapsed() < PATIENCE => {
                    order = back;
                    thread::sleep(LOOK_EVERY);
                }
                Err(TrySendError::Full(_)) => {
                    return Err(format!(
                        "the disk of the log files does not reply within {} s",
                        PATIENCE.as_secs()
                    ));
                }
                Err(TrySendError::Disconnected(_)) => break,
            }
        }
        Err("no thread to write log files with".to_owned())
    }

    /// Closes open files and waits for the disk. Returns the first error, if any.
    pub(crate) fn finish(mut self) -> Result<(), String> {
        self.orders = None;
        let begun = Instant::now();
        while let Some(thread) = &self.thread {
            if thread.is_finished() {
                return self.failed().map_or(Ok(()), Err);
            }
            if begun.elapsed() > PATIENCE {
                break;
            }
            thread::sleep(LOOK_EVERY);
        }
        Err(format!(
            "the disk of the log files does not reply within {} s",
            PATIENCE.as_secs()
        ))
    }
}

/// A file being written under a temporary name.
struct Open {
    name: String,
    part: PathBuf,
    file: BufWriter<File>,
    bytes: u64,
}

/// The thread's side.
struct Writer {
    folder: PathBuf,
    failure: Arc<Mutex<Option<String>>>,
    open: [Option<Open>; 2],
}

impl Writer {
    fn new(folder: PathBuf, failure: Arc<Mutex<Option<String>>>) -> Self {
        Self {
            folder,
            failure,
            open: [None, None],
        }
    }

    fn run(mut self, orders: &Receiver<Order>) {
        while let Ok(order) = orders.recv() {
            let done = match order {
                Order::Open { kind, name, appends } => {
                    self.close(kind).and_then(|()| self.begin(kind, name, appends))
                }
                Order::Line(kind, text) => self.line(kind, &text),
                Order::Close(kind) => self.close(kind),
            };
            self.note(done);
        }
        for kind in [LogKind::Lines, LogKind::Probes] {
            let done = self.close(kind);
            self.note(done);
        }
    }

    /// Only the first failure is reported.
    fn note(&self, done: Result<(), String>) {
        if let Err(text) = done {
            let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
            failure.get_or_insert(text);
        }
    }

    fn begin(&mut self, kind: LogKind, name: String, appends: bool) -> Result<(), String> {
        let target = self.folder.join(&name);
        let wrong = |error: std::io::Error| format!("log file {}: {error}", target.display());
        let before = if appends {
            match read_regular(&target, MAX_BYTES) {
                Ok(bytes) => bytes,
                Err(error) if error.kind() == ErrorKind::NotFound => Vec::new(),
                Err(error) => return Err(wrong(error)),
            }
        } else {
            Vec::new()
        };
        if before.len() as u64 > MAX_BYTES {
            return Err(too_long(&target));
        }
        std::fs::create_dir_all(&self.folder).map_err(wrong)?;
        let part = self.folder.join(format!(".{name}.part"));
        let mut file = BufWriter::new(File::create(&part).map_err(wrong)?);
        file.write_all(&before).map_err(wrong)?;
        self.open[kind as usize] = Some(Open {
            name,
            part,
            file,
            bytes: before.len() as u64,
        });
        Ok(())
    }

    fn line(&mut self, kind: LogKind, text: &str) -> Result<(), String> {
        let Some(open) = &mut self.open[kind as usize] else {
            return Ok(());
        };
        let target = self.folder.join(&open.name);
        open.bytes += text.len() as u64 + 1;
        if open.bytes > MAX_BYTES {
            // The part that fits is kept.
            let text = too_long(&target);
            return self.close(kind).and(Err(text));
        }
        writeln!(open.file, "{text}").map_err(|error| format!("log file {}: {error}", target.display()))
    }

    /// Renames a file to its final name: readers see the complete file or the previous one.
    fn close(&mut self, kind: LogKind) -> Result<(), String> {
        let Some(Open { name, part, file, .. }) = self.open[kind as usize].take() else {
            return Ok(());
        };
        let target = self.folder.join(name);
        let written = file
            .into_inner()
            .map_err(std::io::IntoInnerError::into_error)
            .and_then(|file| file.sync_all())
            .and_then(|()| std::fs::rename(&part, &target));
        written.map_err(|error| {
            // A failure here adds nothing: the first error gives the reason.
            let _ = std::fs::remove_file(&part);
            format!("log file {}: {error}", target.display())
        })
    }
}

fn too_long(file: &Path) -> String {
    format!(
        "log file {} is longer than {MAX_BYTES} bytes; open another one from time to time",
        file.display()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(name: &str) -> LogAction {
        LogAction::Open(name.to_owned())
    }

    fn line(text: &str) -> LogAction {
        LogAction::Line(text.to_owned())
    }

    #[test]
    fn a_file_has_its_name_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path().join("made/on/demand");
        let mut logs = LogFiles::new(at.clone());
        for action in [
            line("nowhere"),
            open("a.txt"),
            line("one"),
            LogAction::Append("b.txt".into()),
            line("two"),
        ] {
            logs.act(&action).unwrap();
        }
        logs.act(&LogAction::OpenProbes("p.txt".into())).unwrap();
        logs.line(LogKind::Probes, "1 2 3".to_owned()).unwrap();
        let begun = Instant::now();
        while !at.join(".p.txt.part").exists() && begun.elapsed() < PATIENCE {
            thread::sleep(LOOK_EVERY);
        }
        assert_eq!(std::fs::read_to_string(at.join("a.txt")).unwrap(), "one\n");
        assert!(!at.join("b.txt").exists() && !at.join("p.txt").exists());
        logs.act(&LogAction::Close).unwrap();
        // Closing one file leaves the other open.
        logs.line(LogKind::Probes, "4 5 6".to_owned()).unwrap();
        logs.act(&line("nowhere")).unwrap();
        logs.finish().unwrap();
        assert_eq!(
            std::fs::read_to_string(at.join("p.txt")).unwrap(),
            "1 2 3\n4 5 6\n"
        );
        let mut logs = LogFiles::new(at.clone());
        for action in [LogAction::Append("b.txt".into()), line("three")] {
            logs.act(&action).unwrap();
        }
        logs.finish().unwrap();
        assert_eq!(std::fs::read_to_string(at.join("b.txt")).unwrap(), "two\nthree\n");
        let mut names: Vec<_> = std::fs::read_dir(&at)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        assert_eq!(names, ["a.txt", "b.txt", "p.txt"]);
    }

    #[test]
    fn a_file_is_bounded_and_what_fits_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let mut logs = LogFiles::new(folder.path().to_path_buf());
        logs.act(&open("long.txt")).unwrap();
        let text = "x".repeat(1 << 20);
        let mut failure = None;
        for _ in 0..40 {
            failure = failure.or(logs.act(&line(&text)).err());
        }
        let failure = logs.finish().err().or(failure).unwrap();
        assert!(failure.contains("longer than"), "{failure}");
        let length = std::fs::metadata(folder.path().join("long.txt")).unwrap().len();
        assert_eq!(length, 15 * ((1 << 20) + 1));
    }

    #[test]
    fn a_folder_that_is_none_is_told_of() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        let mut logs = LogFiles::new(file);
        logs.act(&open("a.txt")).unwrap();
        let error = logs.finish().unwrap_err();
        assert!(error.contains("a.txt"), "{error}");
        // A folder with the name of the file is an error too, and leaves no temporary file.
        std::fs::create_dir(folder.path().join("b.txt")).unwrap();
        let mut logs = LogFiles::new(folder.path().to_path_buf());
        logs.act(&open("b.txt")).unwrap();
        assert!(logs.finish().is_err());
        assert!(!folder.path().join(".b.txt.part").exists());
    }

    #[test]
    fn names_that_lead_elsewhere_are_refused() {
        for name in [
            "",
            ".hidden",
            "..",
            "a/b",
            "/etc/passwd",
            "a\\b",
            "a\0",
            " a",
            "a ",
            "ä.txt",
            &"x".repeat(101),
        ] {
            assert!(log_objection(&open(name)).is_some(), "{name:?}");
        }
        for name in ["a.txt", "probe results-1_2.txt", &"x".repeat(100)] {
            assert!(log_objection(&open(name)).is_none(), "{name:?}");
        }
        assert!(log_objection(&line("../x")).is_none());
    }
}

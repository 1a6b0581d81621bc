//! M100 to M199: user-defined M codes, executables in a folder named by the machine file.
//!
//! Such an executable runs while the axes are at rest and the plan waits. It has its own process group, no
//! shell, and P and Q as its two arguments (-1 for a missing word, as machine builders expect). Its output is
//! reported line by line. The code is complete when the process ends; processes that it leaves in the
//! background are not monitored.

use std::io::{ErrorKind, PipeReader, Read};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process_group};

use crate::job::Setup;
use crate::news::UserCall;
use crate::periphery::CHANGE_BEGINS;
use crate::rt::take_turns;

/// Poll interval of a running executable.
const LOOK_EVERY: Duration = Duration::from_millis(2);
/// Time within which an executable must end after it was asked to.
const GRACE: Duration = Duration::from_secs(1);
/// Maximum wait for further output after an executable has ended, if other processes keep the pipe open.
const LAST_WORDS: Duration = Duration::from_millis(100);
/// Maximum length of reported output, of a line and in total, bytes.
const MAX_LINE: usize = 500;
const MAX_BYTES: usize = 64 * 1024;
/// Number of bytes read at once; the number of reads per poll exceeds the capacity of a pipe (1 MiB if
/// enlarged).
const BYTES_AT_ONCE: usize = 8 * 1024;
const MAX_READS: usize = 160;
/// Argument for a missing word.
const NO_WORD: f64 = -1.0;

/// Folder of the executables, and their time limit.
#[derive(Clone, Debug)]
pub(crate) struct UserCodes {
    folder: PathBuf,
    timeout: Duration,
    machine_name: String,
}

/// Events of an executable.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum UserNews {
    /// It has written a line.
    Line(String),
    /// It has ended, successfully or with the reason of its failure.
    Ended(Result<(), String>),
}

/// A running executable. It is killed when dropped.
#[derive(Debug)]
pub(crate) struct UserProgram {
    news: Receiver<UserNews>,
    cancelled: Arc<AtomicBool>,
    is_over: bool,
}

impl UserCodes {
    /// Settings of the machine file.
    pub(crate) fn of(setup: &Setup) -> Self {
        let program = &setup.machine.program;
        let beside = setup.machine_file.parent().unwrap_or(Path::new(""));
        let folder = match &program.user_code_folder {
            Some(folder) => beside.join(folder),
            None => beside.to_path_buf(),
        };
        Self {
            // The executable starts in this folder, and a relative path would be resolved from there.
            folder: std::path::absolute(&folder).unwrap_or(folder),
            timeout: Duration::from_secs_f64(program.user_code_timeout_s),
            machine_name: setup.machine.name.clone(),
        }
    }

    /// The reason why a code cannot be executed, before anything starts.
    pub(crate) fn objection(&self, number: u32) -> Option<String> {
        let file = self.file(number);
        let what = match file.metadata() {
            Err(error) => {
                return Some(format!(
                    "M{number}: {}: {error}; {}",
                    file.display(),
                    self.advice()
                ));
            }
            Ok(metadata) if !metadata.is_file() => "is not a file",
            Ok(metadata) if metadata.permissions().mode() & 0o111 == 0 => "is not executable",
            // Whoever can write the file can move the machine.
            Ok(metadata) if metadata.permissions().mode() & 0o002 != 0 => "is writable by everyone",
            Ok(_) => return None,
        };
        Some(format!("M{number}: {} {what}; {}", file.display(), self.advice()))
    }

    fn file(&self, number: u32) -> PathBuf {
        self.folder.join(format!("M{number}"))
    }

    fn advice(&self) -> &'static str {
        "put an executable of that name there, or name the folder with program.user_code_folder in the \
         machine file"
    }

    /// Starts the executable of a code on a separate thread.
    pub(crate) fn start(&self, call: UserCall) -> UserProgram {
        let (sender, news) = mpsc::channel();
        let cancelled = Arc::new(AtomicBool::new(false));
        let (codes, is_cancelled) = (self.clone(), Arc::clone(&cancelled));
        let failed = sender.clone();
        let started = thread::Builder::new().name("user-code".into()).spawn(move || {
            take_turns();
            let result = codes.run(call, &is_cancelled, &sender);
            let _gone = sender.send(UserNews::Ended(result));
        });
        if let Err(error) = started {
            let _gone = failed.send(UserNews::Ended(Err(format!(
                "{}: no thread: {error}",
                call.text()
            ))));
        }
        UserProgram {
            news,
            cancelled,
            is_over: false,
        }
    }

    fn run(&self, call: UserCall, cancelled: &AtomicBool, sender: &Sender<UserNews>) -> Result<(), String> {
        if call.number == CHANGE_BEGINS {
            return Ok(());
        }
        if let Some(objection) = self.objection(call.number) {
            return Err(objection);
        }
        let name = call.text();
        let fails = |error: std::io::Error| format!("{name}: cannot be started: {error}");
        let (output, input) = std::io::pipe().map_err(fails)?;
        // The thread that monitors the executable reads without blocking, so all output is available when it
        // has ended.
        rustix::io::ioctl_fionbio(&output, true).map_err(|error| fails(error.into()))?;
        let mut command = Command::new(self.file(call.number));
        for word in call.words {
            command.arg(word.unwrap_or(NO_WORD).to_string());
        }
        let child = command
            .current_dir(&self.folder)
            .env("EVOLVENT_MACHINE_NAME", &self.machine_name)
            .env("EVOLVENT_LINE", call.line.to_string())
            // The core's socket to its service manager must not be inherited.
            .env_remove("NOTIFY_SOCKET")
            .env_remove("WATCHDOG_USEC")
            .env_remove("WATCHDOG_PID")
            .stdin(Stdio::null())
            .stdout(input.try_clone().map_err(fails)?)
            .stderr(input)
            .process_group(0)
            .spawn()
            .map_err(fails)?;
        // Our ends of the pipe are dropped with the command, so that its end is detected.
        drop(command);
        let mut output = Output::new(output, sender);
        let result = self.watch(&name, child, &mut output, cancelled);
        let end = Instant::now();
        while output.tell() && end.elapsed() < LAST_WORDS {
            thread::sleep(LOOK_EVERY);
        }
        output.report_line();
        result
    }

    /// Waits for the end, and enforces it after the time limit.
    fn watch(
        &self,
        name: &str,
        mut child: Child,
        output: &mut Output<'_>,
        cancelled: &AtomicBool,
    ) -> Result<(), String> {
        let begin = Instant::now();
        let mut asked: Option<Instant> = None;
        loop {
            // Output beyond the limit is read as well, so that the executable does not block.
            let _is_open = output.tell();
            match child.try_wait() {
                Ok(Some(_)) if asked.is_some() => return Err(format!("{name}: was ended by a stop")),
                Ok(Some(status)) => return judge(name, status),
                Ok(None) => {}
                Err(error) => return Err(format!("{name}: cannot be waited for: {error}")),
            }
            if asked.is_none() && cancelled.load(Ordering::Acquire) {
                asked = Some(Instant::now());
                signal(&child, Signal::TERM);
            }
            let is_late = asked.is_none() && begin.elapsed() > self.timeout;
            if is_late || asked.is_some_and(|since| since.elapsed() > GRACE) {
                signal(&child, Signal::KILL);
                let _ended = child.wait();
                return Err(if is_late {
                    format!(
                        "{name}: did not end within {} s and was killed; find out what it waits for, or \
                         raise program.user_code_timeout_s",
                        self.timeout.as_secs_f64()
                    )
                } else {
                    format!("{name}: was ended by a stop")
                });
            }
            thread::sleep(LOOK_EVERY);
        }
    }
}

/// Sends a signal to the executable and all processes of its group.
fn signal(child: &Child, signal: Signal) {
    if let Some(group) = Pid::from_raw(child.id().cast_signed()) {
        // A process that has already ended needs no signal.
        let _gone = kill_process_group(group, signal);
    }
}

fn judge(name: &str, status: ExitStatus) -> Result<(), String> {
    match (status.code(), status.signal()) {
        (Some(0), _) => Ok(()),
        (Some(code), _) => Err(format!("{name}: ended with exit code {code}; see its output")),
        (None, signal) => Err(format!("{name}: was killed by signal {}", signal.unwrap_or(0))),
    }
}

/// Output of an executable, line by line.
struct Output<'a> {
    pipe: PipeReader,
    sender: &'a Sender<UserNews>,
    /// The incomplete last line.
    line: Vec<u8>,
    /// Number of bytes that may still be reported.
    left: usize,
}

impl<'a> Output<'a> {
    /// Reads a pipe without blocking.
    fn new(pipe: PipeReader, sender: &'a Sender<UserNews>) -> Self {
        Self {
            pipe,
            sender,
            line: Vec::with_capacity(MAX_LINE),
            left: MAX_BYTES,
        }
    }

    /// Reports the lines received so far. Returns whether there may be more.
    fn tell(&mut self) -> bool {
        let mut bytes = [0; BYTES_AT_ONCE];
        for _ in 0..MAX_READS {
            match self.pipe.read(&mut bytes) {
                Ok(0) => return false,
                Ok(count) => {
                    for &byte in &bytes[..count] {
                        self.line.push(byte);
                        if byte == b'\n' || self.line.len() == MAX_LINE {
                            self.report_line();
                        }
                    }
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return error.kind() == ErrorKind::WouldBlock,
            }
        }
        true
    }

    /// Reports the present line. Output beyond the limit is dropped.
    fn report_line(&mut self) {
        if !self.line.is_empty() && self.left > 0 {
            self.left = self.left.saturating_sub(self.line.len());
            let text: String = String::from_utf8_lossy(&self.line)
                .trim_end()
                .chars()
                .map(|c| if c.is_control() { ' ' } else { c })
                .collect();
            let _gone = self.sender.send(UserNews::Line(text));
            if self.left == 0 {
                let _gone = self.sender.send(UserNews::Line("(more was written)".to_owned()));
            }
        }
        self.line.clear();
    }
}

impl UserProgram {
    /// The next event, if any.
    pub(crate) fn poll(&mut self) -> Option<UserNews> {
        let news = self.news.try_recv().ok()?;
        self.is_over |= matches!(news, UserNews::Ended(_));
        Some(news)
    }

    /// Whether its end was reported.
    pub(crate) fn is_over(&self) -> bool {
        self.is_over
    }

    /// Ends it: it is asked first, and killed if it does not end.
    pub(crate) fn cancel(&self) {
        self.cancelled.store(true, Ordering::Release);
    }
}

impl Drop for UserProgram {
    /// Waits for its end: if the core's process ends next, nothing else would end it.
    fn drop(&mut self) {
        if self.is_over {
            return;
        }
        self.cancel();
        let deadline = Instant::now() + 2 * GRACE;
        while Instant::now() < deadline {
            match self.news.recv_timeout(GRACE) {
                Ok(UserNews::Line(_)) => {}
                _ => return,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Mutex, PoisonError};

    use super::*;

    /// A script cannot be started while the child of another test, which is just being created, has inherited
    /// its open file.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    /// Longer than any host suspends a test.
    const FOREVER: Duration = Duration::from_secs(60);
    const FOREVER_S: f64 = 60.0;

    /// Runs a script called M101 in a folder, and returns its output and result.
    fn outcome(
        script: &str,
        timeout_s: f64,
        cancel_at_first_line: bool,
    ) -> (Vec<String>, Result<(), String>) {
        let (lines, result, _) = timed_outcome(script, timeout_s, cancel_at_first_line);
        (lines, result)
    }

    /// The same with the time from the start of the script to its end, excluding the wait for its turn.
    fn timed_outcome(
        script: &str,
        timeout_s: f64,
        cancel_at_first_line: bool,
    ) -> (Vec<String>, Result<(), String>, Duration) {
        let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("M101");
        std::fs::write(&file, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&file, PermissionsExt::from_mode(0o755)).unwrap();
        let codes = UserCodes {
            folder: folder.path().to_path_buf(),
            timeout: Duration::from_secs_f64(timeout_s),
            machine_name: "mill".to_owned(),
        };
        let call = UserCall {
            number: 101,
            words: [Some(2.5), None],
            line: 7,
        };
        let (begin, mut lines) = (Instant::now(), Vec::new());
        let mut program = codes.start(call);
        loop {
            match program.poll() {
                Some(UserNews::Line(line)) => lines.push(line),
                Some(UserNews::Ended(result)) => {
                    assert!(program.is_over());
                    return (lines, result, begin.elapsed());
                }
                None => thread::sleep(Duration::from_millis(1)),
            }
            if cancel_at_first_line && !lines.is_empty() {
                program.cancel();
            }
            assert!(begin.elapsed() < FOREVER, "never ends");
        }
    }

    #[test]
    fn a_user_code_gets_its_words_and_its_output_is_kept() {
        let (lines, result) = outcome(
            "echo \"$1 $2 $# $EVOLVENT_MACHINE_NAME $EVOLVENT_LINE\"; [ -x M101 ] && echo here >&2",
            FOREVER_S,
            false,
        );
        assert_eq!(result, Ok(()));
        assert_eq!(lines, ["2.5 -1 2 mill 7", "here"]);
    }

    #[test]
    fn words_are_no_shell() {
        let call = UserCall {
            number: 150,
            words: [Some(-0.25), Some(1e9)],
            line: 1,
        };
        assert_eq!(call.text(), "M150 P-0.25 Q1000000000");
    }

    #[test]
    fn a_failed_killed_or_hung_user_code_is_explained() {
        for (script, timeout_s, said) in [
            ("exit 3", FOREVER_S, "exit code 3"),
            ("kill -9 $$", FOREVER_S, "killed by signal 9"),
            ("trap '' TERM; sleep 300", 0.3, "did not end within 0.3 s"),
        ] {
            let (_, result) = outcome(script, timeout_s, false);
            let text = result.unwrap_err();
            assert!(
                text.contains(said) && text.starts_with("M101 P2.5: "),
                "{script}: {text}"
            );
        }
    }

    #[test]
    fn a_stop_ends_a_program_and_all_that_it_has_started() {
        let (lines, result) = outcome("sleep 333.25 & echo $!; wait", FOREVER_S, true);
        assert!(result.unwrap_err().contains("stop"));
        let child = format!("/proc/{}/cmdline", lines[0].parse::<u32>().unwrap());
        let begin = Instant::now();
        while std::fs::read_to_string(&child).is_ok_and(|left| left.contains("333.25")) {
            assert!(begin.elapsed() < FOREVER, "it sleeps on");
            thread::sleep(LOOK_EVERY);
        }
    }

    #[test]
    fn background_processes_do_not_delay_the_program() {
        let (_, result, took) = timed_outcome("sleep 30 & exit 0", 25.0, false);
        assert_eq!(result, Ok(()));
        assert!(took < Duration::from_secs(20), "{took:?}");
    }

    #[test]
    fn last_output_is_kept_although_the_pipe_stays_open() {
        let script = "sleep 30 & seq 3000; printf 'no end of line'";
        let (lines, result) = outcome(script, FOREVER_S, false);
        assert_eq!(result, Ok(()));
        let mut expected: Vec<String> = (1..=3000).map(|number| number.to_string()).collect();
        expected.push("no end of line".to_owned());
        assert_eq!(lines, expected);
    }

    /// However late the poll is.
    #[test]
    fn one_look_tells_all_that_is_in_the_pipe() {
        use std::io::Write;
        let (output, mut input) = std::io::pipe().unwrap();
        rustix::io::ioctl_fionbio(&output, true).unwrap();
        rustix::io::ioctl_fionbio(&input, true).unwrap();
        let (sender, news) = mpsc::channel();
        let mut output = Output::new(output, &sender);
        assert!(output.tell() && news.try_recv().is_err(), "nothing yet");
        let line = "x".repeat(99);
        // The system may provide small pipes only.
        let whole = format!("{line}\n");
        let written = (0..600)
            .take_while(|_| input.write_all(whole.as_bytes()).is_ok())
            .count();
        assert!(output.tell(), "it is still open");
        assert_eq!(
            news.try_iter().collect::<Vec<_>>(),
            vec![UserNews::Line(line); written]
        );
    }

    #[test]
    fn endless_output_is_cut() {
        let (lines, result) = outcome("yes 0123456789 | head -c 1000000", FOREVER_S, false);
        assert_eq!(result, Ok(()));
        assert!(lines.len() < 10_000 && lines[lines.len() - 1] == "(more was written)");
    }

    #[test]
    fn what_is_missing_or_everybody_s_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let codes = UserCodes {
            folder: folder.path().to_path_buf(),
            timeout: Duration::from_secs(1),
            machine_name: String::new(),
        };
        assert!(codes.objection(101).unwrap().contains("M101"));
        let file = folder.path().join("M101");
        std::fs::write(&file, "#!/bin/sh\n").unwrap();
        for (mode, said) in [(0o644, "not executable"), (0o757, "by everyone")] {
            std::fs::set_permissions(&file, PermissionsExt::from_mode(mode)).unwrap();
            assert!(codes.objection(101).unwrap().contains(said));
        }
        std::fs::set_permissions(&file, PermissionsExt::from_mode(0o750)).unwrap();
        assert_eq!(codes.objection(101), None);
    }
}

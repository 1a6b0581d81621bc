//! Uploaded programs: checked, and planned for the picture, in threads of normal priority.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::Bytes;
use evolvent_analysis::{FeedWords, LimitClassifier};
use evolvent_bus::flags;
use evolvent_gcode::Diagnostic;
use evolvent_runtime::{CheckBounds, Clock, Controls, Job, Notice, RunObserver, Setup, Warning, check, run};
use tokio::sync::mpsc;

use crate::messages::{Finding, PathChunk, ProgramInfo, ToPage, ToolEntry, WorkOffset};
use crate::streaming::hand_over;

/// Maximum number of errors shown.
const ERRORS: usize = 50;
/// Vertices per chunk of the path.
const CHUNK: usize = 16_384;
/// The first chunk is small, so that it is shown at once.
const FIRST_CHUNK: usize = 64;
/// A chunk that is not full is sent after this time: a slow plan is drawn as it grows.
const CHUNK_TIME: Duration = Duration::from_millis(250);
/// A path with more vertices is not shown to its end: a program may loop for ever.
const MAX_VERTICES: usize = 8_000_000;
/// Time between two vertices of the path, ns.
const VERTEX_NS: u64 = 8_000_000;
/// Maximum length of a program name, bytes: it fits into the status.
const MAX_NAME: usize = 100;

/// Whether a page may use it as the name of a file.
pub(crate) fn is_good_name(name: &str) -> bool {
    let good = |letter: char| letter.is_alphanumeric() || "._- +()".contains(letter);
    !name.is_empty() && name.len() <= MAX_NAME && !name.starts_with('.') && name.chars().all(good)
}

/// The machine with the present offsets and tools.
pub(crate) fn present_setup(setup: &Setup, state_folder: Option<&Path>) -> Setup {
    let mut setup = setup.clone();
    let Some(state_folder) = state_folder else {
        return setup;
    };
    // The core reports unreadable files; the picture is made without them.
    let kept = setup.memory.kept_file.clone();
    let _unread = setup
        .memory
        .load_parameters(kept.unwrap_or_else(|| state_folder.join("parameters.var")));
    let tools = setup.memory.tools_file.clone();
    let _unread = setup
        .memory
        .load_tools(tools.unwrap_or_else(|| state_folder.join("tools.tbl")));
    setup
}

/// The present offsets and tools.
pub(crate) fn kept(setup: &Setup, state_folder: Option<&Path>) -> ToPage {
    let memory = present_setup(setup, state_folder).memory;
    let text = memory.kept.map(|kept| kept.to_text()).unwrap_or_default();
    let parameter = |number: u32| {
        text.lines().find_map(|line| {
            let mut words = line.split_whitespace();
            (words.next()?.parse() == Ok(number)).then(|| words.next()?.parse::<f64>().ok())?
        })
    };
    let axes: Vec<usize> = setup
        .machine
        .axes
        .iter()
        .map(|axis| axis.letter.index())
        .collect();
    let offsets = (1..=9).map(|system| WorkOffset {
        system,
        values: axes
            .iter()
            .map(|&axis| parameter(5201 + 20 * system + axis as u32).unwrap_or(0.0))
            .collect(),
    });
    let tools = memory
        .tools
        .iter()
        .flat_map(|table| table.tools())
        .map(|tool| ToolEntry {
            number: tool.number,
            offsets: axes.iter().map(|&axis| tool.offset[axis]).collect(),
            diameter: tool.diameter_mm,
            comment: String::new(),
        });
    ToPage::Kept {
        offsets: offsets.collect(),
        tools: tools.collect(),
    }
}

/// Checks a program, as `evolvent check` does.
pub(crate) fn checked(
    file: &Path,
    info: &ProgramInfo,
    setup: &Setup,
    state_folder: Option<&Path>,
) -> ProgramInfo {
    let setup = present_setup(setup, state_folder);
    let (errors, warnings) = match check(file, &setup, CheckBounds::whole(ERRORS)) {
        Ok(found) => (
            found.errors.iter().map(error).collect(),
            found.warnings.into_iter().map(warning).collect(),
        ),
        Err(cause) => (vec![unreadable(&cause)], Vec::new()),
    };
    ProgramInfo {
        errors,
        warnings,
        checked: true,
        ..info.clone()
    }
}

fn error(found: &Diagnostic) -> Finding {
    Finding {
        line: found.line,
        column: found.column,
        length: found.length,
        code: found.code.as_str().to_owned(),
        message: found.message.clone(),
        help: found.help.as_deref().unwrap_or_default().to_owned(),
        file: found.file.as_deref().map(str::to_owned),
    }
}

fn warning(found: Warning) -> Finding {
    Finding {
        line: found.line,
        column: 0,
        length: 0,
        code: String::new(),
        message: found.message,
        help: String::new(),
        file: found.file,
    }
}

fn unreadable(cause: &std::io::Error) -> Finding {
    Finding {
        line: 0,
        column: 0,
        length: 0,
        code: String::new(),
        message: format!("the program cannot be read: {cause}"),
        help: "upload it again".to_owned(),
        file: None,
    }
}

/// Niceness of computations for pages: machine control has priority.
const NICE: i32 = 10;

/// Runs a function in a separate thread that yields the processor to others.
pub(crate) fn background(name: &str, work: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    std::thread::Builder::new().name(name.to_owned()).spawn(move || {
        // On Linux the priority is a thread's own, and its children's.
        let _kept = rustix::process::setpriority_process(Some(rustix::thread::gettid()), NICE);
        work();
    })?;
    Ok(())
}

struct Quiet;

impl RunObserver for Quiet {
    fn progress(&mut self, _controls: &Controls) {}
    fn notice(&mut self, _notice: &Notice) {}
    fn note(&mut self, _text: &str) {}
}

/// Plans a program and passes its path on in chunks until the receiver is dropped. Returns the planned time,
/// s, if it reached the end.
pub(crate) fn plan(
    file: PathBuf,
    setup: &Setup,
    state_folder: Option<&Path>,
    chunks: &mpsc::Sender<Bytes>,
) -> Option<f64> {
    let setup = present_setup(setup, state_folder);
    let every = (VERTEX_NS / setup.period_ns.max(1)).max(1);
    let job = Job {
        program: file,
        setup,
        clock: Clock::Virtual,
        feed_override: 1.0,
        trace: None,
        bus: false,
        bus_prefix: None,
        wait_for_subscribers: 0,
        inputs: None,
        optional_stop: false,
        stop_at_program_stops: false,
    };
    let controls = Arc::new(Controls::new(1.0));
    let classifier = LimitClassifier::new(&job.setup.machine, job.setup.period_ns as f64 * 1e-9);
    // A program that cannot be opened is the run's to complain of.
    let mut feeds = FeedWords::open(&job.program, &job.setup).ok();
    let (mut chunk, mut full, mut line) = (PathChunk::default(), FIRST_CHUNK, u32::MAX);
    let mut sent_at = Instant::now();
    let mut sent = 0;
    let outcome = run(&job, &controls, &mut Quiet, |setpoint| {
        if setpoint.sequence % every != 0 && setpoint.line == line {
            return;
        }
        line = setpoint.line;
        let [x, y, z] = [0, 1, 2].map(|axis| setpoint.position[axis] as f32);
        let is_rapid = setpoint.flags & flags::RAPID != 0;
        let feed = if is_rapid {
            -setpoint.feed_mm_s
        } else {
            setpoint.feed_mm_s
        };
        let word = feeds.as_mut().and_then(|feeds| feeds.of_block(setpoint.block));
        let limit = classifier.classify(setpoint, word).index() as u8;
        chunk.push([x, y, z], feed as f32, setpoint.line, limit);
        let is_late = full == CHUNK && sent_at.elapsed() >= CHUNK_TIME;
        if chunk.len() >= full || is_late {
            sent += chunk.len();
            full = CHUNK;
            if sent > MAX_VERTICES || !hand_over(chunks, chunk.take_bytes().into()) {
                controls.stop();
            }
            sent_at = Instant::now();
        }
    });
    if !chunk.is_empty() {
        // The receiver may be gone.
        let _gone = hand_over(chunks, chunk.take_bytes().into());
    }
    let outcome = outcome.ok()?;
    (outcome.program.is_ok() && outcome.fault.is_none() && !controls.is_stopping())
        .then_some(outcome.summary.duration_s)
}

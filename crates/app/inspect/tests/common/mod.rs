//! Recorded runs for tests, and changed copies of them.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]
#![allow(
    dead_code,
    unreachable_pub,
    reason = "not every helper has a user at all times"
)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use evolvent_machine::{ControlRate, Machine};
use evolvent_runtime::{Clock, Controls, Job, Notice, RunObserver, RunOutcome, Setup, run};
use evolvent_trace::{CycleRecord, ProgramSource, Recorder, RunInfo, TraceFile};

/// Lines, arcs, blends, a dwell, a program stop and exact path, in about two seconds.
pub const PROGRAM: &str = "\
(a <part> & more)
G17 G21 G90 G94 G64 P0.01
M3 S1000
G0 X5 Y0
G1 X20 Y0 F6000
G3 X20 Y10 J5
G1 X0
G4 P0.1
G1 X-5 Y5 Z-1
M1
G2 X-10 Y10 I-5
G61
G1 X0 Y0
G64
G0 X5 Z2
M30
";

/// The same path, back and forth, for some seconds.
pub fn long_program(turns: usize) -> String {
    format!(
        "G21 G90 G94 G64 P0.02 F3000\n{}M30\n",
        "G1 X40 Y20\nG1 X-40 Y-15\nG2 X-20 Y5 R20\n".repeat(turns)
    )
}

pub fn machine_file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml")
}

/// The shipped mill at 1 kHz, its traces with cycles in columns or as messages.
pub fn setup(columns: bool) -> Setup {
    let text = std::fs::read_to_string(machine_file())
        .expect("the shipped mill")
        .replace("# max_late_cycles = 1000", "max_late_cycles = 0")
        .replace(
            "[trace]\n",
            if columns {
                "[trace]\ncycles = \"columns\"\n"
            } else {
                "[trace]\n"
            },
        );
    let machine = Machine::parse(&text, "mill-3axis.toml").expect("a machine");
    Setup::new(machine, machine_file(), text, Some(ControlRate::Hz(1000.0))).expect("a rate")
}

struct Silent;

impl RunObserver for Silent {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}

/// Runs a program and records it.
pub fn record(
    folder: &Path,
    name: &str,
    program: &str,
    clock: Clock,
    feed_override: f64,
    meanwhile: impl FnOnce(&Controls) + Send,
) -> (PathBuf, RunOutcome) {
    let file = folder.join(format!("{name}.ngc"));
    std::fs::write(&file, program).expect("a program");
    let trace = folder.join(format!("{name}.mcap"));
    let job = Job {
        clock,
        feed_override,
        trace: Some(trace.clone()),
        optional_stop: true,
        // Readers support both kinds of traces, so every other run is recorded in columns.
        ..Job::new(file, setup(name.len().is_multiple_of(2)))
    };
    let controls = Arc::new(Controls::new(feed_override));
    let outcome = std::thread::scope(|scope| {
        let controls_there = Arc::clone(&controls);
        scope.spawn(move || meanwhile(&controls_there));
        run(&job, &controls, &mut Silent, |_| {}).expect("a run")
    });
    (trace, outcome)
}

pub fn cycles(trace: &Path) -> Vec<CycleRecord> {
    let mut file = TraceFile::open(trace).expect("a trace");
    file.cycles().map(|cycle| cycle.expect("a cycle")).collect()
}

/// Records a trace again with its description and its cycles changed.
pub fn altered(
    trace: &Path,
    name: &str,
    describe: impl FnOnce(&mut RunInfo),
    mut change: impl FnMut(&mut CycleRecord) -> bool,
) -> PathBuf {
    let mut file = TraceFile::open(trace).expect("a trace");
    let mut info = file.info().run.clone().expect("a run");
    let text = file
        .attachment(&info.machine_file_name)
        .expect("readable")
        .expect("there");
    info.machine_file = String::from_utf8(text).expect("UTF-8");
    let program = file.attachment(&info.program_name).expect("readable");
    info.program = program.map_or(ProgramSource::None, ProgramSource::Bytes);
    describe(&mut info);
    let summary: BTreeMap<String, String> = file.info().summary.clone();
    let output = trace.with_file_name(format!("{name}.mcap"));
    let mut recorder = Recorder::create(&output, &info).expect("a recorder");
    for cycle in file.cycles() {
        let mut cycle = cycle.expect("a cycle");
        if change(&mut cycle) {
            recorder.cycle(&cycle).expect("room");
        }
    }
    recorder.finish(&summary).expect("room");
    output
}

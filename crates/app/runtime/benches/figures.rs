//! The figures of docs/benchmarks.md: `cargo bench -p evolvent-runtime --bench figures [-- SECONDS]`.
//!
//! Prints a table. Times are those of this host at this moment, so compare lines of the same run.

#![allow(
    clippy::print_stdout,
    clippy::expect_used,
    reason = "a benchmark prints, and ends where it cannot be set up"
)]

use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use evolvent_gcode::{Action, CanonicalCommand, Interpreter};
use evolvent_machine::{ControlRate, Machine, PlannerKind};
use evolvent_motion::{Inputs, PathExecutor, PlanConsumer, PlanProducer, plan_queue};
use evolvent_planner::Planner;
use evolvent_runtime::{
    Clock, Controls, Job, Notice, RealtimeRequest, RunObserver, Setup, Summary, bare_loop, run,
};
use evolvent_trace::Histogram;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

fn setup(machine: &str, rate: Option<ControlRate>) -> Setup {
    let file = root().join("config/machines").join(machine);
    let text = std::fs::read_to_string(&file).expect("machine file");
    Setup::new(Machine::load(&file).expect("machine"), file, text, rate).expect("rate")
}

/// A planner that plans on request, for a program that the caller drives step by step.
struct Ahead {
    commands: Box<dyn Iterator<Item = CanonicalCommand>>,
    planner: Planner<PlanProducer<fn() -> bool>>,
    block: u32,
    ended: bool,
    /// The longest time without a check for requests of the cycle.
    longest: Duration,
}

impl Ahead {
    fn new(program: &Path, setup: &Setup) -> (Self, PlanConsumer) {
        let (producer, queue) = plan_queue((|| false) as fn() -> bool);
        let planner = Planner::new(setup.path_limits(), setup.path_rules(1.0), producer);
        let reader = BufReader::new(File::open(program).expect("program"));
        let commands = Interpreter::new(reader, setup.interpreter_settings())
            .map(|command| command.expect("program without errors"));
        let ahead = Self {
            commands: Box::new(commands),
            planner,
            block: 0,
            ended: false,
            longest: Duration::ZERO,
        };
        (ahead, queue)
    }

    fn go_on(&mut self) {
        let command = self.commands.next();
        let start = Instant::now();
        match command {
            Some(command) => {
                if let Action::Move(motion) = command.action {
                    self.planner
                        .push(&motion, command.line, self.block)
                        .expect("plan");
                    self.block += 1;
                }
            }
            None if self.ended => self.planner.poll().expect("plan"),
            None => {
                self.planner.finish(0).expect("finish");
                self.ended = true;
            }
        }
        self.longest = self.longest.max(start.elapsed());
    }
}

/// Time of each step including its two queues, as in the loop, and the longest time in which the planner did
/// not check for requests.
fn own_work(program: &str, rate_hz: f64, planner: PlannerKind) -> (Histogram, u64, Duration) {
    let mut setup = setup("mill-3axis.toml", Some(ControlRate::Hz(rate_hz)));
    setup.machine.path.planner = planner;
    let mut histogram = Histogram::default();
    let (mut ahead, mut queue) = Ahead::new(&root().join("tests/programs").join(program), &setup);
    let limits = setup.machine.limits();
    let mut motion = PathExecutor::new(limits, setup.period_ns, limits.home);
    let (mut to_bus, mut bus) = rtrb::RingBuffer::new(1024);
    let (mut to_trace, mut trace) = rtrb::RingBuffer::new(1024);
    let inputs = Inputs::default();
    let mut cycles = 0;
    while !motion.is_over() && cycles < 2_000_000 {
        while !motion.is_ready(&mut queue) {
            ahead.go_on();
        }
        let start = Instant::now();
        let setpoint = motion.step(&inputs, &mut queue);
        let _full = to_bus.push(setpoint);
        let _full = to_trace.push(setpoint);
        histogram.record(start.elapsed().as_nanos() as i64);
        // The other ends are emptied outside the measured time.
        let _taken = (bus.pop(), trace.pop());
        cycles += 1;
    }
    (histogram, cycles, ahead.longest)
}

struct Silent;

impl RunObserver for Silent {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}

fn job(program: PathBuf, setup: Setup, clock: Clock, trace: Option<PathBuf>) -> Job {
    Job {
        clock,
        trace,
        ..Job::new(program, setup)
    }
}

/// Runs a job. Returns its summary, its duration, and the time until the first setpoint.
fn timed(job: &Job) -> (Summary, Duration, Duration) {
    let controls = Arc::new(Controls::new(1.0));
    let start = Instant::now();
    let mut first = None;
    let outcome = run(job, &controls, &mut Silent, |_| {
        first.get_or_insert_with(|| start.elapsed());
    })
    .expect("run");
    outcome.program.expect("program without errors");
    (outcome.summary, start.elapsed(), first.unwrap_or_default())
}

fn stopped_after(job: &Job, time: Duration) -> Summary {
    let controls = Arc::new(Controls::new(1.0));
    let stopper = Arc::clone(&controls);
    let watch = std::thread::spawn(move || {
        std::thread::sleep(time);
        stopper.stop();
    });
    let outcome = run(job, &controls, &mut Silent, |_| {}).expect("run");
    watch.join().expect("timer");
    outcome.summary
}

fn million_lines(path: &Path) {
    let mut out = BufWriter::new(File::create(path).expect("temporary file"));
    writeln!(out, "G21 G90 G64 P0.01 F6000\nG0 X0 Y0 Z0").expect("write");
    for i in 0..1_000_000 {
        let t = f64::from(i) * 0.0005;
        let (x, y, z) = (
            50.0 * t.sin(),
            50.0 * (1.3 * t + 0.4).sin() - 19.47,
            5.0 * (0.11 * t).sin(),
        );
        writeln!(out, "G1 X{x:.4} Y{y:.4} Z{z:.4}").expect("write");
    }
    writeln!(out, "M30").expect("write");
}

/// Maximum resident memory of this process, MB.
fn resident_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status
        .lines()
        .find(|line| line.starts_with("VmHWM"))
        .unwrap_or_default();
    line.split_whitespace()
        .nth(1)
        .and_then(|kb| kb.parse::<f64>().ok())
        .unwrap_or(f64::NAN)
        / 1024.0
}

fn us(ns: i64) -> f64 {
    ns as f64 / 1000.0
}

fn row(what: &str, figure: &str) {
    println!("| {what} | {figure} |");
}

fn fast() -> Setup {
    setup("mill-3axis.toml", Some(ControlRate::Hz(35_000.0)))
}

fn long_program(folder: &Path) {
    let program = folder.join("million.ngc");
    million_lines(&program);
    let (summary, time, first) = timed(&job(
        program,
        setup("mill-3axis.toml", None),
        Clock::Virtual,
        None,
    ));
    row(
        "1 000 000 lines: first setpoint",
        &format!("{:.3} s", first.as_secs_f64()),
    );
    row(
        "1 000 000 lines: largest resident memory",
        &format!("{:.0} MB", resident_mb()),
    );
    row(
        "1 000 000 lines: planned and stepped",
        &format!(
            "{:.1} s, {:.0} blocks/s, path time {:.0} s",
            time.as_secs_f64(),
            1e6 / time.as_secs_f64(),
            summary.duration_s
        ),
    );
}

fn work_of_cycles() {
    for program in ["letters.ngc", "bore-200.ngc", "relief.ngc"] {
        for rate in [250.0, 1000.0, 10_000.0, 35_000.0] {
            for planner in [PlannerKind::Optimal, PlannerKind::Classic] {
                let (histogram, cycles, longest) = own_work(program, rate, planner);
                row(
                    &format!("own work, step and hand-over, {program}, {rate} Hz, {planner:?}"),
                    &format!(
                        "p50 {:.2} us, p99.9 {:.2} us, most {:.0} us ({cycles} cycles); the planner's \
                         longest piece of work {:.2} ms",
                        us(histogram.percentile_ns(50.0)),
                        us(histogram.percentile_ns(99.9)),
                        us(histogram.max_ns()),
                        1e3 * longest.as_secs_f64()
                    ),
                );
            }
        }
    }
}

fn virtual_clock(folder: &Path) {
    for program in ["bore-200.ngc", "letters.ngc"] {
        let file = root().join("tests/programs").join(program);
        let (summary, time, _) = timed(&job(file.clone(), fast(), Clock::Virtual, None));
        let rate = summary.cycles as f64 / time.as_secs_f64();
        row(
            &format!("virtual clock, no trace, {program}"),
            &format!("{:.2} million cycles/s", rate / 1e6),
        );
        let trace = folder.join(format!("{program}.mcap"));
        let (summary, time, _) = timed(&job(file, fast(), Clock::Virtual, Some(trace.clone())));
        let rate = summary.cycles as f64 / time.as_secs_f64();
        let bytes = std::fs::metadata(&trace).map_or(0, |meta| meta.len()) as f64 / summary.cycles as f64;
        row(
            &format!("virtual clock, with trace, {program}"),
            &format!("{:.2} million cycles/s, {bytes:.0} bytes a cycle", rate / 1e6),
        );
    }
}

fn limits_of_programs() {
    let bore = root().join("tests/programs/bore-200.ngc");
    let (summary, _, _) = timed(&job(bore, setup("mill-3axis.toml", None), Clock::Virtual, None));
    row(
        "bore-200 at the rational rate: chord error",
        &format!(
            "{:.3} of 1 um at {:.2} Hz",
            1000.0 * summary.max_chord_error_mm,
            summary.rate_hz
        ),
    );
    for program in [
        "bore-200.ngc",
        "letters.ngc",
        "pocket-helix.ngc",
        "bracket-g61.ngc",
        "facing-inch.ngc",
        "relief.ngc",
    ] {
        for rate in [
            None,
            Some(ControlRate::Hz(250.0)),
            Some(ControlRate::Hz(1000.0)),
            Some(ControlRate::Hz(10_000.0)),
            Some(ControlRate::Hz(35_000.0)),
        ] {
            let setup = setup("mill-3axis.toml", rate);
            let (summary, _, _) = timed(&job(
                root().join("tests/programs").join(program),
                setup,
                Clock::Virtual,
                None,
            ));
            let most = |list: &[f64]| list.iter().copied().fold(0.0, f64::max);
            row(
                &format!("{program} at {:.2} Hz: ratio to limits", summary.rate_hz),
                &format!(
                    "v {:.6}, a {:.6}, j {:.4}; chord {:.3} um; {:.3} s",
                    most(&summary.velocity_ratio),
                    most(&summary.acceleration_ratio),
                    most(&summary.jerk_ratio),
                    1000.0 * summary.max_chord_error_mm,
                    summary.duration_s
                ),
            );
        }
    }
}

fn real_time(folder: &Path, seconds: u64) {
    let request = RealtimeRequest {
        priority: Some(80),
        core: None,
        lock_memory: true,
    };
    match bare_loop(35_000.0, Duration::from_secs(seconds.min(20)), &request) {
        Ok(report) => row("35 kHz bare loop, nothing else", &format!("{report:?}")),
        Err(error) => row("35 kHz bare loop", &format!("not measured: {error}")),
    }
    let trace = folder.join("realtime.mcap");
    let letters = root().join("tests/programs/letters.ngc");
    let summary = stopped_after(
        &job(letters, fast(), Clock::Realtime, Some(trace)),
        Duration::from_secs(seconds),
    );
    row(
        &format!("35 kHz in real time, {seconds} s, traced"),
        &format!(
            "{} cycles, {} records dropped, {} late setpoints; woken {:?}; own work {:?}; {:?}",
            summary.cycles,
            summary.dropped_records,
            summary.late_cycles,
            summary.wake_lateness,
            summary.work,
            summary.notes
        ),
    );
}

fn main() {
    let seconds = std::env::args()
        .filter_map(|text| text.parse::<u64>().ok())
        .next()
        .unwrap_or(60);
    let folder = std::env::temp_dir().join(format!("evolvent-figures-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary folder");
    println!("| what | figure |\n|---|---|");
    // Measured first, before anything else has used memory.
    long_program(&folder);
    work_of_cycles();
    virtual_clock(&folder);
    limits_of_programs();
    real_time(&folder, seconds);
    drop(std::fs::remove_dir_all(&folder));
}

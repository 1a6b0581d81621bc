//! A lathe with simulated spindles, and the phase of its threads.

use std::path::{Path, PathBuf};

use evolvent_trace::{EventKind, TraceFile};

use crate::{Domain, Drives, Finished, Launch, Workshop, cycles};

/// Numbers of inputs in a trace: a sample of the spindle angle, and the setpoint that is due then.
const TURNS: u32 = 96;
const CYCLE: u32 = 97;
const Z: usize = 2;

const MACHINE: &str = r#"
description = "Two-axis lathe with measured spindles"
kind = "lathe"
increments_per_mm = 10000
rate = 1000
[[axis]]
letter = "X"
kind = "linear"
travel_min_mm = -10
travel_max_mm = 200
max_velocity_mm_min = 12000
max_acceleration_m_s2 = 3
max_jerk_m_s3 = 100
home_mm = 20
[[axis]]
letter = "Z"
kind = "linear"
travel_min_mm = -100
travel_max_mm = 600
max_velocity_mm_min = 20000
max_acceleration_m_s2 = 4
max_jerk_m_s3 = 100
home_mm = 10
[drives]
feedback_timeout_ms = 1000
[signals]
input_timeout_ms = 500
"#;

impl Workshop {
    /// A two-axis lathe with these spindles.
    #[must_use]
    pub fn lathe(&self, name: &str, spindles: &str) -> PathBuf {
        self.write("lathe.toml", format!("name = {name:?}{MACHINE}{spindles}"))
    }

    /// Runs a program on a lathe with simulated spindles and options of `bridge sim`. Returns the result and
    /// the trace.
    #[must_use]
    pub fn turn(&self, machine: &Path, program: &str, options: &[&str]) -> (Finished, PathBuf) {
        let domain = Domain::new();
        let program = self.write("program.ngc", program);
        let trace = self.path("run.mcap");
        let _drives = Drives::start(machine, &domain, options);
        let finished = Launch::in_real_time(&program, machine, &domain)
            .with(&["--wait-for-clients", "1"])
            .trace(&trace)
            .finish();
        (finished, trace)
    }
}

/// Samples of the encoder: the setpoint that is due then, with its fraction, and the turns.
///
/// # Panics
/// If the trace cannot be read.
#[must_use]
pub fn angles(trace: &Path) -> Vec<(f64, f64)> {
    let mut file = TraceFile::open(trace).expect("a trace");
    let (mut turns, mut samples) = (0.0, Vec::new());
    for event in file.events().map(|event| event.expect("a readable event")) {
        match (event.kind, event.code, event.value) {
            (EventKind::Input, TURNS, Some(value)) => turns = value,
            (EventKind::Input, CYCLE, Some(value)) => samples.push((value, turns)),
            _ => {}
        }
    }
    samples
}

/// A pass of a thread, measured by the samples of the encoder.
#[derive(Clone, Copy, Debug)]
pub struct ThreadPass {
    /// Maximum distance of Z from the thread, mm.
    pub worst_mm: f64,
    /// Number of samples compared.
    pub samples: usize,
}

/// The passes towards negative Z of a thread that begins at `start` and a whole turn, between these
/// positions, mm.
///
/// # Panics
/// If the trace cannot be read, or has no cycles.
#[must_use]
pub fn phases(trace: &Path, pitch: f64, start: f64, z_range: std::ops::Range<f64>) -> Vec<ThreadPass> {
    let all = cycles(trace);
    let first = all.first().expect("cycles").sequence;
    let mut passes: Vec<ThreadPass> = Vec::new();
    let mut last_cycle = f64::NEG_INFINITY;
    for (cycle, turns) in angles(trace) {
        let at = cycle - first as f64;
        let (Some(here), Some(next)) = (all.get(at.floor() as usize), all.get(at.floor() as usize + 1))
        else {
            continue;
        };
        let z = here.position[Z] + at.fract() * (next.position[Z] - here.position[Z]);
        if here.velocity[Z] >= -1.0 || !z_range.contains(&z) {
            continue;
        }
        if cycle > last_cycle + 50.0 {
            passes.push(ThreadPass {
                worst_mm: 0.0,
                samples: 0,
            });
        }
        last_cycle = cycle;
        let turned = turns - (start - z) / pitch;
        let error = (turned - turned.round()).abs() * pitch;
        if let Some(pass) = passes.last_mut() {
            pass.worst_mm = pass.worst_mm.max(error);
            pass.samples += 1;
        }
    }
    passes
}

//! A lathe with two measured spindles: `$` selects the one that turns, threads, stops at an angle, or gives the feed.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::{Path, PathBuf};

use evolvent_tests::{Domain, Drives, Finished, Launch, Workshop, cycles, evolvent, unless_disturbed};
use evolvent_trace::{EventKind, TraceFile};

/// Numbers in a trace: how spindle 1 is, the angle of a spindle and its time, and which spindle that is.
const SPINDLE_1: u32 = 81;
const TURNS: u32 = 96;
const CYCLE: u32 = 97;
const ANGLE_SPINDLE: u32 = 102;
const Z: usize = 2;

const LATHE: &str = r#"
name = "two-spindles"
description = "Two-axis lathe with a main and a sub spindle"
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
[[spindle]]
max_rpm = 4000
feedback = true
[[spindle]]
number = 1
max_rpm = 2000
reverse = false
feedback = true
acceleration_rpm_s = 2000
"#;

fn drive(workshop: &Workshop, program: &str, options: &[&str]) -> (Finished, PathBuf) {
    let domain = Domain::new();
    let machine = workshop.write("lathe.toml", LATHE);
    let program = workshop.write("program.ngc", program);
    let trace = workshop.path("run.mcap");
    let _drives = Drives::start(&machine, &domain, options);
    let finished = Launch::in_real_time(&program, &machine, &domain)
        .with(&["--wait-for-clients", "1"])
        .trace(&trace)
        .finish();
    (finished, trace)
}

/// The events of inputs of a trace: setpoint, number, value, text.
fn inputs(trace: &Path) -> Vec<(u64, u32, Option<f64>, String)> {
    let mut file = TraceFile::open(trace).expect("a trace");
    let events = file.events().map(|event| event.expect("a readable event"));
    events
        .filter(|event| event.kind == EventKind::Input)
        .map(|event| (event.sequence, event.code, event.value, event.text))
        .collect()
}

/// The notices of a trace in their order.
fn notices(trace: &Path) -> Vec<String> {
    let mut file = TraceFile::open(trace).expect("a trace");
    let events = file.events().map(|event| event.expect("a readable event"));
    events.map(|event| event.text).collect()
}

fn verifies(trace: &Path) {
    let output = evolvent().args(["trace", "verify"]).arg(trace).output();
    Finished::from(output.expect("the binary to start")).expect_code(&[0]);
}

/// Largest distance in mm between Z and a thread of this pitch that begins at `start` and a whole turn.
fn worst_phase_mm(trace: &Path, pitch: f64, start: f64, places: std::ops::Range<f64>) -> (f64, usize) {
    let all = cycles(trace);
    let first = all.first().expect("cycles").sequence as f64;
    let (mut turns, mut worst, mut count) = (0.0, 0.0_f64, 0);
    for (_, code, value, _) in inputs(trace) {
        match (code, value) {
            (TURNS, Some(value)) => turns = value,
            (CYCLE, Some(cycle)) => {
                let at = cycle - first;
                let (Some(here), Some(next)) =
                    (all.get(at.floor() as usize), all.get(at.floor() as usize + 1))
                else {
                    continue;
                };
                let z = here.position[Z] + at.fract() * (next.position[Z] - here.position[Z]);
                if places.contains(&z) && here.velocity[Z] < -1.0 {
                    let turned = turns - (start - z) / pitch;
                    worst = worst.max((turned - turned.round()).abs() * pitch);
                    count += 1;
                }
            }
            _ => {}
        }
    }
    (worst, count)
}

#[test]
fn both_turn_and_the_named_one_threads_and_stops_at_its_angle() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G18 G90 G8\nS300 M3\nS900 M3 $1\nG0 X15 Z5\nG33 Z-15 K2 $1\nG0 X20\nM19 R90 $1\nG95 F0.5 S300 $0\nG1 Z-10\n\
                       M5 $-1\nM2\n";
        let (finished, trace) = drive(&workshop, program, &["--spindle-ripple", "2"]);
        finished.expect_code(&[0, 3]);
        // Spindle 1 gives the angle: at its speed, and not at that of spindle 0, the thread is in phase.
        let (worst_mm, samples) = worst_phase_mm(&trace, 2.0, 5.0, -13.0..0.0);
        println!("{worst_mm} mm in {samples} samples");
        assert!(samples > 100, "{samples}");
        // 2 um, a step of the encoder, and one more of that for the sample compared with.
        assert!(worst_mm <= 0.002 + 2.0 * 2.0 / 4096.0, "{worst_mm} mm");
        let told = inputs(&trace);
        let named: Vec<_> = told
            .iter()
            .filter(|(_, code, ..)| *code == ANGLE_SPINDLE)
            .map(|(_, _, value, _)| *value)
            .collect();
        assert_eq!(named, [Some(1.0)], "which spindle the angle is");
        let is_of_first = |text: &str| {
            told.iter()
                .any(|(_, code, _, said)| *code == SPINDLE_1 && said == text)
        };
        assert!(is_of_first("spindle 1 at speed") && is_of_first("spindle 1 oriented"));
        let told = notices(&trace);
        let at = |text: &str| {
            let found = told.iter().position(|said| said == text);
            found.unwrap_or_else(|| panic!("{text}: {told:?}"))
        };
        let order = [
            at("spindle clockwise 300 rpm"),
            at("spindle 1 clockwise 900 rpm"),
            at("spindle 1 to 90 degrees (M19)"),
            at("spindle 1 stop"),
        ];
        assert!(order.is_sorted(), "{order:?}");
        verifies(&trace);
    });
}

#[test]
fn a_tap_turns_its_own_spindle_back() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G18 G90 G8\nS400 M3\nS300 M3 $1\nG0 X15 Z5\nG33.1 Z-15 K1 $1\nG0 X20\nM2\n";
        // It cannot turn counter-clockwise, which the tap has to know before it moves.
        let (finished, _trace) = drive(&workshop, program, &[]);
        let said = finished.out.clone() + &finished.err;
        finished.expect_code(&[1]);
        assert!(said.contains("spindle 1"), "{said}");
        assert!(said.contains("reverse"), "{said}");
    });
}

#[test]
fn trouble_of_either_spindle_stops_the_machine() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G18 G90 G94 F600\nS500 M3 $1\nG1 Z200\nM2\n";
        let (finished, trace) = drive(&workshop, program, &["--fault", "spindle-fault@3"]);
        let said = finished.out.clone() + &finished.err;
        finished.expect_code(&[1]);
        assert!(said.contains("spindle"), "{said}");
        let last = cycles(&trace).pop().expect("cycles");
        assert!(last.position[Z] < 199.0 && last.velocity[Z] == 0.0);
        verifies(&trace);
    });
}

#[test]
fn what_a_spindle_cannot_do_is_refused_with_its_name() {
    let workshop = Workshop::new();
    let machine = workshop.write("lathe.toml", LATHE);
    for (line, message) in [
        ("M3 S10 $2", "the machine has no spindle 2"),
        ("M3 S3000 $1", "S3000: spindle 1 turns at 2000 rpm at most"),
        ("M4 S10 $1", "M4: spindle 1 turns clockwise only"),
        ("G96 S10 M4 $1", "M4: spindle 1 turns clockwise only"),
        ("M19 R3 $2", "the machine has no spindle 2"),
    ] {
        let program = workshop.write("program.ngc", format!("G21\n{line}\nM2\n"));
        for command in ["check", "plan"] {
            let output = evolvent()
                .arg(command)
                .arg(&program)
                .arg("--machine")
                .arg(&machine)
                .output();
            let finished = Finished::from(output.expect("the binary to start"));
            let said = finished.out.clone() + &finished.err;
            finished.expect_code(&[1]);
            assert!(
                said.contains(message) && said.contains("program.ngc:2"),
                "{line}: {said}"
            );
            assert!(said.contains("help"), "{line}: {said}");
        }
    }
}

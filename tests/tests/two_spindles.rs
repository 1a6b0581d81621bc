//! A lathe with two measured spindles: `$` selects the one that turns, threads, stops at an angle, or
//! determines the feed.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::{Path, PathBuf};

use evolvent_tests::{Finished, Workshop, cycles, evolvent, phases, unless_disturbed, verifies};
use evolvent_trace::{EventKind, TraceFile};

/// Numbers of inputs in a trace: the state of spindle 1, and the spindle of the angle.
const SPINDLE_1: u32 = 81;
const ANGLE_SPINDLE: u32 = 102;
const Z: usize = 2;

const SPINDLES: &str = "
[[spindle]]
max_rpm = 4000
feedback = true
[[spindle]]
number = 1
max_rpm = 2000
reverse = false
feedback = true
acceleration_rpm_s = 2000
";

fn lathe(workshop: &Workshop) -> PathBuf {
    workshop.lathe("two-spindles", SPINDLES)
}

fn drive(workshop: &Workshop, program: &str, options: &[&str]) -> (Finished, PathBuf) {
    workshop.turn(&lathe(workshop), program, options)
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

/// The notices of a trace in order.
fn notices(trace: &Path) -> Vec<String> {
    let mut file = TraceFile::open(trace).expect("a trace");
    let events = file.events().map(|event| event.expect("a readable event"));
    events.map(|event| event.text).collect()
}

#[test]
fn the_named_one_of_two_spindles_threads_and_orients() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G18 G90 G8\nS300 M3\nS900 M3 $1\nG0 X15 Z5\nG33 Z-15 K2 $1\nG0 X20\nM19 R90 $1\n\
                       G95 F0.5 S300 $0\nG1 Z-10\nM5 $-1\nM2\n";
        let (finished, trace) = drive(&workshop, program, &["--spindle-ripple", "2"]);
        finished.expect_code(&[0, 3]);
        // Spindle 1 gives the angle: the thread is in phase at its speed, not at that of spindle 0.
        let passes = phases(&trace, 2.0, 5.0, -13.0..0.0);
        println!("{passes:?} mm");
        assert!(passes.len() == 1 && passes[0].samples > 100, "{passes:?}");
        // 2 um, a step of the encoder, and one more of that for the sample compared with.
        assert!(passes[0].worst_mm <= 0.002 + 2.0 * 2.0 / 4096.0, "{passes:?} mm");
        let texts = inputs(&trace);
        let named: Vec<_> = texts
            .iter()
            .filter(|(_, code, ..)| *code == ANGLE_SPINDLE)
            .map(|(_, _, value, _)| *value)
            .collect();
        assert_eq!(named, [Some(1.0)], "which spindle the angle is");
        let is_of_first = |text: &str| {
            texts
                .iter()
                .any(|(_, code, _, found_text)| *code == SPINDLE_1 && found_text == text)
        };
        assert!(is_of_first("spindle 1 at speed") && is_of_first("spindle 1 oriented"));
        let texts = notices(&trace);
        let at = |text: &str| {
            let found = texts.iter().position(|found_text| found_text == text);
            found.unwrap_or_else(|| panic!("{text}: {texts:?}"))
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
        // It cannot turn counter-clockwise, which the tap has to find out before it moves.
        let (finished, _trace) = drive(&workshop, program, &[]);
        let printed = finished.out.clone() + &finished.err;
        finished.expect_code(&[1]);
        assert!(printed.contains("spindle 1"), "{printed}");
        assert!(printed.contains("reverse"), "{printed}");
    });
}

#[test]
fn trouble_of_either_spindle_stops_the_machine() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G18 G90 G94 F600\nS500 M3 $1\nG1 Z200\nM2\n";
        let (finished, trace) = drive(&workshop, program, &["--fault", "spindle-fault@3"]);
        let printed = finished.out.clone() + &finished.err;
        finished.expect_code(&[1]);
        assert!(printed.contains("spindle"), "{printed}");
        let last = cycles(&trace).pop().expect("cycles");
        assert!(last.position[Z] < 199.0 && last.velocity[Z] == 0.0);
        verifies(&trace);
    });
}

#[test]
fn what_a_spindle_cannot_do_is_refused_with_its_name() {
    let workshop = Workshop::new();
    let machine = lathe(&workshop);
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
            let printed = finished.out.clone() + &finished.err;
            finished.expect_code(&[1]);
            assert!(
                printed.contains(message) && printed.contains("program.ngc:2"),
                "{line}: {printed}"
            );
            assert!(printed.contains("help"), "{line}: {printed}");
        }
    }
}

//! G96 and G95 in real time with a simulated spindle: the commands to the bridge, and what the feed refers
//! to.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use evolvent_bus::{ControlRequest, MachineOutputs};
use evolvent_tests::{
    Cycle, Domain, Drives, Launch, Operator, OutputListener, Served, Workshop, command, cycles,
    unless_disturbed, verifies,
};
use evolvent_trace::{EventKind, TraceFile};

/// Numbers of inputs in a trace: state and speed of spindle 0.
const SPINDLE: u32 = 80;
const SPEED: u32 = 98;
const MAX_RPM: f64 = 4000.0;

/// A mill with a measured spindle; its X is the radius. A bridge on a busy host may be silent for a while.
fn machine(workshop: &Workshop, name: &str) -> PathBuf {
    let file = workshop.mill(
        name,
        &[("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 1000 ")],
    );
    let text = std::fs::read_to_string(&file).expect("the machine file");
    let spindle = format!(
        "\n[signals]\ninput_timeout_ms = 500\n[[spindle]]\nmax_rpm = {MAX_RPM}\nfeedback = true\n\
         at_speed_timeout_s = 20\n"
    );
    workshop.write("machine.toml", text + &spindle)
}

/// The inputs with a number in a trace: the setpoint from which each applies, and its text.
fn inputs(trace: &Path, code: u32) -> Vec<(u64, String)> {
    let mut file = TraceFile::open(trace).expect("a trace");
    let events = file.events().map(|event| event.expect("a readable event"));
    events
        .filter(|event| event.kind == EventKind::Input && event.code == code)
        .map(|event| (event.sequence, event.text))
        .collect()
}

fn surface_rpm(metres_per_minute: f64, max_rpm: f64, radius_mm: f64) -> f64 {
    (1000.0 * metres_per_minute / (TAU * radius_mm.abs())).min(max_rpm)
}

#[test]
fn surface_speed_follows_the_radius_of_each_setpoint() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = machine(&workshop, "surface");
        // The centre is 20 mm from the zero of the machine.
        let program =
            "G21 G90 G95 G10 L2 P1 X20\nG0 X60\nG96 S120 D2500 M3\nG1 Y1 F0.4\nX4\nG0 X30\nG1 Y5\nM5\nM2\n";
        let program = workshop.write("program.ngc", program);
        let trace = workshop.path("run.mcap");
        let _drives = Drives::start(&machine, &domain, &["--spindle-acceleration", "1500"]);
        let listener = OutputListener::of(&domain, "surface");
        let launch = Launch::in_real_time(&program, &machine, &domain).trace(&trace);
        launch.finish().expect_code(&[0, 3]);
        let cycles = cycles(&trace);
        let messages = listener.messages();
        let turning = |message: &&MachineOutputs| message.spindle_direction[0] == 1;
        let commanded: Vec<_> = messages.iter().filter(turning).collect();
        for message in &commanded {
            let Some(cycle) = cycles.get(message.cycle as usize) else {
                continue;
            };
            let wanted = surface_rpm(120.0, 2500.0, cycle.position[0] - 20.0);
            let off = message.spindle_rpm[0] / wanted - 1.0;
            assert!(
                off.abs() < 0.002,
                "{} rpm at {}",
                message.spindle_rpm[0],
                cycle.position[0]
            );
        }
        // From 318 to 2500 rpm and back in steps of 0.1 %: about 2000 in one direction, at most one per
        // setpoint.
        assert!(commanded.len() > 300, "{}", commanded.len());
        let fastest = commanded.iter().map(|message| message.spindle_rpm[0]);
        assert!((fastest.fold(0.0, f64::max) / 2500.0 - 1.0).abs() < 0.002);
        // After the rapid the feed waits for the speed at its radius, about 1860 rpm slower.
        let at_speed: Vec<u64> = (inputs(&trace, SPINDLE).iter())
            .filter(|(_, text)| text == "spindle 0 at speed")
            .map(|(sequence, _)| *sequence)
            .collect();
        let begins = (cycles.iter()).find(|cycle| cycle.position[1] > 1.01);
        let begins = begins.expect("the last cut").sequence;
        let rests = (cycles.iter())
            .filter(|cycle| cycle.sequence < begins && (cycle.position[0] - 50.0).abs() < 1e-9)
            .map(|cycle| cycle.sequence)
            .min()
            .expect("the end of the rapid");
        assert!(
            at_speed.iter().any(|sequence| (rests..begins).contains(sequence)),
            "rests {rests}, feeds {begins}, at speed {at_speed:?}"
        );
        verifies(&trace);
    });
}

/// The feed per revolution with the last speed in the trace, at every setpoint of a motion along X.
fn feeds_per_turn(trace: &Path, cycles: &[Cycle], from_x: f64, to_x: f64) -> Vec<(f64, f64)> {
    let speeds: Vec<(u64, f64)> = (inputs(trace, SPEED).iter())
        .filter_map(|(sequence, text)| {
            let words: Vec<&str> = text.split(' ').collect();
            Some((*sequence, words.get(2)?.parse().ok()?))
        })
        .collect();
    (cycles.iter())
        .filter(|cycle| (from_x..to_x).contains(&cycle.position[0]))
        .filter_map(|cycle| {
            let newest = speeds
                .iter()
                .rev()
                .find(|(sequence, _)| *sequence <= cycle.sequence)?;
            Some((newest.1, 60.0 * cycle.velocity[0] / newest.1))
        })
        .collect()
}

#[test]
fn g95_follows_a_spindle_that_slows_down() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = machine(&workshop, "slowing");
        let program = workshop.write("program.ngc", "G21 G90 G95\nM3 S1200\nG1 X150 F0.5\nM5\nM2\n");
        let trace = workshop.path("run.mcap");
        let _drives = Drives::start(
            &machine,
            &domain,
            &[
                "--spindle-acceleration",
                "1500",
                "--spindle-ripple",
                "2",
                "--fault",
                "spindle-slow@6",
            ],
        );
        let launch = Launch::in_real_time(&program, &machine, &domain).trace(&trace);
        launch.finish().expect_code(&[0, 3]);
        let cycles = cycles(&trace);
        let feeds = feeds_per_turn(&trace, &cycles, 5.0, 145.0);
        let speeds = feeds.iter().map(|(rpm, _)| *rpm);
        let (slowest, fastest) = speeds.fold((f64::MAX, 0.0_f64), |(low, high), rpm| {
            (low.min(rpm), high.max(rpm))
        });
        assert!(
            (fastest / 1200.0 - 1.0).abs() < 0.02 && slowest < 0.9 * fastest,
            "{slowest} to {fastest}"
        );
        // While the spindle slows down the feed lags by its ramp; at both speeds it is exact.
        let right = feeds.iter().filter(|(_, feed)| (feed / 0.5 - 1.0).abs() < 0.02);
        assert!(right.count() as f64 > 0.9 * feeds.len() as f64);
        assert!(
            feeds.iter().all(|(_, feed)| *feed < 0.5 * 1.25),
            "a thicker chip than the ramp explains"
        );
        verifies(&trace);
    });
}

#[test]
fn the_spindle_override_acts_at_the_bridge_and_in_g95() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = machine(&workshop, "overridden");
        let program = workshop.write(
            "program.ngc",
            "G21 G90 G95\nM3 S1000\nG1 X100 F0.6\nM51 P0\nX200\nM51 P1\nX290\nM2\n",
        );
        let _drives = Drives::start(&machine, &domain, &["--spindle-acceleration", "3000"]);
        let served = Served::start(&machine, "overridden", &domain, &workshop.path("state"), &[]);
        let mut operator = Operator::join("overridden", &domain);
        let listener = OutputListener::of(&domain, "overridden");
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", &program.display().to_string());
        let job = operator.says("START").job;
        operator.waits("the cut", |status| status.position_machine[0] > 5.0);
        operator.does(&ControlRequest {
            amount: 0.5,
            ..command("SPINDLE_OVERRIDE")
        });
        let status = operator.waits("half the speed", |status| {
            (status.spindle_rpm - 500.0).abs() < 1.0
        });
        assert!((status.spindle_override_ratio - 0.5).abs() < 1e-9);
        operator.waits("half the feed", |status| (status.feed_mm_s - 5.0).abs() < 0.15);
        // Disabled by the program: both are at 100 %.
        let status = operator.waits("the second part", |status| status.position_machine[0] > 150.0);
        assert!(
            (status.spindle_rpm - 1000.0).abs() < 1.0,
            "{}",
            status.spindle_rpm
        );
        assert!((status.feed_mm_s - 10.0).abs() < 0.3, "{}", status.feed_mm_s);
        operator.waits("the third part", |status| {
            status.position_machine[0] > 210.0 && (status.feed_mm_s - 5.0).abs() < 0.15
        });
        // Not above the maximum speed of the spindle.
        operator.does(&ControlRequest {
            amount: 2.0,
            ..command("SPINDLE_OVERRIDE")
        });
        operator.waits("twice the feed", |status| (status.feed_mm_s - 20.0).abs() < 0.6);
        operator.sees_end(job);
        let mut changes: Vec<f64> = (listener.messages().iter())
            .filter(|message| message.spindle_direction[0] == 1)
            .map(|message| message.spindle_rpm[0])
            .collect();
        changes.dedup();
        assert_eq!(changes, [1000.0, 500.0, 1000.0, 500.0, 2000.0]);
        drop(operator);
        drop(listener);
        served.end().expect_code(&[0, 3]);
    });
}

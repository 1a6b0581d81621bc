//! A spindle whose command has a ramp: the commands to the bridge, what waits for the ramp, and what the feed
//! refers to.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::process::Child;
use std::time::{Duration, Instant};

use evolvent_bus::MachineOutputs;
use evolvent_tests::{
    Cycle, Domain, Drives, Launch, OutputListener, Workshop, cycles, run as evolvent_run, unless_disturbed,
    verifies, wait,
};
use rustix::process::{Pid, Signal, kill_process};

const RAMP_RPM_S: f64 = 1500.0;
/// States of setpoints.
const DONE: u8 = 9;
const STOPPED: u8 = 5;

fn machine(workshop: &Workshop, name: &str, ramp: &str) -> PathBuf {
    let file = workshop.mill(
        name,
        &[("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 1000 ")],
    );
    let text = std::fs::read_to_string(&file).expect("the machine file");
    let spindle = format!(
        "\n[signals]\ninput_timeout_ms = 500\n[[spindle]]\nmax_rpm = 4000\nat_speed_timeout_s = 20\n{ramp}"
    );
    workshop.write("machine.toml", text + &spindle)
}

/// Negative counter-clockwise.
fn signed_rpm(message: &MachineOutputs) -> f64 {
    match message.spindle_direction[0] {
        1 => message.spindle_rpm[0],
        2 => -message.spindle_rpm[0],
        _ => 0.0,
    }
}

fn run(workshop: &Workshop, name: &str, ramp: &str, program: &str) -> (Vec<MachineOutputs>, PathBuf) {
    let domain = Domain::new();
    let machine = machine(workshop, name, ramp);
    let program = workshop.write("program.ngc", program);
    let trace = workshop.path("run.mcap");
    let _drives = Drives::start(&machine, &domain, &[]);
    let listener = OutputListener::of(&domain, name);
    let launch = Launch::in_real_time(&program, &machine, &domain)
        .with(&["--wait-for-clients", "2"])
        .trace(&trace);
    launch.finish().expect_code(&[0, 3]);
    let mut messages = listener.messages();
    messages.dedup_by_key(|message| message.sequence);
    (messages, trace)
}

#[test]
fn spindle_commands_ramp_through_zero_and_delay_feed() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G90 G94 F1200\nM3 S600\nG0 X5\nG1 X10\nM4 S300\nG1 X15\nM5\nG4 P0.5\nM2\n";
        let (messages, trace) = run(
            &workshop,
            "ramped",
            &format!("ramp_rpm_s = {RAMP_RPM_S}\n"),
            program,
        );
        for pair in messages.windows(2) {
            let seconds = pair[1].due_time_ns.saturating_sub(pair[0].due_time_ns) as f64 * 1e-9;
            let change = (signed_rpm(&pair[1]) - signed_rpm(&pair[0])).abs();
            // The command changes in steps of at most one millisecond.
            assert!(
                change <= RAMP_RPM_S * (seconds + 0.001),
                "{change} rpm in {seconds} s"
            );
        }
        let all: Vec<f64> = messages.iter().map(signed_rpm).collect();
        let fastest = all.iter().copied().fold(0.0, f64::max);
        let slowest = all.iter().copied().fold(0.0, f64::min);
        assert_eq!(
            (fastest, slowest, all.last().copied()),
            (600.0, -300.0, Some(0.0))
        );
        let cycles = cycles(&trace);
        let rpm_at = |sequence: u64| {
            let before = messages.iter().filter(|message| message.cycle <= sequence);
            before.map(signed_rpm).next_back().expect("a message")
        };
        for (x, rpm) in [(5.0, 600.0), (10.0, -300.0)] {
            let begins = cycles.iter().find(|cycle| cycle.position[0] > x + 1e-9);
            assert_eq!(
                rpm_at(begins.expect("a feed").sequence),
                rpm,
                "feed from X{x} waits"
            );
        }
        verifies(&trace);
    });
}

#[test]
fn feed_per_revolution_goes_by_the_ramp() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        // From 318 to 3183 rpm within 45 mm: at 0.3 mm per revolution faster than 200 rpm/s permits.
        let program = "G21 G90 G95\nG0 X50\nG96 S100 D4000 M3\nG1 X5 F0.3\nM5\nG4 P0.1\nM2\n";
        let (messages, trace) = run(&workshop, "ramped-feed", "ramp_rpm_s = 200\n", program);
        let (mut compared, mut behind) = (0, 0);
        for cycle in cycles(&trace)
            .iter()
            .filter(|cycle| (6.0..49.0).contains(&cycle.position[0]) && cycle.velocity[0] < 0.0)
        {
            let Some(message) = messages.iter().rfind(|message| message.cycle <= cycle.sequence) else {
                continue;
            };
            let rpm = signed_rpm(message);
            let fed_mm_rev = -cycle.velocity[0] * 60.0 / rpm;
            // 1 % hysteresis, 0.5 % for the report, and the progress of the ramp meanwhile.
            assert!((fed_mm_rev / 0.3 - 1.0).abs() < 0.04, "{fed_mm_rev} at {rpm} rpm");
            compared += 1;
            let wanted = 1e5 / (std::f64::consts::TAU * cycle.position[0]);
            behind += i32::from(rpm < 0.9 * wanted);
        }
        assert!(compared > 500 && behind > 100, "{compared}, {behind}");
        verifies(&trace);
    });
}

#[test]
fn a_spindle_stopped_by_the_program_delays_no_rest() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        // After a feed per revolution, a dwell, a rapid and an output at rest do not wait for a stopped
        // spindle.
        let program = "G21 G90 G95\nS800 M3\nG1 X1 F0.1\nM5\nG4 P1\nG0 X50\nG4 P0.2\nG94 F600\nG1 X51\nM2\n";
        let (_messages, trace) = run(&workshop, "rests", "ramp_rpm_s = 2000\n", program);
        let cycles = cycles(&trace);
        let last = cycles.last().expect("cycles");
        assert_eq!((last.state, last.position[0]), (DONE, 51.0));
        verifies(&trace);
    });
}

#[test]
fn without_a_ramp_the_command_changes_at_once() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G90 G94 F1200\nM3 S600\nG1 X5\nM4 S300\nG1 X10\nM2\n";
        let (messages, _trace) = run(&workshop, "unramped", "", program);
        let mut all: Vec<f64> = messages.iter().map(signed_rpm).collect();
        all.dedup();
        assert_eq!(all, [0.0, 600.0, -300.0, 0.0]);
    });
}

fn period_s(cycles: &[Cycle]) -> f64 {
    (cycles[1].due_time_ns - cycles[0].due_time_ns) as f64 * 1e-9
}

/// Waits until the spindle turns at this speed.
fn await_rpm(listener: &OutputListener, rpm: f64) {
    let begin = Instant::now();
    while listener.messages().iter().map(signed_rpm).next_back() != Some(rpm) {
        assert!(
            begin.elapsed() < Duration::from_secs(60),
            "the spindle never turns at {rpm} rpm"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn signal(process: &Child, signal: Signal) {
    kill_process(Pid::from_child(process), signal).expect("a process that can be signalled");
}

/// The axes are at rest from the end of the program to the last setpoint, which comes when the ramp has
/// ended, at most `margin_s` later.
fn runs_down(messages: &[MachineOutputs], found: &[Cycle], rate_rpm_s: f64, from_rpm: f64, state: u8) {
    let begins = found
        .iter()
        .position(|cycle| cycle.state == state)
        .expect("an end");
    let position = found[begins].position;
    for cycle in &found[begins..] {
        assert_eq!(
            (cycle.state, cycle.position),
            (state, position),
            "{}",
            cycle.sequence
        );
        assert_eq!((cycle.velocity, cycle.acceleration), ([0.0; 9], [0.0; 9]));
    }
    let rests_s = (found.len() - begins) as f64 * period_s(found);
    let ramp_s = from_rpm / rate_rpm_s;
    assert!(
        rests_s > 0.95 * ramp_s && rests_s < ramp_s + 0.3,
        "{rests_s} s for a ramp of {ramp_s} s"
    );
    let last = messages.last().expect("messages");
    assert_eq!(signed_rpm(last), 0.0, "the ramp ends at 0");
    assert!(last.cycle <= found.last().expect("cycles").sequence);
    let mut before: Option<&MachineOutputs> = None;
    for message in messages
        .iter()
        .filter(|message| message.cycle >= found[begins].sequence)
    {
        if let Some(before) = before {
            let seconds = message.due_time_ns.saturating_sub(before.due_time_ns) as f64 * 1e-9;
            let change = signed_rpm(before).abs() - signed_rpm(message).abs();
            assert!(
                (0.0..=rate_rpm_s * (seconds + 0.001)).contains(&change),
                "{change}"
            );
        }
        before = Some(message);
    }
}

fn replays(trace: &Path) {
    let domain = Domain::new();
    let trace = trace.to_string_lossy();
    let prefix = &domain.prefix;
    evolvent_run(["trace", "replay", &trace, "--bus-prefix", prefix, "--speed", "20"]).expect_code(&[0]);
}

#[test]
fn a_run_ends_when_its_spindle_ramps_have_ended() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G90 G94 F1200\nM4 S600\nG1 X5\nM2\n";
        let (messages, trace) = run(&workshop, "rundown", "ramp_rpm_s = 600\n", program);
        runs_down(&messages, &cycles(&trace), 600.0, 600.0, DONE);
        verifies(&trace);
        replays(&trace);
    });
}

/// The status during the ramp shows the command on the ramp, not the target of the program.
#[test]
fn the_status_shows_the_command_on_its_ramp() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = machine(&workshop, "shown-ramp", "ramp_rpm_s = 200\n");
        let program = workshop.write("program.ngc", "G21 G90\nM4 S400\nG4 P3\nM2\n");
        let _drives = Drives::start(&machine, &domain, &[]);
        let listener = OutputListener::of(&domain, "shown-ramp");
        let running = Launch::in_real_time(&program, &machine, &domain)
            .with(&["--wait-for-clients", "2"])
            .no_trace()
            .start();
        let mut status = domain.client("shown-ramp").status().expect("a subscription");
        let (begin, mut shown) = (Instant::now(), Vec::new());
        while begin.elapsed() < Duration::from_secs(60) && shown.last() != Some(&-400.0) {
            if let Ok(Some(status)) = status.latest() {
                let spindle = status.spindles().next().expect("a spindle");
                assert_eq!((spindle.number, spindle.measured_rpm), (0, None));
                assert!((status.spindle_rpm - spindle.command_rpm).abs() < 0.01);
                shown.push(spindle.command_rpm);
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        wait(running).expect_code(&[0, 3]);
        let on_ramp = shown.iter().filter(|rpm| (-390.0..-10.0).contains(*rpm)).count();
        assert!(on_ramp > 5 && shown.last() == Some(&-400.0), "{shown:?}");
        assert_eq!(listener.messages().last().map(signed_rpm), Some(0.0));
    });
}

#[test]
fn a_signal_ends_a_run_after_its_ramp() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let domain = Domain::new();
        let machine = machine(&workshop, "stopped-ramp", "ramp_rpm_s = 400\n");
        let program = workshop.write("program.ngc", "G21 G90 G94 F300\nM3 S600\nG1 X100\nM2\n");
        let _drives = Drives::start(&machine, &domain, &[]);
        for is_repeated in [false, true] {
            let trace = workshop.path(if is_repeated { "twice.mcap" } else { "once.mcap" });
            let listener = OutputListener::of(&domain, "stopped-ramp");
            let running = Launch::in_real_time(&program, &machine, &domain)
                .with(&["--wait-for-clients", "2"])
                .trace(&trace)
                .start();
            await_rpm(&listener, 600.0);
            signal(&running, Signal::INT);
            if is_repeated {
                std::thread::sleep(Duration::from_millis(700));
                signal(&running, Signal::INT);
                let signalled = Instant::now();
                let finished = wait(running);
                assert_ne!(finished.code, Some(0));
                assert!(
                    signalled.elapsed() < Duration::from_millis(600),
                    "{:?}",
                    signalled.elapsed()
                );
                let last = listener.messages().last().map(signed_rpm);
                assert!(
                    last.is_some_and(|rpm| rpm > 100.0),
                    "{last:?}: the ramp was not over"
                );
                continue;
            }
            let finished = wait(running).expect_code(&[1]);
            assert_eq!(finished.json()["outcome"], "stopped");
            let mut messages = listener.messages();
            messages.dedup_by_key(|message| message.sequence);
            runs_down(&messages, &cycles(&trace), 400.0, 600.0, STOPPED);
            verifies(&trace);
        }
    });
}

/// Nothing waits for a spindle without a ramp, or for a speed that is reached at once.
#[test]
fn a_run_without_a_ramp_ends_with_its_program() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G90 G94 F1200\nM3 S600\nG1 X5\nM2\n";
        let (_, trace) = run(&workshop, "no-rundown", "", program);
        let ends = |trace: &Path| {
            let found = cycles(trace);
            found.iter().filter(|cycle| cycle.state == DONE).count()
        };
        assert_eq!(ends(&trace), 1);
        let machine = machine(&workshop, "virtual-ramp", "ramp_rpm_s = 100\n");
        let (file, trace) = (workshop.path("program.ngc"), workshop.path("virtual.mcap"));
        Launch::in_virtual_time(&file, &machine)
            .trace(&trace)
            .finish()
            .expect_code(&[0]);
        assert_eq!(ends(&trace), 1);
    });
}

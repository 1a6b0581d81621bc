//! A spindle whose command has a ramp: what the bridge is commanded, what waits for it, and what the feed goes by.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::PathBuf;

use evolvent_bus::MachineOutputs;
use evolvent_tests::{Domain, Drives, Launch, OutputListener, Workshop, cycles, unless_disturbed, verifies};

const RAMP_RPM_S: f64 = 1500.0;

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
        .with(&["--wait-for-clients", "1"])
        .trace(&trace);
    launch.finish().expect_code(&[0, 3]);
    let mut messages = listener.messages();
    messages.dedup_by_key(|message| message.sequence);
    (messages, trace)
}

#[test]
fn the_command_changes_by_its_rate_through_zero_and_feed_waits_for_its_end() {
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
            // Steps come every millisecond at most.
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
            // 1 % of hysteresis, 0.5 % of the report, and what the ramp goes on meanwhile.
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

//! Two spindles with ramps on a served machine: MDI commands them, STOP ramps them down, and ESTOP takes their power at once.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::PathBuf;
use std::time::{Duration, Instant};

use evolvent_bus::MachineOutputs;
use evolvent_tests::{Domain, Drives, Operator, OutputListener, Served, Workshop, unless_disturbed};

const DONE: u32 = 1;
/// A busy host may take its time.
const PATIENCE: Duration = Duration::from_secs(60);
const OFF: [f64; 2] = [0.0, 0.0];
const RAMPS_RPM_S: [f64; 2] = [600.0, 1500.0];

fn machine(workshop: &Workshop, name: &str) -> PathBuf {
    let file = workshop.mill(
        name,
        &[("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 1000 ")],
    );
    let text = std::fs::read_to_string(&file).expect("the machine file");
    let [first, second] = RAMPS_RPM_S;
    let spindles = format!(
        "\n[signals]\ninput_timeout_ms = 500\n\
         [[spindle]]\nmax_rpm = 4000\nat_speed_timeout_s = 20\nramp_rpm_s = {first}\n\
         [[spindle]]\nnumber = 1\nmax_rpm = 3000\nat_speed_timeout_s = 20\nramp_rpm_s = {second}\n"
    );
    workshop.write("machine.toml", text + &spindles)
}

/// Both speeds of a message, negative counter-clockwise.
fn speeds(message: &MachineOutputs) -> [f64; 2] {
    [0, 1].map(|number| match message.spindle_direction[number] {
        1 => message.spindle_rpm[number],
        2 => -message.spindle_rpm[number],
        _ => 0.0,
    })
}

/// Waits until both are commanded these speeds.
fn reach(listener: &OutputListener, wanted: [f64; 2]) {
    let begin = Instant::now();
    loop {
        let last = listener.messages().last().map(speeds);
        if last == Some(wanted) {
            return;
        }
        assert!(begin.elapsed() < PATIENCE, "{wanted:?} rpm do not come: {last:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// No message changes a speed by more than its ramp permits.
fn assert_ramped(messages: &[MachineOutputs]) {
    for pair in messages.windows(2) {
        let seconds = pair[1].due_time_ns.saturating_sub(pair[0].due_time_ns) as f64 * 1e-9;
        let (before, after) = (speeds(&pair[0]), speeds(&pair[1]));
        for number in 0..2 {
            let change = (after[number] - before[number]).abs();
            // Steps come every millisecond at most.
            assert!(
                change <= RAMPS_RPM_S[number] * (seconds + 0.001) + 1e-9,
                "spindle {number}: {change} rpm in {seconds} s"
            );
        }
    }
}

/// Some message has a speed of each spindle between these and zero: it was not switched off at once.
fn passes_between(messages: &[MachineOutputs], from: [f64; 2]) -> [bool; 2] {
    [0, 1].map(|number| {
        messages
            .iter()
            .map(|message| speeds(message)[number].abs())
            .any(|rpm| rpm > 0.0 && rpm < 0.9 * from[number].abs())
    })
}

#[test]
fn mdi_and_stop_ramp_both_spindles_and_estop_switches_them_off_at_once() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = machine(&workshop, "ramped-pair");
        let _drives = Drives::start(&machine, &domain, &[]);
        let served = Served::start(&machine, "ramped-pair", &domain, &workshop.path("state"), &[]);
        let mut operator = Operator::join("ramped-pair", &domain);
        let listener = OutputListener::of(&domain, "ramped-pair");
        operator.brings_up();
        operator.says_number("MODE", 2);
        for block in ["G21 G90 G94 F1200 M3 S600", "M4 S900 $1", "G1 X5"] {
            let job = operator.says_text("MDI", block).job;
            assert_eq!(operator.sees_end(job).job_result, DONE, "{block}");
        }
        reach(&listener, [600.0, -900.0]);
        assert_ramped(&listener.messages());

        // STOP ends a program, and both spindles along their ramps.
        operator.says_text("MDI", "G1 X200 F60");
        operator.waits("motion", |status| status.position_machine[0] > 5.2);
        operator.says("STOP");
        let from = listener.messages().len();
        reach(&listener, OFF);
        let stopping = listener.messages().split_off(from.saturating_sub(1));
        assert_ramped(&stopping);
        assert_eq!(passes_between(&stopping, [600.0, 900.0]), [true, true], "STOP");

        for block in ["M3 S500 $0", "M3 S1000 $1"] {
            let job = operator.says_text("MDI", block).job;
            assert_eq!(operator.sees_end(job).job_result, DONE, "{block}");
        }
        reach(&listener, [500.0, 1000.0]);
        let from = listener.messages().len();
        operator.says("ESTOP");
        reach(&listener, OFF);
        let after = listener.messages().split_off(from);
        assert_eq!(passes_between(&after, [500.0, 1000.0]), [false, false], "ESTOP");

        // They stay off, also with power again.
        operator.brings_up();
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(listener.messages().last().map(speeds), Some(OFF));
        served.end().expect_code(&[0, 1, 3]);
    });
}

//! Two spindles with ramps on a served machine: MDI commands them, STOP ramps them down, and ESTOP removes
//! their power at once.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::PathBuf;
use std::time::{Duration, Instant};

use evolvent_bus::MachineOutputs;
use evolvent_tests::job_result::DONE;
use evolvent_tests::{Domain, Drives, Operator, OutputListener, Served, Workshop, unless_disturbed};

const AUTO: u32 = 0;
const MDI: u32 = 2;
/// A busy host may be slow.
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

/// Asserts that no message changes a speed by more than its ramp permits.
fn assert_ramped(messages: &[MachineOutputs]) {
    for pair in messages.windows(2) {
        let seconds = pair[1].due_time_ns.saturating_sub(pair[0].due_time_ns) as f64 * 1e-9;
        let (before, after) = (speeds(&pair[0]), speeds(&pair[1]));
        for number in 0..2 {
            let change = (after[number] - before[number]).abs();
            // The command changes in steps of at most one millisecond.
            assert!(
                change <= RAMPS_RPM_S[number] * (seconds + 0.001) + 1e-9,
                "spindle {number}: {change} rpm in {seconds} s"
            );
        }
    }
}

/// Whether some message has a speed of each spindle between these and zero: it was not switched off at once.
fn passes_between(messages: &[MachineOutputs], from: [f64; 2]) -> [bool; 2] {
    [0, 1].map(|number| {
        messages
            .iter()
            .map(|message| speeds(message)[number].abs())
            .any(|rpm| rpm > 0.0 && rpm < 0.9 * from[number].abs())
    })
}

#[test]
fn mdi_and_stop_ramp_spindles_and_estop_cuts_them() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = machine(&workshop, "ramped-pair");
        let _drives = Drives::start(&machine, &domain, &[]);
        let served = Served::start(&machine, "ramped-pair", &domain, &workshop.path("state"), &[]);
        let mut operator = Operator::join("ramped-pair", &domain);
        let listener = OutputListener::of(&domain, "ramped-pair");
        operator.brings_up();
        operator.says_number("MODE", MDI);
        for block in ["G21 G90 G94 F1200 M3 S600", "M4 S900 $1", "G1 X5"] {
            let job = operator.says_text("MDI", block).job;
            assert_eq!(operator.sees_end(job).job_result, DONE, "{block}");
        }
        reach(&listener, [600.0, -900.0]);
        assert_ramped(&listener.messages());

        // STOP ends a program, and stops both spindles along their ramps.
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

        // They stay off after power is on again.
        operator.brings_up();
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(listener.messages().last().map(speeds), Some(OFF));
        served.end().expect_code(&[0, 1, 3]);
    });
}

#[test]
fn surface_speed_ends_with_program_stop_or_reset() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = machine(&workshop, "surface-speed");
        let _drives = Drives::start(&machine, &domain, &[]);
        let served = Served::start(&machine, "surface-speed", &domain, &workshop.path("state"), &[]);
        let mut operator = Operator::join("surface-speed", &domain);
        let listener = OutputListener::of(&domain, "surface-speed");
        operator.brings_up();
        let surface = "G21 G90 G94 F6000\nG96 S40 D900 M3\nG1 X60\n";
        let ends = [
            // A spindle that is off at the end of the program needs no switching off.
            ("M5 before M2", format!("{surface}M5\nM2\n"), ""),
            ("M2", format!("{surface}M2\n"), ""),
            ("STOP", format!("{surface}G1 X200 F60\nM2\n"), "STOP"),
            ("RESET", String::new(), "RESET"),
        ];
        for (what, text, command) in ends {
            if text.is_empty() {
                operator.says_number("MODE", MDI);
                let job = operator.says_text("MDI", "G96 S40 D900").job;
                assert_eq!(operator.sees_end(job).job_result, DONE, "{what}");
                operator.says(command);
            } else {
                operator.says_number("MODE", AUTO);
                let program = workshop.write("surface.ngc", &text);
                operator.says_text("LOAD", &program.display().to_string());
                let job = operator.says("START").job;
                if !command.is_empty() {
                    operator.waits("the slow move", |status| status.position_machine[0] > 60.2);
                    operator.says(command);
                }
                operator.sees_end(job);
            }
            reach(&listener, OFF);
            operator.says_number("MODE", MDI);
            let job = operator.says_text("MDI", "S300 M3").job;
            assert_eq!(operator.sees_end(job).job_result, DONE, "{what}");
            reach(&listener, [300.0, 0.0]);
            let job = operator.says_text("MDI", "G90 G94 G0 X0 M5").job;
            assert_eq!(operator.sees_end(job).job_result, DONE, "{what}");
            reach(&listener, OFF);
        }
        served.end().expect_code(&[0, 1, 3]);
    });
}

/// The planner receives such a move in pieces of 1 % of speed. For the operator it is one move; formerly
/// RETRACE returned to the start of a piece.
#[test]
fn a_move_at_surface_speed_feed_is_retraced_whole() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = machine(&workshop, "surface-feed");
        let _drives = Drives::start(&machine, &domain, &[]);
        let served = Served::start(&machine, "surface-feed", &domain, &workshop.path("state"), &[]);
        let mut operator = Operator::join("surface-feed", &domain);
        operator.brings_up();
        operator.says_number("MODE", AUTO);
        let text = "G21 G18 G90 G54 G64\nG0 X20\nG95 G96 S60 D1500 M3\nG1 X30 F0.5\nG1 X120 F0.5\nM2\n";
        let program = workshop.write("facing.ngc", text);
        operator.says_text("LOAD", &program.display().to_string());
        let job = operator.says("START").job;
        let middle = operator.waits("the middle of line 5", |status| status.position_machine[0] > 60.0);
        let to_go = 120.0 - middle.position_machine[0];
        assert!((middle.distance_to_go[0] - to_go).abs() < 1e-9, "{middle:?}");
        operator.says("HOLD");
        let rests = |status: &evolvent_bus::Status| status.velocity.iter().all(|v| *v == 0.0);
        let held = operator.waits("a hold", |status| rests(status) && status.retrace_blocks > 0);
        assert_eq!(held.retrace_blocks, 3);
        operator.says("RETRACE");
        let back = operator.waits("the start of line 5", |status| {
            rests(status) && status.retrace_blocks == 2
        });
        // In the blend of the corner, which is straight here.
        assert!(
            (back.position_machine[0] - 30.0).abs() < 0.2,
            "{}",
            back.position_machine[0]
        );
        operator.says("STOP");
        operator.sees_end(job);
        served.end().expect_code(&[0, 1, 3]);
    });
}

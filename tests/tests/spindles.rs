//! Spindles with feedback: feed waits for the speed, M19 waits for the angle, and a failure stops the
//! machine.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::time::Duration;

use evolvent_tests::job_result::{DONE, FAULT};
use evolvent_tests::{
    Cycle, Domain, Drives, Finished, Launch, Operator, Served, Workshop, cycles, unless_disturbed, verifies,
};
use evolvent_trace::{EventKind, TraceFile};

/// The number of the state of spindle 0 in a trace, after 64 digital and 16 analog inputs.
const SPINDLE: u32 = 80;
const SPINDLE_ALARM: u32 = 440;

/// A mill with a measured spindle. A bridge on a busy host may be silent for a while.
fn machine(workshop: &Workshop, name: &str, timeout_s: f64) -> PathBuf {
    let file = workshop.mill(
        name,
        &[("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 1000 ")],
    );
    let text = std::fs::read_to_string(&file).expect("the machine file");
    let spindle = format!(
        "\n[signals]\ninput_timeout_ms = 500\n[[spindle]]\nmax_rpm = 8000\nfeedback = true\n\
         at_speed_timeout_s = {timeout_s}\n"
    );
    workshop.write("machine.toml", text + &spindle)
}

/// Runs a program with a simulated spindle; returns the result and the trace.
fn drive(workshop: &Workshop, program: &str, timeout_s: f64, options: &[&str]) -> (Finished, PathBuf) {
    let domain = Domain::new();
    let machine = machine(workshop, "spun", timeout_s);
    let program = workshop.write("program.ngc", program);
    let trace = workshop.path("run.mcap");
    let _drives = Drives::start(&machine, &domain, options);
    let finished = Launch::in_real_time(&program, &machine, &domain)
        .trace(&trace)
        .finish();
    (finished, trace)
}

/// Every change of the spindle in a trace: the setpoint and the text.
fn spindle(trace: &Path) -> Vec<(u64, String)> {
    let mut file = TraceFile::open(trace).expect("a trace");
    let events = file.events().map(|event| event.expect("a readable event"));
    events
        .filter(|event| event.kind == EventKind::Input && event.code == SPINDLE)
        .map(|event| (event.sequence, event.text))
        .collect()
}

fn first(cycles: &[Cycle], when: impl Fn(&Cycle) -> bool) -> u64 {
    let found = cycles.iter().find(|cycle| when(cycle));
    found.expect("such a cycle").sequence
}

#[test]
fn feed_waits_for_each_speed_and_rapids_do_not() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program =
            "G21 G90 G94 F1200\nM3 S1000\nG0 X5\nG1 X10\nX15\nS2000\nG1 X20\nG0 X0\nM5\nG0 X1\nM2\n";
        let (finished, trace) = drive(&workshop, program, 20.0, &["--spindle-acceleration", "1500"]);
        finished.expect_code(&[0, 3]);
        let cycles = cycles(&trace);
        let commands = spindle(&trace);
        // At speed twice, each time before the feed that needs it, and after the rapid.
        let at_speed: Vec<u64> = (commands.iter())
            .filter(|(_, text)| text == "spindle 0 at speed")
            .map(|(sequence, _)| *sequence)
            .collect();
        let begins = |x: f64| first(&cycles, |cycle| cycle.position[0] > x);
        let reaches = |x: f64| first(&cycles, |cycle| cycle.position[0] > x - 1e-9);
        let [rapid, feed, faster] = [begins(0.0), begins(5.0), begins(15.0)];
        assert!(rapid < feed, "{commands:?}");
        let before = |limit: u64| at_speed.iter().filter(|sequence| **sequence < limit).max();
        assert!(
            before(feed).is_some_and(|sequence| *sequence > reaches(5.0)),
            "{commands:?}"
        );
        assert!(
            before(faster).is_some_and(|sequence| *sequence > reaches(15.0)),
            "{commands:?}"
        );
        // 1000 rpm at 1500 rpm/s minus 2 %, then the same once more: the minimum time for which the machine
        // waits.
        let due_s = |sequence: u64| cycles[sequence as usize].due_time_ns as f64 * 1e-9;
        let waits_s = |at: f64, until: u64| due_s(until) - due_s(reaches(at));
        let ramp_s = 0.98 * 1000.0 / 1500.0;
        assert!(waits_s(15.0, faster) >= 0.9 * ramp_s, "{}", waits_s(15.0, faster));
        verifies(&trace);
    });
}

#[test]
fn a_slow_spindle_ends_the_program_before_the_feed() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G90 G94 F1200\nM4 S1000\nG0 X5\nG1 X10\nM2\n";
        let (finished, trace) = drive(&workshop, program, 1.5, &["--fault", "spindle-slow@0"]);
        let printed = finished.out.clone() + &finished.err;
        finished.expect_code(&[1]);
        assert!(printed.contains("program.ngc:4"), "{printed}");
        assert!(
            printed.contains("did not reach -1000 rpm within 1.5 s"),
            "{printed}"
        );
        assert!(cycles(&trace).iter().all(|cycle| cycle.position[0] < 5.0 + 1e-9));
        verifies(&trace);
    });
}

#[test]
fn a_failed_stalled_or_silent_spindle_stops_the_run() {
    for fault in ["spindle-fault", "spindle-stall", "spindle-silent"] {
        unless_disturbed(|| {
            let workshop = Workshop::new();
            let program = "G21 G90 G94 F600\nM3 S1000\nG1 X200\nM2\n";
            let fault = format!("{fault}@3");
            let (finished, trace) = drive(&workshop, program, 20.0, &["--fault", &fault]);
            let summary = finished.expect_code(&[1]).json();
            assert_eq!(summary["alarm"], SPINDLE_ALARM, "{summary}");
            let cycles = cycles(&trace);
            let last = cycles.last().expect("cycles");
            assert!(
                last.position[0] > 0.0 && last.position[0] < 100.0,
                "{fault}: {last:?}"
            );
            assert!(last.velocity[0].abs() < 1e-9 && last.position[1].abs() < 1e-9);
            verifies(&trace);
        });
    }
}

/// The longer time is for the first report only: M3 comes at 2 s, the last report at 3 s, the alarm 0.5 s later.
#[test]
fn a_spindle_that_has_been_reported_is_silent_at_once() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let program = "G21 G90 G94 F600\nG4 P2\nM3 S100\nG4 P9\nM2\n";
        let (finished, trace) = drive(&workshop, program, 20.0, &["--fault", "spindle-silent@3"]);
        let summary = finished.expect_code(&[1]).json();
        assert_eq!(summary["alarm"], SPINDLE_ALARM, "{summary}");
        let took_s = summary["duration_s"].as_f64().expect("a duration");
        assert!((2.5..4.5).contains(&took_s), "{took_s} s, {summary}");
        verifies(&trace);
    });
}

/// The bridge begins when the `input_timeout_ms` of the machine has passed.
#[test]
fn a_bridge_that_begins_after_m3_is_waited_for() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = machine(&workshop, "late", 20.0);
        let program = workshop.write("program.ngc", "G21 G90 G94 F1200\nM3 S1000\nG1 X5\nM5\nM2\n");
        let launch = Launch::in_real_time(&program, &machine, &domain).no_trace();
        let run = launch.start();
        let mut status = domain.client("late").status().expect("the status");
        while status
            .latest()
            .expect("a status")
            .is_none_or(|status| status.cycles == 0)
        {
            std::thread::sleep(Duration::from_millis(5));
        }
        std::thread::sleep(Duration::from_millis(700));
        let _drives = Drives::start(&machine, &domain, &[]);
        let finished = Finished::from(run.wait_with_output().expect("the run to end"));
        finished.expect_code(&[0, 3]);
    });
}

/// Neither coolant nor a short `at_speed_timeout_s` puts off or replaces the alarm.
#[test]
fn a_spindle_that_no_bridge_reports_stops_the_run() {
    for (timeout_s, permitted_s) in [(20.0, 3.0), (1.5, 0.75)] {
        unless_disturbed(|| {
            let (workshop, domain) = (Workshop::new(), Domain::new());
            let machine = machine(&workshop, "alone", timeout_s);
            let program = "G21 G90 G94 F1200\nM3 S1000\nM8\nG4 P0.5\nM9\nG4 P2\nM8\nG4 P0.8\nG1 X5\nM5\nM2\n";
            let program = workshop.write("program.ngc", program);
            let run = Launch::in_real_time(&program, &machine, &domain)
                .no_trace()
                .finish();
            let summary = run.expect_code(&[1]).json();
            assert_eq!(summary["alarm"], SPINDLE_ALARM, "{summary}");
            assert_eq!(summary["end_position"][0], 0.0, "{summary}");
            let took_s = summary["duration_s"].as_f64().expect("a duration");
            assert!((took_s - permitted_s).abs() < 0.2, "{took_s} s, {summary}");
        });
    }
}

#[test]
fn an_angle_is_waited_for_before_the_program_goes_on() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        // It has seen its index pulse before it is commanded to stop.
        let program = "G21 G90 G94 F1200\nM3 S600\nG1 X5\nM19 R90 P1\nG0 X10\nM5\nM2\n";
        let (finished, trace) = drive(&workshop, program, 20.0, &[]);
        finished.expect_code(&[0, 3]);
        let commands = spindle(&trace);
        let oriented = commands.iter().find(|(_, text)| text == "spindle 0 oriented");
        let oriented = oriented.expect("an angle").0;
        let cycles = cycles(&trace);
        assert!(
            oriented < first(&cycles, |cycle| cycle.position[0] > 5.0 + 1e-9),
            "{commands:?}"
        );
        verifies(&trace);
        let program = "G21 G90\nM3 S600\nG4 P3\nM19 R90 Q1.5\nG0 X10\nM2\n";
        let (finished, _) = drive(&workshop, program, 20.0, &["--spindle-acceleration", "100"]);
        let printed = finished.out.clone() + &finished.err;
        finished.expect_code(&[1]);
        assert!(
            printed.contains("program.ngc:4") && printed.contains("90 degrees after 1.5 s"),
            "{printed}"
        );
    });
}

#[test]
fn m19_without_a_measured_spindle_is_rejected() {
    let workshop = Workshop::new();
    let machine = workshop.mill("plain", &[]);
    let program = workshop.write("program.ngc", "G21 G90 G94 F1200\nM3 S600\nG1 X5\nM19 R90\nM2\n");
    let finished = Launch::in_virtual_time(&program, &machine).finish();
    let printed = finished.out.clone() + &finished.err;
    finished.expect_code(&[1]);
    assert!(
        printed.contains("program.ngc:4") && printed.contains("feedback = true"),
        "{printed}"
    );
    // With the virtual clock spindles execute commands at once.
    let measured = self::machine(&workshop, "spun", 20.0);
    let program = workshop.write(
        "program.ngc",
        "G21 G90 G94 F1200\nM3 S600\nG1 X5\nM19 R90\nG1 X6\nM2\n",
    );
    Launch::in_virtual_time(&program, &measured)
        .finish()
        .expect_code(&[0]);
}

#[test]
fn a_served_machine_waits_for_the_spindle_speed() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = machine(&workshop, "spun", 20.0);
        let options = ["--spindle-acceleration", "1000", "--fault", "spindle-silent@20"];
        let _drives = Drives::start(&machine, &domain, &options);
        let served = Served::start(&machine, "spun", &domain, &workshop.path("state"), &[]);
        let mut operator = Operator::join("spun", &domain);
        operator.brings_up();
        // A program that waits for the speed is not held.
        operator.says_number("MODE", 0);
        let program = workshop.write("turn.ngc", "G21 G90 G94 F1200 M3 S1000\nG1 X1\nM2\n");
        operator.says_text("LOAD", &program.display().to_string());
        let job = operator.says("START").job;
        let end = operator.sees_end(job);
        assert_eq!((end.job_result, end.program_held_s), (DONE, 0.0));
        assert!(end.program_time_s > 0.9, "no wait: {}", end.program_time_s);
        operator.says_number("MODE", 2);
        for block in ["G21 G90 G94 F1200 M3 S1000", "G1 X5"] {
            let job = operator.says_text("MDI", block).job;
            let end = operator.sees_end(job);
            assert_eq!((end.job_result, end.spindle_rpm), (DONE, 1000.0), "{block}");
        }
        operator.says_text("MDI", "G1 X200 F60");
        operator.waits("motion", |status| status.position_machine[0] > 5.5);
        let status = operator.waits("an alarm", |status| status.alarm_count > 0);
        assert_eq!(status.alarms[0], SPINDLE_ALARM, "{:?}", status.alarms);
        let status = operator.waits("rest", |status| status.activity == 0);
        assert_eq!(status.job_result, FAULT);
        assert!(
            status.position_machine[0] < 100.0 && status.spindle_rpm == 0.0,
            "{status:?}"
        );
        served.end().expect_code(&[0, 1, 3]);
    });
}

//! The status of a run: positions of the drives, if there are any, and the state of the program.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::time::{Duration, Instant};

use evolvent_bus::Status;
use evolvent_tests::{Domain, Drives, Launch, Workshop, evolvent, unless_disturbed, wait};

/// One line in G55, whose motion begins after 3 s, when drives follow.
const PROGRAM: &str = "G21 G90 G94\nG10 L2 P2 X10 Y-5 Z1\nG55\n(MSG, second system)\nG4 P3\n\
                       G1 X60 Y-20 Z-5 F1800\nM2\n";

/// Runs the program and returns the statuses in motion.
fn statuses(name: &str, has_drives: bool) -> Vec<Status> {
    let (domain, workshop) = (Domain::new(), Workshop::new());
    let machine = workshop.mill(
        name,
        &[("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 800 ")],
    );
    let _drives = has_drives.then(|| Drives::start(&machine, &domain, &[]));
    let program = workshop.write("part.ngc", PROGRAM);
    let child = Launch::in_real_time(&program, &machine, &domain)
        .no_trace()
        .start();
    let bus = domain.client(name);
    let mut reader = bus.status().expect("the status");
    let (begin, mut moving) = (Instant::now(), Vec::new());
    while begin.elapsed() < Duration::from_secs(6) {
        let status = reader.latest().expect("the status");
        moving.extend(status.filter(|status| status.velocity != [0.0; 9]));
        std::thread::sleep(Duration::from_millis(5));
    }
    let _finished = wait(child);
    moving
}

#[test]
fn a_run_shows_the_positions_of_its_drives() {
    unless_disturbed(|| {
        let moving = statuses("run-drives", true);
        let with: Vec<&Status> = moving.iter().filter(|status| status.has_feedback()).collect();
        let last = with.last().expect("feedback");
        assert!(last.feedback_age_ns < 800_000_000, "{last:?}");
        assert_eq!(last.enabled_mask, 7, "{last:?}");
        assert!(last.position_actual[0] > 40.0, "{last:?}");
        for status in &with {
            for axis in 0..3 {
                // The drives follow with a delay: at 30 mm/s less than 3 mm in a tenth of a second.
                let off = status.position_actual[axis] - status.position_machine[axis];
                assert!(off.abs() < 3.0, "axis {axis} is off by {off} mm");
            }
        }
    });
}

#[test]
fn a_run_without_drives_shows_no_feedback() {
    unless_disturbed(|| {
        let moving = statuses("run-alone", false);
        assert!(!moving.is_empty() && moving.iter().all(|status| !status.has_feedback()));
    });
}

#[test]
fn a_run_shows_the_state_of_its_program() {
    unless_disturbed(|| {
        let seen = statuses("run-program", false);
        assert!(!seen.is_empty());
        let (zero, end) = ([10.0, -5.0, 1.0], [70.0, -25.0, -4.0]);
        for status in &seen {
            for axis in 0..3 {
                let work = status.position_work[axis] + zero[axis] - status.position_machine[axis];
                let rest = status.distance_to_go[axis] + status.position_machine[axis] - end[axis];
                assert!(work.abs() < 1e-9 && rest.abs() < 1e-9, "axis {axis}: {status:?}");
            }
            assert_eq!((status.work_system, status.feed_programmed_mm_s), (550, 30.0));
            assert_eq!(status.work_offset[..3], zero);
            assert!(status.modal.contains(&550) && status.modal.contains(&210));
            assert_eq!(status.operator_message(), "second system");
        }
        let to_go = |status: &Status| status.path_to_go_mm;
        let (first, last) = (seen.first().map_or(0.0, to_go), seen.last().map_or(0.0, to_go));
        assert!(
            last < 5.0 && last < first && first < 75.0,
            "{first} mm to go, then {last} mm"
        );
    });
}

/// Late setpoints count for the exit code only where somebody else reads them.
#[test]
fn the_own_screen_of_a_run_is_no_listener() {
    unless_disturbed(|| {
        let (domain, workshop) = (Domain::new(), Workshop::new());
        let machine = workshop.mill("run-screen", &[]);
        let program = workshop.write("dwell.ngc", "G4 P2\nM2\n");
        let output = evolvent()
            .args([
                "run",
                "--no-trace",
                "--json",
                "--screen=127.0.0.1:0",
                "--wait-for-clients",
                "1",
            ])
            .args(["--bus-prefix", &domain.prefix, "--machine"])
            .args([&machine, &program])
            .output()
            .expect("the binary to start");
        let (json, log) = (&output.stdout, String::from_utf8_lossy(&output.stderr));
        let summary: serde_json::Value = serde_json::from_slice(json).expect("JSON");
        assert_eq!(summary["listeners"], 0, "{summary}");
        assert!(log.contains("0 of 1 subscribers connected"), "{log}");
        assert_eq!(output.status.code(), Some(0), "{log}");
    });
}

#[test]
fn every_message_of_a_run_is_in_a_status() {
    unless_disturbed(|| {
        let (domain, workshop) = (Domain::new(), Workshop::new());
        let machine = workshop.mill("run-messages", &[]);
        let moves: String = (1..=20)
            .map(|i| format!("(MSG, move {i})\nG1 X{}\n", 0.1 * f64::from(i)))
            .collect();
        // The bus is joined during the first dwell.
        let text = format!(
            "G21 G90 G64 P0.01 F20000\nG4 P2\n(MSG, one)\nG4 P0.005\n(MSG, two)\nG4 P0.005\n(MSG, three)\n(MSG, four)\n\
             G4 P0.1\n{moves}G4 P0.3\nM2\n"
        );
        let program = workshop.write("part.ngc", &text);
        let child = Launch::in_real_time(&program, &machine, &domain)
            .no_trace()
            .start();
        let bus = domain.client("run-messages");
        let mut reader = bus.every_status().expect("the status");
        let (begin, mut seen) = (Instant::now(), Vec::<String>::new());
        while begin.elapsed() < Duration::from_secs(5) {
            while let Ok(Some(status)) = reader.receive() {
                let message = status.operator_message();
                if !message.is_empty() && seen.last().is_none_or(|last| last != message) {
                    seen.push(message.to_owned());
                }
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let _finished = wait(child);
        // The first move begins where the dwells are, so its message is one of theirs.
        let stops = [
            "one",
            "one; two",
            "one; two; three",
            "one; two; three; four",
            "one; two; three; four; move 1",
        ];
        let moves = (2..=20).map(|i| format!("move {i}"));
        let expected: Vec<String> = stops.map(str::to_owned).into_iter().chain(moves).collect();
        assert_eq!(seen, expected);
    });
}

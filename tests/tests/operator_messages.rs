//! Messages of the status to the operator: their contents and duration.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::time::{Duration, Instant};

use evolvent_bus::{ControlRequest, EveryStatusReader, Status};
use evolvent_tests::{Operator, Scene, command, unless_disturbed};

const DWELLS: u32 = 6;
const STOPPED: u32 = 7;

fn starts(scene: &Scene, program: &str) -> (Operator, u64) {
    let program = scene.workshop.write("program.ngc", program);
    let mut operator = scene.operator();
    operator.brings_up();
    operator.says_number("MODE", 0);
    operator.says_text("LOAD", program.to_str().expect("UTF-8"));
    let job = operator.says("START").job;
    (operator, job)
}

#[track_caller]
fn waits_at_line(operator: &mut Operator, line: u32) -> Status {
    operator.waits("a stop", |status| status.state == STOPPED && status.line == line)
}

#[test]
fn messages_come_where_the_program_has_them() {
    unless_disturbed(|| {
        let scene = Scene::new("messages");
        let text = "G21 G90 F6000\nG1 X10\n(MSG, flip the part)\nM0\nG1 X5\nM0 (MSG, measure)\nG1 X2\n\
                    (MSG, wait for the glue)\nG4 P0.6\nG1 X0\n(MSG, part done)\nM2\n";
        let (mut operator, mut job) = starts(&scene, text);
        // A series of parts: each run prints the same message again.
        for part in 0..3 {
            let first = waits_at_line(&mut operator, 4);
            assert_eq!(first.operator_message(), "flip the part", "part {part}");
            assert_eq!(first.position_machine[0], 10.0);
            operator.says("RESUME");
            let second = waits_at_line(&mut operator, 6);
            assert_eq!(second.operator_message(), "measure", "part {part}");
            operator.says("RESUME");
            let dwell = operator.waits("the dwell", |status| status.state == DWELLS);
            assert_eq!(dwell.operator_message(), "wait for the glue", "part {part}");
            assert_eq!(
                operator.sees_end(job).operator_message(),
                "part done",
                "part {part}"
            );
            if part < 2 {
                job = operator.says("START").job;
                let next = operator.waits("the next part", |status| status.job == job && status.state != 0);
                assert_ne!(next.operator_message(), "part done", "of the part before");
            }
        }
        drop(operator);
        scene.end();
    });
}

#[test]
fn a_request_ends_with_the_stop_that_it_is_about() {
    unless_disturbed(|| {
        let scene = Scene::new("requests");
        let (mut operator, job) = starts(&scene, "G21 G90 F600\nG1 X1\nT4 M6\nG1 X11\nM0\nG1 X12\nM2\n");
        let stop = waits_at_line(&mut operator, 3);
        assert!(stop.operator_message().contains("put tool 4 into the spindle"));
        operator.says("RESUME");
        let cut = operator.waits("the cut", |status| {
            status.line == 4 && status.position_machine[0] > 2.0
        });
        assert_eq!(cut.operator_message(), "");
        waits_at_line(&mut operator, 5);
        // Jogged away from the program, after which the job is ended.
        let mut jog = ControlRequest {
            axes_mask: 0b10,
            amount: 20.0,
            index: 1,
            ..command("JOG")
        };
        jog.values[1] = 2.0;
        operator.does(&jog);
        operator.waits("the jog", |status| {
            status.position_machine[1] > 1.99 && status.operator_message().contains("the way back")
        });
        operator.says("STOP");
        let end = operator.sees_end(job);
        assert_eq!(end.operator_message(), "", "there is no way back any more");
        drop(operator);
        scene.end();
    });
}

/// The texts of messages in the order in which statuses have them, until the job ends. A text that continues
/// the one before counts by what it adds.
fn told(reader: &mut EveryStatusReader, job: u64) -> Vec<String> {
    let (begin, mut before, mut told) = (Instant::now(), String::new(), Vec::new());
    loop {
        while let Some(status) = reader.receive().expect("a status") {
            let text = status.operator_message().to_owned();
            if text != before && !text.is_empty() {
                let added = text
                    .strip_prefix(&before)
                    .and_then(|added| added.strip_prefix("; "));
                told.push(added.unwrap_or(&text).to_owned());
            }
            before = text;
            if status.job == job && status.job_result != 0 {
                return told;
            }
        }
        assert!(begin.elapsed() < Duration::from_secs(20), "no end: {told:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn every_message_is_in_a_status_however_soon_the_next_one_comes() {
    unless_disturbed(|| {
        let scene = Scene::new("soon");
        // Moves of about a millisecond, and texts that do not fit into one status together.
        let moves: String = (1..=20)
            .map(|i| format!("(MSG, move {i})\nG1 X{}\n", 0.1 * f64::from(i)))
            .collect();
        let long: String = (1..=5)
            .map(|i| format!("(MSG, {i}{})\n", " long".repeat(20)))
            .collect();
        let text = format!(
            "G21 G90 G64 P0.01 F20000\n(MSG, clamp A closed?)\n(MSG, clamp B closed?)\nM0\n(MSG, one)\nG4 P0.005\n\
             (MSG, two)\nG4 P0.005\n(MSG, three)\nG4 P0.1\n{moves}{long}G4 P0.2\nM2\n"
        );
        let mut reader = scene.domain.client("soon").every_status().expect("the status");
        let (mut operator, job) = starts(&scene, &text);
        let stop = waits_at_line(&mut operator, 4);
        assert_eq!(stop.operator_message(), "clamp A closed?; clamp B closed?");
        operator.says("RESUME");
        let told = told(&mut reader, job);
        let expected: Vec<String> = ["clamp A closed?", "clamp B closed?", "one", "two", "three"]
            .map(str::to_owned)
            .into_iter()
            .chain((1..=20).map(|i| format!("move {i}")))
            .chain((1..=5).map(|i| format!("{i}{}", " long".repeat(20))))
            .collect();
        let seen = told.join("; ");
        assert_eq!(seen, expected.join("; "));
        drop((operator, reader));
        scene.end();
    });
}

#[test]
fn the_message_before_a_start_line_begins_with_what_turns_and_moves() {
    unless_disturbed(|| {
        let scene = Scene::new("start-line");
        let text = "G21 G90 G94 G91.1 G64 P0.005 Q0.001 G99 G8 G40 G49\nG55 T3 M6\nG0 X1 Y2 Z3\nS12000 M3 F1800\nM8\n\
                    G1 X10.123456 Y20.123456 Z-3.123456\nG1 X11 Y21 Z-4\nM2\n";
        let program = scene.workshop.write("program.ngc", text);
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says_number("START", 7).job;
        let stop = operator.waits("the approach", |status| {
            status.job == job && status.operator_message().contains("approach (machine")
        });
        let message = stop.operator_message();
        let (before, rest) = message.split_once("; the approach").expect("an approach");
        assert_eq!(
            before,
            "stopped before line 7, as after: T3 S12000 M3 M8 F1800 G55"
        );
        // What was cut ends with a whole word, and nothing of the approach is cut.
        assert!(rest.contains("RESUME starts it"), "{message}");
        assert!(message.len() <= 256);
        if let Some(kept) = message.strip_suffix("...") {
            let last = kept.rsplit(' ').next().unwrap_or_default();
            assert!(
                text.contains(last)
                    || ["job.", "the", "ends", "STOP", "Also", "it,", "starts"].contains(&last),
                "{message}"
            );
        }
        operator.says("STOP");
        operator.sees_end(job);
        drop(operator);
        scene.end();
    });
}

//! Messages of the status to the operator: their contents and duration.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use evolvent_bus::{ControlRequest, Status};
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

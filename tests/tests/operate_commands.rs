//! Commands to a served machine: rejected, MDI, stale, invalid.

use std::cell::Cell;
use std::time::Duration;

use evolvent_bus::ControlRequest;
use evolvent_tests::job_result::DONE;
use evolvent_tests::{Operator, Scene, command, speed, unless_disturbed};

#[test]
fn rejected_commands_have_a_number_and_change_nothing() {
    unless_disturbed(|| {
        let scene = Scene::new("op-refuse");
        let mut operator = scene.operator();
        let refused = |operator: &mut Operator, request: &ControlRequest, alarm: u32| {
            let answer = operator.request(request);
            assert_eq!((answer.verdict, answer.alarm), (1, alarm), "{}", answer.text());
            assert!(answer.text().len() > 15);
        };
        refused(&mut operator, &command("ON"), 910);
        operator.brings_up();
        refused(&mut operator, &command("START"), 913);
        refused(&mut operator, &command("HOLD"), 915);
        operator.says_number("MODE", 0);
        refused(&mut operator, &command("START"), 917);
        let mut missing = command("LOAD");
        assert!(missing.set_text("/nowhere/at-all.ngc"));
        refused(&mut operator, &missing, 922);
        let bad = scene.workshop.write("bad.ngc", "G21\nG1 X5000 F100\nM2\n");
        let mut load = command("LOAD");
        assert!(load.set_text(bad.to_str().expect("UTF-8")));
        let answer = operator.request(&load);
        assert_eq!((answer.verdict, answer.alarm), (1, 919));
        for word in ["line 2", "axis X", "5000", "400"] {
            assert!(answer.text().contains(word), "{}", answer.text());
        }
        let status = operator.now();
        assert_eq!((status.job, status.machine_state, status.mode), (0, 2, 0));
        assert_eq!(status.program_name(), "");
        drop(operator);
        scene.end();
    });
}

#[test]
fn mdi_keeps_modes_and_rejects_before_motion() {
    unless_disturbed(|| {
        let scene = Scene::new("op-mdi");
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", "G91 G0 X-10").job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        let job = operator.says_text("MDI", "G1 X-2.5 Y1 F3000").job;
        let status = operator.sees_end(job);
        assert_eq!(status.job_result, DONE);
        assert!(
            (status.position_machine[0] + 12.5).abs() < 1e-9,
            "G91 is remembered"
        );
        assert!(status.modal.contains(&910));
        // Also the motion: a rapid would be ten times as fast.
        while operator.setpoints.receive().expect("setpoints").is_some() {}
        let job = operator.says_text("MDI", "X10").job;
        let (mut top, begun): (f64, _) = (0.0, Cell::new(false));
        operator.follows(
            |setpoint| {
                begun.set(begun.get() || setpoint.state == 1);
                if begun.get() {
                    top = top.max(speed(setpoint));
                }
            },
            |setpoint| setpoint.state == 9 && begun.get(),
        );
        let status = operator.sees_end(job);
        assert!((status.position_machine[0] + 2.5).abs() < 1e-9);
        assert!((top - 50.0).abs() < 0.5, "{top} mm/s");
        let mut wrong = command("MDI");
        assert!(wrong.set_text("G90 G1 X9999 F100"));
        let answer = operator.request(&wrong);
        assert_eq!((answer.verdict, answer.alarm), (1, 919), "{}", answer.text());
        assert!(wrong.set_text("G1 X#"));
        assert_eq!(operator.request(&wrong).alarm, 923);
        assert_eq!(operator.now().job, job);
        drop(operator);
        scene.end();
    });
}

/// A machine in inches, as LinuxCNC starts one. M2 does not change the units, as in LinuxCNC; RESET is a new
/// start.
#[test]
fn mdi_starts_in_the_units_of_the_machine() {
    unless_disturbed(|| {
        let program = "[program]\nstart_unit = \"inch\"\nparameter_unit = \"inch\"\n[trace]";
        let scene = Scene::with_changes("op-inch", &[("[trace]", program)], &[]);
        let mut operator = scene.operator();
        operator.brings_up();
        assert!(operator.now().modal.contains(&200));
        operator.says_number("MODE", 2);
        let mut block = |text: &str| {
            let job = operator.says_text("MDI", text).job;
            let status = operator.sees_end(job);
            assert_eq!(status.job_result, DONE, "{text}");
            (status.position_machine[0], status.modal.contains(&200))
        };
        let near = |(x, inches): (f64, bool), expected: f64| inches && (x - expected).abs() < 1e-9;
        assert!(near(block("G90 G0 X1"), 25.4));
        assert!(near(block("G10 L2 P1 X0.5"), 25.4));
        assert!(near(block("G0 X[2*#5221]"), 38.1));
        assert!(!block("G21").1);
        assert!(!block("G91 M2").1);
        let (x, inches) = block("G90 G0 X2");
        assert!(!inches && (x - 14.7).abs() < 1e-9, "{x}");
        operator.says("RESET");
        let status = operator.waits("the start", |status| status.modal.contains(&200));
        assert!(status.modal.contains(&900));
        drop(operator);
        scene.end();
    });
}

#[test]
fn mdi_parameters_last_for_mdi_but_not_for_programs() {
    unless_disturbed(|| {
        let scene = Scene::new("op-parameters");
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 2);
        let mut block = |text: &str| {
            let job = operator.says_text("MDI", text).job;
            operator.sees_end(job)
        };
        assert_eq!(block("#100 = 7.5 #1 = [1/3]").job_result, DONE);
        assert_eq!(block("#<depth> = -2 #<_side> = 4").job_result, DONE);
        assert_eq!(block("G90 G0 X[-#100] Y[-#<_side>]").job_result, DONE);
        let status = block("G0 Z#<depth>");
        let at = status.position_machine;
        assert!(
            (at[0] + 7.5).abs() < 1e-9 && (at[1] + 4.0).abs() < 1e-9 && (at[2] + 2.0).abs() < 1e-9,
            "{at:?}"
        );
        // Three times a third is exactly one.
        assert_eq!(block("#101 = [#100 + [#1 * 3 EQ 1]]").job_result, DONE);
        assert!((block("G0 X[-#101]").position_machine[0] + 8.5).abs() < 1e-9);
        // A parameter that was never set is an error as before, and a block with an error changes nothing.
        let mut wrong = command("MDI");
        assert!(wrong.set_text("#100 = 1 G0 X#<height>"));
        assert_eq!(operator.request(&wrong).alarm, 923);
        let job = operator.says_text("MDI", "G0 X[-#100]").job;
        assert!((operator.sees_end(job).position_machine[0] + 7.5).abs() < 1e-9);
        // A program begins without them and leaves none of its own.
        let file = scene.workshop.write("own.ngc", "G0 X[-#100 - 1]\n#102 = 3\nM2\n");
        let file = file.to_str().expect("UTF-8");
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", file);
        let job = operator.says_text("START", file).job;
        assert!((operator.sees_end(job).position_machine[0] + 1.0).abs() < 1e-9);
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", "G0 X[-#100 - #102]").job;
        assert!((operator.sees_end(job).position_machine[0] + 7.5).abs() < 1e-9);
        drop(operator);
        scene.end();
    });
}

#[test]
fn stale_serials_rubbish_and_floods_change_nothing() {
    unless_disturbed(|| {
        let scene = Scene::new("op-rubbish");
        let mut operator = scene.operator();
        let mut rubbish = scene.operator();
        operator.brings_up();
        let before = operator.now();
        let good = ControlRequest {
            amount: 0.1,
            ..command("FEED_OVERRIDE")
        };
        let patience = Duration::from_secs(60);
        // Not by `..good`: this compiler fails on it in a closure.
        let numbered = |client: u64, serial: u64| {
            let mut request = good;
            (request.client, request.serial) = (client, serial);
            request
        };
        let first = rubbish
            .control
            .send_as_it_is(&numbered(77, 5), patience)
            .expect("an answer");
        assert_eq!((first.verdict, first.client, first.serial), (0, 77, 5));
        operator.does(&ControlRequest { amount: 1.0, ..good });
        let mut random = evolvent_tests::Random::new();
        for _ in 0..300 {
            let mut request = numbered(77, 1 + random.below(5) as u64);
            let kind = random.below(5);
            match kind {
                0 => {}
                1 => (request.serial, request.amount) = (1_000 + random.below(1 << 20) as u64, f64::NAN),
                2 => (request.client, request.interface_version) = (78, random.below(1000) as u32 + 2),
                3 => (request.client, request.struct_size) = (79, random.below(1000) as u32),
                _ => (request.client, request.serial) = (0, 1),
            }
            let answer = rubbish
                .control
                .send_as_it_is(&request, patience)
                .expect("an answer");
            assert_ne!(answer.verdict, 0, "{kind}");
            assert_eq!((answer.client, answer.serial), (request.client, request.serial));
        }
        // Invalid commands, as fast as they can be sent, without waiting for replies.
        for k in 0..3_000 {
            let request = ControlRequest {
                command: 1_000 + k,
                ..ControlRequest::default()
            };
            let _unanswered = rubbish.control.command(&request, Duration::ZERO);
        }
        let after = operator.now();
        assert_eq!(after.override_ratio, 1.0);
        assert_eq!(
            (after.machine_state, after.mode, after.job, after.position_machine),
            (
                before.machine_state,
                before.mode,
                before.job,
                before.position_machine
            )
        );
        assert!(after.commands_rejected >= 300, "{}", after.commands_rejected);
        assert_eq!(after.commands_accepted, before.commands_accepted + 2);
        drop((operator, rubbish));
        scene.end();
    });
}

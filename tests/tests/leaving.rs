//! Excursions from held programs, with simulated drives.

use std::time::Duration;

use evolvent_bus::{ControlRequest, Status};
use evolvent_tests::job_result::{DONE, FAULT, STOPPED};
use evolvent_tests::{Cycle, command, unless_disturbed};

use crate::shop::{AUTO, HELD, Shop, is_away, jog, jogs, keeps_limits};

const MDI: u32 = 2;
const PROGRAM: u32 = 1;
const X: u32 = 1;
const Z: u32 = 4;
const MOVING: u32 = 921;
const OFF_PATH: u32 = 932;
const CANNOT_LEAVE: u32 = 933;
const CANNOT_RETRACE: u32 = 934;
/// Sides of a square with a plunge, slow enough to be held anywhere.
const SQUARE: &str =
    "G21 G90 G94 G64 P0.01\nM3 S1000\nG0 X0 Y0\nG1 Z-2 F1200\nX20\nY10\nX0\nY0\nM5\nG0 Z5\nM2\n";

#[test]
fn a_held_program_left_by_jogs_continues_where_held() {
    unless_disturbed(|| {
        let shop = Shop::new("leave-jog");
        let (served, _drives, mut operator) = shop.opens();
        let held = shop.holds(&mut operator, SQUARE, |status| {
            status.position_machine[2] < -1.9 && status.position_machine[0] > 4.0
        });
        assert_eq!(held.activity, PROGRAM);
        // Not with two axes at once.
        let refused = operator.request(&jog(X | Z, [1.0, 0.0, 1.0]));
        assert_eq!(
            (refused.verdict, refused.alarm),
            (1, CANNOT_LEAVE),
            "{}",
            refused.text()
        );
        let refused = operator.request(&command("RETURN"));
        assert_eq!(refused.verdict, 1, "{}", refused.text());
        jogs(&mut operator, 2, 12.0);
        jogs(&mut operator, 0, -3.0);
        jogs(&mut operator, 1, 7.5);
        let away = operator.now();
        assert_eq!(
            (away.away_mask, away.away_parts),
            (0b111, 3),
            "{}",
            away.operator_message()
        );
        let message = away.operator_message();
        for part in ["Y by -7.5", "X by +3", "Z by -12"] {
            assert!(message.contains(part), "{message}");
        }
        let refused = operator.request(&command("RESUME"));
        assert_eq!(
            (refused.verdict, refused.alarm),
            (1, OFF_PATH),
            "{}",
            refused.text()
        );
        let refused = operator.request(&command("RETRACE"));
        assert_eq!(
            (refused.verdict, refused.alarm),
            (1, CANNOT_RETRACE),
            "{}",
            refused.text()
        );
        // A return that was stopped continues from there.
        operator.says("RETURN");
        operator.waits("the way back", |status| status.velocity[1] < -1.0);
        operator.says("JOG_STOP");
        let stopped = operator.waits("rest", |status| status.velocity.iter().all(|v| *v == 0.0));
        assert_eq!((stopped.activity, stopped.state), (PROGRAM, HELD));
        assert_eq!(operator.request(&command("RESUME")).alarm, OFF_PATH);
        operator.waits("the way back again", |status| {
            status.operator_message().contains("the way back:")
        });
        operator.says("RETURN");
        let back = operator.waits("the way back", |status| status.away_parts == 0);
        assert_eq!(back.position_machine, held.position_machine);
        // An axis that was jogged forth and back by hand has also returned.
        operator.waits("the program's axes", |status| {
            status.operator_message().contains("`resume`")
        });
        jogs(&mut operator, 2, 2.5);
        operator.does(&jog(Z, [0.0, 0.0, -2.5]));
        operator.waits("the way back by hand", |status| status.away_parts == 0);
        operator.waits("the program's axes", |status| {
            status.operator_message().contains("`resume`") && status.away_mask == 0
        });
        let job = held.job;
        operator.says("RESUME");
        let end = operator.sees_end(job);
        assert_eq!(end.job_result, DONE);
        let cycles = shop.ends(served, operator);
        keeps_limits(&shop, &cycles);
        let left: Vec<&Cycle> = cycles.iter().filter(|cycle| is_away(cycle)).collect();
        let farthest = left
            .iter()
            .map(|cycle| cycle.position[2])
            .fold(f64::MIN, f64::max);
        assert!((farthest - 10.0).abs() < 1e-9, "{farthest}");
        // The first setpoint of the program after the excursion is exactly at the last one before it.
        let first = left.first().expect("cycles").sequence;
        let last = left.last().expect("cycles").sequence;
        let at = |sequence: u64| {
            cycles
                .iter()
                .find(|cycle| cycle.sequence == sequence)
                .expect("a cycle")
        };
        assert_eq!(at(first - 1).position, at(last + 1).position);
    });
}

/// Formerly a jog without distance ran to the end of the travel once it had lost its dead-man switch.
#[test]
fn an_increment_in_a_held_program_keeps_the_way_back() {
    unless_disturbed(|| {
        let shop = Shop::new("leave-add");
        let (served, _drives, mut operator) = shop.opens();
        let held = shop.holds(&mut operator, SQUARE, |status| {
            status.position_machine[2] < -1.9 && status.position_machine[0] > 4.0
        });
        let mut onward = ControlRequest {
            axes_mask: Z,
            amount: 20.0,
            ..command("JOG")
        };
        onward.values[2] = 1.0;
        operator.does(&onward);
        operator.waits("motion", |status| {
            status.velocity[2] > 19.0 || status.away_parts > 0
        });
        operator.request(&jog(Z, [0.0, 0.0, -1.0]));
        let away = operator.waits("the way back", |status| {
            status.operator_message().contains("the way back:")
        });
        let went = away.position_machine[2] - held.position_machine[2];
        assert!(went.abs() < 20.0, "{went} mm");
        operator.says("RETURN");
        let back = operator.waits("the way back", |status| status.away_parts == 0);
        assert_eq!(back.position_machine, held.position_machine);
        operator.waits("the program's axes", |status| {
            status.operator_message().contains("`resume`")
        });
        operator.says("RESUME");
        assert_eq!(operator.sees_end(held.job).job_result, DONE);
        let cycles = shop.ends(served, operator);
        keeps_limits(&shop, &cycles);
        let top = (cycles.iter().filter(|cycle| is_away(cycle)))
            .map(|cycle| cycle.velocity[2].abs())
            .fold(0.0, f64::max);
        // The return has the usual speed.
        assert!(top < 150.0 / 5.0 * 2.5, "{top} mm/s");
    });
}

#[test]
fn a_path_is_retraced_to_block_starts_and_back() {
    unless_disturbed(|| {
        let shop = Shop::new("leave-back");
        let (served, _drives, mut operator) = shop.opens();
        let held = shop.holds(&mut operator, SQUARE, |status| {
            status.position_machine[1] > 9.9 && status.position_machine[0] < 12.0
        });
        assert!(held.retrace_blocks >= 3, "{}", held.retrace_blocks);
        operator.says("RETRACE");
        // The corner at X20 Y10 is rounded within 0.01 mm.
        let near = |status: &Status, x: f64, y: f64| {
            let [px, py] = [status.position_machine[0], status.position_machine[1]];
            (px - x).abs() < 0.1 && (py - y).abs() < 0.1 && status.velocity.iter().all(|v| *v == 0.0)
        };
        let there = operator.waits("the start of the block", |status| near(status, 20.0, 10.0));
        assert_eq!((there.state, there.activity), (HELD, PROGRAM));
        operator.waits("what is known of it", |status| status.retraced == 1);
        assert_eq!(operator.request(&command("RESUME")).alarm, OFF_PATH);
        operator.does(&ControlRequest {
            index: 1,
            ..command("RETRACE")
        });
        operator.waits("the start of the block before", |status| near(status, 20.0, 0.0));
        // Spindle and coolant stay as they are.
        assert_eq!(operator.now().spindle_rpm, 1000.0);
        jogs(&mut operator, 2, 5.0);
        let away = operator.now();
        assert_eq!(
            (away.away_parts, away.retraced),
            (2, 1),
            "{}",
            away.operator_message()
        );
        let far = operator.now().retrace_blocks + 1;
        operator.says("RETURN");
        operator.waits("the way back", |status| status.away_parts == 0);
        operator.waits("the program's axes", |status| {
            status.operator_message().contains("`resume`")
        });
        let back = operator.now();
        assert_eq!(back.position_machine, held.position_machine);
        // M3 is before it: retracing ends there.
        let refused = operator.request(&ControlRequest {
            index: back.retrace_blocks + 1,
            ..command("RETRACE")
        });
        assert_eq!(
            (refused.verdict, refused.alarm),
            (1, CANNOT_RETRACE),
            "{}",
            refused.text()
        );
        assert!(far > 0);
        operator.says("RESUME");
        assert_eq!(operator.sees_end(held.job).job_result, DONE);
        let cycles = shop.ends(served, operator);
        keeps_limits(&shop, &cycles);
        // Every position of the retraced path is one of the square.
        let below = |cycle: &&Cycle| is_away(cycle) && cycle.position[2] < -1.99;
        for cycle in cycles.iter().filter(below) {
            let [x, y] = [cycle.position[0], cycle.position[1]];
            let off = [x, y, 20.0 - x, 10.0 - y]
                .into_iter()
                .map(f64::abs)
                .fold(f64::MAX, f64::min);
            assert!(off < 0.0101, "{off} mm off the path at {}", cycle.sequence);
        }
    });
}

#[test]
fn every_event_on_an_excursion_has_a_defined_end() {
    unless_disturbed(|| {
        let shop = Shop::new("leave-trouble");
        let (served, _drives, mut operator) = shop.opens();
        let on_side = |status: &Status| status.position_machine[2] < -1.9 && status.position_machine[0] > 4.0;
        // A client that has gone: the axes stop, the program stays held, and the return path is known.
        shop.holds(&mut operator, SQUARE, on_side);
        let mut on = ControlRequest {
            axes_mask: Z,
            amount: 20.0,
            ..command("JOG")
        };
        on.values[2] = 1.0;
        operator.does(&on);
        operator.waits("a jog", |status| status.velocity[2] > 1.0);
        let stopped = operator.waits("its end", |status| {
            status.velocity[2] == 0.0 && status.operator_message().contains("the way back:")
        });
        assert_eq!(
            (stopped.state, stopped.activity, stopped.away_parts),
            (HELD, PROGRAM, 1)
        );
        // Another axis waits until the first one has stopped; a program cannot be left while it moves.
        operator.does(&jog(Z, [0.0, 0.0, 30.0]));
        operator.waits("a jog", |status| status.velocity[2] > 5.0);
        let refused = operator.request(&jog(X, [5.0, 0.0, 0.0]));
        assert_eq!(refused.verdict, 1, "{}", refused.text());
        // STOP: at rest at the present position, and the job is over.
        operator.says("STOP");
        let status = operator.waits("the end", |status| status.activity == 0);
        assert_eq!(status.job_result, STOPPED);
        assert!(status.position_machine[2] > -1.9);
        assert_eq!(status.away_parts, 0);
        // The next job begins there.
        operator.says_number("MODE", MDI);
        let job = operator.says_text("MDI", "G0 Z5").job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        // An emergency stop during a return.
        shop.holds(&mut operator, SQUARE, on_side);
        jogs(&mut operator, 2, 12.0);
        operator.says("RETURN");
        operator.waits("the way back", |status| status.velocity[2] < -5.0);
        operator.says("ESTOP");
        let status = operator.waits("the end", |status| status.activity == 0);
        assert_eq!((status.machine_state, status.job_result), (0, FAULT));
        operator.waits("power off", |status| status.power == 0);
        // And while the path is driven backwards.
        operator.brings_up();
        let job = {
            operator.says_number("MODE", MDI);
            operator.says_text("MDI", "G0 Z5").job
        };
        assert_eq!(operator.sees_end(job).job_result, DONE);
        let held = shop.holds(&mut operator, SQUARE, on_side);
        operator.says("RETRACE");
        operator.waits("the way", |status| status.velocity.iter().any(|v| *v != 0.0));
        operator.says("HOLD");
        let stopped = operator.waits("rest", |status| {
            status.velocity.iter().all(|v| *v == 0.0) && status.retraced == 1
        });
        assert_eq!(stopped.activity, PROGRAM);
        operator.says("RETURN");
        operator.waits("the way back", |status| status.away_parts == 0);
        operator.waits("the program's axes", |status| {
            status.operator_message().contains("`resume`")
        });
        operator.says("RESUME");
        assert_eq!(operator.sees_end(held.job).job_result, DONE);
        let cycles = shop.ends(served, operator);
        keeps_limits(&shop, &cycles);
    });
}

#[test]
fn a_program_is_left_only_where_it_stands() {
    unless_disturbed(|| {
        let shop = Shop::new("leave-not");
        let (served, _drives, mut operator) = shop.opens();
        let program = shop.workshop.write("slow.ngc", "G21 G90 G94\nG1 X300 F300\nM2\n");
        operator.says_number("MODE", AUTO);
        operator.says_text("LOAD", &program.display().to_string());
        let job = operator.says("START").job;
        operator.waits("motion", |status| status.velocity[0] > 1.0);
        assert_eq!(operator.request(&jog(Z, [0.0, 0.0, 1.0])).verdict, 1);
        assert_eq!(operator.request(&command("RETRACE")).verdict, 1);
        operator.says("HOLD");
        // Stopping, or stopped already.
        let refused = operator.request(&jog(Z, [0.0, 0.0, 1.0]));
        assert!(
            refused.verdict == 0 || refused.alarm == MOVING,
            "{}",
            refused.text()
        );
        operator.waits("rest", |status| status.velocity.iter().all(|v| *v == 0.0));
        std::thread::sleep(Duration::from_millis(50));
        operator.says("STOP");
        operator.sees_end(job);
        // A tool that the operator has to change.
        let program = shop
            .workshop
            .write("tool.ngc", "G21 G90 G94\nT3 M6\nG1 X1 F600\nM2\n");
        operator.says_text("LOAD", &program.display().to_string());
        let job = operator.says("START").job;
        operator.waits("the tool", |status| status.tool_change == 1);
        let refused = operator.request(&jog(Z, [0.0, 0.0, 1.0]));
        assert_eq!(
            (refused.verdict, refused.alarm),
            (1, CANNOT_LEAVE),
            "{}",
            refused.text()
        );
        assert!(refused.text().contains("tool"), "{}", refused.text());
        operator.says("RESUME");
        assert_eq!(operator.sees_end(job).job_result, DONE);
        // A program stop may be left, and holds the program until the axes are back.
        let program = shop
            .workshop
            .write("stop.ngc", "G21 G90 G94\nG1 X5 F3000\nM0\nG1 X0\nM2\n");
        operator.says_text("LOAD", &program.display().to_string());
        let job = operator.says("START").job;
        operator.waits("the stop", |status| status.state == 7);
        jogs(&mut operator, 2, 8.0);
        assert_eq!(operator.request(&command("RESUME")).alarm, OFF_PATH);
        operator.says("RETURN");
        operator.waits("the way back", |status| {
            status.operator_message().contains("`resume`")
        });
        let still = operator.now();
        assert_eq!((still.state, still.position_machine[0]), (7, 5.0));
        operator.says("RESUME");
        assert_eq!(operator.sees_end(job).job_result, DONE);
        let cycles = shop.ends(served, operator);
        keeps_limits(&shop, &cycles);
    });
}

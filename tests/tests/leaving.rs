//! Excursions from held programs, with simulated drives and faults at any moment.
#![expect(
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests fail as tests do"
)]

use std::path::PathBuf;
use std::time::Duration;

use evolvent_bus::{ControlRequest, Status};
use evolvent_machine::Machine;
use evolvent_random::{Random, cases};
use evolvent_replay::verify;
use evolvent_tests::{Cycle, Domain, Drives, Operator, Served, Workshop, command, cycles, unless_disturbed};

const AUTO: u32 = 0;
const MDI: u32 = 2;
const HELD: u32 = 3;
const PROGRAM: u32 = 1;
const DONE: u32 = 1;
const STOPPED: u32 = 2;
const FAULT: u32 = 4;
const X: u32 = 1;
const Z: u32 = 4;
const MOVING: u32 = 921;
const OFF_PATH: u32 = 932;
const CANNOT_LEAVE: u32 = 933;
const CANNOT_RETRACE: u32 = 934;
/// Bits of `inputs` in a trace.
const FOLLOWS: u32 = 128;
const STEERS: u32 = 256;
const RELOCATED: u32 = 512;
/// Sides of a square with a plunge, slow enough to be held anywhere.
const SQUARE: &str =
    "G21 G90 G94 G64 P0.01\nM3 S1000\nG0 X0 Y0\nG1 Z-2 F1200\nX20\nY10\nX0\nY0\nM5\nG0 Z5\nM2\n";

struct Shop {
    workshop: Workshop,
    domain: Domain,
    machine: PathBuf,
    name: &'static str,
}

impl Shop {
    fn new(name: &'static str) -> Self {
        let workshop = Workshop::new();
        let machine = workshop.mill(
            name,
            &[
                ("rate = \"rational\"  ", "rate = 1000.0  "),
                ("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 1000 "),
            ],
        );
        Self {
            workshop,
            domain: Domain::new(),
            machine,
            name,
        }
    }

    fn trace(&self) -> PathBuf {
        self.workshop.path("leaving.mcap")
    }

    /// Core, drives, and somebody who has brought them up.
    fn opens(&self) -> (Served, Drives, Operator) {
        let trace = self.trace().display().to_string();
        let state = self.workshop.path("state");
        let served = Served::start(
            &self.machine,
            self.name,
            &self.domain,
            &state,
            &["--trace", &trace],
        );
        let drives = Drives::start(&self.machine, &self.domain, &[]);
        let mut operator = Operator::join(self.name, &self.domain);
        operator.waits("drives", |status| status.feedback_age_ns < u64::MAX);
        operator.brings_up();
        (served, drives, operator)
    }

    /// Starts a program and holds it where X is beyond `x` on the side of the square at `y`.
    fn holds(&self, operator: &mut Operator, text: &str, until: impl FnMut(&Status) -> bool) -> Status {
        let program = self.workshop.write("square.ngc", text);
        operator.says_number("MODE", AUTO);
        operator.says_text("LOAD", &program.display().to_string());
        operator.says("START");
        operator.waits("the place of the hold", until);
        operator.says("HOLD");
        operator.waits("a hold", |status| {
            status.state == HELD && status.velocity.iter().all(|v| *v == 0.0)
        })
    }

    /// Ends the core; its cycles. The trace is computed again to the last bit.
    fn ends(&self, served: Served, operator: Operator) -> Vec<Cycle> {
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let again = verify(&self.trace()).expect("a readable trace");
        assert!(again.holds() && again.uncompared == 0, "{again:?}");
        cycles(&self.trace())
    }
}

fn jog(axes_mask: u32, distances: [f64; 3]) -> ControlRequest {
    let mut jog = ControlRequest {
        axes_mask,
        index: 1,
        amount: 30.0,
        ..command("JOG")
    };
    jog.values[..3].copy_from_slice(&distances);
    jog
}

/// Jogs away from the program by a distance, to its end.
#[track_caller]
fn jogs(operator: &mut Operator, axis: usize, distance: f64) {
    let before = operator.now().position_machine[axis];
    let mut distances = [0.0; 3];
    distances[axis] = distance;
    operator.does(&jog(1 << axis, distances));
    let goal = before + distance;
    operator.waits("the end of the jog", |status| {
        (status.position_machine[axis] - goal).abs() < 1e-9 && status.velocity[axis] == 0.0
    });
    // The way back is known after the cycle has reported the end of the jog.
    operator.waits("the way back", |status| {
        status.away_parts > 0 || status.operator_message().contains("`resume`")
    });
}

/// Checks that the cycles keep the limits of every axis, by differences of their positions.
#[track_caller]
fn keeps_limits(shop: &Shop, cycles: &[Cycle]) {
    let limits = Machine::load(&shop.machine).expect("the machine file").limits();
    for axis in 0..3 {
        let limits = [
            limits.velocity[axis],
            limits.acceleration[axis],
            limits.jerk[axis],
        ];
        for four in cycles.windows(4) {
            // Drives without power are elsewhere than their setpoints: the core follows them by a step that is no motion.
            let is_relocated = four.iter().any(|cycle| cycle.inputs & RELOCATED != 0);
            if four[3].sequence != four[0].sequence + 3 || is_relocated {
                continue;
            }
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| four[k].position[axis]);
            let rates = [
                (d - c) * 1e3,
                (d - 2.0 * c + b) * 1e6,
                (d - 3.0 * c + 3.0 * b - a) * 1e9,
            ];
            for ((value, slack), limit) in rates.iter().zip([1.001, 1.001, 1.02]).zip(limits) {
                let at = four[0].sequence;
                assert!(
                    value.abs() <= limit * slack + 1.0,
                    "axis {axis} at {at}: {value} of {limit}"
                );
            }
        }
    }
}

fn is_away(cycle: &Cycle) -> bool {
    cycle.inputs & (FOLLOWS | STEERS) == FOLLOWS | STEERS
}

#[test]
fn a_held_program_is_left_by_jogs_and_goes_on_where_it_was_held() {
    unless_disturbed(|| {
        let shop = Shop::new("leave-jog");
        let (served, _drives, mut operator) = shop.opens();
        let held = shop.holds(&mut operator, SQUARE, |status| {
            status.position_machine[2] < -1.9 && status.position_machine[0] > 4.0
        });
        assert_eq!(held.activity, PROGRAM);
        // Not by two axes at once.
        let refused = operator.ask(&jog(X | Z, [1.0, 0.0, 1.0]));
        assert_eq!(
            (refused.verdict, refused.alarm),
            (1, CANNOT_LEAVE),
            "{}",
            refused.text()
        );
        let refused = operator.ask(&command("RETURN"));
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
        let refused = operator.ask(&command("RESUME"));
        assert_eq!(
            (refused.verdict, refused.alarm),
            (1, OFF_PATH),
            "{}",
            refused.text()
        );
        let refused = operator.ask(&command("RETRACE"));
        assert_eq!(
            (refused.verdict, refused.alarm),
            (1, CANNOT_RETRACE),
            "{}",
            refused.text()
        );
        // A way back that is stopped is driven from there on.
        operator.says("RETURN");
        operator.waits("the way back", |status| status.velocity[1] < -1.0);
        operator.says("JOG_STOP");
        let stopped = operator.waits("rest", |status| status.velocity.iter().all(|v| *v == 0.0));
        assert_eq!((stopped.activity, stopped.state), (PROGRAM, HELD));
        assert_eq!(operator.ask(&command("RESUME")).alarm, OFF_PATH);
        operator.waits("the way back again", |status| {
            status.operator_message().contains("the way back:")
        });
        operator.says("RETURN");
        let back = operator.waits("the way back", |status| status.away_parts == 0);
        assert_eq!(back.position_machine, held.position_machine);
        // An axis that is jogged forth and back by hand is back too.
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
        // The first setpoint of the program behind it begins just where the last one before it was.
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

/// A jog without distance under way once freed of its dead-man switch ran to the end of the travel.
#[test]
fn an_increment_stops_the_jog_of_a_held_program_and_the_way_back_is_known() {
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
        operator.ask(&jog(Z, [0.0, 0.0, -1.0]));
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
        // The way back has the usual speed.
        assert!(top < 150.0 / 5.0 * 2.5, "{top} mm/s");
    });
}

#[test]
fn a_path_is_driven_backwards_to_starts_of_blocks_and_forwards_again() {
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
        assert_eq!(operator.ask(&command("RESUME")).alarm, OFF_PATH);
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
        // M3 lies before: there it ends.
        let refused = operator.ask(&ControlRequest {
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
        // Every place of the way back and forth is one of the square's.
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
fn whatever_comes_while_the_axes_are_away_ends_in_a_defined_way() {
    unless_disturbed(|| {
        let shop = Shop::new("leave-trouble");
        let (served, _drives, mut operator) = shop.opens();
        let on_side = |status: &Status| status.position_machine[2] < -1.9 && status.position_machine[0] > 4.0;
        // A client that is gone: the axes stop, the program stays held, and the way back is known.
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
        // Another axis waits until the first one rests; a program cannot be left while it moves.
        operator.does(&jog(Z, [0.0, 0.0, 30.0]));
        operator.waits("a jog", |status| status.velocity[2] > 5.0);
        let refused = operator.ask(&jog(X, [5.0, 0.0, 0.0]));
        assert_eq!(refused.verdict, 1, "{}", refused.text());
        // STOP: at rest where the axes are, and the job is over.
        operator.says("STOP");
        let status = operator.waits("the end", |status| status.activity == 0);
        assert_eq!(status.job_result, STOPPED);
        assert!(status.position_machine[2] > -1.9);
        assert_eq!(status.away_parts, 0);
        // The next one begins there.
        operator.says_number("MODE", MDI);
        let job = operator.says_text("MDI", "G0 Z5").job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        // An emergency stop in the middle of a way back.
        shop.holds(&mut operator, SQUARE, on_side);
        jogs(&mut operator, 2, 12.0);
        operator.says("RETURN");
        operator.waits("the way back", |status| status.velocity[2] < -5.0);
        operator.says("ESTOP");
        let status = operator.waits("the end", |status| status.activity == 0);
        assert_eq!((status.machine_state, status.job_result), (0, FAULT));
        operator.waits("power off", |status| status.power == 0);
        // And of a path that is driven backwards.
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
        assert_eq!(operator.ask(&jog(Z, [0.0, 0.0, 1.0])).verdict, 1);
        assert_eq!(operator.ask(&command("RETRACE")).verdict, 1);
        operator.says("HOLD");
        // On its way to rest, or there already.
        let refused = operator.ask(&jog(Z, [0.0, 0.0, 1.0]));
        assert!(
            refused.verdict == 0 || refused.alarm == MOVING,
            "{}",
            refused.text()
        );
        operator.waits("rest", |status| status.velocity.iter().all(|v| *v == 0.0));
        std::thread::sleep(Duration::from_millis(50));
        operator.says("STOP");
        operator.sees_end(job);
        // A tool that the operator is to change.
        let program = shop
            .workshop
            .write("tool.ngc", "G21 G90 G94\nT3 M6\nG1 X1 F600\nM2\n");
        operator.says_text("LOAD", &program.display().to_string());
        let job = operator.says("START").job;
        operator.waits("the tool", |status| status.tool_change == 1);
        let refused = operator.ask(&jog(Z, [0.0, 0.0, 1.0]));
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
        assert_eq!(operator.ask(&command("RESUME")).alarm, OFF_PATH);
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

/// Radius of the random campaign's circle, mm, and its number of lines.
const RADIUS: f64 = 30.0;
const SIDES: u32 = 1440;
/// The first line of the circle in [`circle`].
const FIRST_SIDE: u32 = 5;

/// A circle of short lines: 0.13 mm each, more than a hundred in a second.
fn circle() -> String {
    use std::fmt::Write as _;
    let mut text = "G21 G90 G94 G64 P0.01\nG0 Z5\nG0 X30 Y0\nG1 Z-2 F1200\n".to_owned();
    for side in 1..=SIDES {
        let angle = f64::from(side) * std::f64::consts::TAU / f64::from(SIDES);
        let _written = writeln!(
            text,
            "G1 X{:.5} Y{:.5}",
            RADIUS * angle.cos(),
            RADIUS * angle.sin()
        );
    }
    text.push_str("G0 Z5\nM2\n");
    text
}

/// Switches the machine on again after whatever has happened.
fn recovers(operator: &mut Operator) {
    for _ in 0..200 {
        let status = operator.now();
        if status.activity == 0 {
            match status.machine_state {
                0 => drop(operator.ask(&command("ESTOP_RESET"))),
                1 => {
                    operator.ask(&command("CLEAR_ALARMS"));
                    operator.ask(&command("ON"));
                }
                _ => {
                    operator.ask(&command("CLEAR_ALARMS"));
                    return;
                }
            }
        }
        std::thread::sleep(Duration::from_millis(25));
    }
    panic!("the machine does not recover: {:?}", operator.now());
}

/// Drives a program to its end from any hold.
fn finishes(operator: &mut Operator) -> Status {
    operator.does(&ControlRequest {
        amount: 1.0,
        ..command("FEED_OVERRIDE")
    });
    operator.says_number("SINGLE_STEP", 0);
    for _ in 0..2000 {
        let status = operator.now();
        if status.activity == 0 {
            return status;
        }
        let rests = status.velocity.iter().all(|v| *v == 0.0);
        if rests && [HELD, 7].contains(&status.state) {
            if status.away_parts > 0 {
                operator.ask(&command("RETURN"));
            }
            operator.ask(&command("RESUME"));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    panic!(
        "no end: {:?} {}",
        operator.now(),
        operator.now().operator_message()
    );
}

/// A random command, mostly one that fits a held program or one that runs. Many are refused all the same.
fn anything(random: &mut Random, is_held: bool) -> ControlRequest {
    let axis = random.below(3);
    let kind = if is_held {
        4 + random.below(18)
    } else {
        random.below(8)
    };
    match kind {
        0..=4 => command("HOLD"),
        5 => ControlRequest {
            amount: random.between(0.0, 2.0),
            ..command("FEED_OVERRIDE")
        },
        6 => ControlRequest {
            index: u32::from(random.unit() < 0.3),
            ..command("SINGLE_STEP")
        },
        7..=8 => command("RESUME"),
        9..=12 => {
            let mut distances = [0.0; 3];
            let far = if axis == 2 { 8.0 } else { 25.0 };
            distances[axis] = random.between(-far, far);
            ControlRequest {
                amount: random.between(5.0, 400.0),
                ..jog(1 << axis, distances)
            }
        }
        13 => {
            let mut on = ControlRequest {
                axes_mask: 1 << axis,
                amount: random.between(1.0, 60.0),
                ..command("JOG")
            };
            on.values[axis] = if random.unit() < 0.5 { 1.0 } else { -1.0 };
            on
        }
        14 => command("JOG_STOP"),
        15..=17 => ControlRequest {
            amount: random.between(0.0, 300.0),
            ..command("RETURN")
        },
        18..=20 => ControlRequest {
            index: random.below(9) as u32,
            ..command("RETRACE")
        },
        _ => command("JOG_KEEP"),
    }
}

/// Commands at random moments of a dense program, now and then a stop, an emergency stop or drives that are gone. Every axis keeps
/// its limits, the program its contour, and the trace is recomputed bit for bit.
#[test]
fn random_commands_leave_limits_contour_and_trace_as_they_are() {
    unless_disturbed(|| {
        let count = cases(150);
        let mut random = Random::new();
        let shop = Shop::new("leave-random");
        let (served, drives, mut operator) = shop.opens();
        let mut drives = Some(drives);
        let program = shop.workshop.write("circle.ngc", circle());
        operator.says_number("MODE", AUTO);
        operator.says_text("LOAD", &program.display().to_string());
        let (mut tried, mut accepted, mut ended) = (0, 0, 0);
        // A draw with few jogs of a held program goes on until it has some; what is short may be missed here.
        let (mut excursions, mut was_away) = (0, false);
        while tried < count || (excursions <= 3 && tried < 10 * count) {
            tried += 1;
            let status = operator.now();
            excursions += u32::from(status.away_parts > 0 && !was_away);
            was_away = status.away_parts > 0;
            if status.activity == 0 {
                recovers(&mut operator);
                if operator.ask(&command("START")).verdict == 0 {
                    ended += 1;
                }
            }
            let request = match random.below(100) {
                0 => command("STOP"),
                1 => command("ESTOP"),
                2 if random.unit() < 0.4 => {
                    drop(drives.take());
                    operator.waits("the loss of the drives", |status| {
                        status.machine_state < 2 && status.activity == 0
                    });
                    drives = Some(Drives::start(&shop.machine, &shop.domain, &[]));
                    operator.waits("drives", |status| status.feedback_age_ns < 100_000_000);
                    continue;
                }
                _ => anything(&mut random, [HELD, 7].contains(&status.state)),
            };
            let answer = operator.ask(&request);
            assert!(answer.verdict <= 1, "{request:?}: {answer:?}");
            assert!(
                answer.verdict == 0 || !answer.text().is_empty(),
                "{request:?}: {answer:?}"
            );
            accepted += u32::from(answer.verdict == 0);
            std::thread::sleep(Duration::from_millis(random.below(120) as u64));
        }
        if operator.now().activity == 0 {
            recovers(&mut operator);
            operator.says("START");
        }
        assert_eq!(finishes(&mut operator).job_result, DONE);
        let cycles = shop.ends(served, operator);
        drop(drives);
        keeps_limits(&shop, &cycles);
        let sides = FIRST_SIDE..FIRST_SIDE + SIDES;
        let (mut left, mut worst, mut seen) = (0, 0.0_f64, 0);
        for pair in cycles.windows(2) {
            let [before, now] = pair else { continue };
            let is_cut = now.inputs & (FOLLOWS | STEERS) == FOLLOWS && sides.contains(&now.line);
            if is_cut && now.position[2] == -2.0 {
                let [x, y] = [now.position[0], now.position[1]];
                worst = worst.max((x.hypot(y) - RADIUS).abs());
                seen += 1;
            }
            left += u32::from(is_away(now) && !is_away(before));
        }
        println!(
            "{accepted} of {tried} accepted, {ended} starts, {left} excursions, {} cycles, {worst:.5} mm off the circle in {seen}",
            cycles.len()
        );
        assert!(worst < 0.0103, "{worst} mm off the circle");
        assert!(
            left > 3 && seen > 500,
            "{left} excursions and {seen} cycles prove nothing"
        );
        // Where the program has the axes again it continues where it was left.
        let mut held: Option<&Cycle> = None;
        for pair in cycles.windows(2) {
            let [before, now] = pair else { continue };
            if is_away(now) && !is_away(before) {
                held = Some(before);
            }
            if !is_away(now) && is_away(before) && now.inputs & FOLLOWS != 0 {
                let held = held.expect("the begin of the excursion");
                assert_eq!(
                    (now.position, now.line),
                    (held.position, held.line),
                    "at {}",
                    now.sequence
                );
            }
        }
    });
}

//! Random commands to a program that is held, left and continued, with faults at random moments.
#![expect(clippy::panic, reason = "helpers of tests fail as tests do")]

use std::time::Duration;

use evolvent_bus::{ControlRequest, Status};
use evolvent_random::{Random, cases};
use evolvent_tests::job_result::DONE;
use evolvent_tests::{Cycle, Drives, Operator, command, unless_disturbed};

use crate::shop::{AUTO, FOLLOWS, HELD, STEERS, Shop, is_away, jog, keeps_limits};

/// Radius of the circle of the random campaign, mm, and its number of lines.
const RADIUS: f64 = 30.0;
const SIDES: u32 = 1440;
/// The first line of the circle in [`circle`].
const FIRST_SIDE: u32 = 5;

/// A circle of short lines: 0.13 mm each, more than a hundred per second.
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

/// Switches the machine on again after any event.
fn recovers(operator: &mut Operator) {
    for _ in 0..200 {
        let status = operator.now();
        if status.activity == 0 {
            match status.machine_state {
                0 => drop(operator.request(&command("ESTOP_RESET"))),
                1 => {
                    operator.request(&command("CLEAR_ALARMS"));
                    operator.request(&command("ON"));
                }
                _ => {
                    operator.request(&command("CLEAR_ALARMS"));
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
                operator.request(&command("RETURN"));
            }
            operator.request(&command("RESUME"));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    panic!(
        "no end: {:?} {}",
        operator.now(),
        operator.now().operator_message()
    );
}

/// A random command, usually one that fits a held or a running program. Many are rejected all the same.
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

/// Commands at random moments of a dense program, with occasional stops, emergency stops and loss of the
/// drives. Every axis keeps its limits, the program keeps its contour, and the trace is recomputed bit for
/// bit.
#[test]
fn random_commands_keep_limits_contour_and_trace() {
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
        // A case with few jogs of a held program continues until it has some; short ones may be missed here.
        let (mut excursions, mut was_away) = (0, false);
        while tried < count || (excursions <= 3 && tried < 10 * count) {
            tried += 1;
            let status = operator.now();
            excursions += u32::from(status.away_parts > 0 && !was_away);
            was_away = status.away_parts > 0;
            if status.activity == 0 {
                recovers(&mut operator);
                if operator.request(&command("START")).verdict == 0 {
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
            let answer = operator.request(&request);
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
        let (mut left, mut worst, mut on_circle) = (0, 0.0_f64, 0);
        for pair in cycles.windows(2) {
            let [before, now] = pair else { continue };
            let is_cut = now.inputs & (FOLLOWS | STEERS) == FOLLOWS && sides.contains(&now.line);
            if is_cut && now.position[2] == -2.0 {
                let [x, y] = [now.position[0], now.position[1]];
                worst = worst.max((x.hypot(y) - RADIUS).abs());
                on_circle += 1;
            }
            left += u32::from(is_away(now) && !is_away(before));
        }
        println!(
            "{accepted} of {tried} accepted, {ended} starts, {left} excursions, {} cycles, {worst:.5} mm \
             off the circle in {on_circle}",
            cycles.len()
        );
        assert!(worst < 0.0103, "{worst} mm off the circle");
        assert!(
            left > 3 && on_circle > 500,
            "{left} excursions and {on_circle} cycles prove nothing"
        );
        // When the program has the axes again it continues where it was left.
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

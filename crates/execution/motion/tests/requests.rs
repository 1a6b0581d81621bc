//! The cycle and the time-optimal planner: holds, overrides, and planners that are late or gone.

#![allow(clippy::expect_used, reason = "a test may fail")]

use evolvent_machine::PlannerKind;
use evolvent_motion::{Inputs, MotionState, Setpoint, flags};
use evolvent_path::{Axes, Curve, Line, Move, MoveKind, PathMode};
use evolvent_planner::Step;

use crate::common::{BLEND, Pair, campaign, check, equal_axes, run, scenario};

/// Time from a change of an input to the position at which the reply takes over, s.
const LEAD: f64 = 0.010;

fn straight(feed: f64, length: f64, period_ns: u64) -> crate::common::Scenario {
    let mut end = Axes::zeros();
    end[0] = length;
    crate::common::Scenario {
        limits: equal_axes(if feed > 250.0 { 1000.0 } else { 250.0 }, 2000.0, 50_000.0),
        period_ns,
        moves: vec![Move {
            curve: Curve::Line(Line::new(Axes::zeros(), end).expect("line")),
            kind: MoveKind::Feed,
            feed_mm_s: feed,
            path_mode: PathMode::ExactPath,
        }],
        chord_error_mm: 1e-3,
        planner: PlannerKind::Optimal,
    }
}

/// Duration of a stop from `v` without acceleration: `2 sqrt(v/J)` if that keeps `A`, else `A/J + v/A`.
fn min_stop(v: f64) -> f64 {
    let (a, j) = (2000.0, 50_000.0);
    if v <= a * a / j {
        2.0 * (v / j).sqrt()
    } else {
        a / j + v / a
    }
}

#[test]
fn a_hold_stops_in_the_least_time_after_the_lead() {
    for (feed, period_ns) in [
        (100.0, 1_000_000),
        (400.0, 100_000),
        (20.0, 1_000_000),
        (5.0, 4_000_000),
    ] {
        let scenario = straight(feed, 600.0, period_ns);
        let period = period_ns as f64 * 1e-9;
        let moment = (0.8 / period) as u64;
        let until = moment + (2.0 / period) as u64;
        let (setpoints, motion) = run(&scenario, |cycle| Inputs {
            hold: (moment..until).contains(&cycle),
            ..Inputs::default()
        });
        check(&scenario, &setpoints, &motion, 1e-6, "straight");
        let before = &setpoints[moment as usize - 1];
        assert!(
            (before.feed_mm_s - feed).abs() < 3e-3 * feed,
            "{}",
            before.feed_mm_s
        );
        // The setpoint in which the hold arrives brakes.
        let first = &setpoints[moment as usize];
        assert!(first.jerk[0] < -0.15 * 50_000.0, "{feed} mm/s: {}", first.jerk[0]);
        assert!(first.feed_mm_s < before.feed_mm_s, "{feed} mm/s");
        let rest = setpoints[moment as usize..]
            .iter()
            .position(|s| s.feed_mm_s == 0.0)
            .expect("comes to rest");
        let took = rest as f64 * period;
        let allowed = 1.1 * min_stop(feed) + LEAD + 2.0 * period;
        assert!(took <= allowed, "{feed} mm/s: {took} s of {allowed} s");
        // The axes have their full speed up to the setpoint before the first that brakes: one period earlier.
        // 0.1 % covers the jerk of a slowdown, which may use 1.002 of the limit.
        assert!(
            took + period >= 0.999 * min_stop(feed),
            "{feed} mm/s: {took} s is less than the limits allow"
        );
        assert_eq!(setpoints[until as usize - 1].state, MotionState::Held);
        // It continues to the end.
        let last = setpoints[setpoints.len() - 1];
        assert!((last.position[0] - 600.0).abs() < 1e-9 && last.state == MotionState::Done);
    }
}

#[test]
fn an_override_acts_within_20_ms_and_is_reached() {
    for factor in [0.3, 0.9, 1.5, 2.0] {
        let scenario = straight(100.0, 500.0, 500_000);
        let moment = 1000;
        let (plain, _) = run(&scenario, |_| Inputs::default());
        let (setpoints, motion) = run(&scenario, |cycle| Inputs {
            feed_override: if cycle >= moment { factor } else { 1.0 },
            ..Inputs::default()
        });
        if let Some(k) = setpoints.iter().position(|s| s.flags & 64 != 0) {
            for s in &setpoints[k - 12..k + 2] {
                println!(
                    "{} {:?} x {} v {} a {} j {}",
                    s.sequence, s.state, s.position[0], s.velocity[0], s.acceleration[0], s.jerk[0]
                );
            }
        }
        check(&scenario, &setpoints, &motion, 1e-6, "straight");
        let differs = (moment as usize..)
            .find(|&k| (setpoints[k].feed_mm_s - plain[k].feed_mm_s).abs() > 1e-6)
            .expect("an effect");
        let took = (differs - moment as usize) as f64 * 0.0005;
        assert!(took <= 0.020, "{factor}: {took} s");
        let reached = setpoints
            .iter()
            .skip(moment as usize + 800)
            .take(200)
            .all(|s| (s.feed_mm_s - 100.0 * factor).abs() < 0.005 * 100.0 * factor);
        assert!(
            reached,
            "{factor}: {}",
            setpoints[moment as usize + 800].feed_mm_s
        );
    }
}

/// Blocks of a few milliseconds each, which arrive more slowly than they are driven.
#[test]
fn a_slow_planner_stops_on_the_path_and_continues() {
    let (mut random, cases) = campaign(0x0e01_0010, 2);
    let mut starved = 0;
    for case in 0..cases {
        let (mode, tolerance) = [(BLEND, 0.02), (PathMode::ExactPath, 1e-6)][case % 2];
        let mut scenario = scenario(&mut random, mode, false);
        scenario.planner = PlannerKind::Optimal;
        scenario.period_ns = 500_000;
        let mut at = Axes::zeros();
        scenario.moves = (0..300)
            .map(|_| {
                let (start, feed) = (at, random.log(20.0, 200.0));
                at[0] += feed * random.log(0.004, 0.03);
                at[1] += feed * random.between(-0.002, 0.002);
                Move {
                    curve: Curve::Line(Line::new(start, at).expect("line")),
                    kind: MoveKind::Feed,
                    feed_mm_s: feed,
                    path_mode: mode,
                }
            })
            .collect();
        let every = 30 + random.pick(60);
        let mut pair = Pair::new(&scenario);
        let mut setpoints: Vec<Setpoint> = Vec::new();
        let mut inputs = Inputs::default();
        while !pair.motion.is_over() {
            let cycle = setpoints.len();
            if cycle.is_multiple_of(every) {
                pair.feed(&scenario);
            } else if cycle.is_multiple_of(7) {
                pair.poll();
            }
            if random.unit() < 0.003 {
                inputs.feed_override = random.between(0.2, 2.0);
                inputs.hold = random.unit() < 0.1;
            }
            setpoints.push(pair.step(&inputs));
            assert!(cycle < 1_000_000, "case {case} does not end");
        }
        let what = format!("case {case}, a block every {every} cycles");
        check(&scenario, &setpoints, &pair.motion, tolerance, &what);
        assert_eq!(pair.motion.state(), MotionState::Done, "{what}");
        starved += setpoints.iter().filter(|s| s.flags & flags::STARVED != 0).count();
    }
    assert!(starved > 0, "the planner was never late");
}

#[test]
fn a_dead_planner_stops_on_the_path() {
    let (mut random, cases) = campaign(0x0e01_0011, 40);
    for case in 0..cases {
        let mode = if case % 2 == 0 { BLEND } else { PathMode::ExactPath };
        let mut scenario = scenario(&mut random, mode, false);
        scenario.planner = PlannerKind::Optimal;
        let death = random.log(1.0, 5000.0) as u64;
        let hold_after = random.log(1.0, 500.0) as u64;
        let held = case % 3 == 0;
        let mut pair = Pair::new(&scenario);
        let mut setpoints = Vec::new();
        let mut tries = 0;
        while (setpoints.len() as u64) < death && !pair.motion.is_over() {
            pair.plan_ahead(&scenario);
            setpoints.push(pair.step(&Inputs::default()));
        }
        let Pair {
            planner,
            mut queue,
            mut motion,
            ..
        } = pair;
        drop(planner);
        while !motion.is_over() && !motion.is_stuck(&mut queue) {
            let hold = held && setpoints.len() as u64 > death + hold_after;
            let inputs = Inputs {
                hold,
                ..Inputs::default()
            };
            setpoints.push(motion.step(&inputs, &mut queue));
            tries += 1;
            assert!(tries < 2_000_000, "case {case} does not come to rest");
            if hold && motion.is_at_rest() {
                break;
            }
        }
        let what = format!("case {case} dies at {death}, held {held}");
        check(
            &scenario,
            &setpoints,
            &motion,
            if case % 2 == 0 { 0.02 } else { 1e-6 },
            &what,
        );
        let last = &setpoints[setpoints.len() - 1];
        assert_eq!(last.velocity.amax(), 0.0, "{what}");
    }
}

#[test]
fn a_hold_without_a_reply_stops_on_the_path() {
    let scenario = straight(200.0, 2000.0, 1_000_000);
    let mut pair = Pair::new(&scenario);
    let mut setpoints = Vec::new();
    // Everything is planned; then the planner stops.
    for cycle in 0..3000 {
        if cycle < 500 {
            pair.plan_ahead(&scenario);
        }
        let hold = cycle >= 1000;
        setpoints.push(pair.step(&Inputs {
            hold,
            ..Inputs::default()
        }));
    }
    check(&scenario, &setpoints, &pair.motion, 1e-6, "unanswered");
    let rest = setpoints[1000..]
        .iter()
        .position(|s| s.feed_mm_s == 0.0)
        .expect("rest");
    // The minimum is 200 mm/s over A plus A/J: 140 cycles.
    assert!(rest < 260, "{rest} cycles");
    assert_eq!(pair.motion.state(), MotionState::Held);
    // The planner returns, and the program continues from there.
    while !pair.motion.is_over() {
        pair.plan_ahead(&scenario);
        setpoints.push(pair.step(&Inputs::default()));
        assert!(setpoints.len() < 100_000, "does not end");
    }
    check(&scenario, &setpoints, &pair.motion, 1e-6, "answered again");
    assert!((setpoints[setpoints.len() - 1].position[0] - 2000.0).abs() < 1e-9);
}

/// A wave in chords of 0.1 mm.
fn wave(blocks: usize) -> Vec<Move> {
    let at = |k: usize| {
        let s = 0.1 * k as f64;
        let mut point = Axes::zeros();
        (point[0], point[1]) = (s, 4.0 * (0.2 * s).sin() + (0.9 * s).cos());
        point
    };
    (0..blocks)
        .map(|k| Move {
            curve: Curve::Line(Line::new(at(k), at(k + 1)).expect("line")),
            kind: MoveKind::Feed,
            feed_mm_s: 20.0,
            path_mode: BLEND,
        })
        .collect()
}

#[test]
fn a_planner_far_ahead_replies_from_the_current_cycle() {
    let mut scenario = straight(100.0, 1.0, 1_000_000);
    scenario.moves = wave(600);
    let drive = |inputs: &dyn Fn(u64) -> Inputs| {
        let mut pair = Pair::new(&scenario);
        for _ in 0..=scenario.moves.len() {
            pair.feed(&scenario);
        }
        let mut out: Vec<Setpoint> = Vec::new();
        while !pair.motion.is_over() {
            pair.plan_ahead(&scenario);
            out.push(pair.step(&inputs(out.len() as u64)));
            assert!(out.len() < 100_000, "does not end");
        }
        check(&scenario, &out, &pair.motion, 0.02, "wave");
        out
    };
    let plain = drive(&|_| Inputs::default());
    for factor in [0.4, 1.6] {
        let changed = drive(&|cycle| Inputs {
            feed_override: if cycle >= 700 { factor } else { 1.0 },
            ..Inputs::default()
        });
        let differs = (700..plain.len())
            .find(|&k| (plain[k].feed_mm_s - changed[k].feed_mm_s).abs() > 1e-3)
            .expect("an effect");
        assert!(differs <= 720, "{factor}: at {differs}");
        let faster = changed.len() < plain.len();
        assert_eq!(
            faster,
            factor > 1.0,
            "{} and {} cycles",
            changed.len(),
            plain.len()
        );
    }
    let held = drive(&|cycle| Inputs {
        hold: (700..1500).contains(&cycle),
        ..Inputs::default()
    });
    let rest = held[700..].iter().position(|s| s.feed_mm_s == 0.0).expect("rest");
    assert!(rest < 200, "{rest} cycles");
}

#[test]
fn a_hold_before_a_dwell_continues_after_it() {
    let mut scenario = straight(200.0, 400.0, 1_000_000);
    let back = Move {
        curve: scenario.moves[0].curve.reversed(),
        ..scenario.moves[0]
    };
    scenario.moves.push(back);
    // No reply to the hold. The hold arrives where there is enough distance to stop before the dwell, where
    // there is hardly enough, and where the machine reaches the dwell before path time has stopped.
    let mut positions = Vec::new();
    let (plain, _) = run(&scenario, |_| Inputs::default());
    let there = plain
        .iter()
        .position(|s| 400.0 - s.position[0] < 1e-5)
        .expect("at the dwell") as u64;
    for hold in [1600, 1940, there] {
        let mut pair = Pair::new(&scenario);
        pair.feed(&scenario);
        let dwell = Step::Dwell {
            seconds: 0.1,
            line: 1,
        };
        pair.planner.rest(&dwell).expect("plan");
        pair.feed(&scenario);
        pair.feed(&scenario);
        let mut setpoints: Vec<Setpoint> = Vec::new();
        for cycle in 0..4000 {
            setpoints.push(pair.step(&Inputs {
                hold: cycle >= hold,
                ..Inputs::default()
            }));
        }
        assert_eq!(pair.motion.state(), MotionState::Held);
        positions.push(setpoints[3999].position[0]);
        while !pair.motion.is_over() {
            pair.poll();
            setpoints.push(pair.step(&Inputs::default()));
            assert!(setpoints.len() < 100_000, "does not end");
        }
        check(&scenario, &setpoints, &pair.motion, 1e-6, "behind the dwell");
        assert_eq!(setpoints[setpoints.len() - 1].position[0], 0.0);
    }
    assert!(positions[0] < 350.0 && positions[2] == 400.0, "{positions:?}");
}

#[test]
fn an_override_near_zero_is_a_hold() {
    for (factor, slowest) in [(5e-4, 0.0), (1e-3, 0.1), (0.01, 1.0)] {
        let scenario = straight(100.0, 200.0, 1_000_000);
        let (setpoints, motion) = run(&scenario, |cycle| Inputs {
            feed_override: if (500..1500).contains(&cycle) { factor } else { 1.0 },
            ..Inputs::default()
        });
        check(&scenario, &setpoints, &motion, 1e-6, "next to nothing");
        let feed = setpoints[1499].feed_mm_s;
        assert!(
            (0.999 * slowest..=1.001 * slowest).contains(&feed),
            "{factor}: {feed} mm/s"
        );
        // Also from rest.
        let (setpoints, motion) = run(&scenario, |cycle| Inputs {
            feed_override: if cycle < 500 { factor } else { 1.0 },
            ..Inputs::default()
        });
        check(&scenario, &setpoints, &motion, 1e-6, "next to nothing at rest");
        assert_eq!(setpoints[setpoints.len() - 1].position[0], 200.0);
    }
}

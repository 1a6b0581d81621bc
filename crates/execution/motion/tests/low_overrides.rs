//! The feed under overrides from nearly zero to twice the programmed feed.

#![allow(clippy::expect_used, reason = "a test may fail")]

use evolvent_machine::PlannerKind;
use evolvent_motion::{Inputs, Setpoint};
use evolvent_path::{Arc, Axes, Curve, Line, Move, MoveKind, PathMode, Plane, Sense};
use evolvent_planner::Step;
use evolvent_random::{Random, cases};

use crate::common::{BLEND, Pair, Scenario, check, equal_axes};

/// Maximum relative error of the feed.
const ALLOWED: f64 = 1e-3;
/// Maximum relative deficit of the feed on the first interval after a decrease along varying caps: the
/// grid points there are as far apart as the speed before the decrease required.
const ALLOWED_AFTER_DECREASE: f64 = 2.5e-3;

fn scenario(moves: Vec<Move>) -> Scenario {
    Scenario {
        limits: equal_axes(1000.0, 2000.0, 50_000.0),
        period_ns: 1_000_000,
        moves,
        chord_error_mm: 1e-2,
        planner: PlannerKind::Optimal,
    }
}

fn feed(curve: Curve, path_mode: PathMode) -> Move {
    Move {
        curve,
        kind: MoveKind::Feed,
        feed_mm_s: 30.0,
        path_mode,
    }
}

fn point(x: f64, y: f64) -> Axes {
    let mut point = Axes::zeros();
    (point[0], point[1]) = (x, y);
    point
}

fn line() -> Scenario {
    let line = Line::new(point(0.0, 0.0), point(300.0, 0.0)).expect("line");
    scenario(vec![feed(line.into(), PathMode::ExactPath)])
}

fn circles() -> Scenario {
    let start = point(40.0, 0.0);
    let arc = Arc::new(Plane::Xy, start, start, [0.0, 0.0], Sense::CounterClockwise, 2).expect("arc");
    scenario(vec![feed(arc.into(), PathMode::ExactPath)])
}

/// A gentle wave in chords of 0.2 mm.
fn wave() -> Scenario {
    let at = |k: usize| {
        let s = 0.2 * k as f64;
        point(s, 4.0 * (0.05 * s).sin())
    };
    let line = |k: usize| Line::new(at(k), at(k + 1)).expect("line").into();
    scenario((0..1500).map(|k| feed(line(k), BLEND)).collect())
}

/// Drives this many cycles.
fn drive(scenario: &Scenario, cycles: usize, requested: impl Fn(u64) -> f64) -> Vec<Setpoint> {
    let mut pair = Pair::new(scenario);
    let mut out = Vec::new();
    while out.len() < cycles {
        pair.plan_ahead(scenario);
        let feed_override = requested(out.len() as u64);
        out.push(pair.step(&Inputs {
            feed_override,
            ..Inputs::default()
        }));
    }
    check(scenario, &out, &pair.motion, 0.02, "override");
    out
}

#[test]
fn the_feed_is_exact_to_1e_3_at_overrides_up_to_2() {
    let mut faults = Vec::new();
    for (name, scenario) in [("line", line()), ("circles", circles()), ("wave", wave())] {
        for (from, to) in [
            (1.0, 0.001),
            (1.0, 0.002),
            (1.0, 0.005),
            (1.0, 0.01),
            (1.0, 0.02),
            (1.0, 0.05),
            (1.0, 0.1),
            (1.0, 0.3),
            (1.0, 0.7),
            (1.0, 1.3),
            (1.0, 2.0),
            (0.001, 1.0),
            (0.01, 0.001),
            (0.001, 0.01),
            (0.01, 0.5),
            (2.0, 0.003),
            (0.001, 0.001),
        ] {
            let change = 600;
            let setpoints = drive(&scenario, 2000, |cycle| if cycle < change { from } else { to });
            for (requested, part) in [(from, 400..600), (to, 1000..2000)] {
                let wanted = 30.0 * requested;
                let ratios = setpoints[part].iter().map(|s| s.feed_mm_s / wanted);
                let (low, high) = ratios.fold((f64::INFINITY, 0.0_f64), |(low, high), ratio| {
                    (low.min(ratio), high.max(ratio))
                });
                let below = if (name, from, to) == ("wave", 2.0, 0.003) {
                    ALLOWED_AFTER_DECREASE
                } else {
                    ALLOWED
                };
                if low < 1.0 - below || high > 1.0 + ALLOWED {
                    faults.push(format!(
                        "{name} {from} -> {to}: at {requested} {low:.5} to {high:.5}"
                    ));
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// The feed per revolution follows a spindle that slows down, and the run is stopped at some moment of it.
#[test]
fn a_stop_while_the_feed_decays_comes_to_rest() {
    let mut random = Random::mixed(40);
    let scenarios = [("line", line()), ("circles", circles()), ("wave", wave())];
    for number in 0..cases(60) {
        let (name, scenario) = &scenarios[number % 3];
        let (per_cycle, begin) = (random.between(0.9, 0.999), 300);
        let stop = begin + random.below(1500) as u64;
        let mut pair = Pair::new(scenario);
        let mut out = Vec::new();
        while !pair.motion.is_over() {
            pair.plan_ahead(scenario);
            let cycle = out.len() as u64;
            out.push(pair.step(&Inputs {
                feed_override: per_cycle.powf(cycle.saturating_sub(begin) as f64),
                stop: cycle >= stop,
                ..Inputs::default()
            }));
            // From 30 mm/s the jerk-limited stop takes 49 ms.
            assert!(
                cycle < stop + 75,
                "{name}, {per_cycle} a cycle, stopped at {stop}: {:?}",
                out.last()
            );
        }
        check(scenario, &out, &pair.motion, 0.02, name);
    }
}

/// A feed of zero only prevents motion; steps of the program at rest take effect when they are reached.
#[test]
fn rests_are_passed_without_feed() {
    let scenario = line();
    let mut pair = Pair::new(&scenario);
    let dwell = Step::Dwell {
        seconds: 0.02,
        line: 2,
    };
    for rest in [
        Step::Action { action: 0, line: 1 },
        dwell,
        Step::Action { action: 1, line: 3 },
    ] {
        pair.planner.rest(&rest).expect("room");
    }
    let stopped = Inputs {
        feed_override: 0.0,
        ..Inputs::default()
    };
    let drive = |pair: &mut Pair, inputs: &Inputs| {
        let mut last = None;
        for _ in 0..100 {
            pair.plan_ahead(&scenario);
            last = Some(pair.step(inputs));
        }
        last.expect("a setpoint")
    };
    let waiting = drive(&mut pair, &stopped);
    assert_eq!((waiting.actions, waiting.path_mm), (2, 0.0));
    assert!(drive(&mut pair, &Inputs::default()).path_mm > 0.0);
}

//! What a setpoint at rest says: the programmed end, and which kind of move is next.

#![allow(clippy::expect_used, reason = "a test may fail")]

use evolvent_machine::PlannerKind;
use evolvent_motion::{Inputs, MotionState};
use evolvent_path::{Axes, Curve, Line, Move, MoveKind, PathMode};

use crate::common::{Pair, Scenario, campaign, equal_axes, program, run};

/// The position at the end of a program is the programmed one to the last bit, whatever the curve computes.
#[test]
fn a_program_ends_exactly_where_it_is_programmed() {
    let (mut random, cases) = campaign(0x2611_2801, 40);
    for case in 0..cases {
        let mut moves = program(&mut random, PathMode::ExactStop, false);
        moves.truncate(1 + case % 3);
        let end = moves.last().expect("a move").curve.end();
        let planner = [PlannerKind::Optimal, PlannerKind::Classic][case % 2];
        let scenario = Scenario {
            limits: equal_axes(200.0, 2000.0, 50_000.0),
            period_ns: 1_000_000,
            moves,
            chord_error_mm: 1e-2,
            planner,
        };
        let (out, _) = run(&scenario, |_| Inputs::default());
        let last = out.last().expect("a setpoint");
        assert_eq!(last.position, end, "case {case}, {planner:?}");
    }
}

fn point(x: f64) -> Axes {
    let mut point = Axes::zeros();
    point[0] = x;
    point
}

/// The override of rapids applies from the end of the feed move, not while it is held in its middle.
#[test]
fn a_held_feed_before_a_rapid_is_no_rapid() {
    for planner in [PlannerKind::Optimal, PlannerKind::Classic] {
        let line = |from: f64, to: f64, kind: MoveKind| Move {
            curve: Curve::Line(Line::new(point(from), point(to)).expect("line")),
            kind,
            feed_mm_s: 20.0,
            path_mode: PathMode::ExactStop,
        };
        let scenario = Scenario {
            limits: equal_axes(200.0, 2000.0, 50_000.0),
            period_ns: 1_000_000,
            moves: vec![line(0.0, 10.0, MoveKind::Feed), line(10.0, 40.0, MoveKind::Rapid)],
            chord_error_mm: 1e-2,
            planner,
        };
        let mut pair = Pair::new(&scenario);
        let (mut was_held, mut positions) = (false, Vec::new());
        for cycle in 0..4000 {
            pair.plan_ahead(&scenario);
            let hold = (200..400).contains(&cycle);
            let setpoint = pair.step(&Inputs {
                hold,
                ..Inputs::default()
            });
            was_held |= setpoint.state == MotionState::Held;
            let x = setpoint.position[0];
            if x < 9.9 {
                assert!(!pair.motion.is_rapid(), "{planner:?}: a rapid at {x}");
            } else if x > 10.0 && setpoint.velocity[0] > 0.0 {
                assert!(pair.motion.is_rapid(), "{planner:?}: a feed at {x}");
            }
            positions.push(x);
            if pair.motion.is_over() {
                break;
            }
        }
        assert!(was_held, "{planner:?}");
        assert_eq!(positions.last(), Some(&40.0), "{planner:?}");
    }
}

//! The invariants of motion over random programs, limits, override histories and hold moments.

use evolvent_machine::PlannerKind;
use evolvent_motion::{Inputs, MotionState};
use evolvent_path::PathMode;

use crate::common::{BLEND, PLANNERS, Random, campaign, check, run, scenario};

#[test]
fn every_setpoint_keeps_every_limit_and_the_path() {
    let (mut random, cases) = campaign(0x0e01_0001, 150);
    for case in 0..cases {
        let (mode, tolerance) = match case / 2 % 3 {
            0 => (PathMode::ExactPath, 1e-6),
            1 => (PathMode::ExactStop, 1e-6),
            _ => (BLEND, 0.02),
        };
        let mut scenario = scenario(&mut random, mode, case % 5 == 0);
        scenario.planner = PLANNERS[case % 2];
        let (setpoints, motion) = run(&scenario, |_| Inputs::default());
        let what = format!("case {case} {mode:?} {:?}", scenario.planner);
        check(&scenario, &setpoints, &motion, tolerance, &what);
        let end = scenario.moves[scenario.moves.len() - 1].curve.end();
        let last = setpoints[setpoints.len() - 1];
        assert!(
            (last.position - end).amax() <= 1e-9,
            "{what}: ends at {:?}",
            last.position
        );
        assert_eq!(last.state, MotionState::Done);
        for setpoint in &setpoints {
            let motion = &scenario.moves[setpoint.block as usize];
            // The feed on a blend, and of a time-optimal plan, is bounded at stations; between them it may be
            // slightly higher.
            let blend = setpoint.flags & evolvent_motion::flags::BLEND != 0;
            let slack = match scenario.planner {
                PlannerKind::Optimal => 1e-3,
                PlannerKind::Classic if blend => 1e-4,
                PlannerKind::Classic => 1e-6,
            };
            assert!(
                setpoint.feed_mm_s <= motion.feed_mm_s * (1.0 + slack),
                "{what}: {} over feed {} flags {}",
                setpoint.feed_mm_s,
                motion.feed_mm_s,
                setpoint.flags
            );
        }
    }
}

#[test]
fn holds_and_overrides_keep_every_limit_and_the_path() {
    let (mut random, cases) = campaign(0x0e01_0002, 150);
    for case in 0..cases {
        let blends = case / 2 % 2 == 0;
        let mode = if blends { BLEND } else { PathMode::ExactPath };
        let tolerance = if blends { 0.02 } else { 1e-6 };
        let mut scenario = scenario(&mut random, mode, false);
        scenario.planner = PLANNERS[case % 2];
        let mut inputs = Inputs::default();
        let mut next = 0;
        let history = Random::from_state(random.state() ^ 0xabcd);
        let mut history_of = history;
        let (setpoints, motion) = run(&scenario, |cycle| {
            if cycle >= next {
                next = cycle + history_of.log(1.0, 400.0) as u64;
                inputs.hold = history_of.unit() < 0.3;
                if history_of.unit() < 0.6 {
                    inputs.feed_override = history_of.between(0.0, 2.2);
                }
                if cycle > 20_000 {
                    inputs = Inputs::default();
                }
            }
            inputs
        });
        let what = format!("case {case} {mode:?} {:?}", scenario.planner);
        check(&scenario, &setpoints, &motion, tolerance, &what);
        let end = scenario.moves[scenario.moves.len() - 1].curve.end();
        assert!(
            (setpoints[setpoints.len() - 1].position - end).amax() <= 1e-9,
            "{what}"
        );
    }
}

#[test]
fn a_stop_at_any_moment_ends_at_rest_on_the_path() {
    let (mut random, cases) = campaign(0x0e01_0003, 150);
    for case in 0..cases {
        let mut scenario = scenario(&mut random, BLEND, false);
        scenario.planner = PLANNERS[case % 2];
        let moment = random.log(1.0, 2000.0) as u64;
        let (setpoints, motion) = run(&scenario, |cycle| Inputs {
            stop: cycle >= moment,
            ..Inputs::default()
        });
        let what = format!("case {case} {:?}", scenario.planner);
        check(&scenario, &setpoints, &motion, 0.02, &what);
        assert!(matches!(motion.state(), MotionState::Stopped | MotionState::Done));
        let last = &setpoints[setpoints.len() - 1];
        assert_eq!(last.velocity.amax(), 0.0, "case {case}");
    }
}

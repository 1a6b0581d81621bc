//! Excursions from held programs: jogs and retraced paths. The program continues as without them.

#![allow(clippy::expect_used, clippy::panic, reason = "a test may fail")]

use evolvent_counting::calls;
use evolvent_machine::Limits;
use evolvent_motion::{
    DrivenPath, Excursion, ExcursionEnd, Inputs, MotionState, Setpoint, SetpointGenerator, TransferExecutor,
    flags,
};
use evolvent_path::{Axes, PathMode};
use evolvent_transfer::{AxesState, Sync, Transfer};

use crate::common::{BLEND, PLANNERS, Pair, Random, Scenario, campaign, path_error, ratios, scenario};

/// A machine that follows a scenario, as in a served cycle.
struct Machine<'a> {
    scenario: &'a Scenario,
    pair: Pair,
    generator: SetpointGenerator,
    driven: DrivenPath,
    out: Vec<Setpoint>,
}

impl<'a> Machine<'a> {
    fn new(scenario: &'a Scenario) -> Self {
        let mut pair = Pair::new(scenario);
        let generator = SetpointGenerator::new(
            scenario.limits,
            scenario.period_ns,
            scenario.moves[0].curve.start(),
        );
        assert!(generator.attach(&mut pair.motion));
        Self {
            scenario,
            pair,
            generator,
            driven: DrivenPath::new(scenario.period_ns),
            out: Vec::new(),
        }
    }

    /// The program's setpoint, and the published one during an excursion.
    fn step(&mut self, hold: bool, away: Option<&mut Excursion>) -> (Setpoint, Option<ExcursionEnd>) {
        if !hold {
            self.pair.plan_ahead(self.scenario);
        }
        let inputs = Inputs {
            hold,
            ..Inputs::default()
        };
        let plan = self.pair.step(&inputs);
        let Some(away) = away else {
            self.generator.follow(&self.pair.motion, &plan);
            let before = calls();
            self.pair.motion.note_driven(&mut self.driven, &plan, false);
            assert_eq!(calls(), before, "calls of the allocator");
            self.out.push(plan);
            return (plan, None);
        };
        let before = calls();
        let (setpoint, ended) = away.step(&mut self.generator, &mut self.driven, &plan);
        assert_eq!(calls(), before, "calls of the allocator");
        assert_eq!(setpoint.sequence, plan.sequence);
        assert_eq!(
            (setpoint.block, setpoint.actions, setpoint.state),
            (plan.block, plan.actions, plan.state)
        );
        self.out.push(setpoint);
        (setpoint, ended)
    }

    /// Until it is held.
    fn holds(&mut self) {
        while self.pair.motion.state() != MotionState::Held {
            self.step(true, None);
            assert!(self.out.len() < 4_000_000, "no rest");
        }
    }

    /// Until the present motion ends. `Some(n)`: with a stop after `n` setpoints.
    fn follows(&mut self, away: &mut Excursion, stop_after: Option<usize>) -> ExcursionEnd {
        for n in 0..4_000_000 {
            if stop_after == Some(n) {
                away.stop();
                assert!(away.is_stopping());
            }
            let (_, ended) = self.step(true, Some(away));
            if let Some(end) = ended {
                let is_stopped = stop_after.is_some_and(|stop| stop <= n);
                assert_eq!(end == ExcursionEnd::Stopped, is_stopped, "{end:?}");
                drop(away.take_spent());
                return end;
            }
        }
        panic!("no end");
    }

    fn jogs(&mut self, away: &mut Excursion, to: Axes, stop_after: Option<usize>) -> ExcursionEnd {
        let from = AxesState::at_rest(self.generator.position());
        let transfer = Transfer::solve(&self.scenario.limits, &from, &AxesState::at_rest(to), Sync::Time)
            .expect("a way");
        let steered = away.steer(&self.generator, Box::new(TransferExecutor::new(transfer)));
        assert!(steered.is_ok(), "refused");
        self.follows(away, stop_after)
    }

    /// Until the axes are back at the program.
    fn is_back(&mut self, away: &mut Excursion) {
        for _ in 0..10 {
            if away.give_back(&self.generator, &mut self.pair.motion) {
                // The guard uses four positions.
                let rests = self.out.iter().rev().take(4);
                let held = self.pair.motion.next_sequence();
                assert!(rests.clone().count() == 4 && held == self.generator.sequence());
                for setpoint in rests {
                    assert_eq!(setpoint.position.as_slice(), self.generator.position().as_slice());
                }
                return;
            }
            self.step(true, Some(away));
        }
        panic!("not back: {:?}", self.generator.position());
    }

    fn ends(&mut self) {
        while !self.pair.motion.is_over() {
            self.step(false, None);
            assert!(self.out.len() < 4_000_000, "no end");
        }
    }
}

/// The setpoints from the resumption on, without their numbers.
fn tail(out: &[Setpoint], from: usize) -> Vec<Setpoint> {
    out[from..]
        .iter()
        .map(|setpoint| Setpoint {
            sequence: setpoint.sequence - from as u64,
            ..*setpoint
        })
        .collect()
}

/// Whether setpoints are equal to the last bit.
fn is_same(a: &[Setpoint], b: &[Setpoint]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| format!("{a:?}") == format!("{b:?}"))
}

fn random_scenario(random: &mut Random, case: usize) -> Scenario {
    let mode = if case.is_multiple_of(3) {
        PathMode::ExactPath
    } else {
        BLEND
    };
    let mut scenario = Scenario {
        planner: PLANNERS[case % 2],
        ..scenario(random, mode, case.is_multiple_of(5))
    };
    // Only the first moves, so that a run lasts seconds.
    scenario.moves.truncate(8);
    scenario
}

/// A moment at which the program moves, taken from a run without holds.
fn moment(random: &mut Random, scenario: &Scenario) -> usize {
    let mut machine = Machine::new(scenario);
    machine.ends();
    1 + random.pick(machine.out.len() - 1)
}

#[test]
fn a_left_program_continues_bit_for_bit() {
    let (mut random, cases) = campaign(1601, 24);
    let mut left = 0;
    for case in 0..cases {
        let scenario = random_scenario(&mut random, case);
        let moment = moment(&mut random, &scenario);
        let mut plain = Machine::new(&scenario);
        let mut machine = Machine::new(&scenario);
        for one in [&mut plain, &mut machine] {
            while one.out.len() < moment && !one.pair.motion.is_over() {
                one.step(false, None);
            }
        }
        if machine.pair.motion.is_over() {
            continue;
        }
        plain.holds();
        machine.holds();
        let held = machine.generator.position();
        let mut away = Excursion::begin(&machine.pair.motion).expect("it stands");
        left += 1;
        let begin = machine.out.len();
        // Backwards along the path, jogs from there, and all the way back.
        let known = away.blocks_before(&machine.driven);
        if known > 0 && random.unit() < 0.7 {
            let back = 1 + random.pick(known as usize) as u32;
            let before = machine.out.len();
            assert!(away.retrace(&machine.generator, &mut machine.driven, &scenario.limits, back));
            assert!(!away.retrace(&machine.generator, &mut machine.driven, &scenario.limits, back));
            let stop = (random.unit() < 0.3).then(|| random.pick(200));
            let end = machine.follows(&mut away, stop);
            assert!(end == ExcursionEnd::Arrived || stop.is_some());
            let stride = (machine.out.len() - before) / 40 + 1;
            for setpoint in machine.out[before..].iter().step_by(stride) {
                let block = setpoint.line.saturating_sub(1) as usize;
                let error = path_error(
                    &scenario.moves,
                    block.min(scenario.moves.len() - 1),
                    &setpoint.position,
                );
                assert!(
                    error < 0.0201,
                    "case {case}: {error} mm from the path at {setpoint:?}"
                );
            }
        }
        let mut positions = vec![machine.generator.position()];
        for _ in 0..random.pick(4) {
            let mut to = *positions.last().expect("a place");
            to[random.pick(3)] += random.between(-30.0, 30.0);
            let stop = (random.unit() < 0.3).then(|| random.pick(100));
            machine.jogs(&mut away, to, stop);
            positions.push(machine.generator.position());
        }
        assert!(!away.give_back(&machine.generator, &mut machine.pair.motion) || positions.len() == 1);
        if machine.generator.position() != positions[0] {
            assert!(!away.retrace(&machine.generator, &mut machine.driven, &scenario.limits, 0));
            assert!(!away.retrace(&machine.generator, &mut machine.driven, &scenario.limits, 1));
        }
        positions.pop();
        for mut position in positions.into_iter().rev() {
            // Jogs by increments return to within rounding.
            position[0] += random.one_of(&[0.0, 1e-12, -3e-10]);
            machine.jogs(&mut away, position, None);
        }
        if away.is_retraced() {
            assert!(away.retrace(&machine.generator, &mut machine.driven, &scenario.limits, 0));
            assert_eq!(machine.follows(&mut away, None), ExcursionEnd::Arrived);
        }
        machine.is_back(&mut away);
        assert_eq!(machine.generator.position().as_slice(), held.as_slice());
        let resumed = machine.out.len();
        // The other machine is held for the same time.
        while plain.out.len() < resumed {
            plain.step(true, None);
        }
        plain.ends();
        machine.ends();
        assert!(
            is_same(&tail(&plain.out, resumed), &tail(&machine.out, resumed)),
            "case {case}: other setpoints behind the excursion from {begin} to {resumed}"
        );
        assert_eq!(machine.pair.motion.fault(), None, "case {case}");
        let [v, a, j] = ratios(&scenario, &machine.out);
        assert!(v <= 1.001 && a <= 1.001 && j <= 1.02, "case {case}: {v} {a} {j}");
        // The guard of the program has also seen the excursion.
        let fastest = |axis: usize| {
            let moved = |pair: &[Setpoint]| (pair[1].position[axis] - pair[0].position[axis]).abs();
            machine.out.windows(2).map(moved).fold(0.0, f64::max) / (1e-9 * scenario.period_ns as f64)
        };
        for axis in 0..3 {
            let measured = machine.pair.motion.extremes().velocity[axis];
            assert!(
                (measured - fastest(axis)).abs() < 1e-6 * (1.0 + measured),
                "case {case}: {measured}"
            );
        }
    }
    assert!(left * 2 > cases, "{left} of {cases} prove nothing");
}

/// Backwards and forwards again along paths in exact-path mode, where the path itself is known.
#[test]
fn the_path_driven_backwards_is_the_driven_path() {
    let (mut random, cases) = campaign(1602, 8);
    let (mut max, mut count, mut fraction) = (0.0_f64, 0, 0.0_f64);
    for case in 0..cases {
        let scenario = random_scenario(&mut random, 3 * case);
        let moment = moment(&mut random, &scenario);
        let mut machine = Machine::new(&scenario);
        while machine.out.len() < moment && !machine.pair.motion.is_over() {
            machine.step(false, None);
        }
        if machine.pair.motion.is_over() {
            continue;
        }
        machine.holds();
        let Some(mut away) = Excursion::begin(&machine.pair.motion) else {
            continue;
        };
        let known = away.blocks_before(&machine.driven);
        if known == 0 {
            continue;
        }
        let before = machine.out.len();
        assert!(away.retrace(&machine.generator, &mut machine.driven, &scenario.limits, known));
        assert!(!away.is_retraced());
        assert_eq!(machine.follows(&mut away, None), ExcursionEnd::Arrived);
        assert_eq!(away.blocks_before(&machine.driven), 0);
        assert!(!away.retrace(&machine.generator, &mut machine.driven, &scenario.limits, 1));
        assert!(away.retrace(&machine.generator, &mut machine.driven, &scenario.limits, 0));
        assert_eq!(machine.follows(&mut away, None), ExcursionEnd::Arrived);
        machine.is_back(&mut away);
        let stride = (machine.out.len() - before) / 200 + 1;
        for (n, setpoint) in machine.out[before..].iter().enumerate().step_by(stride) {
            let near_joint = (n.saturating_sub(3)..n + 3)
                .filter_map(|k| machine.out.get(before + k))
                .any(|setpoint| setpoint.flags & flags::JOINT != 0);
            if near_joint {
                continue;
            }
            let block = setpoint.line.saturating_sub(1) as usize;
            let error = path_error(&scenario.moves, block, &setpoint.position);
            let jerk = scenario.limits.jerk;
            let jerk = jerk.iter().take(3).map(|j| j * j).sum::<f64>().sqrt();
            let apart_s = 1e-9 * scenario.period_ns.max(1_000_000) as f64;
            // The derived error of the quintics, plus the error of the nearest point on the path.
            let bound = 1.02 * jerk * apart_s.powi(3) / 161.0 + 1e-8;
            (max, count, fraction) = (max.max(error), count + 1, fraction.max(error / bound));
        }
        let [v, a, j] = ratios(&scenario, &machine.out);
        assert!(v <= 1.001 && a <= 1.001 && j <= 1.02, "case {case}: {v} {a} {j}");
    }
    println!("{count} positions within {max:.2e} mm of the path, {fraction:.2} of the bound");
    assert!(
        count > 500 && fraction <= 1.0,
        "{count} positions, {fraction} of the bound, {max} mm"
    );
}

fn two_lines(limits: Limits) -> Scenario {
    let mut random = Random::from_state(7);
    let mut scenario = random_scenario(&mut random, 1);
    scenario.limits = limits;
    scenario.period_ns = 1_000_000;
    scenario
}

#[test]
fn a_moving_program_is_not_left_and_actions_bar_it() {
    let scenario = two_lines(crate::common::equal_axes(100.0, 1000.0, 20_000.0));
    let mut machine = Machine::new(&scenario);
    for _ in 0..60 {
        machine.step(false, None);
        let at_rest = machine.pair.motion.state() != MotionState::Running;
        assert!(Excursion::begin(&machine.pair.motion).is_none() || at_rest);
    }
    // An output that is safe in a feed hold does not clear the stored path; an output of the program does.
    machine.holds();
    let last = *machine.out.last().expect("setpoints");
    machine.pair.motion.note_driven(&mut machine.driven, &last, true);
    assert!(machine.driven.blocks_driven() > 0);
    let running = Setpoint {
        state: MotionState::Running,
        block: last.block + 1,
        ..last
    };
    machine
        .pair
        .motion
        .note_driven(&mut machine.driven, &running, true);
    // The stored path begins with the barred motion: no block start precedes it.
    assert_eq!(machine.driven.blocks_driven(), 0);
    let mut away = Excursion::begin(&machine.pair.motion).expect("it stands");
    assert!(!away.retrace(&machine.generator, &mut machine.driven, &scenario.limits, 1));
    assert!(!away.is_moving());
    // A transfer that begins elsewhere is returned.
    let there = AxesState::at_rest(machine.generator.position() + Axes::repeat(0.01));
    let here = AxesState::at_rest(machine.generator.position());
    let wrong = Transfer::solve(&scenario.limits, &there, &here, Sync::Time).expect("a way");
    assert!(
        away.steer(&machine.generator, Box::new(TransferExecutor::new(wrong)))
            .is_err()
    );
    machine.is_back(&mut away);
}

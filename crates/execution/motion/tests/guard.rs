//! Limits of the published positions in all cases: requested stops, and plans that the guard rejects.

#![allow(clippy::expect_used, reason = "a test may fail")]

use evolvent_machine::PlannerKind;
use evolvent_motion::{
    Inputs, PathExecutor, PlanConsumer, PlanProducer, PlannerLag, QueueClosed, Setpoint, flags, plan_queue,
};
use evolvent_planner::{PathLimits, PathRules, PlanSink, Planner, Step};
use evolvent_timing::TimeLaw;

use crate::common::{
    BLEND, Pair, Random, Scenario, campaign, check, equal_axes, forward_to_sink, program, ratios, run,
};

const RATES: [f64; 3] = [1000.0, 4000.0, 35_000.0];

/// A random program of lines, arcs and involutes, short enough for its rate.
fn scenario(random: &mut Random, rate: f64) -> Scenario {
    loop {
        let scenario = Scenario {
            limits: equal_axes(200.0, 2000.0, 50_000.0),
            period_ns: (1e9 / rate) as u64,
            moves: program(random, BLEND, false),
            chord_error_mm: 1e-2,
            planner: PlannerKind::Optimal,
        };
        let seconds: f64 = scenario
            .moves
            .iter()
            .map(|one| one.curve.length() / one.feed_mm_s.min(100.0))
            .sum();
        if seconds * rate < 1.5e5 && seconds > 0.2 {
            return scenario;
        }
    }
}

#[test]
fn stops_keep_every_limit_however_the_planner_answers() {
    let (mut random, cases) = campaign(0x1401_0010, 9);
    let mut max = [0.0_f64; 3];
    for case in 0..cases {
        let scenario = scenario(&mut random, RATES[case % 3]);
        let (plain, _) = run(&scenario, |_| Inputs::default());
        for trial in 0..6 {
            // Absent from the stop to rest, refused, or in time.
            let (absent, refused) = (trial % 3 == 0, trial % 3 == 1);
            let moment = 1 + random.pick(plain.len() - 2);
            let until = moment + 1 + random.pick(plain.len());
            let lowered = if random.unit() < 0.4 {
                random.between(0.05, 0.95)
            } else {
                0.0
            };
            let what = format!("case {case}, trial {trial}, {lowered} from {moment} to {until}");
            let mut pair = Pair::new(&scenario);
            let mut out: Vec<Setpoint> = Vec::new();
            while !pair.motion.is_over() {
                let stopping = (moment..until).contains(&out.len());
                if !(absent && stopping) {
                    pair.plan_ahead(&scenario);
                }
                let inputs = Inputs {
                    hold: stopping && lowered == 0.0,
                    feed_override: if stopping && lowered > 0.0 { lowered } else { 1.0 },
                    ..Inputs::default()
                };
                let lag = PlannerLag {
                    refused: refused && stopping,
                    ..PlannerLag::default()
                };
                out.push(pair.motion.replay_step(&inputs, &mut pair.queue, lag));
                assert!(out.len() < 2_000_000, "{what}: does not end");
            }
            check(&scenario, &out, &pair.motion, 0.02, &what);
            for (max, ratio) in max.iter_mut().zip(ratios(&scenario, &out)) {
                *max = max.max(ratio);
            }
        }
    }
    println!("worst ratios of velocity, acceleration, jerk: {max:.5?}");
}

/// Passes a plan on with one piece falsified.
struct Falsifier<W> {
    sink: PlanProducer<W>,
    steps: usize,
    /// Number of the piece, the step of acceleration, and the factor of its change.
    at: usize,
    step: f64,
    factor: f64,
}

impl<W: FnMut() -> bool> PlanSink for Falsifier<W> {
    type Error = QueueClosed;

    forward_to_sink!(segment exit commit mark leave_open reserve_link link has_capacity wait request reply acknowledged withdrawn reached reached_step);

    fn step(&mut self, step: &Step) -> Result<(), QueueClosed> {
        let mut step = *step;
        if let Step::TimedSegment(flow) = &mut step {
            self.steps += 1;
            if self.steps == self.at {
                match &mut flow.piece.law {
                    TimeLaw::LinearAcceleration { b, c, .. } => (*b, *c) = (*b + self.step, *c * self.factor),
                    TimeLaw::ConstantJerk { a, j, .. } => (*a, *j) = (*a + self.step, *j * self.factor),
                }
            }
        }
        self.sink.step(&step)
    }
}

/// Drives a falsified plan to its end, with a hold from the setpoint `hold_from` on.
fn drive(
    scenario: &Scenario,
    (at, step, factor): (usize, f64, f64),
    hold_from: usize,
) -> (Vec<Setpoint>, PathExecutor) {
    let (sink, queue): (_, PlanConsumer) = plan_queue(|| false);
    let mut queue = queue;
    let sink = Falsifier {
        sink,
        steps: 0,
        at,
        step,
        factor,
    };
    let rules = PathRules {
        blend_tolerance_mm: 0.01,
        joint_time_s: 0.001,
        planner: scenario.planner,
        feed_override: 1.0,
    };
    let limits = PathLimits::new(
        scenario.limits,
        1e9 / scenario.period_ns as f64,
        scenario.chord_error_mm,
    );
    let mut planner = Planner::new(limits, rules, sink);
    let mut motion = scenario.motion();
    let (mut out, mut fed) = (Vec::new(), 0);
    while !motion.is_over() {
        let inputs = Inputs {
            hold: out.len() >= hold_from,
            ..Inputs::default()
        };
        if inputs.hold && out.len() > hold_from + 2 && motion.is_at_rest() {
            break;
        }
        let mut tries = 0;
        while !motion.is_ready(&mut queue) && tries < 2000 {
            if let Some(one) = scenario.moves.get(fed) {
                planner.push(one, fed as u32 + 1, fed as u32).expect("plan");
            } else if fed == scenario.moves.len() {
                planner.finish(9999).expect("finish");
            }
            fed += 1;
            tries += 1;
            let _full = planner.poll();
        }
        out.push(motion.step(&inputs, &mut queue));
        assert!(out.len() < 2_000_000, "does not end");
    }
    (out, motion)
}

#[test]
fn published_setpoints_keep_limits_on_guard_stops() {
    let (mut random, cases) = campaign(0x1401_0011, 60);
    let (mut max, mut provoked) = ([0.0_f64; 3], 0);
    for case in 0..cases {
        let scenario = scenario(&mut random, RATES[case % 3]);
        let at = 1 + random.pick(80);
        let sign = if random.unit() < 0.5 { -1.0 } else { 1.0 };
        let (step, factor) = match random.pick(3) {
            0 => (sign * random.log(20.0, 5000.0), 1.0),
            1 => (0.0, sign * random.log(1.1, 50.0)),
            _ => (sign * random.log(1.0, 500.0), random.log(0.1, 10.0)),
        };
        let (out, motion) = drive(&scenario, (at, step, factor), usize::MAX);
        if motion.fault().is_none() {
            continue;
        }
        provoked += 1;
        let [v, a, j] = ratios(&scenario, &out);
        for (max, ratio) in max.iter_mut().zip([v, a, j]) {
            *max = max.max(ratio);
        }
        let what = format!(
            "case {case} at {} Hz: piece {at}, {step}, {factor}: {v} {a} {j}, {:?}",
            RATES[case % 3],
            motion.fault()
        );
        assert!(out.iter().any(|setpoint| setpoint.flags & flags::GUARD != 0));
        // The speed exceeds its limit while the acceleration at the rejection is reduced: by at most a^2 / (2
        // J).
        let overshoot = 2000.0 * 2000.0 / (2.0 * 50_000.0) / 200.0;
        assert!(v <= 1.001 * (1.0 + overshoot), "{what}");
        assert!(a <= 1.002, "{what}");
        assert!(j <= 1.021, "{what}");
    }
    assert!(provoked > cases / 4, "{provoked} of {cases} provoked the guard");
    println!("{provoked} of {cases}, worst ratios of velocity, acceleration, jerk: {max:.5?}");
}

/// The guard rejects a piece while a hold slows the plan down.
#[test]
fn guard_stops_in_a_hold_keep_limits() {
    let (mut random, cases) = campaign(0x1401_0012, 60);
    let (mut max, mut provoked) = ([0.0_f64; 3], 0);
    for case in 0..cases {
        let rate = [250.0, 1000.0, 4000.0][case % 3];
        let scenario = scenario(&mut random, rate);
        let at = 1 + random.pick(80);
        let sign = if random.unit() < 0.5 { -1.0 } else { 1.0 };
        let falsified = match random.pick(3) {
            0 => (at, sign * random.log(20.0, 2000.0), 1.0),
            1 => (at, 0.0, sign * random.log(1.1, 50.0)),
            _ => (at, sign * random.log(1.0, 100.0), random.log(0.1, 10.0)),
        };
        let rejection = |out: &[Setpoint]| out.iter().position(|setpoint| setpoint.flags & flags::GUARD != 0);
        // The hold begins up to 40 ms before the piece is reached.
        let Some(undisturbed) = rejection(&drive(&scenario, falsified, usize::MAX).0) else {
            continue;
        };
        let hold_from = undisturbed.saturating_sub(1 + random.pick((0.04 * rate) as usize));
        let (out, motion) = drive(&scenario, falsified, hold_from);
        if rejection(&out).is_none_or(|first| first <= hold_from + 1) {
            continue;
        }
        provoked += 1;
        let [v, a, j] = ratios(&scenario, &out);
        for (max, ratio) in max.iter_mut().zip([v, a, j]) {
            *max = max.max(ratio);
        }
        let what = format!(
            "case {case} at {rate} Hz: {falsified:?}: {v} {a} {j}, {:?}",
            motion.fault()
        );
        assert!(a <= 1.002 && j <= 1.021, "{what}");
    }
    println!("{provoked} of {cases}, worst ratios {max:.5?}");
    assert!(provoked > cases / 20, "{provoked} of {cases} provoked the guard");
}

//! Answers that come too late: the cycle has dropped them, and the planner has to notice.

#![allow(clippy::expect_used, reason = "a test may fail")]

mod common;

use common::{BLEND, Scenario, check};
use evolvent_gcode::{Move, MoveKind};
use evolvent_machine::{Limits, PlannerKind};
use evolvent_motion::{Inputs, PlanProducer, QueueClosed, Setpoint, State, plan_queue};
use evolvent_path::{AXES, Axes, Curve, Line};
use evolvent_plan::{
    Answer, BlockMark, ExitSpeeds, PathLimits, PathRules, PlanSink, Planner, Request, Segment, Step,
};

/// Loses so many answers: the same to the cycle as if they came too late.
struct Losing<S> {
    sink: S,
    left: u32,
}

impl<S: PlanSink<Error = QueueClosed>> PlanSink for Losing<S> {
    type Error = QueueClosed;

    fn segment(&mut self, segment: &Segment) -> Result<(), QueueClosed> {
        self.sink.segment(segment)
    }

    fn step(&mut self, step: &Step) -> Result<(), QueueClosed> {
        self.sink.step(step)
    }

    fn exit(&mut self, index: u64, speeds: ExitSpeeds) {
        self.sink.exit(index, speeds);
    }

    fn finalise(&mut self, count: u64) {
        self.sink.finalise(count);
    }

    fn mark(&mut self, mark: &BlockMark) -> Result<(), QueueClosed> {
        self.sink.mark(mark)
    }

    fn link(&mut self, from: u64, to: u64) -> bool {
        self.sink.link(from, to)
    }

    fn has_room(&self, steps: usize, segments: usize, marks: usize) -> bool {
        self.sink.has_room(steps, segments, marks)
    }

    fn wait(&mut self) -> Result<(), QueueClosed> {
        self.sink.wait()
    }

    fn request(&mut self) -> Option<Request> {
        self.sink.request()
    }

    fn answer(&mut self, answer: Answer) {
        match self.left.checked_sub(1) {
            Some(left) => self.left = left,
            None => self.sink.answer(answer),
        }
    }

    fn taken(&self) -> u64 {
        self.sink.taken()
    }

    fn reached(&self) -> u64 {
        self.sink.reached()
    }
}

/// A wave in chords of 0.1 mm.
fn wave(blocks: usize) -> Scenario {
    let at = |k: usize| {
        let s = 0.1 * k as f64;
        let mut point = Axes::zeros();
        (point[0], point[1]) = (s, 4.0 * (0.2 * s).sin() + (0.9 * s).cos());
        point
    };
    let moves = (0..blocks)
        .map(|k| Move {
            curve: Curve::Line(Line::new(at(k), at(k + 1)).expect("line")),
            kind: MoveKind::Feed,
            feed: 20.0,
            path_mode: BLEND,
        })
        .collect();
    Scenario {
        limits: Limits {
            present: [true; AXES],
            velocity: Axes::repeat(250.0),
            acceleration: Axes::repeat(2000.0),
            jerk: Axes::repeat(50_000.0),
            travel_min: Axes::repeat(-1e5),
            travel_max: Axes::repeat(1e5),
            home: Axes::zeros(),
        },
        period_ns: 1_000_000,
        moves,
        chord_error_mm: 1e-3,
        planner: PlannerKind::Optimal,
    }
}

/// Drives the wave while the first `lost` answers get lost.
fn drive(lost: u32, inputs: impl Fn(u64) -> Inputs) -> Vec<Setpoint> {
    let scenario = wave(700);
    let (producer, mut queue): (PlanProducer<fn() -> bool>, _) = plan_queue(|| false);
    let rules = PathRules {
        blend_tolerance_mm: 0.01,
        joint_time_s: 0.001,
        planner: PlannerKind::Optimal,
        feed_override: 1.0,
    };
    let sink = Losing {
        sink: producer,
        left: lost,
    };
    let mut planner = Planner::new(PathLimits::new(scenario.limits, 1000.0, 1e-3), rules, sink);
    for (i, one) in scenario.moves.iter().enumerate() {
        planner.push(one, i as u32 + 1, i as u32).expect("plan");
    }
    planner.finish(9999).expect("plan");
    let mut motion = scenario.motion();
    let mut setpoints: Vec<Setpoint> = Vec::new();
    while !motion.is_over() {
        planner.poll().expect("plan");
        setpoints.push(motion.step(&inputs(setpoints.len() as u64), &mut queue));
        assert!(setpoints.len() < 100_000, "does not end");
    }
    check(&scenario, &setpoints, &motion, 0.02, "late");
    assert_eq!(motion.state(), State::Done);
    setpoints
}

#[test]
fn a_wish_whose_first_answers_come_too_late_is_met_by_a_later_one() {
    for lost in [1, 2] {
        for factor in [0.5, 1.5] {
            let setpoints = drive(lost, |cycle| Inputs {
                feed_override: if cycle >= 700 { factor } else { 1.0 },
                ..Inputs::default()
            });
            let feed = setpoints[1000].feed_mm_s;
            let wanted = 20.0 * factor;
            assert!(
                (feed - wanted).abs() < 0.05 * wanted,
                "{lost} lost, {factor}: {feed} mm/s"
            );
        }
        let setpoints = drive(lost, |cycle| Inputs {
            hold: (700..1000).contains(&cycle),
            ..Inputs::default()
        });
        assert_eq!(setpoints[900].state, State::Held);
    }
}

#[test]
fn a_wish_withdrawn_before_its_late_answer_leaves_a_planner_that_meets_the_next() {
    let setpoints = drive(1, |cycle| Inputs {
        feed_override: if (700..705).contains(&cycle) || cycle >= 1500 {
            0.5
        } else {
            1.0
        },
        ..Inputs::default()
    });
    for (cycle, wanted) in [(1400, 20.0), (1800, 10.0)] {
        let feed = setpoints[cycle].feed_mm_s;
        assert!((feed - wanted).abs() < 0.05 * wanted, "{feed} mm/s at {cycle}");
    }
}

#[test]
fn overrides_that_were_not_met_make_no_hold_slower() {
    let hold = 745;
    let cycles_to_rest = |lost: u32| {
        let setpoints = drive(lost, |cycle| Inputs {
            feed_override: if cycle >= 700 { 0.9 } else { 1.0 },
            hold: (hold..2500).contains(&cycle),
            ..Inputs::default()
        });
        let rest = (hold as usize..setpoints.len()).find(|&k| setpoints[k].state == State::Held);
        rest.expect("comes to rest") - hold as usize
    };
    // Two leads at most: the override's request is still open when the hold comes.
    let (met, lost) = (cycles_to_rest(0), cycles_to_rest(4));
    assert!(lost <= met + 20, "{lost} cycles, {met} where overrides were met");
}

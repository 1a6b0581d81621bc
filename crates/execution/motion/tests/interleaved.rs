//! Cycles that run while the planner is working, as in real time, and the same run replayed.

#![allow(clippy::expect_used, reason = "a test may fail")]

use std::cell::RefCell;
use std::rc::Rc;

use evolvent_machine::PlannerKind;
use evolvent_motion::{
    Inputs, PathExecutor, PlanConsumer, PlanProducer, PlannerLag, QueueClosed, Setpoint, plan_queue,
};
use evolvent_path::PathMode;
use evolvent_planner::{PlanSink, ReplanReply, Segment, Step};

use crate::common::{Random, Scenario, campaign, forward_to_sink, scenario};

/// Maximum number of changes of the override at one rest; after them the axes can move again.
const MAX_CHANGES: u32 = 12;
/// Probability of a cycle between a reply and the plan that follows it.
const AFTER_REPLY: f64 = 0.5;
/// Probability of a cycle between two parts of a plan, which has hundreds.
const WITHIN_PLAN: f64 = 0.02;

/// The record of one cycle in a trace.
struct Recorded {
    inputs: Inputs,
    lag: PlannerLag,
    setpoint: Setpoint,
}

/// The cycle's side of a run.
struct Cycles {
    motion: PathExecutor,
    queue: PlanConsumer,
    random: Random,
    feed_override: f64,
    changes_left: u32,
    done: Vec<Recorded>,
    /// The run that is replayed; `None` in real time.
    replayed: Option<Vec<Recorded>>,
}

impl Cycles {
    fn step(&mut self) {
        if self.motion.is_over() {
            return;
        }
        let (inputs, lag) = match &self.replayed {
            None => (self.live_inputs(), PlannerLag::default()),
            Some(recorded) => {
                let one = &recorded[self.done.len()];
                (one.inputs, one.lag)
            }
        };
        let setpoint = self.motion.replay_step(&inputs, &mut self.queue, lag);
        if let Some(recorded) = &self.replayed {
            assert_eq!(setpoint, recorded[self.done.len()].setpoint);
        }
        self.done.push(Recorded {
            inputs,
            lag: self.motion.planner_lag(),
            setpoint,
        });
        assert!(self.done.len() < 1_000_000, "does not end");
    }

    /// The override changes only at rest; `slow_planner.rs` changes it in motion.
    fn live_inputs(&mut self) -> Inputs {
        if !self.motion.is_at_rest() {
            self.changes_left = MAX_CHANGES;
        } else if self.changes_left > 0 && self.random.unit() < 0.4 {
            self.changes_left -= 1;
            self.feed_override = self.random.between(0.2, 2.0);
        }
        Inputs {
            feed_override: self.feed_override,
            ..Inputs::default()
        }
    }

    /// A cycle during the planner's work. In real time only at rest; `slow_planner.rs` has cycles in motion.
    fn interrupt(&mut self, probability: f64) {
        let may_step = match self.replayed {
            None => self.motion.is_at_rest(),
            Some(_) => self.motion.is_ready(&mut self.queue),
        };
        if may_step && self.random.unit() < probability {
            self.step();
        }
    }
}

/// Lets cycles run between any two outputs of the planner.
struct Interrupted {
    sink: PlanProducer<fn() -> bool>,
    cycles: Rc<RefCell<Cycles>>,
}

impl Interrupted {
    fn interrupt(&self, probability: f64) {
        self.cycles.borrow_mut().interrupt(probability);
    }
}

impl PlanSink for Interrupted {
    type Error = QueueClosed;

    forward_to_sink!(exit mark leave_open has_capacity wait request acknowledged withdrawn reached reached_step);

    fn segment(&mut self, segment: &Segment) -> Result<(), QueueClosed> {
        self.sink.segment(segment)?;
        self.interrupt(WITHIN_PLAN);
        Ok(())
    }

    fn step(&mut self, step: &Step) -> Result<(), QueueClosed> {
        self.sink.step(step)?;
        self.interrupt(WITHIN_PLAN);
        Ok(())
    }

    fn reserve_link(&mut self) -> Result<(), QueueClosed> {
        self.sink.reserve_link()?;
        self.interrupt(WITHIN_PLAN);
        Ok(())
    }

    fn commit(&mut self, count: u64) {
        self.sink.commit(count);
        self.interrupt(WITHIN_PLAN);
    }

    fn link(&mut self, from: u64, to: u64) -> bool {
        let linked = self.sink.link(from, to);
        self.interrupt(WITHIN_PLAN);
        linked
    }

    fn reply(&mut self, reply: ReplanReply) {
        self.sink.reply(reply);
        self.interrupt(AFTER_REPLY);
    }
}

/// Drives the program, or replays it, with a planner that is interrupted at random.
fn drive(scenario: &Scenario, random: Random, replayed: Option<Vec<Recorded>>) -> Vec<Recorded> {
    let (sink, queue): (PlanProducer<fn() -> bool>, _) = plan_queue(|| false);
    let is_replay = replayed.is_some();
    let cycles = Rc::new(RefCell::new(Cycles {
        motion: scenario.motion(),
        queue,
        random,
        feed_override: 1.0,
        changes_left: MAX_CHANGES,
        done: Vec::new(),
        replayed,
    }));
    let period_s = scenario.period_ns as f64 * 1e-9;
    let sink = Interrupted {
        sink,
        cycles: Rc::clone(&cycles),
    };
    let mut planner = scenario.planner(1.0, sink);
    for (number, one) in scenario.moves.iter().enumerate() {
        planner.push(one, number as u32 + 1, number as u32).expect("plan");
        let dwell = Step::Dwell {
            seconds: 2.5 * period_s,
            line: number as u32 + 1,
        };
        planner.rest(&dwell).expect("plan");
    }
    planner.finish(9999).expect("plan");
    while !cycles.borrow().motion.is_over() {
        planner.poll().expect("plan");
        let mut cycles = cycles.borrow_mut();
        let Cycles { motion, queue, .. } = &mut *cycles;
        if !is_replay || motion.is_ready(queue) {
            cycles.step();
        }
    }
    std::mem::take(&mut cycles.borrow_mut().done)
}

#[test]
fn motion_during_planning_is_replayed_bit_for_bit() {
    let (mut random, cases) = campaign(0x1e71_0001, 8);
    let (mut waits, mut changes) = (0, 0);
    for case in 0..cases {
        let mut scenario = scenario(&mut random, PathMode::ExactPath, false);
        scenario.planner = PlannerKind::Optimal;
        scenario.moves.truncate(12);
        let mut seed = || Random::from_state(random.pick(1 << 30) as u64);
        let (driving, replaying) = (seed(), seed());
        let recorded = drive(&scenario, driving, None);
        waits += recorded
            .iter()
            .filter(|one| one.lag.failed_lookup.is_some())
            .count();
        changes += recorded
            .windows(2)
            .filter(|pair| pair[0].inputs.feed_override != pair[1].inputs.feed_override)
            .count();
        let cycles = recorded.len();
        let replayed = drive(&scenario, replaying, Some(recorded));
        assert_eq!(cycles, replayed.len(), "case {case}");
    }
    assert!(waits > 100 && changes > 100, "{waits} waits, {changes} overrides");
}

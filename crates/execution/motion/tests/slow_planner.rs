//! A planner that is as slow as on a busy host: cycles run while it solves a window.

#![allow(clippy::expect_used, reason = "a test may fail")]

use std::cell::RefCell;
use std::rc::Rc;

use evolvent_motion::{
    Inputs, MotionState, PathExecutor, PlanConsumer, PlanProducer, PlannerLag, QueueClosed, Setpoint, flags,
    plan_queue,
};
use evolvent_planner::{PlanSink, ReplanReply, Step};

use crate::common::{Random, Scenario, WAVE_FEED_MM_S, check, forward_to_sink, wave};

/// The cycle at which the override starts to change.
const BEGINS: u64 = 500;
/// Minimum fraction of the feed: the plan itself has less than 0.9 of it at one position, even with a planner
/// that is never late.
const MIN_FRACTION: f64 = 0.88;
/// Maximum number of cycles per window on a busy host: too late for every request, and so late that the cycle
/// drives tails.
const LATE: usize = 50;
const STARVING: usize = 1000;
/// Maximum number of cycles of the virtual clock between two outputs of the planner: one request may follow
/// another's reply at once.
const MEANWHILE: usize = 40;
/// Number of blocks of the wave between two positions with rest steps.
const BLOCKS_TO_REST: usize = 60;
/// Number of rest steps at one position.
const RESTS: usize = 7;

/// The lag that a cycle met, and its setpoint.
#[derive(Clone, Debug)]
struct Recorded {
    inputs: Inputs,
    lag: PlannerLag,
    setpoint: Setpoint,
}

/// The cycle, called by the planner.
struct Cycles {
    motion: PathExecutor,
    queue: PlanConsumer,
    feed_override: fn(u64) -> f64,
    done: Vec<Recorded>,
    /// The recorded run, if this is a replay.
    replayed: Option<Vec<Recorded>>,
}

impl Cycles {
    /// As with the virtual clock.
    fn step_if_ready(&mut self) -> bool {
        let is_ready = self.motion.is_ready(&mut self.queue);
        if is_ready {
            self.step();
        }
        is_ready
    }

    fn run_while_ready(&mut self) {
        for _ in 0..MEANWHILE {
            self.step_if_ready();
        }
    }

    fn step(&mut self) {
        if self.motion.is_over() {
            return;
        }
        let sequence = self.done.len();
        let (inputs, lag) = match &self.replayed {
            Some(recorded) => (recorded[sequence].inputs, recorded[sequence].lag),
            None => {
                let inputs = Inputs {
                    feed_override: (self.feed_override)(sequence as u64),
                    ..Inputs::default()
                };
                (inputs, PlannerLag::default())
            }
        };
        let setpoint = self.motion.replay_step(&inputs, &mut self.queue, lag);
        if let Some(recorded) = &self.replayed {
            assert_eq!(setpoint, recorded[sequence].setpoint, "replayed cycle {sequence}");
        }
        let lag = self.motion.planner_lag();
        self.done.push(Recorded {
            inputs,
            lag,
            setpoint,
        });
        assert!(self.done.len() < 100_000, "does not end");
    }
}

/// Lets cycles run while a window is solved.
struct Slow {
    sink: PlanProducer<fn() -> bool>,
    cycles: Rc<RefCell<Cycles>>,
    /// Draws the number of cycles that run meanwhile; `None` in a replay, in which the clock is virtual and
    /// waits for the planner.
    random: Option<Random>,
    /// Maximum number of cycles on a busy host.
    longest: usize,
    /// The host is busy with other work.
    is_busy: bool,
}

impl PlanSink for Slow {
    type Error = QueueClosed;

    forward_to_sink!(segment exit commit mark leave_open reserve_link link has_capacity wait request acknowledged withdrawn reached reached_step);

    /// The interpreter may need as long for the block after a rest step as the planner for a window.
    fn step(&mut self, step: &Step) -> Result<(), QueueClosed> {
        self.sink.step(step)?;
        let mut cycles = self.cycles.borrow_mut();
        let Some(random) = &mut self.random else {
            cycles.run_while_ready();
            return Ok(());
        };
        let is_rest = !matches!(step, Step::TimedSegment(_));
        if is_rest && !cycles.done.is_empty() && random.pick(3) == 0 {
            for _ in 0..random.pick(self.longest) {
                cycles.step();
            }
        }
        Ok(())
    }

    /// On a quiet host a window takes most of the lead of a request, on a busy one several leads.
    fn solved(&mut self, _steps: u32) {
        let mut cycles = self.cycles.borrow_mut();
        let Some(random) = &mut self.random else {
            cycles.run_while_ready();
            return;
        };
        if random.pick(10) == 0 {
            self.is_busy = !self.is_busy;
        }
        let count = if cycles.done.is_empty() {
            0
        } else if self.is_busy {
            20 + random.pick(self.longest - 20)
        } else {
            6
        };
        for _ in 0..count {
            cycles.step();
        }
    }

    fn reply(&mut self, reply: ReplanReply) {
        self.sink.reply(reply);
        if self.random.is_none() {
            self.cycles.borrow_mut().run_while_ready();
        }
    }
}

/// The program: moves, with one of these chains of rest steps after every [`BLOCKS_TO_REST`] blocks.
struct Program {
    scenario: Scenario,
    rests: Vec<Vec<Step>>,
}

impl Program {
    fn of(scenario: Scenario) -> Self {
        Self {
            scenario,
            rests: Vec::new(),
        }
    }
}

/// Drives a program with a slow planner, or replays the run.
fn drive(
    program: &Program,
    feed_override: fn(u64) -> f64,
    random: Option<Random>,
    longest: usize,
    replayed: Option<Vec<Recorded>>,
) -> Vec<Recorded> {
    let Program { scenario, rests } = program;
    let is_replay = replayed.is_some();
    let (sink, queue): (PlanProducer<fn() -> bool>, _) = plan_queue(|| false);
    let cycles = Rc::new(RefCell::new(Cycles {
        motion: scenario.motion(),
        queue,
        feed_override,
        done: Vec::new(),
        replayed,
    }));
    let sink = Slow {
        sink,
        cycles: Rc::clone(&cycles),
        random,
        longest,
        is_busy: false,
    };
    let mut planner = scenario.planner(1.0, sink);
    for (number, one) in scenario.moves.iter().enumerate() {
        planner.push(one, number as u32 + 1, number as u32).expect("plan");
        if number % BLOCKS_TO_REST == BLOCKS_TO_REST - 1 && !rests.is_empty() {
            for step in &rests[number / BLOCKS_TO_REST % rests.len()] {
                planner.rest(step).expect("plan");
            }
        }
    }
    planner.finish(9999).expect("plan");
    let mut waits = 0;
    while !cycles.borrow().motion.is_over() {
        planner.poll().expect("plan");
        let mut cycles = cycles.borrow_mut();
        if !is_replay {
            cycles.step();
        } else if cycles.step_if_ready() {
            waits = 0;
        } else {
            waits += 1;
            assert!(
                waits < 1000,
                "cycle {} and the planner wait for each other",
                cycles.done.len()
            );
        }
    }
    let done = std::mem::take(&mut cycles.borrow_mut().done);
    let setpoints: Vec<Setpoint> = done.iter().map(|one| one.setpoint).collect();
    check(scenario, &setpoints, &cycles.borrow().motion, 0.02, "the wave");
    assert_eq!(cycles.borrow().motion.state(), MotionState::Done);
    done
}

/// An override that is multiplied by `factor` every `every` cycles, down to 0.2.
fn falling(cycle: u64, factor: f64, every: u64) -> f64 {
    factor
        .powi((cycle.saturating_sub(BEGINS) / every) as i32)
        .max(0.2)
}

/// Overrides that fall continuously, as the ramp of a spindle makes them.
const FALLING: [fn(u64) -> f64; 5] = [
    |cycle| falling(cycle, 0.995, 3),
    |cycle| falling(cycle, 0.988, 9),
    |cycle| falling(cycle, 0.988, 14),
    |cycle| falling(cycle, 0.97, 30),
    |cycle| falling(cycle, 0.9, 70),
];

/// A lower override needs no planner: the plan is driven more slowly, and the planner continues it whatever
/// becomes of the requests meanwhile.
#[test]
fn a_falling_override_is_followed_with_a_late_planner() {
    let mut late = 0;
    let program = Program::of(wave(500));
    for (number, feed_override) in FALLING.into_iter().enumerate() {
        for seed in 1..20 {
            let recorded = drive(
                &program,
                feed_override,
                Some(Random::from_state(seed)),
                LATE,
                None,
            );
            late += recorded.iter().filter(|one| one.lag.refused).count();
            let ends = recorded.len() - 200;
            for (cycle, one) in recorded.iter().enumerate().take(ends).skip(BEGINS as usize) {
                let min = WAVE_FEED_MM_S * one.inputs.feed_override;
                assert!(
                    one.setpoint.feed_mm_s > MIN_FRACTION * min && one.setpoint.flags & flags::STARVED == 0,
                    "override {number}, seed {seed}: {} of {min} mm/s at {cycle}",
                    one.setpoint.feed_mm_s
                );
            }
        }
    }
    assert!(late > 100, "{late} answers were late");
}

/// The recorded lag of the planner is all that a replay needs, however late the planner was.
#[test]
fn a_run_with_a_slow_planner_is_replayed_bit_for_bit() {
    let overrides: [fn(u64) -> f64; 5] = [
        FALLING[1],
        |cycle| if cycle % 400 < 150 { 0.0 } else { 1.0 },
        |cycle| if cycle % 300 < 120 { 0.7 } else { 1.3 },
        |cycle| 1.0 + 0.4 * (0.002 * cycle as f64).sin(),
        |_| 1.0,
    ];
    let program = Program::of(wave(500));
    let (mut late, mut starved) = (0, 0);
    let cases = evolvent_random::cases(7) as u64;
    let first = evolvent_random::seed(1);
    // The last seed leaves a plan that ends at a stop, and returns to it.
    let seeds = (first..first + cases).chain([1022]);
    for (number, feed_override) in overrides.into_iter().enumerate() {
        for (seed, longest) in seeds.clone().flat_map(|seed| [(seed, LATE), (seed, STARVING)]) {
            println!("override {number}, seed {seed}, windows of up to {longest} cycles");
            let recorded = drive(
                &program,
                feed_override,
                Some(Random::from_state(seed)),
                longest,
                None,
            );
            late += recorded.iter().filter(|one| one.lag.refused).count();
            let is_starved = |one: &&Recorded| one.setpoint.flags & flags::STARVED != 0;
            starved += recorded.iter().filter(is_starved).count();
            drive(&program, feed_override, None, longest, Some(recorded));
        }
    }
    assert!(
        late > 100 && starved > 100,
        "{late} answers were late, {starved} cycles starved"
    );
}

/// A chain of rest steps, most of them without duration.
fn random_rests(random: &mut Random) -> Vec<Step> {
    (0..1 + random.pick(RESTS))
        .map(|number| {
            let line = 10_000 + number as u32;
            match random.pick(4) {
                0 => Step::Dwell { seconds: 0.0, line },
                1 => Step::Dwell {
                    seconds: 0.0025,
                    line,
                },
                _ => Step::Action {
                    action: number as u32,
                    line,
                },
            }
        })
        .collect()
}

/// The cycle passes as many as have arrived.
#[test]
fn steps_arriving_at_rest_are_replayed_bit_for_bit() {
    let mut waited = 0;
    let cases = evolvent_random::cases(12) as u64;
    let first = evolvent_random::seed(1);
    for seed in first..first + cases {
        for (number, feed_override) in [|_| 1.0, FALLING[1]].into_iter().enumerate() {
            println!("override {number}, seed {seed}");
            let mut random = Random::from_state(seed);
            let rests: Vec<Vec<Step>> = (0..5).map(|_| random_rests(&mut random)).collect();
            let program = Program {
                scenario: wave(500),
                rests,
            };
            let recorded = drive(&program, feed_override, Some(random), STARVING, None);
            waited += recorded
                .iter()
                .filter(|one| one.lag.failed_lookup.is_some())
                .count();
            drive(&program, feed_override, None, STARVING, Some(recorded));
        }
    }
    assert!(waited > 100, "waited in {waited} cycles");
}

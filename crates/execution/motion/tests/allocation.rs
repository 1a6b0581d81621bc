//! The cycle does not allocate, measured by a counting allocator.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use evolvent_counting::calls;
use evolvent_machine::Limits;
use evolvent_motion::{
    Inputs, MotionState, PathExecutor, ProcessCycle, ProcessInputs, ProcessStatus, plan_queue,
};
use evolvent_path::{AXES, Axes, Jet};
use evolvent_planner::{PlanSink, Step};

use crate::common::{BLEND, PLANNERS, Pair, Random, scenario};

#[test]
fn the_cycle_does_not_allocate() {
    let seed = 0x0a11_0c01;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    let before = calls();
    drop(std::hint::black_box(vec![1_u8; 100]));
    assert!(calls() >= before + 2, "the allocator does not count");
    let mut cycles = 0_u64;
    for case in 0..8 {
        let mut scenario = scenario(&mut random, BLEND, true);
        scenario.planner = PLANNERS[case % 2];
        let mut pair = Pair::new(&scenario);
        let (mut producer, mut consumer) = rtrb::RingBuffer::new(16);
        let (mut counted, mut own) = (0, 0_u64);
        while !pair.motion.is_over() {
            pair.plan_ahead(&scenario);
            let inputs = Inputs {
                hold: own % 700 > 600,
                feed_override: if own % 300 < 150 { 1.0 } else { 1.7 },
                ..Inputs::default()
            };
            let before = calls();
            let setpoint = pair.step(&inputs);
            // Hand-over, as in the loop.
            let _full = producer.push(setpoint);
            let _taken = consumer.pop();
            counted += calls() - before;
            own += 1;
        }
        assert_eq!(
            counted, 0,
            "case {case}: {counted} calls of the allocator in {own} cycles"
        );
        cycles += own;
    }
    assert!(cycles > 5_000, "only {cycles} cycles: proves nothing");
}

/// A process that swings out 30 mm along X and back, at a rate that follows the override, and may fail before
/// it is done.
#[derive(Debug)]
struct OutAndBack {
    start: Axes,
    phase: f64,
    /// Rate of the phase, rad/s.
    rate: f64,
    fails_at_mm: f64,
    jumps_at_mm: f64,
}

impl OutAndBack {
    const RADIUS_MM: f64 = 15.0;
    const RATE: f64 = 2.0;
    /// Change of the rate per cycle.
    const STEP: f64 = 0.02;

    fn new(start: Axes) -> Self {
        Self {
            start,
            phase: 0.0,
            rate: 0.0,
            fails_at_mm: f64::INFINITY,
            jumps_at_mm: f64::INFINITY,
        }
    }

    fn at_mm(&self) -> f64 {
        Self::RADIUS_MM * (1.0 - self.phase.cos())
    }
}

impl ProcessCycle for OutAndBack {
    fn step(&mut self, inputs: &ProcessInputs) -> (Jet, ProcessStatus) {
        let has_failed = self.at_mm() >= self.fails_at_mm;
        let wanted = if inputs.hold || has_failed {
            0.0
        } else {
            Self::RATE * inputs.feed_override
        };
        self.rate += (wanted - self.rate).clamp(-Self::STEP, Self::STEP);
        self.phase += self.rate * PERIOD_S;
        let is_done = self.phase >= std::f64::consts::TAU;
        let mut jet = Jet::at_rest(self.start);
        if is_done {
            self.rate = 0.0;
        } else {
            jet.position[0] += self.at_mm();
        }
        if self.at_mm() >= self.jumps_at_mm {
            jet.position[0] += 5.0;
        }
        let status = if has_failed {
            ProcessStatus::Failed
        } else if is_done {
            ProcessStatus::Done
        } else {
            ProcessStatus::Running
        };
        (jet, status)
    }

    fn is_at_rest(&self) -> bool {
        self.rate == 0.0
    }
}

const PERIOD_S: f64 = 0.001;

/// The fate of a process cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Scene {
    HeldAndSlowed,
    Failed,
    Stopped,
    BeyondLimits,
}

/// The states of a plan with two process cycles, the position of the last setpoint, and the number of calls
/// of the allocator.
fn drive_processes(scene: Scene) -> (Vec<MotionState>, PathExecutor, Axes, u64) {
    let limits = Limits {
        present: [true; AXES],
        velocity: Axes::repeat(200.0),
        acceleration: Axes::repeat(2000.0),
        jerk: Axes::repeat(4e6),
        travel_min: Axes::repeat(-1000.0),
        travel_max: Axes::repeat(1000.0),
        home: Axes::zeros(),
    };
    let (mut producer, mut queue) = plan_queue(|| true);
    let mut sender = producer.take_processes().expect("the way of process cycles");
    // The first is returned while the second runs.
    for line in [1, 2] {
        let mut process = OutAndBack::new(Axes::zeros());
        if line == 2 {
            match scene {
                Scene::Failed => process.fails_at_mm = 10.0,
                Scene::BeyondLimits => process.jumps_at_mm = 10.0,
                Scene::HeldAndSlowed | Scene::Stopped => {}
            }
        }
        assert!(sender.send(Box::new(process)).is_ok(), "no room");
        producer.step(&Step::Turning { line }).expect("room");
    }
    producer.step(&Step::End { line: 3 }).expect("room");
    producer.commit(3);
    let mut motion = PathExecutor::new(limits, 1_000_000, Axes::zeros());
    let mut states = Vec::with_capacity(100_000);
    let (mut counted, mut moved, mut position) = (0, 0_u64, Axes::zeros());
    while !motion.is_over() {
        let cycles = states.len();
        let inputs = Inputs {
            hold: scene == Scene::HeldAndSlowed && cycles % 900 > 700,
            stop: scene == Scene::Stopped && cycles > 4000,
            feed_override: if scene == Scene::HeldAndSlowed && cycles % 500 > 400 {
                0.6
            } else {
                1.0
            },
            ..Inputs::default()
        };
        let before = calls();
        let setpoint = motion.step(&inputs, &mut queue);
        counted += calls() - before;
        moved += u64::from(motion.process().is_some());
        position = setpoint.position;
        states.push(setpoint.state);
        assert!(states.len() < 100_000, "{scene:?} does not end");
    }
    assert!(moved > 1500, "{scene:?}: {moved} cycles of the processes");
    (states, motion, position, counted)
}

#[test]
fn process_cycles_do_not_allocate_however_they_end() {
    for scene in [
        Scene::HeldAndSlowed,
        Scene::Failed,
        Scene::Stopped,
        Scene::BeyondLimits,
    ] {
        let (states, motion, position, counted) = drive_processes(scene);
        assert_eq!(counted, 0, "{scene:?}: calls of the allocator");
        let has_failed = motion.failed_process().is_some();
        match scene {
            Scene::HeldAndSlowed => {
                assert_eq!((motion.state(), has_failed), (MotionState::Done, false));
                assert!(states.contains(&MotionState::Held), "never held");
                assert_eq!(position, Axes::zeros(), "the plan goes on where they began");
            }
            Scene::Failed => {
                assert_eq!((motion.state(), has_failed), (MotionState::Fault, true));
                assert!((10.0..13.0).contains(&position[0]), "{position}");
            }
            Scene::Stopped => assert_eq!((motion.state(), has_failed), (MotionState::Stopped, false)),
            Scene::BeyondLimits => {
                assert_eq!((motion.state(), has_failed), (MotionState::Fault, false));
                assert!(motion.fault().is_some(), "the guard has to object");
                assert!((position[0] - 10.0).abs() < 2.0, "{position}");
            }
        }
    }
}

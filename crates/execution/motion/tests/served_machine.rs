//! State that continues from job to job: numbers, the guard's memory, positions; and transfers, which have no
//! path.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use evolvent_counting::calls;
use evolvent_machine::Limits;
use evolvent_motion::{MotionState, Setpoint, SetpointGenerator, TransferExecutor};
use evolvent_path::{AXES, Axes};
use evolvent_transfer::{AxesState, Sync, Transfer};

use crate::common::Random;

const PERIOD_NS: u64 = 1_000_000;

fn limits() -> Limits {
    let mut present = [false; AXES];
    present[..3].fill(true);
    Limits {
        present,
        velocity: Axes::repeat(300.0),
        acceleration: Axes::repeat(4000.0),
        jerk: Axes::repeat(100_000.0),
        travel_min: Axes::repeat(-100.0),
        travel_max: Axes::repeat(100.0),
        home: Axes::zeros(),
    }
}

fn random_position(random: &mut Random) -> Axes {
    Axes::from_fn(|i, _| if i < 3 { random.between(-100.0, 100.0) } else { 0.0 })
}

fn to_rest(from: &AxesState, to: Axes) -> TransferExecutor {
    let target = AxesState::at_rest(to);
    TransferExecutor::new(Transfer::solve(&limits(), from, &target, Sync::Time).expect("a way"))
}

fn state_of(setpoint: &Setpoint) -> AxesState {
    AxesState {
        position: setpoint.position,
        velocity: setpoint.velocity,
        acceleration: setpoint.acceleration,
    }
}

/// Computes differences of positions independently of the guard.
#[derive(Default)]
struct Measure {
    past: Vec<Axes>,
    worst: [f64; 3],
    next: u64,
}

impl Measure {
    fn observe(&mut self, setpoint: &Setpoint) {
        assert_eq!(setpoint.sequence, self.next, "a number is missing");
        self.next += 1;
        self.past.insert(0, setpoint.position);
        self.past.truncate(4);
        let rate = 1e9 / PERIOD_NS as f64;
        let p = |k: usize| {
            self.past
                .get(k)
                .copied()
                .unwrap_or(self.past[self.past.len() - 1])
        };
        let limits = limits();
        let first = (p(0) - p(1)) * rate;
        let second = (p(0) - 2.0 * p(1) + p(2)) * rate.powi(2);
        let third = (p(0) - 3.0 * p(1) + 3.0 * p(2) - p(3)) * rate.powi(3);
        for i in 0..3 {
            for (k, ratio) in [
                first[i] / limits.velocity[i],
                second[i] / limits.acceleration[i],
                third[i] / limits.jerk[i],
            ]
            .into_iter()
            .enumerate()
            {
                self.worst[k] = self.worst[k].max(ratio.abs());
            }
            assert!(
                setpoint.position[i].abs() <= 100.0 + 1e-6,
                "{:?}",
                setpoint.position
            );
        }
    }

    fn keeps_the_limits(&self) {
        assert!(self.worst[0] <= 1.0 + 1e-5, "{:?}", self.worst);
        assert!(self.worst[1] <= 1.0 + 1e-5, "{:?}", self.worst);
        assert!(self.worst[2] <= 1.0 + 1e-3, "{:?}", self.worst);
    }
}

#[test]
fn jogs_keep_limits_and_numbers_without_allocation() {
    let seed = 0x57a7_1001;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    let mut generator = SetpointGenerator::new(limits(), PERIOD_NS, Axes::zeros());
    let mut measure = Measure::default();
    let mut counted = 0;
    let (mut turns, mut stops) = (0, 0);
    for _ in 0..400 {
        for _ in 0..3 {
            measure.observe(&generator.rest(MotionState::Idle));
        }
        let from = AxesState::at_rest(generator.position());
        let mut steering = to_rest(&from, random_position(&mut random));
        assert!(generator.can_steer(&steering));
        let turn_at = (random.unit() * 600.0) as u64;
        let stop_at = (random.unit() * 900.0) as u64;
        let mut own = 0;
        let end = loop {
            let before = calls();
            let setpoint = generator.steer(&mut steering);
            counted += calls() - before;
            measure.observe(&setpoint);
            own += 1;
            if own == turn_at && setpoint.state == MotionState::Running {
                let other = to_rest(&state_of(&setpoint), random_position(&mut random));
                let before = calls();
                assert!(generator.turn(&mut steering, &other));
                counted += calls() - before;
                turns += 1;
            }
            if own == stop_at {
                steering.stop();
                stops += 1;
            }
            if matches!(setpoint.state, MotionState::Done | MotionState::Stopped) {
                break setpoint;
            }
            assert!(own < 20_000, "no end");
        };
        assert_eq!(end.velocity.norm() + end.acceleration.norm(), 0.0);
        assert!(generator.take_fault().is_none());
        generator.end();
    }
    measure.keeps_the_limits();
    assert_eq!(counted, 0, "the cycle allocates");
    assert!(
        turns > 100 && stops > 100,
        "{turns} turns and {stops} stops prove little"
    );
}

#[test]
fn a_jog_stops_no_later_than_its_transfer_ends() {
    let seed = 0x57a7_1002;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    for _ in 0..200 {
        // To the very edge of the travel: a stop must not lead beyond it.
        let mut generator = SetpointGenerator::new(limits(), PERIOD_NS, Axes::zeros());
        let edge = Axes::from_fn(|i, _| if i == 0 { 100.0 } else { 0.0 });
        let mut steering = to_rest(&AxesState::at_rest(Axes::zeros()), edge);
        let cycles = steering.transfer().duration_s() * 1e9 / PERIOD_NS as f64;
        let stop_at = (random.unit() * cycles) as u64;
        let mut speed_at_stop = 0.0;
        for own in 0_u64.. {
            if own == stop_at {
                steering.stop();
                speed_at_stop = 1.0;
            }
            let setpoint = generator.steer(&mut steering);
            assert!(setpoint.position[0] <= 100.0 + 1e-9);
            assert!(setpoint.velocity[0] >= -1e-9, "backwards");
            if matches!(setpoint.state, MotionState::Done | MotionState::Stopped) {
                break;
            }
        }
        assert!(generator.take_fault().is_none() && speed_at_stop >= 0.0);
    }
}

#[test]
fn what_begins_elsewhere_is_not_taken_up() {
    let mut generator = SetpointGenerator::new(limits(), PERIOD_NS, Axes::zeros());
    let elsewhere = Axes::from_fn(|i, _| if i == 0 { 0.01 } else { 0.0 });
    let steering = to_rest(&AxesState::at_rest(elsewhere), Axes::zeros());
    assert!(!generator.can_steer(&steering));
    let mut motion = evolvent_motion::PathExecutor::new(limits(), PERIOD_NS, elsewhere);
    assert!(!generator.attach(&mut motion));
    let mut motion = evolvent_motion::PathExecutor::new(limits(), PERIOD_NS, Axes::zeros());
    assert!(generator.attach(&mut motion));
    // A transfer that does not begin at the present state leaves the motion unchanged.
    let mut steering = to_rest(&AxesState::at_rest(Axes::zeros()), elsewhere);
    let other = to_rest(&AxesState::at_rest(Axes::repeat(0.0)), -elsewhere);
    for _ in 0..5 {
        generator.steer(&mut steering);
    }
    assert!(!generator.turn(&mut steering, &other));
}

#[test]
fn an_emergency_stop_stops_each_axis_within_limits() {
    let seed = 0x57a7_1003;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    for _ in 0..200 {
        let mut generator = SetpointGenerator::new(limits(), PERIOD_NS, Axes::zeros());
        let mut measure = Measure::default();
        // Differences are measured from rest on.
        for _ in 0..3 {
            measure.observe(&generator.rest(MotionState::Idle));
        }
        let target = 0.9 * random_position(&mut random);
        let mut steering = to_rest(&AxesState::at_rest(Axes::zeros()), target);
        let cycles = steering.transfer().duration_s() * 1e9 / PERIOD_NS as f64;
        for _ in 0..(random.unit() * cycles) as u64 {
            measure.observe(&generator.steer(&mut steering));
        }
        generator.emergency();
        let mut own = 0;
        while !generator.is_at_rest() {
            measure.observe(&generator.rest(MotionState::Fault));
            own += 1;
            assert!(own < 1000, "no end");
        }
        measure.keeps_the_limits();
    }
}

#[test]
fn a_new_name_for_a_place_is_no_motion() {
    let mut generator = SetpointGenerator::new(limits(), PERIOD_NS, Axes::zeros());
    generator.rest(MotionState::Idle);
    let renamed = Axes::from_fn(|i, _| if i == 1 { -55.0 } else { 0.0 });
    generator.relocate(limits(), renamed);
    let setpoint = generator.rest(MotionState::Idle);
    assert_eq!((setpoint.position, setpoint.sequence), (renamed, 1));
    let mut steering = to_rest(&AxesState::at_rest(renamed), Axes::zeros());
    assert!(generator.can_steer(&steering));
    while generator.steer(&mut steering).state == MotionState::Running {}
    assert!(generator.take_fault().is_none());
}

//! The cycle does not allocate: counted, not believed.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use evolvent_counting::calls;
use evolvent_machine::Limits;
use evolvent_motion::{Inputs, PathExecutor, State, Turning, TurningFrame, plan_queue};
use evolvent_path::{AXES, Axes, AxisLetter};
use evolvent_planner::{PlanSink, Step};
use evolvent_turning::{
    BackOff, Blank, CutLaw, Reason, Regime, RegimeInput, Sensor, SensorFault, SensorModel, Tool,
    TurningController, TurningSettings, TurningState, Workpiece,
};

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
            // Hand-over, as the loop does it.
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

/// What happens to a turning cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Scene {
    HeldAndSlowed,
    Overload,
    SensorLost,
    Stopped,
}

const PERIOD_S: f64 = 0.001;
const SET: f64 = 2200.0;
/// Where the tool stands before and after: 8 mm before the face, 8 mm above the final size.
const START_MM: (f64, f64) = (-8.0, 8.0);

fn turning_settings() -> TurningSettings {
    let law = CutLaw {
        coefficient: 1467.0,
        depth_exponent: 1.0,
        feed_exponent: 0.75,
    };
    let tool = Tool::new(60.0, 12.0).expect("a tool");
    let input = RegimeInput {
        law,
        set_load: SET,
        permitted_load: 10_000.0,
        feed_min_mm_rev: 0.2,
        feed_max_mm_rev: 0.7,
        back_off: BackOff::Balanced,
    };
    let regime = Regime::new(&input, &tool).expect("a regime");
    TurningSettings {
        allowance_max_mm: 8.0,
        period_s: PERIOD_S,
        ..TurningSettings::usual(regime, tool, 500.0, 30.0)
    }
}

/// A lathe: X across, as a radius from 30 mm, and Z along, downwards from 300 mm.
fn lathe() -> (Limits, TurningFrame) {
    let mut limits = Limits {
        present: [false; AXES],
        velocity: Axes::repeat(200.0),
        acceleration: Axes::repeat(2000.0),
        jerk: Axes::repeat(50_000.0),
        travel_min: Axes::repeat(-1000.0),
        travel_max: Axes::repeat(1000.0),
        home: Axes::zeros(),
    };
    let (x, z) = (AxisLetter::X, AxisLetter::Z);
    (limits.present[x.index()], limits.present[z.index()]) = (true, true);
    let mut start = Axes::zeros();
    start[x.index()] = 30.0 + START_MM.1;
    start[z.index()] = 300.0 - START_MM.0;
    let frame = TurningFrame {
        start,
        along: (z, 300.0, -1.0),
        out: (x, 30.0, 1.0),
    };
    (limits, frame)
}

#[test]
fn turning_cycles_in_the_plan_do_not_allocate_whatever_becomes_of_them() {
    for scene in [
        Scene::HeldAndSlowed,
        Scene::Overload,
        Scene::SensorLost,
        Scene::Stopped,
    ] {
        let (limits, frame) = lathe();
        let settings = turning_settings();
        let (mut producer, mut queue) = plan_queue(|| true);
        let mut sender = producer.take_turnings().expect("the way of turning cycles");
        // Two of them: the first is handed back while the second runs.
        for line in [1, 2] {
            let (along, out) = START_MM;
            let controller = TurningController::starting_at(settings, along, out).expect("a job");
            let sent = sender.send(Box::new(Turning::new(controller, frame)));
            assert!(sent.is_ok(), "no room");
            producer.step(&Step::Turning { line }).expect("room");
        }
        producer.step(&Step::End { line: 3 }).expect("room");
        producer.finalise(3);
        let mut motion = PathExecutor::new(limits, 1_000_000, frame.start);
        let blank = Blank::outline(&[(0.0, 6.5), (15.0, 6.5), (15.0, 3.0), (30.0, 4.0)]);
        let mut piece = Workpiece::new(blank, 30.0, settings.regime.law, settings.tool, 0.12 / PERIOD_S);
        let (uncut, mut line) = (piece.clone(), 1);
        let model = SensorModel {
            lag_s: 0.01,
            noise: 0.02,
            range_max: 20_000.0,
            seed: 3,
        };
        let mut sensor = Sensor::new(model, PERIOD_S);
        let (mut load, mut counted, mut cycles, mut cut, mut backed) = (0.0, 0, 0_u64, 0_u32, 0);
        let mut states = Vec::with_capacity(400_000);
        while !motion.is_over() {
            let struck = cut > 1500;
            let held = scene == Scene::HeldAndSlowed && cycles % 9000 > 8500;
            let inputs = Inputs {
                hold: held,
                stop: struck && scene == Scene::Stopped,
                feed_override: if scene == Scene::HeldAndSlowed && cycles % 5000 > 4000 {
                    0.6
                } else {
                    1.0
                },
                load: sensor.read(
                    if struck && scene == Scene::Overload {
                        3.0 * SET
                    } else {
                        load
                    },
                    (struck && scene == Scene::SensorLost).then_some(SensorFault::Lost),
                ),
                ..Inputs::default()
            };
            let before = calls();
            let setpoint = motion.step(&inputs, &mut queue);
            counted += calls() - before;
            states.push(setpoint.state);
            if setpoint.line == 2 && line == 1 {
                // The next part.
                (piece, line) = (uncut.clone(), 2);
            }
            let place = (300.0 - setpoint.position[2], setpoint.position[0] - 30.0);
            load = piece.step(place.0, place.1).load;
            if let Some(output) = motion.turning() {
                cut += u32::from(output.state == TurningState::Cut);
                backed += u32::from(output.state == TurningState::BackOff);
            }
            cycles += 1;
            assert!(cycles < 400_000, "{scene:?} does not end");
        }
        assert_eq!(counted, 0, "{scene:?}: calls of the allocator in {cycles} cycles");
        assert!(
            cut > 1500 && backed > 0,
            "{scene:?}: {cut} cycles of cut, {backed} of backing off"
        );
        let (state, fault) = (motion.state(), motion.turning_fault());
        match scene {
            Scene::HeldAndSlowed => {
                assert_eq!((state, fault), (State::Done, None));
                assert!(states.contains(&State::Held), "never held");
                assert!(piece.residual_mm() < 0.1, "{}", piece.residual_mm());
            }
            Scene::Overload => assert!(matches!(fault, Some(Reason::Overload { .. })), "{fault:?}"),
            Scene::SensorLost => assert!(matches!(fault, Some(Reason::Sensor(_))), "{fault:?}"),
            Scene::Stopped => assert_eq!((state, fault), (State::Stopped, None)),
        }
    }
}

//! Plans that stop arriving, and plans that are wrong.

#![allow(clippy::expect_used, reason = "a test may fail")]

use evolvent_machine::{Limits, PlannerKind};
use evolvent_motion::{Inputs, MotionState, PathExecutor, QueueClosed, SetpointGenerator, flags, plan_queue};
use evolvent_path::{AXES, Arc, Axes, Curve, Line, Move, MoveKind, PathMode, Plane, Sense};
use evolvent_planner::{
    ExitSpeeds, PathLimits, PathRules, PlanSink, Planner, Run, ScalarLimits, Segment, SegmentMarks, Step,
};

use crate::common::{BLEND, Random, campaign, check, scenario};

const RULES: PathRules = PathRules {
    blend_tolerance_mm: 0.01,
    joint_time_s: 0.001,
    planner: PlannerKind::Classic,
    feed_override: 1.0,
};

#[test]
fn a_planner_dying_at_any_moment_stops_on_the_path() {
    let (mut random, cases) = campaign(0xdead_0001, 60);
    for case in 0..cases {
        let scenario = scenario(&mut random, BLEND, false);
        let rate = 1e9 / scenario.period_ns as f64;
        let (producer, mut queue) = plan_queue(|| false);
        let limits = PathLimits::new(scenario.limits, rate, scenario.chord_error_mm);
        let mut planner = Some(Planner::new(limits, RULES, producer));
        let mut motion = PathExecutor::new(
            scenario.limits,
            scenario.period_ns,
            scenario.moves[0].curve.start(),
        );
        // Moves arrive slowly while the machine runs, and stop at a random one.
        let last = random.pick(scenario.moves.len());
        let every = random.log(1.0, 300.0) as usize;
        let mut setpoints = Vec::new();
        let mut fed = 0;
        let mut still = 0;
        while still < 3 {
            if setpoints.len() % every == 0 && fed <= last {
                if let Some(planner) = &mut planner {
                    planner
                        .push(&scenario.moves[fed], fed as u32 + 1, fed as u32)
                        .expect("plan");
                }
                fed += 1;
            }
            if fed > last {
                planner = None;
            }
            setpoints.push(motion.step(&Inputs::default(), &mut queue));
            let over = planner.is_none() && motion.is_at_rest() && queue.step(0).is_none();
            still = if over { still + 1 } else { 0 };
            if planner.is_none() && motion.is_at_rest() {
                // Steps that never became final are not entered from rest.
                break;
            }
            assert!(setpoints.len() < 4_000_000, "case {case} does not come to rest");
        }
        check(&scenario, &setpoints, &motion, 0.02, &format!("case {case}"));
        // Otherwise the run would wait for the plan without end. It may still drive what is final.
        for _ in 0..200_000 {
            if motion.is_stuck(&mut queue) {
                break;
            }
            motion.step(&Inputs::default(), &mut queue);
        }
        assert!(motion.is_stuck(&mut queue), "case {case}: {:?}", motion.state());
    }
}

/// Steps may still change after the cycle has entered them.
#[test]
fn overrides_with_a_short_look_ahead_keep_every_limit() {
    let (mut random, cases) = campaign(0xdead_0002, 5);
    let mut starved = 0;
    for case in 0..cases {
        let mut scenario = scenario(&mut random, PathMode::ExactPath, false);
        // Straight blocks of a few milliseconds each: the plan changes with every new block.
        let mut at = Axes::zeros();
        scenario.moves = (0..400)
            .map(|_| {
                let (start, feed) = (at, random.log(20.0, 200.0));
                at[0] += feed * random.log(0.004, 0.03);
                let curve = Curve::Line(Line::new(start, at).expect("line"));
                Move {
                    curve,
                    kind: MoveKind::Feed,
                    feed_mm_s: feed,
                    path_mode: PathMode::ExactPath,
                }
            })
            .collect();
        scenario.period_ns = 500_000;
        let (producer, mut queue) = plan_queue(|| false);
        let limits = PathLimits::new(scenario.limits, 2000.0, scenario.chord_error_mm);
        let mut planner = Planner::new(limits, RULES, producer);
        let mut motion = PathExecutor::new(scenario.limits, scenario.period_ns, Axes::zeros());
        let (mut setpoints, mut fed) = (Vec::new(), 0);
        let every = 20 + random.pick(60);
        let mut inputs = Inputs::default();
        while !motion.is_over() {
            let cycle = setpoints.len();
            if cycle > every * fed {
                if let Some(one) = scenario.moves.get(fed) {
                    planner.push(one, fed as u32 + 1, fed as u32).expect("plan");
                } else if fed == scenario.moves.len() {
                    planner.finish(999).expect("finish");
                }
                fed += 1;
            }
            if random.unit() < 0.1 {
                inputs.feed_override = random.between(0.2, 2.0);
                inputs.hold = random.unit() < 0.05;
            }
            let setpoint = motion.step(&inputs, &mut queue);
            starved += u32::from(setpoint.flags & flags::STARVED != 0);
            setpoints.push(setpoint);
            assert!(cycle < 1_000_000, "case {case} does not end");
        }
        check(&scenario, &setpoints, &motion, 1e-6, &format!("case {case}"));
    }
    assert!(starved > 0, "the planner was never close behind");
}

#[test]
fn a_queue_that_is_full_gives_up_when_told_to() {
    let (mut producer, _queue) = plan_queue(|| false);
    let step = Step::Dwell {
        seconds: 0.0,
        line: 1,
    };
    let mut result = Ok(());
    for _ in 0..100_000 {
        result = producer.step(&step);
        if result.is_err() {
            break;
        }
    }
    assert_eq!(result, Err(QueueClosed));
}

fn one_axis(velocity: f64, acceleration: f64, jerk: f64) -> Limits {
    Limits {
        present: [true; AXES],
        velocity: Axes::repeat(velocity),
        acceleration: Axes::repeat(acceleration),
        jerk: Axes::repeat(jerk),
        travel_min: Axes::repeat(-500.0),
        travel_max: Axes::repeat(500.0),
        home: Axes::zeros(),
    }
}

fn line(from: f64, to: f64) -> Segment {
    let (mut start, mut end) = (Axes::zeros(), Axes::zeros());
    (start[0], end[0]) = (from, to);
    let curve = Curve::Line(Line::new(start, end).expect("line"));
    Segment {
        curve,
        from: 0.0,
        length: to - from,
        line: 1,
        block: 0,
        marks: SegmentMarks::default(),
    }
}

fn unchecked_plan(
    segments: &[Segment],
    limits: ScalarLimits,
    exits: &[f64],
) -> evolvent_motion::PlanConsumer {
    let (mut producer, queue) = plan_queue(|| false);
    for (k, segment) in segments.iter().enumerate() {
        producer.segment(segment).expect("room");
        let run = Run {
            length: segment.length,
            segments: 1,
            limits,
            feed_u_s: f64::INFINITY,
        };
        producer.step(&Step::Run(run)).expect("room");
        producer.exit(
            k as u64,
            ExitSpeeds {
                nominal: exits[k],
                doubled: exits[k],
            },
        );
    }
    producer.step(&Step::End { line: 2 }).expect("room");
    producer.commit(segments.len() as u64 + 1);
    queue
}

/// Runs until nothing moves and returns the maximum |velocity|, |acceleration|, |jerk| of X as published.
fn published(motion: &mut PathExecutor, queue: &mut evolvent_motion::PlanConsumer, rate: f64) -> [f64; 3] {
    let mut past = [0.0; 4];
    let mut max = [0.0_f64; 3];
    for _ in 0..100_000 {
        let setpoint = motion.step(&Inputs::default(), queue);
        past = [setpoint.position[0], past[0], past[1], past[2]];
        let d = [
            (past[0] - past[1]) * rate,
            (past[0] - 2.0 * past[1] + past[2]) * rate.powi(2),
            (past[0] - 3.0 * past[1] + 3.0 * past[2] - past[3]) * rate.powi(3),
        ];
        for k in 0..3 {
            max[k] = max[k].max(d[k].abs());
        }
        if motion.is_over() {
            break;
        }
    }
    max
}

#[test]
fn the_guard_stops_a_plan_that_breaks_velocity() {
    let limits = one_axis(100.0, 2000.0, 50_000.0);
    // A plan for a machine with twice the speed and the same acceleration and jerk.
    let scalar = ScalarLimits {
        velocity: 200.0,
        acceleration: 2000.0,
        jerk: 50_000.0,
    };
    let mut queue = unchecked_plan(&[line(0.0, 200.0)], scalar, &[0.0]);
    let mut motion = PathExecutor::new(limits, 1_000_000, Axes::zeros());
    let [v, a, j] = published(&mut motion, &mut queue, 1000.0);
    let fault = motion.fault().expect("the guard has to see it");
    assert_eq!(fault.quantity, evolvent_motion::BrokenLimit::Velocity);
    assert_eq!(motion.state(), MotionState::Fault);
    assert!(motion.is_over());
    // It may pass the velocity limit only while acceleration is reduced: by at most a^2 / (2 J).
    assert!(v <= 100.0 + 2000.0 * 2000.0 / 100_000.0 + 1.0, "{v}");
    assert!(a <= 2000.0 * 1.001 && j <= 50_000.0 * 1.02, "{a} {j}");
}

#[test]
fn the_guard_quick_stops_when_braking_breaks_limits() {
    let limits = one_axis(200.0, 2000.0, 50_000.0);
    // Jerk ten times too high: rejected at the first setpoint, and no other profile of this run is better.
    let scalar = ScalarLimits {
        velocity: 200.0,
        acceleration: 2000.0,
        jerk: 500_000.0,
    };
    let mut queue = unchecked_plan(&[line(0.0, 200.0)], scalar, &[0.0]);
    let mut motion = PathExecutor::new(limits, 1_000_000, Axes::zeros());
    let [v, a, j] = published(&mut motion, &mut queue, 1000.0);
    assert_eq!(
        motion.fault().expect("fault").quantity,
        evolvent_motion::BrokenLimit::Jerk
    );
    assert!(motion.is_over());
    assert!(
        v <= 200.0 && a <= 2000.0 * 1.001 && j <= 50_000.0 * 1.02,
        "{v} {a} {j}"
    );
}

#[test]
fn the_guard_keeps_a_jump_of_the_path_from_the_drives() {
    let limits = one_axis(200.0, 2000.0, 50_000.0);
    let scalar = ScalarLimits {
        velocity: 200.0,
        acceleration: 2000.0,
        jerk: 50_000.0,
    };
    // The second segment starts 5 mm beyond the end of the first.
    let mut queue = unchecked_plan(&[line(0.0, 100.0), line(105.0, 200.0)], scalar, &[200.0, 0.0]);
    let mut motion = PathExecutor::new(limits, 1_000_000, Axes::zeros());
    let [v, a, j] = published(&mut motion, &mut queue, 1000.0);
    assert!(motion.fault().is_some() && motion.is_over());
    assert!(v <= 200.0 * 1.001 && a <= 2000.0 * 1.001, "{v} {a}");
    // The plan did not contain the jump, so the axis stops on its own, from its present acceleration: zero.
    assert!(j <= 50_000.0 * 1.02, "{j}");
}

/// The emergency stop comes while the axis is already stopping on its own.
#[test]
fn an_emergency_stop_continues_a_stop_of_the_guard() {
    let limits = one_axis(200.0, 2000.0, 50_000.0);
    let scalar = ScalarLimits {
        velocity: 200.0,
        acceleration: 2000.0,
        jerk: 50_000.0,
    };
    for moment in 1..150 {
        let mut queue = unchecked_plan(&[line(0.0, 100.0), line(105.0, 200.0)], scalar, &[200.0, 0.0]);
        let mut motion = PathExecutor::new(limits, 1_000_000, Axes::zeros());
        let mut generator = SetpointGenerator::new(limits, 1_000_000, Axes::zeros());
        assert!(generator.attach(&mut motion));
        let mut stopping = 0;
        while stopping < moment && !motion.is_over() {
            let setpoint = motion.step(&Inputs::default(), &mut queue);
            generator.follow(&motion, &setpoint);
            stopping += u64::from(motion.fault().is_some());
        }
        generator.emergency();
        let mut periods = 0;
        while !generator.is_at_rest() {
            let _setpoint = generator.rest(MotionState::Fault);
            periods += 1;
            assert!(periods < 1000, "no end");
        }
        let max = generator.extremes();
        let [v, a, j] = [max.velocity[0], max.acceleration[0], max.jerk[0]];
        assert!(
            v <= 200.0 * 1.001 && a <= 2000.0 * 1.001 && j <= 50_000.0 * 1.02,
            "{moment}: {v} {a} {j}"
        );
    }
}

#[test]
fn a_position_that_is_no_number_never_leaves() {
    let limits = one_axis(200.0, 2000.0, 50_000.0);
    let scalar = ScalarLimits {
        velocity: 200.0,
        acceleration: 2000.0,
        jerk: f64::NAN,
    };
    let mut queue = unchecked_plan(&[line(0.0, 100.0)], scalar, &[0.0]);
    let mut motion = PathExecutor::new(limits, 1_000_000, Axes::zeros());
    for _ in 0..1000 {
        let setpoint = motion.step(&Inputs::default(), &mut queue);
        assert!(setpoint.position.iter().all(|value| value.is_finite()));
    }
}

#[test]
fn an_override_that_is_no_number_stands_still() {
    let mut random = Random::from_state(7);
    let scenario = scenario(&mut random, PathMode::ExactPath, false);
    let mut queue = crate::common::plan(&scenario);
    let mut motion = PathExecutor::new(
        scenario.limits,
        scenario.period_ns,
        scenario.moves[0].curve.start(),
    );
    let inputs = Inputs {
        feed_override: f64::NAN,
        ..Inputs::default()
    };
    for _ in 0..100 {
        let setpoint = motion.step(&inputs, &mut queue);
        assert_eq!(setpoint.position, scenario.moves[0].curve.start());
        assert_eq!(setpoint.flags & flags::GUARD, 0);
    }
}

#[test]
fn the_line_at_rest_is_that_of_the_awaited_step() {
    let scalar = ScalarLimits {
        velocity: 200.0,
        acceleration: 2000.0,
        jerk: 50_000.0,
    };
    let (mut producer, mut queue) = plan_queue(|| false);
    let mut second = line(10.0, 20.0);
    (second.line, second.block) = (5, 1);
    let run = Step::Run(Run {
        length: 10.0,
        segments: 1,
        limits: scalar,
        feed_u_s: f64::INFINITY,
    });
    for (segment, step) in [
        (Some(line(0.0, 10.0)), run),
        (None, Step::ProgramStop { line: 2 }),
        (Some(second), run),
    ] {
        if let Some(segment) = segment {
            producer.segment(&segment).expect("room");
        }
        producer.step(&step).expect("room");
    }
    producer.step(&Step::End { line: 6 }).expect("room");
    producer.commit(4);
    let mut motion = PathExecutor::new(one_axis(200.0, 2000.0, 50_000.0), 1_000_000, Axes::zeros());
    let mut states = Vec::new();
    for cycle in 0..1000 {
        let inputs = Inputs {
            resume: cycle > 500,
            ..Inputs::default()
        };
        let setpoint = motion.step(&inputs, &mut queue);
        if states.last() != Some(&(setpoint.state, setpoint.line, setpoint.block)) {
            states.push((setpoint.state, setpoint.line, setpoint.block));
        }
    }
    let expected = [
        (MotionState::Running, 1, 0),
        (MotionState::ProgramStop, 2, 0),
        (MotionState::Running, 5, 1),
        (MotionState::Done, 6, 1),
    ];
    assert_eq!(states, expected);
}

/// Every axis stops on its own after the published setpoints. Returns the acceleration and jerk of X and Y as
/// published, as multiples of their limits, and the maximum X.
fn stopped_alone(
    mut generator: SetpointGenerator,
    mut published: Vec<Axes>,
    limits: &Limits,
    rate: f64,
) -> ([f64; 2], [f64; 2], f64) {
    generator.emergency();
    while !generator.is_at_rest() {
        published.push(generator.rest(MotionState::Fault).position);
        assert!(published.len() < 4000, "no end");
    }
    published.extend([generator.position(); 3]);
    let (mut acceleration, mut jerk) = ([0.0_f64; 2], [0.0_f64; 2]);
    for four in published.windows(4) {
        for axis in 0..2 {
            let [d, c, b, a] = [0, 1, 2, 3].map(|i: usize| four[i][axis]);
            let second = (a - 2.0 * b + c).abs() * rate.powi(2) / limits.acceleration[axis];
            let third = (a - 3.0 * b + 3.0 * c - d).abs() * rate.powi(3) / limits.jerk[axis];
            acceleration[axis] = acceleration[axis].max(second);
            jerk[axis] = jerk[axis].max(third);
        }
    }
    let farthest = published
        .iter()
        .map(|position| position[0])
        .fold(f64::MIN, f64::max);
    (acceleration, jerk, farthest)
}

#[test]
fn an_emergency_stop_on_a_circle_stays_in_travel() {
    for (period_ns, radius, beside) in [
        (250_000, 10.0, 0.0),
        (1_000_000, 10.0, 0.0),
        (1_000_000, 30.0, 0.0),
        (1_000_000, 30.0, 0.02),
        (1_000_000, 2.0, 0.0),
        (4_000_000, 10.0, 0.0),
        (1_000_000, 10.0, 0.3),
    ] {
        let mut limits = one_axis(500.0, 2000.0, 50_000.0);
        limits.travel_max[0] = radius + beside;
        let mut start = Axes::zeros();
        start[0] = -radius;
        let arc = Arc::new(Plane::Xy, start, start, [0.0, 0.0], Sense::CounterClockwise, 1).expect("arc");
        let circle = Move {
            curve: Curve::Arc(arc),
            kind: MoveKind::Feed,
            feed_mm_s: 400.0,
            path_mode: PathMode::ExactPath,
        };
        let what = format!("{period_ns} ns, radius {radius} mm, {beside} mm beside the edge");
        let rate = 1e9 / period_ns as f64;
        let (producer, mut queue) = plan_queue(|| true);
        let mut planner = Planner::new(PathLimits::new(limits, rate, 0.01), RULES, producer);
        planner.push(&circle, 1, 0).expect("within the travel");
        planner.finish(2).expect("taken");
        let mut motion = PathExecutor::new(limits, period_ns, start);
        let mut generator = SetpointGenerator::new(limits, period_ns, start);
        assert!(generator.attach(&mut motion));
        let (mut max, mut min) = ([0.0_f64; 4], f64::MAX);
        let mut past = vec![start; 3];
        while !motion.is_over() {
            let (acceleration, jerk, farthest) = stopped_alone(generator, past.clone(), &limits, rate);
            assert!(farthest <= limits.travel_max[0] + 1e-6, "{what}: {farthest}");
            let found = [acceleration[0], acceleration[1], jerk[0], jerk[1]];
            for (max, found) in max.iter_mut().zip(found) {
                *max = max.max(found);
            }
            min = min.min(limits.travel_max[0] - farthest);
            planner.poll().expect("taken");
            let setpoint = motion.step(&Inputs::default(), &mut queue);
            generator.follow(&motion, &setpoint);
            past = vec![past[1], past[2], setpoint.position];
        }
        println!("{what}: acceleration XY, jerk XY {max:.3?}, to within {min:.6} mm of the edge");
        assert!(max[0] <= 1.001 && max[1] <= 1.001, "{what}: {max:?}");
        assert!(max[3] <= 1.02, "{what}: {max:?}");
        // The overshoot at the jerk limit is A^3 / 24 J^2 = 0.133 mm: farther from the edge no limit is
        // exceeded.
        assert!(max[2] <= 1.02 || beside < 0.2, "{what}: {max:?}");
    }
}

/// A plan that leads X out of its travel at full speed: only a step of its speed can stop that axis before
/// the edge.
#[test]
fn other_axes_stop_when_one_axis_leaves_its_travel() {
    let mut limits = one_axis(200.0, 2000.0, 50_000.0);
    limits.travel_max[0] = 50.0;
    let (mut end, start) = (Axes::zeros(), Axes::zeros());
    (end[0], end[1]) = (100.0, 100.0);
    let curve = Curve::Line(Line::new(start, end).expect("line"));
    let diagonal = Segment {
        curve,
        length: curve.length(),
        ..line(0.0, 1.0)
    };
    let scalar = ScalarLimits {
        velocity: 200.0,
        acceleration: 2000.0,
        jerk: 50_000.0,
    };
    let mut queue = unchecked_plan(&[diagonal], scalar, &[0.0]);
    let mut motion = PathExecutor::new(limits, 1_000_000, start);
    let mut published = vec![start; 3];
    while !motion.is_over() {
        published.push(motion.step(&Inputs::default(), &mut queue).position);
        assert!(published.len() < 4000, "no end");
    }
    assert_eq!(
        motion.fault().expect("fault").quantity,
        evolvent_motion::BrokenLimit::Travel
    );
    let last = published[published.len() - 1];
    assert!(published.iter().all(|position| position[0] <= 50.0 + 1e-6));
    assert!(last[0] > 49.0 && last[1] > 55.0, "{last}");
    for four in published.windows(4) {
        let [d, c, b, a] = [0, 1, 2, 3].map(|i: usize| four[i][1]);
        let (second, third) = ((a - 2.0 * b + c) * 1e6, (a - 3.0 * b + 3.0 * c - d) * 1e9);
        assert!(
            second.abs() <= 2000.0 * 1.001 && third.abs() <= 50_000.0 * 1.02,
            "{second} {third}"
        );
    }
}

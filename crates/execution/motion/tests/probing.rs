//! Probing moves at random moments: their stopping positions, their results, the limits, and no allocation.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use evolvent_counting::calls;
use evolvent_machine::{Limits, PlannerKind};
use evolvent_motion::{
    Inputs, MotionState, PathExecutor, PlanConsumer, ProbeMove, ProbeResult, ProbeVerdict, Probing,
    ProbingSender, Setpoint, plan_queue,
};
use evolvent_path::{AXES, Axes, Curve, Line, Move, MoveKind, PathMode};
use evolvent_planner::{PathLimits, PathRules, Planner, Step};
use evolvent_signals::{ProbeInput, ProbeState};

use crate::common::{PLANNERS, Random, equal_axes, limits};

/// The behaviour of the probe, by the cycle since the move started to move.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Scene {
    /// It changes in this cycle, for this number of cycles (a bounce is open again after one).
    Changes {
        cycle: u64,
        lasts: u64,
    },
    /// The probe is not reported from this cycle on.
    Lost(u64),
    Never,
    Before,
    Silent,
}

struct Outcome {
    result: ProbeResult,
    /// Setpoints of the probing move alone.
    moved: Vec<Setpoint>,
    all: Vec<Setpoint>,
    contact_at: Option<Axes>,
    allocations: usize,
}

fn line(from: Axes, to: Axes) -> Curve {
    Curve::Line(Line::new(from, to).expect("two points"))
}

fn feed_move(from: Axes, to: Axes, feed: f64) -> Move {
    Move {
        curve: line(from, to),
        kind: MoveKind::Feed,
        feed_mm_s: feed,
        path_mode: PathMode::ExactPath,
    }
}

/// Moves, probes, and continues from the position at which the probing move has stopped.
#[expect(clippy::too_many_arguments, reason = "a case is many things")]
fn run(
    machine: Limits,
    period_ns: u64,
    kind: PlannerKind,
    start: Axes,
    order: ProbeMove,
    toward_next: Axes,
    scene: Scene,
    hold: std::ops::Range<u64>,
) -> Outcome {
    let (mut producer, mut queue) = plan_queue(|| unreachable!("no room"));
    let mut probings: ProbingSender = producer.take_probings().expect("once");
    let rules = PathRules {
        blend_tolerance_mm: 0.01,
        joint_time_s: 0.001,
        planner: kind,
        feed_override: 1.0,
    };
    let chord = PathLimits::new(machine, 1e9 / period_ns as f64, 0.01);
    let mut planner = Planner::new(chord, rules, producer);
    let mut motion = PathExecutor::new(machine, period_ns, start);
    let from = order.curve.start();
    planner
        .push(&feed_move(start, from, order.feed_mm_s), 1, 0)
        .expect("a move");
    probings
        .send(Box::new(Probing::new(order, &machine, 0.002)))
        .expect("room");
    planner.rest(&Step::Probe { line: 2 }).expect("room");
    planner.poll().expect("taken");
    let (mut all, mut moved) = (Vec::<Setpoint>::new(), Vec::new());
    let (mut result, mut begun, mut allocations) = (None, None, 0);
    let mut probe = ProbeInput::default();
    let away = if order.toward {
        ProbeState::Open
    } else {
        ProbeState::Tripped
    };
    let changed = if order.toward {
        ProbeState::Tripped
    } else {
        ProbeState::Open
    };
    probe.now.state = match scene {
        Scene::Before => changed,
        Scene::Silent => ProbeState::Unknown,
        _ => away,
    };
    let mut contact_at = None;
    while !motion.is_over() {
        if result.is_none() {
            planner.poll().expect("taken");
        }
        let line_now = all.last().map_or(0, |last: &Setpoint| last.line);
        let is_moving = line_now == 2 && all.last().is_some_and(|last| last.position != from);
        if begun.is_none() && is_moving {
            begun = Some(all.len() as u64 - 1);
        }
        let since = begun.map(|begun| all.len() as u64 - begun);
        (probe.was_tripped, probe.was_open) = (false, false);
        match (scene, since) {
            (Scene::Changes { cycle, lasts }, Some(since)) if since >= cycle => {
                let is_on = since < cycle + lasts;
                probe.now.state = if is_on { changed } else { away };
                if since == cycle {
                    let at = all.last().expect("one").position;
                    contact_at = Some(at);
                    probe.now.locate_change(std::array::from_fn(|axis| at[axis]));
                }
            }
            (Scene::Lost(cycle), Some(since)) if since >= cycle => probe.now.state = ProbeState::Unknown,
            _ => {}
        }
        match probe.now.state {
            ProbeState::Tripped => probe.was_tripped = true,
            ProbeState::Open => probe.was_open = true,
            _ => {}
        }
        let inputs = Inputs {
            probe,
            hold: since.is_some_and(|since| hold.contains(&since)),
            ..Inputs::default()
        };
        let before = calls();
        let setpoint = motion.step(&inputs, &mut queue);
        allocations += (calls() - before) as usize;
        let at_rest = |setpoint: &Setpoint| setpoint.velocity == Axes::zeros();
        if inputs.hold && at_rest(&setpoint) && all.last().is_some_and(at_rest) {
            assert!(motion.is_at_rest(), "held in cycle {}", all.len());
        }
        all.push(setpoint);
        if setpoint.line == 2 && result.is_none() {
            moved.push(setpoint);
        }
        if result.is_none()
            && let Some(reported) = probings.result()
        {
            result = Some(reported);
            planner.set_position(&reported.stop_position);
            planner
                .push(
                    &feed_move(reported.stop_position, toward_next, order.feed_mm_s),
                    3,
                    1,
                )
                .expect("it begins where the axes stand");
            planner.finish(3).expect("taken");
        }
        assert!(
            all.len() < 200_000,
            "no end: {:?}, {:?}",
            motion.state(),
            all.last()
        );
    }
    assert_eq!(motion.fault(), None);
    assert_eq!(motion.state(), MotionState::Done);
    let end = all.last().expect("one").position;
    assert!((end - toward_next).abs().max() < 1e-9, "{end:?}");
    consume(queue);
    Outcome {
        result: result.expect("a result"),
        moved,
        all,
        contact_at,
        allocations,
    }
}

fn consume(queue: PlanConsumer) {
    drop(queue);
}

/// Uses only differences of the positions, independent of the code.
fn assert_within(all: &[Setpoint], machine: &Limits, period_ns: u64, what: &str) {
    let period = period_ns as f64 * 1e-9;
    // Rounding of positions, in each difference.
    let noise = 64.0 * f64::EPSILON * 200.0;
    for axis in 0..AXES {
        let of = |k: usize| all[k].position[axis];
        for k in 3..all.len() {
            let first = (of(k) - of(k - 1)) / period;
            let second = (of(k) - 2.0 * of(k - 1) + of(k - 2)) / period.powi(2);
            let third = (of(k) - 3.0 * of(k - 1) + 3.0 * of(k - 2) - of(k - 3)) / period.powi(3);
            assert!(
                first.abs() <= 1.001 * machine.velocity[axis] + noise / period,
                "{what}: velocity, cycle {k}"
            );
            assert!(
                second.abs() <= 1.001 * machine.acceleration[axis] + noise / period.powi(2),
                "{what}: acceleration {second}, cycle {k}"
            );
            // Nothing moves at the joint of exact-path mode, so the jerk is bounded everywhere.
            assert!(
                third.abs() <= 1.02 * machine.jerk[axis] + noise / period.powi(3),
                "{what}: jerk {third} of {}, axis {axis}, cycle {k}",
                machine.jerk[axis]
            );
        }
    }
}

#[test]
fn a_probing_move_stops_within_limits_and_goes_on() {
    let seed = 0x0b0b_0001;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    let mut met = [0; 5];
    for case in 0..60 {
        let rate = if case % 5 == 0 {
            35_000.0
        } else {
            random.log(250.0, 35_000.0)
        };
        let period_ns = (1e9 / rate).round() as u64;
        let machine = limits(&mut random);
        let kind = PLANNERS[case % 2];
        let direction = |random: &mut Random| {
            let mut direction = Axes::zeros();
            for axis in 0..3 {
                direction[axis] = random.between(-1.0, 1.0);
            }
            direction
        };
        let start = 20.0 * direction(&mut random);
        let from = start + 0.3 * direction(&mut random);
        let to = from + random.log(0.02, 2.0) * direction(&mut random);
        let order = ProbeMove {
            curve: line(from, to),
            feed_mm_s: random.log(4.0, 60.0),
            toward: random.unit() < 0.5,
        };
        // The duration of the move without contact, to place the worst moments in it.
        let free = run(machine, period_ns, kind, start, order, start, Scene::Never, 0..0);
        assert_eq!(free.result.verdict, ProbeVerdict::NoContact, "case {case}");
        assert!((free.result.stop_position - to).abs().max() < 1e-9);
        let moving = free
            .moved
            .windows(2)
            .filter(|pair| pair[0].position != pair[1].position)
            .count() as u64;
        let cycle = match case % 4 {
            0 => 1,
            1 => moving.saturating_sub(1).max(1),
            // While the axes stop at the end, or after that: drives lag behind.
            2 => moving + 1,
            _ => 1 + (random.unit() * moving as f64) as u64,
        };
        let scene = match case % 7 {
            0 => Scene::Lost(cycle),
            1 => Scene::Changes { cycle, lasts: 1 },
            5 if random.unit() < 0.5 => Scene::Before,
            5 => Scene::Silent,
            _ => Scene::Changes {
                cycle,
                lasts: u64::MAX / 2,
            },
        };
        let hold = if case % 3 == 0 { 2..40 } else { 0..0 };
        let what = format!("case {case}, {rate:.0} Hz, {kind:?}, {scene:?}");
        let next = from + 0.3 * direction(&mut random);
        let outcome = run(machine, period_ns, kind, start, order, next, scene, hold);
        assert_eq!(outcome.allocations, 0, "{what}");
        assert_within(&outcome.all, &machine, period_ns, &what);
        let result = outcome.result;
        let length = (to - from).norm();
        match scene {
            Scene::Changes { .. } => {
                met[0] += 1;
                assert_eq!(result.verdict, ProbeVerdict::Contact, "{what}");
                let contact = outcome.contact_at.expect("a contact");
                assert_eq!(result.position, contact, "{what}");
                // The distance after the contact: at most the computed one, and never beyond the end.
                let beyond = (result.stop_position - contact).norm();
                let max = order.stopping_distance(&machine) + 1e-9;
                assert!(beyond <= max, "{what}: {beyond} mm of {max}");
                assert!((result.stop_position - from).norm() <= length + 1e-9, "{what}");
            }
            Scene::Lost(_) => {
                met[1] += 1;
                assert_eq!(result.verdict, ProbeVerdict::Lost, "{what}");
            }
            Scene::Before => {
                met[2] += 1;
                assert_eq!(result.verdict, ProbeVerdict::ChangedBefore, "{what}");
                assert_eq!(result.stop_position, from, "{what}: nothing has moved");
            }
            Scene::Silent => {
                met[3] += 1;
                assert_eq!(result.verdict, ProbeVerdict::Unknown, "{what}");
                assert_eq!(result.stop_position, from, "{what}: nothing has moved");
            }
            Scene::Never => met[4] += 1,
        }
        // Always on the line.
        for setpoint in &outcome.moved {
            let along = (setpoint.position - from).dot(&(to - from)) / length;
            let off = (setpoint.position - from - (to - from) * (along / length)).norm();
            assert!(off < 1e-9, "{what}: {off} mm off the line");
        }
    }
    assert!(met[..4].iter().all(|&count| count > 0), "{met:?}");
}

/// The drives lag behind, and a contact by the move before must have been reported when this one begins.
#[test]
fn a_probing_move_begins_after_the_drives_have_settled() {
    let point = |x: f64| {
        let mut point = Axes::zeros();
        point[0] = x;
        point
    };
    let machine = equal_axes(1000.0, 500.0, 50_000.0);
    let order = ProbeMove {
        curve: line(point(1.0), point(3.0)),
        feed_mm_s: 5.0,
        toward: true,
    };
    let (period_ns, next) = (1_000_000, point(0.0));
    for hold in [0..0, 100..300] {
        let outcome = run(
            machine,
            period_ns,
            PLANNERS[0],
            point(0.0),
            order,
            next,
            Scene::Never,
            hold,
        );
        let xs: Vec<f64> = outcome.all.iter().map(|setpoint| setpoint.position[0]).collect();
        let waits = xs.iter().filter(|x| **x == 1.0).count();
        // A lead of 2 ms and 30 ms for the drives.
        assert!((32..40).contains(&waits), "{waits} ms");
    }
}

#[test]
fn a_probe_stop_takes_the_textbook_distance() {
    // From v with acceleration A and jerk J, if A is reached: v^2 / (2 A) + v A / (2 J).
    let machine = equal_axes(1000.0, 500.0, 50_000.0);
    let order = ProbeMove {
        curve: line(Axes::zeros(), {
            let mut to = Axes::zeros();
            to[0] = 100.0;
            to
        }),
        feed_mm_s: 20.0,
        toward: true,
    };
    let (v, a, j) = (20.0, 0.99 * 500.0, 0.99 * 50_000.0);
    let expected = v * v / (2.0 * a) + v * a / (2.0 * j);
    assert!((order.stopping_distance(&machine) - expected).abs() < 1e-9);
}

//! Threads and taps on simulated spindles with inertia, uneven speed, encoder and delay: phase, limits, and
//! failures of the spindle.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

mod taps;
mod threads;
mod travel_ends;

use std::f64::consts::TAU;

use evolvent_counting::calls;
use evolvent_machine::{Limits, PlannerKind, SignalSettings};
use evolvent_motion::{
    Inputs, MotionState, PathExecutor, Setpoint, TapReturn, ThreadLeg, ThreadObjection, ThreadPass,
    ThreadResult, ThreadVerdict, Threading, ThreadingSender, plan_queue,
};
use evolvent_path::{AXES, Axes, Curve, Line, Move, MoveKind, PathMode};
use evolvent_planner::{PathLimits, PathRules, Planner, Step};
use evolvent_signals::{InputImage, Signals, SpindleAngle, SpindleState};

use crate::common::{PLANNERS, Random, equal_axes, limits};

/// Interval at which a bridge reports the angle, s.
const SAMPLE_S: f64 = 1e-3;
const LEAD: u32 = 2;

/// A spindle whose angle is the integral of its speed in small steps.
#[derive(Clone, Copy, Debug)]
struct Spindle {
    rev_s: f64,
    /// Maximum rate of change of the speed, turns/s^2.
    torque: f64,
    ripple: f64,
    order: f64,
    counts: f64,
    delay_s: f64,
    /// Turns from rest to the index pulse.
    index: f64,
}

/// 600 rpm without ripple, from 0 within 0.3 s; its encoder has 4096 counts, and its angle is 1 ms old.
const EVEN: Spindle = Spindle {
    rev_s: 10.0,
    torque: 33.0,
    ripple: 0.0,
    order: 1.0,
    counts: 4096.0,
    delay_s: 0.001,
    index: 0.3,
};

/// Trouble of the spindle.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Trouble {
    None,
    /// Nothing is reported from this time on.
    Silent(f64),
    /// It slows down to a standstill from this time on.
    Stall(f64),
    /// Its speed falls by this amount, within its torque, at this time: a tool begins to cut. Negative values
    /// raise the speed: an override.
    Load(f64, f64),
    /// It does not turn back.
    Stubborn,
}

struct Track {
    /// True angle at each `STEP_S`.
    turns: Vec<f64>,
    speed: f64,
    wanted: f64,
}

const STEP_S: f64 = 2e-5;

impl Track {
    fn new(spindle: &Spindle) -> Self {
        Self {
            turns: vec![-spindle.index],
            speed: spindle.rev_s,
            wanted: spindle.rev_s,
        }
    }

    fn go_to(&mut self, time_s: f64, spindle: &Spindle, trouble: Trouble) {
        while (self.turns.len() as f64 - 1.0) * STEP_S < time_s {
            let now = (self.turns.len() as f64 - 1.0) * STEP_S;
            let wanted = match trouble {
                Trouble::Stall(at) if now >= at => 0.0,
                Trouble::Load(at, ratio) if now >= at => self.wanted * (1.0 - ratio),
                _ => self.wanted,
            };
            let max = spindle.torque * STEP_S;
            self.speed += (wanted - self.speed).clamp(-max, max);
            let last = *self.turns.last().expect("one");
            let even = 1.0 + spindle.ripple * (spindle.order * TAU * last).sin();
            self.turns.push(last + self.speed * even * STEP_S);
        }
    }

    /// The true angle, with linear interpolation between two steps.
    fn at(&self, time_s: f64) -> f64 {
        let at = (time_s / STEP_S).max(0.0);
        let low = (at as usize).min(self.turns.len() - 1);
        let high = (low + 1).min(self.turns.len() - 1);
        self.turns[low] + (at - low as f64) * (self.turns[high] - self.turns[low])
    }
}

struct Outcome {
    result: Option<ThreadResult>,
    all: Vec<Setpoint>,
    /// Numbers of the setpoints of the pass alone.
    pass: std::ops::Range<usize>,
    track: Track,
    allocations: usize,
    state: MotionState,
}

/// Drives one pass, and a move away from its end.
#[expect(clippy::too_many_arguments, reason = "a case is many things")]
fn run(
    machine: Limits,
    period_ns: u64,
    kind: PlannerKind,
    pass: &ThreadPass,
    spindle: &Spindle,
    trouble: Trouble,
    hold: std::ops::Range<f64>,
    stop_at: f64,
) -> Outcome {
    let period = period_ns as f64 * 1e-9;
    let (mut producer, mut queue) = plan_queue(|| unreachable!("no room"));
    let mut threadings: ThreadingSender = producer.take_threadings().expect("once");
    let rules = PathRules {
        blend_tolerance_mm: 0.01,
        joint_time_s: 0.001,
        planner: kind,
        feed_override: 1.0,
    };
    let chord = PathLimits::new(machine, 1.0 / period, 0.01);
    let mut planner = Planner::new(chord, rules, producer);
    let mut motion = PathExecutor::new(machine, period_ns, pass.start);
    let mut signals = Signals::new(&SignalSettings::default(), LEAD, period_ns);
    threadings
        .send(Box::new(Threading::new(pass.clone(), &machine)))
        .expect("room");
    planner.rest(&Step::Thread { line: 2 }).expect("room");
    planner.poll().expect("taken");
    let direction = pass.turns_per_s.signum();
    let mut track = Track::new(spindle);
    let (mut all, mut result) = (Vec::<Setpoint>::new(), None);
    let (mut sampled, mut allocations, mut actions, mut max_angle) = (0_u64, 0, 0, f64::NEG_INFINITY);
    let mut pass_end = 0;
    let mut image = InputImage::default();
    while !motion.is_over() {
        if result.is_none() {
            planner.poll().expect("taken");
        }
        let number = all.len();
        let computed_s = (number as f64 - f64::from(LEAD)) * period;
        // The spindle executes commands that are due.
        if let Some(tap) = pass.tap
            && actions > 0
            && trouble != Trouble::Stubborn
        {
            track.wanted = if actions == 1 {
                -tap.turns_per_s
            } else {
                spindle.rev_s
            };
        }
        let is_stopping = |last: &Setpoint| last.state == MotionState::Stopping;
        if pass.tap.is_some() && trouble != Trouble::Stubborn && all.last().is_some_and(is_stopping) {
            track.wanted = 0.0;
        }
        track.go_to(number as f64 * period, spindle, trouble);
        while sampled as f64 * SAMPLE_S + spindle.delay_s <= computed_s {
            let time_s = sampled as f64 * SAMPLE_S;
            sampled += 1;
            if matches!(trouble, Trouble::Silent(at) if time_s >= at) {
                continue;
            }
            let angle = direction * track.at(time_s);
            max_angle = f64::max(max_angle, angle.abs());
            image.set_spindle(
                0,
                Some(SpindleState {
                    indexed: track.at(time_s) > 0.0,
                    ..SpindleState::default()
                }),
            );
            image.angle = Some(SpindleAngle {
                cycle: time_s / period,
                // The middle of a count, as bridges report it.
                turns: ((angle * spindle.counts).floor() + 0.5) / spindle.counts,
            });
            signals.observe(&image);
        }
        let time_s = number as f64 * period;
        let inputs = Inputs {
            spindle: signals.spindle_at(number as u64),
            hold: hold.contains(&time_s),
            stop: time_s >= stop_at,
            ..Inputs::default()
        };
        let before = calls();
        let setpoint = motion.step(&inputs, &mut queue);
        allocations += (calls() - before) as usize;
        actions = setpoint.actions;
        all.push(setpoint);
        if result.is_none()
            && let Some(reported) = threadings.result()
        {
            result = Some(reported);
            pass_end = all.len();
            planner.set_position(&reported.stop_position);
            let mut away = reported.stop_position;
            away[0] += 3.0;
            let line = Line::new(reported.stop_position, away).expect("two points");
            let away = Move {
                curve: Curve::Line(line),
                kind: MoveKind::Rapid,
                feed_mm_s: f64::INFINITY,
                path_mode: PathMode::ExactPath,
            };
            planner.push(&away, 3, 1).expect("it begins where the axes stand");
            planner.finish(3).expect("taken");
        }
        assert!(
            (all.len() as f64) * period < 120.0,
            "no end: {:?}, {:?}",
            motion.state(),
            all.last()
        );
    }
    assert_eq!(motion.fault(), None);
    let moved = |k: usize| all[k].position != pass.start;
    let begin = (0..all.len()).find(|&k| moved(k)).unwrap_or(0);
    let state = motion.state();
    Outcome {
        result,
        pass: begin..pass_end.max(begin),
        all,
        track,
        allocations,
        state,
    }
}

/// A pass without holds, stops and trouble of the spindle.
fn undisturbed(
    machine: Limits,
    period_ns: u64,
    kind: PlannerKind,
    pass: &ThreadPass,
    spindle: &Spindle,
) -> Outcome {
    let (trouble, never) = (Trouble::None, f64::INFINITY);
    run(machine, period_ns, kind, pass, spindle, trouble, 0.0..0.0, never)
}

fn assert_within(all: &[Setpoint], machine: &Limits, period_ns: u64, what: &str) {
    let period = period_ns as f64 * 1e-9;
    let noise = 64.0 * f64::EPSILON * 200.0;
    for axis in 0..AXES {
        let of = |k: usize| all[k].position[axis];
        for k in 0..all.len() {
            assert!(
                of(k) >= machine.travel_min[axis] - 1e-6 && of(k) <= machine.travel_max[axis] + 1e-6,
                "{what}: position {}, axis {axis}, cycle {k}",
                of(k)
            );
        }
        for k in 3..all.len() {
            let first = (of(k) - of(k - 1)) / period;
            let second = (of(k) - 2.0 * of(k - 1) + of(k - 2)) / period.powi(2);
            let third = (of(k) - 3.0 * of(k - 1) + 3.0 * of(k - 2) - of(k - 3)) / period.powi(3);
            assert!(
                first.abs() <= 1.001 * machine.velocity[axis] + noise / period,
                "{what}: velocity {first}, axis {axis}, cycle {k}"
            );
            assert!(
                second.abs() <= 1.001 * machine.acceleration[axis] + noise / period.powi(2),
                "{what}: acceleration {second}, axis {axis}, cycle {k}"
            );
            assert!(
                third.abs() <= 1.02 * machine.jerk[axis] + noise / period.powi(3),
                "{what}: jerk {third} of {}, axis {axis}, cycle {k}",
                machine.jerk[axis]
            );
        }
    }
}

fn straight(pitch: f64, length: f64, rev_s: f64) -> ThreadPass {
    let mut end = Axes::zeros();
    end[2] = -length;
    ThreadPass {
        start: Axes::zeros(),
        legs: [ThreadLeg {
            end,
            turns: length / pitch,
            line: 2,
        }]
        .into(),
        start_turns: 0.0,
        turns_per_s: rev_s,
        tap: None,
        chord_error_mm: 0.001,
        max_angle_age_s: 0.02,
        clear_at: None,
    }
}

/// Maximum error between run-in and run-out, mm, relative to the true angle and a thread that begins at a
/// whole turn; and that turn.
fn phase_error(
    outcome: &Outcome,
    pass: &ThreadPass,
    pitch: f64,
    run_in_mm: f64,
    period_ns: u64,
) -> (f64, f64) {
    let period = period_ns as f64 * 1e-9;
    let length = pass.legs[0].turns * pitch;
    let (mut worst, mut origin) = (0.0_f64, f64::NAN);
    for k in outcome.pass.clone() {
        let along = -outcome.all[k].position[2];
        if along < run_in_mm || along > length - run_in_mm {
            continue;
        }
        let turns = outcome.track.at(k as f64 * period) - pass.start_turns - along / pitch;
        if origin.is_nan() {
            origin = turns.round();
        }
        worst = worst.max((turns - origin).abs() * pitch);
    }
    assert!(!origin.is_nan(), "nothing is in phase");
    (worst, origin)
}

/// A medium-sized lathe.
fn lathe() -> Limits {
    equal_axes(300.0, 4000.0, 100_000.0)
}

//! Threads on simulated spindles of inertia, uneven speed, encoder and delay: phase, limits, and what happens when the spindle fails.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::f64::consts::TAU;

use evolvent_counting::calls;
use evolvent_machine::{Limits, PlannerKind, SignalSettings};
use evolvent_motion::{
    Inputs, PathExecutor, Setpoint, State, TapReturn, ThreadLeg, ThreadObjection, ThreadPass, ThreadResult,
    ThreadVerdict, Threading, ThreadingSender, plan_queue,
};
use evolvent_path::{AXES, Axes, Curve, Line, Move, MoveKind, PathMode};
use evolvent_planner::{PathLimits, PathRules, Planner, Step};
use evolvent_signals::{InputImage, Signals, SpindleAngle, SpindleState};

use crate::common::{PLANNERS, Random, equal_axes, limits};

/// How often a bridge tells the angle, s.
const SAMPLE_S: f64 = 1e-3;
const LEAD: u32 = 2;

/// A spindle whose angle is the integral of its speed in small steps.
#[derive(Clone, Copy, Debug)]
struct Spindle {
    rev_s: f64,
    /// Speed changes by so much at most, turns/s^2.
    torque: f64,
    ripple: f64,
    order: f64,
    counts: f64,
    delay_s: f64,
    /// Turns from rest to the index pulse.
    index: f64,
}

/// What happens to it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Trouble {
    None,
    /// Nothing is told from this time on.
    Silent(f64),
    /// It slows down to a standstill from this time on.
    Stall(f64),
    /// Its speed sinks by so much within its torque at this time: a tool begins to cut. Below 0 it rises: an override.
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
            let most = spindle.torque * STEP_S;
            self.speed += (wanted - self.speed).clamp(-most, most);
            let last = *self.turns.last().expect("one");
            let even = 1.0 + spindle.ripple * (spindle.order * TAU * last).sin();
            self.turns.push(last + self.speed * even * STEP_S);
        }
    }

    /// The true angle, between two steps by the straight line.
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
    /// Of the pass alone: number of the setpoint.
    pass: std::ops::Range<usize>,
    track: Track,
    allocations: usize,
    state: State,
}

/// Drives one pass, and away from where it ends.
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
    let way = pass.turns_per_s.signum();
    let mut track = Track::new(spindle);
    let (mut all, mut result) = (Vec::<Setpoint>::new(), None);
    let (mut sampled, mut allocations, mut actions, mut seen) = (0_u64, 0, 0, f64::NEG_INFINITY);
    let mut pass_end = 0;
    let mut image = InputImage::default();
    while !motion.is_over() {
        if result.is_none() {
            planner.poll().expect("taken");
        }
        let number = all.len();
        let computed_s = (number as f64 - f64::from(LEAD)) * period;
        // The spindle obeys what has been due.
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
        track.go_to(number as f64 * period, spindle, trouble);
        while sampled as f64 * SAMPLE_S + spindle.delay_s <= computed_s {
            let time_s = sampled as f64 * SAMPLE_S;
            sampled += 1;
            if matches!(trouble, Trouble::Silent(at) if time_s >= at) {
                continue;
            }
            let angle = way * track.at(time_s);
            seen = f64::max(seen, angle.abs());
            image.set_spindle(
                0,
                Some(SpindleState {
                    indexed: track.at(time_s) > 0.0,
                    ..SpindleState::default()
                }),
            );
            image.angle = Some(SpindleAngle {
                cycle: time_s / period,
                turns: (angle * spindle.counts).floor() / spindle.counts,
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
            && let Some(told) = threadings.result()
        {
            result = Some(told);
            pass_end = all.len();
            planner.set_position(&told.stands_at);
            let mut away = told.stands_at;
            away[0] += 3.0;
            let line = Line::new(told.stands_at, away).expect("two points");
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

fn assert_within(all: &[Setpoint], machine: &Limits, period_ns: u64, what: &str) {
    let period = period_ns as f64 * 1e-9;
    let noise = 64.0 * f64::EPSILON * 200.0;
    for axis in 0..AXES {
        let of = |k: usize| all[k].position[axis];
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
        clear_at: None,
    }
}

/// Largest error between run-in and run-out, mm, against the true angle and a thread that begins at a whole turn; and that turn.
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

/// A lathe of middling size.
fn lathe() -> Limits {
    equal_axes(300.0, 4000.0, 100_000.0)
}

#[test]
fn a_thread_is_in_phase_on_uneven_spindles_at_any_speed() {
    let mut worst_of_all: f64 = 0.0;
    for rpm in [100.0, 600.0, 1500.0, 3000.0] {
        for (order, ripple) in [(1.0, 0.02), (2.0, 0.02), (3.0, 0.02), (1.0, 0.0)] {
            for delay_s in [0.0, 0.004] {
                let (pitch, counts) = (1.5, 4096.0);
                let spindle = Spindle {
                    rev_s: rpm / 60.0,
                    torque: 2000.0 / 60.0,
                    ripple,
                    order,
                    counts,
                    delay_s,
                    index: 0.3,
                };
                let pass = straight(pitch, 30.0, spindle.rev_s);
                let run_in = pass.check(&lathe(), 1e-3).expect("room");
                let outcome = run(
                    lathe(),
                    1_000_000,
                    PlannerKind::Optimal,
                    &pass,
                    &spindle,
                    Trouble::None,
                    0.0..0.0,
                    f64::INFINITY,
                );
                let what = format!("{rpm} rpm, order {order}, ripple {ripple}, delay {delay_s} s");
                assert_eq!(outcome.allocations, 0, "{what}");
                assert_eq!(outcome.state, State::Done, "{what}");
                let result = outcome.result.expect("a result");
                assert_eq!(result.verdict, ThreadVerdict::Done, "{what}");
                assert_eq!(result.stands_at[2], -30.0, "{what}");
                assert_within(&outcome.all, &lathe(), 1_000_000, &what);
                let (error, _) = phase_error(&outcome, &pass, pitch, run_in, 1_000_000);
                println!("{what}: {:.2} um", error * 1e3);
                worst_of_all = worst_of_all.max(error);
                // What of the ripple no axis can follow: its jerk, of which a part is left for it.
                let amplitude = pitch * ripple / (TAU * order);
                let rate = TAU * order * spindle.rev_s;
                let left_out = (amplitude - 0.3 * 100_000.0 / rate.powi(3)).max(0.0);
                let most = (0.002 + pitch / counts).max(left_out + 0.001);
                assert!(error <= most, "{what}: {error} mm");
            }
        }
    }
    println!("worst: {:.2} um", worst_of_all * 1e3);
}

#[test]
fn passes_at_other_speeds_and_after_holds_lie_in_the_same_groove() {
    let mut random = Random::from_state(0x7ead_0001);
    for case in 0..12 {
        let rev_s = random.log(1.0, 60.0);
        let spindle = Spindle {
            rev_s,
            torque: 33.0,
            ripple: 0.01,
            order: 1.0,
            counts: 4096.0,
            delay_s: 0.002,
            index: random.unit(),
        };
        let pass = ThreadPass {
            // Two starts.
            start_turns: 0.5 * f64::from(case % 2),
            turns_per_s: if case % 3 == 0 { -rev_s } else { rev_s },
            ..straight(1.25, 40.0, rev_s)
        };
        let run_in = pass.check(&lathe(), 1e-3).expect("room");
        // A hold in the middle of the pass has the machine stand after it; one before it waits.
        let hold = if case % 4 == 1 { 0.0..3.0 } else { 0.0..0.05 };
        let outcome = run(
            lathe(),
            1_000_000,
            PLANNERS[case as usize % 2],
            &pass,
            &spindle,
            Trouble::None,
            hold,
            f64::INFINITY,
        );
        assert_eq!(outcome.state, State::Done, "case {case}");
        let (error, _) = phase_error(&outcome, &pass, 1.25, run_in, 1_000_000);
        assert!(error < 0.0025, "case {case}, {rev_s} turns/s: {error}");
    }
}

#[test]
fn a_tool_that_begins_to_cut_slows_the_spindle_and_the_thread_follows() {
    let spindle = Spindle {
        rev_s: 20.0,
        torque: 10.0,
        ripple: 0.005,
        order: 1.0,
        counts: 4096.0,
        delay_s: 0.002,
        index: 0.3,
    };
    let pass = straight(2.0, 60.0, 20.0);
    let run_in = pass.check(&lathe(), 1e-3).expect("room");
    let outcome = run(
        lathe(),
        1_000_000,
        PlannerKind::Optimal,
        &pass,
        &spindle,
        Trouble::Load(0.8, 0.05),
        0.0..0.0,
        f64::INFINITY,
    );
    assert_eq!(outcome.result.expect("a result").verdict, ThreadVerdict::Done);
    assert_within(&outcome.all, &lathe(), 1_000_000, "load");
    let (error, _) = phase_error(&outcome, &pass, 2.0, run_in, 1_000_000);
    println!("load step: {:.2} um", error * 1e3);
    // Its speed sinks by 10 turns/s^2 without a warning: 5 ms until the first sample of it counts, and as long again until it
    // stands out of the encoder's steps, are 2 mm * 10 / 2 * (10 ms)^2 = 1 um; the follower has its share.
    assert!(error < 0.005, "{error}");
}

#[test]
fn random_threads_keep_every_limit_whatever_the_spindle_does() {
    let seed = 0x7ead_0002;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    let mut met = [0; 5];
    let mut drawn_out = 0;
    for case in 0..80 {
        let rate = if case % 8 == 0 {
            35_000.0
        } else {
            random.log(250.0, 8000.0)
        };
        let period_ns = (1e9 / rate).round() as u64;
        let machine = limits(&mut random);
        let rev_s = random.log(0.8, 60.0);
        let pitch = random.log(0.2, 6.0);
        let spindle = Spindle {
            rev_s,
            torque: random.log(5.0, 700.0),
            ripple: random.between(0.0, 0.03),
            order: 1.0 + random.pick(4) as f64,
            counts: random.log(100.0, 100_000.0).round(),
            delay_s: random.between(0.0, 0.006),
            index: random.unit(),
        };
        let mut pass = straight(pitch, pitch * random.between(4.0, 20.0), rev_s);
        if case % 3 == 0 {
            // Tapered, and then back out.
            let mut end = pass.legs[0].end;
            end[0] = random.between(-1.0, 1.0);
            let second = ThreadLeg {
                end: end * 1.3 + Axes::from_fn(|axis, _| if axis == 0 { 1.0 } else { 0.0 }),
                turns: 5.0,
                line: 3,
            };
            let first = ThreadLeg { end, ..pass.legs[0] };
            pass.legs = [first, second].into();
        }
        if case % 2 == 0 {
            pass.clear_at = Some((0, random.between(-8.0, 8.0)));
        }
        let trouble = match case % 5 {
            0 => Trouble::Silent(random.between(0.0, 6.0 / rev_s + 1.0)),
            1 => Trouble::Stall(random.between(0.0, 6.0 / rev_s + 1.0)),
            2 => Trouble::Load(random.between(0.5, 2.0), random.between(0.0, 0.3)),
            _ => Trouble::None,
        };
        let stop_at = if case % 7 == 3 {
            random.between(0.0, 4.0 / rev_s + 1.0)
        } else {
            f64::INFINITY
        };
        let what =
            format!("case {case}, {rate:.0} Hz, {pitch:.2} mm, {spindle:?}, {trouble:?}, stop {stop_at}");
        let kind = PLANNERS[case % 2];
        let outcome = run(
            machine,
            period_ns,
            kind,
            &pass,
            &spindle,
            trouble,
            0.0..0.0,
            stop_at,
        );
        assert_eq!(outcome.allocations, 0, "{what}");
        assert_within(&outcome.all, &machine, period_ns, &what);
        let fits = pass.check(&machine, period_ns as f64 * 1e-9);
        let (stands_at, gave_up) = match outcome.result {
            None => (outcome.all.last().expect("setpoints").position, true),
            Some(result) => {
                use ThreadVerdict::{Lost, OutOfPhase, Stalled};
                let gave_up = matches!(result.verdict, Lost | Stalled | OutOfPhase);
                (result.stands_at, gave_up)
            }
        };
        if let Some((axis, clear)) = pass.clear_at
            && gave_up
            && stands_at != pass.start
        {
            drawn_out += 1;
            assert_eq!(stands_at[axis], clear, "{what}");
            assert!(outcome.result.is_none_or(|result| result.is_clear), "{what}");
        }
        match outcome.result.map(|result| result.verdict) {
            None => {
                met[0] += 1;
                assert_eq!(outcome.state, State::Stopped, "{what}");
            }
            Some(ThreadVerdict::Done) => met[1] += 1,
            Some(ThreadVerdict::Refused(_)) => {
                met[2] += 1;
                // What just fits may not at the speed of the moment, and the other way round.
                let near = ThreadPass {
                    turns_per_s: 1.1 * pass.turns_per_s,
                    ..pass.clone()
                };
                assert!(
                    fits.is_err() || near.check(&machine, period_ns as f64 * 1e-9).is_err(),
                    "{what}"
                );
                let moved = &outcome.all[..outcome.pass.end];
                let stands = outcome.result.expect("one").stands_at;
                assert!(
                    moved.is_empty() || stands == pass.start,
                    "{what}: nothing has moved"
                );
            }
            Some(ThreadVerdict::Lost | ThreadVerdict::Unknown) => {
                met[3] += 1;
                // Of a spindle that stands before its index pulse has come the angle stays unknown as well.
                assert!(
                    matches!(trouble, Trouble::Silent(_) | Trouble::Stall(_)),
                    "{what}"
                );
            }
            Some(ThreadVerdict::Stalled | ThreadVerdict::OutOfPhase) => met[4] += 1,
            Some(ThreadVerdict::NotTurnedBack) => unreachable!("{what}: no tap"),
        }
    }
    println!("{met:?}, drawn out {drawn_out}");
    assert!(drawn_out > 2, "{drawn_out}");
    assert!(met.iter().all(|&count| count > 0), "{met:?}");
}

#[test]
fn a_tap_goes_in_and_out_in_phase_and_stops_at_its_depth() {
    for rpm in [100.0, 1000.0] {
        let rev_s = rpm / 60.0;
        let torque = 2000.0 / 60.0;
        let spindle = Spindle {
            rev_s,
            torque,
            ripple: 0.01,
            order: 1.0,
            counts: 4096.0,
            delay_s: 0.002,
            index: 0.3,
        };
        let pass = ThreadPass {
            tap: Some(TapReturn {
                turns_per_s: 1.5 * rev_s,
                braking: Some(torque),
            }),
            ..straight(1.0, 15.0, rev_s)
        };
        let outcome = run(
            lathe(),
            1_000_000,
            PlannerKind::Optimal,
            &pass,
            &spindle,
            Trouble::None,
            0.0..0.0,
            f64::INFINITY,
        );
        let result = outcome.result.expect("a result");
        assert_eq!(result.verdict, ThreadVerdict::Done);
        assert_eq!(result.stands_at, pass.start);
        assert_eq!(outcome.all.last().expect("one").actions, 2);
        assert_within(&outcome.all, &lathe(), 1_000_000, "tap");
        let run_in = pass.check(&lathe(), 1e-3).expect("room");
        let (mut worst, mut worst_turning, mut deepest) = (0.0_f64, 0.0_f64, 0.0_f64);
        let (mut origin, mut turned_at) = (f64::NAN, 0);
        for k in outcome.pass.clone() {
            let depth = -outcome.all[k].position[2];
            deepest = deepest.max(depth);
            let is_turning = (outcome.all[k].velocity[2] + rev_s).abs() > 0.03 * rev_s
                && (outcome.all[k].velocity[2] - 1.5 * rev_s).abs() > 0.03 * rev_s;
            // Out of the hole it is faster, and its run-out longer.
            if depth > 2.5 * run_in {
                let turns = outcome.track.at(k as f64 * 1e-3) - depth;
                if origin.is_nan() {
                    origin = turns.round();
                }
                let error = (turns - origin).abs();
                worst_turning = worst_turning.max(error);
                if is_turning {
                    turned_at = k;
                } else if k > turned_at + 50 && turned_at > 0 {
                    // In, the spindle is even for long; out, it has its speed again for 50 ms.
                    worst = worst.max(error);
                }
            }
        }
        println!(
            "{rpm} rpm: worst {:.2} um, {:.2} um while it turns back, depth {deepest:.4} mm",
            worst * 1e3,
            worst_turning * 1e3
        );
        assert!(worst <= 0.003, "{rpm} rpm: {worst} mm");
        assert!(worst_turning <= 0.006, "{rpm} rpm: {worst_turning} mm");
        // By the ripple at the end, and the time that the order takes.
        assert!((deepest - 15.0).abs() < 0.02 * rev_s, "{deepest}");
    }
}

#[test]
fn a_lost_angle_ends_a_pass_where_it_is_and_not_before_the_index_pulse_does_one_begin() {
    let spindle = Spindle {
        rev_s: 10.0,
        torque: 33.0,
        ripple: 0.0,
        order: 1.0,
        counts: 4096.0,
        delay_s: 0.001,
        // Its angle is told for half a second before it means anything.
        index: 5.3,
    };
    let pass = straight(1.5, 60.0, 10.0);
    let drive = |trouble| {
        let kind = PLANNERS[0];
        let (hold, never) = (0.0..0.0, f64::INFINITY);
        run(lathe(), 1_000_000, kind, &pass, &spindle, trouble, hold, never)
    };
    let outcome = drive(Trouble::None);
    assert_eq!(outcome.result.expect("a result").verdict, ThreadVerdict::Done);
    assert!(outcome.track.at(outcome.pass.start as f64 * 1e-3) > 0.0);
    let outcome = drive(Trouble::Silent(2.0));
    let result = outcome.result.expect("a result");
    assert_eq!(result.verdict, ThreadVerdict::Lost);
    // 15 mm/s: 0.1 s until inputs are too old, and the stop.
    let silent_at = outcome.all[2000].position[2];
    let farther = silent_at - result.stands_at[2];
    assert!((1.0..3.0).contains(&farther), "{farther} mm");
    assert_within(&outcome.all, &lathe(), 1_000_000, "lost");
}

#[test]
fn a_tap_whose_spindle_does_not_turn_back_stops() {
    for braking in [None, Some(33.0)] {
        let spindle = Spindle {
            rev_s: 10.0,
            torque: 33.0,
            ripple: 0.0,
            order: 1.0,
            counts: 4096.0,
            delay_s: 0.001,
            index: 0.3,
        };
        let pass = ThreadPass {
            tap: Some(TapReturn {
                turns_per_s: 10.0,
                braking,
            }),
            ..straight(1.0, 15.0, 10.0)
        };
        let outcome = run(
            lathe(),
            1_000_000,
            PlannerKind::Classic,
            &pass,
            &spindle,
            Trouble::Stubborn,
            0.0..0.0,
            f64::INFINITY,
        );
        let result = outcome.result.expect("a result");
        assert_eq!(result.verdict, ThreadVerdict::NotTurnedBack);
        // Two turns and the way of its braking, or half a second, and the stop.
        assert!((-23.0..-15.0).contains(&result.stands_at[2]), "{result:?}");
        assert_within(&outcome.all, &lathe(), 1_000_000, "stubborn");
    }
}

#[test]
fn an_override_of_the_spindle_in_a_pass_is_followed_in_phase() {
    for change in [-0.3, 0.3] {
        let spindle = Spindle {
            rev_s: 15.0,
            torque: 20.0,
            ripple: 0.005,
            order: 1.0,
            counts: 4096.0,
            delay_s: 0.001,
            index: 0.3,
        };
        let pass = straight(2.0, 60.0, 15.0);
        // In phase at the faster of both speeds.
        let fast = ThreadPass {
            turns_per_s: 20.0,
            ..pass.clone()
        };
        let run_in = fast.check(&lathe(), 1e-3).expect("room");
        let outcome = run(
            lathe(),
            1_000_000,
            PlannerKind::Optimal,
            &pass,
            &spindle,
            Trouble::Load(0.6, -change),
            0.0..0.0,
            f64::INFINITY,
        );
        let result = outcome.result.expect("a result");
        assert_eq!(
            (result.verdict, result.stands_at[2]),
            (ThreadVerdict::Done, -60.0)
        );
        assert_within(&outcome.all, &lathe(), 1_000_000, "override");
        let (error, _) = phase_error(&outcome, &pass, 2.0, run_in, 1_000_000);
        println!("override by {change}: {:.2} um", error * 1e3);
        // The run-out of the faster spindle is wider: the axes can follow it.
        assert!(result.worst_mm < 0.01, "{}", result.worst_mm);
        assert!(error < 0.008, "{error}");
    }
}

#[test]
fn what_cannot_be_cut_is_refused_at_rest() {
    let pass = straight(2.0, 5.0, 50.0);
    let Err(ThreadObjection::TooShort {
        run_in_mm, length_mm, ..
    }) = pass.check(&lathe(), 1e-3)
    else {
        unreachable!("100 mm/s cannot be reached and left within 5 mm")
    };
    // 105 mm/s for the reserve: 26 mm/s^2... by the jerk, two boxes of sqrt(105 / 60000) s.
    let expected = 105.0 * (105.0_f64 / 60_000.0).sqrt();
    assert!(
        (run_in_mm - expected).abs() < 1e-9 && length_mm == 5.0,
        "{run_in_mm}"
    );
}

//! Random sequences of jogs, increments, stops and keep-alives: operator and cycle on one thread, in
//! simulated time.

use std::sync::mpsc::channel;

use evolvent_bus::ControlRequest;
use evolvent_control::{Alarm, CommandCode, JobResult};
use evolvent_motion::Setpoint;
use evolvent_path::{Axes, AxisMask};
use evolvent_random::{Random, cases};

use super::bench::Bench;
use super::operator::Job;
use crate::news::{ExternalEventKind, FeederEvent};

/// Cycles within which a programmed speed is reached or an axis stops: from 500 mm/s at 3000 mm/s2 and its
/// jerk, plus the time until a change is applied, including one that was too late at first.
const SETTLES: u64 = 450;
/// Cycles without a keep-alive after which a continuous jog starts to stop.
const PATIENCE: u64 = 90;

/// The demands on one axis since all axes were last at rest.
#[derive(Clone, Copy, Debug, Default)]
struct Requested {
    /// Highest programmed speed so far; 0 if none.
    top: f64,
    /// Last programmed speed; 0 if the axis is to stop.
    last: f64,
    /// Range of positions that the increments permit, if only increments moved the axis.
    goal: Option<f64>,
    /// Tolerance of `goal` for increments that began in motion.
    slack: f64,
    lowest: f64,
    highest: f64,
}

impl Requested {
    /// The axis stays between the present bounds and `goal`, each with the slack.
    fn widen(&mut self, position: f64) {
        if let Some(goal) = self.goal {
            self.lowest = self.lowest.min(goal.min(position) - self.slack);
            self.highest = self.highest.max(goal.max(position) + self.slack);
        }
    }
}

/// A trial, one motion from rest to rest: the jogs of several clients, and what they demand of each axis.
struct JogTrial {
    number: usize,
    begun: u64,
    requested: [Requested; 3],
    /// Number of further jogs.
    left: usize,
    /// Of the present jog: whether it is an increment, its client, whether its dead-man switch is held, and the
    /// time of its last keep-alive.
    is_increment: bool,
    client: u64,
    is_held: bool,
    alive_at: u64,
    changed_at: u64,
    stop_at: Option<u64>,
    /// Number of jogs that replaced another.
    taken_over: u32,
    log: Vec<String>,
}

impl JogTrial {
    fn new(number: usize, bench: &Bench, random: &mut Random) -> Self {
        let here = bench.operator.view.setpoint.position;
        let mut requested = [Requested::default(); 3];
        for (i, axis) in requested.iter_mut().enumerate() {
            (axis.lowest, axis.highest) = (here[i], here[i]);
        }
        Self {
            number,
            begun: bench.now,
            requested,
            left: random.below(6),
            is_increment: false,
            client: 0,
            is_held: false,
            alive_at: 0,
            changed_at: bench.now,
            stop_at: None,
            taken_over: 0,
            log: Vec::new(),
        }
    }

    /// Runs until the axes are at rest; `None` if the first jog was rejected.
    fn run(&mut self, bench: &mut Bench, random: &mut Random) -> Option<JobResult> {
        if !self.jog(bench, random) {
            return None;
        }
        loop {
            self.keep_alive(bench, random);
            self.may_stop(bench, random);
            // Occasionally the control thread sleeps for longer than the lead of a change.
            let cycles = if random.below(25) == 0 {
                20
            } else {
                1 + random.below(6) as u64
            };
            for setpoint in bench.runs(cycles) {
                self.check(&setpoint, bench.now);
            }
            bench.ticks();
            if matches!(bench.operator.job, Job::None) {
                return Some(bench.operator.state.result());
            }
            let (number, log) = (self.number, &self.log);
            assert!(
                bench.now < self.begun + 60_000,
                "motion {number} does not end: {log:?}"
            );
            if self.left > 0 && random.below(12) == 0 {
                self.left -= 1;
                self.jog(bench, random);
            }
        }
    }

    /// A random jog of a random client. Returns whether it is accepted.
    fn jog(&mut self, bench: &mut Bench, random: &mut Random) -> bool {
        let who = 1 + random.below(3) as u64;
        let was_moving = !matches!(bench.operator.job, Job::None);
        let mut jog = bench.command(CommandCode::Jog);
        let adds = random.below(2) == 0;
        (jog.index, jog.amount) = (u32::from(adds), random.log(1.0, 400.0));
        jog.axes_mask = 1 << random.below(3);
        if random.below(6) == 0 {
            jog.axes_mask |= 1 << random.below(3);
        }
        for i in AxisMask::from_bits(jog.axes_mask).axes() {
            let sign = if random.below(2) == 0 { 1.0 } else { -1.0 };
            jog.values[i] = sign * if adds { random.log(0.01, 40.0) } else { 1.0 };
        }
        // The operator does not know this state yet.
        let at = bench.last;
        // A jog of this axis may be on its way to the cycle.
        let is_pending = was_moving && bench.now < self.changed_at + 60;
        if !bench.says(who, jog) {
            return false;
        }
        self.taken_over += u32::from(was_moving);
        self.log.push(format!(
            "{} ms: {who} {:?} {:?} at {}",
            bench.now - self.begun,
            &jog.values[..3],
            jog.index,
            jog.amount
        ));
        (self.client, self.is_held, self.alive_at) = (who, !adds, bench.now);
        self.changed_at = bench.now;
        self.demand(&jog, &at, &bench.operator.limits.velocity, is_pending);
        self.is_increment = adds;
        true
    }

    /// What an accepted jog demands of each axis, which is at `at`.
    fn demand(&mut self, jog: &ControlRequest, at: &Setpoint, limits: &Axes, is_pending: bool) {
        let adds = jog.index == 1;
        let continues = adds && self.is_increment;
        for (i, axis) in self.requested.iter_mut().enumerate() {
            let named = jog.axes_mask >> i & 1 == 1;
            if named {
                axis.last = jog.amount.min(limits[i]);
                axis.top = axis.top.max(axis.last);
            } else if !continues {
                axis.last = 0.0;
            }
            if named && adds {
                let base = axis.goal.filter(|_| continues).unwrap_or_else(|| {
                    // Where the axis stops, and how far it moves until the order is applied.
                    let v = axis.top.max(at.velocity[i].abs());
                    let moving = is_pending || at.velocity[i] != 0.0 || at.acceleration[i] != 0.0;
                    axis.slack = if moving {
                        v * (v / 3000.0 + 0.1 + 0.1)
                    } else {
                        1e-6
                    };
                    at.position[i]
                });
                axis.goal = Some(base + jog.values[i]);
            } else if !continues {
                axis.goal = None;
                if named {
                    (axis.lowest, axis.highest) = (f64::NEG_INFINITY, f64::INFINITY);
                }
            }
            axis.widen(at.position[i]);
        }
    }

    /// The client may hold its dead-man switch, or another may send a keep-alive, which has no effect.
    fn keep_alive(&mut self, bench: &mut Bench, random: &mut Random) {
        if self.is_held && random.below(80) == 0 {
            self.is_held = false;
        }
        if self.is_held && random.below(5) == 0 {
            let keep = bench.command(CommandCode::JogKeep);
            bench.says(self.client, keep);
            self.alive_at = bench.now;
        } else if random.below(10) == 0 {
            let keep = bench.command(CommandCode::JogKeep);
            bench.says(9, keep);
        }
    }

    fn may_stop(&mut self, bench: &mut Bench, random: &mut Random) {
        if random.below(200) == 0 {
            let stop = bench.command(CommandCode::JogStop);
            bench.says(7, stop);
            self.stop_at.get_or_insert(bench.now);
            self.left = 0;
            self.is_held = false;
        }
    }

    /// Speed, position and standstill of each axis.
    fn check(&self, setpoint: &Setpoint, now: u64) {
        let (number, moment, log) = (self.number, now - self.begun, &self.log);
        for (i, axis) in self.requested.iter().enumerate() {
            let (speed, at) = (setpoint.velocity[i].abs(), setpoint.position[i]);
            let bound = |speed: f64| speed * (1.0 + 1e-3) + 1e-6;
            assert!(
                speed <= bound(axis.top),
                "motion {number}: axis {i} at {speed} mm/s, asked for {axis:?}, {moment} ms: {log:?}"
            );
            if now > self.changed_at + SETTLES {
                assert!(
                    speed <= bound(axis.last),
                    "motion {number}: axis {i} still at {speed} mm/s, asked for {axis:?}, {moment} ms: {log:?}"
                );
            }
            assert!(
                (axis.lowest..=axis.highest).contains(&at),
                "motion {number}: axis {i} at {at} mm, asked for {axis:?}, {moment} ms: {log:?}"
            );
            let is_dead = !self.is_increment && now > self.alive_at + PATIENCE + SETTLES;
            let is_stopped = self.stop_at.is_some_and(|stop_at| now > stop_at + SETTLES);
            assert!(
                speed == 0.0 || !(is_dead || is_stopped),
                "motion {number}: axis {i} at {speed} mm/s without a dead man, {moment} ms: {log:?}"
            );
        }
    }

    /// The axes are at rest; after an increment they are at its goal.
    fn check_end(&self, end: &Setpoint, is_done: bool) {
        let (number, log) = (self.number, &self.log);
        assert!(
            end.velocity == Axes::zeros(),
            "motion {number} has ended and moves: {log:?}"
        );
        for (i, axis) in self.requested.iter().enumerate() {
            if let Some(goal) = axis.goal.filter(|_| is_done) {
                let off = (end.position[i] - goal).abs();
                assert!(
                    off <= axis.slack,
                    "motion {number}: axis {i} ends {off} mm off, {axis:?}: {log:?}"
                );
            }
        }
    }
}

#[test]
fn random_jogs_keep_speed_distance_and_dead_man() {
    let mut random = Random::seeded(2313);
    let mut bench = Bench::new();
    let (mut taken_over, mut stopped_by_dead_man, mut increments_done) = (0, 0, 0);
    for number in 0..cases(400) {
        let mut motion = JogTrial::new(number, &bench, &mut random);
        let Some(result) = motion.run(&mut bench, &mut random) else {
            continue;
        };
        let is_done = motion.is_increment && result == JobResult::Done;
        motion.check_end(&bench.operator.view.setpoint, is_done);
        taken_over += motion.taken_over;
        let is_dead_man = result == JobResult::Stopped && !motion.is_increment && motion.stop_at.is_none();
        stopped_by_dead_man += u32::from(is_dead_man);
        increments_done += u32::from(is_done);
        bench.runs(20);
        bench.ticks();
    }
    // Otherwise the test proves nothing.
    assert!(
        taken_over > 100 && stopped_by_dead_man > 30 && increments_done > 30,
        "{taken_over} {stopped_by_dead_man} {increments_done}"
    );
}

/// Includes a jog that replaces one in progress, and one that is replaced before the cycle applies it.
#[test]
fn each_jog_is_recorded_once() {
    let mut bench = Bench::new();
    let (recorder, recorded) = channel();
    bench.operator.book.recorder = Some(recorder);
    let mut jog = bench.command(CommandCode::Jog);
    (jog.index, jog.axes_mask, jog.amount) = (1, 1, 20.0);
    for distance in [1.0, 2.0, 3.0, 4.0] {
        jog.values[0] = distance;
        assert_eq!(bench.reply(1, jog), None);
        if distance < 2.0 {
            bench.runs_and_ticks(20);
        }
    }
    bench.runs_and_ticks(2000);
    assert!(matches!(bench.operator.job, Job::None));
    let jogs: Vec<String> = recorded
        .try_iter()
        .filter_map(|event| match event {
            FeederEvent::ExternalEvent(event) if event.code == CommandCode::Jog as u32 => {
                (event.kind == ExternalEventKind::Command).then_some(event.text)
            }
            _ => None,
        })
        .collect();
    assert_eq!(jogs.len(), 4, "{jogs:?}");
}

/// Otherwise a client whose jog was replaced would rely on keep-alives without effect.
#[test]
fn a_keepalive_for_the_jog_of_another_is_rejected() {
    let mut bench = Bench::new();
    let keep = bench.command(CommandCode::JogKeep);
    assert_eq!(bench.reply(1, keep), None, "nothing moves");
    let mut jog = bench.command(CommandCode::Jog);
    (jog.axes_mask, jog.amount, jog.values[0]) = (1, 20.0, 1.0);
    assert_eq!(bench.reply(1, jog), None);
    assert_eq!(bench.operator.steered_speed(), Some(20.0));
    bench.runs(20);
    bench.ticks();
    assert_eq!(bench.reply(1, keep), None, "its own");
    assert_eq!(bench.reply(2, keep), Some(Alarm::Busy.number()), "another's");
    assert_eq!(bench.reply(2, jog), None, "taken over");
    assert_eq!(
        bench.reply(1, keep),
        Some(Alarm::Busy.number()),
        "no longer its own"
    );
    assert_eq!(bench.reply(2, keep), None);
    // Keep-alives that were on their way when the jog stopped.
    assert_eq!(bench.reply(2, bench.command(CommandCode::JogStop)), None);
    assert_eq!(bench.reply(2, keep), None, "while it stops");
    for _ in 0..50 {
        bench.runs(10);
        bench.ticks();
    }
    assert!(matches!(bench.operator.job, Job::None));
    for client in [1, 2] {
        assert_eq!(bench.reply(client, keep), None, "after its end");
    }
    // An increment ends by itself and needs no keep-alives.
    (jog.index, jog.values[0]) = (1, 5.0);
    assert_eq!(bench.reply(1, jog), None);
    assert_eq!(bench.reply(2, keep), None);
}

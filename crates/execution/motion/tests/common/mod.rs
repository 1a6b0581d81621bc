//! Random programs and machines, and measurements that share no code with planner or guard: limits are
//! checked on differences of the published positions, and distances are measured from the programmed curves
//! themselves.

#![allow(dead_code, unreachable_pub, reason = "each test uses its part")]
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a test may fail, and prints its seed"
)]

use evolvent_machine::{Limits, PlannerKind};
use evolvent_motion::{Inputs, PathExecutor, PlanConsumer, PlanProducer, Setpoint, flags, plan_queue};
use evolvent_path::{AXES, Arc, Axes, Curve, Involute, Line, Move, MoveKind, PathMode, Plane, Sense};
use evolvent_planner::{PathLimits, PathRules, PlanSink, Planner};
pub use evolvent_random::Random;

/// Forwards methods of a [`evolvent_planner::PlanSink`] to `self.sink`: a sink of a test implements only the
/// methods that it changes.
macro_rules! forward_to_sink {
    ($($method:ident)*) => { $(crate::common::forward_to_sink!(@ $method);)* };
    (@ segment) => {
        fn segment(&mut self, segment: &evolvent_planner::Segment) -> Result<(), evolvent_motion::QueueClosed> {
            self.sink.segment(segment)
        }
    };
    (@ step) => {
        fn step(&mut self, step: &evolvent_planner::Step) -> Result<(), evolvent_motion::QueueClosed> {
            self.sink.step(step)
        }
    };
    (@ exit) => {
        fn exit(&mut self, index: u64, speeds: evolvent_planner::ExitSpeeds) {
            self.sink.exit(index, speeds);
        }
    };
    (@ commit) => {
        fn commit(&mut self, count: u64) {
            self.sink.commit(count);
        }
    };
    (@ mark) => {
        fn mark(&mut self, mark: &evolvent_planner::BlockMark) -> Result<(), evolvent_motion::QueueClosed> {
            self.sink.mark(mark)
        }
    };
    (@ leave_open) => {
        fn leave_open(&mut self, from: u64) {
            self.sink.leave_open(from);
        }
    };
    (@ reserve_link) => {
        fn reserve_link(&mut self) -> Result<(), evolvent_motion::QueueClosed> {
            self.sink.reserve_link()
        }
    };
    (@ link) => {
        fn link(&mut self, from: u64, to: u64) -> bool {
            self.sink.link(from, to)
        }
    };
    (@ has_capacity) => {
        fn has_capacity(&self, steps: usize, segments: usize, marks: usize) -> bool {
            self.sink.has_capacity(steps, segments, marks)
        }
    };
    (@ wait) => {
        fn wait(&mut self) -> Result<(), evolvent_motion::QueueClosed> {
            self.sink.wait()
        }
    };
    (@ request) => {
        fn request(&mut self) -> Option<evolvent_planner::ReplanRequest> {
            self.sink.request()
        }
    };
    (@ reply) => {
        fn reply(&mut self, reply: evolvent_planner::ReplanReply) {
            self.sink.reply(reply);
        }
    };
    (@ acknowledged) => {
        fn acknowledged(&self) -> u64 {
            self.sink.acknowledged()
        }
    };
    (@ withdrawn) => {
        fn withdrawn(&self) -> u64 {
            self.sink.withdrawn()
        }
    };
    (@ reached_step) => {
        fn reached_step(&self) -> u64 {
            self.sink.reached_step()
        }
    };
    (@ reached) => {
        fn reached(&self) -> u64 {
            self.sink.reached()
        }
    };
}
pub(crate) use forward_to_sink;

/// The same limits on every axis, and an unlimited travel.
pub fn equal_axes(velocity: f64, acceleration: f64, jerk: f64) -> Limits {
    Limits {
        present: [true; AXES],
        velocity: Axes::repeat(velocity),
        acceleration: Axes::repeat(acceleration),
        jerk: Axes::repeat(jerk),
        travel_min: Axes::repeat(-1e5),
        travel_max: Axes::repeat(1e5),
        home: Axes::zeros(),
    }
}

pub fn limits(random: &mut Random) -> Limits {
    let mut limits = equal_axes(0.0, 0.0, 0.0);
    for i in 0..AXES {
        limits.velocity[i] = random.log(20.0, 1000.0);
        limits.acceleration[i] = random.log(300.0, 20_000.0);
        limits.jerk[i] = limits.acceleration[i] * random.log(10.0, 100.0);
    }
    limits
}

pub fn program(random: &mut Random, mode: PathMode, rotary: bool) -> Vec<Move> {
    let count = 2 + random.pick(30);
    let scale = random.log(0.005, 50.0);
    let mut at = Axes::zeros();
    let mut moves = Vec::new();
    while moves.len() < count {
        let feed = if random.unit() < 0.2 {
            f64::INFINITY
        } else {
            random.log(1.0, 500.0)
        };
        let kind = if feed.is_infinite() {
            MoveKind::Rapid
        } else {
            MoveKind::Feed
        };
        let step = scale * random.log(0.05, 5.0);
        let curve = match random.pick(5) {
            4 => {
                let Some(curve) = involute(random, at, step) else {
                    continue;
                };
                Ok(curve)
            }
            0 => {
                let plane = [Plane::Xy, Plane::Zx, Plane::Yz][random.pick(3)];
                let (first, second, third) = plane.axes();
                let radius = step.max(0.01);
                let (start, sweep) = (random.between(0.0, std::f64::consts::TAU), random.log(0.05, 6.0));
                let sense = if random.unit() < 0.5 {
                    Sense::Clockwise
                } else {
                    Sense::CounterClockwise
                };
                let centre = [
                    at[first] - radius * start.cos(),
                    at[second] - radius * start.sin(),
                ];
                let angle = start + sense.sign() * sweep;
                let mut end = at;
                end[first] = centre[0] + radius * angle.cos();
                end[second] = centre[1] + radius * angle.sin();
                if random.unit() < 0.3 {
                    end[third] += random.between(-step, step);
                }
                Arc::new(plane, at, end, centre, sense, 0).map(Curve::Arc)
            }
            // A reversal: the sharpest corner.
            1 if !moves.is_empty() && random.unit() < 0.3 => {
                let last: &Move = &moves[moves.len() - 1];
                Ok(last.curve.reversed())
            }
            // Straight on.
            2 if !moves.is_empty() => {
                let last: &Move = &moves[moves.len() - 1];
                let ahead = last.curve.jet(last.curve.domain()).first;
                Line::new(at, at + ahead * step).map(Curve::Line)
            }
            _ => {
                let mut end = at;
                for i in 0..3 {
                    end[i] += random.between(-step, step);
                }
                if rotary && random.unit() < 0.5 {
                    end[4] += random.between(-step, step);
                    end[6] += random.between(-step, step);
                }
                Line::new(at, end).map(Curve::Line)
            }
        };
        let Ok(curve) = curve else { continue };
        at = curve.end();
        moves.push(Move {
            curve,
            kind,
            feed_mm_s: feed,
            path_mode: mode,
        });
    }
    moves
}

/// From `at`, outwards or inwards, some of them to or from the base circle itself.
fn involute(random: &mut Random, at: Axes, step: f64) -> Option<Curve> {
    let radius = (step * random.log(0.05, 1.0)).max(1e-3);
    let handed = if random.unit() < 0.5 { 1.0 } else { -1.0 };
    let inner = if random.unit() < 0.4 {
        0.0
    } else {
        random.between(0.01, 6.0)
    };
    let outer = inner + random.log(0.05, 12.0);
    let turn = random.between(0.0, std::f64::consts::TAU);
    let point = |phi: f64| {
        let (sin, cos) = (turn + handed * phi).sin_cos();
        [
            radius * (cos + handed * phi * sin),
            radius * (sin - handed * phi * cos),
        ]
    };
    let (from, to) = (point(inner), point(outer));
    let centre = [at[0] - from[0], at[1] - from[1]];
    let mut end = at;
    (end[0], end[1]) = (centre[0] + to[0], centre[1] + to[1]);
    if random.unit() < 0.3 {
        end[2] += random.between(-step, step);
    }
    let sense = if handed > 0.0 {
        Sense::CounterClockwise
    } else {
        Sense::Clockwise
    };
    let curve = Curve::Involute(Involute::new(Plane::Xy, at, end, centre, radius, sense, 1e-6).ok()?);
    if random.unit() < 0.5 {
        return Some(curve);
    }
    // The reversed curve, moved so that it starts here.
    let back = curve.reversed();
    let shift = at - back.start();
    let (start, end) = (at, back.end() + shift);
    let centre = [centre[0] + shift[0], centre[1] + shift[1]];
    let sense = if handed > 0.0 {
        Sense::Clockwise
    } else {
        Sense::CounterClockwise
    };
    Some(Curve::Involute(
        Involute::new(Plane::Xy, start, end, centre, radius, sense, 1e-6).ok()?,
    ))
}

pub struct Scenario {
    pub limits: Limits,
    pub period_ns: u64,
    pub moves: Vec<Move>,
    pub chord_error_mm: f64,
    pub planner: PlannerKind,
}

impl Scenario {
    pub fn planner<S: PlanSink>(&self, feed_override: f64, sink: S) -> Planner<S> {
        let rate = 1e9 / self.period_ns as f64;
        let rules = PathRules {
            blend_tolerance_mm: 0.01,
            joint_time_s: 0.001,
            planner: self.planner,
            feed_override,
        };
        let path_limits = PathLimits::new(self.limits, rate, self.chord_error_mm);
        Planner::new(path_limits, rules, sink)
    }

    pub fn motion(&self) -> PathExecutor {
        PathExecutor::new(self.limits, self.period_ns, self.moves[0].curve.start())
    }
}

/// Feed of [`wave`].
pub const WAVE_FEED_MM_S: f64 = 20.0;

/// A wave in chords of 0.1 mm: a window of the planner lasts 0.4 s at its feed.
pub fn wave(blocks: usize) -> Scenario {
    let at = |k: usize| {
        let s = 0.1 * k as f64;
        let mut point = Axes::zeros();
        (point[0], point[1]) = (s, 4.0 * (0.2 * s).sin() + (0.9 * s).cos());
        point
    };
    let moves = (0..blocks)
        .map(|k| Move {
            curve: Curve::Line(Line::new(at(k), at(k + 1)).expect("line")),
            kind: MoveKind::Feed,
            feed_mm_s: WAVE_FEED_MM_S,
            path_mode: BLEND,
        })
        .collect();
    Scenario {
        limits: equal_axes(250.0, 2000.0, 50_000.0),
        period_ns: 1_000_000,
        moves,
        chord_error_mm: 1e-3,
        planner: PlannerKind::Optimal,
    }
}

/// Plans everything at once; only a classic plan can be driven without its planner.
pub fn plan(scenario: &Scenario) -> PlanConsumer {
    let (producer, consumer) = plan_queue(|| false);
    let mut planner = scenario.planner(1.0, producer);
    for (i, motion) in scenario.moves.iter().enumerate() {
        planner.push(motion, i as u32 + 1, i as u32).expect("plan");
    }
    planner.finish(9999).expect("finish");
    consumer
}

/// Planner and cycle in lockstep: the planner continues when the cycle would have to wait.
pub struct Pair {
    pub planner: Planner<PlanProducer<fn() -> bool>>,
    pub queue: PlanConsumer,
    pub motion: PathExecutor,
    pub fed: usize,
    /// Number of moves pushed at once.
    pub lump: usize,
}

impl Pair {
    pub fn new(scenario: &Scenario) -> Self {
        let (producer, queue) = plan_queue((|| false) as fn() -> bool);
        Self {
            planner: scenario.planner(1.0, producer),
            queue,
            motion: scenario.motion(),
            fed: 0,
            lump: 1,
        }
    }

    /// Runs the planner until the next step does not depend on it any more.
    pub fn plan_ahead(&mut self, scenario: &Scenario) {
        let mut tries = 0;
        while !self.motion.is_ready(&mut self.queue) {
            for _ in 0..self.lump {
                self.feed(scenario);
            }
            self.poll();
            tries += 1;
            assert!(
                tries < scenario.moves.len() + 1000,
                "the planner does not get on, fed {} of {}, state {:?}",
                self.fed,
                scenario.moves.len(),
                self.motion.state()
            );
        }
    }

    /// Lets the planner continue. If the queue is full it continues later: nothing is taken while it waits.
    pub fn poll(&mut self) {
        let _full = self.planner.poll();
    }

    /// Pushes one more move, or the end.
    pub fn feed(&mut self, scenario: &Scenario) {
        if let Some(one) = scenario.moves.get(self.fed) {
            let number = self.fed as u32;
            self.planner.push(one, number + 1, number).expect("plan");
        } else if self.fed == scenario.moves.len() {
            self.planner.finish(9999).expect("finish");
        }
        self.fed += 1;
    }

    pub fn step(&mut self, inputs: &Inputs) -> Setpoint {
        self.motion.step(inputs, &mut self.queue)
    }
}

pub fn run(scenario: &Scenario, mut inputs: impl FnMut(u64) -> Inputs) -> (Vec<Setpoint>, PathExecutor) {
    let mut pair = Pair::new(scenario);
    let mut out = Vec::new();
    while !pair.motion.is_over() {
        pair.plan_ahead(scenario);
        let setpoint = pair.step(&inputs(out.len() as u64));
        out.push(setpoint);
        assert!(
            out.len() < 4_000_000,
            "does not end, state {:?}, {setpoint:?}",
            pair.motion.state()
        );
    }
    (out, pair.motion)
}

/// Maximum ratios of first, second and third differences to the limits, away from flagged joints.
pub fn ratios(scenario: &Scenario, setpoints: &[Setpoint]) -> [f64; 3] {
    let start = scenario.moves[0].curve.start();
    let rate = 1e9 / scenario.period_ns as f64;
    let at = |k: isize| {
        if k < 0 {
            start
        } else {
            setpoints[k as usize].position
        }
    };
    let mut max = [0.0_f64; 3];
    for k in 0..setpoints.len() as isize {
        let near_joint = (k - 2..=k).any(|j| j >= 0 && setpoints[j as usize].flags & flags::JOINT != 0);
        for i in 0..AXES {
            let d = |order: u32| match order {
                1 => at(k)[i] - at(k - 1)[i],
                2 => at(k)[i] - 2.0 * at(k - 1)[i] + at(k - 2)[i],
                _ => at(k)[i] - 3.0 * at(k - 1)[i] + 3.0 * at(k - 2)[i] - at(k - 3)[i],
            };
            max[0] = max[0].max(d(1).abs() * rate / scenario.limits.velocity[i]);
            if !near_joint {
                let noise = 8.0 * f64::EPSILON * at(k)[i].abs() * rate.powi(3);
                max[1] = max[1].max(d(2).abs() * rate.powi(2) / scenario.limits.acceleration[i]);
                max[2] = max[2].max((d(3).abs() * rate.powi(3) - noise) / scenario.limits.jerk[i]);
            }
        }
    }
    max
}

/// Distance of XYZ from the nearest programmed point near block `block`.
pub fn path_error(moves: &[Move], block: usize, p: &Axes) -> f64 {
    let mut best = f64::INFINITY;
    for motion in &moves[block.saturating_sub(2)..(block + 3).min(moves.len())] {
        let curve = &motion.curve;
        let distance = |u: f64| {
            let d = curve.position(u) - p;
            (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
        };
        let n = 64;
        let width = curve.domain() / f64::from(n);
        for k in 0..n {
            // Ternary search in every cell: the distance from a short arc or a line has one minimum.
            let (mut low, mut high) = (width * f64::from(k), width * f64::from(k + 1));
            if distance(low).min(distance(high)) > best + width {
                continue;
            }
            for _ in 0..80 {
                let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
                if distance(a) < distance(b) {
                    high = b;
                } else {
                    low = a;
                }
            }
            best = best.min(distance(0.5 * (low + high)));
        }
    }
    best
}

pub fn check(scenario: &Scenario, setpoints: &[Setpoint], motion: &PathExecutor, tolerance: f64, what: &str) {
    if motion.fault().is_some() {
        let k = setpoints
            .iter()
            .position(|s| s.flags & flags::GUARD != 0)
            .unwrap_or(0);
        for s in &setpoints[k.saturating_sub(6)..(k + 3).min(setpoints.len())] {
            println!(
                "{} {:?} flags {} path {} v {} a {} block {}",
                s.sequence,
                s.state,
                s.flags,
                s.path_mm,
                s.feed_mm_s,
                s.acceleration.amax(),
                s.block
            );
        }
    }
    assert!(motion.fault().is_none(), "{what}: guard {:?}", motion.fault());
    let [v, a, j] = ratios(scenario, setpoints);
    assert!(v <= 1.001, "{what}: velocity ratio {v}");
    assert!(a <= 1.001, "{what}: acceleration ratio {a}");
    assert!(j <= 1.02, "{what}: jerk ratio {j}");
    let stride = (setpoints.len() / 150).max(1);
    for setpoint in setpoints.iter().step_by(stride) {
        let error = path_error(&scenario.moves, setpoint.block as usize, &setpoint.position);
        if error > tolerance {
            for b in 0..scenario.moves.len() {
                println!(
                    "block {b}: {} {:?} len {} feed {}",
                    path_error(&scenario.moves, b, &setpoint.position),
                    scenario.moves[b].curve.end(),
                    scenario.moves[b].curve.length(),
                    scenario.moves[b].feed_mm_s
                );
            }
        }
        assert!(
            error <= tolerance,
            "{what}: {error} mm off the path at {}, block {}",
            setpoint.sequence,
            setpoint.block
        );
    }
}

pub fn scenario(random: &mut Random, mode: PathMode, rotary: bool) -> Scenario {
    let limits = limits(random);
    let moves = program(random, mode, rotary);
    // The highest rate at which the run does not take too long.
    let seconds: f64 = moves
        .iter()
        .map(|motion| motion.curve.length() / motion.feed_mm_s.min(100.0))
        .sum();
    let highest = [250.0, 1000.0, 10_000.0, 35_000.0][random.pick(4)];
    let rate = [35_000.0, 10_000.0, 1000.0]
        .into_iter()
        .find(|rate| *rate <= highest && rate * seconds < 3e5);
    Scenario {
        limits,
        period_ns: (1e9 / rate.unwrap_or(250.0)) as u64,
        moves,
        chord_error_mm: random.log(1e-5, 1e-2),
        planner: PlannerKind::Classic,
    }
}

pub const PLANNERS: [PlannerKind; 2] = [PlannerKind::Classic, PlannerKind::Optimal];

pub const BLEND: PathMode = PathMode::Blend {
    tolerance_mm: Some(0.02),
    merge_mm: None,
};

/// Seed and number of cases: those of the test, or `EVOLVENT_SEED` and `EVOLVENT_CASES` for a longer search.
pub fn campaign(seed: u64, cases: usize) -> (Random, usize) {
    (
        Random::from_state(evolvent_random::seed(seed)),
        evolvent_random::cases(cases),
    )
}

//! Holds along plans of the classic planner with runs far shorter than a stop.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use evolvent_machine::PlannerKind;
use evolvent_motion::{Inputs, MotionState, PlannerLag, Setpoint};
use evolvent_path::{Axes, Curve, Line, Move, MoveKind, PathMode};

use crate::common::{BLEND, Pair, Random, Scenario, campaign, check, equal_axes, limits, program, ratios};

/// A path of chords: the length of each, mm, and the amplitude of their deviation from a wave, mm.
struct Chords {
    length: f64,
    rough: f64,
    feed: f64,
}

impl Chords {
    fn moves(&self, random: &mut Random, total: f64) -> Vec<Move> {
        let mut at = Axes::zeros();
        (0..(total / self.length) as u32)
            .map(|k| {
                let from = at;
                let along = f64::from(k) * self.length / 20.0;
                at[0] += self.length;
                at[1] += self.length * along.sin() + self.rough * (random.unit() - 0.5);
                at[2] += self.rough * (random.unit() - 0.5);
                Move {
                    curve: Curve::Line(Line::new(from, at).expect("two points")),
                    kind: MoveKind::Feed,
                    feed_mm_s: self.feed,
                    path_mode: PathMode::Blend {
                        tolerance_mm: Some(0.01),
                        merge_mm: None,
                    },
                }
            })
            .collect()
    }
}

/// Duration of the shortest stop along a straight line, s.
fn shortest_stop(speed: f64, acceleration: f64, jerk: f64) -> f64 {
    if speed <= acceleration * acceleration / jerk {
        2.0 * (speed / jerk).sqrt()
    } else {
        acceleration / jerk + speed / acceleration
    }
}

/// Runs last 2 to 8 ms here, a stop from 65 mm/s at least 72 ms. The jerk limit of a run is what curvature at
/// its maximum speed leaves, 0.15 to 0.3 of that of the axes: within it a stop takes 1.8 to 2.5 times as
/// long. Run by run it takes up to nine times as long.
#[test]
fn a_hold_over_many_short_runs_is_one_stop() {
    let machine = equal_axes(300.0, 2000.0, 50_000.0);
    let mut random = Random::seeded(4242);
    for (length, rough, feed) in [
        (0.1, 0.02, 120.0),
        (0.2, 0.004, 120.0),
        (0.5, 0.01, 120.0),
        (0.5, 0.002, 65.0),
        (1.0, 0.005, 200.0),
        (2.0, 0.3, 120.0),
    ] {
        let chords = Chords { length, rough, feed };
        let what = format!("chords of {length} mm, {rough} mm rough, {feed} mm/s");
        let mut ratios = Vec::new();
        for case in 0..12 {
            let scenario = Scenario {
                limits: machine,
                period_ns: 1_000_000,
                moves: chords.moves(&mut random, 200.0),
                chord_error_mm: 1e-3,
                planner: PlannerKind::Classic,
            };
            let mut pair = Pair::new(&scenario);
            let at = 300 + case * 70;
            let (mut cycle, mut speed) = (0_u32, 0.0);
            while pair.motion.state() != MotionState::Held {
                pair.plan_ahead(&scenario);
                let inputs = Inputs {
                    hold: cycle >= at,
                    ..Inputs::default()
                };
                let setpoint = pair.step(&inputs);
                if cycle < at {
                    speed = setpoint.feed_mm_s;
                }
                cycle += 1;
            }
            let took = f64::from(cycle - at) * 1e-3;
            ratios.push((took - 0.015) / shortest_stop(speed, 2000.0, 50_000.0));
        }
        ratios.sort_by(f64::total_cmp);
        let (median, worst) = (ratios[6], ratios[11]);
        println!("{what}: stops less 15 ms take {median:.2} of the shortest, {worst:.2} at most");
        assert!(median <= 2.1 && worst <= 2.5, "{what}: {ratios:.2?}");
    }
}

/// Sets and releases holds, and changes the override, at random.
struct Hands {
    random: Random,
    inputs: Inputs,
    next: usize,
    period_s: f64,
    /// The maximum override so far.
    max: f64,
}

impl Hands {
    fn new(random: &mut Random, period_s: f64) -> Self {
        Self {
            random: Random::from_state((random.unit() * 1e15) as u64 + 1),
            inputs: Inputs::default(),
            next: 0,
            period_s,
            max: 1.0,
        }
    }

    fn at(&mut self, cycle: usize) -> Inputs {
        if cycle >= self.next {
            let random = &mut self.random;
            match random.pick(5) {
                0 => self.inputs.feed_override = *random.one_of(&[0.0, 0.3, 1.0, 1.0, 1.5, 2.0]),
                1 => self.inputs.feed_override = random.between(0.01, 2.0),
                _ => self.inputs.hold = !self.inputs.hold,
            }
            self.max = self.max.max(self.inputs.feed_override);
            // From one cycle to longer than any stop.
            self.next = cycle + 1 + (random.log(1e-4, 0.5) / self.period_s) as usize;
            if cycle as f64 * self.period_s > 20.0 {
                self.inputs = Inputs::default();
                self.next = usize::MAX;
            }
        }
        self.inputs
    }
}

#[test]
fn holds_and_overrides_keep_limits_with_any_planner() {
    let (mut random, cases) = campaign(0x1402_0001, 60);
    let mut max = [0.0_f64; 3];
    for case in 0..cases {
        let rate = [250.0, 1000.0, 4000.0][case % 3];
        let moves = match case / 3 % 4 {
            0 => program(&mut random, BLEND, false),
            1 => program(&mut random, PathMode::ExactPath, false),
            _ => {
                let length = random.log(0.05, 3.0);
                let chords = Chords {
                    length,
                    rough: length * random.log(1e-3, 0.2),
                    feed: random.log(10.0, 300.0),
                };
                chords.moves(&mut random, 60.0 * length.min(1.0))
            }
        };
        let scenario = Scenario {
            limits: if random.unit() < 0.5 {
                limits(&mut random)
            } else {
                equal_axes(300.0, 2000.0, 50_000.0)
            },
            period_ns: (1e9 / rate) as u64,
            moves,
            chord_error_mm: 1e-2,
            planner: PlannerKind::Classic,
        };
        let seconds: f64 = scenario
            .moves
            .iter()
            .map(|motion| motion.curve.length() / motion.feed_mm_s.min(100.0))
            .sum();
        if seconds * rate > 1e5 {
            continue;
        }
        // In time, late, or absent for a while.
        let planner = random.pick(3);
        let what = format!("case {case}, {rate} Hz, planner {planner}");
        let mut hands = Hands::new(&mut random, 1.0 / rate);
        let mut pair = Pair::new(&scenario);
        let mut gone = 0..0;
        let mut out: Vec<Setpoint> = Vec::new();
        let mut met: Vec<(Inputs, PlannerLag)> = Vec::new();
        while !pair.motion.is_over() {
            let cycle = out.len();
            match planner {
                0 => pair.plan_ahead(&scenario),
                1 => {
                    if random.unit() < 0.05 {
                        pair.feed(&scenario);
                        pair.poll();
                    }
                }
                _ => {
                    if cycle >= gone.end {
                        gone.start = cycle + (random.unit() * 0.5 * rate) as usize;
                        gone.end = gone.start + (random.unit() * rate) as usize;
                    }
                    if !gone.contains(&cycle) {
                        pair.plan_ahead(&scenario);
                    }
                }
            }
            let inputs = hands.at(cycle);
            let setpoint = pair.step(&inputs);
            met.push((inputs, pair.motion.planner_lag()));
            if let Some(before) = out.last() {
                assert!(setpoint.path_mm >= before.path_mm, "{what}: backwards at {cycle}");
            }
            let block = setpoint.block as usize;
            let near = &scenario.moves[block.saturating_sub(1)..(block + 2).min(scenario.moves.len())];
            let feed = near.iter().fold(0.0_f64, |max, one| max.max(one.feed_mm_s));
            assert!(
                setpoint.feed_mm_s <= feed * hands.max * 1.001 + 1e-6,
                "{what}: {} mm/s of {feed} at {cycle}",
                setpoint.feed_mm_s
            );
            out.push(setpoint);
            assert!(out.len() < 1_000_000, "{what}: does not end");
        }
        check(&scenario, &out, &pair.motion, 0.05, &what);
        assert_repeats(&scenario, &met, &out, &what);
        for (max, ratio) in max.iter_mut().zip(ratios(&scenario, &out)) {
            *max = max.max(ratio);
        }
    }
    println!("worst ratios of velocity, acceleration, jerk: {max:.5?}");
}

/// The same inputs give the same setpoints if the planner is far ahead and replayed with its recorded lag.
fn assert_repeats(scenario: &Scenario, met: &[(Inputs, PlannerLag)], out: &[Setpoint], what: &str) {
    let mut pair = Pair::new(scenario);
    for ((inputs, lag), setpoint) in met.iter().zip(out) {
        while !pair.motion.is_ready(&mut pair.queue) {
            pair.feed(scenario);
            pair.poll();
        }
        let again = pair.motion.replay_step(inputs, &mut pair.queue, *lag);
        assert_eq!(again, *setpoint, "{what}: computed again");
    }
}

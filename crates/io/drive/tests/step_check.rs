//! Steps from setpoint to setpoint: a follower accepts all those of motions within the limits, and none of
//! jumps.

#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use evolvent_drive::{BridgeState, Follower, FollowerSettings, Note, PowerRequest, Target};
use evolvent_random::{Random, cases};
use evolvent_wire::{AXES, Setpoint, flags};

use crate::machines::{HEAVY, MILL, settings};
use crate::random_motion::RandomMotion;

/// Due time of the setpoint with the number 0, ns.
const BEGIN_NS: u64 = 5_000_000_000;
/// None of the jumps is near enough to begin there.
const SYNC: f64 = 1e-3;

fn at_rest(sequence: u64, period_ns: u64, position: f64) -> Setpoint {
    Setpoint {
        sequence,
        due_time_ns: BEGIN_NS + sequence * period_ns,
        period_ns,
        position: [position; AXES],
        axes_mask: 0b11,
        power_request: PowerRequest::On.number(),
        ..Setpoint::default()
    }
}

/// X and Y from rest to a constant velocity, within the limits.
fn in_motion(sequence: u64, period_ns: u64, limits: [f64; 3], speed: f64) -> Setpoint {
    let mut setpoint = at_rest(sequence, period_ns, 0.0);
    // A ramp whose acceleration is a parabola: its maximum is 1.5 times the mean, its maximum slope 6 times
    // speed over duration squared.
    let ramp_s = (2.0 * speed / limits[1]).max((8.0 * speed / limits[2]).sqrt());
    let time_s = sequence as f64 * period_ns as f64 * 1e-9;
    let u = (time_s / ramp_s).min(1.0);
    let mut position = speed * ramp_s * u * u * u * (1.0 - 0.5 * u);
    position += speed * (time_s - ramp_s).max(0.0);
    for axis in 0..2 {
        setpoint.position[axis] = position;
        setpoint.velocity[axis] = speed * u * u * (3.0 - 2.0 * u);
        setpoint.acceleration[axis] = speed / ramp_s * 6.0 * u * (1.0 - u);
    }
    setpoint
}

/// A follower with ideal drives. Setpoints arrive `lead` periods before they are due.
struct Bench {
    follower: Follower,
    settings: FollowerSettings,
    lead: u64,
    cycle: u64,
    enabled_from: u64,
    actual: [f64; AXES],
    targets: Vec<Target>,
}

impl Bench {
    fn new(settings: FollowerSettings, lead: u64) -> Self {
        Self {
            follower: Follower::new(settings).expect("limits"),
            settings,
            lead,
            cycle: 0,
            enabled_from: 0,
            actual: [0.0; AXES],
            targets: Vec::new(),
        }
    }

    /// One period: a setpoint arrives, or is lost.
    fn cycle(&mut self, offered: Option<Setpoint>) -> Target {
        let now_ns = BEGIN_NS + self.cycle * self.settings.period_ns - self.lead * self.settings.period_ns;
        if let Some(setpoint) = offered {
            let _noted = self.follower.offer(now_ns, &setpoint);
        }
        let is_enabled = self.cycle >= self.enabled_from;
        let target = self.follower.step(now_ns, is_enabled, &self.actual);
        self.actual = target.position;
        self.targets.push(target);
        self.cycle += 1;
        target
    }

    /// The maximum velocity and acceleration of X over the targets from number `from` on, relative to the
    /// limits.
    fn ratios(&self, from: usize) -> [f64; 2] {
        let rate = 1e9 / self.settings.period_ns as f64;
        let x: Vec<f64> = self.targets[from..]
            .iter()
            .map(|target| target.position[0])
            .collect();
        let v: Vec<f64> = x.windows(2).map(|pair| (pair[1] - pair[0]) * rate).collect();
        let a: Vec<f64> = v.windows(2).map(|pair| (pair[1] - pair[0]) * rate).collect();
        let max = |values: &[f64]| values.iter().fold(0.0, |max: f64, value| max.max(value.abs()));
        [
            max(&v) / self.settings.max_velocity[0],
            max(&a) / self.settings.max_acceleration[0],
        ]
    }
}

/// Every combination of rate, machine, lead and jump, mm.
fn jumps() -> impl Iterator<Item = (u64, [f64; 3], u64, f64)> {
    [4_000_000, 1_000_000, 250_000].into_iter().flat_map(|period_ns| {
        [MILL, HEAVY].into_iter().flat_map(move |limits| {
            [1, 3, 40].into_iter().flat_map(move |lead| {
                [0.6, 1.0, 2.0, -0.6, -2.0].map(move |jump| (period_ns, limits, lead, jump))
            })
        })
    })
}

#[test]
fn a_jump_that_persists_is_not_followed_at_rest() {
    for (period_ns, limits, lead, jump) in jumps() {
        // The number of setpoints lost after the first one of the jump, and whether the drives come into
        // operation only when the jump is in the queue.
        for (lost, is_queued) in [(0, false), (1, false), (7, false), (0, true), (7, true)] {
            let mut bench = Bench::new(settings(period_ns, limits, SYNC), lead);
            let first = lead + 20;
            bench.enabled_from = if is_queued { first + 1 } else { 0 };
            let mut has_held = false;
            for cycle in 0..first + 200 {
                let mut setpoint = at_rest(cycle, period_ns, 0.0);
                if cycle >= first {
                    setpoint.position[0] = jump;
                }
                let is_lost = (first + 1..=first + lost).contains(&cycle);
                let target = bench.cycle((!is_lost).then_some(setpoint));
                assert_eq!(
                    target.position[0], 0.0,
                    "{period_ns} ns, {limits:?}, lead {lead}, {jump} mm, {lost} lost, queued {is_queued}, \
                     cycle {cycle}"
                );
                has_held |= cycle > first && target.state == BridgeState::Holding;
            }
            assert!(has_held && bench.follower.note() == Note::Jump);
        }
    }
}

#[test]
fn a_jump_that_persists_is_not_followed_in_motion() {
    for (period_ns, limits, lead, jump) in jumps() {
        for lost in [0, 1, 7] {
            let mut bench = Bench::new(settings(period_ns, limits, SYNC), lead);
            let speed = 0.5 * limits[0];
            let first = lead + 1_500_000_000 / period_ns;
            for cycle in 0..first + 2_000_000_000 / period_ns {
                let mut setpoint = in_motion(cycle, period_ns, limits, speed);
                if cycle >= first {
                    setpoint.position[0] += jump;
                }
                let is_lost = (first + 1..=first + lost).contains(&cycle);
                bench.cycle((!is_lost).then_some(setpoint));
            }
            let case = format!("{period_ns} ns, {limits:?}, lead {lead}, {jump} mm, {lost} lost");
            let ratios = bench.ratios(lead as usize + 2);
            // 1 % for differences of positions.
            assert!(ratios.iter().all(|ratio| *ratio <= 1.01), "{case}: {ratios:?}");
            let last = bench.targets.last().expect("targets");
            assert_eq!(last.state, BridgeState::Holding, "{case}");
        }
    }
}

#[test]
fn one_setpoint_out_of_reach_counts_as_missing() {
    for (period_ns, limits, lead, jump) in jumps() {
        let mut bench = Bench::new(settings(period_ns, limits, SYNC), lead);
        let first = lead + 1_500_000_000 / period_ns;
        let mut wild = 0;
        for cycle in 0..first + 200 {
            let mut setpoint = in_motion(cycle, period_ns, limits, 0.5 * limits[0]);
            // Repeatedly, with good setpoints in between.
            if (first..first + 190).contains(&cycle) && cycle % 4 == 0 {
                setpoint.position[0] += jump;
                wild += 1;
            }
            bench.cycle(Some(setpoint));
        }
        let case = format!("{period_ns} ns, {limits:?}, lead {lead}, {jump} mm");
        assert_eq!(bench.follower.missed(), 2 * wild, "{case}: refused, and a gap");
        assert!(
            bench.targets[lead as usize + 2..]
                .iter()
                .all(|target| matches!(target.state, BridgeState::Following | BridgeState::Bridging)),
            "{case}"
        );
        let ratios = bench.ratios(lead as usize + 2);
        assert!(ratios.iter().all(|ratio| *ratio <= 1.01), "{case}: {ratios:?}");
    }
}

/// Setpoints at one position with a velocity, and moving setpoints without one.
#[test]
fn velocities_inconsistent_with_positions_are_refused() {
    for period_ns in [4_000_000, 1_000_000, 250_000] {
        let period_s = period_ns as f64 * 1e-9;
        for (velocity, moves) in [(100.0, 0.0), (0.0, 100.0), (-100.0, 100.0)] {
            let mut bench = Bench::new(settings(period_ns, MILL, SYNC), 3);
            let first = 30;
            for cycle in 0..first + 400 {
                let mut setpoint = at_rest(cycle, period_ns, 0.0);
                if cycle >= first {
                    setpoint.velocity[0] = velocity;
                    setpoint.position[0] = moves * period_s * (cycle - first + 1) as f64;
                }
                let target = bench.cycle(Some(setpoint));
                assert_eq!(
                    target.position[0], 0.0,
                    "{period_ns} ns, {velocity} {moves}, {cycle}"
                );
            }
            assert!(
                bench
                    .targets
                    .iter()
                    .skip(first as usize)
                    .any(|target| target.state == BridgeState::Holding)
            );
        }
    }
}

/// Positions that match the velocities, which change in steps.
#[test]
fn a_step_of_velocity_is_not_followed() {
    for period_ns in [4_000_000, 1_000_000, 250_000] {
        let mut bench = Bench::new(settings(period_ns, MILL, SYNC), 3);
        let (first, speed) = (30, 100.0);
        for cycle in 0..first + 400 {
            let mut setpoint = at_rest(cycle, period_ns, 0.0);
            if cycle >= first {
                let periods = (cycle - first) as f64 + 0.5;
                setpoint.velocity[0] = speed;
                setpoint.position[0] = speed * period_ns as f64 * 1e-9 * periods;
            }
            let target = bench.cycle(Some(setpoint));
            assert_eq!(target.position[0], 0.0, "{period_ns} ns, {cycle}");
        }
    }
}

/// An axis that the core's guard stops at the end of its travel stops at its position; without the guard's
/// flag the axes brake within their limits.
#[test]
fn guard_stop_at_travel_end_is_followed() {
    let (period_ns, first) = (1_000_000, 1500);
    for is_guarded in [true, false] {
        let mut bench = Bench::new(settings(period_ns, MILL, SYNC), 2);
        for cycle in 0..first + 300 {
            let mut setpoint = in_motion(cycle.min(first - 1), period_ns, MILL, 100.0);
            if cycle >= first {
                (setpoint.velocity, setpoint.acceleration) = ([0.0; AXES], [0.0; AXES]);
                // Only the first one has the flag.
                setpoint.flags = if is_guarded && cycle == first {
                    flags::GUARD
                } else {
                    0
                };
            }
            (setpoint.sequence, setpoint.due_time_ns) = (cycle, BEGIN_NS + cycle * period_ns);
            bench.cycle(Some(setpoint));
        }
        let end = in_motion(first - 1, period_ns, MILL, 100.0).position[0];
        let last = bench.targets.last().expect("targets");
        if is_guarded {
            assert_eq!((last.state, last.position[0]), (BridgeState::Following, end));
        } else {
            assert_eq!(last.state, BridgeState::Holding);
            let ratios = bench.ratios(5);
            assert!(ratios.iter().all(|ratio| *ratio <= 1.01), "{ratios:?}");
        }
    }
}

/// Random limits, rates, motions, losses and clocks.
#[test]
fn motion_within_limits_is_followed_despite_losses() {
    let mut random = Random::new();
    for case in 0..cases(400) {
        let period_ns = *random.one_of(&[4_000_000, 1_000_000, 250_000, 28_571]);
        let velocity = random.log(10.0, 1_000.0);
        let acceleration = random.log(0.5 * velocity, 50.0 * velocity);
        let limits = [velocity, acceleration, random.log(3.0, 200.0) * acceleration];
        let settings = settings(period_ns, limits, SYNC);
        // Up to the amount that corrections and following a spindle may add.
        let fraction = random.between(0.3, 1.95);
        let driven = [velocity, fraction * acceleration, limits[2]];
        let has_steps = random.below(2) == 0;
        let mut motions =
            [(); 2].map(|()| RandomMotion::from_rest(random.between(-2_000.0, 2_000.0), driven, has_steps));
        let mut follower = Follower::new(settings).expect("limits");
        let (mut due_ns, mut lost, mut wander) = (BEGIN_NS, 0, 0.0_f64);
        let mut was_taken = true;
        let actual = std::array::from_fn(|axis| motions.get(axis).map_or(0.0, |motion| motion.state()[0]));
        for sequence in 0..4_000 {
            if sequence > 20 {
                for motion in &mut motions {
                    motion.advance(&mut random, period_ns as f64 * 1e-9);
                }
            }
            wander = (wander + random.between(-1e-4, 1e-4)).clamp(-1e-3, 1e-3);
            due_ns = due_ns.saturating_add_signed(period_ns as i64 + (wander * period_ns as f64) as i64);
            let mut setpoint = at_rest(sequence, period_ns, 0.0);
            setpoint.due_time_ns = due_ns;
            for (axis, motion) in motions.iter().enumerate() {
                [
                    setpoint.position[axis],
                    setpoint.velocity[axis],
                    setpoint.acceleration[axis],
                ] = motion.state();
            }
            if was_taken && sequence > 20 && random.below(12) == 0 {
                // With one more the motion ends a thousandth of its time too early, by the clock.
                lost = 1 + random.below(settings.bridge_cycles as usize - 2);
            }
            was_taken = lost == 0;
            if lost > 0 {
                lost -= 1;
            } else {
                let taken = follower.offer(due_ns - 2 * period_ns, &setpoint);
                assert_eq!(
                    taken,
                    Ok(()),
                    "case {case}: {period_ns} ns, {limits:?}, {fraction}, steps {has_steps}, setpoint {sequence}"
                );
            }
            let target = follower.step(due_ns, sequence > 2, &actual);
            assert!(
                sequence < 5 || matches!(target.state, BridgeState::Following | BridgeState::Bridging),
                "case {case}, setpoint {sequence}: {:?}",
                target.state
            );
        }
    }
}

//! Following begins at setpoints near the axes but not exactly at them: no target steps, whatever the
//! setpoints do meanwhile.

#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use evolvent_drive::{BridgeState, Follower, FollowerSettings, PowerRequest, Target};
use evolvent_random::{Random, cases};
use evolvent_wire::{AXES, Setpoint};

use crate::machines::{HEAVY, MILL, settings};
use crate::random_motion::RandomMotion;

/// Due time of the setpoint with the number 0, ns.
const BEGIN_NS: u64 = 5_000_000_000;
/// Tolerance of the start.
const SYNC: f64 = 0.5;
/// The fraction of every limit that the documentation permits for the start, in addition to the setpoints;
/// and rounding of differences.
const START: f64 = 0.05;
const ROUNDING: f64 = 1e-3;

/// A follower with ideal drives. Setpoints arrive two periods before they are due.
struct Bench {
    follower: Follower,
    settings: FollowerSettings,
    now_ns: u64,
    actual: [f64; AXES],
    /// Targets of the drives, in the final coordinates.
    targets: Vec<Target>,
}

impl Bench {
    fn new(settings: FollowerSettings, actual: [f64; AXES]) -> Self {
        Self {
            follower: Follower::new(settings).expect("limits"),
            settings,
            now_ns: BEGIN_NS - 2 * settings.period_ns,
            actual,
            targets: Vec::new(),
        }
    }

    fn cycle(&mut self, setpoint: Option<Setpoint>, is_enabled: bool) -> Target {
        if let Some(setpoint) = setpoint {
            let _noted = self.follower.offer(self.now_ns, &setpoint);
        }
        let target = self.follower.step(self.now_ns, is_enabled, &self.actual);
        if let Some(shift) = target.datum_shift {
            for earlier in &mut self.targets {
                for (position, shift) in earlier.position.iter_mut().zip(shift) {
                    *position += shift;
                }
            }
        }
        self.actual = target.position;
        self.targets.push(target);
        self.now_ns += self.settings.period_ns;
        target
    }

    /// The maximum velocity and acceleration of both axes over the targets, relative to the limits.
    fn ratios(&self) -> [f64; 2] {
        let rate = 1e9 / self.settings.period_ns as f64;
        let mut ratios = [0.0_f64; 2];
        for axis in 0..2 {
            let x = self.targets.iter().map(|target| target.position[axis]);
            let x: Vec<f64> = x.collect();
            for three in x.windows(3) {
                let velocity = (three[2] - three[1]) * rate;
                let acceleration = (three[2] - 2.0 * three[1] + three[0]) * rate * rate;
                ratios[0] = ratios[0].max(velocity.abs() / self.settings.max_velocity[axis]);
                ratios[1] = ratios[1].max(acceleration.abs() / self.settings.max_acceleration[axis]);
            }
        }
        ratios
    }
}

fn setpoint(sequence: u64, period_ns: u64) -> Setpoint {
    Setpoint {
        sequence,
        due_time_ns: BEGIN_NS + sequence * period_ns,
        period_ns,
        axes_mask: 0b11,
        power_request: PowerRequest::On.number(),
        ..Setpoint::default()
    }
}

/// Every combination of rate, machine and distance of the axes from the setpoints, mm.
fn starts() -> impl Iterator<Item = (u64, [f64; 3], f64)> {
    [4_000_000, 1_000_000, 250_000].into_iter().flat_map(|period_ns| {
        [MILL, HEAVY].into_iter().flat_map(move |limits| {
            [0.05, -0.05, 0.3, -0.3, 0.5, -0.5].map(move |distance| (period_ns, limits, distance))
        })
    })
}

#[test]
fn axes_at_rest_go_smoothly_to_setpoints_beside_them() {
    for (period_ns, limits, distance) in starts() {
        let case = format!("{period_ns} ns, {limits:?}, {distance} mm");
        let mut actual = [0.0; AXES];
        (actual[0], actual[1]) = (distance, -0.5 * distance);
        let mut bench = Bench::new(settings(period_ns, limits, SYNC), actual);
        let mut left = f64::INFINITY;
        for sequence in 0..3_000_000_000 / period_ns {
            let target = bench.cycle(Some(setpoint(sequence, period_ns)), sequence >= 12);
            if sequence < 12 {
                continue;
            }
            assert_eq!(target.state, BridgeState::Following, "{case}");
            // The distance only decreases.
            let now = target.position[0] * distance.signum();
            assert!(now >= 0.0 && now <= left, "{case}: {now} mm after {left} mm");
            left = now;
        }
        // And the end is exact to the bit.
        assert_eq!(bench.actual, [0.0; AXES], "{case}");
        let ratios = bench.ratios();
        assert!(
            ratios.iter().all(|ratio| *ratio <= START * (1.0 + ROUNDING)),
            "{case}: {ratios:?}"
        );
    }
}

/// A motion at the limits of the axes, which may already have begun when following begins.
#[test]
fn immediate_motion_keeps_limits_plus_start_fraction() {
    for (period_ns, limits, distance) in starts() {
        for begin_s in [-0.002, 0.0, 0.01, 0.05] {
            let case = format!("{period_ns} ns, {limits:?}, {distance} mm, {begin_s} s");
            // Velocity V (1 - cos) / 2 and acceleration A sin: its largest jerk is 2 A^2 / V.
            let turn = 2.0 * limits[1] / limits[0];
            let size = 0.5 * limits[0] / turn;
            let mut actual = [0.0; AXES];
            // The motion of the setpoints before following begins adds to it.
            (actual[0], actual[1]) = (0.99 * distance, 0.99 * distance);
            let mut bench = Bench::new(settings(period_ns, limits, SYNC), actual);
            let enabled_from = 12;
            for sequence in 0..6_000_000_000 / period_ns {
                let mut sent = setpoint(sequence, period_ns);
                let since_ns = sent.due_time_ns as f64 - (BEGIN_NS + (enabled_from - 2) * period_ns) as f64;
                let angle = turn * (since_ns * 1e-9 - begin_s).max(0.0);
                for (axis, sign) in [1.0, -1.0].into_iter().enumerate() {
                    sent.position[axis] = sign * size * (angle - angle.sin());
                    sent.velocity[axis] = sign * size * turn * (1.0 - angle.cos());
                    sent.acceleration[axis] = sign * size * turn * turn * angle.sin();
                }
                let target = bench.cycle(Some(sent), sequence >= enabled_from);
                assert!(
                    sequence < enabled_from || target.state == BridgeState::Following,
                    "{case}"
                );
                // The setpoint that is due now arrived two periods ago.
                if sequence == 6_000_000_000 / period_ns - 1 {
                    let due = target.sequence * period_ns;
                    let angle =
                        turn * ((due as f64 - ((enabled_from - 2) * period_ns) as f64) * 1e-9 - begin_s);
                    assert_eq!(target.position[0], size * (angle - angle.sin()), "{case}");
                }
            }
            let ratios = bench.ratios();
            assert!(
                ratios
                    .iter()
                    .all(|ratio| *ratio <= (1.0 + START) * (1.0 + ROUNDING)),
                "{case}: {ratios:?}"
            );
        }
    }
}

/// Setpoints at rest jump to where following may begin: the axes, which are at rest, stop, and then move
/// there smoothly.
#[test]
fn persistent_small_jump_at_rest_is_no_target_step() {
    for (period_ns, limits, distance) in starts() {
        let mut bench = Bench::new(settings(period_ns, limits, SYNC), [0.0; AXES]);
        for sequence in 0..3_000_000_000 / period_ns {
            let mut sent = setpoint(sequence, period_ns);
            if sequence >= 50 {
                sent.position[0] = distance;
            }
            bench.cycle(Some(sent), true);
        }
        let case = format!("{period_ns} ns, {limits:?}, {distance} mm");
        assert_eq!(bench.actual[0], distance, "{case}");
        let ratios = bench.ratios();
        assert!(
            ratios.iter().all(|ratio| *ratio <= START * (1.0 + ROUNDING)),
            "{case}: {ratios:?}"
        );
    }
}

/// The core becomes silent, and homes an axis, before the distance of the start has decayed.
#[test]
fn braking_and_datum_changes_at_start_add_no_motion() {
    for (period_ns, limits, distance) in starts() {
        for is_silent in [false, true] {
            let case = format!("{period_ns} ns, {limits:?}, {distance} mm, silent {is_silent}");
            let mut actual = [0.0; AXES];
            (actual[0], actual[1]) = (distance, distance);
            let mut bench = Bench::new(settings(period_ns, limits, SYNC), actual);
            let renamed_from = 20;
            let silence = if is_silent { 25..100 } else { 0..0 };
            for sequence in 0..3_000_000_000 / period_ns {
                let mut sent = setpoint(sequence, period_ns);
                if sequence >= renamed_from {
                    (sent.datum, sent.position[0]) = (1, 250.0);
                }
                bench.cycle((!silence.contains(&sequence)).then_some(sent), sequence >= 12);
            }
            assert_eq!(bench.actual[..2], [250.0, 0.0], "{case}");
            let ratios = bench.ratios();
            let max = if is_silent { 1.0 } else { START };
            assert!(
                ratios.iter().all(|ratio| *ratio <= max * (1.0 + ROUNDING)),
                "{case}: {ratios:?}"
            );
        }
    }
}

/// Random machines, rates, clocks of the drives, distances and motions.
#[test]
fn no_start_leaves_the_limits() {
    let mut random = Random::new();
    for case in 0..cases(300) {
        let period_ns = *random.one_of(&[4_000_000, 1_000_000, 250_000]);
        let velocity = random.log(10.0, 1_000.0);
        let acceleration = random.log(2.0 * velocity, 50.0 * velocity);
        let limits = [velocity, acceleration, random.log(5.0, 200.0) * acceleration];
        let position = random.between(-1_000.0, 1_000.0);
        let mut motions = [(); 2].map(|()| RandomMotion::from_rest(position, limits, false));
        let mut actual = [0.0; AXES];
        for held in &mut actual[..2] {
            *held = position + random.between(-SYNC, SYNC);
        }
        let mut bench = Bench::new(settings(period_ns, limits, SYNC), actual);
        // The drives sample between the due times.
        bench.now_ns += random.below(period_ns as usize) as u64;
        let moves_from = 8 + random.below(40) as u64;
        let enabled_from = 10 + random.below(10) as u64;
        let mut has_followed = false;
        for sequence in 0..1_000 {
            let mut sent = setpoint(sequence, period_ns);
            for (axis, motion) in motions.iter_mut().enumerate() {
                if sequence >= moves_from {
                    motion.advance(&mut random, period_ns as f64 * 1e-9);
                }
                [sent.position[axis], sent.velocity[axis], sent.acceleration[axis]] = motion.state();
            }
            let target = bench.cycle(Some(sent), sequence >= enabled_from);
            has_followed |= target.state == BridgeState::Following;
        }
        let ratios = bench.ratios();
        // Differences may exceed the limits slightly because of discretisation and rounding of positions.
        let rate = 1e9 / period_ns as f64;
        let rounding = 4.0 * 2_000.0 * f64::EPSILON * rate * rate / acceleration;
        let max = [1.0 + START, 1.0 + START + rounding].map(|max| max * 1.02);
        assert!(
            ratios[0] <= max[0] && ratios[1] <= max[1],
            "case {case}: {period_ns} ns, {limits:?}, moves from {moves_from}, enabled from {enabled_from}: \
             {ratios:?}"
        );
        // A core that already moves faster than a thousandth of the velocity of its axes is not followed.
        assert!(has_followed || moves_from < enabled_from + 2, "case {case}");
    }
}

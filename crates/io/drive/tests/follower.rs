//! A bridge's conversion of setpoints to targets: missing, late, wrong ones, and those of another core.

#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use evolvent_drive::{
    BridgeState, Follower, FollowerSettings, Note, PowerRequest, Rejection, SettingsError, Target,
};
use evolvent_path::AxisMask;
use evolvent_random::Random;
use evolvent_wire::{AXES, Setpoint};

const PERIOD_NS: u64 = 1_000_000;
const BRIDGED: u32 = 4;
const LIMITS: [f64; 3] = [500.0, 5_000.0, 200_000.0];

fn settings() -> FollowerSettings {
    FollowerSettings {
        period_ns: PERIOD_NS,
        bridge_cycles: BRIDGED,
        axes: AxisMask::from_bits(0b11),
        max_velocity: [LIMITS[0]; AXES],
        max_acceleration: [LIMITS[1]; AXES],
        max_jerk: [LIMITS[2]; AXES],
        sync_tolerance: [0.5; AXES],
    }
}

/// A motion whose position, velocity and acceleration are known and continuous from rest, within the limits.
fn motion(time_s: f64) -> [[f64; AXES]; 3] {
    let mut state = [[0.0; AXES]; 3];
    for (axis, (size, turn)) in [(10.0, 12.0_f64), (7.0, 14.0)].into_iter().enumerate() {
        let angle = turn * time_s;
        state[0][axis] = size * (angle - angle.sin());
        state[1][axis] = size * turn * (1.0 - angle.cos());
        state[2][axis] = size * turn * turn * angle.sin();
    }
    state
}

fn setpoint(cycle: u64) -> Setpoint {
    // At rest for the first 20 cycles.
    let [position, velocity, acceleration] = if cycle < 20 {
        [[0.0; AXES]; 3]
    } else {
        motion((cycle - 20) as f64 * 1e-3)
    };
    Setpoint {
        sequence: cycle,
        due_time_ns: 5_000_000 + cycle * PERIOD_NS,
        period_ns: PERIOD_NS,
        position,
        velocity,
        acceleration,
        axes_mask: 0b11,
        power_request: PowerRequest::On.number(),
        ..Setpoint::default()
    }
}

/// A follower with ideal drives. Offers each setpoint two periods before it is due and keeps all targets.
struct Bench {
    follower: Follower,
    now_ns: u64,
    actual: [f64; AXES],
    targets: Vec<Target>,
}

impl Bench {
    fn new() -> Self {
        Self {
            follower: Follower::new(settings()).expect("limits"),
            now_ns: 3_000_000,
            actual: [0.0; AXES],
            targets: Vec::new(),
        }
    }

    fn cycle(&mut self, offered: Option<Setpoint>) -> Target {
        if let Some(setpoint) = offered {
            let _noted = self.follower.offer(self.now_ns, &setpoint);
        }
        self.now_ns += PERIOD_NS;
        let target = self.follower.step(self.now_ns, true, &self.actual);
        self.actual = target.position;
        self.targets.push(target);
        target
    }

    /// Runs the cycles `from..to`, with some setpoints left out.
    fn run(&mut self, from: u64, to: u64, missing: impl Fn(u64) -> bool) -> Target {
        let mut last = None;
        for cycle in from..to {
            last = Some(self.cycle((!missing(cycle)).then(|| setpoint(cycle))));
        }
        last.expect("cycles")
    }

    /// The maximum velocity, acceleration and jerk over the targets, as fractions of the limits.
    fn limit_fractions(&self) -> [f64; 3] {
        let mut limit_fractions = [0.0_f64; 3];
        for axis in 0..2 {
            let dt = PERIOD_NS as f64 * 1e-9;
            let differ = |values: &[f64]| -> Vec<f64> {
                values.windows(2).map(|pair| (pair[1] - pair[0]) / dt).collect()
            };
            let mut values: Vec<f64> = self.targets.iter().map(|target| target.position[axis]).collect();
            for order in 0..3 {
                values = differ(&values);
                let max = values.iter().fold(0.0, |max: f64, value| max.max(value.abs()));
                limit_fractions[order] = limit_fractions[order].max(max / LIMITS[order]);
            }
        }
        limit_fractions
    }
}

#[test]
fn setpoints_are_exact_at_due_times_and_between() {
    let mut bench = Bench::new();
    for cycle in 0..400 {
        let target = bench.cycle(Some(setpoint(cycle)));
        if cycle > 3 {
            assert_eq!(target.state, BridgeState::Following);
            assert_eq!(target.position, setpoint(target.sequence).position);
        }
    }
    assert_eq!((bench.follower.missed(), bench.follower.note()), (0, Note::None));
    // A drive whose clock is late by a third of a period gets targets between two setpoints.
    let mut follower = Follower::new(settings()).expect("limits");
    let mut worst = 0.0_f64;
    for cycle in 0..400 {
        let sent = setpoint(cycle);
        follower
            .offer(sent.due_time_ns - 2_000_000, &sent)
            .expect("taken");
        let now_ns = sent.due_time_ns - 2_000_000 + 333_333;
        let target = follower.step(now_ns, true, &[0.0; AXES]);
        if cycle > 40 {
            let time_s = (now_ns - 5_000_000) as f64 * 1e-9 - 0.020;
            for axis in 0..2 {
                worst = worst.max((target.position[axis] - motion(time_s)[0][axis]).abs());
            }
            assert_eq!(target.phase_error_ns, 333_333);
        }
    }
    // A quintic misses a sine of 14 rad/s by less than h^6 w^6 / 720.
    assert!(worst < 1e-9, "{worst}");
}

#[test]
fn a_few_missing_setpoints_are_bridged_within_a_hair() {
    for lost in 1..=u64::from(BRIDGED) - 1 {
        let mut bench = Bench::new();
        bench.run(0, 100, |_| false);
        bench.run(100, 300, |cycle| (150..150 + lost).contains(&cycle));
        for target in &bench.targets[10..] {
            assert!(matches!(
                target.state,
                BridgeState::Following | BridgeState::Bridging
            ));
        }
        for (i, target) in bench.targets.iter().enumerate().skip(10) {
            let true_position = setpoint(i as u64 - 1).position;
            for axis in 0..2 {
                // Jerk times time cubed over six: the motion's 20 000 mm/s3 and that of the decay, over 4 ms.
                let off = (target.position[axis] - true_position[axis]).abs();
                assert!(off < (20_000.0 + LIMITS[2]) * 4e-3_f64.powi(3) / 6.0, "{i} {off}");
            }
        }
        assert_eq!(u64::from(bench.follower.missed()), lost);
    }
}

/// The setpoints end at 50 random moments. The axes continue for the bridged periods, brake within the
/// limits, and hold.
#[test]
fn silence_ends_at_rest_within_limits_and_bounded() {
    let mut random = Random::new();
    for _ in 0..50 {
        let end = random.between(30.0, 600.0) as u64;
        let mut bench = Bench::new();
        bench.run(0, end, |_| false);
        let last = bench.run(end, end + 400, |_| true);
        assert_eq!(last.state, BridgeState::Holding, "{end}");
        assert_eq!(last.velocity, [0.0; AXES]);
        assert_eq!(bench.follower.note(), Note::Silence);
        // Distance: bridged periods at the present speed, plus a brake from the maximum speed.
        let limit_fractions = bench.limit_fractions();
        // 1 % for differences of positions.
        assert!(
            limit_fractions.iter().all(|fraction| *fraction <= 1.01),
            "{end}: {limit_fractions:?}"
        );
        let sent = setpoint(end - 1);
        for axis in 0..2 {
            let v = LIMITS[0];
            let max = v * f64::from(BRIDGED) * 1e-3 + v * (v / LIMITS[1] + LIMITS[1] / LIMITS[2]);
            assert!((last.position[axis] - sent.position[axis]).abs() < max);
        }
        let held = bench.run(end + 400, end + 500, |_| true);
        assert_eq!(held.position, last.position);
    }
}

#[test]
fn suspended_bridge_brakes_from_last_target() {
    for pause in [u64::from(BRIDGED) + 1, 60, 400] {
        let mut bench = Bench::new();
        bench.run(0, 300, |_| false);
        let before = bench.targets.len();
        // The core continues meanwhile, and the setpoints wait.
        for cycle in 300..300 + pause {
            let _noted = bench.follower.offer(bench.now_ns, &setpoint(cycle));
        }
        bench.now_ns += pause * PERIOD_NS;
        let first = bench.cycle(None);
        assert_eq!(first.state, BridgeState::Braking, "{pause}");
        // Again in the middle of the brake.
        bench.run(1000, 1010, |_| true);
        bench.now_ns += 100 * PERIOD_NS;
        let last = bench.run(1000, 1400, |_| true);
        assert_eq!(
            (last.state, last.velocity),
            (BridgeState::Holding, [0.0; AXES]),
            "{pause}"
        );
        assert!(bench.targets.len() > before);
        let limit_fractions = bench.limit_fractions();
        assert!(
            limit_fractions.iter().all(|fraction| *fraction <= 1.01),
            "{pause}: {limit_fractions:?}"
        );
    }
}

#[test]
fn following_resumes_only_at_positions_of_axes() {
    let mut bench = Bench::new();
    bench.run(0, 200, |_| false);
    bench.run(200, 600, |_| true);
    let held = bench.actual;
    // The core continues as if nothing had happened.
    let target = bench.run(600, 700, |_| false);
    assert_eq!((target.state, target.position), (BridgeState::Holding, held));
    assert_eq!(bench.follower.note(), Note::Jump);
    // It adapts to the machine instead, at rest.
    for cycle in 700..720 {
        let mut here = setpoint(cycle);
        (here.position, here.velocity, here.acceleration) = (held, [0.0; AXES], [0.0; AXES]);
        bench.cycle(Some(here));
    }
    assert_eq!(
        bench.targets.last().map(|target| target.state),
        Some(BridgeState::Following)
    );
}

#[test]
fn a_jump_is_refused_and_what_follows_it_too() {
    let mut bench = Bench::new();
    bench.run(0, 100, |_| false);
    let mut wild = setpoint(100);
    wild.position[0] += 3.0;
    assert_eq!(bench.follower.offer(bench.now_ns, &wild), Err(Rejection::Jump));
    assert_eq!(bench.follower.note(), Note::Jump);
    // A single wild setpoint among good ones counts as missing.
    bench.cycle(None);
    bench.run(101, 200, |_| false);
    assert_eq!(
        bench.targets.last().map(|target| target.state),
        Some(BridgeState::Following)
    );
    // From here on all are wrong: the axes brake and hold.
    for cycle in 200..400 {
        let mut off = setpoint(cycle);
        off.position[0] += 30.0;
        bench.cycle(Some(off));
    }
    assert_eq!(
        bench.targets.last().map(|target| target.state),
        Some(BridgeState::Holding)
    );
    let limit_fractions = bench.limit_fractions();
    assert!(
        limit_fractions.iter().all(|fraction| *fraction <= 1.01),
        "{limit_fractions:?}"
    );
}

/// Setpoints arrive two periods before they are due: the one that arrives in the period in which following
/// starts was not checked.
#[test]
fn jump_queued_before_enabling_is_refused() {
    let wrongs: [fn(&mut Setpoint); 3] = [
        |setpoint| setpoint.position[0] += 3.0,
        |setpoint| setpoint.velocity[1] = 2.0 * LIMITS[0],
        |setpoint| setpoint.acceleration[0] = 1e9,
    ];
    // The first wrong setpoint, and how many follow it.
    for (wrong, many) in wrongs.into_iter().flat_map(|wrong| [(wrong, 1), (wrong, 300)]) {
        let mut bench = Bench::new();
        let (enabled_at, first_wrong, mut has_noted) = (12, 12, false);
        for cycle in 0..first_wrong + many + 60 {
            let mut offered = setpoint(0);
            (offered.sequence, offered.due_time_ns) = (cycle, setpoint(cycle).due_time_ns);
            if (first_wrong..first_wrong + many).contains(&cycle) {
                wrong(&mut offered);
            }
            let _noted = bench.follower.offer(bench.now_ns, &offered);
            bench.now_ns += PERIOD_NS;
            let target = bench
                .follower
                .step(bench.now_ns, cycle >= enabled_at, &bench.actual);
            assert_eq!(target.position[..2], [0.0; 2], "{cycle}: {target:?}");
            bench.targets.push(target);
            has_noted |= bench.follower.note() == Note::Jump;
        }
        assert!(has_noted && bench.follower.missed() > 0);
        // One is bridged; many stop the axes, and the setpoints after them are at the positions of the axes.
        let has_held = bench.targets[20..]
            .iter()
            .any(|target| target.state == BridgeState::Holding);
        assert_eq!(has_held, many > 1);
        let last = bench.targets.last().expect("targets");
        assert_eq!(last.state, BridgeState::Following);
    }
}

/// Finite numbers and increasing due times that no axis can follow.
#[test]
fn impossible_accelerations_and_times_are_refused() {
    let (begin, until) = (100, 160);
    let deceptions: [fn(&mut Setpoint); 4] = [
        |setpoint| setpoint.acceleration[0] = 1e9,
        |setpoint| setpoint.acceleration[1] = -2.01 * LIMITS[1],
        |setpoint| setpoint.due_time_ns += 100 * PERIOD_NS,
        |setpoint| setpoint.due_time_ns += PERIOD_NS,
    ];
    for deceive in deceptions {
        let mut bench = Bench::new();
        bench.run(0, begin, |_| false);
        let mut wrong = setpoint(begin);
        deceive(&mut wrong);
        assert_eq!(bench.follower.offer(bench.now_ns, &wrong), Err(Rejection::Jump));
        bench.cycle(None);
        bench.run(begin + 1, until, |_| false);
        let limit_fractions = bench.limit_fractions();
        assert!(
            limit_fractions.iter().all(|fraction| *fraction <= 1.01),
            "{limit_fractions:?}"
        );
        // All from here on: the axes brake and hold.
        for cycle in until..until + 200 {
            let mut wrong = setpoint(cycle);
            deceive(&mut wrong);
            bench.cycle(Some(wrong));
        }
        let limit_fractions = bench.limit_fractions();
        assert!(
            limit_fractions.iter().all(|fraction| *fraction <= 1.05),
            "{limit_fractions:?}"
        );
    }
    // At rest a core may pause, but nothing moves meanwhile.
    let mut bench = Bench::new();
    bench.run(0, 10, |_| false);
    let mut later = setpoint(10);
    later.due_time_ns += 100 * PERIOD_NS;
    let mut elsewhere = later;
    elsewhere.position[0] += 1.0;
    assert_eq!(
        bench.follower.offer(bench.now_ns, &elsewhere),
        Err(Rejection::Jump)
    );
    assert_eq!(bench.follower.offer(bench.now_ns, &later), Ok(()));
}

#[test]
fn nan_late_far_and_repeated_setpoints_change_nothing() {
    let mut bench = Bench::new();
    bench.run(0, 100, |_| false);
    let before = bench.follower.missed();
    let good = setpoint(100);
    let mut bad = good;
    bad.velocity[1] = f64::NAN;
    assert_eq!(
        bench.follower.offer(bench.now_ns, &bad),
        Err(Rejection::NotFinite)
    );
    // Axes that the machine does not have may have any value.
    let mut other = good;
    other.position[5] = f64::INFINITY;
    assert_eq!(bench.follower.offer(bench.now_ns, &other), Ok(()));
    assert_eq!(bench.follower.offer(bench.now_ns, &good), Ok(()), "a repetition");
    let mut late = setpoint(101);
    late.due_time_ns = 17;
    assert_eq!(bench.follower.offer(bench.now_ns, &late), Err(Rejection::Late));
    for due_time_ns in [u64::MAX, 60_000_000_000] {
        let far = Setpoint { due_time_ns, ..late };
        assert_eq!(bench.follower.offer(bench.now_ns, &far), Err(Rejection::Future));
    }
    assert_eq!(bench.follower.missed(), before + 4);
    bench.cycle(None);
    bench.run(101, 200, |_| false);
    assert_eq!(
        bench.targets.last().map(|target| target.state),
        Some(BridgeState::Following)
    );
    assert!(bench.limit_fractions().iter().all(|fraction| *fraction <= 1.01));
}

/// A core dies in mid-motion and another starts at zero: the axes brake, under torque although the new core
/// does not request it yet, and then follow its request.
#[test]
fn new_core_stops_motion_of_old_one_within_limits() {
    let mut bench = Bench::new();
    bench.run(0, 180, |_| false);
    let mut off_after = None;
    for cycle in 0..400 {
        let mut new = setpoint(cycle + 181);
        new.sequence = cycle;
        new.position = [0.0; AXES];
        new.velocity = [0.0; AXES];
        new.acceleration = [0.0; AXES];
        new.power_request = PowerRequest::Off.number();
        let target = bench.cycle(Some(new));
        if target.state == BridgeState::Braking {
            assert_eq!(target.power, PowerRequest::On, "torque to brake with");
        }
        if target.power == PowerRequest::Off {
            off_after = off_after.or(Some(cycle));
        }
    }
    let last = bench.targets.last().expect("targets");
    assert_eq!(
        (last.state, last.power),
        (BridgeState::Holding, PowerRequest::Off)
    );
    assert!(off_after > Some(20), "{off_after:?}");
    let limit_fractions = bench.limit_fractions();
    assert!(
        limit_fractions.iter().all(|fraction| *fraction <= 1.01),
        "{limit_fractions:?}"
    );
    assert_eq!(bench.follower.note(), Note::Restart);
}

#[test]
fn target_is_actual_position_while_not_following() {
    let mut follower = Follower::new(settings()).expect("limits");
    let mut now_ns = 3_000_000;
    for cycle in 0..50 {
        let _taken = follower.offer(now_ns, &setpoint(cycle));
        now_ns += PERIOD_NS;
        let actual = [0.1 * cycle as f64; AXES];
        let target = follower.step(now_ns, false, &actual);
        assert_eq!(target.position, actual);
    }
    assert_eq!(follower.step(now_ns, false, &[0.0; AXES]).state, BridgeState::Off);
}

#[test]
fn silent_core_gives_no_power_before_following() {
    let mut follower = Follower::new(settings()).expect("limits");
    let mut now_ns = 5_000_000;
    for cycle in 0..10 {
        let _noted = follower.offer(now_ns, &setpoint(cycle));
        let target = follower.step(now_ns, false, &[0.0; AXES]);
        assert_eq!((target.power, target.is_silent), (PowerRequest::On, false));
        now_ns += PERIOD_NS;
    }
    let mut step = |periods: u64| {
        now_ns += periods * PERIOD_NS;
        let target = follower.step(now_ns, false, &[0.0; AXES]);
        (target.state, target.power, target.is_silent)
    };
    assert_eq!(step(2), (BridgeState::Off, PowerRequest::On, false));
    assert_eq!(step(2), (BridgeState::Off, PowerRequest::Off, true));
    assert_eq!(step(1_000), (BridgeState::Off, PowerRequest::Off, true));
}

#[test]
fn late_or_wrong_quick_stop_is_passed_on_at_once() {
    let mut bench = Bench::new();
    bench.run(0, 100, |_| false);
    let mut stop = setpoint(100);
    stop.power_request = PowerRequest::QuickStop.number();
    assert_eq!(
        bench.cycle(Some(stop)).power,
        PowerRequest::QuickStop,
        "before it is due"
    );
    let mut bench = Bench::new();
    bench.run(0, 100, |_| false);
    let mut stop = setpoint(100);
    stop.power_request = 77;
    stop.position[0] = f64::NAN;
    assert_eq!(bench.cycle(Some(stop)).power, PowerRequest::QuickStop);
}

#[test]
fn new_datum_at_rest_shifts_positions_without_motion() {
    let mut bench = Bench::new();
    bench.run(0, 10, |_| false);
    let mut shifts = Vec::new();
    for cycle in 10..40 {
        let mut renamed = setpoint(0);
        renamed.sequence = cycle;
        renamed.due_time_ns = setpoint(cycle).due_time_ns;
        if cycle >= 15 {
            renamed.datum = 1;
            renamed.position[0] = 123.25;
        }
        let target = bench.cycle(Some(renamed));
        assert_eq!(target.state, BridgeState::Following);
        if let Some(shift) = target.datum_shift {
            shifts.push((target.sequence, shift[0], shift[1]));
        }
        assert_eq!(target.position[0], if target.datum == 1 { 123.25 } else { 0.0 });
        assert_eq!(target.velocity, [0.0; AXES]);
    }
    assert_eq!(shifts, [(15, 123.25, 0.0)]);
    // In motion it is a jump.
    let mut bench = Bench::new();
    bench.run(0, 100, |_| false);
    let mut renamed = setpoint(100);
    renamed.datum = 2;
    assert_eq!(bench.follower.offer(bench.now_ns, &renamed), Err(Rejection::Jump));
}

#[test]
fn settings_that_are_none_are_named() {
    let mut bad = settings();
    bad.max_jerk[1] = f64::NAN;
    assert!(matches!(
        Follower::new(bad),
        Err(SettingsError::Limit { axis: 1, .. })
    ));
    bad = settings();
    bad.period_ns = 0;
    assert!(matches!(Follower::new(bad), Err(SettingsError::Period { .. })));
    bad = settings();
    bad.bridge_cycles = 1000;
    assert!(matches!(
        Follower::new(bad),
        Err(SettingsError::BridgeCycles { .. })
    ));
}

/// 35 kHz: the core sends nothing for 1.5 ms in motion, then the missed setpoints, and a scheduling pause of
/// that length stops no axis.
#[test]
fn host_pause_at_high_rate_does_not_stop_axes() {
    let period_ns = 28_571;
    for (pause_ns, is_stopped) in [(1_500_000, false), (3_000_000, true)] {
        let settings = FollowerSettings {
            period_ns,
            bridge_cycles: evolvent_drive::bridge_cycles(period_ns),
            ..settings()
        };
        let mut follower = Follower::new(settings).expect("limits");
        let (mut actual, mut has_stopped) = ([0.0; AXES], false);
        let pause = 3000..3000 + pause_ns / period_ns;
        for cycle in 0..5000_u64 {
            let due_time_ns = 5_000_000 + cycle * period_ns;
            let [position, velocity, acceleration] = if cycle < 700 {
                [[0.0; AXES]; 3]
            } else {
                motion(((cycle - 700) * period_ns) as f64 * 1e-9)
            };
            let sent = Setpoint {
                sequence: cycle,
                due_time_ns,
                period_ns,
                position,
                velocity,
                acceleration,
                ..setpoint(0)
            };
            let now_ns = due_time_ns - 2 * period_ns;
            if !pause.contains(&cycle) {
                let _noted = follower.offer(now_ns, &sent);
            }
            let target = follower.step(now_ns, true, &actual);
            actual = target.position;
            has_stopped |=
                cycle > 100 && !matches!(target.state, BridgeState::Following | BridgeState::Bridging);
        }
        assert_eq!(has_stopped, is_stopped, "{pause_ns} ns");
    }
}

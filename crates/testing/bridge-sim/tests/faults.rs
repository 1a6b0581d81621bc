//! Faults of the bridge at random moments: the core's watch raises the right alarm, and all axes stop within
//! the limits. Core and drives are pure models in simulated time.
#![expect(
    clippy::expect_used,
    reason = "helpers of tests fail as tests do, and tell their seed"
)]

use evolvent_path::AxisMask;
use evolvent_random::Random;
use std::collections::VecDeque;

use evolvent_bridge_sim::{Fault, FaultKind, SimBridge, SimSettings};
use evolvent_bus::{AXES, Feedback, Setpoint};
use evolvent_drive::{
    Brake, BrakeState, DriveAlarm, DriveSetpoint, DriveState, FeedbackWatch, PowerRequest, Presence,
    WatchSettings,
};

const PERIOD_NS: u64 = 1_000_000;
const PERIOD_S: f64 = 1e-3;
const LEAD: u64 = 2;
/// Velocity, acceleration, jerk.
const LIMITS: [f64; 3] = [500.0, 5_000.0, 200_000.0];

fn settings() -> SimSettings {
    let mut settings = SimSettings::usual("XYZ", PERIOD_NS);
    for axis in &mut settings.axes {
        (axis.max_velocity, axis.max_acceleration, axis.max_jerk) = (LIMITS[0], LIMITS[1], LIMITS[2]);
        axis.servo.strongest = 2.0 * LIMITS[1];
        (axis.travel_min, axis.travel_max) = (-1e5, 1e5);
    }
    settings
}

/// A core that waits for its drives, moves three axes without end, and stops each within its limits at an
/// alarm.
struct Core {
    watch: FeedbackWatch,
    cycle: u64,
    /// Initial position of all axes, mm; the drives are at 0.
    base: f64,
    /// Cycle at which motion began.
    moving_since: Option<u64>,
    stop: Option<(u64, [Brake; 3])>,
    last: [BrakeState; 3],
    alarm: Option<DriveAlarm>,
    power: PowerRequest,
}

impl Core {
    fn new(base: f64) -> Self {
        Self {
            base,
            watch: FeedbackWatch::new(WatchSettings::new(PERIOD_NS, AxisMask::from_bits(0b111))),
            cycle: 0,
            moving_since: None,
            stop: None,
            last: [BrakeState {
                position: base,
                ..BrakeState::default()
            }; 3],
            alarm: None,
            power: PowerRequest::On,
        }
    }

    fn motion(axis: usize, time_s: f64) -> BrakeState {
        let (size, turn) = [(10.0, 14.0), (8.0, 11.0), (5.0, 17.0)][axis];
        let angle: f64 = turn * time_s;
        BrakeState {
            position: size * (angle - angle.sin()),
            velocity: size * turn * (1.0 - angle.cos()),
            acceleration: size * turn * turn * angle.sin(),
        }
    }

    /// Runs one cycle at `now_ns`: takes the newest feedback and returns the setpoint.
    fn cycle(&mut self, now_ns: u64, feedback: Option<&Feedback>) -> Setpoint {
        if let Some((since, brakes)) = &self.stop {
            let time_s = (self.cycle - since) as f64 * PERIOD_S;
            self.last = brakes.map(|brake| brake.at(time_s));
        } else if let Some(since) = self.moving_since {
            let time_s = (self.cycle - since) as f64 * PERIOD_S;
            self.last = core::array::from_fn(|axis| {
                let motion = Self::motion(axis, time_s);
                BrakeState {
                    position: self.base + motion.position,
                    ..motion
                }
            });
        }
        let mut setpoint = Setpoint {
            sequence: self.cycle,
            due_time_ns: now_ns + LEAD * PERIOD_NS,
            period_ns: PERIOD_NS,
            axes_mask: 0b111,
            power_request: self.power.number(),
            ..Setpoint::default()
        };
        for (axis, state) in self.last.into_iter().enumerate() {
            setpoint.position[axis] = state.position;
            setpoint.velocity[axis] = state.velocity;
            setpoint.acceleration[axis] = state.acceleration;
        }
        match self.watch.step(now_ns, &DriveSetpoint::of(&setpoint), feedback) {
            Ok(Presence::Operational) if self.alarm.is_none() => {
                self.moving_since.get_or_insert(self.cycle + 1);
            }
            Ok(_) => {}
            Err(alarm) => {
                if self.alarm.is_none() {
                    self.alarm = Some(alarm);
                    let brakes = self.last.map(|state| Brake::new(state, LIMITS[1], LIMITS[2]));
                    self.stop = Some((self.cycle, brakes));
                    if !alarm.drives_follow() {
                        self.power = PowerRequest::QuickStop;
                    }
                }
            }
        }
        self.cycle += 1;
        setpoint
    }
}

struct Outcome {
    alarm: Option<DriveAlarm>,
    /// Time from the fault to the alarm, ns.
    noticed_ns: u64,
    /// Speed of each axis at the end.
    speed: [f64; 3],
    /// Maximum velocity and acceleration of the axes as fractions of the limits.
    limit_fractions: [f64; 2],
    states: Vec<DriveState>,
}

/// Runs with one fault. Both sides have their own clocks; that of the drives is off by half a period and
/// drifts.
fn run(fault: Option<Fault>, seconds: f64) -> Outcome {
    let mut bridge = SimBridge::new(&settings()).expect("limits");
    bridge.add_fault(fault.unwrap_or(Fault {
        kind: FaultKind::Late,
        at_ns: u64::MAX,
        duration_ns: None,
        axis: None,
    }));
    let mut core = Core::new(0.0);
    let mut in_transit: VecDeque<Feedback> = VecDeque::new();
    let mut outcome = Outcome {
        alarm: None,
        noticed_ns: 0,
        speed: [0.0; 3],
        limit_fractions: [0.0; 2],
        states: Vec::new(),
    };
    let blocked = fault
        .filter(|fault| fault.kind == FaultKind::Blocked)
        .map(|fault| fault.axis);
    let mut velocity = [0.0; 3];
    for cycle in 0..(seconds / PERIOD_S) as u64 {
        let now_ns = 1_000_000_000 + cycle * PERIOD_NS;
        // Messages arrive one period after they were sent.
        let newest = in_transit.drain(..).next_back();
        let setpoint = core.cycle(now_ns, newest.as_ref());
        bridge.offer(now_ns, &setpoint);
        let drives_ns = now_ns + 400_000 + cycle * 50;
        in_transit.extend(bridge.step(drives_ns));
        if outcome.alarm.is_none()
            && let (Some(alarm), Some(since_ns), Some(fault)) =
                (core.alarm, bridge.operating_since_ns(), fault)
        {
            outcome.alarm = Some(alarm);
            outcome.noticed_ns = (now_ns - since_ns).saturating_sub(fault.at_ns);
        }
        for (i, drive) in bridge.drives().iter().enumerate() {
            let now = drive.servo().velocity;
            if blocked != Some(Some(i)) {
                outcome.limit_fractions[0] = outcome.limit_fractions[0].max(now.abs() / LIMITS[0]);
                outcome.limit_fractions[1] =
                    outcome.limit_fractions[1].max((now - velocity[i]).abs() / PERIOD_S / LIMITS[1]);
            }
            velocity[i] = now;
        }
    }
    outcome.alarm = outcome.alarm.or(core.alarm);
    outcome.speed = velocity.map(f64::abs);
    outcome.states = bridge.drives().iter().map(|drive| drive.state()).collect();
    outcome
}

#[test]
fn a_minute_without_faults_has_no_alarm() {
    let outcome = run(None, 60.0);
    assert_eq!(outcome.alarm, None);
    assert!(outcome.limit_fractions[0] > 0.5, "{:?}", outcome.limit_fractions);
    assert!(
        outcome.limit_fractions.iter().all(|fraction| *fraction < 1.0),
        "{:?}",
        outcome.limit_fractions
    );
}

/// Following begins at a distance from the setpoints that is less than the following error: the core moves no
/// axis until most of the distance is gone.
#[test]
fn a_core_beside_its_axes_waits_until_they_have_come() {
    let floor = WatchSettings::new(PERIOD_NS, AxisMask::NONE).following_floor[0];
    for base in [0.1, -0.3, 0.45, -0.49] {
        let mut bridge = SimBridge::new(&settings()).expect("limits");
        let mut core = Core::new(base);
        let mut newest = None;
        let mut followed_from = None;
        for cycle in 0..2_000 {
            let now_ns = 1_000_000_000 + cycle * PERIOD_NS;
            let setpoint = core.cycle(now_ns, newest.as_ref());
            if newest.is_some_and(|feedback: Feedback| feedback.bridge_state == 1) {
                followed_from = followed_from.or(Some(cycle));
            }
            if core.moving_since == Some(core.cycle) {
                let far = (base - bridge.true_positions()[0]).abs();
                assert!(far <= 0.5 * floor, "{base}: moves {far} mm beside its axes");
                // The decay takes at most 0.15 s, and half of the distance is gone after half of the time.
                let waited = cycle - followed_from.expect("a bridge that follows");
                assert!(waited < 100, "{base}: waits for {waited} ms");
                assert_eq!(waited > 20, base.abs() > 0.5 * floor, "{base}: {waited} ms");
            }
            bridge.offer(now_ns, &setpoint);
            newest = bridge.step(now_ns + 400_000);
        }
        assert_eq!(core.alarm, None, "{base}");
        assert!(core.moving_since.is_some(), "{base}: never moves");
    }
}

/// Whether an alarm is the right one for a fault of an axis.
fn is_right(kind: FaultKind, axis: usize, alarm: &DriveAlarm) -> bool {
    match kind {
        FaultKind::Late | FaultKind::Silent => matches!(alarm, DriveAlarm::Stale { .. }),
        FaultKind::Frozen => matches!(alarm, DriveAlarm::Frozen { .. }),
        FaultKind::Stuck => {
            matches!(alarm, DriveAlarm::FrozenAxis { axis: named, .. } | DriveAlarm::FollowingError { axis: named, .. } if *named == axis)
        }
        FaultKind::Fault => {
            matches!(alarm, DriveAlarm::DriveFault { axis: named, error_code: 0x8611, .. } if *named == axis)
        }
        FaultKind::Off => matches!(alarm, DriveAlarm::DriveOff { axis: named, .. } if *named == axis),
        FaultKind::Jump => matches!(alarm, DriveAlarm::Jump { axis: named, .. } if *named == axis),
        FaultKind::Blocked => {
            matches!(alarm, DriveAlarm::FollowingError { axis: named, .. } | DriveAlarm::FrozenAxis { axis: named, .. } if *named == axis)
        }
        FaultKind::Nan => matches!(alarm, DriveAlarm::NotFinite { axis: named } if *named == axis),
        FaultKind::Wild => {
            matches!(alarm, DriveAlarm::Unbelievable { field: "position", axis: Some(named), .. } if *named == axis)
        }
        FaultKind::Ahead => matches!(alarm, DriveAlarm::AheadOfTime { .. }),
        kind => unreachable!("{kind:?} is no fault of the drives"),
    }
}

#[test]
fn every_fault_is_reported_and_stops_within_limits() {
    let mut random = Random::new();
    let of_drives = |kind: FaultKind| !kind.is_of_load() && !kind.is_of_spindle() && !kind.is_of_homing();
    for (kind, name) in FaultKind::ALL.into_iter().filter(|(kind, _)| of_drives(*kind)) {
        let (mut slowest_ns, mut limit_fractions) = (0, [0.0_f64; 2]);
        for _ in 0..50 {
            let axis = random.between(0.0, 3.0) as usize;
            let fault = Fault {
                kind,
                at_ns: random.between(0.05e9, 1.5e9) as u64,
                duration_ns: None,
                axis: Some(axis),
            };
            let outcome = run(Some(fault), 3.5);
            let Some(alarm) = outcome.alarm else {
                unreachable!("{fault}: no alarm");
            };
            assert!(is_right(kind, axis, &alarm), "{fault}: {alarm}");
            assert!(
                outcome.speed.iter().all(|speed| *speed < 1e-3),
                "{fault}: {:?}",
                outcome.speed
            );
            for i in 0..2 {
                limit_fractions[i] = limit_fractions[i].max(outcome.limit_fractions[i]);
            }
            slowest_ns = slowest_ns.max(outcome.noticed_ns);
        }
        println!(
            "{name}: noticed within {} ms, fractions of the limits {limit_fractions:.3?}",
            slowest_ns / 1_000_000
        );
        // The loop's response to a ramp of full acceleration overshoots a little.
        assert!(
            limit_fractions[0] <= 1.0 && limit_fractions[1] <= 1.15,
            "{name}: {limit_fractions:?}"
        );
    }
}

#[test]
fn a_fault_of_one_drive_stops_the_others_quickly() {
    let fault = "fault@0.4:Y".parse().expect("a fault");
    let outcome = run(Some(fault), 3.0);
    assert_eq!(
        outcome.states,
        [
            DriveState::SwitchOnDisabled,
            DriveState::Fault,
            DriveState::SwitchOnDisabled
        ]
    );
}

/// The setpoints end at random moments: the bridge alone stops the axes.
#[test]
fn drives_stop_by_themselves_when_the_core_dies() {
    let mut random = Random::new();
    let mut worst = 0.0_f64;
    for _ in 0..50 {
        let dies = random.between(60.0, 1500.0) as u64;
        let mut bridge = SimBridge::new(&settings()).expect("limits");
        let mut core = Core::new(0.0);
        let (mut newest, mut velocity) = (None, [0.0; 3]);
        let mut at_death = [0.0; 3];
        for cycle in 0..dies + 1500 {
            let now_ns = 1_000_000_000 + cycle * PERIOD_NS;
            if cycle < dies {
                let setpoint = core.cycle(now_ns, newest.as_ref());
                bridge.offer(now_ns, &setpoint);
            }
            newest = bridge.step(now_ns + 300_000);
            for (i, drive) in bridge.drives().iter().enumerate() {
                let now = drive.servo().velocity;
                worst = worst.max((now - velocity[i]).abs() / PERIOD_S / LIMITS[1]);
                velocity[i] = now;
                if cycle < dies {
                    at_death[i] = drive.servo().position;
                }
            }
        }
        assert!(core.alarm.is_none(), "{:?}", core.alarm);
        for (i, drive) in bridge.drives().iter().enumerate() {
            assert!(drive.servo().velocity.abs() < 1e-3);
            assert_eq!(drive.state(), DriveState::OperationEnabled, "held under torque");
            let v = LIMITS[0];
            let distance = v * 0.02 + v * v / (2.0 * LIMITS[1]) + v * LIMITS[1] / LIMITS[2];
            assert!((drive.servo().position - at_death[i]).abs() < distance);
        }
    }
    assert!(worst <= 1.15, "{worst}");
}

#[test]
fn the_same_inputs_give_the_same_feedback_to_the_bit() {
    let feedback = || {
        let mut bridge = SimBridge::new(&settings()).expect("limits");
        let mut core = Core::new(0.0);
        let mut newest = None;
        let mut all = Vec::new();
        for cycle in 0..500 {
            let now_ns = 1_000_000_000 + cycle * PERIOD_NS;
            let setpoint = core.cycle(now_ns, newest.as_ref());
            bridge.offer(now_ns, &setpoint);
            newest = bridge.step(now_ns + 300_000);
            all.extend(newest.map(|feedback| feedback.position.map(f64::to_bits)));
        }
        all
    };
    let first: Vec<[u64; AXES]> = feedback();
    assert!(first.len() > 400 && first == feedback());
}

#[test]
fn a_load_sensor_fails_as_configured() {
    for (kind, name) in FaultKind::ALL.into_iter().filter(|(kind, _)| kind.is_of_load()) {
        let mut settings = settings();
        settings.faults = vec![format!("{name}@0.5+0.2").parse().expect("a fault")];
        let mut bridge = SimBridge::new(&settings).expect("a bridge");
        let (mut since, mut faulty) = (None, 0);
        for cycle in 1..2000_u64 {
            let now_ns = cycle * PERIOD_NS;
            let setpoint = Setpoint {
                sequence: cycle,
                due_time_ns: now_ns,
                period_ns: PERIOD_NS,
                axes_mask: 7,
                power_request: PowerRequest::On.number(),
                ..Setpoint::default()
            };
            bridge.offer(now_ns, &setpoint);
            bridge.step(now_ns);
            since = since.or(bridge.operating_since_ns());
            let value = 100.0 + cycle as f64;
            let read = bridge.load_reading(now_ns, (value, 5000.0));
            let after_ns = since.map(|since| now_ns - since);
            if after_ns.is_none_or(|ns| !(500_000_000..700_000_000).contains(&ns)) {
                assert_eq!(read, Some((value, 5000.0)), "{name}");
                continue;
            }
            faulty += 1;
            let as_configured = match kind {
                FaultKind::LoadZero => read == Some((0.0, 5000.0)),
                FaultKind::LoadLost => read.is_none(),
                FaultKind::LoadNan => read.is_some_and(|(value, _)| value.is_nan()),
                FaultKind::LoadSaturated => read == Some((5000.0, 5000.0)),
                FaultKind::LoadNegative => read == Some((-5000.0, 5000.0)),
                // The value at its first moment.
                _ => read == Some((value - f64::from(faulty - 1), 5000.0)),
            };
            assert!(as_configured, "{name}: {read:?} for {value}");
        }
        assert_eq!(faulty, 200, "{name}");
    }
}

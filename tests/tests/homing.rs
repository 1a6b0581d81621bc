//! Homing by switch, index pulse and absolute encoder in closed loop with simulated drives: in simulated time
//! with faults at random moments, and served, with a trace that is recomputed.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::collections::VecDeque;

use evolvent_bridge_sim::{Fault, FaultKind, SimBridge, SimIndex, SimSettings};
use evolvent_bus::{AXES, ControlRequest, Feedback, Setpoint, Status};
use evolvent_control::{Alarm, Homing, HomingAction, HomingAxis, HomingSample, Rejection};
use evolvent_drive::{DriveSetpoint, FeedbackWatch, PowerRequest, Presence, WatchSettings};
use evolvent_machine::{HomingMethod, Limits};
use evolvent_motion::{MotionState, SetpointGenerator, TransferExecutor};
use evolvent_path::{Axes, AxisLetter, AxisMask};
use evolvent_replay::verify;
use evolvent_tests::{Domain, Drives, Operator, Random, Served, Workshop, command, unless_disturbed};
use evolvent_transfer::{AxesState, Sync, Transfer};

const PERIOD_NS: u64 = 1_000_000;
const LEAD: u64 = 2;
const TRAVEL: [f64; 2] = [-150.0, 150.0];
const PITCH: f64 = 4.0;

fn limits() -> Limits {
    let mut present = [false; AXES];
    present[0] = true;
    Limits {
        present,
        velocity: Axes::repeat(400.0),
        acceleration: Axes::repeat(4000.0),
        jerk: Axes::repeat(100_000.0),
        travel_min: Axes::repeat(TRAVEL[0]),
        travel_max: Axes::repeat(TRAVEL[1]),
        home: Axes::zeros(),
    }
}

/// The part of a core that homes one axis.
struct Core {
    station: SetpointGenerator,
    steering: Option<TransferExecutor>,
    homing: Homing,
    watch: FeedbackWatch,
    datum: u64,
    index: (u32, u32),
    is_operational: bool,
    outcome: Option<Result<(), Rejection>>,
}

impl Core {
    fn new(axis: HomingAxis, position: Axes) -> Self {
        Self {
            station: SetpointGenerator::new(far(), PERIOD_NS, position),
            steering: None,
            homing: Homing::new(vec![axis], 5),
            watch: FeedbackWatch::new(WatchSettings::new(PERIOD_NS, AxisMask::one(0))),
            datum: 0,
            index: (0, 0),
            is_operational: false,
            outcome: None,
        }
    }

    fn move_to(&mut self, to: f64, speed: f64) {
        let from = AxesState::at_rest(self.station.position());
        let mut limits = far();
        limits.velocity[0] = speed;
        let mut target = from.position;
        target[0] = to;
        let solved = Transfer::solve(&limits, &from, &AxesState::at_rest(target), Sync::Time);
        self.steering = Some(TransferExecutor::new(solved.expect("a transfer")));
    }

    fn act(&mut self, feedback: &Feedback) {
        let at_rest = self.steering.is_none() && self.station.is_at_rest();
        if !self.is_operational || feedback.datum != self.datum || self.outcome.is_some() {
            return;
        }
        let sample = HomingSample {
            time_ns: feedback.time_ns,
            position: Axes::from(feedback.position),
            switches: AxisMask::from_bits(feedback.home_switch_mask),
            limits: [feedback.negative_limit_mask, feedback.positive_limit_mask].map(AxisMask::from_bits),
            absolute: AxisMask::from_bits(feedback.absolute_mask),
            index_request: feedback.index_request,
            index_position: (!feedback.index_position.is_nan()).then_some(feedback.index_position),
        };
        let here = self.station.position();
        match self.homing.step(&sample, at_rest) {
            HomingAction::Wait | HomingAction::TakePosition { .. } => {}
            HomingAction::Move { distance, speed, .. } => self.move_to(here[0] + distance, speed),
            HomingAction::Home { position, speed, .. } => self.move_to(position, speed),
            HomingAction::Stop => {
                if let Some(steering) = &mut self.steering {
                    steering.stop();
                }
            }
            HomingAction::LatchIndex { request, .. } => self.index = (request, 0),
            HomingAction::SetZero {
                position, coordinate, ..
            } => {
                let mut renamed = here;
                renamed[0] += coordinate - position;
                self.station.relocate(far(), renamed);
                self.datum += 1;
            }
            HomingAction::Done => self.outcome = Some(Ok(())),
            HomingAction::Fail(rejection) => {
                assert!(at_rest, "it fails in motion: {rejection}");
                self.outcome = Some(Err(rejection));
            }
        }
    }

    fn cycle(&mut self, now_ns: u64, feedback: Option<&Feedback>) -> Setpoint {
        if let Some(feedback) = feedback {
            self.act(feedback);
        }
        let step = match &mut self.steering {
            Some(steering) => self.station.steer(steering),
            None => self.station.rest(MotionState::Idle),
        };
        assert_eq!(self.station.take_fault(), None, "within the limits");
        if matches!(step.state, MotionState::Done | MotionState::Stopped) && self.steering.take().is_some() {
            self.station.end();
        }
        let setpoint = Setpoint {
            sequence: step.sequence,
            due_time_ns: now_ns + LEAD * PERIOD_NS,
            period_ns: PERIOD_NS,
            position: step.position.into(),
            velocity: step.velocity.into(),
            acceleration: step.acceleration.into(),
            axes_mask: 1,
            power_request: PowerRequest::On.number(),
            datum: self.datum,
            index_request: self.index.0,
            index_axis: self.index.1,
            ..Setpoint::default()
        };
        let expected = DriveSetpoint {
            switches_expected: self.homing.expected_limits(),
            ..DriveSetpoint::of(&setpoint)
        };
        let presence = self.watch.step(now_ns, &expected, feedback).expect("no alarm");
        self.is_operational = presence == Presence::Operational;
        setpoint
    }
}

/// Limits of an axis whose zero is unknown.
fn far() -> Limits {
    Limits {
        travel_min: Axes::repeat(-5000.0),
        travel_max: Axes::repeat(5000.0),
        ..limits()
    }
}

/// The drive of one axis: its start position, the end at which its switch is, and the position of a pulse.
fn drive(start: f64, is_negative: bool, switch: f64, pulse: f64) -> SimSettings {
    let mut settings = SimSettings::usual("X", PERIOD_NS);
    let axis = &mut settings.axes[0];
    (axis.max_velocity, axis.max_acceleration, axis.max_jerk) = (400.0, 4000.0, 100_000.0);
    axis.servo.strongest = 8000.0;
    // It can move beyond the ends of its travel: the test checks how far it does.
    (axis.travel_min, axis.travel_max) = (10.0 * TRAVEL[0], 10.0 * TRAVEL[1]);
    (axis.start, axis.reference_offset) = (start, 7.25);
    (axis.home_switch, axis.home_switch_is_below) = (switch, is_negative);
    axis.index = Some(SimIndex {
        position: pulse,
        pitch: PITCH,
    });
    settings
}

struct Trial {
    axis: HomingAxis,
    drives: SimSettings,
    fault: Option<Fault>,
}

/// The result, the error of the axis coordinate, and the range of motion.
fn run(trial: &Trial) -> (Result<(), Rejection>, f64, [f64; 2]) {
    let mut bridge = SimBridge::new(&trial.drives).expect("limits");
    trial.fault.into_iter().for_each(|fault| bridge.add_fault(fault));
    let mut start = Axes::zeros();
    start[0] = bridge.shown_positions()[0];
    let mut core = Core::new(trial.axis, start);
    let mut in_transit: VecDeque<Feedback> = VecDeque::new();
    let mut reach = [f64::INFINITY, f64::NEG_INFINITY];
    for cycle in 0..400_000 {
        let now_ns = 1_000_000_000 + cycle * PERIOD_NS;
        let newest = in_transit.drain(..).next_back();
        let setpoint = core.cycle(now_ns, newest.as_ref());
        bridge.offer(now_ns, &setpoint);
        in_transit.extend(bridge.step(now_ns + 400_000 + cycle % 1000));
        let position = bridge.true_positions()[0];
        reach = [reach[0].min(position), reach[1].max(position)];
        assert!(
            bridge.drives()[0].servo().velocity.abs() < 400.0,
            "the axis keeps its limit"
        );
        if let Some(outcome) = core.outcome.take() {
            let wrong = bridge.shown_positions()[0] - bridge.true_positions()[0];
            return (outcome, wrong, reach);
        }
    }
    unreachable!("homing has no end");
}

fn trial(random: &mut Random) -> Trial {
    let is_negative = random.bits().is_multiple_of(2);
    let when_opening = random.bits().is_multiple_of(2);
    let direction = if is_negative { -1.0 } else { 1.0 };
    let switch = direction * 140.0;
    let direction_of_edge = if when_opening { -direction } else { direction };
    // Not so near to the switch that its sampling decides which pulse is found.
    let pulse = switch + direction_of_edge * random.between(0.3, 0.9) * PITCH;
    let axis = HomingAxis {
        axis: AxisLetter::X,
        method: HomingMethod::SwitchThenIndex {
            when_opening,
            within: 1.3 * PITCH,
        },
        order: 0,
        direction,
        search_velocity: random.between(50.0, 200.0),
        latch_velocity: random.between(2.0, 20.0),
        reference: pulse,
        travel: TRAVEL[1] - TRAVEL[0],
        home: 0.0,
    };
    let start = random.between(TRAVEL[0], TRAVEL[1]);
    Trial {
        axis,
        drives: drive(start, is_negative, switch, pulse),
        fault: None,
    }
}

#[test]
fn the_index_pulse_homes_exactly_from_any_start() {
    let mut random = Random::new();
    for _ in 0..40 {
        let trial = trial(&mut random);
        let (outcome, wrong, _) = run(&trial);
        assert_eq!(outcome, Ok(()), "{:?}", trial.axis);
        // The grid of the encoder; the latch itself is exact.
        assert!(wrong.abs() < 1e-4, "{wrong} {:?}", trial.axis);
    }
}

/// A wire that breaks or a switch that sticks: the right alarm at rest, or the right zero if the fault came
/// too late to matter. A break that looks like the expected edge cannot be distinguished from it and is
/// excluded.
#[test]
fn faults_at_random_moments_raise_their_alarm() {
    let mut random = Random::new();
    let mut ended = [0; 4];
    let mut trials = 0;
    // Some results are rare.
    while trials < 120 || trials < 2000 && ended.iter().any(|count| *count <= 3) {
        trials += 1;
        let mut trial = trial(&mut random);
        let HomingMethod::SwitchThenIndex { when_opening, .. } = trial.axis.method else {
            unreachable!("a switch and an index");
        };
        let (kind, at_s) = match (random.bits() % 3, when_opening) {
            (0, _) => (FaultKind::IndexMissing, random.between(0.0, 12.0)),
            (1, true) => (FaultKind::SwitchClosed, random.between(0.0, 12.0)),
            (1, false) => (FaultKind::SwitchClosed, 0.0),
            (_, true) => (FaultKind::SwitchOpen, 0.0),
            (_, false) => (FaultKind::SwitchOpen, random.between(0.0, 12.0)),
        };
        trial.fault = Some(Fault {
            kind,
            at_ns: (at_s * 1e9) as u64,
            duration_ns: None,
            axis: Some(0),
        });
        let (outcome, wrong, reach) = run(&trial);
        let alarm = outcome.as_ref().err().map(|rejection| rejection.alarm);
        let right: &[Alarm] = match kind {
            FaultKind::IndexMissing => &[Alarm::IndexMissing],
            // Held closed by a broken wire, the switch is left and not found again.
            FaultKind::SwitchClosed => &[Alarm::HomeSwitchStuck, Alarm::HomeSwitchMissing],
            _ => &[Alarm::HomeSwitchMissing, Alarm::HomeSwitchStuck],
        };
        match alarm {
            None => assert!(wrong.abs() < 1e-4, "{kind:?} {at_s}: {wrong}"),
            Some(alarm) => assert!(right.contains(&alarm), "{kind:?} {at_s}: {alarm:?}"),
        }
        // 1.1 of the travel for the search, half of it for backing off.
        let length = reach[1] - reach[0];
        assert!(
            length < 1.7 * (TRAVEL[1] - TRAVEL[0]),
            "{kind:?} {at_s}: {length}"
        );
        ended[match alarm {
            None => 0,
            Some(Alarm::IndexMissing) => 1,
            Some(Alarm::HomeSwitchMissing) => 2,
            Some(_) => 3,
        }] += 1;
    }
    assert!(ended.iter().all(|count| *count > 3), "{ended:?}");
}

/// X by the pulse while leaving the switch, Y by the pulse after it, Z by its absolute encoder.
const THREE: &str = "
[[homing]]
axis = \"X\"
method = \"switch-index\"
index_edge = \"opening\"
towards = \"negative\"
order = 2
search_mm_s = 200
latch_mm_s = 10
index_mm = -380
index_within_mm = 6
[[homing]]
axis = \"Y\"
method = \"switch-index\"
towards = \"positive\"
order = 1
search_mm_s = 200
latch_mm_s = 10
index_mm = 240
index_within_mm = 6
[[homing]]
axis = \"Z\"
method = \"absolute\"
";

/// Imported axes: the pulse of X and the switch of Y are slightly beyond the travel.
const BEYOND: &str = "
[[homing]]
axis = \"X\"
method = \"switch-index\"
index_edge = \"opening\"
towards = \"positive\"
search_mm_s = 200
latch_mm_s = 10
index_mm = 406.35
index_within_mm = 12
[[homing]]
axis = \"Y\"
towards = \"negative\"
search_mm_s = 200
latch_mm_s = 10
switch_mm = -260
";

struct Mill {
    workshop: Workshop,
    _drives: Drives,
    served: Served,
    domain: Domain,
}

impl Mill {
    fn new(name: &str, options: &[&str]) -> Self {
        Self::with(name, options, THREE)
    }

    fn with(name: &str, options: &[&str], homing: &str) -> Self {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let shipped = workshop.mill(name, &[]);
        let text = std::fs::read_to_string(shipped).expect("a machine file");
        let text = text.replace("feedback_timeout_ms = 20", "feedback_timeout_ms = 1000");
        let machine = workshop.write(&format!("{name}.toml"), format!("{text}\n{homing}"));
        let trace = workshop.path("homing.mcap");
        let recorded = ["--trace", trace.to_str().expect("UTF-8")];
        let served = Served::start(&machine, name, &domain, &workshop.path("state"), &recorded);
        let drives = Drives::start(&machine, &domain, options);
        Self {
            workshop,
            _drives: drives,
            served,
            domain,
        }
    }

    fn operator(&self, name: &str) -> Operator {
        let mut operator = Operator::join(name, &self.domain);
        operator.waits("drives", |status| status.feedback_age_ns < 1_000_000_000);
        operator.brings_up();
        operator.says_number("MODE", 1);
        operator
    }
}

/// Homes axes, and returns the status at the end of the job.
fn home(operator: &mut Operator, mask: u32) -> Status {
    let request = ControlRequest {
        axes_mask: mask,
        ..command("HOME")
    };
    let job = operator.does(&request).job;
    operator.sees_end(job)
}

/// Homes X and Y, after which all axes are homed: each offset is that of the encoders.
fn homes_x_and_y(operator: &mut Operator, offset: f64, tolerance: f64) {
    let status = home(operator, 0b011);
    assert_eq!(
        (status.job_result, status.homed_mask),
        (1, 0b111),
        "{}",
        status.alarm_sentence()
    );
    for axis in [0, 1] {
        let wrong = status.home_offset[axis] - offset;
        assert!(wrong.abs() < tolerance, "axis {axis}: {wrong}");
    }
}

#[test]
fn simulated_axes_home_to_a_zero_beyond_their_travel() {
    unless_disturbed(|| {
        let mill = Mill::with("home-beyond", &["--reference-offset", "3.5"], BEYOND);
        let mut operator = mill.operator("home-beyond");
        homes_x_and_y(&mut operator, 3.5, 0.05);
        drop(operator);
        let _finished = mill.served.end();
    });
}

#[test]
fn a_served_mill_homes_and_its_trace_is_recomputed() {
    unless_disturbed(|| {
        let mill = Mill::new("home-index", &["--absolute", "--reference-offset", "7.25"]);
        let mut operator = mill.operator("home-index");
        assert_eq!(operator.now().homed_mask, 0);
        let before = operator.now().position_machine;
        let status = home(&mut operator, 0b100);
        assert_eq!((status.job_result, status.homed_mask), (1, 0b100));
        assert_eq!(status.position_machine, before, "nothing moves");
        homes_x_and_y(&mut operator, 7.25, 1e-3);
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", "G0 X-20 Y10").job;
        assert_eq!(operator.sees_end(job).job_result, 1);
        drop(operator);
        let Mill { workshop, served, .. } = mill;
        served.end().expect_code(&[0, 3]);
        let again = verify(&workshop.path("homing.mcap")).expect("a readable trace");
        assert!(again.holds() && again.uncompared == 0, "{again:?}");
    });
}

#[test]
fn missing_switches_and_lost_zeros_are_reported() {
    unless_disturbed(|| {
        let faults = [
            "--absolute",
            "--fault",
            "index-missing@0:Y",
            "--fault",
            "absolute-lost@8:Z",
        ];
        let mill = Mill::new("home-faults", &faults);
        let mut operator = mill.operator("home-faults");
        let status = home(&mut operator, 0b100);
        assert_eq!(status.homed_mask, 0b100, "{}", status.alarm_sentence());
        let status = home(&mut operator, 0b010);
        assert_eq!(status.listed_alarms(), [422], "{}", status.alarm_sentence());
        let sentence = status.alarm_sentence().to_owned();
        assert!(
            sentence.contains("axis Y") && sentence.contains("of 6.0"),
            "{sentence}"
        );
        let status = operator.waits("the encoder of Z has lost its zero", |status| {
            status.homed_mask & 0b100 == 0
        });
        assert!(
            status.listed_alarms().contains(&418),
            "{}",
            status.alarm_sentence()
        );
        operator.says("CLEAR_ALARMS");
        operator.waits("clear", |status| status.alarm_count == 0);
        operator.says("ON");
        operator.waits("power", |status| status.machine_state == 2);
        let status = home(&mut operator, 0b100);
        assert_eq!(status.listed_alarms(), [423], "{}", status.alarm_sentence());
        drop(operator);
        mill.served.end().expect_code(&[0, 3]);
    });
}

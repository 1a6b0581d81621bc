//! Homing that is broken off at any moment: operator, cycle and a bridge with one drive in one thread, in time of their own.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc;

use evolvent_bus::{ControlRequest, Feedback, Setpoint};
use evolvent_control::{self as control, CommandCode};
use evolvent_drive::{DriveState, FeedbackWatch, Follower, FollowerSettings, PowerRequest};
use evolvent_machine::Machine;
use evolvent_motion::{DrivenPath, MachineState};
use evolvent_path::{AXES, Axes, AxisMask};
use evolvent_signals::ProbeInput;
use rtrb::{Consumer, Producer, RingBuffer};

use super::operator::{Job, Operator, OperatorConfig};
use super::orders::{CycleCommand, CycleEvent, CycleView};
use super::served_cycle::{ServedCycle, ServedParts};
use super::state_store::StateStore;
use super::urgent::UrgentOrders;
use crate::core_loop::{CycleBegin, CycleCounts, CycleEnd, SetpointSource};
use crate::drives::watch_settings;
use crate::job::Setup;
use crate::rt::MonotonicClock;
use crate::shared::Controls;

const PERIOD_NS: u64 = 1_000_000;
const LEAD: u64 = 2;
/// Where the motor of X closes its switch, and the machine coordinate of that.
const EDGE: f64 = -20.0;
const REFERENCE: f64 = -5.0;
/// Errors of the trial are smaller, mm: a switch is seen some periods late, and feedback is as old. A wrong zero is off by 15 mm.
const NEAR: f64 = 0.2;
const HOMING: &str =
    "[[homing]]\naxis = \"X\"\ntowards = \"negative\"\nsearch_mm_s = 50\nlatch_mm_s = 5\nswitch_mm = -5\n";

/// What breaks homing off.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Trouble {
    EmergencyStop,
    DriveFault,
}

/// A follower with ideal drives behind it.
struct Bridge {
    follower: Follower,
    motor: [f64; AXES],
    /// Coordinates less positions of the motors.
    offset: [f64; AXES],
    power: PowerRequest,
    has_fault: bool,
    /// It takes over the number of a datum, and goes on counting as before.
    keeps_names: bool,
}

impl Bridge {
    fn new(setup: &Setup) -> Self {
        let mut settings = FollowerSettings {
            period_ns: PERIOD_NS,
            bridge_cycles: 10,
            axes: AxisMask::NONE,
            max_velocity: [1.0; AXES],
            max_acceleration: [1.0; AXES],
            max_jerk: [1.0; AXES],
            sync_tolerance: [0.5; AXES],
        };
        for axis in &setup.machine.axes {
            let i = axis.letter.index();
            settings.axes |= AxisMask::one(i);
            settings.max_velocity[i] = axis.max_velocity;
            settings.max_acceleration[i] = axis.max_acceleration;
            settings.max_jerk[i] = axis.max_jerk;
        }
        Self {
            follower: Follower::new(settings).unwrap(),
            motor: [0.0; AXES],
            offset: [0.0; AXES],
            power: PowerRequest::Off,
            has_fault: false,
            keeps_names: false,
        }
    }

    fn shown(&self) -> [f64; AXES] {
        std::array::from_fn(|axis| self.motor[axis] + self.offset[axis])
    }

    fn step(&mut self, now_ns: u64) -> Feedback {
        let is_enabled = self.power == PowerRequest::On && !self.has_fault;
        let target = self.follower.step(now_ns, is_enabled, &self.shown());
        self.power = target.power;
        if let (Some(shift), false) = (target.datum_shift, self.keeps_names) {
            for axis in 0..AXES {
                self.offset[axis] += shift[axis];
            }
        }
        if is_enabled && !(self.keeps_names && target.datum > 0) {
            self.motor = std::array::from_fn(|axis| target.position[axis] - self.offset[axis]);
        }
        let state = match (self.has_fault, is_enabled) {
            (true, _) => DriveState::Fault,
            (_, true) => DriveState::OperationEnabled,
            (_, false) => DriveState::SwitchedOn,
        };
        Feedback {
            sequence: target.sequence,
            time_ns: MonotonicClock::now_ns(),
            axes_mask: 0b111,
            bridge_state: target.state.number(),
            datum: target.datum,
            instance: target.instance(7),
            position: self.shown(),
            status_word: [u32::from(state.code()); AXES],
            home_switch_mask: u32::from(self.motor[0] <= EDGE),
            index_position: f64::NAN,
            ..Feedback::default()
        }
    }
}

struct Bench {
    operator: Operator,
    cycle: ServedCycle,
    views: Consumer<CycleView>,
    events: Consumer<CycleEvent>,
    answers: Consumer<Feedback>,
    to_operator: Producer<Feedback>,
    to_cycle: Producer<Feedback>,
    _folder: tempfile::TempDir,
    counts: CycleCounts,
    bridge: Bridge,
    now: u64,
    serial: u64,
}

impl Bench {
    fn new() -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let text = std::fs::read_to_string(&file).unwrap() + "\n" + HOMING;
        let machine = Machine::parse(&text, "mill.toml").unwrap();
        let mut setup = Setup::new(machine, file, text, None).unwrap();
        setup.period_ns = PERIOD_NS;
        let limits = setup.machine.limits();
        let (orders, cycle_orders) = RingBuffer::new(1024);
        let (cycle_events, events) = RingBuffer::new(4096);
        let (cycle_views, mut views) = RingBuffer::new(4096);
        let (to_cycle, feedback) = RingBuffer::new(16);
        let (to_operator, answers) = RingBuffer::new(16);
        let (periphery, _publisher) = mpsc::channel();
        let urgent = Arc::<UrgentOrders>::default();
        let mut cycle = ServedCycle::new(ServedParts {
            urgent: Arc::clone(&urgent),
            station: MachineState::new(limits, PERIOD_NS, Axes::zeros()),
            limits,
            period_ns: PERIOD_NS,
            orders: cycle_orders,
            events: cycle_events,
            views: cycle_views,
            feedback,
            watch: FeedbackWatch::new(watch_settings(&setup.machine, PERIOD_NS)),
            signals: None,
            corrections: None,
            probe: ProbeInput::default(),
            wheel_counts: None,
            phase: None,
            controls: Arc::new(Controls::new(1.0)),
            driven: DrivenPath::new(PERIOD_NS),
        });
        let counts = CycleCounts::default();
        let mut bridge = Bridge::new(&setup);
        cycle_once(&mut cycle, &mut bridge, 0, &counts);
        let folder = tempfile::tempdir().unwrap();
        let operator = Operator::new(OperatorConfig {
            keep: StateStore::open(setup.memory.clone(), folder.path()),
            setup,
            folder: folder.path().to_owned(),
            orders,
            recorder: None,
            periphery,
            urgent,
            view: views.pop().unwrap(),
        })
        .unwrap();
        let mut bench = Self {
            operator,
            cycle,
            views,
            events,
            answers,
            to_operator,
            to_cycle,
            _folder: folder,
            counts,
            bridge,
            now: 0,
            serial: 0,
        };
        bench.run(50);
        bench.comes_up();
        bench
    }

    fn comes_up(&mut self) {
        for code in [
            CommandCode::EstopReset,
            CommandCode::ClearAlarms,
            CommandCode::On,
            CommandCode::Mode,
        ] {
            self.says(code, u32::from(code == CommandCode::Mode));
            self.run(200);
        }
    }

    fn says(&mut self, code: CommandCode, index: u32) {
        self.serial += 1;
        let request = ControlRequest {
            command: code as u32,
            index,
            client: 1,
            serial: self.serial,
            ..ControlRequest::default()
        };
        let answer = self.operator.answer(&request, MonotonicClock::now_ns());
        assert!(
            answer.is_some_and(|answer| answer.verdict == 0),
            "{code:?}: {}",
            answer.map_or_else(String::new, |answer| answer.text().to_owned())
        );
    }

    /// One period of bridge, cycle and operator.
    fn period(&mut self) {
        self.now += 1;
        let feedback = self.bridge.step(100_000_000 + self.now * PERIOD_NS);
        let _full = self.to_cycle.push(feedback);
        cycle_once(&mut self.cycle, &mut self.bridge, self.now, &self.counts);
        let _full = self.to_operator.push(feedback);
        let (views, events, answers) = (&mut self.views, &mut self.events, &mut self.answers);
        self.operator
            .tick(MonotonicClock::now_ns(), views, events, answers, |_| {});
    }

    fn run(&mut self, periods: u64) {
        for _ in 0..periods {
            self.period();
        }
    }

    fn is_homed(&self) -> bool {
        self.operator.desk.homed().contains(0)
    }

    fn is_busy(&self) -> bool {
        !matches!(self.operator.job, Job::None)
    }

    /// By how much the coordinate of X is wrong: a period of the approach, and the delay of the feedback.
    fn error(&self) -> f64 {
        let coordinate = self.operator.view.setpoint.position[0];
        (coordinate - self.bridge.motor[0] - (REFERENCE - EDGE)).abs()
    }
}

fn cycle_once(cycle: &mut ServedCycle, bridge: &mut Bridge, number: u64, counts: &CycleCounts) {
    let computed = cycle.step(&CycleBegin {
        number,
        deadline_ns: number * PERIOD_NS,
    });
    cycle.finish(&CycleEnd {
        setpoint: &computed.setpoint,
        lateness_ns: 0,
        work_ns: 0,
        counts,
    });
    let now_ns = 100_000_000 + number * PERIOD_NS;
    // What a bridge rejects it counts.
    let _noted = bridge.follower.offer(
        now_ns,
        &Setpoint {
            sequence: computed.setpoint.sequence,
            due_time_ns: now_ns + LEAD * PERIOD_NS,
            period_ns: PERIOD_NS,
            position: computed.setpoint.position.into(),
            velocity: computed.setpoint.velocity.into(),
            acceleration: computed.setpoint.acceleration.into(),
            axes_mask: 0b111,
            power_request: computed.drive.power.number(),
            fault_reset: computed.drive.fault_reset,
            datum: computed.drive.datum,
            ..Setpoint::default()
        },
    );
}

/// Homes; the period of the renaming, and at the end of the job.
fn homes(bench: &mut Bench) -> (u64, u64) {
    bench.says(CommandCode::Home, 0);
    let begun = bench.now;
    let mut renamed = None;
    while bench.is_busy() {
        bench.period();
        if bench.operator.drives.datum > 0 {
            renamed.get_or_insert(bench.now - begun);
        }
        assert!(bench.now < begun + 60_000, "homing does not end");
    }
    assert!(bench.is_homed());
    assert!(bench.error() < NEAR, "{}", bench.error());
    (renamed.unwrap(), bench.now - begun)
}

/// Each period around the one in which machine zero is set.
#[test]
fn an_axis_is_homed_only_once_its_drive_shows_the_coordinate() {
    let (renamed, _) = homes(&mut Bench::new());
    let (mut kept, mut lost) = (0, 0);
    for trouble in [Trouble::EmergencyStop, Trouble::DriveFault] {
        for moment in renamed - 6..renamed + 8 {
            let mut bench = Bench::new();
            bench.says(CommandCode::Home, 0);
            bench.run(moment);
            match trouble {
                Trouble::EmergencyStop => bench.says(CommandCode::Estop, 0),
                Trouble::DriveFault => bench.bridge.has_fault = true,
            }
            for _ in 0..400 {
                bench.period();
                if bench.is_homed() {
                    assert!(bench.error() < NEAR, "{trouble:?} {moment}: {}", bench.error());
                }
            }
            *(if bench.is_homed() { &mut kept } else { &mut lost }) += 1;
            assert!(!bench.is_busy(), "{trouble:?} {moment}");
            bench.bridge.has_fault = false;
            if trouble == Trouble::EmergencyStop {
                bench.comes_up();
            } else {
                for code in [CommandCode::ClearAlarms, CommandCode::On, CommandCode::Mode] {
                    bench.says(code, u32::from(code == CommandCode::Mode));
                    bench.run(200);
                }
            }
            homes(&mut bench);
        }
    }
    assert!(kept > 4 && lost > 4, "{kept} {lost}");
}

#[test]
fn a_bridge_that_takes_the_number_and_keeps_its_names_homes_no_axis() {
    let mut bench = Bench::new();
    bench.bridge.keeps_names = true;
    bench.says(CommandCode::Home, 0);
    let mut was_renamed = false;
    for _ in 0..20_000 {
        bench.period();
        was_renamed |= bench.operator.view.datum > 0;
        assert!(!bench.is_homed());
    }
    assert!(was_renamed && !bench.is_busy());
}

/// The cycle renames at rest only. An order that comes in motion leaves everything as it was, and homing works afterwards.
#[test]
fn new_coordinates_that_the_cycle_refuses_are_forgotten() {
    let mut bench = Bench::new();
    bench.says(CommandCode::Home, 0);
    while bench.operator.view.setpoint.velocity[0] == 0.0 {
        bench.period();
    }
    let here = bench.operator.view.setpoint.position + Axes::from_element(15.0);
    bench
        .operator
        .rename(here, AxisMask::one(0), Axes::from_element(-15.0));
    let begun = bench.now;
    while bench.is_busy() {
        bench.period();
        assert!(bench.now < begun + 10_000, "homing goes on, or does not end");
    }
    let drives = &bench.operator.drives;
    assert_eq!(
        (bench.operator.view.datum, drives.datum, drives.home_offset),
        (0, 0, Axes::zeros())
    );
    assert!(!bench.is_homed());
    homes(&mut bench);
}

/// An order to rename that does not fit into the queue is an emergency stop, after which homing works.
#[test]
fn new_coordinates_that_do_not_fit_into_the_queue_are_forgotten() {
    let mut bench = Bench::new();
    bench.says(CommandCode::Home, 0);
    bench.run(100);
    assert!(bench.is_busy());
    // As many as fit.
    while !bench.operator.book.is_full() {
        bench.operator.order(CycleCommand::KeepJogging(u64::MAX));
    }
    let here = bench.operator.view.setpoint.position + Axes::from_element(15.0);
    bench
        .operator
        .rename(here, AxisMask::one(0), Axes::from_element(-15.0));
    bench.run(400);
    assert_eq!(bench.operator.desk.machine(), control::MachineState::Estop);
    let drives = &bench.operator.drives;
    assert_eq!(
        (bench.operator.view.datum, drives.datum, drives.home_offset),
        (0, 0, Axes::zeros())
    );
    assert!(!bench.is_busy() && !bench.is_homed());
    bench.comes_up();
    homes(&mut bench);
}

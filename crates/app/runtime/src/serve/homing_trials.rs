//! Homing interrupted at any moment: operator, cycle and a bridge with one drive on one thread, in simulated
//! time.

use std::time::{Duration, Instant};

use evolvent_bus::{Feedback, Setpoint};
use evolvent_control::{Alarm, CommandCode, JobResult, MachineState};
use evolvent_drive::{DriveState, Follower, FollowerSettings, PowerRequest};
use evolvent_path::{AXES, Axes, AxisMask};

use super::bench::{Bench, Drives, Equipment, PERIOD_NS};
use super::operator::Job;
use super::orders::CycleCommand;
use crate::core_loop::Computed;
use crate::drives::watch_settings;
use crate::job::Setup;
use crate::rt::MonotonicClock;

const LEAD: u64 = 2;
/// Motor position at which the switch of X closes, and its machine coordinate.
const EDGE: f64 = -20.0;
const REFERENCE: f64 = -5.0;
/// Upper limit of the errors in these tests, mm: a switch is seen some periods late, and feedback has the
/// same age. A wrong zero is off by 15 mm.
const NEAR: f64 = 0.2;
const HOMING: &str =
    "[[homing]]\naxis = \"X\"\ntowards = \"negative\"\nsearch_mm_s = 50\nlatch_mm_s = 5\nswitch_mm = -5\n";

/// What interrupts homing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    EmergencyStop,
    DriveFault,
}

/// A bridge's follower with ideal drives.
struct Bridge {
    follower: Follower,
    motor: [f64; AXES],
    /// Coordinates minus motor positions.
    offset: [f64; AXES],
    power: PowerRequest,
    has_fault: bool,
    /// Takes over the number of a datum without its coordinates.
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

impl Drives for Bridge {
    fn report(&mut self, period: u64) -> Option<Feedback> {
        Some(self.step(bridge_ns(period)))
    }

    fn receive(&mut self, computed: &Computed, period: u64) {
        let now_ns = bridge_ns(period);
        // The bridge counts rejected setpoints.
        let _noted = self.follower.offer(
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
}

/// The bridge's time in a period.
fn bridge_ns(period: u64) -> u64 {
    100_000_000 + period * PERIOD_NS
}

impl Bench<Bridge> {
    fn homed_by_switch() -> Self {
        let mut bench = Self::assemble(HOMING, |setup| Equipment {
            drives: Bridge::new(setup),
            watch: watch_settings(&setup.machine, PERIOD_NS),
            position: Axes::zeros(),
            has_signals: false,
            control_reads_feedback: true,
        });
        bench.runs_and_ticks(50);
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
            self.commands(code, u32::from(code == CommandCode::Mode));
            self.runs_and_ticks(200);
        }
    }

    fn commands(&mut self, code: CommandCode, index: u32) {
        let mut request = self.command(code);
        request.index = index;
        assert!(self.says(1, request), "{code:?}");
    }

    fn is_homed(&self) -> bool {
        self.operator.state.homed().contains(0)
    }

    fn is_busy(&self) -> bool {
        !matches!(self.operator.job, Job::None)
    }

    /// The error of X's coordinate: at most a period of the approach, plus the delay of the feedback.
    fn error(&self) -> f64 {
        let coordinate = self.operator.view.setpoint.position[0];
        (coordinate - self.drives.motor[0] - (REFERENCE - EDGE)).abs()
    }
}

/// The position before homing is no reason to reject a program, which starts only after homing.
#[test]
fn a_program_loads_with_an_unhomed_axis_off_travel() {
    for added in [HOMING, ""] {
        let mut bench = Bench::assemble(added, |setup| {
            let (mut position, mut drives) = (Axes::zeros(), Bridge::new(setup));
            (position[0], drives.motor[0]) = (1000.0, 1000.0);
            Equipment {
                drives,
                watch: watch_settings(&setup.machine, PERIOD_NS),
                position,
                has_signals: false,
                control_reads_feedback: true,
            }
        });
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("part.ngc");
        std::fs::write(&file, "G0 X10\nM2\n").unwrap();
        bench.runs_and_ticks(50);
        bench.comes_up();
        let mut load = bench.command(CommandCode::Load);
        assert!(load.set_text(file.to_str().unwrap()));
        assert_eq!(bench.reply(1, load), None, "it is being read");
        let begun = Instant::now();
        let answer = loop {
            if let Some(answer) = bench.operator.finish_reading(bench.now * PERIOD_NS) {
                break answer;
            }
            bench.runs_and_ticks(1);
            std::thread::sleep(Duration::from_millis(1));
            assert!(begun.elapsed() < Duration::from_secs(30), "no answer");
        };
        let (loads, starts) = if bench.is_homed() {
            (Alarm::SoftLimit.number(), Alarm::NoProgram)
        } else {
            (0, Alarm::NotHomed)
        };
        assert_eq!(answer.alarm, loads, "{}", answer.text());
        bench.commands(CommandCode::Mode, 0);
        bench.runs_and_ticks(10);
        let start = bench.command(CommandCode::Start);
        assert_eq!(bench.reply(1, start), Some(starts.number()), "{added}");
    }
}

/// Homes; returns the period of the renaming and the period in which the job ended.
fn homes(bench: &mut Bench<Bridge>) -> (u64, u64) {
    bench.commands(CommandCode::Home, 0);
    let begun = bench.now;
    let mut renamed = None;
    while bench.is_busy() {
        bench.runs_and_ticks(1);
        // The speeds of the search and of the approach to the switch.
        if let Some(speed) = bench.operator.steered_speed() {
            assert!(speed == 50.0 || speed == 5.0, "{speed} mm/s");
        }
        if bench.operator.drives.datum > 0 {
            renamed.get_or_insert(bench.now - begun);
        }
        assert!(bench.now < begun + 60_000, "homing does not end");
    }
    assert!(bench.is_homed());
    assert!(bench.error() < NEAR, "{}", bench.error());
    (renamed.unwrap(), bench.now - begun)
}

/// Tries each period around the one in which machine zero is set.
#[test]
fn an_axis_is_homed_once_its_drive_has_the_coordinate() {
    let (renamed, _) = homes(&mut Bench::homed_by_switch());
    let (mut kept, mut lost) = (0, 0);
    for trouble in [Fault::EmergencyStop, Fault::DriveFault] {
        for moment in renamed - 6..renamed + 8 {
            let mut bench = Bench::homed_by_switch();
            bench.commands(CommandCode::Home, 0);
            bench.runs_and_ticks(moment);
            match trouble {
                Fault::EmergencyStop => bench.commands(CommandCode::Estop, 0),
                Fault::DriveFault => bench.drives.has_fault = true,
            }
            for _ in 0..400 {
                bench.runs_and_ticks(1);
                if bench.is_homed() {
                    assert!(bench.error() < NEAR, "{trouble:?} {moment}: {}", bench.error());
                }
            }
            *(if bench.is_homed() { &mut kept } else { &mut lost }) += 1;
            assert!(!bench.is_busy(), "{trouble:?} {moment}");
            bench.drives.has_fault = false;
            if trouble == Fault::EmergencyStop {
                bench.comes_up();
            } else {
                for code in [CommandCode::ClearAlarms, CommandCode::On, CommandCode::Mode] {
                    bench.commands(code, u32::from(code == CommandCode::Mode));
                    bench.runs_and_ticks(200);
                }
            }
            homes(&mut bench);
        }
    }
    assert!(kept > 4 && lost > 4, "{kept} {lost}");
}

/// The control thread may run in the middle of a cycle. If it sees that power is gone or that homing has
/// ended, it sees the alarm too.
#[test]
fn homing_ended_by_a_drive_fault_always_has_an_alarm() {
    let mut bench = Bench::homed_by_switch();
    let mut ended = 0;
    for moment in [1, 20, 100] {
        bench.commands(CommandCode::Home, 0);
        bench.runs_and_ticks(moment);
        bench.runs(1);
        bench.drives.has_fault = true;
        for _ in 0..400 {
            bench.ticks_beside_a_cycle();
            let state = &bench.operator.state;
            if state.machine() != MachineState::On || !bench.is_busy() {
                assert!(state.has_latched_alarm(), "{moment}");
                ended += 1;
            }
            bench.runs(1);
        }
        assert_eq!(bench.operator.state.result(), JobResult::Fault, "{moment}");
        bench.drives.has_fault = false;
        for code in [CommandCode::ClearAlarms, CommandCode::On, CommandCode::Mode] {
            bench.commands(code, u32::from(code == CommandCode::Mode));
            bench.runs_and_ticks(200);
        }
    }
    assert!(ended > 3, "no fault came: {ended}");
}

/// The cycle reports that it has applied the new coordinates before its view shows them.
#[test]
fn an_axis_is_homed_if_its_event_precedes_its_view() {
    let mut bench = Bench::homed_by_switch();
    bench.commands(CommandCode::Home, 0);
    for _ in 0..60_000 {
        bench.runs(1);
        bench.ticks_before_the_last_view();
        if !bench.is_busy() {
            break;
        }
    }
    assert!(bench.is_homed(), "{:?}", bench.operator.state.result());
    assert!(bench.error() < NEAR, "{}", bench.error());
}

#[test]
fn a_bridge_that_ignores_the_datum_homes_no_axis() {
    let mut bench = Bench::homed_by_switch();
    bench.drives.keeps_names = true;
    bench.commands(CommandCode::Home, 0);
    let mut was_renamed = false;
    for _ in 0..20_000 {
        bench.runs_and_ticks(1);
        was_renamed |= bench.operator.view.datum > 0;
        assert!(!bench.is_homed());
    }
    assert!(was_renamed && !bench.is_busy());
}

/// The cycle renames only at rest. An order during motion has no effect, and homing works afterwards.
#[test]
fn coordinates_that_the_cycle_rejects_are_dropped() {
    let mut bench = Bench::homed_by_switch();
    bench.commands(CommandCode::Home, 0);
    while bench.operator.view.setpoint.velocity[0] == 0.0 {
        bench.runs_and_ticks(1);
    }
    let here = bench.operator.view.setpoint.position + Axes::from_element(15.0);
    bench
        .operator
        .rename(here, AxisMask::one(0), Axes::from_element(-15.0));
    let begun = bench.now;
    while bench.is_busy() {
        bench.runs_and_ticks(1);
        assert!(bench.now < begun + 10_000, "homing goes on, or does not end");
    }
    assert!(bench.operator.message.text().contains("not at rest"), "no reason");
    let drives = &bench.operator.drives;
    assert_eq!(
        (bench.operator.view.datum, drives.datum, drives.home_offset),
        (0, 0, Axes::zeros())
    );
    assert!(!bench.is_homed());
    homes(&mut bench);
}

/// An order to rename that does not fit into the queue causes an emergency stop, after which homing works.
#[test]
fn coordinates_that_do_not_fit_the_queue_are_dropped() {
    let mut bench = Bench::homed_by_switch();
    bench.commands(CommandCode::Home, 0);
    bench.runs_and_ticks(100);
    assert!(bench.is_busy());
    // Fills the queue.
    while !bench.operator.book.is_full() {
        bench.operator.order(CycleCommand::KeepJogging(u64::MAX));
    }
    let here = bench.operator.view.setpoint.position + Axes::from_element(15.0);
    bench
        .operator
        .rename(here, AxisMask::one(0), Axes::from_element(-15.0));
    bench.runs_and_ticks(400);
    assert_eq!(bench.operator.state.machine(), MachineState::Estop);
    let drives = &bench.operator.drives;
    assert_eq!(
        (bench.operator.view.datum, drives.datum, drives.home_offset),
        (0, 0, Axes::zeros())
    );
    assert!(!bench.is_busy() && !bench.is_homed());
    bench.comes_up();
    homes(&mut bench);
}

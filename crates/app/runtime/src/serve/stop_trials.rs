//! Stops of a served machine, in various orders: operator and cycle on one thread.

use std::time::{Duration, Instant};

use evolvent_bus::ControlRequest;
use evolvent_control::{Alarm, CommandCode, JobResult, MachineState};
use evolvent_drive::PowerRequest;
use evolvent_path::AxisMask;

use super::bench::Bench;
use super::operator::Job;
use super::orders::CycleCommand;
use crate::core_loop::SetpointSource;

/// X, the axis that is jogged.
const X: AxisMask = AxisMask::one(0);
/// Time limit, in real time, for a block to move the axes.
const PATIENCE: Duration = Duration::from_secs(30);

impl Bench {
    /// Begins a long jog of X.
    fn jogs(&mut self) {
        assert!(self.says(1, self.jog(100.0)), "JOG");
    }

    /// A jog of X by a distance.
    fn jog(&self, distance: f64) -> ControlRequest {
        let mut jog = self.command(CommandCode::Jog);
        (jog.axes_mask, jog.index, jog.amount) = (X.bits(), 1, 50.0);
        jog.values[0] = distance;
        jog
    }

    /// The numbers of the alarms in force, oldest first.
    fn alarms(&self) -> Vec<u32> {
        (self.operator.state.alarms())
            .map(|(alarm, _)| alarm.number())
            .collect()
    }

    /// Another fault was found before; the axes are stopping for it.
    fn has_another_fault(&mut self) {
        self.cycle.stop_for_lateness(self.last.sequence);
    }

    /// Begins a block of MDI and waits until it reaches its feed.
    fn drives_block(&mut self, text: &str) {
        let mut mode = self.command(CommandCode::Mode);
        mode.index = 2;
        assert!(self.says(1, mode), "MODE");
        let mut block = self.command(CommandCode::Mdi);
        assert!(block.set_text(text));
        assert!(self.says(1, block), "MDI");
        self.comes_to_feed();
    }

    /// Waits until the block in progress reaches its feed. Threads that read files and plan need real time.
    fn comes_to_feed(&mut self) {
        let begun = Instant::now();
        while self.last.velocity[0] < 35.0 {
            let _answer = self.operator.finish_reading(self.now);
            self.runs_and_ticks(1);
            std::thread::sleep(Duration::from_micros(200));
            assert!(begun.elapsed() < PATIENCE, "it does not move: {:?}", self.last);
        }
    }
}

/// The cycle checks the spindles before the drives, and both may fail for one reason.
#[test]
fn a_later_drive_fault_is_listed_and_powers_off() {
    let mut bench = Bench::with_drives(X);
    bench.jogs();
    bench.runs_and_ticks(200);
    assert!(bench.last.velocity[0] > 40.0, "{:?}", bench.last);
    bench.has_another_fault();
    bench.drives.has_fault = true;
    bench.runs_and_ticks(1);
    assert_eq!(bench.power, PowerRequest::QuickStop);
    bench.runs_and_ticks(1000);
    assert_eq!(bench.alarms(), [300, 406]);
    assert_eq!(
        (bench.operator.state.machine(), bench.power),
        (MachineState::Off, PowerRequest::Off)
    );
    // Nothing moves until the machine is switched on again.
    bench.drives.has_fault = false;
    assert!(bench.says(1, bench.command(CommandCode::Reset)));
    bench.runs_and_ticks(5);
    assert!(!bench.says(1, bench.jog(1.0)), "drives without power");
    assert!(bench.says(1, bench.command(CommandCode::On)));
    bench.runs_and_ticks(10);
    assert!(bench.says(1, bench.jog(1.0)));
    bench.drives.has_fault = true;
    bench.runs_and_ticks(1000);
    assert_eq!(bench.alarms(), [406], "each time that power is on");
}

/// A crash blocks the axis while it is being stopped for another fault.
#[test]
fn an_axis_blocked_after_a_fault_stops_and_powers_off() {
    let mut bench = Bench::with_drives(X);
    bench.jogs();
    bench.runs_and_ticks(200);
    bench.has_another_fault();
    bench.drives.is_blocked = true;
    bench.runs_and_ticks(1000);
    let alarms = bench.alarms();
    assert!(
        matches!(alarms[..], [300, 403 | 410]),
        "the alarm of the drives is listed: {alarms:?}"
    );
    assert_eq!(
        (bench.operator.state.machine(), bench.power),
        (MachineState::Off, PowerRequest::Off)
    );
}

/// Drives still follow during the stop for the first alarm.
#[test]
fn a_drive_fault_turns_a_path_stop_into_a_quick_stop() {
    let mut bench = Bench::with_drives(X);
    bench.jogs();
    bench.runs_and_ticks(200);
    bench.drives.is_blocked = true;
    while bench.alarms().is_empty() {
        bench.runs_and_ticks(1);
    }
    assert_eq!(bench.power, PowerRequest::On, "it stops on the path");
    bench.drives.has_fault = true;
    bench.runs_and_ticks(1);
    assert_eq!(bench.power, PowerRequest::QuickStop);
    bench.runs_and_ticks(1000);
    assert_eq!(bench.alarms().last(), Some(&Alarm::DriveFault.number()));
    assert_eq!(bench.power, PowerRequest::Off);
}

/// Whatever removed the power, and whether or not its event was received.
#[test]
fn a_desk_whose_drives_have_no_power_is_off() {
    let mut bench = Bench::with_drives(X);
    assert_eq!(bench.operator.state.machine(), MachineState::On);
    bench.operator.view.power = PowerRequest::Off;
    // No new view arrives.
    bench.ticks();
    assert_eq!(bench.operator.state.machine(), MachineState::Off);
}

/// The chain opens in the cycle before the one that takes the order, and the operator does not know it.
#[test]
fn a_jog_ordered_as_the_chain_opens_does_not_start() {
    let mut bench = Bench::with_chain();
    bench.opens_chain();
    bench.runs(1);
    bench.jogs();
    let here = bench.last.position;
    bench.runs_and_ticks(300);
    assert_eq!(bench.last.position, here);
    assert_eq!(bench.operator.state.machine(), MachineState::Estop);
    assert_eq!(bench.alarms(), [Alarm::EmergencyStopChain.number()]);
    assert!(matches!(bench.operator.job, Job::None), "the jog has ended");
}

/// The jog ends as soon as the emergency stop takes effect, and OFF is accepted.
#[test]
fn off_while_the_axes_still_stop_takes_power_at_rest() {
    for is_emergency in [true, false] {
        let mut bench = Bench::with_drives(X);
        bench.jogs();
        bench.runs_and_ticks(300);
        if is_emergency {
            assert!(bench.says(2, bench.command(CommandCode::Estop)));
        } else {
            // A fault found by the guard: the drives stay on and follow.
            bench.cycle.quick_stops();
        }
        bench.runs_and_ticks(2);
        assert!(bench.last.velocity[0] > 20.0, "{:?}", bench.last);
        assert!(matches!(bench.operator.job, Job::None), "the jog has ended");
        assert!(bench.says(2, bench.command(CommandCode::Off)), "OFF");
        let mut touch_off = bench.command(CommandCode::TouchOff);
        touch_off.axes_mask = X.bits();
        assert!(!bench.says(2, touch_off), "touched off on the way");
        let mut has_power = true;
        for _ in 0..300 {
            bench.runs_and_ticks(1);
            let moves = bench.last.velocity[0] != 0.0;
            assert!(!moves || bench.power != PowerRequest::Off, "{:?}", bench.last);
            has_power = bench.power != PowerRequest::Off;
        }
        assert!(!has_power, "power is off at rest");
        assert_eq!(bench.last.velocity[0], 0.0);
        assert!(bench.says(2, touch_off), "touched off at rest");
    }
}

/// The job has no alarm that gives the reason, since an emergency stop by command needs none.
#[test]
fn a_job_denied_by_emergency_stop_raises_no_alarm() {
    let mut bench = Bench::new();
    bench.jogs();
    // As if the cycle had taken the emergency stop before the jog.
    bench.cycle.fall_into_estop();
    bench.runs_and_ticks(2);
    assert!(bench.alarms().is_empty(), "{:?}", bench.alarms());
    assert!(matches!(bench.operator.job, Job::None), "the jog has ended");
}

/// Three clients change overrides faster than the cycle takes orders. This must not delay an emergency stop.
#[test]
fn emergency_stop_in_a_flood_acts_in_the_next_cycle() {
    let mut bench = Bench::new();
    bench.jogs();
    bench.runs_and_ticks(200);
    for number in 0..3000_u32 {
        let mut turn = bench.command(CommandCode::FeedOverride);
        turn.amount = 0.5 + f64::from(number % 50) / 100.0;
        assert!(bench.says(2 + u64::from(number % 3), turn), "{number}");
    }
    assert!(bench.says(1, bench.command(CommandCode::Estop)));
    bench.runs_and_ticks(1);
    assert_eq!(bench.power, PowerRequest::QuickStop);
    assert_eq!(bench.operator.state.machine(), MachineState::Estop);
    bench.runs_and_ticks(300);
    assert_eq!((bench.last.velocity[0], bench.power), (0.0, PowerRequest::Off));
    // The newest one is in force.
    assert_eq!(bench.last.feed_override, 0.99);
    assert!(bench.alarms().is_empty());
}

/// Clients send holds as fast as they can, or stops of a jog away from the program. Nothing else stops.
#[test]
fn a_flood_of_holds_causes_no_emergency_stop() {
    let mut bench = Bench::new();
    bench.drives_block("G1 X100 F2400");
    for moves_away in [false, true, true] {
        if moves_away {
            assert!(bench.says(1, bench.jog(-50.0)), "JOG");
            bench.runs_and_ticks(200);
            assert!(bench.last.velocity[0] < -40.0, "{:?}", bench.last);
        }
        for number in 0..3000_u64 {
            let code = [CommandCode::Hold, CommandCode::JogStop][(number % 2) as usize];
            assert!(bench.says(2 + number % 3, bench.command(code)), "{number}");
            assert_eq!(bench.operator.state.machine(), MachineState::On, "{number}");
        }
        bench.runs_and_ticks(300);
        assert_eq!((bench.last.velocity[0], bench.power), (0.0, PowerRequest::On));
    }
    assert!(bench.alarms().is_empty());
    let mut back = bench.command(CommandCode::Return);
    back.amount = 50.0;
    assert!(bench.says(1, back), "RETURN");
    bench.runs_and_ticks(1500);
    assert!(bench.says(1, bench.command(CommandCode::Resume)), "RESUME");
    bench.comes_to_feed();
}

/// Within one cycle, an order after an emergency stop takes effect, and an order before it does not undo it.
#[test]
fn orders_around_an_emergency_stop_keep_their_order() {
    let mut bench = Bench::new();
    bench.jogs();
    bench.runs_and_ticks(100);
    // The cycle takes both at once.
    assert!(bench.says(1, bench.command(CommandCode::On)));
    assert!(bench.says(2, bench.command(CommandCode::Estop)));
    bench.runs(1);
    assert_eq!(bench.power, PowerRequest::QuickStop);
    bench.runs_and_ticks(300);
    for code in [CommandCode::EstopReset, CommandCode::On] {
        assert!(bench.says(1, bench.command(code)), "{code:?}");
    }
    bench.runs_and_ticks(10);
    assert_eq!(
        (bench.operator.state.machine(), bench.power),
        (MachineState::On, PowerRequest::On)
    );
    // Before the next cycle: reset and on again, then another emergency stop.
    assert!(bench.says(1, bench.command(CommandCode::Estop)));
    for code in [CommandCode::EstopReset, CommandCode::On, CommandCode::Estop] {
        assert!(bench.says(1, bench.command(code)), "{code:?}");
    }
    bench.runs_and_ticks(20);
    assert_eq!(
        (bench.operator.state.machine(), bench.power),
        (MachineState::Estop, PowerRequest::Off)
    );
    for code in [CommandCode::EstopReset, CommandCode::On] {
        assert!(bench.says(1, bench.command(code)), "{code:?}");
    }
    bench.runs_and_ticks(20);
    assert!(bench.says(1, bench.jog(5.0)));
    bench.runs_and_ticks(500);
    assert!((bench.last.velocity[0], bench.alarms().len()) == (0.0, 0));
}

/// A jog, and a stop of another client, both before the next cycle.
#[test]
fn a_jog_that_a_stop_has_overtaken_ends_as_stopped() {
    let mut bench = Bench::new();
    let here = bench.last.position;
    bench.jogs();
    assert!(bench.says(2, bench.command(CommandCode::Stop)));
    bench.runs_and_ticks(3);
    assert!(matches!(bench.operator.job, Job::None));
    assert_eq!(bench.operator.state.result(), JobResult::Stopped);
    assert!(bench.alarms().is_empty());
    bench.jogs();
    bench.runs_and_ticks(10);
    assert_ne!(bench.last.position, here, "a later jog begins");
}

/// A cycle that takes no orders: the orders then become one emergency stop.
#[test]
fn orders_that_do_not_fit_cause_an_emergency_stop() {
    let mut bench = Bench::new();
    bench.jogs();
    bench.runs_and_ticks(200);
    let (mut accepted, mut number) = (0, 0);
    // Each keep-alive of a jog is an order; nothing else limits their number here.
    while bench.operator.state.machine() == MachineState::On {
        bench.operator.order(CycleCommand::KeepJogging(u64::MAX));
        accepted += u64::from(bench.says(2, bench.command(CommandCode::JogKeep)));
        number += 1;
        assert!(number < 3000, "the queue is never full");
        bench.operator.give_up_lost_orders();
    }
    assert!(accepted < number, "commands are refused before");
    assert_eq!(bench.alarms(), [Alarm::OrdersLost.number()]);
    bench.runs(1);
    assert_eq!(bench.power, PowerRequest::QuickStop);
    bench.runs_and_ticks(300);
    assert_eq!((bench.last.velocity[0], bench.power), (0.0, PowerRequest::Off));
    for code in [CommandCode::Reset, CommandCode::EstopReset, CommandCode::On] {
        assert!(bench.says(1, bench.command(code)), "{code:?}");
        bench.runs_and_ticks(10);
    }
    assert!(bench.says(1, bench.jog(1.0)));
}

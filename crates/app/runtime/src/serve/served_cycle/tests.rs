//! The complete cycle: its allocations, and the effect of an open chain.

use std::path::Path;

use evolvent_counting::{CountingAllocator, calls};
use evolvent_drive::{BridgeState, DriveState, WatchMode, WatchSettings};
use evolvent_machine::{Machine, SignalKind, SignalSettings};
use evolvent_path::Axes;
use evolvent_signals::{InputImage, OutputChange, SignalMoment, Signals};
use evolvent_transfer::{AxesState, Sync, Transfer};
use rtrb::{Consumer, RingBuffer};

use super::*;
use crate::core_loop::{CoreLoop, CycleCounts};
use crate::job::Clock;
use crate::serve::orders::CycleCommand;
use crate::signal_loop::InputSource;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// A cycle at rest at home, without signals, corrections and drives' clock, with its queues.
fn parts_at_home(
    limits: Limits,
    period_ns: u64,
    (orders, feedback): (Consumer<Order>, Consumer<Feedback>),
) -> (ServedParts, Consumer<CycleEvent>, Consumer<CycleView>) {
    let (events, cycle_events) = RingBuffer::new(4096);
    let (views, cycle_views) = RingBuffer::new(4096);
    let parts = ServedParts {
        generator: SetpointGenerator::new(limits, period_ns, limits.home),
        limits,
        period_ns,
        orders,
        urgent: Arc::default(),
        events,
        views,
        feedback,
        watch: FeedbackWatch::new(WatchSettings::new(period_ns, AxisMask::NONE)),
        signals: None,
        corrections: None,
        probe: ProbeInput::default(),
        wheel_counts: None,
        phase: None,
        controls: Arc::new(Controls::new(1.0)),
        driven: DrivenPath::new(period_ns),
    };
    (parts, cycle_events, cycle_views)
}

/// A motion from rest to rest.
fn transfer(limits: &Limits, from: Axes, to: Axes) -> TransferExecutor {
    let [from, to] = [from, to].map(AxesState::at_rest);
    TransferExecutor::new(Transfer::solve(limits, &from, &to, Sync::Time).unwrap())
}

/// Number of allocator calls by a cycle that drives this number of jogs, each with a change that is too late,
/// with renamings, an override and feedback in every cycle.
fn calls_during(jogs: u64) -> (u64, u64) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
    let text = std::fs::read_to_string(file).unwrap();
    let text = text.replacen("letter = \"X\"", "letter = \"X\"\nbacklash_mm = 0.02", 1);
    let machine = Machine::parse(&text, "backlash.toml").unwrap();
    let limits = machine.limits();
    let period_ns = 250_000;
    let (mut orders, cycle_orders) = RingBuffer::new(64);
    let (mut to_cycle, feedback) = RingBuffer::new(256);
    let (bus, _setpoints) = RingBuffer::new(64);
    let (trace, _records) = RingBuffer::new(64);
    let core = CoreLoop {
        clock: Clock::Realtime,
        period_ns,
        lead_cycles: 2,
        max_late_cycles: 0,
        start_unix_ns: 0,
        bus: Some(bus),
        trace: Some(trace),
    };
    let (parts, mut events, mut views) = parts_at_home(limits, period_ns, (cycle_orders, feedback));
    // A machine without drives to monitor.
    let mut settings = WatchSettings::new(period_ns, AxisMask::NONE);
    settings.mode = WatchMode::Ignore;
    let parts = ServedParts {
        corrections: Corrections::new(&machine, period_ns, limits.home),
        watch: FeedbackWatch::new(settings),
        ..parts
    };
    let cycle = std::thread::spawn(move || {
        let before = calls();
        let counts = core.run(&mut ServedCycle::new(parts));
        (calls() - before, counts.cycles)
    });
    let mut give = |what| assert!(orders.push(Order { id: 1, what }).is_ok(), "no room");
    give(CycleCommand::LeaveEstop);
    give(CycleCommand::Power(PowerRequest::On));
    give(CycleCommand::KeepJogging(u64::MAX));
    let mut at = limits.home;
    let (mut ended, mut begun) = (0, 0);
    while ended < jogs {
        while let Ok(view) = views.pop() {
            at = view.setpoint.position;
            // Unneeded feedback is read as well.
            let _full = to_cycle.push(Feedback::default());
        }
        while let Ok(event) = events.pop() {
            match event {
                CycleEvent::Ended { .. } => ended += 1,
                // The view was older than the event: try again.
                CycleEvent::Misplaced { .. } => begun = ended,
                _ => {}
            }
        }
        if begun == ended && begun < jogs && views.is_empty() {
            begun += 1;
            let mut to = at;
            to[0] = if begun % 2 == 1 { 2.0 } else { 0.0 };
            let steering = transfer(&limits, at, to);
            give(CycleCommand::Override(0.5));
            give(CycleCommand::Relocate {
                position: at,
                limits,
                renames: false,
            });
            give(CycleCommand::Steer(Box::new(steering)));
            give(CycleCommand::Turn {
                after: 0,
                until_ns: u64::MAX,
                steering: Box::new(steering),
            });
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    give(CycleCommand::End);
    cycle.join().unwrap()
}

#[test]
fn the_cycle_neither_allocates_nor_frees() {
    let (few, _) = calls_during(1);
    let (many, cycles) = calls_during(12);
    assert!(cycles > 500, "{cycles} cycles prove nothing");
    assert_eq!(few, many, "calls of the allocator");
}

/// A machine with a chain on input 0, and on output 0 a clamp whose safe state is on.
fn settings() -> SignalSettings {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
    let text = std::fs::read_to_string(file).unwrap();
    let signals = "[[input]]\nname = \"chain\"\nnumber = 0\n[[output]]\nname = \"clamp\"\nnumber = 0\n\
                   safe_on = true\n[estop]\ninput = \"chain\"\n";
    let machine = Machine::parse(&format!("{text}{signals}"), "signals.toml").unwrap();
    machine.signals
}

/// The control thread sleeps: events and views are not read, and no order arrives.
#[test]
fn an_open_chain_acts_without_the_control_thread() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
    let limits = Machine::load(&file).unwrap().limits();
    let period_ns = 1_000_000;
    let settings = settings();
    let (mut orders, cycle_orders) = RingBuffer::new(64);
    let (cycle_views, _full) = RingBuffer::new(1);
    let (_to_cycle, feedback) = RingBuffer::new(1);
    let (mut inputs, samples) = RingBuffer::new(16);
    let (changes, mut outputs) = RingBuffer::new(64);
    let source = InputSource::Bus(samples);
    let signals = SignalLoop::new(
        Signals::new(&settings, 2, 1_000_000),
        source,
        Some(changes),
        None,
        true,
    );
    let (parts, mut events, _views) = parts_at_home(limits, period_ns, (cycle_orders, feedback));
    let mut cycle = ServedCycle::new(ServedParts {
        views: cycle_views,
        signals: Some(signals),
        ..parts
    });
    let mut image = InputImage::default();
    image.set(SignalKind::Digital, 0, Some(1.0));
    inputs.push(image).unwrap();
    let mut to = limits.home;
    to[0] += 100.0;
    let mut clamp = OutputChange::at(SignalMoment::Rest(0));
    clamp.set_digital(0, false);
    for what in [
        CycleCommand::LeaveEstop,
        CycleCommand::Power(PowerRequest::On),
        CycleCommand::Outputs(clamp),
        CycleCommand::KeepJogging(u64::MAX),
    ] {
        assert!(orders.push(Order { id: 0, what }).is_ok(), "no room");
    }
    let mut step = |number: u64| {
        cycle.step(&CycleBegin {
            number,
            deadline_ns: number * period_ns,
        })
    };
    step(0);
    let what = CycleCommand::Steer(Box::new(transfer(&limits, limits.home, to)));
    assert!(orders.push(Order { id: 0, what }).is_ok(), "no room");
    let before = (1..200).map(&mut step).last().unwrap();
    assert!(before.setpoint.velocity[0] > 10.0, "{:?}", before.setpoint);
    assert_eq!(before.drive.power, PowerRequest::On);
    let open: Vec<_> = std::iter::from_fn(|| outputs.pop().ok()).collect();
    assert_eq!(open.last().map(|due| due.outputs.digital), Some(0));
    image.set(SignalKind::Digital, 0, Some(0.0));
    inputs.push(image).unwrap();
    let first = step(200);
    assert_eq!(first.drive.power, PowerRequest::QuickStop);
    let safe = outputs.pop().unwrap();
    assert_eq!(
        (safe.sequence, safe.outputs.digital),
        (first.setpoint.sequence, 1)
    );
    let stopping: Vec<_> = (201..1200).map(step).collect();
    let speeds = || stopping.iter().map(|computed| computed.setpoint.velocity[0]);
    assert!(speeds().all(|speed| speed <= first.setpoint.velocity[0] + 1e-9));
    let last = stopping.last().unwrap();
    assert_eq!(
        (last.setpoint.velocity[0], last.drive.power),
        (0.0, PowerRequest::Off)
    );
    let reported: Vec<_> = std::iter::from_fn(|| events.pop().ok()).collect();
    let chain = reported
        .iter()
        .filter(|event| matches!(event, CycleEvent::EstopChain { .. }));
    assert_eq!(chain.count(), 1);
}

/// Bridges take over a datum at rest, so a motion that was ordered together with it begins one setpoint
/// later.
#[test]
fn a_datum_is_published_at_rest_before_motion() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
    let limits = Machine::load(&file).unwrap().limits();
    let period_ns = 1_000_000;
    let (mut orders, cycle_orders) = RingBuffer::new(64);
    let (_to_cycle, feedback) = RingBuffer::new(1);
    let (parts, _events, _views) = parts_at_home(limits, period_ns, (cycle_orders, feedback));
    let mut cycle = ServedCycle::new(parts);
    let mut renamed = limits.home;
    renamed[0] += 5.0;
    let mut to = renamed;
    to[0] += 50.0;
    let mut step = |number: u64| {
        cycle.step(&CycleBegin {
            number,
            deadline_ns: number * period_ns,
        })
    };
    for what in [CycleCommand::LeaveEstop, CycleCommand::Power(PowerRequest::On)] {
        assert!(orders.push(Order { id: 0, what }).is_ok(), "no room");
    }
    step(0);
    for what in [
        CycleCommand::KeepJogging(u64::MAX),
        CycleCommand::Relocate {
            position: renamed,
            limits,
            renames: true,
        },
        CycleCommand::Steer(Box::new(transfer(&limits, renamed, to))),
    ] {
        assert!(orders.push(Order { id: 0, what }).is_ok(), "no room");
    }
    let computed: Vec<_> = (1..100).map(step).collect();
    let first = computed
        .iter()
        .find(|computed| computed.drive.datum == 1)
        .unwrap();
    let [speed, acceleration] = [first.setpoint.velocity[0], first.setpoint.acceleration[0]];
    assert_eq!((speed, acceleration), (0.0, 0.0));
    assert_eq!(first.setpoint.position, renamed);
    let last = computed.last().unwrap();
    assert!(last.setpoint.velocity[0] > 1.0, "{:?}", last.setpoint);
}

/// A served cycle whose bridge replies two setpoints later, with a drive that takes three more to leave
/// operation.
struct PowerTrial {
    cycle: ServedCycle,
    orders: Producer<Order>,
    to_cycle: Producer<Feedback>,
    views: Consumer<CycleView>,
    requests: Vec<PowerRequest>,
    /// Whether the bridge replies to new setpoints, and whether it sends at all.
    replies: bool,
    sends: bool,
    /// The drive brakes along its own ramp.
    brakes: bool,
}

impl PowerTrial {
    fn new() -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let limits = Machine::load(&file).unwrap().limits();
        let period_ns = 1_000_000;
        let (orders, cycle_orders) = RingBuffer::new(64);
        let (to_cycle, feedback) = RingBuffer::new(64);
        let (parts, _events, views) = parts_at_home(limits, period_ns, (cycle_orders, feedback));
        let cycle = ServedCycle::new(ServedParts {
            watch: FeedbackWatch::new(WatchSettings::new(period_ns, AxisMask::one(0))),
            ..parts
        });
        let mut trial = Self {
            cycle,
            orders,
            to_cycle,
            views,
            requests: Vec::new(),
            replies: true,
            sends: true,
            brakes: false,
        };
        trial.order(0, CycleCommand::LeaveEstop);
        trial
    }

    fn order(&mut self, id: u64, what: CycleCommand) {
        assert!(self.orders.push(Order { id, what }).is_ok(), "no room");
    }

    fn power(&mut self, id: u64, request: PowerRequest) {
        self.order(id, CycleCommand::Power(request));
    }

    fn reply(&self) -> Feedback {
        let number = self.requests.len();
        let sequence = if self.replies { number.saturating_sub(2) } else { 0 };
        // The drives do what was requested two setpoints ago after another three.
        let of = |ago: usize| number.checked_sub(ago).map(|at| self.requests[at]);
        let is_on = (2..=5).any(|ago| of(ago) == Some(PowerRequest::On));
        let (state, bridge) = if self.brakes {
            (DriveState::QuickStopActive, BridgeState::Off)
        } else if is_on {
            (DriveState::OperationEnabled, BridgeState::Following)
        } else {
            (DriveState::SwitchedOn, BridgeState::Off)
        };
        let mut reply = Feedback {
            sequence: sequence as u64,
            time_ns: MonotonicClock::now_ns(),
            axes_mask: 1,
            bridge_state: bridge.number(),
            ..Feedback::default()
        };
        reply.status_word[0] = u32::from(state.code());
        reply
    }

    /// The requests of these cycles, and the last order that was settled.
    fn run(&mut self, cycles: usize) -> (Vec<PowerRequest>, u64) {
        let first = self.requests.len();
        for _ in 0..cycles {
            if self.sends {
                let reply = self.reply();
                self.to_cycle.push(reply).unwrap();
            }
            let number = self.requests.len() as u64;
            let computed = self.cycle.step(&CycleBegin {
                number,
                deadline_ns: number * 1_000_000,
            });
            self.requests.push(computed.drive.power);
            let counts = CycleCounts::default();
            let _next = self.cycle.finish(&CycleEnd {
                setpoint: &computed.setpoint,
                lateness_ns: 0,
                work_ns: 0,
                counts: &counts,
            });
        }
        let view = std::iter::from_fn(|| self.views.pop().ok()).last().unwrap();
        (self.requests[first..].to_vec(), view.power_order)
    }
}

const ON: PowerRequest = PowerRequest::On;
const OFF: PowerRequest = PowerRequest::Off;

#[test]
fn power_returns_once_the_drives_have_been_without_it() {
    let mut trial = PowerTrial::new();
    trial.power(1, ON);
    assert_eq!(trial.run(20).1, 1);
    // Both orders within one cycle, and ON one cycle after OFF.
    for (off, on, is_later) in [(2, 3, false), (4, 5, true)] {
        trial.power(off, OFF);
        if !is_later {
            trial.power(on, ON);
        }
        let (first, order) = trial.run(1);
        assert_eq!(first, [OFF], "off is sent");
        assert!(order < on, "power has not been requested yet");
        if is_later {
            trial.power(on, ON);
        }
        let (after, order) = trial.run(30);
        let is_off = after.iter().take_while(|power| **power == OFF).count();
        // Two until the reply, three until the drive has left operation, one until it is noticed.
        assert!((5..=7).contains(&is_off), "{is_off}: {after:?}");
        assert!(after[is_off..].iter().all(|power| *power == ON), "{after:?}");
        assert_eq!(order, on);
    }
}

/// A bridge that repeats its last reply for ever: its alarm comes from the watch, and the wait ends.
#[test]
fn power_without_a_reply_is_requested_after_500_ms() {
    let mut trial = PowerTrial::new();
    trial.power(1, ON);
    trial.run(20);
    trial.replies = false;
    trial.power(2, OFF);
    trial.power(3, ON);
    let (after, order) = trial.run(600);
    assert_eq!(after.iter().take_while(|power| **power == OFF).count(), 499);
    assert_eq!(order, 3);
}

/// Otherwise its voltage would be removed at speed, and the bridge would then refuse power.
#[test]
fn power_waits_for_a_drive_that_brakes_over_500_ms() {
    for ramp_ends in [true, false] {
        let mut trial = PowerTrial::new();
        trial.power(1, ON);
        trial.run(20);
        trial.power(2, OFF);
        trial.brakes = true;
        trial.power(3, ON);
        let (after, _) = trial.run(1200);
        assert!(!after.contains(&ON), "it brakes");
        trial.brakes = !ramp_ends;
        let (after, order) = trial.run(1400);
        let is_off = after.iter().take_while(|power| **power == OFF).count();
        assert_eq!(is_off, if ramp_ends { 1 } else { 1299 });
        assert_eq!(order, 3);
    }
}

/// Waiting for it would hide its alarm.
#[test]
fn power_is_requested_at_once_of_a_silent_bridge() {
    let mut trial = PowerTrial::new();
    trial.power(1, ON);
    trial.run(20);
    trial.power(2, OFF);
    trial.sends = false;
    trial.run(3);
    std::thread::sleep(core::time::Duration::from_millis(300));
    trial.power(3, ON);
    assert_eq!(trial.run(1), (vec![ON], 3));
}

/// Also if ON arrives in the cycle after it, before the control thread knows of it.
#[test]
fn an_emergency_or_a_fault_takes_a_waiting_on_back() {
    let troubles: [fn(&mut PowerTrial); 2] = [
        |trial| trial.order(9, CycleCommand::Emergency),
        |trial| trial.cycle.now.faulted = true,
    ];
    for trouble in troubles {
        for is_before in [false, true] {
            let mut trial = PowerTrial::new();
            trial.power(1, ON);
            trial.run(20);
            trial.power(2, OFF);
            if is_before {
                trouble(&mut trial);
                trial.run(1);
                trial.power(3, ON);
            } else {
                trial.power(3, ON);
                trial.run(1);
                trouble(&mut trial);
            }
            let (after, order) = trial.run(700);
            assert!(!after.contains(&ON), "{after:?}");
            assert_eq!(order, 3, "refused");
        }
    }
}

/// The trace has no record of such a change, so the recomputed setpoints would differ in it.
#[test]
fn a_relocation_to_the_same_position_changes_no_bit() {
    let mut trial = PowerTrial::new();
    trial.run(1);
    let limits = trial.cycle.parts.limits;
    for (id, (zero, kept)) in [(-1.0, -1.0), (0.0, 0.0), (-0.0, 0.0)].into_iter().enumerate() {
        let mut position = limits.home;
        position[1] = zero;
        trial.order(
            id as u64,
            CycleCommand::Relocate {
                position,
                limits,
                renames: false,
            },
        );
        trial.run(1);
        let found = trial.cycle.parts.generator.position()[1];
        assert_eq!(found.to_bits(), f64::to_bits(kept), "{zero}: {found}");
    }
}

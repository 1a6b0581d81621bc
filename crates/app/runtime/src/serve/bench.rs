//! Operator and cycle of a machine in one thread, in time of their own, for tests.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc;

use evolvent_bus::{ControlRequest, Feedback};
use evolvent_control::CommandCode;
use evolvent_drive::{BridgeState, DriveState, FeedbackWatch, PowerRequest, WatchSettings};
use evolvent_machine::{Machine, SignalKind};
use evolvent_motion::{DrivenPath, MachineState, Setpoint};
use evolvent_path::AxisMask;
use evolvent_signals::{InputImage, ProbeInput, Signals};
use rtrb::{Consumer, Producer, RingBuffer};

use super::operator::{Operator, OperatorConfig};
use super::orders::{CycleEvent, CycleView};
use super::served_cycle::{ServedCycle, ServedParts};
use super::state_store::StateStore;
use super::urgent::UrgentOrders;
use crate::core_loop::{Computed, CycleBegin, CycleCounts, CycleEnd, SetpointSource};
use crate::job::Setup;
use crate::rt::MonotonicClock;
use crate::shared::Controls;
use crate::signal_loop::{InputSource, SignalLoop};

const PERIOD_NS: u64 = 1_000_000;

/// Drives that follow at once.
#[derive(Default)]
pub(super) struct BenchDrives {
    /// Axes that have drives; without any no bridge is heard.
    pub(super) axes: AxisMask,
    /// The drives are in fault.
    pub(super) has_fault: bool,
    /// The axes are blocked where they were first.
    pub(super) is_blocked: bool,
}

impl BenchDrives {
    /// What they reply to a setpoint.
    fn reply(&self, last: &Computed, before: &Feedback) -> Feedback {
        let power = last.drive.power;
        let (state, bridge) = match power {
            _ if self.has_fault => (DriveState::Fault, BridgeState::Off),
            PowerRequest::On => (DriveState::OperationEnabled, BridgeState::Following),
            _ => (DriveState::SwitchedOn, BridgeState::Off),
        };
        let mut reply = Feedback {
            sequence: last.setpoint.sequence,
            time_ns: MonotonicClock::now_ns(),
            axes_mask: self.axes.bits(),
            bridge_state: bridge.number(),
            datum: last.drive.datum,
            position: last.setpoint.position.into(),
            ..Feedback::default()
        };
        if self.is_blocked {
            reply.position = before.position;
        }
        for axis in self.axes.axes() {
            reply.status_word[axis] = u32::from(state.code());
        }
        reply
    }
}

/// A machine on its own, at rest at home, switched on, in manual mode.
pub(super) struct Bench {
    pub(super) operator: Operator,
    pub(super) cycle: ServedCycle,
    views: Consumer<CycleView>,
    events: Consumer<CycleEvent>,
    answers: Consumer<Feedback>,
    _answers: Producer<Feedback>,
    to_cycle: Producer<Feedback>,
    inputs: Producer<InputImage>,
    pub(super) drives: BenchDrives,
    last_reply: Feedback,
    /// The power of the drives with the last setpoint.
    pub(super) power: PowerRequest,
    _folder: tempfile::TempDir,
    counts: CycleCounts,
    pub(super) now: u64,
    serial: u64,
    pub(super) last: Setpoint,
    computed: Computed,
}

impl Bench {
    pub(super) fn new() -> Self {
        Self::build(AxisMask::NONE, false)
    }

    /// The same, with drives of these axes.
    pub(super) fn with_drives(axes: AxisMask) -> Self {
        Self::build(axes, false)
    }

    /// The same, with an emergency-stop chain that is closed.
    pub(super) fn with_chain() -> Self {
        Self::build(AxisMask::NONE, true)
    }

    fn build(axes: AxisMask, has_chain: bool) -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let text = std::fs::read_to_string(&file).unwrap();
        let chain = "[[input]]\nname = \"chain\"\nnumber = 0\n[estop]\ninput = \"chain\"\n";
        let text = if has_chain { text + chain } else { text };
        let machine = Machine::parse(&text, "mill.toml").unwrap();
        let mut setup = Setup::new(machine, file, text, None).unwrap();
        setup.period_ns = PERIOD_NS;
        let limits = setup.machine.limits();
        let (orders, cycle_orders) = RingBuffer::new(1024);
        let urgent = Arc::<UrgentOrders>::default();
        let (cycle_events, events) = RingBuffer::new(4096);
        let (cycle_views, mut views) = RingBuffer::new(4096);
        let (to_cycle, feedback) = RingBuffer::new(4);
        let (_answers, answers) = RingBuffer::new(1);
        let (periphery, _publisher) = mpsc::channel();
        let (mut inputs, samples) = RingBuffer::new(4);
        inputs.push(chain_input(true)).unwrap();
        let signals = Signals::new(&setup.machine.signals, 2, PERIOD_NS);
        let signals = SignalLoop::new(signals, InputSource::Bus(samples), None, None, true);
        let mut cycle = ServedCycle::new(ServedParts {
            station: MachineState::new(limits, PERIOD_NS, limits.home),
            limits,
            period_ns: PERIOD_NS,
            orders: cycle_orders,
            urgent: Arc::clone(&urgent),
            events: cycle_events,
            views: cycle_views,
            feedback,
            watch: FeedbackWatch::new(WatchSettings::new(PERIOD_NS, axes)),
            signals: has_chain.then_some(signals),
            corrections: None,
            probe: ProbeInput::default(),
            wheel_counts: None,
            phase: None,
            controls: Arc::new(Controls::new(1.0)),
            driven: DrivenPath::new(PERIOD_NS),
        });
        let mut counts = CycleCounts::default();
        let first = step(&mut cycle, 0, &mut counts);
        let folder = tempfile::tempdir().unwrap();
        let operator = Operator::new(OperatorConfig {
            keep: StateStore::open(setup.memory.clone(), folder.path()),
            setup,
            folder: folder.path().to_owned(),
            orders,
            urgent,
            recorder: None,
            periphery,
            view: views.pop().unwrap(),
        })
        .unwrap();
        let mut bench = Self {
            operator,
            cycle,
            views,
            events,
            answers,
            _answers,
            to_cycle,
            inputs,
            drives: BenchDrives {
                axes,
                ..BenchDrives::default()
            },
            last_reply: Feedback::default(),
            power: first.drive.power,
            _folder: folder,
            counts,
            now: 0,
            serial: 0,
            last: first.setpoint,
            computed: first,
        };
        for (code, index) in [
            (CommandCode::EstopReset, 0),
            (CommandCode::On, 0),
            (CommandCode::Mode, 1),
        ] {
            let mut command = bench.command(code);
            command.index = index;
            assert!(bench.says(1, command), "{code:?}");
            bench.runs(10);
            bench.ticks();
        }
        bench
    }

    /// The emergency-stop chain opens before the next cycle, which finds it so.
    pub(super) fn opens_chain(&mut self) {
        self.inputs.push(chain_input(false)).unwrap();
    }

    pub(super) fn command(&self, code: CommandCode) -> ControlRequest {
        ControlRequest {
            command: code as u32,
            ..ControlRequest::default()
        }
    }

    /// Whether it was accepted.
    pub(super) fn says(&mut self, client: u64, mut request: ControlRequest) -> bool {
        self.serial += 1;
        (request.client, request.serial) = (client, self.serial);
        let answer = self.operator.answer(&request, self.now * PERIOD_NS);
        answer.is_none_or(|answer| answer.verdict == 0)
    }

    pub(super) fn ticks(&mut self) {
        let (views, events, answers) = (&mut self.views, &mut self.events, &mut self.answers);
        self.operator
            .tick(self.now * PERIOD_NS, views, events, answers, |_| {});
    }

    pub(super) fn runs(&mut self, cycles: u64) -> Vec<Setpoint> {
        (0..cycles)
            .map(|_| {
                self.now += 1;
                if !self.drives.axes.is_empty() {
                    self.last_reply = self.drives.reply(&self.computed, &self.last_reply);
                    let _full = self.to_cycle.push(self.last_reply);
                }
                self.computed = step(&mut self.cycle, self.now, &mut self.counts);
                (self.last, self.power) = (self.computed.setpoint, self.computed.drive.power);
                self.last
            })
            .collect()
    }
}

/// The inputs of a machine whose chain is closed or open.
fn chain_input(is_closed: bool) -> InputImage {
    let mut image = InputImage::default();
    image.set(SignalKind::Digital, 0, Some(f64::from(u8::from(is_closed))));
    image
}

fn step(cycle: &mut ServedCycle, number: u64, counts: &mut CycleCounts) -> Computed {
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
    computed
}

//! Operator and cycle of a machine on one thread, in simulated time, for tests.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc;

use evolvent_bus::{ControlRequest, Feedback};
use evolvent_control::CommandCode;
use evolvent_drive::{BridgeState, DriveState, FeedbackWatch, PowerRequest, WatchSettings};
use evolvent_machine::{Machine, SignalKind};
use evolvent_motion::{DrivenPath, Setpoint, SetpointGenerator};
use evolvent_path::{Axes, AxisMask};
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

pub(super) const PERIOD_NS: u64 = 1_000_000;

/// The drives of a machine, and their bridge.
pub(super) trait Drives {
    /// Their feedback at the beginning of a period; `None` if no bridge sends any.
    fn report(&mut self, period: u64) -> Option<Feedback>;

    /// Receives the cycle's result for the period.
    fn receive(&mut self, computed: &Computed, period: u64);
}

/// Drives that follow without delay.
#[derive(Default)]
pub(super) struct BenchDrives {
    /// Axes with drives; if empty, there is no bridge.
    pub(super) axes: AxisMask,
    /// The drives are in fault.
    pub(super) has_fault: bool,
    /// The axes are blocked at their initial position.
    pub(super) is_blocked: bool,
    received: Option<Computed>,
    last_reply: Feedback,
}

impl Drives for BenchDrives {
    fn report(&mut self, _period: u64) -> Option<Feedback> {
        let last = self.received.filter(|_| !self.axes.is_empty())?;
        self.last_reply = self.reply(&last);
        Some(self.last_reply)
    }

    fn receive(&mut self, computed: &Computed, _period: u64) {
        self.received = Some(*computed);
    }
}

impl BenchDrives {
    /// The drives' feedback to a setpoint.
    fn reply(&self, last: &Computed) -> Feedback {
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
            reply.position = self.last_reply.position;
        }
        for axis in self.axes.axes() {
            reply.status_word[axis] = u32::from(state.code());
        }
        reply
    }
}

/// The equipment of a bench.
pub(super) struct Equipment<D> {
    pub(super) drives: D,
    pub(super) watch: WatchSettings,
    /// Initial position of the axes.
    pub(super) position: Axes,
    pub(super) has_signals: bool,
    /// The control thread receives the feedback too. Feedback carries real time, so the control thread then
    /// uses real time as well; otherwise it uses the time of the cycles.
    pub(super) control_reads_feedback: bool,
}

/// A machine on its own.
pub(super) struct Bench<D = BenchDrives> {
    pub(super) operator: Operator,
    pub(super) cycle: ServedCycle,
    views: Consumer<CycleView>,
    /// The newest view, if the control thread ran before it arrived.
    withheld: Option<CycleView>,
    events: Consumer<CycleEvent>,
    answers: Consumer<Feedback>,
    to_control: Option<Producer<Feedback>>,
    to_cycle: Producer<Feedback>,
    inputs: Producer<InputImage>,
    pub(super) drives: D,
    /// The power request published with the last setpoint.
    pub(super) power: PowerRequest,
    _folder: tempfile::TempDir,
    counts: CycleCounts,
    pub(super) now: u64,
    serial: u64,
    pub(super) last: Setpoint,
}

impl Bench {
    /// At rest at home, switched on, in manual mode.
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
        let chain = "[[input]]\nname = \"chain\"\nnumber = 0\n[estop]\ninput = \"chain\"\n";
        let mut bench = Self::assemble(if has_chain { chain } else { "" }, |setup| Equipment {
            drives: BenchDrives {
                axes,
                ..BenchDrives::default()
            },
            watch: WatchSettings::new(PERIOD_NS, axes),
            position: setup.machine.limits().home,
            has_signals: has_chain,
            control_reads_feedback: false,
        });
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
}

impl<D: Drives> Bench<D> {
    /// A mill in emergency stop, with `added` in its file.
    pub(super) fn assemble(added: &str, equip: impl FnOnce(&Setup) -> Equipment<D>) -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let text = std::fs::read_to_string(&file).unwrap() + "\n" + added;
        let machine = Machine::parse(&text, "mill.toml").unwrap();
        let mut setup = Setup::new(machine, file, text, None).unwrap();
        setup.period_ns = PERIOD_NS;
        let limits = setup.machine.limits();
        let Equipment {
            mut drives,
            watch,
            position,
            has_signals,
            control_reads_feedback,
        } = equip(&setup);
        let (orders, cycle_orders) = RingBuffer::new(1024);
        let urgent = Arc::<UrgentOrders>::default();
        let (cycle_events, events) = RingBuffer::new(4096);
        let (cycle_views, mut views) = RingBuffer::new(4096);
        let (to_cycle, feedback) = RingBuffer::new(4);
        let (to_control, answers) = RingBuffer::new(4);
        let (periphery, _publisher) = mpsc::channel();
        let (mut inputs, samples) = RingBuffer::new(4);
        inputs.push(chain_input(true)).unwrap();
        let signals = Signals::new(&setup.machine.signals, 2, PERIOD_NS);
        let signals = SignalLoop::new(signals, InputSource::Bus(samples), None, None, true);
        let mut cycle = ServedCycle::new(ServedParts {
            generator: SetpointGenerator::new(limits, PERIOD_NS, position),
            limits,
            period_ns: PERIOD_NS,
            orders: cycle_orders,
            urgent: Arc::clone(&urgent),
            events: cycle_events,
            views: cycle_views,
            feedback,
            watch: FeedbackWatch::new(watch),
            signals: has_signals.then_some(signals),
            corrections: None,
            probe: ProbeInput::default(),
            wheel_counts: None,
            phase: None,
            controls: Arc::new(Controls::new(1.0)),
            driven: DrivenPath::new(PERIOD_NS),
        });
        let mut counts = CycleCounts::default();
        let first = step(&mut cycle, 0, &mut counts);
        drives.receive(&first, 0);
        let folder = tempfile::tempdir().unwrap();
        let operator = Operator::new(OperatorConfig {
            store: StateStore::open(setup.memory.clone(), folder.path()),
            setup,
            folder: folder.path().to_owned(),
            orders,
            urgent,
            recorder: None,
            periphery,
            view: views.pop().unwrap(),
        })
        .unwrap();
        Self {
            operator,
            cycle,
            views,
            withheld: None,
            events,
            answers,
            to_control: control_reads_feedback.then_some(to_control),
            to_cycle,
            inputs,
            drives,
            power: first.drive.power,
            _folder: folder,
            counts,
            now: 0,
            serial: 0,
            last: first.setpoint,
        }
    }

    /// Opens the emergency-stop chain before the next cycle.
    pub(super) fn opens_chain(&mut self) {
        self.inputs.push(chain_input(false)).unwrap();
    }

    pub(super) fn command(&self, code: CommandCode) -> ControlRequest {
        ControlRequest {
            command: code as u32,
            ..ControlRequest::default()
        }
    }

    /// Sends a request; returns whether it was accepted.
    pub(super) fn says(&mut self, client: u64, request: ControlRequest) -> bool {
        self.reply(client, request).is_none()
    }

    /// Sends a request; returns the alarm of its rejection, if any.
    pub(super) fn reply(&mut self, client: u64, mut request: ControlRequest) -> Option<u32> {
        self.serial += 1;
        (request.client, request.serial) = (client, self.serial);
        let answer = self.operator.answer(&request, self.control_ns());
        answer
            .filter(|answer| answer.verdict != 0)
            .map(|answer| answer.alarm)
    }

    /// The time of the control thread.
    fn control_ns(&self) -> u64 {
        if self.to_control.is_some() {
            MonotonicClock::now_ns()
        } else {
            self.now * PERIOD_NS
        }
    }

    pub(super) fn ticks(&mut self) {
        let now_ns = self.control_ns();
        let (views, events, answers) = (&mut self.views, &mut self.events, &mut self.answers);
        self.operator.tick(now_ns, views, events, answers, |_| {});
    }

    pub(super) fn runs(&mut self, cycles: u64) -> Vec<Setpoint> {
        (0..cycles)
            .map(|_| {
                self.now += 1;
                let (cycle, drives, to_cycle) = (&mut self.cycle, &mut self.drives, &mut self.to_cycle);
                let (report, computed) = run_cycle(cycle, drives, to_cycle, self.now, &mut self.counts);
                if let (Some(control), Some(report)) = (&mut self.to_control, report) {
                    let _full = control.push(report);
                }
                (self.last, self.power) = (computed.setpoint, computed.drive.power);
                self.last
            })
            .collect()
    }

    /// Runs one cycle, which ends while the control thread takes in the views of earlier cycles.
    pub(super) fn ticks_beside_a_cycle(&mut self) {
        let now_ns = self.control_ns();
        let (views, events, answers) = (&mut self.views, &mut self.events, &mut self.answers);
        let (cycle, drives, to_cycle) = (&mut self.cycle, &mut self.drives, &mut self.to_cycle);
        let (now, counts) = (&mut self.now, &mut self.counts);
        let mut ended = None;
        self.operator.tick(now_ns, views, events, answers, |_| {
            if ended.is_none() {
                *now += 1;
                ended = Some(run_cycle(cycle, drives, to_cycle, *now, counts).1);
            }
        });
        let computed = ended.expect("a view before");
        (self.last, self.power) = (computed.setpoint, computed.drive.power);
    }

    /// Runs the control thread after the last cycle has reported its events and before its view arrives.
    pub(super) fn ticks_before_the_last_view(&mut self) {
        let (mut to_control, mut views) = RingBuffer::new(64);
        let withheld = self.withheld.take();
        for view in withheld
            .into_iter()
            .chain(std::iter::from_fn(|| self.views.pop().ok()))
        {
            if let Some(before) = self.withheld.replace(view) {
                to_control.push(before).expect("room for views");
            }
        }
        let now_ns = self.control_ns();
        let (events, answers) = (&mut self.events, &mut self.answers);
        self.operator.tick(now_ns, &mut views, events, answers, |_| {});
    }

    /// Runs cycles, with one pass of the control thread after each.
    pub(super) fn runs_and_ticks(&mut self, cycles: u64) {
        for _ in 0..cycles {
            self.runs(1);
            self.ticks();
        }
    }
}

/// The inputs of a machine whose chain is closed or open.
fn chain_input(is_closed: bool) -> InputImage {
    let mut image = InputImage::default();
    image.set(SignalKind::Digital, 0, Some(f64::from(u8::from(is_closed))));
    image
}

/// Runs one cycle with the drives: passes their feedback in and the result back.
fn run_cycle(
    cycle: &mut ServedCycle,
    drives: &mut impl Drives,
    to_cycle: &mut Producer<Feedback>,
    number: u64,
    counts: &mut CycleCounts,
) -> (Option<Feedback>, Computed) {
    let report = drives.report(number);
    if let Some(report) = report {
        let _full = to_cycle.push(report);
    }
    let computed = step(cycle, number, counts);
    drives.receive(&computed, number);
    (report, computed)
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

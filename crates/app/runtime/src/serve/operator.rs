//! The control thread's side of a served machine: carries out commands, follows jobs, reports faults.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::Sender;

use evolvent_bus::Feedback;
use evolvent_control::{Alarm, Homing, JobResult, MachineState, OperatorCommand, OperatorState};
use evolvent_drive::{PowerRequest, Presence};
use evolvent_machine::{Limits, OnFull};
use evolvent_motion::MotionState;
use evolvent_path::{Axes, AxisMask};
use rtrb::{Consumer, Producer};

use super::change_mark::ChangeMark;
use super::checking::{Checking, Finding};
use super::drive_view::{DriveView, homing_sample};
use super::file_work::FileWork;
use super::handwheel::HandwheelState;
use super::jog::Steered;
use super::modes::{Modes, simulate_modes};
use super::operator_message::OperatorMessage;
use super::order_book::OrderBook;
use super::orders::{CycleCommand, CycleEvent, CycleView, Order};
use super::periphery_state::PeripheryState;
use super::program_context::ProgramContext;
use super::programs::ProgramRun;
use super::state_store::StateStore;
use super::urgent::UrgentOrders;
use crate::drives::watch_settings;
use crate::job::Setup;
use crate::news::{ExternalEvent, ExternalEventKind, FeederEvent};
use crate::periphery_track::PeripheryOrder;

/// Additional time after which the operator reports that drives do not come into operation, beyond the time
/// of the cycle's watch, ns. The watch starts when power is requested, which may be 2.5 s after the command.
const ENABLE_MARGIN_NS: u64 = 2_600_000_000;

pub(super) enum Job {
    None,
    Program(Box<ProgramRun>),
    Jog {
        steered: Box<Steered>,
        by_handwheel: bool,
    },
    Homing {
        homing: Homing,
        steered: Option<Box<Steered>>,
        /// Result of the job once its motion has ended.
        cancelled: Option<JobResult>,
    },
}

/// Why the job does not continue, or will end soon.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StopState {
    pub(super) hold: bool,
    /// The job received a stop and cannot be resumed.
    pub(super) stopping: bool,
    /// An emergency stop ended the job: what its program switches no longer counts.
    pub(super) is_emergency: bool,
    /// The process is to end.
    pub(super) ending: bool,
}

/// The operator's side of one machine.
pub(crate) struct Operator {
    pub(super) setup: Setup,
    pub(super) state: OperatorState,
    pub(super) store: StateStore,
    pub(super) folder: PathBuf,
    pub(super) limits: Limits,
    pub(super) present: AxisMask,
    /// Unlimited rotary axes.
    pub(super) unlimited: AxisMask,
    pub(super) view: CycleView,
    /// Number of the last order for power.
    pub(super) power_order: u64,
    /// Events of cycles whose view has not arrived yet.
    inbox: VecDeque<CycleEvent>,
    pub(super) drives: DriveView,
    pub(super) book: OrderBook,
    pub(super) job: Job,
    pub(super) stops: StopState,
    pub(super) program: ProgramContext,
    pub(super) files: FileWork,
    /// Present state of spindle, coolant and tool.
    pub(super) periphery: PeripheryState,
    pub(super) handwheel: Option<HandwheelState>,
    pub(super) message: OperatorMessage,
    pub(super) malformed: u64,
}

/// Parts from which an [`Operator`] is built.
pub(crate) struct OperatorConfig {
    pub setup: Setup,
    pub store: StateStore,
    pub folder: PathBuf,
    pub orders: Producer<Order>,
    /// Orders that bypass the queue.
    pub urgent: Arc<UrgentOrders>,
    pub recorder: Option<Sender<FeederEvent>>,
    /// To the publisher.
    pub periphery: Sender<PeripheryOrder>,
    pub view: CycleView,
}

impl Operator {
    /// Builds the operator's side.
    ///
    /// # Errors
    /// The kept parameters do not fit the machine.
    pub(crate) fn new(beginning: OperatorConfig) -> Result<Self, String> {
        let OperatorConfig {
            setup,
            store,
            folder,
            orders,
            urgent,
            recorder,
            periphery,
            view,
        } = beginning;
        let tool = store.tool;
        let handwheel = setup.machine.handwheel.as_ref().map(HandwheelState::new);
        let machine = &setup.machine;
        let present = machine
            .axes
            .iter()
            .map(|axis| axis.letter.index())
            .collect::<AxisMask>();
        let to_home = machine
            .homing
            .iter()
            .map(|axis| axis.axis.index())
            .collect::<AxisMask>();
        let unlimited = machine.unlimited();
        let limits = machine.limits();
        let bounds = watch_settings(machine, setup.period_ns).bounds;
        let mut state = OperatorState::default();
        // Axes that the core cannot home are at the position in the machine file or, if the drives keep
        // theirs, at the position that the drives report.
        state.set_homed(present.without(to_home));
        // The cycle's watch has the same timeout and knows which drive it is, so this one comes second.
        let enable_timeout_ns = (machine.drives.enable_timeout_s * 1e9) as u64;
        state.set_enable_timeout_ns(enable_timeout_ns.saturating_add(ENABLE_MARGIN_NS));
        if !store.complaints.is_empty() {
            // One alarm: of two, the second would not be seen.
            state.raise(Alarm::NotRead, store.complaints.join("; "));
        }
        if let Some(mark) = store.change {
            state.raise(Alarm::ToolChange, mark.sentence());
        }
        let modes = Modes::at_start(&setup.interpreter_settings()).map_err(|error| error.to_string())?;
        let mut operator = Self {
            setup,
            state,
            store,
            folder,
            limits,
            present,
            unlimited,
            view,
            power_order: 0,
            inbox: VecDeque::new(),
            drives: DriveView::new(bounds),
            book: OrderBook::new(orders, urgent, recorder),
            job: Job::None,
            stops: StopState::default(),
            program: ProgramContext::new(modes),
            files: FileWork::default(),
            periphery: PeripheryState::new(tool, periphery),
            handwheel,
            message: OperatorMessage::default(),
            malformed: 0,
        };
        operator.refresh_modes();
        operator.relocate(operator.view.setpoint.position, false);
        Ok(operator)
    }

    /// The setup of a job that begins now at the present position.
    pub(super) fn setup_here(&self) -> Setup {
        let mut setup = self.setup.clone();
        setup.memory = self.store.memory.clone();
        setup.position = Some(self.view.setpoint.position);
        setup.unhomed = self.present.without(self.state.homed());
        setup.tool = self.store.tool;
        setup.selected_tool = self.program.modes.modal.selected_tool;
        setup.tool_unknown = self.store.change.map(ChangeMark::sentence);
        setup.outputs = self.periphery.now().outputs;
        setup.block_delete = self.state.is_block_delete();
        setup.rapid_override = self.state.overrides()[1];
        setup
    }

    /// The same with `preamble` before the text, which restores the present modes.
    pub(super) fn setup_after(&self, preamble: &str) -> Setup {
        let mut setup = self.setup_here();
        setup.restored = self.program.modes.restored(preamble);
        setup
    }

    pub(super) fn kept(&self) -> evolvent_gcode::PersistentParameters {
        self.store.memory.kept.clone().unwrap_or_default()
    }

    /// Computes the modes again after offsets or tools changed from outside.
    pub(super) fn refresh_modes(&mut self) {
        let preamble = self.program.modes.preamble();
        let settings = self.setup_after(&preamble).interpreter_settings();
        if let Ok(after) = simulate_modes(&preamble, &settings, &self.kept()) {
            self.program.modes = after.modes;
        }
    }

    /// Number of requests of another version or size so far.
    pub(crate) fn malformed(&self) -> u64 {
        self.malformed
    }

    pub(super) fn is_held(&self) -> bool {
        let state = self.view.setpoint.state;
        // A user-defined M code and a wait for an input must end before the program continues.
        let at_stop = state == MotionState::ProgramStop && !self.is_waiting();
        let is_held = self.stops.hold || at_stop || matches!(state, MotionState::Holding | MotionState::Held);
        is_held && !self.stops.stopping
    }

    /// Whether a tool change was interrupted and the tool in the spindle has not been declared since.
    pub(crate) fn is_tool_unknown(&self) -> bool {
        self.store.change.is_some() && !self.store.is_change_under_way
    }

    /// Whether the feed is held.
    pub(crate) fn is_holding(&self) -> bool {
        self.stops.hold
    }

    /// Emergency stop: ends the job and everything pending.
    pub(super) fn break_off(&mut self, result: JobResult) {
        self.cancel_reading();
        self.give_up_waiting(result);
        self.cancel_command();
        self.cancel_homing(result);
        if !matches!(self.job, Job::None) {
            // The job may be on its way to a cycle that has found the chain open and stopped nothing.
            self.order(CycleCommand::Stop);
        }
        self.stops.is_emergency = true;
        self.switch_periphery_off();
    }

    pub(super) fn order(&mut self, what: CycleCommand) -> u64 {
        self.book.order(what)
    }

    /// Sends an order that is recorded where it takes effect.
    pub(super) fn send(&mut self, what: CycleCommand, command: &OperatorCommand) -> u64 {
        self.book.send(what, command)
    }

    /// Records something that took effect now.
    pub(super) fn record(&mut self, kind: ExternalEventKind, code: u32, text: String, value: Option<f64>) {
        let sequence = self.view.setpoint.sequence;
        self.record_at(sequence, kind, code, text, value);
    }

    pub(super) fn record_at(
        &mut self,
        sequence: u64,
        kind: ExternalEventKind,
        code: u32,
        text: String,
        value: Option<f64>,
    ) {
        self.book.record(ExternalEvent {
            sequence,
            kind,
            code,
            text,
            value,
        });
    }

    pub(super) fn raise(&mut self, sequence: u64, alarm: Alarm, text: String) {
        let kind = match alarm.kind() {
            evolvent_control::AlarmKind::Warning => ExternalEventKind::Warning,
            _ => ExternalEventKind::Alarm,
        };
        self.record_at(sequence, kind, alarm.number(), text.clone(), None);
        self.state.raise(alarm, text);
    }

    pub(super) fn g92(&self) -> Axes {
        let kept = self.kept();
        self.program.modes.modal.work_offset - kept.work_offset(kept.active_offset())
    }

    /// Ends the process: everything stops, then the cycle ends.
    pub(crate) fn end(&mut self) {
        if !self.stops.ending {
            self.stops.ending = true;
            self.switch_off_at_rest();
            self.cancel_reading();
            self.give_up_waiting(JobResult::Stopped);
            self.cancel_command();
            self.cancel_homing(JobResult::Stopped);
            self.order(CycleCommand::End);
            self.record(
                ExternalEventKind::Command,
                0,
                "the core was requested to shut down".to_owned(),
                None,
            );
        }
    }

    /// Begins another trace file after the present setpoint.
    pub(crate) fn begin_trace_file(&mut self) {
        self.book.begin_file(self.view.setpoint.sequence);
    }

    /// Whether nothing moves and no motion is pending.
    pub(crate) fn is_idle(&self) -> bool {
        matches!(self.job, Job::None) && self.files.reading.is_none() && self.view.at_rest
    }

    /// Handles a trace that can no longer be written. The machine file determines whether the machine
    /// continues.
    pub(crate) fn trace_failed(&mut self, text: &str) {
        self.state.raise(Alarm::Trace, text);
        if self.setup.machine.trace.on_full == OnFull::Stop {
            self.give_up_waiting(JobResult::Stopped);
            self.cancel_homing(JobResult::Stopped);
            self.order(CycleCommand::Stop);
        }
    }

    /// Takes in what arrived since the last call, and continues what is in progress.
    pub(crate) fn tick(
        &mut self,
        now_ns: u64,
        views: &mut Consumer<CycleView>,
        events: &mut Consumer<CycleEvent>,
        answers: &mut Consumer<Feedback>,
        mut observe: impl FnMut(&CycleView),
    ) {
        while let Ok(view) = views.pop() {
            observe(&view);
            self.view = view;
            if self.view.datum < self.drives.datum {
                // What begins now uses the new coordinates.
                self.view.setpoint.position += self.drives.renaming;
            } else {
                self.drives.renaming = Axes::zeros();
            }
        }
        // Events are read after the views. A cycle reports its events before its view, so the events that led
        // to the view are here too. In the other order, power could appear gone before its alarm, and a job
        // would end without a reason.
        while let Ok(event) = events.pop() {
            self.inbox.push_back(event);
        }
        while self
            .inbox
            .front()
            .is_some_and(|event| event.sequence() <= self.view.setpoint.sequence)
        {
            if let Some(event) = self.inbox.pop_front() {
                self.handle_event(event);
            }
        }
        self.give_up_lost_orders();
        while let Ok(feedback) = answers.pop() {
            let Some(feedback) = self.drives.take(feedback, &self.view, now_ns) else {
                continue;
            };
            self.watch_absolute(AxisMask::from_bits(feedback.absolute_mask));
            if self.drives.counts_as(&self.view, &feedback) {
                self.take_zeroed(&feedback);
                if self.drives.zeroed.is_empty() {
                    self.step_homing(&homing_sample(&feedback));
                }
            }
        }
        // A view from before the order does not show the effect of the order.
        let is_settled = self.view.power_order == self.power_order;
        let is_powered = self.view.power == PowerRequest::On && is_settled;
        let are_ready = matches!(self.view.presence, Presence::Operational | Presence::Absent);
        let wanted_power = self.state.wants_power();
        self.state.enable(is_powered && are_ready, now_ns);
        if wanted_power && !self.state.wants_power() {
            // Too late: power must not come on by itself afterwards.
            self.power_order = self.book.order(CycleCommand::Power(PowerRequest::Off));
        }
        if is_settled && !is_powered && self.state.machine() == MachineState::On {
            // Whatever removed the power: a machine that is on without power would accept jobs that move
            // nothing.
            self.lose_power();
        }
        // While the program waits for a spindle, an input or a user-defined M code, its state is that of a
        // program stop although no operator holds it.
        let is_held = match self.view.setpoint.state {
            MotionState::Held => true,
            MotionState::ProgramStop => !self.is_waiting(),
            _ => false,
        };
        self.program.tally.observe(self.view.setpoint.sequence, is_held);
        self.follow_program();
        self.follow_jog();
        self.follow_handwheel();
        self.remove_whole_turns();
        if let Some(text) = self
            .files
            .approach
            .as_ref()
            .and_then(|approach| approach.try_recv().ok())
        {
            self.files.approach = None;
            // A job that was stopped meanwhile does not need it any more.
            if matches!(self.job, Job::Program(_)) {
                self.message.tell_of_stop(text);
            }
        }
        self.tell_check();
    }

    /// Reports the result of the separate check.
    fn tell_check(&mut self) {
        let Some(finding) = self.files.checking.as_mut().and_then(Checking::finding) else {
            return;
        };
        let text = match finding {
            Finding::Objection(text) => text,
            Finding::Caution(text) => {
                let program = self.state.program().unwrap_or_default();
                let note = format!("{program}: {text}");
                self.record(ExternalEventKind::Warning, 0, note.clone(), None);
                self.files.cautions.push(note);
                text
            }
        };
        self.message.tell_of_program(text);
    }

    /// Parts of programs that could not be checked, since the last call.
    pub(super) fn take_cautions(&mut self) -> Vec<String> {
        std::mem::take(&mut self.files.cautions)
    }

    pub(super) fn end_job(&mut self, result: JobResult) {
        if matches!(self.job, Job::Homing { .. }) {
            self.order(CycleCommand::ExpectSwitches([AxisMask::NONE; 2]));
            // Restores the present limits of travel.
            self.relocate(self.view.setpoint.position, false);
        }
        self.judge_change();
        self.program.tally.end(result == JobResult::Done);
        // A program that did not reach its end has not switched off what it had switched on.
        let is_broken_off = matches!(self.job, Job::Program(_)) && result != JobResult::Done;
        if is_broken_off || result == JobResult::Fault {
            self.switch_periphery_off();
        }
        self.message.job_ends();
        self.job = Job::None;
        (self.stops.hold, self.stops.stopping) = (false, false);
        self.state.job_ends(result);
    }

    pub(crate) fn present(&self) -> AxisMask {
        self.present
    }
}

//! The control thread's side of a served machine: commands carried out, jobs followed, faults told.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender};

use evolvent_bus::{ControlAnswer, ControlRequest, Feedback, Payload};
use evolvent_control::{
    Alarm, Command, CommandCode, Homing, HomingSample, JobResult, JogEnable, OperatorInputs, OperatorState,
    RawCommand, Rejection, Verdict,
};
use evolvent_drive::{FeedbackBounds, PowerRequest, Presence};
use evolvent_machine::{Limits, OnFull};
use evolvent_motion::State;
use evolvent_path::{Axes, AxisMask};
use rtrb::{Consumer, Producer};

use super::change_mark::ChangeMark;
use super::checking::Checking;
use super::files::{Readers, Reading};
use super::handwheel::HandwheelDesk;
use super::jog::Steered;
use super::modes::{Modes, simulate_modes};
use super::orders::{ActiveJob, CycleCommand, CycleEvent, CycleView, Order};
use super::periphery_desk::PeripheryDesk;
use super::program_tally::ProgramTally;
use super::programs::ProgramRun;
use super::recorded::JobNotes;
use super::state_store::{Saved, StateStore};
use super::track::Track;
use crate::drives::watch_settings;
use crate::job::Setup;
use crate::news::{ExternalEvent, ExternalEventKind, FeederEvent};
use crate::periphery_track::PeripheryOrder;
use crate::program_cycle::turning_alarm;
use crate::switches::{SwitchState, Switches};

/// By how much later than the cycle's watch the desk finds that drives do not come into operation, ns.
const ENABLE_MARGIN_NS: u64 = 100_000_000;

pub(super) enum Job {
    None,
    Program(Box<ProgramRun>),
    Jog {
        steered: Box<Steered>,
        held: Option<JogEnable>,
        by_handwheel: bool,
    },
    Homing {
        homing: Homing,
        steered: Option<Box<Steered>>,
        cancelled: bool,
    },
}

/// A command on its way to the cycle.
struct PendingCommand {
    id: u64,
    code: u32,
    text: String,
    value: Option<f64>,
}

/// The operator's side of one machine.
pub(crate) struct Operator {
    pub(super) setup: Setup,
    pub(super) desk: OperatorState,
    pub(super) keep: StateStore,
    pub(super) modes: Modes,
    /// Lines that set the parameters that blocks of MDI have left.
    pub(super) parameters: String,
    pub(super) message: String,
    pub(super) track: Track,
    pub(super) view: CycleView,
    pub(super) feedback: Option<Feedback>,
    bounds: FeedbackBounds,
    pub(super) folder: PathBuf,
    pub(super) limits: Limits,
    pub(super) present: AxisMask,
    pub(super) orders: Producer<Order>,
    pub(super) next_id: u64,
    sent: VecDeque<PendingCommand>,
    pub(super) recorder: Option<Sender<FeederEvent>>,
    /// Of the job that runs, or of the next one.
    pub(super) switches: Arc<Switches>,
    /// What the trace is told of jobs.
    pub(super) notes: JobNotes,
    /// Numbers of the next block and action.
    pub(super) numbers: (u32, u32),
    pub(super) job: Job,
    pub(super) hold: bool,
    /// The job was told to stop: nothing resumes it.
    pub(super) stopping: bool,
    pub(super) ending: bool,
    /// Machine coordinates of the drives' first datum, less those of now.
    pub(super) home_offset: Axes,
    pub(super) malformed: u64,
    /// Events of cycles whose view has not come.
    inbox: VecDeque<CycleEvent>,
    /// The check of a long program.
    pub(super) checking: Option<Checking>,
    /// Spindle, coolant and tool as they are now.
    pub(super) periphery: PeripheryDesk,
    /// The job was stopped by an emergency stop: what its program switches counts no more.
    pub(super) is_emergency: bool,
    pub(super) handwheel: Option<HandwheelDesk>,
    pub(super) tally: ProgramTally,
    pub(super) readers: Readers,
    /// The command whose files are being read.
    pub(super) reading: Option<Reading>,
    /// The datum that the last renaming has led to.
    pub(super) datum: u64,
    /// Number of the next request for an index pulse, and the axis of the last.
    pub(super) next_index: u32,
    pub(super) index_axis: Option<usize>,
    /// The way to the middle of the program, on its way.
    pub(super) way: Option<Receiver<String>>,
    /// The tool in the spindle is being written.
    pub(super) tool_savings: Vec<Receiver<Saved>>,
}

/// What the operator begins with.
pub(crate) struct OperatorConfig {
    pub setup: Setup,
    pub keep: StateStore,
    pub folder: PathBuf,
    pub orders: Producer<Order>,
    pub recorder: Option<Sender<FeederEvent>>,
    /// To the publisher.
    pub periphery: Sender<PeripheryOrder>,
    pub view: CycleView,
}

impl Operator {
    /// Stands at its desk.
    ///
    /// # Errors
    /// What was kept of parameters does not fit the machine.
    pub(crate) fn new(beginning: OperatorConfig) -> Result<Self, String> {
        let OperatorConfig {
            setup,
            keep,
            folder,
            orders,
            recorder,
            periphery,
            view,
        } = beginning;
        let tool = keep.tool;
        let handwheel = setup.machine.handwheel.as_ref().map(HandwheelDesk::new);
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
        let limits = machine.limits();
        let bounds = watch_settings(machine, setup.period_ns).bounds;
        let mut desk = OperatorState::default();
        // Axes without a switch stand where the machine file says, or where their drives say.
        desk.set_homed(present.without(to_home));
        // The cycle's watch has the same time and knows which drive it is: this comes second.
        let enable_timeout_ns = (machine.drives.enable_timeout_s * 1e9) as u64;
        desk.set_enable_timeout_ns(enable_timeout_ns.saturating_add(ENABLE_MARGIN_NS));
        for complaint in &keep.complaints {
            desk.raise(Alarm::NotRead, complaint.clone());
        }
        if let Some(mark) = keep.change {
            desk.raise(Alarm::ToolChange, mark.sentence());
        }
        let mut operator = Self {
            modes: Modes::at_start(&setup.interpreter_settings()).map_err(|error| error.to_string())?,
            parameters: String::new(),
            setup,
            desk,
            keep,
            message: String::new(),
            track: Track::default(),
            view,
            feedback: None,
            bounds,
            folder,
            limits,
            present,
            orders,
            next_id: 0,
            sent: VecDeque::new(),
            notes: JobNotes::new(recorder.is_some()),
            recorder,
            switches: Arc::new(Switches::new(&SwitchState::default())),
            numbers: (0, 0),
            job: Job::None,
            hold: false,
            stopping: false,
            ending: false,
            home_offset: Axes::zeros(),
            malformed: 0,
            inbox: VecDeque::new(),
            datum: 0,
            next_index: 1,
            index_axis: None,
            way: None,
            tool_savings: Vec::new(),
            checking: None,
            periphery: PeripheryDesk::new(tool, periphery),
            is_emergency: false,
            handwheel,
            tally: ProgramTally::default(),
            readers: Readers::default(),
            reading: None,
        };
        operator.refresh_modes();
        operator.relocate(operator.view.setpoint.position, false);
        Ok(operator)
    }

    /// The setup of a job that begins here and now.
    pub(super) fn setup_here(&self) -> Setup {
        let mut setup = self.setup.clone();
        setup.memory = self.keep.memory.clone();
        setup.place = Some(self.view.setpoint.position);
        setup.tool = self.keep.tool;
        setup.selected_tool = self.modes.modal.selected_tool;
        setup.tool_unknown = self.keep.change.map(ChangeMark::sentence);
        setup.outputs = self.periphery.now().outputs;
        setup.block_delete = self.desk.is_block_delete();
        setup.rapid_override = self.desk.overrides()[1];
        setup
    }

    pub(super) fn kept(&self) -> evolvent_gcode::KeptParameters {
        self.keep.memory.kept.clone().unwrap_or_default()
    }

    /// Works the modes out again: after offsets or tools were changed from outside.
    pub(super) fn refresh_modes(&mut self) {
        let settings = self.setup_here().interpreter_settings();
        if let Ok(after) = simulate_modes(&self.modes.preamble(), &settings, &self.kept()) {
            self.modes = after.modes;
        }
    }

    /// Judges a request and carries it out.
    /// The answer; `None` while files are being read for it, until [`Operator::finish_reading`] gives it.
    pub(crate) fn answer(&mut self, request: &ControlRequest, now_ns: u64) -> Option<ControlAnswer> {
        if !request.is_compatible() {
            self.malformed += 1;
            return Some(self.composed(request, Err((Verdict::Rejected, Alarm::Malformed.into()))));
        }
        let raw = RawCommand {
            command: request.command,
            axes_mask: request.axes_mask,
            index: request.index,
            amount: request.amount,
            values: request.values,
            text: request.text(),
        };
        let facts = self.facts();
        let considered = self.desk.authorize(request.client, request.serial, &raw, &facts);
        let carried_out = match considered {
            Err(refused) => Err(refused),
            Ok(command) => match self.begin_reading(request, &command) {
                Some(Ok(reading)) => {
                    self.reading = Some(reading);
                    return None;
                }
                Some(Err(refusal)) => Err(self.desk.refuse(refusal)),
                None => self
                    .carry_out(&command, request.client, now_ns)
                    .map_err(|refusal| self.desk.refuse(refusal))
                    .inspect(|_| self.desk.commit(&command, now_ns, true)),
            },
        };
        Some(self.composed(request, carried_out))
    }

    pub(super) fn facts(&self) -> OperatorInputs {
        OperatorInputs {
            present: self.present,
            is_held: self.is_held(),
            is_ending: self.ending,
            is_chain_open: self.view.is_chain_open,
        }
    }

    /// The answer to a request: the job that it begins, or why it is refused.
    pub(super) fn composed(
        &self,
        request: &ControlRequest,
        result: Result<u64, (Verdict, Rejection)>,
    ) -> ControlAnswer {
        let mut answer = ControlAnswer {
            client: request.client,
            serial: request.serial,
            command: request.command,
            sequence: self.view.setpoint.sequence,
            ..ControlAnswer::default()
        };
        match result {
            Ok(job) => {
                answer.job = job;
                let starts = [CommandCode::Start as u32, CommandCode::Step as u32].contains(&request.command);
                if job > 0 && starts {
                    answer.set_text(&self.started());
                }
            }
            Err((verdict, refusal)) => {
                answer.verdict = verdict as u32;
                answer.alarm = refusal.alarm.number();
                answer.set_text(&refusal.text);
            }
        }
        answer
    }

    pub(super) fn note_command(&mut self, command: &Command) {
        self.record(
            ExternalEventKind::Command,
            command.code() as u32,
            command.to_string(),
            command.value(),
        );
    }

    /// Requests of another version or size so far.
    pub(crate) fn malformed(&self) -> u64 {
        self.malformed
    }

    pub(super) fn is_held(&self) -> bool {
        let state = self.view.setpoint.state;
        // A command of the machine's own, or a wait for an input, has to end by itself before the program goes on.
        let at_stop = state == State::ProgramStop && !self.is_waiting();
        let is_held = self.hold || at_stop || matches!(state, State::Holding | State::Held);
        is_held && !self.stopping
    }

    /// Whether the feed is held.
    pub(crate) fn is_holding(&self) -> bool {
        self.hold
    }

    /// Does what a command says; the number of the job that it begins, or 0.
    pub(super) fn carry_out(
        &mut self,
        command: &Command,
        client: u64,
        now_ns: u64,
    ) -> Result<u64, Rejection> {
        let mut job = 0;
        match command {
            Command::Estop => {
                self.break_off(JobResult::Stopped);
                self.send(CycleCommand::Emergency, command);
                return Ok(0);
            }
            Command::EstopReset => {
                self.send(CycleCommand::LeaveEstop, command);
                return Ok(0);
            }
            Command::SetOutput { name, value } => {
                let change = self.output_change(name, *value)?;
                self.send(CycleCommand::Outputs(change), command);
                return Ok(0);
            }
            Command::On => {
                // Where the drives are is where the core stands: the cycle sees to it without power.
                self.send(CycleCommand::Power(PowerRequest::On), command);
                return Ok(0);
            }
            Command::Off => {
                self.switch_periphery_off();
                self.cancel_reading();
                self.send(CycleCommand::Power(PowerRequest::Off), command);
                return Ok(0);
            }
            Command::Hold => {
                self.hold = !self.stopping;
                self.send(CycleCommand::Hold, command);
                return Ok(0);
            }
            Command::Resume => {
                self.resume(command);
                return Ok(0);
            }
            Command::Step => {
                self.switches.set_single_step(true);
                self.resume(command);
                return Ok(0);
            }
            Command::SingleStep(on) => {
                self.switches.set_single_step(*on);
                self.step_on(*on);
            }
            Command::Stop => {
                self.cancel_reading();
                self.stop(command);
                return Ok(0);
            }
            Command::FeedOverride(ratio) => {
                self.send(CycleCommand::Override(*ratio), command);
                return Ok(0);
            }
            Command::Jog(jog) => job = self.jog(jog, client, now_ns, command)?,
            Command::JogKeep => {
                self.keep_jogging(client, now_ns);
                return Ok(0);
            }
            Command::JogStop => {
                if let Job::Jog { steered, .. } = &mut self.job {
                    steered.stopping = true;
                    self.send(CycleCommand::Stop, command);
                    return Ok(0);
                }
            }
            Command::Home(mask) => job = self.home(*mask)?,
            Command::Reset => {
                self.switch_periphery_off();
                let settings = self.setup_here().interpreter_settings();
                if let Ok(modes) = Modes::at_start(&settings) {
                    self.modes = modes;
                }
                self.message.clear();
                self.send(CycleCommand::Clear, command);
                return Ok(0);
            }
            Command::ClearAlarms => {
                self.message.clear();
                self.send(CycleCommand::Clear, command);
                return Ok(0);
            }
            Command::OptionalStop(on) => self.switches.set_optional_stop(*on),
            Command::BlockDelete(on) => self.switches.set_block_delete(*on),
            Command::RapidOverride(ratio) => self.switches.set_rapid_override(*ratio),
            // Those with files are carried out when they have been read.
            Command::Load(_)
            | Command::Start(_)
            | Command::Mdi(_)
            | Command::WorkOffset { .. }
            | Command::TouchOff { .. }
            | Command::Tool(_)
            | Command::ReloadTools => {}
            Command::SpindleOverride(ratio) => {
                self.send(CycleCommand::SpindleOverride(*ratio), command);
                return Ok(0);
            }
            Command::Handwheel { axis, step } => self.choose_handwheel(*axis, *step)?,
            Command::SetMode(_) => {}
        }
        self.note_command(command);
        Ok(job)
    }

    /// An emergency stop: whatever runs or is about to is given up.
    fn break_off(&mut self, result: JobResult) {
        self.cancel_reading();
        self.give_up_waiting(result);
        self.cancel_command();
        self.cancel_homing();
        self.is_emergency = true;
        self.switch_periphery_off();
    }

    pub(super) fn order(&mut self, what: CycleCommand) -> u64 {
        self.next_id += 1;
        let id = self.next_id;
        // The queue holds more than can be asked for between two cycles; a cycle that takes none has ended.
        let _full = self.orders.push(Order { id, what });
        id
    }

    /// An order that is recorded where it takes effect.
    pub(super) fn send(&mut self, what: CycleCommand, command: &Command) -> u64 {
        let id = self.order(what);
        self.sent.push_back(PendingCommand {
            id,
            code: command.code() as u32,
            text: command.to_string(),
            value: command.value(),
        });
        id
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
        if let Some(recorder) = &self.recorder {
            let outside = ExternalEvent {
                sequence,
                kind,
                code,
                text,
                value,
            };
            let _gone = recorder.send(FeederEvent::ExternalEvent(outside));
        }
    }

    pub(super) fn raise(&mut self, sequence: u64, alarm: Alarm, text: String) {
        let kind = match alarm.kind() {
            evolvent_control::AlarmKind::Warning => ExternalEventKind::Warning,
            _ => ExternalEventKind::Alarm,
        };
        self.record_at(sequence, kind, alarm.number(), text.clone(), None);
        self.desk.raise(alarm, text);
    }

    pub(super) fn g92(&self) -> Axes {
        let kept = self.kept();
        self.modes.modal.work_offset - kept.work_offset(kept.active_offset())
    }

    /// The process is to end: everything comes to rest, and then the cycle ends.
    pub(crate) fn end(&mut self) {
        if !self.ending {
            self.ending = true;
            self.switch_off_at_rest();
            self.cancel_reading();
            self.give_up_waiting(JobResult::Stopped);
            self.cancel_command();
            self.cancel_homing();
            self.order(CycleCommand::End);
            self.record(
                ExternalEventKind::Command,
                0,
                "the core was told to end".to_owned(),
                None,
            );
        }
    }

    /// The trace goes on in another file behind the present setpoint.
    pub(crate) fn begin_trace_file(&mut self) {
        if let Some(recorder) = &self.recorder {
            self.notes.begin_file();
            let _gone = recorder.send(FeederEvent::NextFile(self.view.setpoint.sequence));
        }
    }

    /// Whether nothing moves and nothing is about to.
    pub(crate) fn is_idle(&self) -> bool {
        matches!(self.job, Job::None) && self.reading.is_none() && self.view.at_rest
    }

    /// The trace cannot be written any more. Whether the machine goes on, its file says.
    pub(crate) fn trace_failed(&mut self, text: &str) {
        self.desk.raise(Alarm::Trace, text);
        if self.setup.machine.trace.on_full == OnFull::Stop {
            self.give_up_waiting(JobResult::Stopped);
            self.cancel_homing();
            self.order(CycleCommand::Stop);
        }
    }

    /// Takes in what has come since the last time, and goes on with what is under way.
    pub(crate) fn tick(
        &mut self,
        now_ns: u64,
        views: &mut Consumer<CycleView>,
        events: &mut Consumer<CycleEvent>,
        answers: &mut Consumer<Feedback>,
        mut observe: impl FnMut(&CycleView),
    ) {
        // Events first: the view of their cycle comes after them.
        while let Ok(event) = events.pop() {
            self.inbox.push_back(event);
        }
        while let Ok(view) = views.pop() {
            observe(&view);
            self.view = view;
        }
        while self
            .inbox
            .front()
            .is_some_and(|event| event.sequence() <= self.view.setpoint.sequence)
        {
            if let Some(event) = self.inbox.pop_front() {
                self.hear(event);
            }
        }
        while let Ok(mut feedback) = answers.pop() {
            // What cannot be true is neither shown nor homed by. The cycle's watch tells of it.
            if self.bounds.check(now_ns, &feedback).is_err() {
                continue;
            }
            if let Some(shift) = &self.view.shift {
                let indexed = self.index_axis;
                feedback.index_position -= indexed.map_or(0.0, |axis| shift[axis]);
                // As of the newest setpoint, a few periods before the feedback: what the correction changes meanwhile is as much
                // smaller than that way as errors of a machine are than its travel.
                for (position, shift) in feedback.position.iter_mut().zip(shift.iter()) {
                    *position -= shift;
                }
            }
            self.feedback = Some(feedback);
            self.watch_absolute(AxisMask::from_bits(feedback.absolute_mask));
            if self.view.datum == feedback.datum && self.view.datum >= self.datum {
                self.step_homing(&HomingSample {
                    time_ns: feedback.time_ns,
                    position: Axes::from(feedback.position),
                    switches: AxisMask::from_bits(feedback.home_switch_mask),
                    absolute: AxisMask::from_bits(feedback.absolute_mask),
                    index_request: feedback.index_request,
                    index_position: (!feedback.index_position.is_nan()).then_some(feedback.index_position),
                });
            }
        }
        let is_powered = self.view.power == PowerRequest::On;
        let are_ready = matches!(self.view.presence, Presence::Operational | Presence::Absent);
        self.desk.enable(is_powered && are_ready, now_ns);
        let is_at_rest = matches!(self.view.setpoint.state, State::Held | State::ProgramStop);
        self.tally.see(self.view.setpoint.sequence, is_at_rest);
        self.follow_program();
        self.follow_handwheel();
        if let Some(text) = self.way.as_ref().and_then(|way| way.try_recv().ok()) {
            self.way = None;
            // Who has stopped meanwhile needs it no more.
            if matches!(self.job, Job::Program(_)) {
                self.message = text;
            }
        }
        if let Some(objection) = self.checking.as_mut().and_then(Checking::objection) {
            self.message = objection;
        }
    }

    pub(super) fn hear(&mut self, event: CycleEvent) {
        match event {
            CycleEvent::Applied { id, sequence } => self.applied(id, sequence),
            CycleEvent::Spent(schedule) => drop(schedule),
            CycleEvent::EstopChain { sequence } => {
                let alarm = Alarm::EmergencyStopChain;
                self.raise(sequence, alarm, alarm.sentence().to_owned());
                self.desk.fall_into_estop();
                self.break_off(JobResult::Fault);
            }
            CycleEvent::Returned(work) => {
                drop(work);
                // A turn that was not reported by now came too late.
                if let Job::Jog { steered, .. } = &mut self.job {
                    steered.turn = None;
                }
            }
            CycleEvent::Ended { result, work, .. } => {
                drop(work);
                self.motion_ended(result);
            }
            CycleEvent::Misplaced { sequence, work } => {
                let is_planned = matches!(work, ActiveJob::Follow(_));
                drop(work);
                if !self.desk.has_latched_alarm() {
                    self.raise(sequence, Alarm::Handover, Alarm::Handover.sentence().to_owned());
                }
                match &mut self.job {
                    Job::Program(run) if is_planned => run.ended = Some(JobResult::Fault),
                    _ => self.end_job(JobResult::Fault),
                }
            }
            CycleEvent::Guard { sequence, violation } => {
                let text = format!(
                    "the guard refused a setpoint: {violation}; the machine was stopped. Please report it with the trace"
                );
                self.raise(sequence, Alarm::Guard, text);
            }
            CycleEvent::PlannerGone { sequence } => {
                self.raise(sequence, Alarm::Planner, Alarm::Planner.sentence().to_owned());
            }
            CycleEvent::Turning { sequence, reason } => {
                self.raise(sequence, turning_alarm(&reason), reason.text());
            }
            CycleEvent::Spindle { sequence, spindle } => {
                let text = format!("spindle {spindle}: {}", Alarm::Spindle.sentence());
                self.raise(sequence, Alarm::Spindle, text);
            }
            CycleEvent::Late { sequence } => {
                self.raise(sequence, Alarm::Lateness, Alarm::Lateness.sentence().to_owned());
            }
            CycleEvent::Drive { sequence, alarm } => {
                let known = Alarm::from_number(alarm.number()).unwrap_or(Alarm::DriveFault);
                self.raise(sequence, known, alarm.to_string());
                self.desk.drop_power();
                self.switch_off_at_rest();
                self.give_up_waiting(JobResult::Fault);
                self.cancel_homing();
            }
            CycleEvent::ReferenceLost { sequence, axes } => self.lose_reference(sequence, axes),
        }
    }

    pub(super) fn applied(&mut self, id: u64, sequence: u64) {
        if let Some(recorder) = &self.recorder {
            self.notes.applied(recorder, id, sequence);
        }
        while self.sent.front().is_some_and(|sent| sent.id <= id) {
            if let Some(sent) = self.sent.pop_front()
                && sent.id == id
            {
                self.record_at(
                    sequence,
                    ExternalEventKind::Command,
                    sent.code,
                    sent.text,
                    sent.value,
                );
            }
        }
        let steered = match &mut self.job {
            Job::Jog { steered, .. }
            | Job::Homing {
                steered: Some(steered),
                ..
            } => steered,
            _ => return,
        };
        if steered.order == id {
            steered.begin = Some(sequence);
        } else if let Some((turn, steering)) = steered.turn.take_if(|(turn, _)| *turn == id) {
            let _same = turn;
            steered.steering = steering;
            steered.begin = Some(sequence);
        }
    }

    pub(super) fn motion_ended(&mut self, result: JobResult) {
        match &mut self.job {
            Job::None => {}
            Job::Program(run) => {
                run.planning.abandon();
                run.ended = Some(result);
                self.cancel_command();
            }
            Job::Jog { .. } => {
                if result != JobResult::Done {
                    self.rest_handwheel();
                }
                self.end_job(result);
            }
            Job::Homing {
                steered, cancelled, ..
            } => {
                *steered = None;
                if *cancelled || result == JobResult::Fault {
                    let result = if result == JobResult::Fault {
                        result
                    } else {
                        JobResult::Stopped
                    };
                    self.end_job(result);
                }
            }
        }
    }

    pub(super) fn end_job(&mut self, result: JobResult) {
        if matches!(self.job, Job::Homing { .. }) {
            self.order(CycleCommand::ExpectSwitches(AxisMask::NONE));
            // Back to the travel as it is.
            self.relocate(self.view.setpoint.position, false);
        }
        self.judge_change();
        self.tally.end(result == JobResult::Done);
        // A program that did not come to its end has not switched off what it had on.
        let is_broken_off = matches!(self.job, Job::Program(_)) && result != JobResult::Done;
        if is_broken_off || result == JobResult::Fault {
            self.switch_periphery_off();
        }
        self.job = Job::None;
        (self.hold, self.stopping) = (false, false);
        self.desk.job_ends(result);
    }

    pub(crate) fn present(&self) -> AxisMask {
        self.present
    }
}

//! The control thread's side of a served machine: commands carried out, jobs followed, faults told.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;

use evolvent_bus::{ControlAnswer, ControlRequest, Feedback, Payload};
use evolvent_control::{
    Activity, Alarm, Command, CommandCode, DeadMan, Desk, Facts, Homing, HomingAction, HomingAxis,
    HomingSample, JobResult, JogCommand, RawCommand, Refusal, Verdict,
};
use evolvent_drive::{PowerRequest, Presence};
use evolvent_machine::Limits;
use evolvent_motion::{State, Steering};
use evolvent_path::{AXES, Axes, AxisLetter};
use evolvent_transfer::AxesState;
use rtrb::{Consumer, Producer};

use super::jobs::{Planning, ProgramJob, is_short};
use super::jog::{limits_here, steering, target};
use super::keep::Keep;
use super::modes::{After, Modes, foresee};
use super::orders::{CycleEvent, CycleView, Order, What, Work};
use super::track::Track;
use crate::feeder::{FeederNews, Outside, OutsideKind, ProgramError, StopKind, check};
use crate::job::Setup;

/// Time from asking for a turn of a jog to where it counts, ns.
const TURN_LEAD_NS: u64 = 12_000_000;
/// A steered motion that needs no dead-man.
const FOR_EVER: u64 = u64::MAX;

/// A program or a block of MDI.
struct ProgramRun {
    planning: Planning,
    /// How the cycle has ended it.
    ended: Option<JobResult>,
    /// What a block of MDI leaves when it is done.
    after: Option<After>,
    /// Single step of a plan that was made without it: hold once this block is behind.
    step_behind: Option<u32>,
    /// The program stop that is waited at has been looked at.
    stop_seen: bool,
}

/// A steered motion: `t` of setpoint `n` is `(n + 1 - begin)` periods.
struct Steered {
    steering: Steering,
    order: u64,
    begin: Option<u64>,
    /// A change that is under way: its order, and how often it was tried.
    turn: Option<(u64, Steering, JogCommand)>,
    stopping: bool,
    target: Axes,
}

enum Job {
    None,
    Program(Box<ProgramRun>),
    Jog {
        steered: Box<Steered>,
        held: Option<DeadMan>,
    },
    Homing {
        homing: Homing,
        steered: Option<Box<Steered>>,
        cancelled: bool,
    },
}

/// A command on its way to the cycle.
struct Sent {
    id: u64,
    code: u32,
    text: String,
    value: Option<f64>,
}

/// The operator's side of one machine.
pub(crate) struct Operator {
    pub(crate) setup: Setup,
    pub(crate) desk: Desk,
    pub(crate) keep: Keep,
    pub(crate) modes: Modes,
    pub(crate) message: String,
    pub(crate) track: Track,
    pub(crate) view: CycleView,
    pub(crate) feedback: Option<Feedback>,
    folder: PathBuf,
    limits: Limits,
    present: u32,
    orders: Producer<Order>,
    next_id: u64,
    sent: VecDeque<Sent>,
    recorder: Option<Sender<FeederNews>>,
    single_step: Arc<AtomicBool>,
    /// Numbers of the next block and action.
    numbers: (u32, u32),
    job: Job,
    hold: bool,
    ending: bool,
    /// Machine coordinates of the drives' first datum, less those of now.
    pub(crate) home_offset: Axes,
    malformed: u64,
    /// Events of cycles whose view has not come.
    inbox: VecDeque<CycleEvent>,
    /// The datum that the last renaming has led to.
    datum: u64,
}

/// What the operator begins with.
pub(crate) struct Beginning {
    pub setup: Setup,
    pub keep: Keep,
    pub folder: PathBuf,
    pub orders: Producer<Order>,
    pub recorder: Option<Sender<FeederNews>>,
    pub view: CycleView,
}

impl Operator {
    /// Stands at its desk.
    ///
    /// # Errors
    /// What was kept of parameters does not fit the machine.
    pub(crate) fn new(beginning: Beginning) -> Result<Self, String> {
        let Beginning {
            setup,
            keep,
            folder,
            orders,
            recorder,
            view,
        } = beginning;
        let machine = &setup.machine;
        let present = machine
            .axes
            .iter()
            .fold(0, |mask, axis| mask | 1 << axis.letter.index());
        let to_home = machine
            .homing
            .iter()
            .fold(0_u32, |mask, axis| mask | 1 << axis.axis.index());
        let limits = machine.limits();
        let mut desk = Desk::default();
        // Axes without a switch stand where the machine file says, or where their drives say.
        desk.set_homed(present & !to_home);
        for complaint in &keep.complaints {
            desk.raise(Alarm::NotRead, complaint.clone());
        }
        let mut operator = Self {
            modes: Modes::at_start(&setup.interpreter_settings()).map_err(|error| error.to_string())?,
            setup,
            desk,
            keep,
            message: String::new(),
            track: Track::default(),
            view,
            feedback: None,
            folder,
            limits,
            present,
            orders,
            next_id: 0,
            sent: VecDeque::new(),
            recorder,
            single_step: Arc::default(),
            numbers: (0, 0),
            job: Job::None,
            hold: false,
            ending: false,
            home_offset: Axes::zeros(),
            malformed: 0,
            inbox: VecDeque::new(),
            datum: 0,
        };
        operator.refresh_modes();
        operator.relocate(operator.view.setpoint.position, false);
        Ok(operator)
    }

    /// The setup of a job that begins here and now.
    fn setup_here(&self) -> Setup {
        let mut setup = self.setup.clone();
        setup.memory = self.keep.memory.clone();
        setup.place = Some(self.view.setpoint.position);
        setup.tool = self.keep.tool;
        setup.block_delete = self.desk.is_block_delete();
        setup.rapid_override = self.desk.overrides()[1];
        setup
    }

    fn kept(&self) -> evolvent_gcode::KeptParameters {
        self.keep.memory.kept.clone().unwrap_or_default()
    }

    /// Works the modes out again: after offsets or tools were changed from outside.
    fn refresh_modes(&mut self) {
        let settings = self.setup_here().interpreter_settings();
        if let Ok(after) = foresee(&self.modes.preamble(), &settings, &self.kept()) {
            self.modes = after.modes;
        }
    }

    /// Judges a request and carries it out.
    pub(crate) fn answer(&mut self, request: &ControlRequest, now_ns: u64) -> ControlAnswer {
        let mut answer = ControlAnswer {
            client: request.client,
            serial: request.serial,
            command: request.command,
            sequence: self.view.setpoint.sequence,
            ..ControlAnswer::default()
        };
        let refuse = |answer: &mut ControlAnswer, verdict: Verdict, refusal: &Refusal| {
            answer.verdict = verdict as u32;
            answer.alarm = refusal.alarm.number();
            answer.set_text(&refusal.text);
        };
        if !request.is_compatible() {
            self.malformed += 1;
            refuse(&mut answer, Verdict::Rejected, &Alarm::Malformed.into());
            return answer;
        }
        let raw = RawCommand {
            command: request.command,
            axes_mask: request.axes_mask,
            index: request.index,
            amount: request.amount,
            values: request.values,
            text: request.text(),
        };
        let facts = Facts {
            present: self.present,
            is_held: self.is_held(),
            is_ending: self.ending,
        };
        let considered = self.desk.consider(request.client, request.serial, &raw, &facts);
        let carried_out = considered.and_then(|command| {
            self.carry_out(&command, request.client, now_ns)
                .map_err(|refusal| self.desk.refuse(refusal))
                .map(|job| (command, job))
        });
        match carried_out {
            Ok((command, job)) => {
                self.desk.commit(&command, now_ns, true);
                answer.job = job;
            }
            Err((verdict, refusal)) => refuse(&mut answer, verdict, &refusal),
        }
        answer
    }

    /// Requests of another version or size so far.
    pub(crate) fn malformed(&self) -> u64 {
        self.malformed
    }

    fn is_held(&self) -> bool {
        let state = self.view.setpoint.state;
        self.hold || matches!(state, State::Holding | State::Held | State::ProgramStop)
    }

    /// Whether the feed is held.
    pub(crate) fn is_holding(&self) -> bool {
        self.hold
    }

    /// Does what a command says; the number of the job that it begins, or 0.
    fn carry_out(&mut self, command: &Command, client: u64, now_ns: u64) -> Result<u64, Refusal> {
        let mut job = 0;
        match command {
            Command::Estop => {
                self.give_up_waiting(JobResult::Stopped);
                self.cancel_homing();
                self.send(What::Emergency, command);
                return Ok(0);
            }
            Command::On => {
                // Where the drives are is where the core stands: the cycle sees to it without power.
                self.send(What::Power(PowerRequest::On), command);
                return Ok(0);
            }
            Command::Off => {
                self.send(What::Power(PowerRequest::Off), command);
                return Ok(0);
            }
            Command::Load(file) => self.load(Path::new(file))?,
            Command::Start(line) => job = self.start(*line)?,
            Command::Hold => {
                self.hold = true;
                self.send(What::Hold, command);
                return Ok(0);
            }
            Command::Resume => {
                self.resume(command);
                return Ok(0);
            }
            Command::Step => {
                if let Job::Program(run) = &mut self.job {
                    run.step_behind = Some(self.view.setpoint.block);
                    self.single_step.store(true, Ordering::Relaxed);
                    self.resume(command);
                    return Ok(0);
                }
                self.single_step.store(true, Ordering::Relaxed);
                job = self.start(0)?;
            }
            Command::SingleStep(on) => {
                self.single_step.store(*on, Ordering::Relaxed);
                if let Job::Program(run) = &mut self.job {
                    run.step_behind = on.then_some(self.view.setpoint.block);
                }
            }
            Command::Stop => {
                self.stop(command);
                return Ok(0);
            }
            Command::FeedOverride(ratio) => {
                self.send(What::Override(*ratio), command);
                return Ok(0);
            }
            Command::Mdi(text) => job = self.mdi(text)?,
            Command::Jog(jog) => job = self.jog(jog, client, now_ns, command)?,
            Command::JogKeep => {
                self.keep_jogging(client, now_ns);
                return Ok(0);
            }
            Command::JogStop => {
                if let Job::Jog { steered, .. } = &mut self.job {
                    steered.stopping = true;
                    self.send(What::Stop, command);
                    return Ok(0);
                }
            }
            Command::Home(mask) => job = self.home(*mask)?,
            Command::WorkOffset {
                system,
                axes_mask,
                values,
            } => self.set_offset(*system, |index, kept| {
                merged(&kept.work_offset(index), values, *axes_mask)
            })?,
            Command::TouchOff {
                system,
                axes_mask,
                values,
            } => {
                let place = self.view.setpoint.position - self.modes.modal.tool_offset - self.g92();
                self.set_offset(*system, |index, kept| {
                    merged(&kept.work_offset(index), &(place - values), *axes_mask)
                })?;
            }
            Command::Tool(entry) => {
                self.keep.set_tool(entry);
                self.save()?;
                self.refresh_modes();
            }
            Command::ReloadTools => {
                self.keep
                    .reload_tools()
                    .map_err(|error| Refusal::new(Alarm::File, error.to_string()))?;
                self.refresh_modes();
            }
            Command::Reset => {
                let settings = self.setup_here().interpreter_settings();
                if let Ok(modes) = Modes::at_start(&settings) {
                    self.modes = modes;
                }
                self.message.clear();
                self.send(What::Clear, command);
                return Ok(0);
            }
            Command::ClearAlarms => {
                self.message.clear();
                self.send(What::Clear, command);
                return Ok(0);
            }
            Command::EstopReset
            | Command::SetMode(_)
            | Command::OptionalStop(_)
            | Command::BlockDelete(_)
            | Command::RapidOverride(_)
            | Command::SpindleOverride(_) => {}
        }
        self.record(
            OutsideKind::Command,
            code_of(command),
            told(command),
            value_of(command),
        );
        Ok(job)
    }

    // --- orders and the trace

    fn order(&mut self, what: What) -> u64 {
        self.next_id += 1;
        let id = self.next_id;
        // The queue holds more than can be asked for between two cycles; a cycle that takes none has ended.
        let _full = self.orders.push(Order { id, what });
        id
    }

    /// An order that is recorded where it takes effect.
    fn send(&mut self, what: What, command: &Command) -> u64 {
        let id = self.order(what);
        self.sent.push_back(Sent {
            id,
            code: code_of(command),
            text: told(command),
            value: value_of(command),
        });
        id
    }

    /// Records something that took effect now.
    fn record(&mut self, kind: OutsideKind, code: u32, text: String, value: Option<f64>) {
        let sequence = self.view.setpoint.sequence;
        self.record_at(sequence, kind, code, text, value);
    }

    fn record_at(&mut self, sequence: u64, kind: OutsideKind, code: u32, text: String, value: Option<f64>) {
        if let Some(recorder) = &self.recorder {
            let outside = Outside {
                sequence,
                kind,
                code,
                text,
                value,
            };
            let _gone = recorder.send(FeederNews::Outside(outside));
        }
    }

    fn raise(&mut self, sequence: u64, alarm: Alarm, text: String) {
        let kind = match alarm.kind() {
            evolvent_control::AlarmKind::Warning => OutsideKind::Warning,
            _ => OutsideKind::Alarm,
        };
        self.record_at(sequence, kind, alarm.number(), text.clone(), None);
        self.desk.raise(alarm, text);
    }

    // --- programs and MDI

    fn load(&mut self, file: &Path) -> Result<(), Refusal> {
        let is_file = file.metadata().map(|facts| facts.is_file());
        let readable = is_file.and_then(|is_file| std::fs::File::open(file).map(|_| is_file));
        match readable {
            Ok(true) => {}
            Ok(false) => {
                let text = format!("{}: is no file; name a part program", file.display());
                return Err(Refusal::new(Alarm::File, text));
            }
            Err(error) => {
                let text = format!("{}: {error}; name a readable part program", file.display());
                return Err(Refusal::new(Alarm::File, text));
            }
        }
        if is_short(file) {
            self.check(file, 0)?;
        }
        Ok(())
    }

    /// What program text and machine have against a program.
    fn check(&self, file: &Path, lines_before: u32) -> Result<(), Refusal> {
        let found = check(file, &self.setup_here(), 1)
            .map_err(|error| Refusal::new(Alarm::File, format!("{}: {error}", file.display())))?;
        match found.first() {
            None => Ok(()),
            Some(first) => {
                let alarm = if first.code == evolvent_gcode::Code::BeyondTravel {
                    Alarm::SoftLimit
                } else {
                    Alarm::BadProgram
                };
                Err(Refusal::new(alarm, sentence(first, lines_before)))
            }
        }
    }

    fn start(&mut self, line: u32) -> Result<u64, Refusal> {
        let Some(file) = self.desk.program().map(PathBuf::from) else {
            return Err(Alarm::NoProgram.into());
        };
        let mut setup = self.setup_here();
        setup.start_line = (line > 1).then_some(line);
        self.single_step.store(
            self.desk.is_single_step() || self.single_step.load(Ordering::Relaxed),
            Ordering::Relaxed,
        );
        self.plan(file, setup, None, Activity::Program)
    }

    fn mdi(&mut self, text: &str) -> Result<u64, Refusal> {
        let preamble = self.modes.preamble();
        let lines = preamble.lines().count() as u32;
        let whole = format!("{preamble}{text}\n");
        let setup = self.setup_here();
        let after = foresee(&whole, &setup.interpreter_settings(), &self.kept())
            .map_err(|error| Refusal::new(Alarm::BadProgram, sentence(&error, lines)))?;
        let file = self.folder.join("mdi.ngc");
        std::fs::create_dir_all(&self.folder)
            .and_then(|()| std::fs::write(&file, &whole))
            .map_err(|error| Refusal::new(Alarm::File, format!("{}: {error}", file.display())))?;
        self.check(&file, lines)?;
        self.single_step.store(false, Ordering::Relaxed);
        self.plan(file, setup, Some(after), Activity::Mdi)
    }

    fn plan(
        &mut self,
        file: PathBuf,
        setup: Setup,
        after: Option<After>,
        activity: Activity,
    ) -> Result<u64, Refusal> {
        if let Some(recorder) = &self.recorder {
            let _gone = recorder.send(FeederNews::File(self.numbers.0, file.clone()));
        }
        let planning = Planning::start(ProgramJob {
            file,
            setup,
            feed_override: self.desk.overrides()[0],
            optional_stop: self.desk.is_optional_stop(),
            single_step: Arc::clone(&self.single_step),
            numbered_from: self.numbers,
            recorder: self.recorder.clone(),
        })
        .map_err(|error| Refusal::new(Alarm::Planner, format!("no thread for the planner: {error}")))?;
        self.track = Track::default();
        self.hold = false;
        self.job = Job::Program(Box::new(ProgramRun {
            planning,
            ended: None,
            after,
            step_behind: None,
            stop_seen: false,
        }));
        Ok(self.desk.job_begins(activity))
    }

    fn resume(&mut self, command: &Command) {
        self.hold = false;
        if let Job::Program(run) = &mut self.job {
            run.stop_seen = false;
        }
        self.send(What::Resume, command);
    }

    fn stop(&mut self, command: &Command) {
        self.give_up_waiting(JobResult::Stopped);
        self.cancel_homing();
        self.send(What::Stop, command);
    }

    /// A job that the cycle has not taken up yet is over at once.
    fn give_up_waiting(&mut self, result: JobResult) {
        if let Job::Program(run) = &mut self.job
            && run.planning.is_waiting()
        {
            run.planning.abandon();
            run.ended = Some(result);
        }
    }

    // --- jog

    /// Where the axes will be with setpoint `sequence`, if nothing intervenes.
    fn foreseen(&self, steered: &Steered, sequence: u64) -> Option<AxesState> {
        let periods = sequence + 1 - steered.begin?;
        let time = periods as f64 * self.setup.period_ns as f64 * 1e-9;
        let point = steered.steering.transfer().at(time);
        Some(AxesState {
            position: point.position,
            velocity: point.velocity,
            acceleration: point.acceleration,
        })
    }

    fn jog(&mut self, jog: &JogCommand, client: u64, now_ns: u64, command: &Command) -> Result<u64, Refusal> {
        let here = self.view.setpoint.position;
        let limits = limits_here(&self.limits, &here, self.desk.homed());
        let held = jog.distance.is_none().then(|| DeadMan::held(client, now_ns));
        let until = held.map_or(FOR_EVER, DeadMan::until_ns);
        let after = self.view.setpoint.sequence + TURN_LEAD_NS.div_ceil(self.setup.period_ns).max(4);
        if let Job::Jog { steered, .. } = &self.job {
            let Some(from) = self.foreseen(steered, after).filter(|_| !steered.stopping) else {
                return Err(Refusal::new(
                    Alarm::Busy,
                    "the last jog is coming to rest; jog again then",
                ));
            };
            // An increment adds to the one under way.
            let base = if jog.distance.is_some() {
                steered.target
            } else {
                from.position
            };
            let to = target(jog, &base, &limits)?;
            let turned = steering(&limits, &from, &to, jog.axes_mask, jog.speed)?;
            let boxed = Box::new(turned);
            let id = self.send(
                What::Turn {
                    after,
                    steering: boxed,
                },
                command,
            );
            self.order(What::Keep(until));
            if let Job::Jog { steered, held: old } = &mut self.job {
                steered.turn = Some((id, turned, *jog));
                steered.target = to;
                *old = held;
            }
            return Ok(self.desk.job());
        }
        let to = target(jog, &here, &limits)?;
        let steering = steering(&limits, &AxesState::at_rest(here), &to, jog.axes_mask, jog.speed)?;
        let steered = self.steer(steering, to, until, Some(command));
        self.job = Job::Jog { steered, held };
        Ok(self.desk.job_begins(Activity::Jog))
    }

    /// Begins a steered motion at rest.
    fn steer(
        &mut self,
        steering: Steering,
        target: Axes,
        until_ns: u64,
        command: Option<&Command>,
    ) -> Box<Steered> {
        self.order(What::Keep(until_ns));
        let what = What::Steer(Box::new(steering));
        let order = match command {
            Some(command) => self.send(what, command),
            None => self.order(what),
        };
        Box::new(Steered {
            steering,
            order,
            begin: None,
            turn: None,
            stopping: false,
            target,
        })
    }

    fn keep_jogging(&mut self, client: u64, now_ns: u64) {
        let Job::Jog { held: Some(held), .. } = &mut self.job else {
            return;
        };
        if held.renew(client, now_ns) {
            let until = held.until_ns();
            self.order(What::Keep(until));
        }
    }

    // --- homing

    fn home(&mut self, mask: u32) -> Result<u64, Refusal> {
        let machine = &self.setup.machine;
        let axes: Vec<HomingAxis> = machine
            .homing
            .iter()
            .filter(|homing| mask >> homing.axis.index() & 1 == 1)
            .map(|homing| {
                let i = homing.axis.index();
                HomingAxis {
                    axis: homing.axis,
                    order: homing.order,
                    direction: if homing.negative { -1.0 } else { 1.0 },
                    search_speed: homing.search_speed,
                    latch_speed: homing.latch_speed,
                    switch_position: homing.switch_position,
                    travel: self.limits.travel_max[i] - self.limits.travel_min[i],
                    home: self.limits.home[i],
                }
            })
            .collect();
        if !axes.is_empty() && self.view.presence != Presence::Operational {
            return Err(Refusal::new(
                Alarm::NoFeedback,
                "no bridge answers, so there is no switch to home with; start the bridge, then switch on",
            ));
        }
        // What is homed anew is not homed before it is done.
        let unknown = axes
            .iter()
            .fold(0_u32, |mask, axis| mask | 1 << axis.axis.index());
        self.desk.set_homed(self.desk.homed() & !unknown);
        self.relocate(self.view.setpoint.position, false);
        self.order(What::ExpectSwitches(unknown));
        let number = self.desk.job_begins(Activity::Homing);
        if axes.is_empty() {
            self.desk.job_ends(JobResult::Done);
        } else {
            self.job = Job::Homing {
                homing: Homing::new(axes),
                steered: None,
                cancelled: false,
            };
        }
        Ok(number)
    }

    fn cancel_homing(&mut self) {
        if let Job::Homing {
            steered, cancelled, ..
        } = &mut self.job
        {
            *cancelled = true;
            if steered.is_none() {
                self.end_job(JobResult::Stopped);
            }
        }
    }

    /// The axes stand at `position`, by names of the present or a new datum.
    fn relocate(&mut self, position: Axes, renames: bool) {
        let limits = limits_here(&self.limits, &position, self.desk.homed());
        self.order(What::Relocate {
            position,
            limits,
            renames,
        });
    }

    fn step_homing(&mut self, sample: &HomingSample) {
        let here = self.view.setpoint.position;
        let at_rest = self.view.at_rest;
        let Job::Homing {
            homing,
            steered,
            cancelled: false,
        } = &mut self.job
        else {
            return;
        };
        let action = homing.step(sample, steered.is_none() && at_rest);
        match action {
            HomingAction::Wait => {}
            HomingAction::Move {
                axis,
                distance,
                speed,
            } => self.homing_move(axis, here[axis.index()] + distance, speed),
            HomingAction::Home {
                axis,
                position,
                speed,
            } => self.homing_move(axis, position, speed),
            HomingAction::Stop => {
                self.order(What::Stop);
            }
            HomingAction::SetZero {
                axis,
                position,
                coordinate,
            } => {
                let i = axis.index();
                let shift = coordinate - position;
                let mut renamed = here;
                renamed[i] += shift;
                self.home_offset[i] -= shift;
                self.datum = self.view.datum + 1;
                self.view.setpoint.position = renamed;
                self.desk.set_homed(self.desk.homed() | 1 << i);
                self.relocate(renamed, true);
                let text = format!("axis {}: machine zero set, shifted by {shift:.6}", axis.letter());
                self.record(OutsideKind::Command, CommandCode::Home as u32, text, Some(shift));
            }
            HomingAction::Done => self.end_job(JobResult::Done),
            HomingAction::Fail(refusal) => {
                let sequence = self.view.setpoint.sequence;
                self.raise(sequence, refusal.alarm, refusal.text);
                self.end_job(JobResult::Fault);
            }
        }
    }

    fn homing_move(&mut self, axis: AxisLetter, to: f64, speed: f64) {
        let here = self.view.setpoint.position;
        let limits = limits_here(&self.limits, &here, self.desk.homed());
        let i = axis.index();
        let mut target = here;
        target[i] = to.clamp(limits.travel_min[i], limits.travel_max[i]);
        let solved = steering(&limits, &AxesState::at_rest(here), &target, 1 << i, Some(speed));
        match solved {
            Ok(solved) => {
                let begun = self.steer(solved, target, FOR_EVER, None);
                if let Job::Homing { steered, .. } = &mut self.job {
                    *steered = Some(begun);
                }
            }
            Err(refusal) => {
                let sequence = self.view.setpoint.sequence;
                self.raise(sequence, Alarm::HomeSwitchMissing, refusal.text);
                self.end_job(JobResult::Fault);
            }
        }
    }

    // --- offsets and tools

    fn g92(&self) -> Axes {
        let kept = self.kept();
        self.modes.modal.work_offset - kept.work_offset(kept.active_offset())
    }

    fn set_offset(
        &mut self,
        system: u32,
        offset: impl FnOnce(usize, &evolvent_gcode::KeptParameters) -> Axes,
    ) -> Result<(), Refusal> {
        let mut kept = self.kept();
        let index = match system {
            0 => kept.active_offset(),
            system => system as usize - 1,
        };
        let offset = offset(index, &kept);
        kept.set_work_offset(index, &offset);
        self.keep.memory.kept = Some(kept);
        self.save()?;
        self.refresh_modes();
        Ok(())
    }

    fn save(&mut self) -> Result<(), Refusal> {
        self.keep
            .save()
            .map_err(|error| Refusal::new(Alarm::File, error.to_string()))
    }

    // --- what happens

    /// The process is to end: everything comes to rest, and then the cycle ends.
    pub(crate) fn end(&mut self) {
        if !self.ending {
            self.ending = true;
            self.give_up_waiting(JobResult::Stopped);
            self.cancel_homing();
            self.order(What::End);
            self.record(
                OutsideKind::Command,
                0,
                "the core was told to end".to_owned(),
                None,
            );
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
        while let Ok(feedback) = answers.pop() {
            self.feedback = Some(feedback);
            if self.view.datum == feedback.datum && self.view.datum >= self.datum {
                self.step_homing(&HomingSample {
                    position: Axes::from(feedback.position),
                    switches: feedback.home_switch_mask,
                });
            }
        }
        let is_powered = self.view.power == PowerRequest::On;
        let are_ready = matches!(self.view.presence, Presence::Operational | Presence::Absent);
        self.desk.enable(is_powered && are_ready, now_ns);
        self.follow_program();
    }

    fn hear(&mut self, event: CycleEvent) {
        match event {
            CycleEvent::Applied { id, sequence } => self.applied(id, sequence),
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
                let is_planned = matches!(work, Work::Follow(_));
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
            CycleEvent::Late { sequence } => {
                self.raise(sequence, Alarm::Lateness, Alarm::Lateness.sentence().to_owned());
            }
            CycleEvent::Drive { sequence, alarm } => {
                let known = Alarm::from_number(alarm.number()).unwrap_or(Alarm::DriveFault);
                self.raise(sequence, known, alarm.to_string());
                self.desk.drop_power();
                self.give_up_waiting(JobResult::Fault);
                self.cancel_homing();
            }
        }
    }

    fn applied(&mut self, id: u64, sequence: u64) {
        while self.sent.front().is_some_and(|sent| sent.id <= id) {
            if let Some(sent) = self.sent.pop_front()
                && sent.id == id
            {
                self.record_at(sequence, OutsideKind::Command, sent.code, sent.text, sent.value);
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
        } else if let Some((turn, steering, _)) = steered.turn.take_if(|(turn, ..)| *turn == id) {
            let _same = turn;
            steered.steering = steering;
            steered.begin = Some(sequence);
        }
    }

    fn motion_ended(&mut self, result: JobResult) {
        match &mut self.job {
            Job::None => {}
            Job::Program(run) => {
                run.planning.abandon();
                run.ended = Some(result);
            }
            Job::Jog { .. } => self.end_job(result),
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

    fn end_job(&mut self, result: JobResult) {
        if matches!(self.job, Job::Homing { .. }) {
            self.order(What::ExpectSwitches(0));
            // Back to the travel as it is.
            self.relocate(self.view.setpoint.position, false);
        }
        self.job = Job::None;
        self.hold = false;
        self.desk.job_ends(result);
    }

    fn follow_program(&mut self) {
        let setpoint = self.view.setpoint;
        let Job::Program(run) = &mut self.job else { return };
        self.track.hear(&run.planning.news);
        let message = &mut self.message;
        if let Some(modal) = self.track.reach(&setpoint, |notice| {
            if notice.is_message {
                message.clone_from(&notice.text);
            }
        }) {
            self.modes.modal = modal;
            self.keep.tool = modal.tool;
        }
        if let Some(result) = run.ended {
            if let Some((report, planned)) = run.planning.take_result() {
                let after = run.after.take();
                self.numbers = (report.next_block, report.next_action);
                self.finish_program(result, planned, after);
            }
            return;
        }
        if let Some(job) = run.planning.take_if_ready() {
            self.order(What::Follow(job));
            return;
        }
        if setpoint.state == State::ProgramStop && !run.stop_seen {
            run.stop_seen = true;
            let kind = self.track.take_stop();
            if kind == StopKind::Step && !self.single_step.load(Ordering::Relaxed) {
                run.stop_seen = false;
                self.order(What::Resume);
            }
            return;
        }
        let Job::Program(run) = &mut self.job else { return };
        if run.stop_seen && setpoint.state != State::ProgramStop {
            run.stop_seen = false;
        }
        if run
            .step_behind
            .is_some_and(|block| setpoint.block > block && setpoint.state == State::Running)
        {
            run.step_behind = None;
            self.hold = true;
            self.order(What::Hold);
        }
    }

    fn finish_program(
        &mut self,
        result: JobResult,
        planned: Result<Option<crate::memory::ProgramMemory>, ProgramError>,
        after: Option<After>,
    ) {
        let sequence = self.view.setpoint.sequence;
        if let Some(modal) = self.track.finish()
            && result == JobResult::Done
        {
            self.modes.modal = modal;
            self.keep.tool = modal.tool;
        }
        match (result, planned, after) {
            (JobResult::Done, _, Some(after)) => {
                self.keep.tool = after.modes.modal.tool;
                self.keep.memory.kept = Some(after.kept);
                self.keep.memory.tools = after.tools.or_else(|| self.keep.memory.tools.take());
                self.modes = after.modes;
            }
            (JobResult::Done, Ok(Some(left)), None) => self.keep.memory = left,
            (JobResult::Failed, Err(error), _) => {
                let text = match &error {
                    ProgramError::Text { diagnostic, .. } => sentence(diagnostic, 0),
                    ProgramError::Read { .. } => error.to_string(),
                };
                self.raise(sequence, Alarm::Program, text);
            }
            _ => {}
        }
        if let Err(error) = self.keep.save() {
            self.raise(sequence, Alarm::NotKept, error.to_string());
        }
        self.refresh_modes();
        self.end_job(result);
    }

    pub(crate) fn present(&self) -> u32 {
        self.present
    }
}

fn merged(old: &Axes, new: &Axes, mask: u32) -> Axes {
    Axes::from_fn(|i, _| if mask >> i & 1 == 1 { new[i] } else { old[i] })
}

/// A diagnostic as one sentence with its line.
fn sentence(diagnostic: &evolvent_gcode::Diagnostic, lines_before: u32) -> String {
    let line = diagnostic.line.saturating_sub(lines_before);
    let mut text = format!(
        "line {line}: {}: {}",
        diagnostic.code.as_str(),
        diagnostic.message
    );
    if let Some(help) = &diagnostic.help {
        text.push_str("; ");
        text.push_str(help);
    }
    text
}

fn code_of(command: &Command) -> u32 {
    let code = match command {
        Command::Estop => CommandCode::Estop,
        Command::EstopReset => CommandCode::EstopReset,
        Command::On => CommandCode::On,
        Command::Off => CommandCode::Off,
        Command::SetMode(_) => CommandCode::Mode,
        Command::Load(_) => CommandCode::Load,
        Command::Start(_) => CommandCode::Start,
        Command::Hold => CommandCode::Hold,
        Command::Resume => CommandCode::Resume,
        Command::Step => CommandCode::Step,
        Command::Stop => CommandCode::Stop,
        Command::Reset => CommandCode::Reset,
        Command::SingleStep(_) => CommandCode::SingleStep,
        Command::OptionalStop(_) => CommandCode::OptionalStop,
        Command::BlockDelete(_) => CommandCode::BlockDelete,
        Command::FeedOverride(_) => CommandCode::FeedOverride,
        Command::RapidOverride(_) => CommandCode::RapidOverride,
        Command::SpindleOverride(_) => CommandCode::SpindleOverride,
        Command::Mdi(_) => CommandCode::Mdi,
        Command::Jog(_) => CommandCode::Jog,
        Command::JogKeep => CommandCode::JogKeep,
        Command::JogStop => CommandCode::JogStop,
        Command::Home(_) => CommandCode::Home,
        Command::WorkOffset { .. } => CommandCode::WorkOffset,
        Command::TouchOff { .. } => CommandCode::TouchOff,
        Command::Tool(_) | Command::ReloadTools => CommandCode::Tool,
        Command::ClearAlarms => CommandCode::ClearAlarms,
    };
    code as u32
}

fn value_of(command: &Command) -> Option<f64> {
    match command {
        Command::FeedOverride(ratio) | Command::RapidOverride(ratio) | Command::SpindleOverride(ratio) => {
            Some(*ratio)
        }
        _ => None,
    }
}

/// A command for the trace.
fn told(command: &Command) -> String {
    let letters = |mask: u32| -> String {
        (0..AXES)
            .filter(|i| mask >> i & 1 == 1)
            .map(|i| AxisLetter::ALL[i].letter())
            .collect()
    };
    let percent = |ratio: &f64| format!("{:.1} %", 100.0 * ratio);
    let on = |on: &bool| if *on { "on" } else { "off" };
    match command {
        Command::Estop => "emergency stop".to_owned(),
        Command::EstopReset => "emergency stop reset".to_owned(),
        Command::On => "on".to_owned(),
        Command::Off => "off".to_owned(),
        Command::SetMode(mode) => format!("mode {}", mode.name()),
        Command::Load(file) => format!("load {file}"),
        Command::Start(line) if *line > 1 => format!("start from line {line}"),
        Command::Start(_) => "start".to_owned(),
        Command::Hold => "hold".to_owned(),
        Command::Resume => "resume".to_owned(),
        Command::Step => "step".to_owned(),
        Command::Stop => "stop".to_owned(),
        Command::Reset => "reset".to_owned(),
        Command::SingleStep(state) => format!("single step {}", on(state)),
        Command::OptionalStop(state) => format!("optional stop {}", on(state)),
        Command::BlockDelete(state) => format!("block delete {}", on(state)),
        Command::FeedOverride(ratio) => format!("feed override {}", percent(ratio)),
        Command::RapidOverride(ratio) => format!("rapid override {}", percent(ratio)),
        Command::SpindleOverride(ratio) => format!("spindle override {}", percent(ratio)),
        Command::Mdi(text) => format!("MDI {text}"),
        Command::Jog(jog) => match &jog.distance {
            Some(_) => format!("jog {} by an increment", letters(jog.axes_mask)),
            None => format!("jog {}", letters(jog.axes_mask)),
        },
        Command::JogKeep => "jog goes on".to_owned(),
        Command::JogStop => "jog stop".to_owned(),
        Command::Home(mask) => format!("home {}", letters(*mask)),
        Command::WorkOffset {
            system, axes_mask, ..
        } => {
            format!("work offset {system} of {}", letters(*axes_mask))
        }
        Command::TouchOff {
            system, axes_mask, ..
        } => {
            format!("touch off {} in work offset {system}", letters(*axes_mask))
        }
        Command::Tool(entry) => format!("tool {} set", entry.number),
        Command::ReloadTools => "tool table read again".to_owned(),
        Command::ClearAlarms => "alarms cleared".to_owned(),
    }
}

//! The planner's thread: program text in, plan out.

mod threading;

use std::collections::{BTreeSet, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::time::Duration;

use evolvent_gcode::{Action, Command, Diagnostic, LogAction, Modal, Move, MoveKind, SpindleDirection};
use evolvent_machine::{AtSpeed, SignalKind, ToolChange};
use evolvent_motion::{
    ProbeMove, ProbeResult, ProbeVerdict, ProbingSender, ProcessCycle, ProcessSender, QueueClosed,
    ThreadingSender,
};
use evolvent_path::{Axes, AxisLetter, Curve};
use evolvent_planner::{PlanError, PlanSink, Step};
use evolvent_signals::{
    Awaited, Change, FeedLaw, InputWait, Moment as SignalMoment, OverrideSwitches, Scheduler, WaitMode,
};
use evolvent_trace::BlockKind;
use rtrb::Producer;

use crate::job::Setup;
use crate::log_file::{LogFiles, LogKind, log_objection};
use crate::memory::ProgramMemory;
use crate::news::{BlockPlan, FeederEvent, Moment, Notice, QueuedBlock, StopKind, UserCall, describe};
use crate::periphery::{
    Changer, Periphery, TOOL_CHANGE_CODE, change_begins, nobody_changes, tool_change_call, tool_request,
    waits_for,
};
use crate::probing::{complaint, objection, probing};
use crate::refusal::{ProgramError, about_line, about_line_with, at_origin, cannot_turn, explain};
use crate::shared::Controls;
use crate::signal_check::signal_objection;
use crate::source::Commands;
use crate::stages::Stages;
use crate::switches::{SwitchState, Switched, Switching};
use crate::threading::ThreadChain;
use crate::turning::turning;
use crate::turning_motion::TurningMotion;
use crate::user_code::UserCodes;

use threading::ThreadTrouble;

/// How long the planner sleeps where too many commands lie ahead.
const CARRIER_NAP: Duration = Duration::from_millis(5);

/// The same while the machine waits for an input.
const INPUT_NAP: Duration = Duration::from_micros(200);

/// The same while the turning cycles before are driven.
const TURNING_NAP: Duration = Duration::from_millis(1);

/// What the feeder knows at the end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FeedReport {
    /// Largest distance of blends from the programmed path.
    pub deviation_mm: f64,
    /// Seconds at the programmed feed, without dwells.
    pub planned_s: f64,
    /// Moves planned.
    pub moves: u64,
    /// Commands of the machine's own (M100 to M199) planned.
    pub user_commands: u64,
    /// Tool changes (M6 with another tool) planned.
    pub tool_changes: u64,
    /// Lines that begin with `/`: skipped, executed.
    pub block_delete_lines: (u64, u64),
    /// Numbers of the next block and action.
    pub next_block: u32,
    pub next_action: u32,
}

/// What came of a command for whose end the program may wait.
enum Waited {
    /// It is none.
    None,
    /// It is carried out.
    Over,
    /// Nobody drives any more.
    Gone,
}

/// Blocks that have been handed to the planner and not yet reported.
struct Open {
    block: u32,
    line: u32,
    kind: BlockKind,
    length_mm: f64,
}

/// A log file that cannot be written, with the cure.
fn no_log(message: String) -> (String, String) {
    let help = "see the folder of the log files, program.log_folder of the machine file";
    (message, help.to_owned())
}

/// Feeds one program.
pub(crate) struct Feeder<'a, S> {
    file: String,
    setup: &'a Setup,
    planner: Stages<S>,
    news: Vec<Sender<FeederEvent>>,
    with_blocks: bool,
    blocks: VecDeque<Open>,
    next_block: u32,
    actions: u32,
    moves: u64,
    /// For somebody who looks on block by block.
    onlooker: Option<Sender<FeederEvent>>,
    switches: SwitchState,
    switching: Switching,
    /// Number of the job that is told of where somebody switches.
    job: u32,
    /// Commands that have been read.
    commands: u64,
    last_line: u32,
    /// Line of what was planned last of all that moves, where anyone wants to hear of blocks: that of the end.
    end_line: u32,
    path_mm: f64,
    modal: Option<Modal>,
    user_commands: u64,
    tool_changes: u64,
    block_delete_lines: (u64, u64),
    /// Spindle, coolant and tool after what has been read.
    periphery: Periphery,
    /// Who else receives them, by the number of the action.
    periphery_listener: Option<Sender<(u32, Periphery)>>,
    /// The spindle was given a speed, and no feed has waited for it.
    awaits_speed: bool,
    /// Somebody confirms tool changes, or nobody needs to.
    confirms_tools: bool,
    /// Where the machine's own commands are carried out.
    codes: Option<UserCodes>,
    carrier: Option<ToCarrier>,
    /// The way of turning cycles to the cycle; none where nothing is driven.
    turnings: Option<ProcessSender>,
    /// The way of probing moves to the cycle; none where nothing is driven.
    probings: Option<ProbingSender>,
    /// The way of passes of threading to the cycle; none where nothing is driven.
    threadings: Option<ThreadingSender>,
    /// The pieces of the next pass so far.
    chain: ThreadChain,
    /// The way of outputs and waits to the cycle; none where nothing is driven.
    signals: Option<Scheduler>,
    /// Outputs that change with the next block (M62, M63, M67), and the line that has set them last.
    with_next_block: Change,
    with_next_line: u32,
    /// What the feed goes by, as scheduled last.
    feed_law: FeedLaw,
    /// A rapid has moved the tool along X since the spindle had the speed of its radius.
    has_left_radius: bool,
    /// The feed override counts for what is read, and so does the rapid override.
    override_counts: bool,
    /// Names of attached subroutines begin with this.
    subroutines: String,
    /// Files of subroutines that have been told of.
    files_told: usize,
    /// Files that the program writes, from the first one on.
    logs: Option<LogFiles>,
    /// Lines of which warnings were told.
    warned: BTreeSet<u32>,
}

/// Tells of the machine's own commands in a run: who carries them out, and the cycle, which waits there.
pub(crate) struct ToCarrier {
    pub calls: Sender<(u32, UserCall)>,
    pub stops: Producer<u32>,
    pub controls: Arc<Controls>,
}

impl<'a, S: PlanSink<Error = QueueClosed>> Feeder<'a, S> {
    /// `with_blocks`: whether anyone wants to hear of blocks.
    pub(crate) fn new(
        file: &Path,
        setup: &'a Setup,
        planner: Stages<S>,
        news: Vec<Sender<FeederEvent>>,
        with_blocks: bool,
        optional_stop: bool,
    ) -> Self {
        Self {
            file: file.display().to_string(),
            setup,
            planner,
            news,
            with_blocks,
            blocks: VecDeque::new(),
            next_block: 0,
            actions: 0,
            moves: 0,
            onlooker: None,
            switches: SwitchState {
                single_step: false,
                optional_stop,
                block_delete: setup.block_delete,
                rapid_override: setup.rapid_override,
            },
            switching: Switching::Fixed,
            job: 0,
            commands: 0,
            last_line: 0,
            end_line: 0,
            path_mm: 0.0,
            modal: None,
            user_commands: 0,
            tool_changes: 0,
            block_delete_lines: (0, 0),
            periphery: Periphery {
                outputs: setup.outputs,
                tool: setup.tool,
                ..Periphery::default()
            },
            awaits_speed: setup.outputs.direction != SpindleDirection::Stopped,
            periphery_listener: None,
            confirms_tools: true,
            codes: None,
            carrier: None,
            turnings: None,
            probings: None,
            threadings: None,
            chain: ThreadChain::default(),
            signals: None,
            with_next_block: Change::at(SignalMoment::Block(0)),
            with_next_line: 0,
            feed_law: FeedLaw::default(),
            has_left_radius: false,
            override_counts: true,
            subroutines: "subroutines/".to_owned(),
            files_told: 0,
            logs: None,
            warned: BTreeSet::new(),
        }
    }

    /// Tells of spindle, coolant and tool.
    pub(crate) fn periphery_to(mut self, listener: Option<Sender<(u32, Periphery)>>) -> Self {
        self.periphery_listener = listener;
        self
    }

    /// Nobody is there to confirm a tool change: one by the operator is an error of the program.
    pub(crate) fn unattended(mut self, unattended: bool) -> Self {
        self.confirms_tools = !unattended;
        self
    }

    /// Hands turning cycles on here.
    pub(crate) fn turning_by(mut self, turnings: Option<ProcessSender>) -> Self {
        self.turnings = turnings;
        self
    }

    /// Hands probing moves on here.
    pub(crate) fn probing_by(mut self, probings: Option<ProbingSender>) -> Self {
        self.probings = probings;
        self
    }

    /// Schedules outputs and waits here.
    pub(crate) fn signalling_by(mut self, signals: Option<Scheduler>) -> Self {
        self.signals = signals;
        self
    }

    /// Numbers blocks and actions from these on, so that they go on from job to job.
    pub(crate) fn numbered_from(mut self, block: u32, action: u32) -> Self {
        (self.next_block, self.actions) = (block, action);
        self
    }

    /// Attaches subroutines under names that begin so.
    pub(crate) fn attaching_to(mut self, folder: String) -> Self {
        self.subroutines = folder;
        self
    }

    /// Tells somebody of every block, of modes and of program stops.
    pub(crate) fn watched_by(mut self, onlooker: Sender<FeederEvent>) -> Self {
        self.onlooker = Some(onlooker);
        self
    }

    /// Begins with these switches, and minds what is switched in this job meanwhile.
    pub(crate) fn switched_by(mut self, switches: SwitchState, switching: Switching, job: u32) -> Self {
        (self.switches, self.switching, self.job) = (switches, switching, job);
        self
    }

    /// Commands of the machine's own are carried out; those that cannot be are errors of the program.
    pub(crate) fn executing(mut self, codes: UserCodes) -> Self {
        self.codes = Some(codes);
        self
    }

    /// Tells who carries them out.
    pub(crate) fn carried_out_by(mut self, carrier: ToCarrier) -> Self {
        self.carrier = Some(carrier);
        self
    }

    /// Plans the program to its end, or to its first error: the plan then ends at rest before it, and `failed` is
    /// called before its end is handed on.
    pub(crate) fn feed(
        mut self,
        program: &Path,
        failed: impl FnOnce(),
    ) -> (FeedReport, Result<Option<ProgramMemory>, ProgramError>) {
        let result = self.feed_lines(program);
        if result.is_err() {
            failed();
        }
        let line = self.end_line;
        // A consumer that has gone needs no end.
        let _gone = self.planner.finish(line);
        self.report_blocks(true);
        self.finish_logs();
        // Holds and overrides are answered as long as the program runs.
        self.planner.attend();
        let report = FeedReport {
            deviation_mm: self.planner.deviation_mm(),
            planned_s: self.planner.planned_s(),
            moves: self.moves,
            user_commands: self.user_commands,
            tool_changes: self.tool_changes,
            block_delete_lines: self.block_delete_lines,
            next_block: self.next_block,
            next_action: self.actions,
        };
        (report, result)
    }

    /// What a program that was read to its end leaves.
    fn feed_lines(&mut self, program: &Path) -> Result<Option<ProgramMemory>, ProgramError> {
        let mut commands = Commands::open(program, self.setup)?;
        if let Some(start) = commands.start() {
            let line = start.restart.line;
            let text = start.told();
            // Somebody who is there looks at the way before the machine takes it.
            if self.act(line, &text).is_err() || self.stop(line, StopKind::Program).is_err() {
                return Ok(None);
            }
        }
        let mut line = 0;
        loop {
            self.follow_switches(&mut commands, line);
            let next = commands.next();
            self.block_delete_lines = commands.block_delete_lines();
            let Some(command) = next else { break };
            self.commands += 1;
            self.tell_files(&commands);
            let command = command.map_err(|diagnostic| ProgramError::Text {
                file: self.file.clone(),
                diagnostic: Box::new(diagnostic),
            })?;
            line = command.line;
            if let Some(diagnostic) = self.objection_to(&command, program) {
                return Err(self.wrong(diagnostic));
            }
            match self.collect_thread(&command, program) {
                Ok(false) => {}
                Ok(true) => continue,
                Err(ThreadTrouble::Program(error)) => return Err(error),
                Err(ThreadTrouble::Gone) => break,
            }
            if let Action::Log(log) = &command.action {
                if let Some((message, help)) = self.log(log, line) {
                    return Err(self.refused(&command, program, message, help));
                }
                continue;
            }
            self.tell_modal(&commands);
            let is_feed = match &command.action {
                Action::Move(motion) => motion.kind == MoveKind::Feed,
                Action::Turning(_) => true,
                _ => false,
            };
            if is_feed && std::mem::take(&mut self.has_left_radius) && self.knows_speed() {
                // A command of its own, so that the wait is for the speed of this radius.
                let action = self.surface_action();
                match self.switch(&action, line) {
                    Ok(()) => {}
                    Err(PlanError::Sink(_gone)) => break,
                    Err(error) => {
                        return Err(self.wrong(at_origin(&command, program, |file, line| {
                            about_line(error.to_string(), file, line)
                        })));
                    }
                }
            }
            if is_feed && std::mem::take(&mut self.awaits_speed) {
                match self.await_speed(line) {
                    Ok(None) => {}
                    Ok(Some((message, help))) => {
                        return Err(self.refused(&command, program, message, help));
                    }
                    Err(_gone) => break,
                }
            }
            match self.wait_out(&command, &mut commands, program)? {
                Waited::None => {}
                Waited::Over => continue,
                Waited::Gone => break,
            }
            match self.execute(&command) {
                Ok(true) => {}
                Ok(false) => {
                    self.warn_of_outputs_without_move();
                    return Ok(Some(commands.left(&self.setup.memory)));
                }
                Err(PlanError::Sink(_)) => break,
                Err(error) => {
                    let diagnostic = match error {
                        // The planner is behind the line that is being read.
                        PlanError::NoMotion { .. } => explain(&error, program, command.line),
                        _ => at_origin(&command, program, |file, line| explain(&error, file, line)),
                    };
                    let diagnostic = Box::new(diagnostic);
                    return Err(ProgramError::Text {
                        file: self.file.clone(),
                        diagnostic,
                    });
                }
            }
            self.report_blocks(false);
        }
        Ok(None)
    }

    /// What the machine has against a command, whatever it stands at.
    fn objection_to(&self, command: &Command, program: &Path) -> Option<Diagnostic> {
        if let Some((message, help)) = signal_objection(&self.setup.machine.signals, &command.action) {
            return Some(at_origin(command, program, |file, line| {
                about_line_with(message, Some(help), file, line)
            }));
        }
        if let (Action::UserCommand { number, .. }, Some(codes)) = (&command.action, &self.codes)
            && let Some(objection) = codes.objection(*number)
        {
            return Some(at_origin(command, program, |file, line| {
                about_line(objection, file, line)
            }));
        }
        match command.action {
            Action::ChangeTool(tool) => self.objection_to_tool(tool, program, command),
            _ => None,
        }
    }

    /// Carries out a command for whose end the program waits.
    fn wait_out(
        &mut self,
        command: &Command,
        commands: &mut Commands,
        program: &Path,
    ) -> Result<Waited, ProgramError> {
        let line = command.line;
        if let Action::OrientSpindle {
            degrees, timeout_s, ..
        } = command.action
        {
            match self.orient(&command.action, degrees, timeout_s, line) {
                Ok(None) => {}
                Ok(Some((message, help))) => {
                    return Err(self.refused(command, program, message, help));
                }
                Err(_gone) => return Ok(Waited::Gone),
            }
            self.report_blocks(false);
            return Ok(Waited::Over);
        }
        if let Action::Turning(cycle) = &command.action {
            let turning = turning(cycle, self.setup).map_err(|what| ProgramError::Text {
                file: self.file.clone(),
                diagnostic: Box::new(at_origin(command, program, |file, line| {
                    cannot_turn(what, file, line)
                })),
            })?;
            return Ok(match self.turn(turning, command.line) {
                Ok(()) => Waited::Over,
                Err(_gone) => Waited::Gone,
            });
        }
        if let Action::WaitInput {
            index,
            analog,
            mode,
            timeout_s,
        } = command.action
        {
            let kind = if analog {
                SignalKind::Analog
            } else {
                SignalKind::Digital
            };
            match self.wait_for_input(kind, index, mode, timeout_s, line) {
                // -1 as after a timeout where the input is not known.
                Ok(value) => commands.answer_input(value.unwrap_or(-1.0)),
                Err(_gone) => return Ok(Waited::Gone),
            }
            self.report_blocks(false);
            return Ok(Waited::Over);
        }
        if let Action::Probe {
            curve,
            feed,
            toward,
            must,
        } = command.action
        {
            let order = ProbeMove { curve, feed, toward };
            if let Some(objection) = objection(&order, self.setup) {
                return Err(self.wrong(at_origin(command, program, |file, line| {
                    objection.told(file, line)
                })));
            }
            let Ok(result) = self.probe(order, line) else {
                return Ok(Waited::Gone);
            };
            if let Some((message, help)) = complaint(&result, toward, must) {
                return Err(self.wrong(at_origin(command, program, |file, line| {
                    about_line_with(message, Some(help), file, line)
                })));
            }
            let tripped = result.verdict == ProbeVerdict::Contact;
            commands.answer_probe(&result.position, &result.stands_at, tripped);
            if let Some((message, help)) = self.log_probe(commands, tripped) {
                return Err(self.refused(command, program, message, help));
            }
            self.report_blocks(false);
            return Ok(Waited::Over);
        }
        Ok(Waited::None)
    }

    /// Carries out a comment about files; why it cannot be.
    fn log(&mut self, log: &LogAction, line: u32) -> Option<(String, String)> {
        if let Some(objection) = log_objection(log) {
            return Some(objection);
        }
        let Some(folder) = &self.setup.log_folder else {
            if matches!(
                log,
                LogAction::Open(_) | LogAction::Append(_) | LogAction::OpenProbes(_)
            ) && self.warned.insert(line)
            {
                let text = "warning: time is not real: the log file is not written";
                self.announce(Moment::Block(self.next_block), line, true, text);
            }
            return None;
        };
        let logs = self.logs.get_or_insert_with(|| LogFiles::new(folder.clone()));
        if matches!(log, LogAction::Line(_)) && !logs.is_open(LogKind::Lines) {
            if self.warned.insert(line) {
                let text =
                    "warning: no log file is open, so this line goes nowhere: write (LOGOPEN,name) before it";
                self.announce(Moment::Block(self.next_block), line, true, text);
            }
            return None;
        }
        logs.act(log).err().map(no_log)
    }

    /// Writes where the probe was, where a file is open for that.
    fn log_probe(&mut self, commands: &Commands, tripped: bool) -> Option<(String, String)> {
        let logs = self.logs.as_mut().filter(|_| tripped)?;
        let text = commands.probed().map(|value| format!("{value:.6}")).join(" ");
        logs.line(LogKind::Probes, text).err().map(no_log)
    }

    /// Closes the files that the program has left open, and waits for the disk.
    fn finish_logs(&mut self) {
        if let Some(Err(text)) = self.logs.take().map(LogFiles::finish) {
            let text = format!("warning: {text}");
            self.announce(Moment::Block(self.next_block), self.last_line, true, &text);
        }
    }

    /// Comes to rest and hands over to a turning cycle.
    fn turn(&mut self, turning: TurningMotion, line: u32) -> Result<(), QueueClosed> {
        // Its passes are fed at the speed that the cycle was planned for.
        self.set_feed_law(FeedLaw::Time);
        let mut turning: Box<dyn ProcessCycle> = Box::new(turning);
        while let Some(turnings) = &mut self.turnings {
            match turnings.send(turning) {
                Ok(()) => break,
                Err(_) if turnings.is_abandoned() => return Err(QueueClosed),
                Err(back) => turning = back,
            }
            // Holds and overrides are answered meanwhile.
            self.planner.poll()?;
            std::thread::sleep(TURNING_NAP);
        }
        if !self.with_next_block.is_empty() {
            // The cycle's passes are no blocks: what is to change with them changes where they begin, at rest.
            let change = Change {
                moment: SignalMoment::Rest(self.actions),
                ..self.with_next_block
            };
            self.with_next_block = Change::at(SignalMoment::Block(0));
            let action = self.actions;
            self.actions += 1;
            self.schedule(|signals| signals.change(change))?;
            self.planner.rest(&Step::Action { action, line })?;
        }
        self.last_line = 0;
        self.planner.rest(&Step::Turning { line })
    }

    /// A command that the machine has not carried out.
    fn refused(&self, command: &Command, program: &Path, message: String, help: String) -> ProgramError {
        ProgramError::Text {
            file: self.file.clone(),
            diagnostic: Box::new(at_origin(command, program, |file, line| {
                about_line_with(message, Some(help), file, line)
            })),
        }
    }

    /// Waits until the spindle has the speed that it was given, where something tells that; why it has not, after the time for it.
    fn await_speed(&mut self, line: u32) -> Result<Option<(String, String)>, QueueClosed> {
        let outputs = &self.periphery.outputs;
        let turns = outputs.direction != SpindleDirection::Stopped && outputs.speed().rpm_at(0.0) > 0.0;
        let Some(spindle) = self.setup.machine.signals.spindle(0).filter(|_| turns) else {
            return Ok(None);
        };
        let speed = match outputs.surface {
            Some(surface) => format!("{} m/min", surface.metres_per_minute),
            None => format!("{} rpm", outputs.constant_rpm()),
        };
        let timeout_s = spindle.at_speed_timeout_s;
        let awaited = match spindle.at_speed {
            AtSpeed::Unknown => return Ok(None),
            AtSpeed::Feedback => Awaited::AtSpeed {
                spindle: spindle.number,
                command: self.periphery.spindle_command,
            },
            AtSpeed::Input(number) => Awaited::Input {
                kind: SignalKind::Digital,
                number,
                mode: WaitMode::High,
            },
        };
        let text = format!("wait for spindle: {speed}, {timeout_s} s at most");
        let reached = self.wait_for(awaited, timeout_s, line, true, &text)?.is_some();
        Ok((!reached && !self.is_abandoned()).then(|| {
            let message = format!("the spindle did not reach {speed} within {timeout_s} s, and feed waits for it");
            let help = "see its drive and its speed; at_speed_timeout_s at its [[spindle]] in the machine file gives it more time";
            (message, help.to_owned())
        }))
    }

    /// Turns the stopped spindle to an angle and waits until it stands there (M19); why it does not, after the time for it.
    fn orient(
        &mut self,
        action: &Action,
        degrees: f64,
        timeout_s: f64,
        line: u32,
    ) -> Result<Option<(String, String)>, QueueClosed> {
        match self.switch(action, line) {
            Ok(()) => {}
            Err(PlanError::Sink(gone)) => return Err(gone),
            // Nothing else can go wrong at rest.
            Err(_) => return Ok(None),
        }
        self.awaits_speed = false;
        let default_s = self.setup.machine.signals.spindle(0);
        let timeout_s = if timeout_s > 0.0 {
            timeout_s
        } else {
            default_s.map_or(10.0, |spindle| spindle.at_speed_timeout_s)
        };
        let awaited = Awaited::Oriented {
            spindle: 0,
            command: self.periphery.spindle_command,
        };
        let text = format!("wait for spindle: at {degrees} degrees, {timeout_s} s at most");
        let reached = self.wait_for(awaited, timeout_s, line, true, &text)?.is_some();
        Ok((!reached && !self.is_abandoned()).then(|| {
            let message = format!("M19: the spindle does not stand at {degrees} degrees after {timeout_s} s");
            let help = "see its drive; Q of M19 gives it more time, in seconds";
            (message, help.to_owned())
        }))
    }

    /// Whether nothing is driven, or what is driven has ended: nobody answers any more.
    fn is_abandoned(&self) -> bool {
        self.signals.as_ref().is_none_or(Scheduler::is_abandoned)
    }

    fn wrong(&self, diagnostic: Diagnostic) -> ProgramError {
        ProgramError::Text {
            file: self.file.clone(),
            diagnostic: Box::new(diagnostic),
        }
    }

    /// Comes to rest, probes, and gives the result. What follows begins where the axes stand then.
    fn probe(&mut self, order: ProbeMove, line: u32) -> Result<ProbeResult, QueueClosed> {
        let mut change = std::mem::replace(&mut self.with_next_block, Change::at(SignalMoment::Block(0)));
        let action = self.actions;
        self.actions += 1;
        if !change.is_empty() {
            // The move is no block: what is to change with it changes where it begins, at rest.
            change.moment = SignalMoment::Rest(action);
            self.schedule(|signals| signals.change(change))?;
        }
        let text = if order.toward {
            "probe until contact (G38)"
        } else {
            "probe until contact is lost (G38)"
        };
        self.announce(Moment::Rest(action), line, false, text);
        (self.last_line, self.end_line) = (0, line);
        self.planner.rest(&Step::Action { action, line })?;
        let end = order.curve.end();
        let mut probing = Box::new(probing(order, self.setup));
        let without_contact = ProbeResult {
            verdict: ProbeVerdict::Imagined,
            position: end,
            stands_at: end,
        };
        let result = loop {
            let Some(probings) = &mut self.probings else {
                // Nothing is driven.
                break without_contact;
            };
            match probings.send(probing) {
                Ok(()) => {
                    self.planner.rest(&Step::Probe { line })?;
                    break self.await_probe()?;
                }
                Err(_) if probings.is_abandoned() => return Err(QueueClosed),
                Err(back) => probing = back,
            }
            self.planner.poll()?;
            std::thread::sleep(TURNING_NAP);
        };
        self.planner.stand_at(&result.stands_at);
        let place = |position: &Axes| {
            let present = self.setup.machine.limits().present;
            let words = AxisLetter::ALL.iter().filter(|axis| present[axis.index()]);
            let words = words.map(|axis| format!("{}{:.4}", axis.letter(), position[axis.index()]));
            words.collect::<Vec<_>>().join(" ")
        };
        let text = match result.verdict {
            ProbeVerdict::Contact => format!("probe changed at {} (machine coordinates)", place(&result.position)),
            ProbeVerdict::Imagined => {
                "warning: time is not real and no contact is known: the move goes to its end, as if the probe had not changed".to_owned()
            }
            _ => "probe: no change".to_owned(),
        };
        if result.verdict != ProbeVerdict::Imagined || self.warned.insert(line) {
            self.announce(Moment::Block(self.next_block), line, true, &text);
        }
        Ok(result)
    }

    fn await_probe(&mut self) -> Result<ProbeResult, QueueClosed> {
        loop {
            let Some(probings) = &mut self.probings else {
                return Err(QueueClosed);
            };
            if let Some(result) = probings.result() {
                return Ok(result);
            }
            if probings.is_abandoned() {
                return Err(QueueClosed);
            }
            // Holds and overrides are answered meanwhile.
            self.planner.poll()?;
            self.report_blocks(false);
            std::thread::sleep(INPUT_NAP);
        }
    }

    /// Comes to rest, waits for an input there, and gives its value.
    fn wait_for_input(
        &mut self,
        kind: SignalKind,
        number: u32,
        mode: u32,
        timeout_s: f64,
        line: u32,
    ) -> Result<Option<f64>, QueueClosed> {
        let signals = &self.setup.machine.signals;
        let name = signals.input(kind, number).map_or("", |input| &input.name);
        let what = ["its value", "its rise", "its fall", "on", "off"];
        let what = what.get(mode as usize).copied().unwrap_or_default();
        let text = match mode {
            0 => format!("read input {name} (M66)"),
            _ => format!("wait for input {name}: {what}, {timeout_s} s at most (M66)"),
        };
        let awaited = Awaited::Input {
            kind,
            number,
            mode: WaitMode::from_number(mode).unwrap_or(WaitMode::Immediate),
        };
        self.wait_for(awaited, timeout_s, line, mode != 0, &text)
    }

    /// Comes to rest and waits there; none after the timeout, and where nothing is driven.
    fn wait_for(
        &mut self,
        awaited: Awaited,
        timeout_s: f64,
        line: u32,
        is_message: bool,
        text: &str,
    ) -> Result<Option<f64>, QueueClosed> {
        let action = self.actions;
        self.actions += 1;
        if let Some(onlooker) = &self.onlooker {
            let _gone = onlooker.send(FeederEvent::Stop(action, StopKind::Input));
        }
        self.announce(Moment::Rest(action), line, is_message, text);
        let wait = InputWait {
            action,
            awaited,
            // A cast saturates, and a wait of the largest number is one for ever.
            timeout_cycles: (timeout_s * 1e9 / self.setup.period_ns as f64).ceil() as u64,
        };
        self.schedule(|signals| signals.wait(wait))?;
        self.last_line = 0;
        self.planner.rest(&Step::Action { action, line })?;
        self.planner.rest(&Step::InputWait { line })?;
        loop {
            let Some(signals) = &mut self.signals else {
                // Nothing is driven: as after a timeout.
                return Ok(None);
            };
            if let Some(result) = signals.result() {
                return Ok(result.value);
            }
            if signals.is_abandoned() {
                return Err(QueueClosed);
            }
            // Holds and overrides are answered meanwhile.
            self.planner.poll()?;
            self.report_blocks(false);
            std::thread::sleep(INPUT_NAP);
        }
    }

    /// Hands something to the cycle's outputs and inputs, before its block or action goes into the plan.
    fn schedule(&mut self, hand: impl Fn(&mut Scheduler) -> bool) -> Result<(), QueueClosed> {
        let Some(signals) = &mut self.signals else {
            return Ok(());
        };
        while !hand(signals) {
            if signals.is_abandoned() {
                return Err(QueueClosed);
            }
            self.planner.poll()?;
            std::thread::sleep(CARRIER_NAP);
        }
        Ok(())
    }

    /// An output that changes at rest, now in the order of the program.
    fn set_at_rest(
        &mut self,
        line: u32,
        text: &str,
        set: impl Fn(&mut Change),
    ) -> Result<(), PlanError<QueueClosed>> {
        let mut change = Change::at(SignalMoment::Rest(self.actions));
        set(&mut change);
        self.schedule(|signals| signals.change(change))
            .map_err(PlanError::Sink)?;
        self.act(line, text)?;
        // An action takes no time, so the next move would begin in the same period: one setpoint at rest has the new value.
        let seconds = self.setup.period_ns as f64 * 1e-9;
        let dwell = Step::Dwell { seconds, line };
        self.planner.rest(&dwell).map_err(PlanError::Sink)
    }

    /// Which overrides count, from the next block on; a cycle that taps needs its feed from the first setpoint on, so it comes
    /// to rest for it.
    fn switch_overrides(
        &mut self,
        switches: OverrideSwitches,
        cycle: Option<&'static str>,
        line: u32,
    ) -> Result<(), PlanError<QueueClosed>> {
        self.override_counts = switches.feed;
        let Some(cycle) = cycle else {
            self.with_next_block.overrides = Some(switches);
            return Ok(());
        };
        self.with_next_block.overrides = None;
        let text = if switches.feed {
            format!("overrides as before {cycle}")
        } else {
            format!("{cycle}: overrides off")
        };
        self.set_at_rest(line, &text, |change| change.overrides = Some(switches))
    }

    /// Outputs that wait for a move that never comes, as in LinuxCNC.
    fn warn_of_outputs_without_move(&mut self) {
        if !self.with_next_block.sets_outputs() {
            return;
        }
        let text = "warning: no move follows this output, so it does not change: write a move behind it, or M64, M65 or M68";
        self.announce(Moment::Block(self.next_block), self.with_next_line, true, text);
    }

    /// Why the machine cannot change to this tool.
    fn objection_to_tool(&self, tool: u32, program: &Path, command: &Command) -> Option<Diagnostic> {
        let present = self.periphery.tool;
        match waits_for(self.setup.machine.program.tool_change, tool, present)? {
            Changer::Operator if !self.confirms_tools => {
                let (message, help) = nobody_changes(tool, present);
                Some(at_origin(command, program, |file, line| {
                    about_line_with(message, Some(help), file, line)
                }))
            }
            Changer::Operator => None,
            Changer::Program => {
                let objection = self.codes.as_ref()?.objection(TOOL_CHANGE_CODE)?;
                Some(at_origin(command, program, |file, line| {
                    about_line(objection, file, line)
                }))
            }
        }
    }

    /// Waits for another tool, if the machine needs to, and takes it as the one in the spindle.
    fn change_tool(&mut self, action: &Action, tool: u32, line: u32) -> Result<(), PlanError<QueueClosed>> {
        let present = self.periphery.tool;
        let is_counted = self.setup.machine.program.tool_change == ToolChange::Subroutine;
        self.tool_changes += u64::from(tool != present && !is_counted);
        let changer = waits_for(self.setup.machine.program.tool_change, tool, present);
        if let Some(changer) = changer {
            self.periphery.change = Some((changer, tool));
            self.periphery.is_tool_known = false;
            let kind = match changer {
                Changer::Operator => StopKind::ToolChange(tool),
                Changer::Program => StopKind::User(tool_change_call(tool, present, line)),
            };
            self.stop(line, kind)?;
        }
        self.switch(action, line)
    }

    /// The feed of a move goes by time or by the spindle, from its block on.
    fn go_by(&mut self, feed_per_revolution: Option<f64>, motion: &Move) {
        let outputs = &self.periphery.outputs;
        let turns = outputs.direction != SpindleDirection::Stopped;
        if motion.kind == MoveKind::Rapid {
            let moves_x = motion.curve.start()[0] != motion.curve.end()[0];
            self.has_left_radius |= turns && outputs.surface.is_some() && moves_x;
            return;
        }
        let law = match feed_per_revolution {
            Some(_) if turns => FeedLaw::Revolution(outputs.speed()),
            _ => FeedLaw::Time,
        };
        self.set_feed_law(law);
    }

    fn set_feed_law(&mut self, law: FeedLaw) {
        if law != self.feed_law {
            self.feed_law = law;
            self.with_next_block.feed_law = Some(law);
        }
    }

    /// Whether something tells that the spindle has its speed.
    fn knows_speed(&self) -> bool {
        let spindle = self.setup.machine.signals.spindle(0);
        spindle.is_some_and(|spindle| spindle.at_speed != AtSpeed::Unknown)
    }

    /// The surface speed in force, once more.
    fn surface_action(&self) -> Action {
        let outputs = &self.periphery.outputs;
        match outputs.surface {
            Some(surface) => Action::SurfaceSpeed {
                direction: outputs.direction,
                surface,
            },
            None => Action::Spindle {
                direction: outputs.direction,
                speed_rpm: outputs.speed_rpm,
            },
        }
    }

    /// Something of the periphery takes effect at rest.
    fn switch(&mut self, action: &Action, line: u32) -> Result<(), PlanError<QueueClosed>> {
        self.periphery.apply(action);
        if matches!(
            action,
            Action::Spindle { .. } | Action::SurfaceSpeed { .. } | Action::OrientSpindle { .. }
        ) {
            self.periphery.spindle_command = u64::from(self.actions) + 1;
            self.awaits_speed = true;
        }
        self.tell_periphery(self.actions);
        match describe(action) {
            Some(text) => self.act(line, &text),
            None => Ok(()),
        }
    }

    /// Tells what the periphery is from the action of this number on.
    fn tell_periphery(&self, action: u32) {
        if let Some(listener) = &self.periphery_listener {
            let _gone = listener.send((action, self.periphery));
        }
        if let Some(onlooker) = &self.onlooker {
            let _gone = onlooker.send(FeederEvent::Periphery(action, self.periphery));
        }
    }

    /// `false` at the program's end.
    fn execute(&mut self, command: &Command) -> Result<bool, PlanError<QueueClosed>> {
        let line = command.line;
        match &command.action {
            Action::Move(motion) => {
                self.go_by(command.feed_per_revolution, motion);
                self.push_move(motion, line)?;
            }
            Action::Dwell { seconds } => {
                self.planner
                    .rest(&Step::Dwell {
                        seconds: *seconds,
                        line,
                    })
                    .map_err(PlanError::Sink)?;
            }
            Action::ProgramStop { optional, .. } => {
                if !optional || self.switches.optional_stop {
                    self.stop(line, StopKind::Program)?;
                }
            }
            Action::UserCommand { number, p, q } => {
                let call = UserCall {
                    number: *number,
                    words: [*p, *q],
                    line,
                };
                self.user_commands += 1;
                self.stop(line, StopKind::User(call))?;
            }
            Action::ProgramEnd => return Ok(false),
            Action::BeginToolChange(tool) => {
                let call = change_begins(*tool, self.periphery.tool, line);
                self.tool_changes += 1;
                self.periphery.apply(&command.action);
                self.stop(line, StopKind::User(call))?;
            }
            Action::ChangeTool(tool) => self.change_tool(&command.action, *tool, line)?,
            Action::Output {
                index,
                on,
                synchronised,
            } => {
                let (index, on) = (*index, *on);
                if *synchronised {
                    self.with_next_block.set_digital(index, on);
                    self.with_next_line = line;
                } else {
                    let text = format!("output {index} {}", if on { "on" } else { "off" });
                    self.set_at_rest(line, &text, |change| change.set_digital(index, on))?;
                }
            }
            Action::AnalogOutput {
                index,
                value,
                synchronised,
            } => {
                let (index, value) = (*index, *value);
                if *synchronised {
                    self.with_next_block.set_analog(index, value);
                    self.with_next_line = line;
                } else {
                    let text = format!("analog output {index} {value}");
                    self.set_at_rest(line, &text, |change| change.set_analog(index, value))?;
                }
            }
            Action::Overrides {
                feed,
                spindle,
                adaptive,
                feed_stop,
                cycle,
            } => {
                let switches = OverrideSwitches {
                    feed: *feed,
                    spindle: *spindle,
                    adaptive: *adaptive,
                    feed_stop: *feed_stop,
                };
                self.switch_overrides(switches, *cycle, line)?;
            }
            Action::Spindle { .. }
            | Action::SurfaceSpeed { .. }
            | Action::Coolant { .. }
            | Action::ToolNumber(_) => {
                self.switch(&command.action, line)?;
            }
            other => {
                if let Some(text) = describe(other) {
                    // Neither a message nor the next tool's number is a reason to stop.
                    // Loops would say it again and again.
                    if matches!(other, Action::Warning(_)) && !self.warned.insert(line) {
                        return Ok(true);
                    }
                    let is_message = !matches!(other, Action::SelectTool(_));
                    self.announce(Moment::Block(self.next_block), line, is_message, &text);
                }
            }
        }
        Ok(true)
    }

    /// Comes to rest and waits to be told to go on. An action before it makes it known by its number.
    fn stop(&mut self, line: u32, kind: StopKind) -> Result<(), PlanError<QueueClosed>> {
        let action = self.actions;
        self.actions += 1;
        if let Some(onlooker) = &self.onlooker {
            let _gone = onlooker.send(FeederEvent::Stop(action, kind));
        }
        match kind {
            StopKind::User(call) => {
                self.tell_periphery(action);
                self.announce(Moment::Rest(action), line, false, &call.text());
                self.hand_to_carrier(action, call)?;
            }
            StopKind::ToolChange(tool) => {
                self.tell_periphery(action);
                let text = tool_request(tool, self.periphery.tool);
                self.announce(Moment::Rest(action), line, true, &text);
            }
            StopKind::Program | StopKind::Step | StopKind::Input => {}
        }
        self.last_line = 0;
        self.planner
            .rest(&Step::Action { action, line })
            .map_err(PlanError::Sink)?;
        self.planner
            .rest(&Step::ProgramStop { line })
            .map_err(PlanError::Sink)
    }

    fn hand_to_carrier(&mut self, action: u32, call: UserCall) -> Result<(), PlanError<QueueClosed>> {
        let Some(carrier) = &mut self.carrier else {
            return Ok(());
        };
        while carrier.stops.is_full() {
            if carrier.controls.is_abandoned() || carrier.stops.is_abandoned() {
                return Err(PlanError::Sink(QueueClosed));
            }
            std::thread::sleep(CARRIER_NAP);
        }
        let _gone = carrier.stops.push(action);
        let _gone = carrier.calls.send((action, call));
        Ok(())
    }

    /// Looks how the switches stand for the next command. Once for each, so that a number says what they counted for.
    fn follow_switches(&mut self, commands: &mut Commands, line: u32) {
        let state = self.switching.at(self.commands, self.switches);
        if state == self.switches {
            return;
        }
        self.switches = state;
        commands.set_block_delete(state.block_delete);
        let switched = Switched {
            command: self.commands,
            line,
            state,
        };
        for news in &self.news {
            let _gone = news.send(FeederEvent::Switched(self.job, switched));
        }
    }

    /// Attaches what the program has called from other files.
    fn tell_files(&mut self, commands: &Commands) {
        if commands.file_count() == self.files_told {
            return;
        }
        for (name, text) in commands.files().skip(self.files_told) {
            for news in &self.news {
                let name = format!("{}{name}", self.subroutines);
                let _gone = news.send(FeederEvent::Attach(name, text.clone()));
            }
        }
        self.files_told = commands.file_count();
    }

    fn tell_modal(&mut self, commands: &Commands) {
        let Some(onlooker) = &self.onlooker else { return };
        let modal = commands.modal();
        if self.modal != Some(modal) {
            self.modal = Some(modal);
            let _gone = onlooker.send(FeederEvent::Modal(self.next_block, modal));
        }
    }

    fn push_move(&mut self, motion: &Move, line: u32) -> Result<(), PlanError<QueueClosed>> {
        let mut motion = *motion;
        let SwitchState {
            single_step,
            rapid_override,
            ..
        } = self.switches;
        // Behind another stop, and before the first move, there is nothing to stop behind.
        if single_step && self.last_line != line && self.last_line > 0 {
            self.stop(self.last_line, StopKind::Step)?;
        }
        if motion.kind == MoveKind::Rapid && rapid_override < 1.0 && self.override_counts {
            motion.feed = rapid_override * self.rapid_speed(&motion.curve);
        }
        if let (MoveKind::Feed, Some(most)) = (motion.kind, self.setup.machine.max_feed_mm_s) {
            motion.feed = motion.feed.min(most);
        }
        let block = self.next_block;
        if !self.with_next_block.is_empty() {
            let nothing = Change::at(SignalMoment::Block(block));
            let mut change = std::mem::replace(&mut self.with_next_block, nothing);
            change.moment = SignalMoment::Block(block);
            self.schedule(|signals| signals.change(change))
                .map_err(PlanError::Sink)?;
        }
        self.planner.push(&motion, line, block)?;
        self.next_block += 1;
        self.moves += 1;
        self.last_line = line;
        self.path_mm += motion.curve.length();
        if let Some(onlooker) = &self.onlooker {
            let queued = QueuedBlock {
                block,
                end: motion.curve.end(),
                feed_mm_s: motion.feed,
                path_mm: self.path_mm,
            };
            let _gone = onlooker.send(FeederEvent::Queued(queued));
        }
        if self.with_blocks {
            self.end_line = line;
            let kind = match (motion.kind, &motion.curve) {
                (MoveKind::Rapid, _) => BlockKind::Rapid,
                (_, Curve::Line(_)) => BlockKind::Line,
                (_, Curve::Arc(_)) => BlockKind::Arc,
                (_, Curve::Involute(_)) => BlockKind::Involute,
                (_, Curve::Blend(_) | Curve::Spline(_)) => BlockKind::Other,
            };
            self.blocks.push_back(Open {
                block,
                line,
                kind,
                length_mm: motion.curve.length(),
            });
        }
        Ok(())
    }

    /// The speed in the feed metric at which the first axis is at its limit, along the chord of a rapid. Never 0.
    fn rapid_speed(&self, curve: &Curve) -> f64 {
        let limits = self.setup.machine.limits();
        let way = curve.end() - curve.start();
        let length = curve.length();
        let mut speed = f64::INFINITY;
        for axis in 0..way.len() {
            if limits.present[axis] && way[axis] != 0.0 {
                speed = speed.min(limits.velocity[axis] * length / way[axis].abs());
            }
        }
        if speed.is_finite() { speed.max(1e-3) } else { 1.0 }
    }

    /// Something of the periphery's that takes effect at rest.
    fn act(&mut self, line: u32, text: &str) -> Result<(), PlanError<QueueClosed>> {
        let action = self.actions;
        self.actions += 1;
        self.announce(Moment::Rest(action), line, false, text);
        self.planner
            .rest(&Step::Action { action, line })
            .map_err(PlanError::Sink)
    }

    fn announce(&self, moment: Moment, line: u32, is_message: bool, text: &str) {
        for news in self.news.iter().chain(&self.onlooker) {
            let notice = Notice {
                moment,
                line,
                is_message,
                text: text.to_owned(),
            };
            // Whoever does not listen any more misses nothing.
            let _gone = news.send(FeederEvent::Notice(notice));
        }
    }

    /// Reports blocks whose plan is final.
    fn report_blocks(&mut self, all: bool) {
        let finished = self.planner.finished();
        let keep = usize::from(!all);
        while finished.len() > keep {
            let Some((block, planned_s)) = finished.pop_front() else {
                break;
            };
            while let Some(open) = self.blocks.front() {
                if open.block > block {
                    break;
                }
                let plan = BlockPlan {
                    block: open.block,
                    line: open.line,
                    kind: open.kind,
                    length_mm: open.length_mm,
                    planned_s: if open.block == block { planned_s } else { 0.0 },
                };
                self.blocks.pop_front();
                for news in &self.news {
                    let _gone = news.send(FeederEvent::Block(plan));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use evolvent_gcode::PathMode;
    use evolvent_machine::{Machine, PlannerKind};
    use evolvent_path::{Axes, Line};

    use super::*;

    /// Takes a plan and forgets it.
    struct Nowhere;

    impl PlanSink for Nowhere {
        type Error = QueueClosed;
        fn segment(&mut self, _: &evolvent_planner::Segment) -> Result<(), QueueClosed> {
            Ok(())
        }
        fn step(&mut self, _: &Step) -> Result<(), QueueClosed> {
            Ok(())
        }
        fn exit(&mut self, _: u64, _: evolvent_planner::ExitSpeeds) {}
        fn finalise(&mut self, _: u64) {}
    }

    #[test]
    fn the_tally_of_a_long_near_optimal_plan_does_not_grow() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let mut machine = Machine::load(&file).unwrap();
        machine.path.planner = PlannerKind::Optimal;
        let setup = Setup::new(machine, file, String::new(), None).unwrap();
        let program = Path::new("none.ngc");
        let planner = Stages::one(&setup, 1.0, Nowhere);
        let mut feeder = Feeder::new(program, &setup, planner, Vec::new(), false, false);
        let at = |k: u32| {
            let mut point = Axes::zeros();
            (point[0], point[1]) = (f64::from(k % 7), f64::from(k % 5));
            point
        };
        for k in 0..500 {
            let motion = Move {
                curve: Curve::Line(Line::new(at(k), at(k + 1)).unwrap()),
                kind: MoveKind::Feed,
                feed: 50.0,
                path_mode: PathMode::ExactPath,
            };
            let action = Action::Move(motion);
            let command = Command {
                line: k,
                action,
                origin: None,
                calls: evolvent_gcode::CallChain::default(),
                feed_per_revolution: None,
            };
            assert!(feeder.execute(&command).unwrap());
        }
        let Stages::One(planner) = &feeder.planner else {
            unreachable!("one thread was asked for")
        };
        let tally = planner.sink();
        assert!(tally.planned_s > 10.0, "{} s", tally.planned_s);
        let (parts, steps) = tally.lengths();
        assert!(parts < 100 && steps < 100, "{parts} parts, {steps} steps");
    }
}

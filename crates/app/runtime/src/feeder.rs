//! The planner's thread: program text in, plan out.

mod execute;
mod links;
mod logs;
mod outputs;
mod reporter;
mod threading;
mod tools;
mod waits;

use std::path::Path;
use std::sync::mpsc::Sender;
use std::time::Duration;

use evolvent_gcode::{Action, CanonicalCommand, Diagnostic, MoveKind, SPINDLES};
use evolvent_motion::{ProbingSender, ProcessSender, QueueClosed};
use evolvent_planner::{PlanError, PlanSink};
use evolvent_signals::Scheduler;

use crate::job::Setup;
use crate::log_file::LogFiles;
use crate::memory::ProgramMemory;
use crate::news::{FeederEvent, Moment, StopKind};
use crate::periphery::Periphery;
use crate::refusal::{ProgramError, about_line, about_line_with, at_origin, explain};
use crate::signal_check::signal_objection;
use crate::source::Commands;
use crate::stages::Stages;
use crate::switches::{SwitchState, Switched, Switching};
use crate::threading::ThreadChain;
use crate::unlikely_feed::UnlikelyFeed;
use crate::user_code::UserCodes;

use links::CycleLinks;
use outputs::NextBlock;
use reporter::Reporter;
use threading::ThreadTrouble;
use waits::Waited;

pub(crate) use links::ToCarrier;

/// Poll interval of the planner while too many user-defined M codes are pending.
const CARRIER_NAP: Duration = Duration::from_millis(5);

/// Poll interval of the planner while the machine waits for an input.
const INPUT_NAP: Duration = Duration::from_micros(200);

/// Result of planning a program.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FeedReport {
    /// Largest distance of blends from the programmed path.
    pub deviation_mm: f64,
    /// Seconds at the programmed feed, without dwells.
    pub planned_s: f64,
    /// Moves planned.
    pub moves: u64,
    /// User-defined M codes (M100 to M199) planned.
    pub user_commands: u64,
    /// Tool changes (M6 with another tool) planned.
    pub tool_changes: u64,
    /// Number of lines that begin with `/`: skipped, executed.
    pub block_delete_lines: (u64, u64),
    /// Numbers of the next block and action.
    pub next_block: u32,
    pub next_action: u32,
}

/// No block or action is begun from this number on: a command uses some further numbers, and setpoints carry
/// the next one.
const LAST_NUMBER: u32 = u32::MAX - 67_295;

/// Feeds one program.
pub(crate) struct Feeder<'a, S> {
    file: String,
    setup: &'a Setup,
    planner: Stages<S>,
    links: CycleLinks,
    reporter: Reporter,
    counts: FeedCounts,
    next_block: u32,
    actions: u32,
    /// Line of the preceding move; 0 if the machine stops after it anyway.
    last_line: u32,
    /// Line of the last planned motion, if blocks are reported; the line of the end.
    end_line: u32,
    switches: SwitchState,
    switching: Switching,
    next: NextBlock,
    /// Spindle, coolant and tool after the commands read so far.
    periphery: Periphery,
    /// Tool changes are confirmed by an operator, or need no confirmation.
    confirms_tools: bool,
    /// Executables of user-defined M codes, if they are carried out.
    codes: Option<UserCodes>,
    /// Pieces of the next threading pass so far.
    chain: ThreadChain,
    /// Files that the program writes; created with the first one.
    logs: Option<LogFiles>,
    unlikely_feed: UnlikelyFeed,
}

/// Counts of what was read and planned.
#[derive(Default)]
struct FeedCounts {
    /// Number of commands read.
    commands: u64,
    moves: u64,
    user_commands: u64,
    tool_changes: u64,
    block_delete_lines: (u64, u64),
    path_mm: f64,
}

impl<'a, S: PlanSink<Error = QueueClosed>> Feeder<'a, S> {
    /// `with_blocks`: whether blocks are reported.
    pub(crate) fn new(
        file: &Path,
        setup: &'a Setup,
        planner: Stages<S>,
        listeners: Vec<Sender<FeederEvent>>,
        with_blocks: bool,
        optional_stop: bool,
    ) -> Self {
        Self {
            file: file.display().to_string(),
            setup,
            planner,
            links: CycleLinks::default(),
            reporter: Reporter::new(listeners, with_blocks),
            counts: FeedCounts::default(),
            next_block: 0,
            actions: 0,
            last_line: 0,
            end_line: 0,
            switches: SwitchState {
                single_step: false,
                optional_stop,
                block_delete: setup.block_delete,
                rapid_override: setup.rapid_override,
            },
            switching: Switching::Fixed,
            next: NextBlock::new(&setup.outputs),
            periphery: Periphery {
                outputs: setup.outputs,
                tool: setup.tool,
                ..Periphery::default()
            },
            confirms_tools: true,
            codes: None,
            chain: ThreadChain::default(),
            logs: None,
            unlikely_feed: UnlikelyFeed::new(setup.path_limits().axes()),
        }
    }

    /// Reports spindle, coolant and tool to a listener.
    pub(crate) fn periphery_to(mut self, listener: Option<Sender<(u32, Periphery)>>) -> Self {
        self.reporter.report_periphery_to(listener);
        self
    }

    /// Without an operator to confirm tool changes, a change by the operator is an error of the program.
    pub(crate) fn unattended(mut self, unattended: bool) -> Self {
        self.confirms_tools = !unattended;
        self
    }

    /// Passes turning cycles on to this sender.
    pub(crate) fn turning_by(mut self, turnings: Option<ProcessSender>) -> Self {
        self.links.processes = turnings;
        self
    }

    /// Passes probing moves on to this sender.
    pub(crate) fn probing_by(mut self, probings: Option<ProbingSender>) -> Self {
        self.links.probings = probings;
        self
    }

    /// Schedules outputs and waits here.
    pub(crate) fn signalling_by(mut self, signals: Option<Scheduler>) -> Self {
        self.links.signals = signals;
        self
    }

    /// Numbers blocks and actions from these numbers on, so that numbers continue from job to job.
    pub(crate) fn numbered_from(mut self, block: u32, action: u32) -> Self {
        (self.next_block, self.actions) = (block, action);
        self
    }

    /// Attaches subroutines under names with this prefix.
    pub(crate) fn attaching_to(mut self, folder: String) -> Self {
        self.reporter.attach_to(folder);
        self
    }

    /// Reports every block, modes and program stops to an observer.
    pub(crate) fn watched_by(mut self, observer: Sender<FeederEvent>) -> Self {
        self.reporter.report_to(observer);
        self
    }

    /// Begins with these switches, and follows later changes in this job.
    pub(crate) fn switched_by(mut self, switches: SwitchState, switching: Switching, job: u32) -> Self {
        (self.switches, self.switching) = (switches, switching);
        self.reporter.report_switches_of(job);
        self
    }

    /// Carries out user-defined M codes; one that cannot be carried out is an error of the program.
    pub(crate) fn executing(mut self, codes: UserCodes) -> Self {
        self.codes = Some(codes);
        self
    }

    /// Sets the thread that carries out user-defined M codes.
    pub(crate) fn carried_out_by(mut self, carrier: ToCarrier) -> Self {
        self.links.carrier = Some(carrier);
        self
    }

    /// Plans the program to its end, or to its first error. The plan then ends at rest before the error, and
    /// `failed` is called before the end of the plan is passed on.
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
        // Sent before the end, so that listeners receive the last messages before it.
        self.reporter.release(Moment::Block(self.next_block));
        // A consumer that is gone needs no end.
        let _gone = self.planner.finish(line);
        self.report_blocks(true);
        self.finish_logs();
        // Messages about these files come after the end.
        self.reporter.release(Moment::Block(self.next_block));
        // Replies to holds and overrides while the program runs.
        self.planner.serve_until_closed();
        let report = FeedReport {
            deviation_mm: self.planner.deviation_mm(),
            planned_s: self.planner.planned_s(),
            moves: self.counts.moves,
            user_commands: self.counts.user_commands,
            tool_changes: self.counts.tool_changes,
            block_delete_lines: self.counts.block_delete_lines,
            next_block: self.next_block,
            next_action: self.actions,
        };
        (report, result)
    }

    /// Plans the lines of a program. Returns the state that a program leaves if it was read to its end.
    fn feed_lines(&mut self, program: &Path) -> Result<Option<ProgramMemory>, ProgramError> {
        let mut commands = Commands::open(program, self.setup)?;
        if let Some(start) = commands.start() {
            let line = start.restart.line;
            let text = start.description();
            // The operator checks the approach before the machine drives it.
            if self.act(line, &text).is_err() || self.stop(line, StopKind::Program).is_err() {
                return Ok(None);
            }
        }
        let mut line = 0;
        loop {
            self.follow_switches(&mut commands, line);
            let next = commands.next();
            self.counts.block_delete_lines = commands.block_delete_lines();
            let Some(command) = next else { break };
            self.counts.commands += 1;
            self.reporter.attach_files(&commands);
            let command = command.map_err(|diagnostic| ProgramError::Text {
                file: self.file.clone(),
                diagnostic: Box::new(diagnostic),
            })?;
            line = command.line;
            if self.next_block.max(self.actions) > LAST_NUMBER {
                let message = "the numbers of blocks and stops are used up".to_owned();
                let help = "4 294 900 000 have been carried out since the start: start `evolvent` again";
                return Err(self.refused(&command, program, message, help.to_owned()));
            }
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
            if let Some(text) = self.unlikely_feed.warning(&command, commands.feed_per_minute()) {
                self.warn(line, &text);
            }
            self.reporter.modal(&commands, self.next_block);
            match self.wait_for_spindle(&command, program)? {
                Waited::Gone => break,
                Waited::None | Waited::Over => {}
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
                Err(error) => return Err(self.not_planned(&error, &command, program)),
            }
            self.report_blocks(false);
        }
        Ok(None)
    }

    /// Before a feed move, waits for a commanded spindle speed, and after a rapid for the surface speed at
    /// the new radius.
    fn wait_for_spindle(
        &mut self,
        command: &CanonicalCommand,
        program: &Path,
    ) -> Result<Waited, ProgramError> {
        let is_feed = match &command.action {
            Action::Move(motion) => motion.kind == MoveKind::Feed,
            Action::Turning(_) => true,
            _ => false,
        };
        let line = command.line;
        let left = if is_feed {
            std::mem::take(&mut self.next.has_left_radius)
        } else {
            [false; SPINDLES]
        };
        for number in 0..SPINDLES as u32 {
            if !left[number as usize] || !self.knows_speed(number) {
                continue;
            }
            // A separate command, so that the wait is for the speed at this radius.
            let action = self.periphery.outputs.spindle(number).action(number);
            match self.switch(&action, line) {
                Ok(()) => {}
                Err(PlanError::Sink(_gone)) => return Ok(Waited::Gone),
                Err(error) => {
                    return Err(self.wrong(at_origin(command, program, |file, line| {
                        about_line(error.to_string(), file, line)
                    })));
                }
            }
        }
        if is_feed {
            match self.await_speeds(line) {
                Ok(None) => {}
                Ok(Some((message, help))) => return Err(self.refused(command, program, message, help)),
                Err(_gone) => return Ok(Waited::Gone),
            }
        }
        Ok(Waited::Over)
    }

    /// The machine's objection to a command, independent of the position.
    fn objection_to(&self, command: &CanonicalCommand, program: &Path) -> Option<Diagnostic> {
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

    /// The error of a command that the machine has not carried out.
    fn refused(
        &self,
        command: &CanonicalCommand,
        program: &Path,
        message: String,
        help: String,
    ) -> ProgramError {
        ProgramError::Text {
            file: self.file.clone(),
            diagnostic: Box::new(at_origin(command, program, |file, line| {
                about_line_with(message, Some(help), file, line)
            })),
        }
    }

    /// The error of a command that the planner has rejected.
    fn not_planned(
        &self,
        error: &PlanError<QueueClosed>,
        command: &CanonicalCommand,
        program: &Path,
    ) -> ProgramError {
        self.wrong(match error {
            // The planner lags behind the line that is being read.
            PlanError::NoMotion { .. } => explain(error, program, command.line),
            _ => at_origin(command, program, |file, line| explain(error, file, line)),
        })
    }

    /// Reports blocks whose plan is final.
    fn report_blocks(&mut self, all: bool) {
        self.reporter.blocks(self.planner.finished(), all);
    }

    fn wrong(&self, diagnostic: Diagnostic) -> ProgramError {
        ProgramError::Text {
            file: self.file.clone(),
            diagnostic: Box::new(diagnostic),
        }
    }

    /// Reads the switches for the next command. Each command reads them once, so the number of a command
    /// identifies the switches it was read with.
    fn follow_switches(&mut self, commands: &mut Commands, line: u32) {
        let state = self.switching.at(self.counts.commands, self.switches);
        if state == self.switches {
            return;
        }
        self.switches = state;
        commands.set_block_delete(state.block_delete);
        let switched = Switched {
            command: self.counts.commands,
            line,
            state,
        };
        self.reporter.switched(switched);
    }
}

#[cfg(test)]
mod tests {
    use evolvent_gcode::{Move, PathMode};
    use evolvent_machine::{Machine, PlannerKind};
    use evolvent_path::{Axes, Curve, Line};
    use evolvent_planner::Step;

    use super::*;

    /// Discards a plan.
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
        fn commit(&mut self, _: u64) {}
    }

    /// Numbers continue from job to job of a service that runs for months.
    #[test]
    fn exhausted_move_numbers_end_a_program_with_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("turns.ngc");
        std::fs::write(
            &program,
            "G21 G90 G94 F600\no1 while [1]\nG1 X1\nG1 X0\no1 endwhile\nM2\n",
        )
        .unwrap();
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let setup = Setup::new(Machine::load(&file).unwrap(), file, String::new(), None).unwrap();
        let planner = Stages::one(&setup, 1.0, Nowhere);
        let feeder = Feeder::new(&program, &setup, planner, Vec::new(), false, false);
        let mut feeder = feeder.numbered_from(LAST_NUMBER - 100, 0);
        let ended = feeder.feed_lines(&program).unwrap_err().to_string();
        assert!(
            ended.contains("turns.ngc:") && ended.contains("used up"),
            "{ended}"
        );
        assert_eq!(feeder.next_block, LAST_NUMBER + 1);
    }

    #[test]
    fn a_long_time_optimal_plan_does_not_grow_the_tally() {
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
                feed_mm_s: 50.0,
                path_mode: PathMode::ExactPath,
            };
            let action = Action::Move(motion);
            let command = CanonicalCommand {
                line: k,
                action,
                origin: None,
                calls: evolvent_gcode::CallChain::default(),
                feed_mm_rev: None,
                feed_spindle: 0,
                continues: false,
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

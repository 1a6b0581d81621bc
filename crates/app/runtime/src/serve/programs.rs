//! Programs and blocks of MDI, on the operator's side.

mod following;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};

use evolvent_control::{Activity, Alarm, JobResult, OperatorCommand, Rejection};
use evolvent_motion::MotionState;

use super::checking::Checking;
use super::files::ProgramFile;
use super::jobs::{Planning, ProgramJob};
use super::leaving::Away;
use super::modes::After;
use super::operator::{Job, Operator};
use super::orders::CycleCommand;
use super::program_tally::ProgramTally;
use super::recorded::job_number;
use super::state_store::Saved;
use crate::block_track::BlockTrack;
use crate::job::Setup;
use crate::job_start::ProgramStart;
use crate::news::{ExternalEventKind, UserCall};
use crate::rt::take_turns;
use crate::source::{Commands, Start};
use crate::switches::{SwitchState, Switches, Switching};
use crate::user_code::UserProgram;

/// End of the message about a user-defined M code in progress.
const AT_WORK: &str = " is being carried out";
/// Start of the message of a program that waits before its approach to a line in the middle.
pub const BEFORE_LINE: &str = "stopped before line ";

/// The error if nothing can be saved any more.
const NO_SAVER: &str = "no thread to write with; restart the core";

/// Time within which the planner's thread must end after the machine has finished the job. It takes
/// milliseconds unless a read of the program or of a subroutine hangs.
const PLANNER_TIMEOUT: Duration = Duration::from_secs(10);

/// Maximum number of blocks and actions that a planner which has not ended may have numbered: more than its
/// queues hold.
const NUMBERS_LEFT: u32 = 1 << 20;

/// A program or a block of MDI.
pub(super) struct ProgramRun {
    pub(super) planning: Planning,
    /// The result reported by the cycle.
    pub(super) ended: Option<JobResult>,
    /// The state that a block of MDI leaves when it is done.
    pub(super) after: Option<After>,
    /// Single step in a plan that was made without it.
    pub(super) step: Option<StepBehind>,
    /// The number of its first block.
    pub(super) first_block: u32,
    /// A user-defined M code in progress; the program waits for it.
    pub(super) command: Option<UserCommand>,
    /// A tool change that begins once its mark is on disk.
    pub(super) beginning: Option<ChangeBeginning>,
    /// A user-defined M code has failed.
    pub(super) has_failed: bool,
    /// The error in its text, if any.
    pub(super) failure: Option<String>,
    /// When the machine was found to have finished the job.
    pub(super) ended_at: Option<Instant>,
    /// The excursion from it while it is held, if any.
    pub(super) away: Option<Away>,
    /// The job's state while it is being saved: its result, and since when.
    pub(super) saving: Option<(JobResult, Receiver<Saved>, Instant)>,
}

/// Where single step holds the feed.
#[derive(Clone, Copy, Debug)]
pub(super) enum StepBehind {
    /// After the line of this block.
    Line { block: u32, line: u32 },
    /// After the line that begins after this block, at the present position.
    LineAfter(u32),
}

/// A user-defined M code (M100 to M199) in progress, or done while the program still waits.
pub(super) struct UserCommand {
    call: UserCall,
    /// Number of actions before the stop at which the program waits.
    stop: u32,
    program: UserProgram,
    is_done: bool,
    is_cancelled: bool,
}

/// A tool change whose mark is being written.
pub(super) struct ChangeBeginning {
    call: UserCall,
    stop: u32,
    saving: Receiver<Saved>,
    begun: Instant,
}

/// Computes the approach to a line in the middle of a program on a separate thread, since there may be many
/// lines before it. The result is one line of text.
fn compute_approach(file: PathBuf, setup: Setup) -> Result<Receiver<String>, Rejection> {
    let (sender, approach) = mpsc::channel();
    let spawned = thread::Builder::new().name("way".into()).spawn(move || {
        take_turns();
        let text = match Commands::open(&file, &setup) {
            Ok(commands) => commands.start().map(approach_text).unwrap_or_default(),
            // The planner finds the same error and ends the job.
            Err(error) => error.to_string(),
        };
        let _gone = sender.send(text);
    });
    spawned.map_err(|error| {
        Rejection::new(
            Alarm::Planner,
            format!("no thread to compute the approach: {error}"),
        )
    })?;
    Ok(approach)
}

fn approach_text(start: &Start) -> String {
    let steps = if start.approach.is_empty() {
        "none, the tool is there".to_owned()
    } else {
        start.approach.join("; ")
    };
    let line = start.restart.line;
    // The status cuts what is too long: what turns and what moves comes first.
    let (active, geometry) = (&start.restart.active, &start.restart.geometry);
    format!(
        "{BEFORE_LINE}{line}, as after: {active}; the approach (machine coordinates): {steps}. RESUME starts \
         it, STOP ends the job. Also {geometry}"
    )
}

impl Operator {
    pub(super) fn load(&mut self, file: &ProgramFile) -> Result<(), Rejection> {
        self.files.checking = None;
        self.message.program_changes();
        self.program.tally = ProgramTally::default();
        self.check_loaded(file).or_else(|refusal| match refusal.alarm {
            // A long program is checked while no client waits.
            Alarm::Checking => Ok(()),
            _ => Err(refusal),
        })?;
        for note in &file.notes {
            self.record(ExternalEventKind::Warning, 0, note.clone(), None);
            self.files.cautions.push(note.clone());
            self.message.tell_of_program(note.clone());
        }
        Ok(())
    }

    /// Checks the loaded program against language and machine, with the present offsets and tools.
    fn check_loaded(&mut self, file: &ProgramFile) -> Result<(), Rejection> {
        if let Some(verdict) = &file.verdict {
            self.files.checking = None;
            return verdict.clone().map(drop);
        }
        let setup = self.setup_here();
        if !(self.files.checking.as_ref()).is_some_and(|checking| checking.is_about(&file.version, &setup)) {
            self.files.checking = Some(Checking::begin(file.version.clone(), &setup)?);
        }
        match self.files.checking.as_mut().and_then(Checking::verdict) {
            Some(verdict) => verdict.clone().map(drop),
            None => Err(Alarm::Checking.into()),
        }
    }

    pub(super) fn start(&mut self, line: u32, file: &ProgramFile) -> Result<u64, Rejection> {
        if let Some(mark) = self.store.change {
            return Err(Rejection::new(Alarm::ToolUnknown, mark.sentence()));
        }
        self.check_loaded(file)?;
        let mut setup = self.setup_here();
        setup.start_line = (line > 1).then_some(line);
        // Nothing knows what obstructs the approach. The plan begins with a program stop so that the operator
        // looks.
        let approach = match setup.start_line {
            None => None,
            Some(_) => Some(compute_approach(file.version.file.clone(), setup.clone())?),
        };
        let steps = self.state.is_single_step() || self.program.switches.is_single_step();
        self.switch_anew(steps);
        let job = self.plan(file, setup, None, Activity::Program)?;
        if let Some(caution) = self.files.checking.as_ref().and_then(Checking::caution) {
            self.message.tell_of_program(caution);
        }
        if approach.is_some() {
            self.message
                .tell_of_stop(format!("{BEFORE_LINE}{line}; the approach is being computed"));
        }
        self.files.approach = approach;
        Ok(job)
    }

    /// The program or block of the job that has just begun, and the approach if it does not start at the
    /// beginning.
    pub(super) fn started(&self) -> String {
        let mut text = self.state.program().unwrap_or_default().to_owned();
        if self.files.approach.is_some() {
            text.push_str(&format!(
                ": {}, and follows in the message of the status",
                self.message.text()
            ));
        }
        if let Some(caution) = self.files.checking.as_ref().and_then(Checking::caution) {
            text.push_str("; ");
            text.push_str(&caution);
        }
        text
    }

    pub(super) fn mdi(
        &mut self,
        after: After,
        file: &ProgramFile,
        restored: evolvent_gcode::MdiPreamble,
    ) -> Result<u64, Rejection> {
        let mut setup = self.setup_here();
        (setup.is_mdi, setup.restored) = (true, restored);
        self.switch_anew(false);
        self.plan(file, setup, Some(after), Activity::Mdi)
    }

    /// The switches of the next job, as the operator has set them.
    fn switch_anew(&mut self, single_step: bool) {
        let [_, rapid_override, _] = self.state.overrides();
        self.program.switches = Arc::new(Switches::new(&SwitchState {
            single_step,
            optional_stop: self.state.is_optional_stop(),
            block_delete: self.state.is_block_delete(),
            rapid_override,
        }));
    }

    pub(super) fn plan(
        &mut self,
        file: &ProgramFile,
        setup: Setup,
        after: Option<After>,
        activity: Activity,
    ) -> Result<u64, Rejection> {
        let mut subroutines = String::new();
        let switches = self.program.switches.state();
        let job = self.state.job() + 1;
        if let Some(recorder) = &self.book.recorder {
            let start = ProgramStart {
                is_mdi: activity == Activity::Mdi,
                restored: setup.restored,
                program: String::new(),
                tools: None,
                parameters: None,
                subroutines: String::new(),
                position: setup.start(),
                tool: setup.tool,
                selected_tool: setup.selected_tool,
                outputs: Some(setup.outputs),
                start_line: setup.start_line.unwrap_or(0),
                switches,
                feed_override: self.state.overrides()[0],
                numbered_from: self.program.numbers,
            };
            subroutines = self
                .book
                .notes
                .plans(recorder, job, file, &setup, start, &self.folder);
        }
        let lines_before = setup.restored.lines;
        let planning = Planning::start(ProgramJob {
            file: file.version.file.clone(),
            setup,
            feed_override: self.state.overrides()[0],
            job: job_number(job),
            number: job,
            switches,
            switching: Switching::Operated(Arc::clone(&self.program.switches)),
            numbered_from: self.program.numbers,
            periphery: Some(self.periphery.of_program(job)),
            recorder: self.book.recorder.clone(),
            subroutines,
            carries_out: true,
            in_two_threads: false,
        })
        .map_err(|error| Rejection::new(Alarm::Planner, format!("no thread for the planner: {error}")))?;
        self.program.track = BlockTrack::default();
        self.program.lines_before = lines_before;
        self.message.clear();
        self.stops.is_emergency = false;
        (self.stops.hold, self.stops.stopping) = (false, false);
        self.job = Job::Program(Box::new(ProgramRun {
            planning,
            ended: None,
            after,
            step: None,
            first_block: self.program.numbers.0,
            command: None,
            beginning: None,
            has_failed: false,
            failure: None,
            ended_at: None,
            away: None,
            saving: None,
        }));
        if activity == Activity::Program {
            self.program.tally.begin(self.view.setpoint.sequence);
        }
        Ok(self.state.job_begins(activity))
    }

    pub(super) fn resume(&mut self, command: &OperatorCommand) {
        self.stops.hold = false;
        let setpoint = &self.view.setpoint;
        let at_stop = setpoint.state == MotionState::ProgramStop && !self.is_waiting();
        let stop = at_stop.then_some(setpoint.actions);
        self.send(CycleCommand::Resume(stop), command);
        self.step_on(self.program.switches.is_single_step());
    }

    /// Applies a change of single step to the program in progress.
    pub(super) fn step_on(&mut self, steps: bool) {
        let setpoint = self.view.setpoint;
        let at_stop = setpoint.state == MotionState::ProgramStop && !self.is_waiting();
        let Job::Program(run) = &mut self.job else { return };
        let has_begun = setpoint.block >= run.first_block;
        run.step = steps.then_some(if at_stop || !has_begun {
            StepBehind::LineAfter(setpoint.block)
        } else {
            StepBehind::Line {
                block: setpoint.block,
                line: setpoint.line,
            }
        });
    }

    /// Whether the program waits for a user-defined M code.
    pub(super) fn is_at_command(&self) -> bool {
        matches!(&self.job, Job::Program(run) if run.command.is_some() || run.beginning.is_some())
    }

    /// Whether the program waits for something other than an operator: a user-defined M code or an input.
    pub(super) fn is_waiting(&self) -> bool {
        self.is_at_command() || self.view.at_wait
    }

    /// Ends a user-defined M code in progress.
    pub(super) fn cancel_command(&mut self) {
        if let Job::Program(run) = &mut self.job
            && let Some(command) = &mut run.command
        {
            command.is_cancelled = true;
            command.program.cancel();
        }
    }

    pub(super) fn stop(&mut self, command: &OperatorCommand) {
        self.give_up_waiting(JobResult::Stopped);
        self.cancel_homing(JobResult::Stopped);
        self.cancel_command();
        self.stops.stopping = !matches!(self.job, Job::None);
        self.stops.hold = false;
        if let Job::Jog { steered, .. } = &mut self.job {
            steered.stopping = true;
        }
        // The cycle stops an excursion together with the program.
        self.stop_away();
        self.switch_off_at_rest();
        self.send(CycleCommand::Stop, command);
    }

    /// Ends a job that the cycle has not taken yet.
    pub(super) fn give_up_waiting(&mut self, result: JobResult) {
        if let Job::Program(run) = &mut self.job
            && run.planning.is_waiting()
        {
            run.planning.abandon();
            run.ended = Some(result);
        }
    }
}

/// A diagnostic as one sentence with its position and the calls that lead there. `lines_before` is the length
/// of the preamble, which the operator has not written.
pub(super) fn sentence(diagnostic: &evolvent_gcode::Diagnostic, lines_before: u32) -> String {
    let location = |file: Option<&str>, line: u32| match file {
        Some(file) => format!("{file}:{line}"),
        None => format!("line {}", line.saturating_sub(lines_before)),
    };
    let mut text = format!(
        "{}: {}: {}",
        location(diagnostic.file.as_deref(), diagnostic.line),
        diagnostic.code.as_str(),
        diagnostic.message
    );
    if let Some(help) = &diagnostic.help {
        text.push_str("; ");
        text.push_str(help);
    }
    for same in diagnostic.calls.chunk_by(|a, b| a == b) {
        text.push_str("; called from ");
        text.push_str(&location(same[0].file.as_deref(), same[0].line));
        if same.len() > 1 {
            text.push_str(&format!(", {} calls deep", same.len()));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use evolvent_gcode::{Interpreter, Settings};

    use super::sentence;

    #[test]
    fn a_sentence_names_the_file_and_every_call() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("inner.ngc");
        std::fs::write(&inner, "o<inner> sub\nG1 Y?\no<inner> endsub\n").unwrap();
        let settings = Settings {
            subroutine_folders: vec![folder.path().to_path_buf()],
            ..Settings::default()
        };
        let text = "(preamble)\no<twice> sub\no<inner> call\no<twice> endsub\no<twice> call\n";
        let error = Interpreter::new(text.as_bytes(), settings)
            .find_map(Result::err)
            .unwrap();
        let message = sentence(&error, 1);
        assert!(
            message.starts_with(&format!("{}:2: G0", inner.display())),
            "{message}"
        );
        assert!(
            message.ends_with("; called from line 2; called from line 4"),
            "{message}"
        );
    }
}

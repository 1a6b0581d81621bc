//! Programs and blocks of MDI, from the operator's side.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use evolvent_control::{Activity, Alarm, Command, JobResult, Refusal};
use evolvent_motion::State;

use super::jobs::{Planning, ProgramJob, is_short};
use super::modes::{After, foresee};
use super::operator::{Job, Operator};
use super::orders::What;
use super::track::Track;
use crate::feeder::{FeederNews, ProgramError, StopKind, check};
use crate::job::Setup;

/// A program or a block of MDI.
pub(super) struct ProgramRun {
    pub(super) planning: Planning,
    /// How the cycle has ended it.
    pub(super) ended: Option<JobResult>,
    /// What a block of MDI leaves when it is done.
    pub(super) after: Option<After>,
    /// Single step of a plan that was made without it: hold once this block is behind.
    pub(super) step_behind: Option<u32>,
    /// The program stop that is waited at has been looked at.
    pub(super) stop_seen: bool,
}

impl Operator {
    pub(super) fn load(&mut self, file: &Path) -> Result<(), Refusal> {
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
    pub(super) fn check(&self, file: &Path, lines_before: u32) -> Result<(), Refusal> {
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

    pub(super) fn start(&mut self, line: u32) -> Result<u64, Refusal> {
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

    pub(super) fn mdi(&mut self, text: &str) -> Result<u64, Refusal> {
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

    pub(super) fn plan(
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

    pub(super) fn resume(&mut self, command: &Command) {
        self.hold = false;
        if let Job::Program(run) = &mut self.job {
            run.stop_seen = false;
        }
        self.send(What::Resume, command);
    }

    pub(super) fn stop(&mut self, command: &Command) {
        self.give_up_waiting(JobResult::Stopped);
        self.cancel_homing();
        self.send(What::Stop, command);
    }

    /// A job that the cycle has not taken up yet is over at once.
    pub(super) fn give_up_waiting(&mut self, result: JobResult) {
        if let Job::Program(run) = &mut self.job
            && run.planning.is_waiting()
        {
            run.planning.abandon();
            run.ended = Some(result);
        }
    }

    pub(super) fn follow_program(&mut self) {
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

    pub(super) fn finish_program(
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

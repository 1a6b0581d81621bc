//! Records of a served machine's jobs in the trace, from which each job can be recomputed.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::Sender;

use evolvent_gcode::{PersistentParameters, ToolTable};

use super::files::{FileVersion, ProgramFile};
use crate::job::Setup;
use crate::job_start::{JobStart, ProgramStart, SteeredStart, plain_name};
use crate::news::{ExternalEvent, ExternalEventKind, FeederEvent};
use crate::program_copy::{ProgramCopy, ProgramText};

/// Maximum number of jobs on their way to the cycle that are kept.
const MAX_SENT: usize = 64;

/// Attaches the inputs of jobs, each content once, and records each job where it begins.
#[derive(Debug, Default)]
pub(super) struct JobNotes {
    /// Nothing is recorded without a trace.
    is_recorded: bool,
    /// Jobs on their way to the cycle: number of the order, number of the job, and the start of the job.
    sent: VecDeque<(u64, u64, JobStart)>,
    /// The program that is being planned.
    planned: Option<JobStart>,
    /// The last attachment and its name.
    tools: Option<(ToolTable, String)>,
    parameters: Option<(PersistentParameters, String)>,
    program: Option<(FileVersion, String, Option<Arc<ProgramCopy>>)>,
}

impl JobNotes {
    pub(super) fn new(is_recorded: bool) -> Self {
        Self {
            is_recorded,
            ..Self::default()
        }
    }

    /// Begins another trace file, in which the inputs of jobs are attached again.
    pub(super) fn begin_file(&mut self) {
        (self.tools, self.parameters, self.program) = (None, None, None);
    }

    /// Notes a program or block of MDI about to be planned. Returns the prefix under which its subroutines
    /// are attached.
    pub(super) fn plans(
        &mut self,
        recorder: &Sender<FeederEvent>,
        job: u64,
        file: &ProgramFile,
        setup: &Setup,
        mut start: ProgramStart,
        folder: &Path,
    ) -> String {
        let attach = |name: &str, text: String| {
            let _gone = recorder.send(FeederEvent::Attach(name.to_owned(), text.into_bytes()));
        };
        let text = match (&file.text, self.known(&file.version)) {
            (Some(text), _) => ProgramText::Whole(text.as_slice().into()),
            (None, Some((_, Some(copy)))) => ProgramText::Copy(copy),
            (None, _) => ProgramText::Copy(ProgramCopy::begin(&file.version.file, folder)),
        };
        start.program = match (self.known(&file.version), start.is_mdi) {
            (Some((name, _)), false) => name,
            _ => {
                let path = &file.version.file;
                let name = path
                    .file_name()
                    .map_or_else(String::new, |name| plain_name(&name.to_string_lossy()));
                let name = format!("job-{job}/{name}");
                let (news, copy) = match &text {
                    ProgramText::Whole(text) => (FeederEvent::Attach(name.clone(), text.to_vec()), None),
                    ProgramText::Copy(copy) => (
                        FeederEvent::AttachFile(name.clone(), Arc::clone(copy)),
                        Some(Arc::clone(copy)),
                    ),
                };
                let _gone = recorder.send(news);
                self.program = Some((file.version.clone(), name.clone(), copy));
                name
            }
        };
        let _gone = recorder.send(FeederEvent::File(start.numbered_from.0, text));
        if let Some(tools) = &setup.memory.tools {
            if self.tools.as_ref().is_none_or(|(known, _)| known != tools) {
                let name = format!("job-{job}/tools.tbl");
                attach(&name, tools.to_text());
                self.tools = Some((tools.clone(), name));
            }
            start.tools = self.tools.as_ref().map(|(_, name)| name.clone());
        }
        if let Some(kept) = &setup.memory.kept {
            if self.parameters.as_ref().is_none_or(|(known, _)| known != kept) {
                let name = format!("job-{job}/parameters.var");
                attach(&name, kept.to_text());
                self.parameters = Some((kept.clone(), name));
            }
            start.parameters = self.parameters.as_ref().map(|(_, name)| name.clone());
        }
        start.subroutines = format!("job-{job}/subroutines/");
        let folder = start.subroutines.clone();
        self.planned = Some(JobStart::Program(Box::new(start)));
        folder
    }

    fn known(&self, version: &FileVersion) -> Option<(String, Option<Arc<ProgramCopy>>)> {
        let (known, name, copy) = self.program.as_ref()?;
        (version == known).then(|| (name.clone(), copy.clone()))
    }

    /// The plan goes to the cycle with this order.
    pub(super) fn sends_plan(&mut self, order: u64, job: u64) {
        if let Some(start) = self.planned.take() {
            self.push(order, job, start);
        }
    }

    /// A steered motion goes to the cycle with this order.
    pub(super) fn sends(&mut self, order: u64, job: u64, start: SteeredStart) {
        self.push(order, job, JobStart::Steered(Box::new(start)));
    }

    /// A retrace of the held program begins with this order.
    pub(super) fn sends_retrace(&mut self, order: u64, job: u64, back: u32) {
        self.push(order, job, JobStart::Retrace { back });
    }

    /// Notes that an order took effect with this setpoint.
    pub(super) fn applied(&mut self, recorder: &Sender<FeederEvent>, order: u64, sequence: u64) {
        // Orders sent later may take effect earlier: a change of a motion waits for its setpoint.
        let Some(at) = self.sent.iter().position(|(known, ..)| *known == order) else {
            return;
        };
        let Some((_, job, start)) = self.sent.remove(at) else {
            return;
        };
        let _gone = recorder.send(FeederEvent::ExternalEvent(ExternalEvent {
            sequence,
            kind: ExternalEventKind::Job,
            code: job_number(job),
            text: start.to_string(),
            value: None,
        }));
    }

    /// Adds a pending start. Changes that were too late never take effect, so the oldest are dropped.
    fn push(&mut self, order: u64, job: u64, start: JobStart) {
        if !self.is_recorded {
            return;
        }
        if self.sent.len() >= MAX_SENT {
            self.sent.pop_front();
        }
        self.sent.push_back((order, job, start));
    }
}

/// The job's number as used in events.
pub(super) fn job_number(job: u64) -> u32 {
    u32::try_from(job).unwrap_or(u32::MAX)
}

//! What the trace of a served machine receives of its jobs, so that each can be computed again.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::Sender;

use evolvent_gcode::{KeptParameters, ToolTable};

use super::files::{Look, ProgramFile};
use crate::job::Setup;
use crate::job_start::{JobStart, ProgramStart, SteeredStart, plain_name};
use crate::news::{ExternalEvent, ExternalEventKind, FeederEvent};
use crate::program_copy::{ProgramCopy, ProgramText};

/// Jobs on their way to the cycle that are remembered.
const MAX_SENT: usize = 64;

/// Attaches what jobs begin with, each content once, and notes each job where it begins.
#[derive(Debug, Default)]
pub(super) struct JobNotes {
    /// Without a trace nothing is noted.
    is_recorded: bool,
    /// Jobs on their way to the cycle: number of the order, of the job, and what it begins with.
    sent: VecDeque<(u64, u64, JobStart)>,
    /// The program that is being planned.
    planned: Option<JobStart>,
    /// What was attached last, and under which name.
    tools: Option<(ToolTable, String)>,
    parameters: Option<(KeptParameters, String)>,
    program: Option<(Look, String, Option<Arc<ProgramCopy>>)>,
}

impl JobNotes {
    pub(super) fn new(is_recorded: bool) -> Self {
        Self {
            is_recorded,
            ..Self::default()
        }
    }

    /// The trace goes on in another file: what jobs begin with is attached again.
    pub(super) fn begin_file(&mut self) {
        (self.tools, self.parameters, self.program) = (None, None, None);
    }

    /// A program or a block of MDI is going to be planned. Gives the name under which its subroutines are
    /// attached.
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
        let text = match (&file.text, self.known(&file.look)) {
            (Some(text), _) => ProgramText::Whole(text.as_slice().into()),
            (None, Some((_, Some(copy)))) => ProgramText::Copy(copy),
            (None, _) => ProgramText::Copy(ProgramCopy::begin(&file.look.file, folder)),
        };
        start.program = match (self.known(&file.look), start.is_mdi) {
            (Some((name, _)), false) => name,
            _ => {
                let path = &file.look.file;
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
                self.program = Some((file.look.clone(), name.clone(), copy));
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

    fn known(&self, look: &Look) -> Option<(String, Option<Arc<ProgramCopy>>)> {
        let (known, name, copy) = self.program.as_ref()?;
        (look == known).then(|| (name.clone(), copy.clone()))
    }

    /// What was planned goes to the cycle with this order.
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

    /// An order counts from this setpoint on.
    pub(super) fn applied(&mut self, recorder: &Sender<FeederEvent>, order: u64, sequence: u64) {
        // Orders that came later may count earlier: a turn waits for its setpoint.
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

    /// What is on its way. Turns that came too late never count: the oldest are forgotten.
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

/// A job's number as events have it.
pub(super) fn job_number(job: u64) -> u32 {
    u32::try_from(job).unwrap_or(u32::MAX)
}

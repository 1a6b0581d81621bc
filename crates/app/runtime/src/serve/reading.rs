//! Commands that need files: what is read for them, and what they do afterwards.

use std::path::PathBuf;

use evolvent_bus::{ControlAnswer, ControlRequest, Payload};
use evolvent_control::{Alarm, CommandCode, OperatorCommand, Rejection};
use evolvent_gcode::{ProgramLimits, Settings};
use evolvent_path::{Axes, AxisMask};

use super::files::{Found, MdiBlock, Reading, read_program, read_tools, written};
use super::operator::{Job, Operator};
use crate::memory::ProgramMemory;

/// Maximum number of lines that a block of MDI may execute, including loops and subroutines, because a client
/// waits for its answer.
const MAX_LINES_OF_MDI: u64 = 1_000_000;

impl Operator {
    /// Whether a request is answered while files are being read for another one. True for all that stop or
    /// slow the axes, and for requests of another version, which are rejected anyway.
    pub(crate) fn is_urgent(request: &ControlRequest) -> bool {
        const URGENT: [CommandCode; 9] = [
            CommandCode::Estop,
            CommandCode::Off,
            CommandCode::Stop,
            CommandCode::Hold,
            CommandCode::JogStop,
            CommandCode::JogKeep,
            CommandCode::FeedOverride,
            CommandCode::RapidOverride,
            CommandCode::SpindleOverride,
        ];
        !request.is_compatible() || URGENT.iter().any(|code| *code as u32 == request.command)
    }

    /// Whether the request stops the machine and is therefore answered before others.
    pub(crate) fn stops_machine(request: &ControlRequest) -> bool {
        const STOPS: [CommandCode; 5] = [
            CommandCode::Estop,
            CommandCode::Off,
            CommandCode::Stop,
            CommandCode::Hold,
            CommandCode::JogStop,
        ];
        request.is_compatible() && STOPS.iter().any(|code| *code as u32 == request.command)
    }

    /// The answer to a client that sends a command while its previous command waits for files.
    pub(crate) fn refuse_while_reading(&mut self, request: &ControlRequest) -> ControlAnswer {
        let text = "the files of an earlier command are still being read; wait for its answer";
        let refused = self.state.refuse(Rejection::new(Alarm::Checking, text));
        self.composed(request, Err(refused))
    }

    /// Returns the answer to the command whose files were being read, once they are.
    pub(crate) fn finish_reading(&mut self, now_ns: u64) -> Option<ControlAnswer> {
        let result = self.files.reading.as_ref()?.poll()?;
        let reading = self.files.reading.take()?;
        let operator_inputs = self.operator_inputs();
        let done = result.and_then(|found| {
            // A drive may have failed meanwhile.
            self.state.permit(reading.command.code(), &operator_inputs)?;
            let job = self.carry_out_read(&reading.command, found)?;
            self.unless_lost(&reading.command, job)
        });
        let result = match done {
            Ok(job) => {
                self.state.commit(&reading.command, now_ns, true);
                Ok(job)
            }
            Err(refusal) => Err(self.state.refuse(refusal)),
        };
        Some(self.composed(&reading.request, result))
    }

    /// Cancels the reading: a job that waits for files does not begin any more.
    pub(super) fn cancel_reading(&mut self) {
        if let Some(reading) = &mut self.files.reading
            && matches!(
                reading.command,
                OperatorCommand::Start(_) | OperatorCommand::Step | OperatorCommand::Mdi(_)
            )
        {
            reading.is_cancelled = true;
        }
    }

    /// Carries out a command whose files were read.
    fn carry_out_read(&mut self, command: &OperatorCommand, found: Found) -> Result<u64, Rejection> {
        let mut job = 0;
        match (command, found) {
            (OperatorCommand::Load(_), Found::Program(file)) => self.load(&file)?,
            (OperatorCommand::Start(line), Found::Program(file)) => job = self.start(*line, &file)?,
            (OperatorCommand::Step, Found::Program(file)) => {
                self.program.switches.set_single_step(true);
                job = self.start(0, &file)?;
            }
            (
                OperatorCommand::Mdi(_),
                Found::Mdi {
                    after,
                    file,
                    restored,
                },
            ) => job = self.mdi(*after, &file, restored)?,
            (OperatorCommand::ReloadTools, Found::Tools(tools)) => {
                if let Some(tools) = tools {
                    self.store.take_tools(tools);
                }
                self.refresh_modes();
            }
            (_, Found::Saved(memory)) => {
                self.store.take_saved(*memory);
                self.refresh_modes();
            }
            // A result always belongs to the command that it was read for.
            _ => {}
        }
        self.note_command(command);
        Ok(job)
    }

    /// Starts to read the files that a command needs; `None` if it needs none.
    pub(super) fn begin_reading(
        &self,
        request: &ControlRequest,
        command: &OperatorCommand,
    ) -> Option<Result<Reading, Rejection>> {
        let is_step_of_running = matches!(self.job, Job::Program(_));
        match command {
            OperatorCommand::Load(file) => {
                let (file, setup) = (PathBuf::from(file), self.setup_here());
                let about = file.display().to_string();
                let work = move || read_program(&file, &setup);
                Some(self.files.readers.begin(request, command, about, work))
            }
            OperatorCommand::Step if is_step_of_running => None,
            OperatorCommand::Start(_) | OperatorCommand::Step => {
                // The interlocks ensure that a program is loaded.
                let file = PathBuf::from(self.state.program().unwrap_or_default());
                let (about, setup) = (file.display().to_string(), self.setup_here());
                let work = move || read_program(&file, &setup);
                Some(self.files.readers.begin(request, command, about, work))
            }
            OperatorCommand::Mdi(text) => {
                let block = self.mdi_block(text);
                let work = move || block.read();
                Some(
                    self.files
                        .readers
                        .begin(request, command, "the block".to_owned(), work),
                )
            }
            OperatorCommand::ReloadTools => {
                let file = self.store.memory.tools_file.clone();
                let work = move || read_tools(file.as_deref());
                Some(
                    self.files
                        .readers
                        .begin(request, command, "the tool table".to_owned(), work),
                )
            }
            // The final position of the axes is not known yet.
            OperatorCommand::TouchOff { .. } if !self.view.at_rest => Some(Err(Rejection::new(
                Alarm::Busy,
                "the axes are still stopping; touch off when they are at rest",
            ))),
            _ => {
                let saving = self.store.save(self.memory_after(command)?);
                let about = "offsets and tools".to_owned();
                Some(
                    self.files
                        .readers
                        .begin(request, command, about, move || written(&saving)),
                )
            }
        }
    }

    /// A block of MDI with everything needed to read it.
    fn mdi_block(&self, text: &str) -> MdiBlock {
        let preamble = format!("{}{}", self.program.parameters, self.program.modes.preamble());
        let mut setup = self.setup_after(&preamble);
        setup.is_mdi = true;
        MdiBlock {
            preamble,
            text: text.to_owned(),
            settings: Settings {
                limits: ProgramLimits {
                    max_lines_before_start: MAX_LINES_OF_MDI,
                    ..ProgramLimits::default()
                },
                ..setup.interpreter_settings()
            },
            kept: self.kept(),
            folder: self.folder.clone(),
            setup,
        }
    }

    fn with_offset(
        &self,
        system: u32,
        offset: impl FnOnce(usize, &evolvent_gcode::PersistentParameters) -> Axes,
    ) -> ProgramMemory {
        let mut kept = self.kept();
        let index = match system {
            0 => kept.active_offset(),
            system => system as usize - 1,
        };
        let offset = offset(index, &kept);
        kept.set_work_offset(index, &offset);
        let mut memory = self.store.memory.clone();
        memory.kept = Some(kept);
        memory
    }

    /// What to save after an offset or a tool was changed; `None` for other commands.
    pub(super) fn memory_after(&self, command: &OperatorCommand) -> Option<ProgramMemory> {
        match command {
            OperatorCommand::WorkOffset { system, axes, values } => {
                Some(self.with_offset(*system, |index, kept| {
                    merged(&kept.work_offset(index), values, *axes)
                }))
            }
            OperatorCommand::TouchOff { system, axes, values } => {
                let tip = self.view.setpoint.position - self.program.modes.modal.tool_offset;
                let g92 = self.g92();
                Some(self.with_offset(*system, |index, kept| {
                    kept.touch_off(index, *axes, values, &tip, &g92)
                }))
            }
            OperatorCommand::Tool(entry) => Some(self.store.with_tool(entry)),
            _ => None,
        }
    }
}

fn merged(old: &Axes, new: &Axes, axes: AxisMask) -> Axes {
    Axes::from_fn(|i, _| if axes.contains(i) { new[i] } else { old[i] })
}

//! Effects of a line other than motion: parameters, comments, calls, saved modes; and replies of the machine.

use std::io::BufRead;

use evolvent_path::{AXES, Axes, MAX_COORDINATE};

use crate::codes::modal_groups::MCode;
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::execution::execute::{Executor, Request};
use crate::execution::saved_modes::SavedModes;
use crate::interpreter::Interpreter;
use crate::parameters::names::NormalizedName;
use crate::parameters::values::{DEBUG, INPUT_RESULT, PROBE_TRIPPED, PROBED};
use crate::state::machine_state::Modes;
use crate::syntax::comment::{self, ActiveComment};
use crate::syntax::expression::Target;
use crate::syntax::statement::Statement;
use crate::{Action, CanonicalCommand, Code, LogAction};

impl<R: BufRead> Interpreter<R> {
    /// Sets the value of an input (M66). Call it after [`Action::WaitInput`] has been executed, before the
    /// next command is requested. The value becomes #5399; without a call #5399 is -1, as after a timeout.
    /// Values that are not finite count as -1.
    pub fn set_input_result(&mut self, value: f64) {
        let value = if value.is_finite() { value } else { -1.0 };
        self.parameters.set_numbered(INPUT_RESULT, value);
        self.parameters.commit();
    }

    /// Sets the result of a probing move. Call it after [`Action::Probe`] has been executed, before the next
    /// command is requested. `contact` is the position at which the probe tripped, in machine coordinates
    /// (mm, degrees), and `stop_position` the position at which the axes stopped; without contact both are
    /// equal. The contact in program coordinates and units becomes #5061 to #5069, and `tripped` becomes
    /// #5070. Returns false, without effect, if one of them is not a valid position.
    pub fn set_probe_result(&mut self, contact: &Axes, stop_position: &Axes, tripped: bool) -> bool {
        let mut both = contact.iter().chain(stop_position.iter());
        if !both.all(|value| value.abs() <= MAX_COORDINATE) {
            return false;
        }
        self.state.is_probed = false;
        // Program coordinates refer to the present position.
        self.state.position = *contact;
        for axis in 0..AXES {
            let value = self.state.program_position(axis);
            self.parameters.set_numbered(PROBED + axis, value);
        }
        self.state.position = *stop_position;
        self.parameters
            .set_numbered(PROBE_TRIPPED, f64::from(u8::from(tripped)));
        self.parameters.commit();
        true
    }

    pub(crate) fn handle_request(&mut self, request: Request) -> Result<(), Fault> {
        match request {
            Request::Call { number, times, span } => self.call_number(number, times, span),
            Request::Profile(call) => self.begin_profile(call),
            Request::ToolChange(call, span) => self.call_tool_change_subroutine(&call, span),
            Request::Return => {
                if !self.return_number()? {
                    self.end();
                }
                Ok(())
            }
            Request::Modes(code) => {
                let modes = SavedModes::new(&self.state, self.tools.as_ref(), &self.parameters);
                let Some(frame) = self.flow.frames.last_mut() else {
                    return Ok(());
                };
                match code {
                    MCode::SaveModes => frame.saved = Some((modes, false)),
                    MCode::SaveAndRestoreModes => frame.saved = Some((modes, true)),
                    MCode::InvalidateModes => frame.saved = None,
                    _ => {
                        let Some((saved, _)) = frame.saved else {
                            let span = Span::new(0, self.current.text.len());
                            return Err(Fault::new(
                                Code::NothingSaved,
                                span,
                                "M72, but no modes have been saved",
                            )
                            .help("write M70 before"));
                        };
                        self.restore_saved(saved)?;
                    }
                }
                Ok(())
            }
        }
    }

    /// Restores the modes of a line that a tool change has divided.
    pub(crate) fn restore(&mut self, modes: Modes) {
        self.with_executor(|executor| executor.restore(modes));
    }

    /// M72, and the end of a subroutine after M73.
    pub(crate) fn restore_saved(&mut self, saved: SavedModes) -> Result<(), Fault> {
        let span = Span::new(0, self.current.text.len());
        self.with_executor(|executor| executor.restore_saved(saved, span))
    }

    /// Changes the state outside of a line.
    fn with_executor<T>(&mut self, change: impl FnOnce(&mut Executor<'_>) -> T) -> T {
        let mut state = self.state;
        let statement = Statement::default();
        let number = self.program_line();
        let result = change(&mut self.executor(&statement, &mut state, number));
        self.parameters.commit();
        self.state = state;
        result
    }

    /// Writes the parameters that the line sets.
    pub(crate) fn assign(&mut self) -> Result<(), Fault> {
        for (target, value) in &self.current.block.assignments {
            match *target {
                Target::Numbered(index) => {
                    let stored = value * self.settings.parameter_mm(index);
                    self.parameters.set_numbered(index, stored);
                    self.parameters.foreign_reads.set(index);
                    if let Some(assumption) = &mut self.parameters.assumption {
                        assumption.set_numbered(index);
                    }
                }
                Target::Named(inside) => {
                    let name =
                        NormalizedName::new(&self.current.text[inside.start as usize..inside.end as usize]);
                    if !name
                        .as_ref()
                        .is_some_and(|name| self.parameters.set_named(name, *value))
                    {
                        let message = "there are too many names of parameters";
                        return Err(Fault::new(Code::BadName, inside, message));
                    }
                    if let (Some(name), Some(assumption)) = (name, &mut self.parameters.assumption)
                        && let Some((id, kind)) = self.parameters.names.find(&name)
                    {
                        assumption.set_named(id, kind);
                    }
                }
            }
        }
        Ok(())
    }

    /// Executes active comments.
    pub(crate) fn execute_comments(&mut self, line: u32) -> Result<(), Fault> {
        for index in 0..self.current.block.comments.len() {
            let inside = self.current.block.comments[index];
            let active_comment = comment::active_comment(&self.current.text, inside, &self.scope());
            let action = match active_comment {
                ActiveComment::None => continue,
                ActiveComment::Debug(_) if self.parameters.numbered(DEBUG) == 0.0 => continue,
                ActiveComment::Message(text) | ActiveComment::Debug(text) => Action::Message(text),
                ActiveComment::Print(text) => Action::Print(text),
                ActiveComment::Log(text) => Action::Log(LogAction::Line(text)),
                ActiveComment::LogOpen(name) => Action::Log(LogAction::Open(name)),
                ActiveComment::LogAppend(name) => Action::Log(LogAction::Append(name)),
                ActiveComment::LogClose => Action::Log(LogAction::Close),
                ActiveComment::ProbeOpen(name) => Action::Log(LogAction::OpenProbes(name)),
                ActiveComment::ProbeClose => Action::Log(LogAction::CloseProbes),
                ActiveComment::Abort(text) => {
                    self.finished = true;
                    return Err(Fault::new(
                        Code::ActiveComment,
                        inside,
                        format!("the program aborts: {text}"),
                    ));
                }
            };
            let (origin, calls) = (self.origin(), self.current.location.calls.clone());
            self.output.pending.push_back(CanonicalCommand {
                line,
                action,
                origin,
                calls,
                feed_mm_rev: None,
                feed_spindle: 0,
                continues: false,
            });
        }
        Ok(())
    }
}

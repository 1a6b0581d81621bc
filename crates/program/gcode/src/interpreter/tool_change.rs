//! M6 by a subroutine of the machine: the line is divided at the change.
//!
//! T and M6 are executed first, then the subroutine, then the change takes effect, then the rest of the
//! line is executed. The subroutine starts with the modes of the line; its own modes are discarded.

use std::io::BufRead;

use crate::codes::modal_groups::{Group, MCode, Motion};
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::execution::execute::ToolChangeCall;
use crate::interpreter::{Interpreter, SourceLocation};
use crate::parameters::names::NormalizedName;
use crate::state::machine_state::{CycleModal, Modes};
use crate::syntax::statement::Statement;
use crate::{Action, Code};

/// A line with M6 while its subroutine is active, and until its rest has been executed.
#[derive(Debug)]
pub(crate) struct SplitLine {
    tool: u32,
    /// The rest of the line.
    rest: Statement,
    text: Vec<u8>,
    line: u32,
    location: SourceLocation,
    modes: Modes,
    motion: Motion,
    cycle: CycleModal,
}

/// The next step of a divided line.
#[derive(Debug)]
pub(crate) enum LineContinuation {
    /// The tool change takes effect.
    ToolChanged(Box<SplitLine>),
    /// The rest of the line.
    Rest(Box<SplitLine>),
}

impl<R: BufRead> Interpreter<R> {
    /// Whether the tool-change subroutine is active.
    fn is_changing_tool(&self) -> bool {
        self.flow.frames.iter().any(|frame| frame.tool_change.is_some())
    }

    /// Whether the present line has to be divided.
    pub(crate) fn needs_split(&self) -> Result<bool, Fault> {
        if self.settings.features.tool_change.is_none() {
            return Ok(false);
        }
        let changes = self.current.statement.m(Group::ToolChange) == Some(MCode::ToolChange);
        if self.is_changing_tool() {
            let ends = matches!(self.current.statement.m(Group::Stop), Some(MCode::End(_)));
            if let Some((group, message)) = [
                (changes, Group::ToolChange, "M6 in the tool-change subroutine"),
                (ends, Group::Stop, "the program ends inside a tool change"),
            ]
            .into_iter()
            .find_map(|(found, group, message)| found.then_some((group, message)))
            {
                let span = self.current.statement.group_span(group);
                return Err(Fault::new(Code::ToolChange, span, message).help(
                    "remove it; the change is complete when its subroutine ends, and (ABORT, text) aborts it",
                ));
            }
        }
        Ok(changes)
    }

    /// Executes a line with M6 up to the change, and calls the subroutine if another tool is requested.
    pub(crate) fn split_at_tool_change(&mut self) -> Result<(), Fault> {
        let rest = self.current.statement.split_at_tool_change();
        self.execute_statement()?;
        // The call has pushed a frame without the rest of its line.
        let Some(tool) = self.started_change.take() else {
            self.current.statement = rest;
            return self.execute_statement();
        };
        let split = SplitLine {
            tool,
            rest,
            text: self.current.text.clone(),
            line: self.current.number,
            location: self.current.location.clone(),
            modes: self.state.modes,
            motion: self.state.motion,
            cycle: self.state.cycle,
        };
        self.frame().tool_change = Some(Box::new(split));
        self.state.is_changing_tool = true;
        Ok(())
    }

    /// Enters the tool-change subroutine.
    pub(crate) fn call_tool_change_subroutine(
        &mut self,
        call: &ToolChangeCall,
        span: Span,
    ) -> Result<(), Fault> {
        let name = match &self.settings.features.tool_change {
            Some(changer) => changer.subroutine.clone(),
            None => return Ok(()),
        };
        let named = NormalizedName::new(name.as_bytes());
        let Some((text, label)) =
            named.and_then(|text| self.flow.labels.intern_label(&text).map(|label| (text, label)))
        else {
            let message = format!("\"{name}\" cannot be the name of a subroutine");
            return Err(Fault::new(Code::BadName, span, message)
                .help("program.tool_change_subroutine of the machine file names it"));
        };
        self.parameters.commit();
        self.flow.arguments.clear();
        let words = [call.tool, call.present, call.from_pocket, call.to_pocket];
        self.flow.arguments.extend(words.map(f64::from));
        self.enter(&text, label, span, true, 1).map_err(|fault| {
            if fault.code == Code::SubroutineMissing {
                let message = format!("M6 needs the subroutine O<{name}>, and there is none");
                Fault::new(Code::SubroutineMissing, span, message).help(format!(
                    "put {name}.ngc into a folder of program.subroutines; program.tool_change_subroutine of \
                     the machine file names it"
                ))
            } else {
                fault
            }
        })?;
        self.started_change = Some(call.tool);
        Ok(())
    }

    /// Continues a divided line.
    pub(crate) fn continue_line(&mut self, continuation: LineContinuation) -> Result<(), Fault> {
        match continuation {
            LineContinuation::ToolChanged(split) => {
                self.restore_line(&split);
                self.restore(split.modes);
                self.state.motion = split.motion;
                self.state.cycle = split.cycle;
                self.state.is_changing_tool = false;
                let mut state = self.state;
                let statement = Statement::default();
                let number = self.program_line();
                let mut executor = self.executor(&statement, &mut state, number);
                executor.swap_pockets(split.tool);
                executor.load_tool(split.tool);
                executor.emit(Action::ChangeTool(split.tool));
                self.parameters.commit();
                self.state = state;
                self.continuation = Some(LineContinuation::Rest(split));
                Ok(())
            }
            LineContinuation::Rest(split) => {
                self.restore_line(&split);
                self.current.statement = split.rest;
                self.execute_statement()
            }
        }
    }

    /// Restores the position of the divided line, for error messages.
    fn restore_line(&mut self, split: &SplitLine) {
        self.current.location = split.location.clone();
        self.current.number = split.line;
        self.current.text.clone_from(&split.text);
        self.flow.location_changed = true;
    }
}

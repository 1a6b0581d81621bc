//! M6 by a subroutine of the machine: the line is divided at the change.
//!
//! T and M6 are executed first, then the subroutine, then the tool counts as changed, then the rest of the
//! line is executed. The subroutine sees the modes of the line and leaves none of its own.

use std::io::BufRead;

use crate::codes::modal_groups::{Group, MCode, Motion};
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::execution::execute::ToolCall;
use crate::interpreter::{Interpreter, Place};
use crate::parameters::names::Normal;
use crate::state::machine_state::{CycleModal, Modes};
use crate::syntax::statement::Statement;
use crate::{Action, Code};

/// A line with M6 while its subroutine is active, and until its rest has been executed.
#[derive(Debug)]
pub(crate) struct DividedLine {
    tool: u32,
    /// The rest of the line.
    rest: Statement,
    text: Vec<u8>,
    line: u32,
    place: Place,
    modes: Modes,
    motion: Motion,
    cycle: CycleModal,
}

/// The next step of a divided line.
#[derive(Debug)]
pub(crate) enum Resumed {
    /// The tool counts as changed.
    Changed(Box<DividedLine>),
    /// The rest of the line.
    Rest(Box<DividedLine>),
}

impl<R: BufRead> Interpreter<R> {
    /// Whether the tool-change subroutine is active.
    fn is_changing(&self) -> bool {
        self.flow.frames.iter().any(|frame| frame.change.is_some())
    }

    /// Whether the present line has to be divided.
    pub(crate) fn divides(&self) -> Result<bool, Fault> {
        if self.settings.features.tool_change.is_none() {
            return Ok(false);
        }
        let changes = self.current.statement.m(Group::ToolChange) == Some(MCode::ToolChange);
        if self.is_changing() {
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
    pub(crate) fn divide(&mut self) -> Result<(), Fault> {
        let rest = self.current.statement.divide();
        self.execute_statement()?;
        // The call has pushed a frame without the rest of its line.
        let Some(tool) = self.begun_change.take() else {
            self.current.statement = rest;
            return self.execute_statement();
        };
        let divided = DividedLine {
            tool,
            rest,
            text: self.current.text.clone(),
            line: self.current.number,
            place: self.current.place.clone(),
            modes: self.state.modes,
            motion: self.state.motion,
            cycle: self.state.sticky,
        };
        self.frame().change = Some(Box::new(divided));
        self.state.is_changing_tool = true;
        Ok(())
    }

    /// Enters the tool-change subroutine.
    pub(crate) fn call_tool_change_subroutine(&mut self, call: &ToolCall, span: Span) -> Result<(), Fault> {
        let name = match &self.settings.features.tool_change {
            Some(changer) => changer.subroutine.clone(),
            None => return Ok(()),
        };
        let named = Normal::new(name.as_bytes());
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
        self.begun_change = Some(call.tool);
        Ok(())
    }

    /// Continues a divided line.
    pub(crate) fn resume_line(&mut self, resumed: Resumed) -> Result<(), Fault> {
        match resumed {
            Resumed::Changed(divided) => {
                self.at_line_of(&divided);
                self.restore(divided.modes);
                self.state.motion = divided.motion;
                self.state.sticky = divided.cycle;
                self.state.is_changing_tool = false;
                let mut state = self.state;
                let statement = Statement::default();
                let number = self.shown_line();
                let mut executor = self.executor(&statement, &mut state, number);
                executor.move_pockets(divided.tool);
                executor.load_tool(divided.tool);
                executor.out(Action::ChangeTool(divided.tool));
                self.parameters.commit();
                self.state = state;
                self.resumed = Some(Resumed::Rest(divided));
                Ok(())
            }
            Resumed::Rest(divided) => {
                self.at_line_of(&divided);
                self.current.statement = divided.rest;
                self.execute_statement()
            }
        }
    }

    /// Restores the position of the divided line, for error messages.
    fn at_line_of(&mut self, divided: &DividedLine) {
        self.current.place = divided.place.clone();
        self.current.number = divided.line;
        self.current.text.clone_from(&divided.text);
        self.flow.has_moved = true;
    }
}

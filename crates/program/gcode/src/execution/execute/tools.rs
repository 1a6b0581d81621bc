//! Tool changes of a line, and the tool in the spindle.

use super::{Executor, Request};
use crate::codes::modal_groups::{Group, MCode};
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::state::tool_pockets::ToolPockets;
use crate::{Action, Code, SPINDLES, SpindleDirection, Tool};

/// The arguments of a tool-change subroutine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ToolChangeCall {
    /// The new tool; 0 empties the spindle.
    pub(crate) tool: u32,
    /// The tool in the spindle.
    pub(crate) present: u32,
    /// The pockets of the new and of the present tool; 0 for none.
    pub(crate) from_pocket: u32,
    pub(crate) to_pocket: u32,
}

impl Executor<'_> {
    pub(super) fn tool_change(&mut self) -> Result<Option<Request>, Fault> {
        let line = self.line;
        let span = line.group_span(Group::ToolChange);
        match line.m(Group::ToolChange) {
            None => Ok(None),
            Some(MCode::ToolNumber) => {
                let Some(tool) = line.integer(b'Q')? else {
                    return Err(Fault::new(
                        Code::WordMissing,
                        span,
                        "M61 needs Q, the number of the tool",
                    ));
                };
                self.reject_unknown_tool(tool, line.span(b'Q'))?;
                if self.state.tool != tool {
                    self.swap_pockets(tool);
                }
                self.load_tool(tool);
                self.emit(Action::ToolNumber(tool));
                Ok(None)
            }
            Some(_) => {
                let Some(tool) = self.state.selected_tool else {
                    return Err(
                        Fault::new(Code::ToolMissing, span, "M6, but no tool has been selected")
                            .help("write T and the tool number before M6 or on its line"),
                    );
                };
                if self.state.cutter.is_on() {
                    return Err(Fault::new(
                        Code::CompensationActive,
                        span,
                        "M6 while cutter compensation is on",
                    )
                    .help("write G40 first"));
                }
                for number in 0..SPINDLES {
                    let spindle = &mut self.state.modes.spindles[number];
                    if spindle.is_rotating() {
                        spindle.direction = SpindleDirection::Stopped;
                        self.emit_spindle(number);
                    }
                }
                // Right after G40 the present position applies, independent of the programmed position at the
                // end of compensation.
                if !self.state.cutter.return_pending {
                    self.state.cutter.programmed = None;
                }
                if self.settings.features.tool_change.is_some() && tool != self.state.tool {
                    let call = self.tool_change_call(tool, span)?;
                    self.emit(Action::BeginToolChange(tool));
                    return Ok(Some(Request::ToolChange(call, span)));
                }
                self.load_tool(tool);
                self.emit(Action::ChangeTool(tool));
                Ok(None)
            }
        }
    }

    /// Rejects a tool that a non-empty tool table does not contain. A served machine starts with an empty
    /// table, and 0 is no tool.
    pub(super) fn reject_unknown_tool(&self, tool: u32, span: Span) -> Result<(), Fault> {
        let tools = self.tools.as_ref().filter(|tools| !tools.tools().is_empty());
        if tool == 0 || tools.is_none_or(|tools| tools.get(tool).is_some()) {
            return Ok(());
        }
        let message = format!("tool {tool} is not in the tool table");
        Err(Fault::new(Code::UnknownTool, span, message)
            .help("add the tool to the table, or name another one"))
    }

    /// The pocket of the new tool, and the pocket for the present one.
    fn tool_change_call(&mut self, tool: u32, span: Span) -> Result<ToolChangeCall, Fault> {
        let present = self.state.tool;
        let is_random = self
            .settings
            .features
            .tool_change
            .as_ref()
            .is_some_and(|changer| changer.is_random);
        let row = |number: u32| self.tools.as_ref().and_then(|tools| tools.get(number));
        let missing = |number: u32| {
            let message = format!("tool {number} is not in the tool table, so its pocket is not known");
            Fault::new(Code::UnknownTool, span, message)
        };
        let inconsistent =
            |message: String, help: &str| Fault::new(Code::ToolChange, span, message).help(help.to_owned());
        if !is_random {
            let pocket = |number: u32, help: &str| match (number, row(number)) {
                (0, _) => Ok(0),
                (_, Some(tool)) => Ok(tool.pocket),
                (_, None) => Err(missing(number).help(help.to_owned())),
            };
            let call = ToolChangeCall {
                tool,
                present,
                from_pocket: pocket(tool, "write its line, such as T3 P3, into the tool table")?,
                to_pocket: pocket(
                    present,
                    "write its line into the tool table; M61 Q names the tool in the spindle if it is \
                     another",
                )?,
            };
            self.warn_of_shared_pocket(tool, call.from_pocket);
            self.warn_of_shared_pocket(present, call.to_pocket);
            return Ok(call);
        }
        let Some(new_tool) = row(tool) else {
            let help = if tool == 0 {
                "a random tool changer stores the present tool in the pocket of T0: write a line such as T0 \
                 P5 for an empty pocket"
            } else {
                "write its line, such as T3 P3, into the tool table"
            };
            return Err(missing(tool).help(help));
        };
        let pocket = new_tool.pocket;
        if pocket == 0 {
            let message = format!(
                "tool {tool} has pocket 0 in the tool table, which is the spindle, but tool {present} is in \
                 it"
            );
            return Err(inconsistent(
                message,
                "give it its pocket in the tool table, or name the tool in the spindle by M61 Q",
            ));
        }
        let others = self.tools.iter().flat_map(|tools| tools.tools());
        if let Some(other) = others
            .filter(|other| other.pocket == pocket)
            .find(|other| other.number != tool && other.number != present)
        {
            let message = format!(
                "pocket {pocket} has tool {tool} and tool {} in the tool table",
                other.number
            );
            return Err(inconsistent(
                message,
                "check the pocket, then correct P of the other one in the tool table",
            ));
        }
        Ok(ToolChangeCall {
            tool,
            present,
            from_pocket: pocket,
            to_pocket: pocket,
        })
    }

    /// Warns of a pocket of a fixed magazine that the tool table gives to another tool too.
    fn warn_of_shared_pocket(&mut self, tool: u32, pocket: u32) {
        let others = self.tools.iter().flat_map(|tools| tools.tools());
        let other = others
            .filter(|other| pocket != 0 && other.pocket == pocket)
            .map(|other| other.number)
            .find(|other| *other != tool);
        if let Some(other) = other {
            self.emit(Action::Warning(format!(
                "pocket {pocket} has tool {tool} and tool {other} in the tool table: check the pocket, then \
                 correct P of the other one in the tool table"
            )));
        }
    }

    /// A random tool changer has stored the present tool in the pocket of the new one.
    pub(crate) fn swap_pockets(&mut self, tool: u32) {
        let present = self.state.tool;
        if self
            .settings
            .features
            .tool_change
            .as_ref()
            .is_some_and(|changer| changer.is_random)
            && let Some(tools) = self.tools
        {
            tools.swap_pockets(tool, present);
        }
    }

    pub(crate) fn load_tool(&mut self, number: u32) {
        self.state.tool = number;
        let known = self.tools.as_ref().and_then(|tools| tools.get(number)).copied();
        let tool = known.unwrap_or_else(|| Tool::new(number));
        self.parameters.publish_tool(&tool);
        self.state.pockets = ToolPockets::of(self.state.tool, self.state.selected_tool, self.tools.as_ref());
    }
}

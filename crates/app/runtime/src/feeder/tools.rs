//! Tool changes.

use std::path::Path;

use evolvent_gcode::{Action, CanonicalCommand, Diagnostic};
use evolvent_machine::ToolChange;
use evolvent_motion::QueueClosed;
use evolvent_planner::{PlanError, PlanSink};

use super::Feeder;
use crate::news::StopKind;
use crate::periphery::{Changer, TOOL_CHANGE_CODE, nobody_changes, tool_change_call, waits_for};
use crate::refusal::{about_line, about_line_with, at_origin};

impl<S: PlanSink<Error = QueueClosed>> Feeder<'_, S> {
    /// The reason why the machine cannot change to this tool, if any.
    pub(super) fn objection_to_tool(
        &self,
        tool: u32,
        program: &Path,
        command: &CanonicalCommand,
    ) -> Option<Diagnostic> {
        let present = self.periphery.tool;
        match waits_for(self.setup.machine.program.tool_change, tool, present)? {
            Changer::Operator if !self.confirms_tools => {
                let (message, help) = nobody_changes(tool, present);
                Some(at_origin(command, program, |file, line| {
                    about_line_with(message, Some(help), file, line)
                }))
            }
            Changer::Operator => None,
            Changer::Program => {
                let objection = self.codes.as_ref()?.objection(TOOL_CHANGE_CODE)?;
                Some(at_origin(command, program, |file, line| {
                    about_line(objection, file, line)
                }))
            }
        }
    }

    /// Waits for another tool if the machine needs to, and takes it as the one in the spindle.
    pub(super) fn change_tool(
        &mut self,
        action: &Action,
        tool: u32,
        line: u32,
    ) -> Result<(), PlanError<QueueClosed>> {
        let present = self.periphery.tool;
        let is_counted = self.setup.machine.program.tool_change == ToolChange::Subroutine;
        self.counts.tool_changes += u64::from(tool != present && !is_counted);
        let changer = waits_for(self.setup.machine.program.tool_change, tool, present);
        if let Some(changer) = changer {
            self.periphery.change = Some((changer, tool));
            self.periphery.is_tool_known = false;
            let kind = match changer {
                Changer::Operator => StopKind::ToolChange(tool),
                Changer::Program => StopKind::User(tool_change_call(tool, present, line)),
            };
            self.stop(line, kind)?;
        }
        self.switch(action, line)
    }
}

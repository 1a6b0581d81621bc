//! The modes that M70 and M73 save, and that M72 and the end of the subroutine restore.

use evolvent_path::Axes;

use crate::codes::modal_groups::Compensation;
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::execution::execute::Executor;
use crate::parameters::values::{G92_ACTIVE, Parameters, WORK_OFFSET};
use crate::state::machine_state::{Modes, State};
use crate::{Code, ToolTable};

/// The modes of a line, with tool length and cutter compensation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SavedModes {
    modes: Modes,
    length: SavedLength,
    compensation: Compensation,
    /// Whether the offset of G92 and G52 is active.
    is_offset_active: bool,
}

/// The active tool length.
#[derive(Clone, Copy, Debug)]
enum SavedLength {
    /// G49.
    Off,
    /// The length of the tool in the spindle by the tool table, for any tool.
    SpindleTool,
    /// Another length, for this tool.
    Other { tool: u32, offset: Axes },
}

impl SavedModes {
    /// The modes that M70 saves.
    pub(crate) fn new(state: &State, tools: Option<&ToolTable>, parameters: &Parameters) -> Self {
        let State {
            tool, tool_offset, ..
        } = *state;
        let length = if tool_offset == Axes::zeros() {
            SavedLength::Off
        } else if tool_offset == table_offset(tool, tools) {
            SavedLength::SpindleTool
        } else {
            SavedLength::Other {
                tool,
                offset: tool_offset,
            }
        };
        Self {
            modes: state.modes,
            length,
            compensation: state.cutter.code,
            is_offset_active: parameters.numbered(G92_ACTIVE) != 0.0,
        }
    }
}

/// The offset of a tool in the tool table, as G43 applies it.
fn table_offset(tool: u32, tools: Option<&ToolTable>) -> Axes {
    let tool = tools.and_then(|tools| tools.get(tool));
    tool.map_or(Axes::zeros(), |tool| tool.offset)
}

impl Executor<'_> {
    /// Restores everything that M70 has saved.
    ///
    /// As in LinuxCNC, an active length is not replaced by another one: a subroutine may select the length of
    /// its tool.
    pub(crate) fn restore_saved(&mut self, saved: SavedModes, span: Span) -> Result<(), Fault> {
        let is_on = self.state.cutter.is_on();
        match saved.compensation {
            Compensation::Off if is_on => self.end_compensation(),
            Compensation::Off => {}
            _ if is_on => {}
            _ => {
                let message = "cutter compensation was on when the modes were saved, and G40 was executed \
                               since";
                return Err(Fault::new(Code::CompensationActive, span, message).help(
                    "cutter compensation begins with a lead-in: write G40 before the call, and G41 or G42 \
                     after it",
                ));
            }
        }
        let has_length = self.state.tool_offset != Axes::zeros();
        let present = self.state.tool;
        self.state.tool_offset = match saved.length {
            SavedLength::Off => Axes::zeros(),
            _ if has_length => self.state.tool_offset,
            SavedLength::Other { tool, offset } if tool == present => offset,
            SavedLength::SpindleTool | SavedLength::Other { .. } => {
                table_offset(present, self.tools.as_ref())
            }
        };
        self.restore(saved.modes);
        if saved.is_offset_active == (self.parameters.numbered(G92_ACTIVE) != 0.0) {
            return Ok(());
        }
        // As in LinuxCNC, whether the offset is active is saved, but not the offset.
        if saved.is_offset_active {
            return self.restore_offset();
        }
        self.suspend_offset();
        Ok(())
    }

    /// Restores saved modes, and outputs what has changed.
    pub(crate) fn restore(&mut self, mut saved: Modes) {
        let before = self.state.modes;
        // As in LinuxCNC only spindle 0 is saved.
        saved.spindles[1..].copy_from_slice(&before.spindles[1..]);
        saved.active_spindle = before.active_spindle;
        // Spindles are not oriented again.
        saved.spindles[0].orientation = before.spindles[0].orientation;
        self.state.modes = saved;
        if saved.work_index != before.work_index {
            self.parameters
                .set_numbered(WORK_OFFSET, (saved.work_index + 1) as f64);
            self.state.load_work(self.parameters);
        }
        let (new, old) = (&saved.spindles[0], &before.spindles[0]);
        if (new.direction, new.speed) != (old.direction, old.speed) {
            self.emit_spindle(0);
        }
        if (saved.mist, saved.flood) != (before.mist, before.flood) {
            self.emit_coolant();
        }
        let overrides = |modes: &Modes| {
            (
                modes.feed_override,
                modes.spindle_override,
                modes.adaptive,
                modes.feed_stop,
            )
        };
        if overrides(&saved) != overrides(&before) {
            self.emit_overrides(None);
        }
    }
}

//! The pockets that `#<_current_pocket>` and `#<_selected_pocket>` return.

use crate::ToolTable;

/// Pockets as programs read them; -1 for none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ToolPockets {
    /// Pocket of the tool in the spindle.
    pub(crate) current: f64,
    /// Pocket of the tool that T has selected and M6 has not put into the spindle yet.
    pub(crate) selected: f64,
}

impl ToolPockets {
    /// The pockets by a tool table, as in LinuxCNC: an empty spindle has no pocket, and once a tool is in the
    /// spindle none is selected.
    pub(crate) fn of(tool: u32, selected: Option<u32>, tools: Option<&ToolTable>) -> Self {
        let selected = selected.filter(|selected| *selected != tool);
        Self {
            current: if tool == 0 { -1.0 } else { pocket(tool, tools) },
            selected: selected.map_or(-1.0, |selected| pocket(selected, tools)),
        }
    }

    /// T selects a tool, which may be the one in the spindle.
    pub(crate) fn select(&mut self, tool: u32, tools: Option<&ToolTable>) {
        self.selected = pocket(tool, tools);
    }
}

fn pocket(tool: u32, tools: Option<&ToolTable>) -> f64 {
    let tool = tools.and_then(|tools| tools.get(tool));
    tool.map_or(-1.0, |tool| f64::from(tool.pocket))
}

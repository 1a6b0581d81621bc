//! Spindle, coolant and tool: what a program switches at rest, and the tool changes it waits for.

use evolvent_gcode::{Action, Outputs, SPINDLES, SpindleDirection};
use evolvent_machine::ToolChange;
use evolvent_path::Axes;

use crate::news::UserCall;

/// Number of M6 where its executable is run like a user-defined M code.
pub(crate) const TOOL_CHANGE_CODE: u32 = 6;

/// Number of the call with which a tool change by a subroutine begins.
pub(crate) const CHANGE_BEGINS: u32 = 0;

/// Who carries out the tool change that the program waits for. The numbers are those of the status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Changer {
    /// The operator, who confirms it.
    Operator = 1,
    /// A program or subroutine of the machine.
    Program = 2,
}

/// An angle that the stopped spindle is to turn to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Orientation {
    pub degrees: f64,
    /// The way; none for the shorter one.
    pub direction: Option<SpindleDirection>,
}

/// A pass of a thread or tap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SpindlePass {
    /// The spindle that it follows.
    pub spindle: u32,
    /// Its feed is that of its first piece at the commanded speed of the spindle; a tap ends at its bottom.
    pub motion: UnplannedMove,
}

/// A move that the cycle drives without the plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UnplannedMove {
    /// Its programmed speed, mm/s.
    pub feed_mm_s: f64,
    /// Where it ends if nothing ends it before, machine coordinates.
    pub end: Axes,
}

/// State of spindle, coolant and tool.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Periphery {
    pub outputs: Outputs,
    /// A stopped spindle turns to an angle (M19), until another command.
    pub orientations: [Option<Orientation>; SPINDLES],
    /// Number of the last command to each spindle. Numbers grow, from job to job as well.
    pub spindle_commands: [u64; SPINDLES],
    /// The spindle whose angle the program follows: the cycle needs each sample of it.
    pub follows_angle: Option<u32>,
    /// The pass that follows a spindle now: it notices itself where that stalls, and draws its tool out.
    pub in_pass: Option<SpindlePass>,
    /// The probing move that the cycle drives now.
    pub in_probe: Option<UnplannedMove>,
    /// Tool in the spindle; 0 for none.
    pub tool: u32,
    /// The tool change that the program waits for: by whom, and the tool; 0 empties the spindle.
    pub change: Option<(Changer, u32)>,
    /// A change has ended in this program, or M61 has named the tool: which tool is in the spindle is known.
    pub is_tool_known: bool,
}

impl Periphery {
    /// Takes over what an action changes. Returns whether it changes anything of the kind.
    pub(crate) fn apply(&mut self, action: &Action) -> bool {
        match *action {
            Action::ChangeTool(tool) | Action::ToolNumber(tool) => {
                (self.tool, self.change) = (tool, None);
                self.is_tool_known = true;
                true
            }
            Action::BeginToolChange(tool) => {
                self.change = Some((Changer::Program, tool));
                self.is_tool_known = false;
                true
            }
            Action::OrientSpindle {
                spindle,
                degrees,
                direction,
                ..
            } => {
                let index = spindle as usize;
                let (Some(output), Some(orientation)) = (
                    self.outputs.spindles.get_mut(index),
                    self.orientations.get_mut(index),
                ) else {
                    return false;
                };
                output.direction = SpindleDirection::Stopped;
                *orientation = Some(Orientation { degrees, direction });
                true
            }
            Action::Spindle { spindle, .. } | Action::SurfaceSpeed { spindle, .. } => {
                if let Some(orientation) = self.orientations.get_mut(spindle as usize) {
                    *orientation = None;
                }
                self.outputs.apply(action)
            }
            _ => self.outputs.apply(action),
        }
    }

    /// Whether a spindle is to turn, or to hold an angle.
    pub(crate) fn drives_spindle(&self, number: usize) -> bool {
        self.outputs.spindles[number].turns() || self.orientations[number].is_some()
    }

    /// The move that the cycle drives now without the plan.
    pub(crate) fn unplanned(&self) -> Option<UnplannedMove> {
        self.in_pass.map(|pass| pass.motion).or(self.in_probe)
    }

    /// Spindles and coolant off, no tool change pending: after a stop, a fault or an emergency stop.
    pub(crate) fn switch_off(&mut self) {
        self.outputs.stop_spindles();
        (self.outputs.mist, self.outputs.flood) = (false, false);
        self.orientations = [None; SPINDLES];
        (self.change, self.in_pass, self.in_probe) = (None, None, None);
    }

    /// Coolant as the bus encodes it: bit 0 mist, bit 1 flood.
    pub(crate) fn coolant_bits(&self) -> u32 {
        u32::from(self.outputs.mist) | u32::from(self.outputs.flood) << 1
    }

    /// The pending tool change as the bus encodes it: by whom (0 none), and the tool.
    pub(crate) fn change_numbers(&self) -> (u32, u32) {
        self.change
            .map_or((0, 0), |(changer, tool)| (changer as u32, tool))
    }
}

/// The call of the machine's program for a tool change: new tool and present tool are its arguments.
pub(crate) fn tool_change_call(tool: u32, present: u32, line: u32) -> UserCall {
    UserCall {
        number: TOOL_CHANGE_CODE,
        words: [Some(f64::from(tool)), Some(f64::from(present))],
        line,
    }
}

/// The call with which a change by a subroutine begins: a served machine notes that it is under way.
pub(crate) fn change_begins(tool: u32, present: u32, line: u32) -> UserCall {
    UserCall {
        number: CHANGE_BEGINS,
        ..tool_change_call(tool, present, line)
    }
}

/// How a request to change the tool begins.
const TOOL_REQUEST: &str = "tool change (M6): ";

/// The request to the operator.
pub(crate) fn tool_request(tool: u32, present: u32) -> String {
    match tool {
        0 => format!("{TOOL_REQUEST}take tool {present} out of the spindle, then resume"),
        _ => format!("{TOOL_REQUEST}put tool {tool} into the spindle, then resume"),
    }
}

/// What is said of a change by the operator that ends before it was confirmed.
pub(crate) fn change_abandoned(tool: u32, present: u32) -> String {
    let change = match tool {
        0 => "to an empty spindle".to_owned(),
        _ => format!("to tool {tool}"),
    };
    let counts = match present {
        0 => "the spindle still counts as empty".to_owned(),
        _ => format!("tool {present} still counts as the one in the spindle"),
    };
    format!(
        "the tool change {change} was abandoned, and {counts}: if that is wrong, name the tool by MDI, such \
         as M61 Q{tool}"
    )
}

/// Why a tool change cannot be carried out where no operator confirms it.
pub(crate) fn nobody_changes(tool: u32, present: u32) -> (String, String) {
    let what = match present {
        0 => "the spindle is empty".to_owned(),
        present => format!("tool {present} is in the spindle"),
    };
    let message = format!("M6 needs tool {tool}, but {what}, and nobody can confirm a tool change here");
    let help = format!(
        "run in a terminal, where Enter confirms it, or use `evolvent serve`; --tool {tool} says that the \
         tool is in the spindle already; program.tool_change in the machine file declares an automatic \
         changer"
    );
    (message, help)
}

/// Whether a program that asks for this tool has to wait for it.
pub(crate) fn waits_for(policy: ToolChange, tool: u32, present: u32) -> Option<Changer> {
    match policy {
        _ if tool == present => None,
        ToolChange::Operator => Some(Changer::Operator),
        ToolChange::Program => Some(Changer::Program),
        // After its subroutine it is done.
        ToolChange::Subroutine | ToolChange::None => None,
    }
}

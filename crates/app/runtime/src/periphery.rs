//! Spindle, coolant and tool: changes at rest, and tool changes that the program waits for.

use evolvent_gcode::{Action, Outputs, SPINDLES, SpindleDirection};
use evolvent_machine::ToolChange;
use evolvent_path::Axes;

use crate::news::UserCall;

/// Number of M6 whose executable is run like a user-defined M code.
pub(crate) const TOOL_CHANGE_CODE: u32 = 6;

/// Number of the call that begins a tool change by a subroutine.
pub(crate) const CHANGE_BEGINS: u32 = 0;

/// The changer of the tool change that the program waits for. The numbers are those of the status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Changer {
    /// The operator, who confirms it.
    Operator = 1,
    /// An executable or subroutine of the machine.
    Program = 2,
}

/// An angle to which the stopped spindle turns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Orientation {
    pub degrees: f64,
    /// Direction of the turn; `None` for the shorter one.
    pub direction: Option<SpindleDirection>,
}

/// A pass of a thread or tap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SpindlePass {
    /// The spindle that it follows.
    pub spindle: u32,
    /// The spindle reverses at its end. A tap that is stopped follows its spindle, which is ordered off, to
    /// rest.
    pub is_tap: bool,
    /// Its feed is that of its first piece at the commanded spindle speed; a tap ends at its bottom.
    pub motion: UnplannedMove,
}

/// A move that the cycle drives without a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UnplannedMove {
    /// Its programmed speed, mm/s.
    pub feed_mm_s: f64,
    /// Its end if nothing ends it earlier, machine coordinates.
    pub end: Axes,
}

/// State of spindle, coolant and tool.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Periphery {
    pub outputs: Outputs,
    /// The angle to which a stopped spindle turns (M19), until another command.
    pub orientations: [Option<Orientation>; SPINDLES],
    /// Number of the last command to each spindle. Numbers increase across jobs.
    pub spindle_commands: [u64; SPINDLES],
    /// The spindle whose angle the program follows; the cycle needs every sample of it.
    pub follows_angle: Option<u32>,
    /// The pass that follows a spindle now. It detects a stall itself and retracts its tool.
    pub in_pass: Option<SpindlePass>,
    /// The probing move that the cycle drives now.
    pub in_probe: Option<UnplannedMove>,
    /// Tool in the spindle; 0 for none.
    pub tool: u32,
    /// The tool change that the program waits for: its changer and the tool; 0 empties the spindle.
    pub change: Option<(Changer, u32)>,
    /// Whether the tool in the spindle is known: a change has ended in this program, or M61 has declared the
    /// tool.
    pub is_tool_known: bool,
}

impl Periphery {
    /// Applies an action. Returns whether it concerns the periphery.
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
        self.outputs.spindles[number].is_rotating() || self.orientations[number].is_some()
    }

    /// The move that the cycle drives now without a plan.
    pub(crate) fn unplanned(&self) -> Option<UnplannedMove> {
        self.in_pass.map(|pass| pass.motion).or(self.in_probe)
    }

    /// Orders the spindle off that a tap follows, if one does: the axes of a tap that is stopped follow it to
    /// rest.
    pub(crate) fn stop_tap(&mut self) {
        if let Some(pass) = self.in_pass.filter(|pass| pass.is_tap)
            && let Some(output) = self.outputs.spindles.get_mut(pass.spindle as usize)
        {
            output.direction = SpindleDirection::Stopped;
        }
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

    /// The pending tool change as the bus encodes it: its changer (0 for none), and the tool.
    pub(crate) fn change_numbers(&self) -> (u32, u32) {
        self.change
            .map_or((0, 0), |(changer, tool)| (changer as u32, tool))
    }
}

/// The call of the machine's executable for a tool change, with the new and the present tool as arguments.
pub(crate) fn tool_change_call(tool: u32, present: u32, line: u32) -> UserCall {
    UserCall {
        number: TOOL_CHANGE_CODE,
        words: [Some(f64::from(tool)), Some(f64::from(present))],
        line,
    }
}

/// The call that begins a change by a subroutine: a served machine marks the change as in progress.
pub(crate) fn change_begins(tool: u32, present: u32, line: u32) -> UserCall {
    UserCall {
        number: CHANGE_BEGINS,
        ..tool_change_call(tool, present, line)
    }
}

/// Start of a request to change the tool.
const TOOL_REQUEST: &str = "tool change (M6): ";

/// The request to the operator.
pub(crate) fn tool_request(tool: u32, present: u32) -> String {
    match tool {
        0 => format!("{TOOL_REQUEST}take tool {present} out of the spindle, then resume"),
        _ => format!("{TOOL_REQUEST}put tool {tool} into the spindle, then resume"),
    }
}

/// The message if a change by the operator ends before it was confirmed.
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

/// The error of a tool change that no operator can confirm.
pub(crate) fn nobody_changes(tool: u32, present: u32) -> (String, String) {
    let what = match present {
        0 => "the spindle is empty".to_owned(),
        present => format!("tool {present} is in the spindle"),
    };
    let message = format!("M6 needs tool {tool}, but {what}, and a tool change cannot be confirmed here");
    let help = format!(
        "run in a terminal, where Enter confirms it, or use `evolvent serve`; --tool {tool} declares that \
         the tool is already in the spindle; program.tool_change in the machine file declares an automatic \
         changer"
    );
    (message, help)
}

/// The changer that a program must wait for to get this tool, if any.
pub(crate) fn waits_for(policy: ToolChange, tool: u32, present: u32) -> Option<Changer> {
    match policy {
        _ if tool == present => None,
        ToolChange::Operator => Some(Changer::Operator),
        ToolChange::Program => Some(Changer::Program),
        // A change by a subroutine is complete after it.
        ToolChange::Subroutine | ToolChange::None => None,
    }
}

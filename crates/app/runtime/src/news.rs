//! Events of the feeder: blocks, notices, modes and stops, for recorder, screen and operator.

use std::collections::VecDeque;
use std::sync::Arc;

use evolvent_gcode::{Action, Modal, SpindleDirection};
use evolvent_path::Axes;
use evolvent_trace::BlockKind;

use crate::periphery::{CHANGE_BEGINS, Periphery, TOOL_CHANGE_CODE};
use crate::program_copy::{ProgramCopy, ProgramText};
use crate::switches::Switched;

/// A planned block, for the trace.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BlockPlan {
    pub block: u32,
    pub line: u32,
    pub kind: BlockKind,
    pub length_mm: f64,
    pub planned_s: f64,
}

/// When a notice takes effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Moment {
    /// At rest, once more actions than this have taken effect.
    Rest(u32),
    /// With the first setpoint of this block or a later one.
    Block(u32),
}

impl Moment {
    /// Whether the moment has come, given the number of actions and blocks begun, and whether the plan has
    /// ended.
    pub(crate) fn has_come(self, actions: u32, blocks: u32, ended: bool) -> bool {
        match self {
            Self::Rest(action) => action < actions,
            Self::Block(block) => ended || block < blocks,
        }
    }
}

/// A message or action that takes effect between moves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    pub(crate) moment: Moment,
    /// Program line.
    pub line: u32,
    /// `true` for a message of the program to its operator.
    pub is_message: bool,
    /// Its text.
    pub text: String,
}

/// Number of notices after the first that are examined: the maximum between two actions.
const NOTICES_AHEAD: usize = 16;

/// Number of notices, from the front, that are due. They are in the order of the program: if a later one is
/// due, so are those before it, even if their block begins only after a stop (T and M6 on one line).
pub(crate) fn notices_due(notices: &VecDeque<Notice>, actions: u32, blocks: u32, ended: bool) -> usize {
    let has_come = |notice: &Notice| notice.moment.has_come(actions, blocks, ended);
    let looked_at = notices.len().min(NOTICES_AHEAD);
    (0..looked_at)
        .rev()
        .find(|&index| has_come(&notices[index]))
        .map_or(0, |last| last + 1)
}

/// Events of the feeder, for the recorder and the operator's screen.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum FeederEvent {
    Block(BlockPlan),
    Notice(Notice),
    /// A block was passed to the planner. Sent on request only.
    Queued(QueuedBlock),
    /// These modes are in force from this block on. Sent on request only.
    Modal(u32, Modal),
    /// State of the periphery after the action of this number. Sent on request only.
    Periphery(u32, Periphery),
    /// A program stop in the plan, by the number of the action before it. Sent on request only.
    Stop(u32, StopKind),
    /// Blocks from this one on belong to this text.
    File(u32, ProgramText),
    /// A text to attach to the trace.
    Attach(String, Vec<u8>),
    /// A file to attach to the trace.
    AttachFile(String, Arc<ProgramCopy>),
    /// An event to be recorded at its setpoint.
    ExternalEvent(ExternalEvent),
    /// The trace continues in a new file after this setpoint; later events belong to that file.
    NextFile(u64),
    /// The planner of the job of this number continues with other switches.
    Switched(u32, Switched),
}

/// A command or an alarm, with the setpoint from which it is in effect.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ExternalEvent {
    pub sequence: u64,
    pub kind: ExternalEventKind,
    /// Number of the command or alarm.
    pub code: u32,
    pub text: String,
    pub value: Option<f64>,
}

/// Origin of an event from outside, or of one of the whole machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ExternalEventKind {
    Command,
    Alarm,
    Warning,
    /// Output of a user-defined M code.
    Output,
    /// A job begins.
    Job,
}

/// Why the program stops and waits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum StopKind {
    /// M0, M1, M60, or the check of the approach to a line in the middle.
    Program,
    /// The operator changes to this tool; 0 empties the spindle.
    ToolChange(u32),
    /// A block has ended in single step.
    Step,
    /// A wait for an input, after which the program continues by itself.
    Input,
    /// A user-defined M code (M100 to M199), or M6 of an automatic changer; the program continues when its
    /// executable has ended.
    User(UserCall),
}

/// A user-defined M code (M100 to M199) in a program, or M6 of an automatic changer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UserCall {
    /// The number after M.
    pub number: u32,
    /// P and Q words; for M6 the new tool and the present one.
    pub words: [Option<f64>; 2],
    /// Program line.
    pub line: u32,
}

impl UserCall {
    /// The code as written in programs.
    pub(crate) fn text(&self) -> String {
        if let (TOOL_CHANGE_CODE, [Some(tool), Some(present)]) = (self.number, self.words) {
            return format!("M6, tool {tool} for tool {present},");
        }
        if let (CHANGE_BEGINS, [Some(tool), Some(present)]) = (self.number, self.words) {
            return format!("the change to tool {tool} for tool {present}");
        }
        let word = |letter: char, value: Option<f64>| value.map(|value| format!(" {letter}{value}"));
        let [p, q] = [word('P', self.words[0]), word('Q', self.words[1])].map(Option::unwrap_or_default);
        format!("M{}{p}{q}", self.number)
    }
}

/// A planned block that is not driven yet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct QueuedBlock {
    pub block: u32,
    /// Its end, machine coordinates.
    pub end: Axes,
    /// Programmed speed, mm/s; infinite for rapids.
    pub feed_mm_s: f64,
    /// Programmed path from the job's start to the block's end, mm.
    pub path_mm: f64,
}

/// Name of a spindle in texts.
pub(crate) fn spindle_name(number: u32) -> String {
    match number {
        0 => "spindle".to_owned(),
        _ => format!("spindle {number}"),
    }
}

/// The same at the start of a sentence; the only spindle of most machines has an article.
pub(crate) fn with_article(number: u32) -> String {
    match number {
        0 => "the spindle".to_owned(),
        _ => spindle_name(number),
    }
}

fn turning_text(number: u32, direction: SpindleDirection, speed: &str) -> String {
    let name = spindle_name(number);
    match direction {
        SpindleDirection::Stopped => format!("{name} stop"),
        SpindleDirection::Clockwise => format!("{name} clockwise {speed}"),
        SpindleDirection::CounterClockwise => format!("{name} counter-clockwise {speed}"),
    }
}

/// An action of the periphery as text; `None` for other actions.
pub(crate) fn describe(action: &Action) -> Option<String> {
    Some(match action {
        Action::SelectTool(tool) => format!("select tool {tool}"),
        Action::BeginToolChange(tool) => format!("the change to tool {tool} begins"),
        Action::ChangeTool(tool) => format!("change to tool {tool}"),
        Action::Spindle {
            spindle,
            direction,
            speed_rpm,
        } => turning_text(*spindle, *direction, &format!("{speed_rpm} rpm")),
        Action::SurfaceSpeed {
            spindle,
            direction,
            surface,
        } => {
            let speed = surface.speed_m_min;
            let limit = if surface.max_rpm.is_finite() {
                format!(", {} rpm at most", surface.max_rpm)
            } else {
                String::new()
            };
            turning_text(*spindle, *direction, &format!("{speed} m/min{limit}"))
        }
        Action::OrientSpindle { spindle, degrees, .. } => {
            format!("{} to {degrees} degrees (M19)", spindle_name(*spindle))
        }
        Action::Coolant { mist, flood } => {
            let word = |on: bool| if on { "on" } else { "off" };
            format!("mist {}, flood {}", word(*mist), word(*flood))
        }
        Action::ToolNumber(tool) => format!("tool {tool} is in the spindle"),
        Action::Message(text) | Action::Print(text) => text.clone(),
        _ => return None,
    })
}

//! What the interpreter hands on: canonical commands in machine coordinates.

use evolvent_path::Curve;

/// One canonical command and the line of the program that asked for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    /// Physical line in the file, from 1.
    pub line: u32,
    /// What is to be done.
    pub action: Action,
}

/// What a machine can be asked to do. Commands of one line come in the order of execution of RS274/NGC
/// (table 8), so that whoever carries them out needs no modal state of his own.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
#[expect(
    clippy::large_enum_variant,
    reason = "nearly every action is a move; a box each would cost more"
)]
pub enum Action {
    /// Move along a curve.
    Move(Move),
    /// Stand still (G4).
    Dwell {
        /// How long, in seconds, not negative.
        seconds: f64,
    },
    /// A tool is going to be needed (T): the changer may fetch it.
    SelectTool(u32),
    /// Put this tool into the spindle (M6); 0 empties the spindle.
    ChangeTool(u32),
    /// Spindle state after M3, M4, M5, or a new S word.
    Spindle {
        /// Sense of rotation, or stopped.
        direction: SpindleDirection,
        /// Commanded speed in revolutions per minute, not negative. It is kept while the spindle is stopped.
        speed_rpm: f64,
    },
    /// Coolant state after M7, M8, M9.
    Coolant {
        /// Mist coolant (M7) runs.
        mist: bool,
        /// Flood coolant (M8) runs.
        flood: bool,
    },
    /// Wait for the operator (M0, M1, M60).
    ProgramStop {
        /// M1: only if the operator has switched the optional stop on.
        optional: bool,
        /// M60: change pallets first.
        pallet: bool,
    },
    /// The program is over (M2, M30, a closing `%` or the end of the text). Nothing follows.
    ProgramEnd,
    /// Show this text to the operator: `(MSG, text)`. Control characters have been taken out.
    Message(String),
}

/// A motion along one curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// Where to, in machine coordinates: mm, and degrees for rotary axes. Never of length zero.
    pub curve: Curve,
    /// Rapid or feed.
    pub kind: MoveKind,
    /// Programmed speed along the curve's feed metric (mm/s; deg/s if only rotary axes move), before override.
    /// G93 and G95 are already resolved. Infinite for rapids: as fast as the axes can.
    pub feed: f64,
    /// How the corner between this move and the next is to be taken.
    pub path_mode: PathMode,
}

/// Rapid or feed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MoveKind {
    /// G0.
    Rapid,
    /// G1, G2, G3, G2.2, G3.2.
    Feed,
}

/// Path control mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathMode {
    /// G61: the path is kept exactly; slow down or stop at corners as the limits demand.
    ExactPath,
    /// G61.1: stop at the end of every move.
    ExactStop,
    /// G64: corners may be rounded.
    Blend {
        /// Greatest distance between the programmed corner and the path in mm (G64 P); without P: `None`,
        /// what the machine is set up for.
        tolerance_mm: Option<f64>,
        /// How far a point may lie off the line through its neighbours to be left out, in mm (G64 Q): short
        /// lines are merged. Without Q: `None`, as P says; 0: nothing is merged.
        merge_mm: Option<f64>,
    },
}

/// Which way the spindle turns, seen along the tool from the spindle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SpindleDirection {
    /// M5.
    #[default]
    Stopped,
    /// M3.
    Clockwise,
    /// M4.
    CounterClockwise,
}

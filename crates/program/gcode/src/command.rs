//! Output of the interpreter: canonical commands in machine coordinates.

use std::sync::Arc;

use evolvent_path::{Curve, Move, PathMode, SurfaceSpeed};

use crate::{Call, SPINDLES, TurningCycle};

/// One canonical command, with the program line it comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct CanonicalCommand {
    /// Physical line in the file, from 1.
    pub line: u32,
    /// The action.
    pub action: Action,
    /// The line if it is in a subroutine file; `line` is then that of the call in the program.
    pub origin: Option<Origin>,
    /// The calls that led to the line.
    pub calls: CallChain,
    /// For a feed move in G95: mm per spindle revolution, or degrees if only rotary axes move. The `feed` of
    /// the move is that at the commanded spindle speed.
    pub feed_mm_rev: Option<f64>,
    /// The spindle whose revolutions `feed_mm_rev` refers to (`$` of G95).
    pub feed_spindle: u32,
    /// Continues the move of the previous command (G95 with G96, where the feed changes along a move).
    pub continues: bool,
}

/// The subroutine calls that led to a line, in shared memory. Empty in the program itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CallChain(Option<Arc<CallLink>>);

#[derive(Debug, PartialEq)]
struct CallLink {
    file: Option<Arc<str>>,
    line: u32,
    outer: CallChain,
}

impl CallChain {
    /// The chain of a subroutine that a line with this chain calls.
    pub(crate) fn called_from(&self, file: Option<Arc<str>>, line: u32) -> Self {
        Self(Some(Arc::new(CallLink {
            file,
            line,
            outer: self.clone(),
        })))
    }

    /// Whether the line is in the program itself.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_none()
    }

    /// All calls, innermost first.
    #[must_use]
    pub fn innermost_first(&self) -> Box<[Call]> {
        let mut calls = Vec::new();
        let mut chain = self;
        while let Some(link) = &chain.0 {
            calls.push(Call {
                file: link.file.as_deref().map(Box::from),
                line: link.line,
            });
            chain = &link.outer;
        }
        calls.into()
    }
}

/// A line of a subroutine file.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Origin {
    /// Path of the file.
    pub file: Arc<str>,
    /// Physical line, from 1.
    pub line: u32,
}

/// A canonical action. The commands of one line come in the order of execution of RS274/NGC (table 8), so the
/// consumer needs no modal state.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Action {
    /// Moves along a curve.
    Move(Move),
    /// Dwells (G4).
    Dwell {
        /// Duration in seconds, not negative.
        seconds: f64,
    },
    /// Selects the next tool (T); a tool changer may fetch it.
    SelectTool(u32),
    /// The machine's subroutine starts to put this tool into the spindle (M6); 0 empties the spindle. Up to
    /// the following [`Action::ChangeTool`] the tool in the spindle is unknown.
    BeginToolChange(u32),
    /// Puts this tool into the spindle (M6); 0 empties the spindle. After [`Action::BeginToolChange`] the
    /// change is complete.
    ChangeTool(u32),
    /// State of a spindle after M3, M4, M5 or a new S word.
    Spindle {
        /// Its number (`$`).
        spindle: u32,
        /// Direction of rotation, or stopped.
        direction: SpindleDirection,
        /// Commanded speed in revolutions per minute, not negative. Kept while the spindle is stopped.
        speed_rpm: f64,
    },
    /// State of the coolant after M7, M8, M9.
    Coolant {
        /// Mist coolant (M7) runs.
        mist: bool,
        /// Flood coolant (M8) runs.
        flood: bool,
    },
    /// Declares the tool in the spindle, without a change (M61).
    ToolNumber(u32),
    /// Orients a stopped spindle (M19).
    OrientSpindle {
        /// Its number (`$`).
        spindle: u32,
        /// Angle in degrees, 0 to 360.
        degrees: f64,
        /// Direction; `None` for the shorter one.
        direction: Option<SpindleDirection>,
        /// Time limit in seconds; 0 for none.
        timeout_s: f64,
    },
    /// Constant surface speed (G96): the spindle speed follows the radius, X of the tool. Repeated when
    /// offsets move the centre.
    SurfaceSpeed {
        /// Number of the spindle (`$`).
        spindle: u32,
        /// Direction of rotation, or stopped.
        direction: SpindleDirection,
        /// Surface speed, and the centre of the radius.
        surface: SurfaceSpeed,
    },
    /// A move synchronised with the spindle angle (G33, G76).
    Thread {
        /// Number of the spindle (`$`).
        spindle: u32,
        /// The path.
        curve: Curve,
        /// Path length per revolution, mm.
        pitch_mm: f64,
        /// Path control mode; rapids between the passes of G76 are [`Action::Move`]s.
        path_mode: PathMode,
        /// Spindle angle at the start, degrees from the index pulse, for multi-start threads. A continuation
        /// of another thread has the same angle.
        start_degrees: f64,
        /// X in machine coordinates at which the tool is clear of the thread (the drive line of G76), if
        /// known.
        clear_x: Option<f64>,
    },
    /// Turns a step in load-adaptive passes (a lathe's G82 Q1, G75 Q1). Starts and ends at its start
    /// position.
    Turning(TurningCycle),
    /// Rigid tapping: in with the spindle, out with the spindle reversed (G33.1). Ends at its start.
    RigidTap {
        /// Number of the spindle (`$`).
        spindle: u32,
        /// The path inwards.
        curve: Curve,
        /// Path length per revolution, mm.
        pitch_mm: f64,
        /// Spindle speed on the path outwards, relative to that inwards.
        return_factor: f64,
    },
    /// A straight move until the probe trips (G38.2 to G38.5). Report the position of contact with
    /// [`Interpreter::set_probe_result`](crate::Interpreter::set_probe_result); otherwise the program
    /// continues as without contact.
    Probe {
        /// The maximum path.
        curve: Curve,
        /// As [`Move::feed_mm_s`].
        feed_mm_s: f64,
        /// Until contact is made; otherwise until it is lost.
        toward: bool,
        /// The program stops with an error if the probe does not trip.
        must: bool,
    },
    /// Sets a digital output (M62 to M65).
    Output {
        /// Number of the output.
        index: u32,
        /// Its new state.
        on: bool,
        /// At the start of the next move instead of immediately.
        synchronised: bool,
    },
    /// Sets an analog output (M67, M68).
    AnalogOutput {
        /// Number of the output.
        index: u32,
        /// Its new value.
        value: f64,
        /// At the start of the next move instead of immediately.
        synchronised: bool,
    },
    /// Waits for an input (M66). Report its value with
    /// [`Interpreter::set_input_result`](crate::Interpreter::set_input_result) before requesting the next
    /// command; it becomes #5399. Otherwise #5399 is -1, which means a timeout.
    WaitInput {
        /// Number of the input.
        index: u32,
        /// Analog instead of digital.
        analog: bool,
        /// 0 immediate, 1 rising edge, 2 falling edge, 3 high, 4 low.
        mode: u32,
        /// Time limit in seconds.
        timeout_s: f64,
    },
    /// Overrides that are enabled (M48 to M53).
    Overrides {
        /// The feed override is enabled.
        feed: bool,
        /// The spindle override is enabled, by spindle.
        spindles: [bool; SPINDLES],
        /// Adaptive feed is enabled (M52); `None` if the program has not set it.
        adaptive: Option<bool>,
        /// Feed hold is enabled.
        feed_stop: bool,
        /// The cycle that sets them, `G84` or `G74`, instead of the program.
        cycle: Option<&'static str>,
    },
    /// A user-defined M code (M100 to M199).
    UserCommand {
        /// The number after M.
        number: u32,
        /// P word.
        p: Option<f64>,
        /// Q word.
        q: Option<f64>,
    },
    /// `(PRINT, text)`: a line for standard output.
    Print(String),
    /// `(LOG, text)` and the comments that open and close the file: a line for a log file.
    Log(LogAction),
    /// Waits for the operator (M0, M1, M60).
    ProgramStop {
        /// M1: only if the operator has enabled the optional stop.
        optional: bool,
        /// M60: with pallet change.
        pallet: bool,
    },
    /// End of the program (M2, M30, a closing `%` or the end of the text). Nothing follows.
    ProgramEnd,
    /// Shows a text to the operator: `(MSG, text)`. Control characters have been removed.
    Message(String),
    /// A warning for the operator: the line is valid but probably not intended.
    Warning(String),
}

/// Operations of log comments.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LogAction {
    /// `(LOGOPEN, file)`: creates a file.
    Open(String),
    /// `(PROBEOPEN file)`: creates a separate file for the positions of probing moves with contact, in
    /// program coordinates and units: #5061 to #5069.
    OpenProbes(String),
    /// `(LOGAPPEND, file)`: appends to a file.
    Append(String),
    /// `(LOG, text)`.
    Line(String),
    /// `(LOGCLOSE)`.
    Close,
    /// `(PROBECLOSE)`.
    CloseProbes,
}

/// Direction of rotation of the spindle, seen along the tool from the spindle.
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

//! What the interpreter hands on: canonical commands in machine coordinates.

use std::sync::Arc;

use evolvent_path::{Curve, Move, PathMode, SurfaceSpeed};

use crate::{Call, TurningCycle};

/// One canonical command and the line of the program that asked for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    /// Physical line in the file, from 1.
    pub line: u32,
    /// What is to be done.
    pub action: Action,
    /// Where the line stands, if it is in a file of a subroutine; `line` is that of the call in the program then.
    pub origin: Option<Origin>,
    /// The calls that have led to the line.
    pub calls: CallChain,
    /// Of a feed move in G95: mm, or degrees where only rotary axes move, per revolution of the spindle. The `feed` of the move is
    /// the one at the spindle's commanded speed.
    pub feed_per_revolution: Option<f64>,
}

/// The calls of subroutines that have led to a line, shared by all that tell of it. Empty in the program itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CallChain(Option<Arc<CallLink>>);

#[derive(Debug, PartialEq)]
struct CallLink {
    file: Option<Arc<str>>,
    line: u32,
    outer: CallChain,
}

impl CallChain {
    /// The chain of a subroutine that is called from a line with this chain.
    pub(crate) fn and_from(&self, file: Option<Arc<str>>, line: u32) -> Self {
        Self(Some(Arc::new(CallLink {
            file,
            line,
            outer: self.clone(),
        })))
    }

    /// Every call, the innermost first.
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

/// A line of a file of a subroutine.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Origin {
    /// Path of the file.
    pub file: Arc<str>,
    /// Physical line, from 1.
    pub line: u32,
}

/// What a machine can be asked to do. Commands of one line come in the order of execution of RS274/NGC
/// (table 8), so that whoever carries them out needs no modal state of his own.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
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
    /// The machine's subroutine begins to put this tool into the spindle (M6); 0 empties the spindle. Which tool is in the
    /// spindle is not known from here to [`Action::ChangeTool`].
    BeginToolChange(u32),
    /// Put this tool into the spindle (M6); 0 empties the spindle. After [`Action::BeginToolChange`] it is done.
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
    /// The tool in the spindle is this one, without a change (M61).
    ToolNumber(u32),
    /// Turn the stopped spindle to an angle (M19).
    OrientSpindle {
        /// In degrees, 0 to 360.
        degrees: f64,
        /// The way; `None` for the shorter one.
        direction: Option<SpindleDirection>,
        /// Longest wait for it in seconds; 0 for none.
        timeout_s: f64,
    },
    /// Constant surface speed (G96): the spindle's speed follows the radius, X of the tool. Again where offsets move the centre.
    SurfaceSpeed {
        /// Sense of rotation, or stopped.
        direction: SpindleDirection,
        /// The speed of the surface, and where it is measured from.
        surface: SurfaceSpeed,
    },
    /// A move in step with the spindle's angle (G33, G76).
    Thread {
        /// Where to.
        curve: Curve,
        /// Path length per revolution, mm.
        pitch_mm: f64,
        /// Rapids between the passes of G76 are [`Action::Move`]s.
        path_mode: PathMode,
        /// Angle of the spindle at which it begins, degrees from the index pulse: threads of several starts. A piece that goes on
        /// with another has that one's.
        start_degrees: f64,
    },
    /// Turn a step, in passes that the cutting load finds (a lathe's G82 Q1, G75 Q1). Begins and ends at its start.
    Turning(TurningCycle),
    /// In with the spindle, out with the spindle reversed (G33.1). Ends where it began.
    RigidTap {
        /// The way in.
        curve: Curve,
        /// Path length per revolution, mm.
        pitch_mm: f64,
        /// Spindle speed on the way out, as a multiple of that on the way in.
        return_factor: f64,
    },
    /// A straight move until the probe trips (G38.2 to G38.5). Where it did is told by
    /// [`Interpreter::answer_probe`](crate::Interpreter::answer_probe); otherwise the program goes on as if there had been no
    /// contact.
    Probe {
        /// Where to at the most.
        curve: Curve,
        /// As [`Move::feed`].
        feed: f64,
        /// Until contact is made; otherwise until it is lost.
        toward: bool,
        /// If the probe does not trip, the program stops with an error.
        must: bool,
    },
    /// A digital output (M62 to M65).
    Output {
        /// Which.
        index: u32,
        /// Its new state.
        on: bool,
        /// With the beginning of the next move, not at once.
        synchronised: bool,
    },
    /// An analogue output (M67, M68).
    AnalogOutput {
        /// Which.
        index: u32,
        /// Its new value.
        value: f64,
        /// With the beginning of the next move, not at once.
        synchronised: bool,
    },
    /// Wait for an input (M66). Its value goes to #5399 if whoever carries this out tells it before asking for the next
    /// command ([`Interpreter::answer_input`](crate::Interpreter::answer_input)); otherwise #5399 is -1, which stands for a
    /// timeout.
    WaitInput {
        /// Which.
        index: u32,
        /// Analogue, not digital.
        analog: bool,
        /// 0 at once, 1 rise, 2 fall, 3 high, 4 low.
        mode: u32,
        /// Longest wait in seconds.
        timeout_s: f64,
    },
    /// What the operator and other programs may do while the program runs (M48 to M53).
    Overrides {
        /// Feed override counts.
        feed: bool,
        /// Spindle override counts.
        spindle: bool,
        /// Adaptive feed is on (M52); none where the program has not said.
        adaptive: Option<bool>,
        /// Feed stop counts.
        feed_stop: bool,
        /// The cycle that switches them, not the program: `G84` or `G74`.
        cycle: Option<&'static str>,
    },
    /// The machine's own command (M100 to M199).
    UserCommand {
        /// The number after M.
        number: u32,
        /// P word.
        p: Option<f64>,
        /// Q word.
        q: Option<f64>,
    },
    /// `(PRINT, text)`: a line for the standard output.
    Print(String),
    /// `(LOG, text)` and what opens and closes the file: a line for a file of the user's.
    Log(LogAction),
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
    /// The line is right but probably not what was meant: tell the operator.
    Warning(String),
}

/// What log comments ask for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LogAction {
    /// `(LOGOPEN, file)`: begin a new file.
    Open(String),
    /// `(PROBEOPEN file)`: begin a new file of its own for the positions of probing moves that met something, in program
    /// coordinates and units: #5061 to #5069.
    OpenProbes(String),
    /// `(LOGAPPEND, file)`: go on in a file.
    Append(String),
    /// `(LOG, text)`.
    Line(String),
    /// `(LOGCLOSE)`.
    Close,
    /// `(PROBECLOSE)`.
    CloseProbes,
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

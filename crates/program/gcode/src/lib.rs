//! RS274/NGC interpreter: program text in, a lazy stream of canonical commands out, and errors with their
//! position.
//!
//! Input: text from any [`BufRead`](std::io::BufRead) and [`Settings`]. Output: an iterator over
//! [`CanonicalCommand`]s in machine coordinates, and [`Diagnostic`]s.
//!
//! ```
//! use evolvent_gcode::{Action, Interpreter, Settings};
//!
//! let program = "G21 G90\nG1 X10 F600\nG2 X20 I5\nM2\n";
//! let commands = Interpreter::new(program.as_bytes(), Settings::default());
//! let mut lengths = Vec::new();
//! for command in commands {
//!     if let Action::Move(path) = command?.action {
//!         lengths.push(path.curve.length());
//!     }
//! }
//! assert_eq!(lengths.len(), 2);
//! assert!((lengths[1] - 5.0 * std::f64::consts::PI).abs() < 1e-9);
//! # Ok::<(), evolvent_gcode::Diagnostic>(())
//! ```
//!
//! # Model
//!
//! ```text
//! bytes ─► lines ─► O-words ─► words ─────► codes and words ─► commands
//!         syntax    interpreter syntax      codes, syntax      execution, with state and parameters
//! ```
//!
//! [`Interpreter`] reads one line at a time. O-words select the next line: the lines of an active loop are
//! stored, subroutines are kept in a library. Words are evaluated while they are read, from
//! [parameters](Interpreter::parameter) and expressions. Codes are sorted into modal groups, the other words
//! to the codes that use them; then the line is executed in the order of RS274/NGC, table 8.
//!
//! | module | contents |
//! |---|---|
//! | `syntax` | lines, tokens, words, expressions, comments; which word belongs to which code |
//! | `codes` | G and M codes, modal groups |
//! | `parameters` | numbered and named parameters, system parameters |
//! | `state` | modal state, settings, outputs |
//! | `execution` | lines, arcs, splines, holes, offsets, cutter compensation, canned cycles |
//! | `interpreter` | O-words, subroutines, restart at a line |
//! | `tables` | tool table and parameter file |
//! | `diagnostics` | errors, advice, equivalents of other dialects |
//!
//! Commands are free of modes: a [`Move`] carries a curve in machine coordinates in mm and degrees, a speed
//! in mm/s and the path control mode, so planners know no units, planes, offsets, cycles or cutter radius. In
//! G95 the feed of a move is that at the commanded spindle speed, and the [`CanonicalCommand`] has the feed
//! per revolution; in G96 such a move is divided into pieces of nearly constant speed.
//!
//! # Guarantees
//!
//! No input panics. A line is executed completely or not at all: after an error modal state and parameters
//! are those before it, so the following errors can be found, without those that follow from it alone. Memory
//! is bounded by the settings. The commands depend only on the text, the settings and the results of inputs
//! and probes. Nothing here is real-time safe: it allocates.
//!
//! # Where to read on
//!
//! `docs/SPECNOTES.md` for what the standard leaves open and where LinuxCNC differs; `tools/compare-rs274`
//! compares both interpreters; `interpreter/mod.rs`, then `execution/execute.rs`.

mod codes;
mod command;
mod diagnostics;
mod execution;
mod interpreter;
mod parameters;
mod state;
mod syntax;
mod tables;

pub use codes::code::Code;
pub use command::{Action, CallChain, CanonicalCommand, LogAction, Origin, SpindleDirection};
pub use diagnostics::diagnostic::{Call, Diagnostic};
pub use evolvent_path::{Move, MoveKind, PathMode};
pub use execution::cycles::turning::{TurningCycle, TurningKind};
pub use interpreter::Interpreter;
pub use interpreter::control_flow::LoopStart;
pub use interpreter::modal::Modal;
pub use interpreter::restart::{Approach, Restart};
pub use state::outputs::{Outputs, SPINDLES, SpindleOutput};
pub use state::settings::{
    ArcTolerance, MachineFeatures, MdiPreamble, ProgramLimits, RotaryDirection, Settings, StartOffsets,
    ToolChanger, TurningWords, WORK_OFFSETS,
};
pub use tables::parameter_file::{ParameterFileError, PersistentParameters};
pub use tables::store::{StoreError, replace_file};
pub use tables::tools::{Tool, ToolTable, ToolTableError};

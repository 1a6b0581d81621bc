//! RS274/NGC: text in, a lazy stream of canonical commands out, errors with their place.
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
//! ```text
//! bytes ─► lines ─► O-words ─► words ─────► codes and words ─► commands
//!         syntax    interpreter syntax      codes, syntax      execution, with state and parameters
//! ```
//!
//! [`Interpreter`] is an iterator and reads one line at a time. O-words decide which line is next: the lines of a running
//! loop are kept, subroutines are held in a library. Words get their values while they are read, from
//! [parameters](Interpreter::parameter) and formulas. Codes are sorted into modal groups and the other words to the codes
//! that use them; then the line is executed in the order of RS274/NGC, table 8. A line counts as a whole: after an error
//! modal state and parameters are those before it, so the next error can be found.
//!
//! | module | contents |
//! |---|---|
//! | `syntax` | lines, tokens, words, formulas, comments; which word belongs to which code |
//! | `codes` | G and M codes, modal groups |
//! | `parameters` | numbered and named parameters, values of the system |
//! | `state` | modal state, settings, outputs |
//! | `execution` | lines, arcs, splines, holes, offsets, cutter compensation, canned cycles |
//! | `interpreter` | O-words, subroutines, restart at a line |
//! | `tables` | tool table and parameter file |
//! | `diagnostics` | errors, hints, what other dialects mean |
//!
//! What comes out is free of modes: a [`Move`] carries a curve in machine coordinates in mm and degrees, a speed in mm/s
//! and the path mode, so planners know nothing of units, planes, offsets, cycles or the cutter's radius.
//! Along moves in G95 the feed is that at the commanded speed of the spindle, and the [`Command`] tells the feed per
//! revolution; in G96 such a move comes in pieces of nearly one speed.
//!
//! Where the standard is silent, or LinuxCNC does otherwise, `docs/SPECNOTES.md` says what happens here;
//! `tools/compare-rs274` compares both interpreters. Nothing here is for the real-time cycle: it allocates.

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
pub use command::{Action, CallChain, Command, LogAction, Origin, SpindleDirection};
pub use diagnostics::diagnostic::{Call, Diagnostic};
pub use evolvent_path::{Move, MoveKind, PathMode};
pub use execution::cycles::turning::{TurningCycle, TurningKind};
pub use interpreter::Interpreter;
pub use interpreter::modal::Modal;
pub use interpreter::restart::{Approach, Restart};
pub use state::outputs::Outputs;
pub use state::settings::{ArcTolerance, Settings, ToolChanger, TurningWords, WORK_OFFSETS};
pub use tables::parameter_file::{KeptParameters, ParameterFileError};
pub use tables::store::{StoreError, replace_file};
pub use tables::tools::{Tool, ToolTable, ToolTableError};

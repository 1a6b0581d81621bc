//! RS274/NGC: text in, a lazy stream of canonical commands out, errors with their place.
//!
//! ```text
//! bytes ─► lines ─► O-words ─► words ─► plan of the line ─► commands
//!         reader    flow       parser   statement           execute: order of execution, modal state,
//!         bounded   tape       formulas codes, groups       motion, round, spline, cycles, compensation
//! ```
//!
//! [`Interpreter`] is an iterator. It reads one line at a time. O-words decide which line is next: a running loop's
//! lines are kept on a tape, subroutines in a library, everything else passes by. Words get their values while
//! they are read, from [parameters](Interpreter::parameter) and formulas; the codes are sorted into modal groups and
//! the other words to the codes that use them; only then the line is executed, in the order of RS274/NGC, table 8.
//! A line counts as a whole: after an error modal state and parameters are those before it, so one can go on and find
//! the next error.
//!
//! What comes out is free of modes: [`Move`]s carry a curve in machine coordinates in mm and degrees, a speed in mm/s
//! and the path mode; planners need not know about units, planes, offsets, cycles or the cutter's radius. What the
//! core cannot do yet comes out too, and [`Action::unsupported_feature`] says so: whoever moves a machine refuses it.
//!
//! Where the standard is silent, or LinuxCNC does otherwise, `docs/SPECNOTES.md` says what happens here;
//! `tools/compare-rs274` holds both interpreters against each other.
//!
//! Nothing here is for the real-time cycle.

mod block;
mod calls;
mod capture;
mod code;
mod codes;
mod command;
mod comment;
mod compensation;
mod cycles;
mod diagnostic;
mod effects;
mod execute;
mod expression;
mod flow;
mod foreign;
mod hints;
mod hole;
mod interpreter;
mod kept;
mod lexer;
mod lines;
mod modal;
mod motion;
mod names;
mod offset_path;
mod offsets;
mod outputs;
mod parameters;
mod parser;
mod profile;
mod reader;
mod restart;
mod roughing;
mod round;
mod scope;
mod settings;
mod spline;
mod state;
mod statement;
mod store;
mod system;
mod tools;
mod turning;
mod word_faults;

pub use code::Code;
pub use command::{Action, Command, LogAction, Move, MoveKind, Origin, PathMode, SpindleDirection};
pub use diagnostic::{Call, Diagnostic};
pub use interpreter::Interpreter;
pub use kept::{KeptParameters, ParameterFileError};
pub use modal::Modal;
pub use outputs::Outputs;
pub use restart::{Approach, Restart};
pub use settings::{ArcTolerance, Settings, TurningWords, WORK_OFFSETS};
pub use store::StoreError;
pub use tools::{Tool, ToolTable, ToolTableError};
pub use turning::{TurningCycle, TurningKind};

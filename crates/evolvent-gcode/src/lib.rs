//! RS274/NGC: text in, a lazy stream of canonical commands out, errors with their place.
//!
//! ```text
//! bytes ─► lines ─► block ─► plan of the line ─► commands
//!         reader    parser   codes, groups,      interpreter:
//!         bounded   words    who uses which word modal state, order of execution
//! ```
//!
//! [`Interpreter`] is an iterator. It reads one line at a time, parses it to words (the parser knows letters,
//! numbers and comments, but no G code), sorts the codes into modal groups and the other words to the codes that
//! use them, and only then executes, in the order of RS274/NGC, table 8. Until a line has gone through without
//! an error nothing of it counts: the modal state is changed by whole lines only, so one can go on after an
//! error and find the next.
//!
//! What comes out is free of modes: [`Move`]s carry a curve in machine coordinates in mm and degrees, a speed in
//! mm/s and the path mode; planners need not know about units, planes, offsets or feed modes.
//!
//! Values are expressions in the syntax tree although only literals exist now: parameters, formulas and O-words
//! fit between parser and interpreter. Where the standard is silent, or LinuxCNC does otherwise,
//! `docs/SPECNOTES.md` says what happens here.
//!
//! Nothing here is for the real-time cycle.

mod block;
mod code;
mod codes;
mod command;
mod comment;
mod compensation;
mod cycles;
mod diagnostic;
mod execute;
mod expression;
mod flow;
mod hole;
mod interpreter;
mod lexer;
mod lines;
mod motion;
mod names;
mod offsets;
mod parameters;
mod parser;
mod reader;
mod restart;
mod round;
mod scope;
mod settings;
mod spline;
mod state;
mod statement;
mod system;
mod tools;

pub use code::Code;
pub use command::{Action, Command, LogAction, Move, MoveKind, PathMode, SpindleDirection};
pub use diagnostic::Diagnostic;
pub use interpreter::Interpreter;
pub use restart::Restart;
pub use settings::{ArcTolerance, Settings, WORK_OFFSETS};
pub use tools::{Tool, ToolTable, ToolTableError};

//! Operating the machine: which command is allowed when, what it does, and what is said if it is not.
//!
//! ```text
//!   request ──► serial ──► decode ──► interlocks ──► Command, to be carried out
//!               newer?     numbers    one table      and committed
//! ```
//!
//! [`Desk`] is the operator's desk of one machine: e-stop, off or on; manual, MDI or automatic; what moves the axes; the
//! overrides and switches; the latched alarms. It looks at no clock and touches nothing: time and facts come in as
//! arguments, and what is to be done comes out as a [`Command`]. So every scenario can be tried in microseconds.
//!
//! The interlocks are one table, [`RULES`]: a row a command, with the machine states, modes and activities in which it
//! is accepted and what else it needs. Everything that is refused has a stable number and a sentence ([`Alarm`],
//! [`Refusal`]).
//!
//! [`Homing`] is the sequence that finds machine zero with the switches of the drives; [`DeadMan`] ends a jog whose
//! client has gone.
//!
//! Nothing here is for the real-time cycle.

mod alarm;
mod code;
mod command;
mod dead_man;
mod decode;
mod desk;
mod homing;
mod refusal;
mod rules;
mod serials;
mod situation;

pub use alarm::{Alarm, AlarmKind};
pub use code::CommandCode;
pub use command::{Command, JogCommand, ToolEntry};
pub use dead_man::DeadMan;
pub use decode::RawCommand;
pub use desk::{Desk, Facts, JobResult, Verdict};
pub use homing::{Homing, HomingAction, HomingAxis, HomingSample};
pub use refusal::Refusal;
pub use rules::{RULES, Rule, judge};
pub use serials::Serials;
pub use situation::{Activity, MachineState, Mode, Situation};

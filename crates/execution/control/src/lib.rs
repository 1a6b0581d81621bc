//! Operating the machine: which command is allowed when, what it does, and what is said if it is not.
//!
//! ```text
//!   request ──► serial ──► decode ──► interlocks ──► Command, to be carried out
//!               newer?     numbers    one table      and committed
//! ```
//!
//! [`OperatorState`] is the operator's desk of one machine: e-stop, off or on; manual, MDI or automatic; what moves the axes; the
//! overrides and switches; the latched alarms. It looks at no clock and touches nothing: time and facts come in as
//! arguments, and what is to be done comes out as a [`Command`]. So every scenario can be tried in microseconds.
//!
//! The interlocks are one table, [`RULES`]: a row a command, with the machine states, modes and activities in which it
//! is accepted and what else it needs. Everything that is refused has a stable number and a sentence ([`Alarm`],
//! [`Rejection`]).
//!
//! [`Homing`] is the sequence that finds machine zero with the switches of the drives; [`JogEnable`] ends a jog whose
//! client has gone.
//!
//! Nothing here is for the real-time cycle.

mod alarm;
mod code;
mod command;
mod decode;
mod homing;
mod interlock_state;
mod jog_enable;
mod operator_state;
mod rejection;
mod rules;
mod serials;

pub use alarm::{Alarm, AlarmKind};
pub use code::CommandCode;
pub use command::{Command, JogCommand, ToolEntry};
pub use decode::RawCommand;
pub use homing::{Homing, HomingAction, HomingAxis, HomingSample};
pub use interlock_state::{Activity, InterlockState, MachineState, Mode};
pub use jog_enable::JogEnable;
pub use operator_state::{JobResult, OperatorInputs, OperatorState, Verdict};
pub use rejection::Rejection;
pub use rules::{RULES, Rule, judge};
pub use serials::Serials;

//! Operating the machine: which command is accepted when, what it does, and why it is rejected.
//!
//! ```text
//!   request ──► serial ──► decode ──► interlocks ──► OperatorCommand, to be carried out
//!               newer?     numbers    one table      and committed
//! ```
//!
//! [`OperatorState`] is the operator's view of one machine: e-stop, off or on; manual, MDI or automatic; the
//! job that moves the axes; overrides and switches; latched alarms. It reads no clock and does no I/O: time
//! and inputs are arguments, and the result is a [`OperatorCommand`] to execute. Every scenario therefore runs in
//! microseconds.
//!
//! ```
//! use evolvent_control::{Alarm, CommandCode, OperatorInputs, OperatorState, RawCommand};
//! use evolvent_path::AxisMask;
//!
//! let mut state = OperatorState::default();
//! let inputs = OperatorInputs { present: AxisMask::from_bits(0b111), ..OperatorInputs::default() };
//! let request = |code: CommandCode| RawCommand {
//!     command: code as u32,
//!     axes_mask: 0,
//!     index: 0,
//!     amount: 0.0,
//!     values: [0.0; 9],
//!     text: Some(""),
//! };
//!
//! // At power-up the machine is in emergency stop: it has to be reset before drives can be enabled.
//! let (_, rejection) = state.authorize(7, 1, &request(CommandCode::On), &inputs).unwrap_err();
//! assert_eq!(rejection.alarm, Alarm::InEstop);
//!
//! let reset = state.authorize(7, 2, &request(CommandCode::EstopReset), &inputs).unwrap();
//! state.commit(&reset, 0, false);
//! assert!(state.authorize(7, 3, &request(CommandCode::On), &inputs).is_ok());
//!
//! // A serial number that is not newer has no effect.
//! let (_, rejection) = state.authorize(7, 3, &request(CommandCode::On), &inputs).unwrap_err();
//! assert_eq!(rejection.alarm, Alarm::Stale);
//! ```
//!
//! The interlocks are one table, [`RULES`], with a row for each command: the machine states, modes and
//! activities in which it is accepted, and its other conditions. Every rejection has a stable number and a
//! sentence ([`Alarm`], [`Rejection`]).
//!
//! [`Homing`] is the sequence that finds machine zero with the switches and index pulses of the drives.
//! [`JogEnable`] ends a jog whose client no longer renews it. [`Handwheel`] converts counts of the wheel to
//! distances.
//!
//! Nothing in this crate is for the real-time cycle.

mod alarm;
mod axis_homing;
mod command;
mod command_code;
mod decode;
mod handwheel;
mod homing;
mod interlock_state;
mod interlocks;
mod jog_enable;
mod operator_state;
mod rejection;
mod serials;

pub use alarm::{Alarm, AlarmKind};
pub use command::{JogCommand, OperatorCommand, ToolEntry};
pub use command_code::CommandCode;
pub use decode::RawCommand;
pub use handwheel::{Handwheel, HandwheelReading};
pub use homing::{Homing, HomingAction, HomingAxis, HomingSample};
pub use interlock_state::{Activity, InterlockState, MachineState, Mode};
pub use interlocks::{RULES, Rule, judge};
pub use jog_enable::JogEnable;
pub use operator_state::{CommandVerdict, JobResult, OperatorInputs, OperatorState};
pub use rejection::Rejection;
pub use serials::Serials;

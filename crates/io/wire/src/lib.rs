//! The messages of the bus, without the transport.
//!
//! Plain structs in; the same bytes in Rust, C and Python out. A payload is a `repr(C)` struct of integers and floats:
//! interface version and size first, reserved fields last, no gaps, no pointers. One macro generates each struct and
//! its [`StructLayout`], from which `evolvent-bus` generates the C header and the Python module.
//!
//! ```
//! use evolvent_wire::{Payload, Setpoint, flags};
//!
//! let setpoint = Setpoint {
//!     sequence: 7,
//!     flags: flags::LAST,
//!     ..Setpoint::default()
//! };
//! assert!(setpoint.is_compatible());
//! assert_eq!(Setpoint::LAYOUT.size_bytes, 400);
//!
//! // A sender of another version is not compatible; receivers drop its message.
//! assert!(!Setpoint { interface_version: 2, ..setpoint }.is_compatible());
//! ```
//!
//! | message | from, to | contents |
//! |---|---|---|
//! | [`Setpoint`] | core to bridge | position and its derivatives at one instant |
//! | [`Feedback`] | bridge to core | the drives' actual values for one setpoint |
//! | [`Load`] | sensor to core | a measured cutting load |
//! | [`MachineOutputs`] | core to bridge | outputs, spindles, coolant and tool, and the setpoint from which they count |
//! | [`MachineInputs`] | bridge to core | digital and analog inputs and the probe at one instant |
//! | [`SpindleFeedback`] | bridge to core | angle and speed of one spindle at one instant |
//! | [`Status`] | core to screens | one coherent snapshot |
//! | [`EventKind`] | core to sleeping clients | a number that wakes them |
//! | [`ControlRequest`], [`ControlAnswer`] | client and core | a command and its result |
//!
//! Lists such as [`STATES`] name every number of a field; [`flags`], [`switches`] and [`spindle_flags`] name single bits.
//!
//! The crate has no dependencies and never allocates; everything is real-time safe. `evolvent-bus` enables the
//! feature `zero-copy`, which implements the marker trait that iceoryx2 requires of its payloads. The meaning of every
//! field is part of the contract, `docs/contract.md`.

mod control;
mod event;
mod feedback;
mod layout;
mod setpoint;
mod signals;
mod status;

pub use control::{
    ACTIVITIES, ANSWER_TEXT_BYTES, COMMAND_TEXT_BYTES, COMMANDS, ControlAnswer, ControlRequest, JOB_RESULTS,
    MACHINE_STATES, MODES, SWITCHES, VERDICTS, switches,
};
pub use event::EventKind;
pub use feedback::{BRIDGE_NOTES, BRIDGE_STATES, Feedback, LOAD_KINDS, Load};
pub use layout::{AXES, FieldLayout, Payload, Scalar, StructLayout};
pub use setpoint::{POWER_REQUESTS, SETPOINT_FLAGS, STATES, Setpoint, flags};
pub use signals::{
    ANALOG_SIGNALS, DIGITAL_SIGNALS, MachineInputs, MachineOutputs, PROBE_STATES, SPINDLE_DIRECTIONS,
    SPINDLE_FLAGS, SPINDLE_WAYS, SPINDLES, SpindleFeedback, spindle_flags,
};
pub use status::{MAX_ALARMS, MAX_MODAL_CODES, SENTENCE_BYTES, SpindleReading, Status, TEXT_BYTES};

/// Version of the contract: raised with every change of a payload's layout or meaning.
pub const INTERFACE_VERSION: u32 = 1;

//! Message types and services over iceoryx2.
//!
//! One machine is one folder of services in shared memory, `evolvent/NAME/CHANNEL`. Its one core opens them with
//! [`CoreBus`]; bridges, screens and loggers, in any number and language, with [`ClientBus`] or iceoryx2's own
//! bindings and the generated header or module in `tools/`.
//!
//! ```text
//!   core ── Setpoint ──► bridge      every period, in order, ahead of its due time
//!   core ── Status ────► screen      the latest snapshot only
//!   core ── event ─────► sleepers    a number that wakes
//!   core ◄── Feedback ── bridge      the drives' answer to one setpoint
//!   core ◄── Load ────── sensor      cutting force, torque, power, current
//!   core ◄── control ──► operator    a command with a serial number, answered accepted or rejected
//! ```
//!
//! Payloads are plain numbers in a fixed layout: version and size first, room for later at the end, no gap, no pointer.
//! Version, period and axes also stand in the services' attributes, so a client that does not fit fails when it
//! opens and not when it moves.
//!
//! The core never waits for a reader: one that lags behind by more than its buffer loses the oldest and sees a
//! gap in the sequence. Who is killed leaves files; whoever opens next clears them away. One name, one core.
//!
//! This is the only crate that names iceoryx2. The control service has ports of its own, [`ControlServer`] and
//! [`ControlClient`], so that commands need not pass through the thread that publishes setpoints.

mod bindings;
mod client_bus;
mod config;
mod control;
mod control_bus;
mod core_bus;
mod descriptors;
mod domain;
mod error;
mod event;
mod feedback;
mod folder;
mod layout;
mod name;
mod node_counter;
mod setpoint;
mod stale_resources;
mod status;

pub use bindings::{c_header, python_module};
pub use client_bus::{
    ClientBus, EventReader, FeedbackReader, FeedbackSender, LoadSender, SetpointReader, StatusReader,
};
pub use config::{BusConfig, ClientConfig, MAX_SETPOINT_BUFFER, PLACES_FOR_BRIDGES, PLACES_FOR_OPERATORS};
pub use control::{
    ACTIVITIES, ANSWER_TEXT_BYTES, COMMAND_TEXT_BYTES, COMMANDS, ControlAnswer, ControlRequest, JOB_RESULTS,
    MACHINE_STATES, MODES, SWITCHES, VERDICTS,
};
pub use control_bus::{CommandError, ControlCall, ControlClient, ControlServer};
pub use core_bus::CoreBus;
pub use domain::{
    ATTRIBUTE_AXES, ATTRIBUTE_INTERFACE, ATTRIBUTE_PERIOD, cores_of_other_users, list_machines,
    remove_private_domain,
};
pub use error::{BusError, ReceiveError, SendError};
pub use event::EventKind;
pub use feedback::{BRIDGE_NOTES, BRIDGE_STATES, Feedback, LOAD_KINDS, Load};
pub use folder::{RUNTIME_FOLDER, bus_folders};
pub use layout::{AXES, FieldLayout, Payload, Scalar, StructLayout};
pub use name::{Channel, MAX_MACHINE_NAME, NameError, check_machine_name};
pub use setpoint::{POWER_REQUESTS, SETPOINT_FLAGS, STATES, Setpoint};
pub use status::{MAX_ALARMS, MAX_MODAL_CODES, SENTENCE_BYTES, Status, TEXT_BYTES};

/// Version of the contract: raised with every change of a payload's layout or meaning.
pub const INTERFACE_VERSION: u32 = 1;

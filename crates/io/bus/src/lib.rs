//! Services over iceoryx2: the transport of the messages.
//!
//! One machine is one folder of services in shared memory, `evolvent/NAME/CHANNEL`. Its one core opens them
//! with [`CoreBus`]; bridges, screens and loggers, in any number and language, with [`ClientBus`] or
//! iceoryx2's own bindings and the generated header or module in `tools/`.
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
//! ```
//! use std::time::Duration;
//!
//! use evolvent_bus::{BusConfig, ClientBus, ClientConfig, CoreBus, Setpoint, remove_private_domain};
//!
//! // A prefix of one's own keeps these two apart from all others.
//! let prefix = Some(format!("doc{}_", std::process::id()));
//! let mut core = CoreBus::open(&BusConfig {
//!     prefix: prefix.clone(),
//!     ..BusConfig::new("mill", "XYZ", 1_000_000)
//! })?;
//! let client = ClientBus::open(&ClientConfig {
//!     prefix: prefix.clone(),
//!     ..ClientConfig::new("mill")
//! })?;
//! let mut reader = client.setpoints()?;
//! core.wait_for_setpoint_subscribers(1, Duration::from_secs(10));
//! let sent = Setpoint {
//!     sequence: 7,
//!     ..Setpoint::default()
//! };
//! core.publish_setpoint(&sent)?;
//! assert_eq!(reader.receive()?, Some(sent));
//! drop((reader, client, core));
//! remove_private_domain(&prefix.unwrap_or_default())?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//! The messages themselves are in `evolvent-wire`, re-exported here: plain numbers in a fixed layout.
//! Version, period and axes are also attributes of the services, so a client that does not match fails when
//! it opens, before anything moves.
//!
//! The core never waits for a reader: readers that lag behind by more than their buffer lose the oldest
//! samples and see a gap in the sequence. A killed process leaves files; the next one that opens removes
//! them. Each name belongs to one core.
//!
//! This is the only crate that calls iceoryx2. The control service has separate ports, [`ControlServer`] and
//! [`ControlClient`], so commands do not pass through the thread that publishes setpoints.

mod bindings;
mod client_bus;
mod config;
mod control_bus;
mod core_bus;
mod deadline;
mod descriptors;
mod discovery;
mod domain;
mod error;
mod folder;
mod name;
mod node_counter;
mod open_failure;
mod private_domain;
mod samples;
mod stale_resources;

pub use bindings::{c_header, python_module};
pub use client_bus::{
    ClientBus, EventReader, EveryStatusReader, FeedbackReader, FeedbackSender, InputReader, InputSender,
    LoadReader, LoadSender, OutputReader, SetpointReader, SpindleReader, SpindleSender, StatusReader,
};
pub use config::{
    BusConfig, ClientConfig, MAX_SETPOINT_BUFFER, PLACES_FOR_BRIDGES, PLACES_FOR_OPERATORS, STATUS_BUFFER,
};
pub use control_bus::{CommandError, ControlCall, ControlClient, ControlServer};
pub use core_bus::CoreBus;
pub use discovery::{cores_of_other_users, list_machines};
pub use domain::{ATTRIBUTE_AXES, ATTRIBUTE_INTERFACE, ATTRIBUTE_PERIOD};
pub use error::{BusError, ReceiveError, SendError};
pub use folder::{RUNTIME_FOLDER, bus_folders, writable_folders};
pub use name::{Channel, MAX_MACHINE_NAME, NameError, check_machine_name};
pub use private_domain::remove_private_domain;

pub use evolvent_wire::{
    ACTIVITIES, ANALOG_SIGNALS, ANSWER_TEXT_BYTES, AXES, BRIDGE_NOTES, BRIDGE_STATES, COMMAND_TEXT_BYTES,
    COMMANDS, ControlAnswer, ControlRequest, DIGITAL_SIGNALS, EventKind, Feedback, FieldLayout,
    INTERFACE_VERSION, JOB_RESULTS, LOAD_KINDS, Load, MACHINE_STATES, MAX_ALARMS, MAX_MODAL_CODES, MODES,
    MachineInputs, MachineOutputs, POWER_REQUESTS, PROBE_STATES, Payload, SENTENCE_BYTES, SETPOINT_FLAGS,
    SPINDLE_DIRECTIONS, SPINDLE_FLAGS, SPINDLE_WAYS, SPINDLES, STATES, SWITCHES, Scalar, Setpoint,
    SpindleFeedback, SpindleReading, Status, StructLayout, TEXT_BYTES, VERDICTS, flags, spindle_flags,
    switches,
};

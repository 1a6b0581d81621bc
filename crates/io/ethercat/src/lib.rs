//! A drive bridge to EtherCAT: CiA 402 drives by cyclic synchronous position.
//!
//! ```text
//!   bus ── Setpoint ──► bus thread ══ queue ══► cycle: Follower ── target ─► Cia402 ──► process data ──► EtherCAT
//!    ▲                      ▲                                                                            │
//!    └───── Feedback ───────┴═════ queue ═══════ drives' positions, status words, switches ◄─────────────┘
//!   bus ── MachineOutputs ──► OutputFollower ── bits and numbers ──► terminals ── MachineInputs ──► bus, by the same queues
//! ```
//!
//! [`Network`] is a network file: devices with identity, start-up objects, and the axis of each drive with
//! its [`Scale`], an exact fraction:
//!
//! ```
//! use evolvent_ethercat::Network;
//!
//! let network = Network::parse(
//!     "device = [{ name = \"x\", vendor = 1, product = 2, axis = { letter = \"X\", increments_per_turn = 1048576, turn_mm = 5 } }]",
//!     "network.toml",
//! )?;
//! let axis = network.devices[0].axis.expect("an axis");
//! assert_eq!(axis.scale.fraction(), (1_048_576, 5));
//! # Ok::<(), evolvent_config::ConfigError>(())
//! ```
//!
//! [`scan`] lists the devices on the wire, and [`network_text`] writes a network file to start from.
//!
//! [`run`] is the bridge. The MainDevice is `ethercrab`, driven by the thread of the cycle itself: a future
//! is polled until its frames have returned, so a cycle has no other thread to wait for. The end of a session
//! (frames lost, a device missing) stops the feedback, which makes the core stop the axes. Then the network
//! is brought up again, under a new instance.

mod al_status_text;
mod axis;
mod clock_monitor;
mod cycle_times;
mod drive_limits;
mod drive_set;
mod dump;
mod emergency;
mod esi;
mod fault_text;
mod fit;
mod found;
mod homing;
mod network;
mod pdo;
mod pump;
mod reference_clock;
mod round_trips;
mod run;
mod scale;
mod scan;
mod session;
mod signal;
mod signal_set;
mod sii;
mod socket;
mod spindle_drive;
mod time_driver;
mod touch_probe;
mod zero_impulse;

pub use clock_monitor::ClockFigures;
pub use cycle_times::{CycleTime, CycleTimes};
pub use drive_limits::{Driven, LimitError};
pub use dump::{DumpSettings, DumpTrouble, MIN_DUMP_BYTES};
pub use esi::{EsiError, EsiLibrary};
pub use evolvent_bridge::{BridgeError, CardFinding, CardVerdict, RoundTrips, examine_card};
pub use evolvent_drive::GantrySettings;
pub use fault_text::{fault_text, fault_text_of};
pub use fit::{FitError, check_fit, fit_notes};
pub use found::{FoundDevice, network_text, scan_json, scan_text};
pub use homing::HomingOnDrive;
pub use network::{
    MAX_DEVICES, Network, NetworkAxis, NetworkDevice, NetworkError, NetworkSpindle, Startup, network_schema,
};
pub use pdo::PdoError;
pub use round_trips::round_trips;
pub use run::{BridgeReport, RunError, RunSettings, run, run_measured};
pub use scale::{Scale, ScaleError};
pub use scan::{ScanError, scan};
pub use session::SessionError;
pub use signal::{
    AnalogChannel, Channel, ChannelForm, NetworkInput, NetworkOutput, OutputFunction, OutputSource,
};
pub use sii::{Pdo, PdoEntry, SiiContents};
pub use socket::InterfaceError;
pub use zero_impulse::ProbeNumber;

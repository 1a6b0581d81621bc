//! The common part of bridges to hardware: the bus side, two threads, and their privileges.
//!
//! ```text
//!   bus ── Setpoint, MachineOutputs ──► bus thread ══ queue ══► session: the cycle of the hardware
//!    ▲                                      ▲                        │
//!    └───── Feedback, MachineInputs ────────┴═════════ queues ═══════┘
//! ```
//!
//! A bridge describes its [`Hardware`] and gives [`run_bridge`] a function that runs one session with it:
//!
//! ```no_run
//! use core::sync::atomic::{AtomicBool, Ordering};
//!
//! use evolvent_bridge::{BridgeSettings, Hardware, run_bridge};
//! use evolvent_machine::Machine;
//! use evolvent_path::{AxisLetter, AxisMask};
//!
//! struct Nothing;
//!
//! impl Hardware for Nothing {
//!     type Notice = String;
//!     type Failure = String;
//!     const NAME: &'static str = "bench";
//!     const ENTRY: &'static str = "a drive";
//!
//!     fn axes(&self) -> AxisMask {
//!         [AxisLetter::X, AxisLetter::Y, AxisLetter::Z].into_iter().collect()
//!     }
//!     fn has_signals(&self) -> bool {
//!         false
//!     }
//!     fn measures_spindles(&self) -> bool {
//!         false
//!     }
//!     fn text(&self, notice: String) -> String {
//!         notice
//!     }
//! }
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let machine = Machine::load("machine.toml".as_ref())?;
//! let settings = BridgeSettings { machine: &machine, machine_name: None, prefix: None, duration: None };
//! let stop = AtomicBool::new(false);
//! let runs = run_bridge(settings, &Nothing, &stop, |text| println!("{text}"), |ends| {
//!     while !ends.stop.load(Ordering::Relaxed) {
//!         while let Ok(message) = ends.incoming.pop() {
//!             println!("{message:?}");
//!         }
//!     }
//!     Ok(())
//! })?;
//! println!("{} sessions", runs.sessions);
//! # Ok(())
//! # }
//! ```
//!
//! The bus thread finds the core, keeps running when the core ends, and connects to the next one. The
//! session's thread has real-time priority. Both threads give up the capabilities, files and system calls
//! that they do not need, so sockets that need rights are opened before.

mod axis_letter;
mod bridge;
mod bus_side;
mod clock;
mod confinement;
mod ends;
mod follower_settings;
mod gantry_file;
mod network_card;
mod privileges;
mod round_trips;
mod spindle_file;

pub use axis_letter::axis_letter;
pub use bridge::{BridgeError, BridgeRuns, BridgeSettings, Hardware, run_bridge};
pub use clock::monotonic_ns;
pub use confinement::confine_writer;
pub use ends::{BusEnds, Incoming};
pub use follower_settings::follower_settings;
pub use gantry_file::GantryFile;
pub use network_card::{CardFinding, CardVerdict, examine_card};
pub use round_trips::{RoundTrips, measure_round_trips};
pub use spindle_file::{OrientationFile, SpindleIndexFile, check_gear};

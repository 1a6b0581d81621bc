//! A simulated set of CiA 402 drives on the bus, with faults on demand.
//!
//! ```text
//!   bus ── Setpoint ──► Follower ── target ──► Cia402 ── control word ──► SimDrive
//!    ▲                                                  state machine, servo loop, encoder, switches
//!    └──── Feedback ◄── faults on demand ◄──────────────────────────────────┘
//! ```
//!
//! [`SimBridge`] is the complete bridge as a pure model: [`SimBridge::offer`] takes setpoints, and
//! [`SimBridge::step`] simulates one period of the drives and returns feedback. Time is an argument, so hours
//! are simulated in seconds and the same inputs give the same feedback. [`run`] connects the model to the bus
//! in real time, with a clock of the drives that may drift.
//!
//! Drive Y reports a fault 0.1 s after the drives have come into operation, and its error code arrives in the
//! feedback:
//!
//! ```
//! use evolvent_bridge_sim::{SimBridge, SimSettings};
//! use evolvent_bus::Setpoint;
//!
//! let mut settings = SimSettings::usual("XY", 1_000_000);
//! settings.faults.push("fault@0.1:Y".parse()?);
//! let mut bridge = SimBridge::new(&settings)?;
//! let mut error_codes = Vec::new();
//! for sequence in 1..=1000 {
//!     let now_ns = sequence * settings.period_ns;
//!     // The axes are at rest at 0, and the core requests power.
//!     let setpoint =
//!         Setpoint { sequence, due_time_ns: now_ns, power_request: 1, ..Setpoint::default() };
//!     bridge.offer(now_ns, &setpoint);
//!     error_codes.extend(bridge.step(now_ns).map(|feedback| feedback.error_code));
//! }
//! assert_eq!((error_codes[0], error_codes[999]), (0, 0x8611));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A drive is the standard's state machine with a second-order position loop ([`Servo`]). It stops with its
//! own ramp at a quick stop or a fault; without torque, friction stops it. When one drive leaves operation,
//! the bridge quick-stops the others, so that the axes follow together or not at all.
//!
//! The crate depends on the bus and the parts of `evolvent-drive` that every bridge needs, not on the rest of
//! the core, and can serve as a model for other bridges.

mod bridge;
mod clock;
mod drive;
mod event;
mod fault;
mod input_messages;
mod loopback;
mod probe;
mod run;
mod servo;
mod settings;
mod spindle;

pub use bridge::SimBridge;
pub use clock::{DriveClock, monotonic_ns};
pub use drive::SimDrive;
pub use event::{SimEvent, StopCause};
pub use fault::{Fault, FaultError, FaultKind};
pub use input_messages::Signalling;
pub use loopback::{LoopbackInputs, loopback};
pub use probe::{ProbeSettings, SimProbe, Surface};
pub use run::{Cutting, RunError, RunSettings, SimReport, run, run_cutting};
pub use servo::{Servo, ServoSettings};
pub use settings::{SimAxis, SimIndex, SimSettings};
pub use spindle::{SimSpindle, SpindleSimulation};

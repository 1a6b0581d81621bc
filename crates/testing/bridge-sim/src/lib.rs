//! A simulated set of CiA 402 drives behind the bus, with faults on demand.
//!
//! ```text
//!   bus ── Setpoint ──► Follower ── target ──► Cia402 ── control word ──► SimDrive
//!    ▲                                                  state machine, servo loop, encoder, switches
//!    └──── Feedback ◄── faults on demand ◄──────────────────────────────────┘
//! ```
//!
//! [`SimBridge`] is the whole of it as a pure model: setpoints in by [`SimBridge::offer`], one period of the
//! drives by [`SimBridge::step`], feedback out. Time comes in as an argument, so hours are simulated in
//! seconds and the same inputs give the same feedback. [`run`] puts it on the bus, in real time, by a clock
//! of the drives that may drift.
//!
//! A drive is a position loop of second order ([`Servo`]) behind the standard's state machine. It stops by
//! its own ramp at a quick stop or a fault; without torque it is braked by friction. When one drive leaves
//! operation the bridge stops the others quickly, so that axes follow together or not at all.
//!
//! It knows only the bus, nothing else of the core, and may serve as a model for other bridges.

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

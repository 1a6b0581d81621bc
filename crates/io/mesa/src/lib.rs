//! A drive bridge to Mesa Ethernet boards: HostMot2 over LBP16 (UDP 27181).
//!
//! ```text
//!   bus ── Setpoint ──► bus thread ══ queue ══► cycle: Follower ── target ─► position loops ──► rates ──► board
//!    ▲                      ▲                                                                        │
//!    └───── Feedback ───────┴═════ queue ═══════ accumulators, counts, pins ◄────────────────────────┘
//! ```
//!
//! [`BoardSettings`] is a board file: the step generator, or encoder and PWM generator, of each axis, and the
//! pins:
//!
//! ```
//! use evolvent_mesa::BoardSettings;
//!
//! let board = BoardSettings::parse(
//!     "address = \"192.168.1.121\"
//!      [[axis]]
//!      letter = \"X\"
//!      stepgen = 0
//!      steps_per_unit = 200
//!      step_length_ns = 2500
//!      step_space_ns = 2500
//!      direction_setup_ns = 5000
//!      direction_hold_ns = 5000",
//!     "board.toml",
//! )?;
//! assert_eq!(board.axes_mask().bits(), 1);
//! # Ok::<(), evolvent_config::ConfigError>(())
//! ```
//!
//! [`Link`] reads the [`Description`] of a board; [`Packet`] is the protocol. [`run`] is the bridge: one
//! packet that reads and one that writes in each period. The end of a session (packets lost, the watchdog, a
//! board that has restarted) stops the axes within their limits as long as the board receives packets, and
//! then the feedback, which makes the core stop the axes. Then the board is set up again, under a new
//! instance.

mod axis;
mod axis_set;
mod board_file;
mod board_settings;
mod clock;
mod description;
mod encoder_index;
mod field_pins;
mod fit;
mod link;
mod packet;
mod pin_uses;
mod plan;
mod round_trips;
mod run;
mod session;
mod signals;
mod smart_serial;
mod spindle;

pub use board_file::{BoardFileError, board_schema};
pub use board_settings::{
    Actuator, BoardAxis, BoardSettings, BoardSpindle, Gains, InputPin, InputSource, OutputPin, OutputTarget,
    Pin, RemoteSettings, SpindleAngleSource, SpindleOrienting, SpindleSpeed, StepTiming,
};
pub use description::{Description, DescriptionError, Module, PinFunction, tag};
pub use evolvent_bridge::BridgeError;
pub use fit::{FitError, check_fit, fit_notes};
pub use link::{Link, LinkError, PORT};
pub use packet::{MAX_PACKET, Packet, PacketFull, Reply, Space};
pub use plan::PlanError;
pub use round_trips::round_trips;
pub use run::{BridgeReport, RunSettings, run, run_measured};
pub use session::SessionError;
pub use smart_serial::RemoteError;

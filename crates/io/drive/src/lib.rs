//! Drives, seen from both ends of the bus: pure, without clock or I/O, and without allocation once built.
//!
//! ```text
//!            core                         bus                       bridge
//!   Motion ── DriveSetpoint ──────────────── Setpoint ───────► Follower ── target ─► Cia402 ── control word ─► drive
//!     ▲          │                                                                                         │
//!     │     FeedbackWatch ◄──────────── Feedback ◄──────────────────────────── status word, position ──────┘
//!     └── stop, alarm                      │
//!   PhaseLock ◄── phase error ─────────────┘
//! ```
//!
//! A drive and its bridge, from supply to operation, one transition a period:
//!
//! ```
//! use evolvent_drive::{Braking, Cia402, DriveEvents, DriveMachine, DriveState, PowerRequest, QuickStopOption};
//!
//! let mut drive = DriveMachine::new(QuickStopOption::ThenDisabled);
//! let mut bridge = Cia402::new();
//! let events = DriveEvents { ready: true, at_rest: true, ..DriveEvents::default() };
//! // What the bridge knows of a drive that brakes: nothing here.
//! let braking = Braking { period_s: 1e-3, is_standing: None };
//! let mut control_word = 0;
//! for _ in 0..10 {
//!     drive.step(control_word, events);
//!     let order = bridge.step(drive.status_word(), PowerRequest::On, None, 12.5, 12.0, braking);
//!     // Until operation is enabled the target is the actual position: enabling moves nothing.
//!     assert_eq!(order.target_position, if order.follows { 12.5 } else { 12.0 });
//!     control_word = order.control_word;
//! }
//! assert_eq!(drive.state(), DriveState::OperationEnabled);
//! ```
//!
//! In the core, [`FeedbackBounds`] drops feedback that cannot be true, whatever its sender. [`FeedbackWatch`]
//! compares the feedback with the commands, and reports the first fault as a [`DriveAlarm`]. [`PhaseLock`]
//! converts the phase error of the drives' clock to a correction of the cycle's period, at most 0.1 %.
//!
//! In a bridge, [`Follower`] converts setpoints that arrive early, late or not at all to a target for every
//! period of the drives: it bridges a few missing ones, then brakes within the limits ([`Brake`]) and holds;
//! it rejects jumps. [`IndexLatch`] keeps the request for an index pulse. [`Gantry`] squares the beam of two
//! motors of one axis. [`SpindleEncoder`] converts counts and index pulses to the angle of a spindle, and
//! [`SpindleOrientation`] turns it to an angle; [`SpindlePower`] decides when its drive may have torque.
//! [`Cia402`] brings a drive to the requested power state. [`DriveMachine`] is the drive's own state machine,
//! for simulated drives and tests.
//!
//! Time is an argument. Everything except the constructors may be called from a real-time cycle.

mod alarm;
mod brake;
mod cia402;
mod command;
mod drive_machine;
mod entry;
mod follower;
mod follower_settings;
mod gantry;
mod gantry_pair;
mod index_latch;
mod input_entry;
mod interpolation;
mod output_follower;
mod phase;
mod point;
mod power;
mod spindle_encoder;
mod spindle_entry;
mod spindle_orientation;
mod spindle_power;
mod start_offset;
mod status_word;
mod step_check;
mod watch;

pub use alarm::DriveAlarm;
pub use brake::{Brake, BrakeState};
pub use cia402::{Braking, CYCLIC_SYNCHRONOUS_POSITION, Cia402, DriveOrder, control};
pub use command::DriveSetpoint;
pub use drive_machine::{DriveEvents, DriveMachine, QuickStopOption};
pub use entry::FeedbackBounds;
pub use follower::{Follower, Rejection, Target};
pub use follower_settings::{FollowerSettings, SettingsError, bridge_cycles};
pub use gantry::{Gantry, GantryFault, GantryInputs, GantrySettings, is_homed, worse_status};
pub use gantry_pair::{GantryEvent, GantryMotor, GantryPair};
pub use index_latch::{IndexLatch, IndexRequest};
pub use input_entry::{InputEntry, InputFault, KnownInputs, KnownProbe};
pub use interpolation::{InterpolationError, InterpolationTime};
pub use output_follower::{OutputFault, OutputFollower};
pub use phase::{MAX_CORRECTION_RATIO, PhaseLock, PhaseSettings};
pub use power::{BridgeState, Note, PowerRequest};
pub use spindle_encoder::{
    SpindleConditions, SpindleEncoder, SpindleEncoderFault, SpindleEncoderSettings, SpindleIndex,
};
pub use spindle_entry::{SpindleEntry, SpindleFault};
pub use spindle_orientation::{OrientationSettings, SpindleOrientation};
pub use spindle_power::SpindlePower;
pub use status_word::{DriveState, bits};
pub use watch::{FeedbackWatch, Presence, WatchMode, WatchSettings};

/// Number of axes, in the order X Y Z A B C U V W.
pub use evolvent_wire::AXES;

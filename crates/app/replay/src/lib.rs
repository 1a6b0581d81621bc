//! Recorded runs: published again, and recomputed.
//!
//! ```text
//!   Opened ──► replay   the setpoints on the bus again, for bridges and clients
//!          └─► verify   the run computed again from program, machine and recorded inputs, bit for bit
//! ```
//!
//! [`replay`] keeps the intervals of the recorded setpoints, or a multiple of them. It first looks for drives
//! that are switched on, and does not move them unless that is confirmed. [`verify`] reads on one thread,
//! plans and computes on others, and compares every cycle with the record and with the machine's limits:
//!
//! ```no_run
//! let verified = evolvent_replay::verify("run.mcap".as_ref())?;
//! println!("{} of {} setpoints differ", verified.differing, verified.compared);
//! # Ok::<(), evolvent_inspect::InspectError>(())
//! ```
//!
//! Neither writes to a trace; neither is real-time code.

mod replay;
mod verify;

pub use replay::{Pace, Replay, ReplayError, Replayed, replay};
pub use verify::{Difference, Verified, verify};

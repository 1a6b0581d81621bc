//! Recorded runs once more.
//!
//! ```text
//!   Opened ──► replay   the setpoints on the bus again, for bridges and clients
//!          └─► verify   the run computed again from program, machine and recorded inputs, bit for bit
//! ```
//!
//! [`replay`] keeps the distances in time of the recorded setpoints, or a multiple of them. It looks for drives that are
//! switched on first, and refuses to move them unless it is told that this is meant. [`verify`] reads on one thread, plans and
//! computes on others, and holds every cycle against the record and against the machine's limits.
//!
//! Neither writes to a trace; neither is real-time code.

mod replay;
mod verify;

pub use replay::{Pace, Replay, ReplayError, Replayed, replay};
pub use verify::{Difference, Verified, verify};

//! State-to-state moves: jog, retract, stop and continue, return to the path.
//!
//! A [`Transfer`] takes the axes from one [`AxesState`] (position, velocity, acceleration) to another as fast
//! as their limits allow. No path is prescribed between the two, unless [`Sync::Phase`] asks for the straight
//! line.
//!
//! ```text
//! limits, from, to ─► check ─► ruckig ─► pieces ─► landed on the target ─► every limit verified ─► Transfer
//!                       │         └ fails ─► other units, other digits ─► stop and go ┘
//!                       └► TransferError
//! ```
//!
//! The solver is ruckig (Berscheid and Kroeger, "Jerk-limited Real-time Trajectory Generation with Arbitrary
//! Target States", RSS 2021), a C++ library that allocates, may fail on valid input, and would send waypoints
//! to a server on the internet. It is therefore confined to one private module that has no waypoints, and its
//! results are verified: they are read back as pieces of constant jerk, the pieces are corrected to end at
//! the target to the last digits, and every limit and the travel are checked on the extremes of those pieces,
//! by formulas of this crate. If ruckig fails, a slower move replaces it: each axis stops, all move in a
//! straight line, each speeds up to its target ([`Method::StopAndGo`]).
//!
//! ```
//! use evolvent_machine::Limits;
//! use evolvent_path::{AXES, Axes};
//! use evolvent_transfer::{AxesState, Sync, Transfer};
//!
//! let limits = Limits {
//!     present: [true; AXES],
//!     velocity: Axes::repeat(100.0),
//!     acceleration: Axes::repeat(1000.0),
//!     jerk: Axes::repeat(20_000.0),
//!     travel_min: Axes::repeat(-500.0),
//!     travel_max: Axes::repeat(500.0),
//!     home: Axes::zeros(),
//! };
//! let mut target = Axes::zeros();
//! target[0] = 100.0;
//! let (from, to) = (AxesState::at_rest(Axes::zeros()), AxesState::at_rest(target));
//! let transfer = Transfer::solve(&limits, &from, &to, Sync::Time)?;
//! assert!((transfer.duration_s() - 1.15).abs() < 1e-6);
//! // The solver stays a little below the limit.
//! let speed_mm_s = transfer.at(0.575).velocity[0];
//! assert!(speed_mm_s > 99.99 && speed_mm_s <= 100.0, "{speed_mm_s}");
//! # Ok::<(), evolvent_transfer::TransferError>(())
//! ```
//! [`Transfer::solve`] belongs to the planner's side. Its result is a plain value without heap: the real-time
//! cycle owns a copy and calls [`Transfer::at`], which costs a few multiplications per axis.
//!
//! The same input gives the same bits on the same computer only: ruckig uses the cosine and cube root of the
//! platform. Record a transfer instead of recomputing it elsewhere.

#![expect(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "checks are written so that NaN fails them: not (x <= limit) refuses NaN, x > limit lets it pass"
)]

mod check;
mod engine;
mod error;
mod fallback;
mod landing;
mod recover;
mod slowing;
mod state;
mod track;
mod transfer;

pub use error::{Quantity, TransferEnd, TransferError};
pub use state::{AxesState, TransferPoint};
pub use track::{JerkSegment, PIECES, Track};
pub use transfer::{Method, Sync, Transfer};

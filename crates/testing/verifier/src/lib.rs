//! An independent check that a motion is what program, machine and tolerance require.
//!
//! ```text
//!   program text ─► Route (lines, arcs, involutes with feed and tolerance)
//!                      │
//!   positions ─────► Judge ─► Verdict ─► violations
//!                      │
//!   machine ───────────┘  limits of every axis, chord error, travel
//! ```
//!
//! A [`Judge`] is fed positions, one a control period, and nothing else: whatever a planner says of its own
//! speed, block or error does not count. Velocity, acceleration and jerk are differences of the positions.
//! The way along the program is found by following: for each position, and for points on the chord to it, the
//! *earliest* point of the program not before the last one that lies within the tolerance. Taking the
//! earliest loses nothing (whoever can go on from a later point can go on from an earlier one), so if
//! following fails there is no way to read the motion as the program in its order. What is passed over has to
//! lie close to the motion as well: nothing is left out.
//!
//! A [`Verdict`] holds the worst of every kind with its place; [`Verdict::violations`] names what is not
//! allowed.
//!
//! Curves are evaluated here once more from their geometry. Nothing of the planner is used, so that one
//! mistake is not made twice. [`suite`] writes the programs on which planners are compared.
//!
//! Nothing here is for the real-time cycle.

#![expect(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "checks are written so that NaN fails them: not (x <= limit) refuses NaN, x > limit lets it pass"
)]

mod block;
mod differences;
mod follower;
mod involute_piece;
mod judge;
mod measure;
mod other;
mod piece;
mod round;
mod route;
mod straight;
mod suite;
mod verdict;

pub use block::Block;
pub use judge::Judge;
pub use route::{Route, RouteError};
pub use suite::{Program, butterfly_point, butterfly_program, suite};
pub use verdict::{Allowances, Kind, Verdict, Violation, Worst};

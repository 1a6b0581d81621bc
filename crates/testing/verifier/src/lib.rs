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
//! A [`Judge`] receives positions, one per control period, and nothing else; the planner's own speed, block
//! or error is not used. Velocity, acceleration and jerk are differences of the positions. The judge follows
//! the program: for each position, and for points on the chord to it, it takes the *earliest* point of the
//! program within the tolerance that is not before the previous one. Taking the earliest point loses nothing,
//! because a motion that can continue from a later point can also continue from an earlier one. So if
//! following fails, the motion does not match the program in its order. Passed parts of the program must be
//! close to the motion as well, so that nothing is left out.
//!
//! A [`Verdict`] has the worst value of every kind with its position; [`Verdict::violations`] lists the
//! violations.
//!
//! Curves are evaluated independently from their geometry, without any code of the planner, so that a mistake
//! there is not repeated here. [`suite`] writes the programs on which planners are compared.
//!
//! Nothing in this crate is for the real-time cycle.

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

pub use block::VerifiedMove;
pub use judge::Judge;
pub use route::{Route, RouteError};
pub use suite::{Program, butterfly_point, butterfly_program, suite};
pub use verdict::{Allowances, Kind, Verdict, Violation, Worst};

//! Smoothing: programmed blocks in, the path that is driven out, within the tolerance.
//!
//! - [`Smoother`] takes [`Block`]s and gives [`Output`]s: [`Stretch`]es of the path, bounds of the speed where it is not
//!   smooth, and a [`Mark`] where each block ends. It looks ahead as far as it must, and remembers nothing else.
//! - Everything is by one parameter, `u`: the programmed length. A point of the path belongs to a point of the program.
//! - The *chain* is the programmed path that is known, link by link. A *section* of it lies between places where the
//!   path is kept. In it, a *zone* reaches from before a joint to behind it, and joints nearby share one; outside of
//!   zones the programmed curve itself is driven.
//! - A zone becomes a cubic spline: knots by how the path bends, control points on the path to begin with, then moved
//!   such that it can be driven fast, inside the *tube* of the tolerance; window by window, so that the path comes out
//!   while the program still comes in.
//! - Safety does not rest on the optimisation. Every piece is checked as it comes out. Where none can be found that holds,
//!   the path comes to rest, returns to the programmed curve, and passes the next joints as they are programmed;
//!   [`Smoother::failures`] counts it.
//! - The same blocks give the same path, bit for bit. Nothing here may be called by the real-time cycle.

#![expect(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "checks are written so that NaN fails them: not (x <= limit) refuses NaN, x > limit lets it pass"
)]

#[cfg(test)]
extern crate self as evolvent_smooth;

mod band;
mod basis;
mod block;
mod chain;
mod follow;
mod joint_optimizer;
mod newton;
mod output;
mod smoother;
mod spacing;
mod tube;
mod weights;
mod zone;
mod zone_solver;

pub use block::{Block, Settings, Tolerance};
pub use output::{Mark, Output, Stretch};
pub use smoother::Smoother;

//! The time law along a known path: how fast the path parameter runs under the limits of every axis.

mod barrier;
mod cell;
mod change;
mod check;
mod error;
mod grid;
mod kept;
mod law;
mod limits;
mod optimizer;
mod profile;
#[cfg(test)]
mod random;
mod reach;
mod riccati;
mod solver;
mod spans;
mod start;
mod stop;
mod stub;
mod window;

pub use change::{ScalarLimits, ScalarState};
pub use error::FeedError;
pub use grid::{Grid, Place};
pub use law::Law;
pub use limits::{DerivativeBounds, PathLimits, append_cells};
pub use optimizer::{Entry, Exit, MOST_INTERVALS, Optimizer, Piece, PlanReport, Ratios, StopReport};
pub use profile::{Outcome, Profile};
pub use reach::{lasting_speed, reachable_speed};

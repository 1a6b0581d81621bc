//! The time law along a known path: how fast the path parameter runs under the limits of every axis.

mod change;
mod limits;
mod profile;
#[cfg(test)]
mod random;
mod reach;

pub use change::{ScalarLimits, ScalarState};
pub use limits::{DerivativeBounds, PathLimits, append_cells};
pub use profile::{Outcome, Profile};
pub use reach::{lasting_speed, reachable_speed};

//! The time law along a known path: how fast the path parameter runs under the limits of every axis.
//!
//! A path is a chain of stretches of curves in a regular parameter `u`. With `a = u'^2`, `b = u''` and
//! `c = u'''/u'` all limits of an axis but jerk are linear:
//!
//! ```text
//! velocity^2  q'^2 a     acceleration  q'' a + q' b     jerk  sqrt(a) (q''' a + 3 q'' b + q' c)
//! ```
//!
//! and with `c` constant on an interval `b` is linear in `u`, `a` quadratic, and `u(t)` a hyperbolic or circular
//! function. A [`Grid`] cuts the path into such intervals. The [`Optimizer`] plans a window of them: it minimises the
//! duration by a barrier method with feasible iterates, so that it may be broken off at any step, and hands out
//! [`Piece`]s, each a [`TimeLaw`] that the cycle evaluates. At rest, where `c` has no bound, pieces have constant jerk.
//!
//! Every plan ends at rest on known path. A window is planned while the one before runs: the new one begins where
//! the caller says on the old one, which serves as its start. If there is no plan, the old one stays what it is.
//!
//! [`PathLimits`] holds the axes' limits, the control rate and the chord error. [`Profile`] is the classic motion
//! under constant limits along one parameter, exact on lines, and what a lower feed override tries first.
//!
//! 100 mm from rest to rest, at 100 mm/s, 1000 mm/s2 and 20 000 mm/s3:
//!
//! ```
//! use evolvent_timing::{Profile, ScalarLimits, ScalarState};
//!
//! let limits = ScalarLimits {
//!     velocity: 100.0,
//!     acceleration: 1000.0,
//!     jerk: 20_000.0,
//! };
//! let profile = Profile::solve(ScalarState::default(), 100.0, 0.0, 0.0, &limits);
//! // Speeding up takes v/a + a/j, and as long as half of that is lost to it.
//! let ramp_s = 100.0 / 1000.0 + 1000.0 / 20_000.0;
//! assert!((profile.duration() - (1.0 + ramp_s)).abs() < 1e-9);
//! let (middle, jerk) = profile.at(0.5 * profile.duration());
//! assert!((middle.x - 50.0).abs() < 1e-9 && (middle.v - 100.0).abs() < 1e-9 && jerk == 0.0);
//! ```
//! Only [`TimeLaw`], [`Piece`] and [`Profile`] are for the real-time cycle.

mod barrier;
mod cell;
mod change;
mod check;
mod closed_form;
mod error;
mod feed_reduction;
mod grid;
mod limits;
mod memory;
mod optimizer;
mod piece;
mod profile;
mod reach;
mod resume;
mod riccati;
mod solver;
mod spans;
mod start;
mod stub;
mod time_law;
mod warm_start;
mod window;

pub use change::{ScalarLimits, ScalarState};
pub use error::FeedError;
pub use grid::{Grid, Place};
pub use limits::{DerivativeBounds, PathLimits, append_cells};
pub use memory::Memory;
pub use optimizer::{MAX_INTERVALS, Optimizer};
pub use piece::{Entry, Exit, Piece, PlanReport, Ratios};
pub use profile::{Outcome, Profile};
pub use reach::{lasting_speed, reachable_speed};
pub use time_law::TimeLaw;

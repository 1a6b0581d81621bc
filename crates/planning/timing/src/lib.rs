//! The time law along a known path: the path parameter as a function of time under the limits of every axis.
//!
//! Input: a path as a chain of segments of curves with feed words, and the limits of the axes. Output:
//! [`TimeLawPiece`]s, each a [`TimeLaw`] that the cycle evaluates.
//!
//! 100 mm from rest to rest, at 100 mm/s, 1000 mm/s2 and 20 000 mm/s3, in closed form:
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
//! // Acceleration takes v/a + a/j, and costs half of that twice.
//! let ramp_s = 100.0 / 1000.0 + 1000.0 / 20_000.0;
//! assert!((profile.duration() - (1.0 + ramp_s)).abs() < 1e-9);
//! let (middle, jerk) = profile.at(0.5 * profile.duration());
//! assert!((middle.x - 50.0).abs() < 1e-9 && (middle.v - 100.0).abs() < 1e-9 && jerk == 0.0);
//! ```
//!
//! # Model
//!
//! A path is a chain of segments of curves by a regular parameter `u`. With `a = u'^2`, `b = u''` and
//! `c = u'''/u'` every axis limit except jerk is linear:
//!
//! ```text
//! velocity^2  q'^2 a     acceleration  q'' a + q' b     jerk  sqrt(a) (q''' a + 3 q'' b + q' c)
//! ```
//!
//! With `c` constant on an interval, `b` is linear and `a` quadratic in `u`, and `u(t)` is a hyperbolic or
//! circular function. A [`Grid`] divides the path into such intervals. The [`Optimizer`] plans a window of
//! them: it minimises the duration by an interior-point method with feasible iterates, which may be stopped
//! after any step. At rest, where `c` is unbounded, pieces have constant jerk.
//!
//! Every plan ends at rest on known path. A window is planned while the previous one is executed: it starts
//! at a given position of the previous plan, which also serves as the warm start. If planning fails, the
//! previous plan stays valid.
//!
//! [`PathLimits`] holds the axis limits, the control rate and the chord error. [`Profile`] is the motion
//! under constant limits along one parameter; it is exact on lines, the basis of the classic planner, and the
//! first attempt at a reduced feed override.
//!
//! # Guarantees
//!
//! [`TimeLaw`], [`TimeLawPiece`] and [`Profile`] are real-time safe; everything else is for the planner's thread.
//! The work of a plan is bounded by a number of Newton steps. Plans are checked between stations: ratios to
//! the limits are at most 1.0008 (velocity, acceleration) and 1.012 (jerk). Results depend on the sequence of
//! calls only.
//!
//! # Where to read on
//!
//! `docs/theory-feed.md` for the equations; [`Optimizer::plan`], then `barrier.rs` and `riccati.rs` for the
//! method.

mod barrier;
mod cell;
mod change;
mod check;
mod closed_form;
mod error;
mod feed_reduction;
mod grid;
mod limits;
mod optimizer;
mod piece;
mod profile;
mod reach;
mod resume;
mod riccati;
mod snapshot;
mod solver;
mod spans;
mod start;
mod stub;
mod time_law;
mod warm_start;
mod window;

pub use change::{ScalarLimits, ScalarState};
pub use error::FeedError;
pub use grid::{Grid, PathPosition};
pub use limits::{DerivativeBounds, PathLimits, append_cells};
pub use optimizer::{MAX_INTERVALS, Optimizer};
pub use piece::{Entry, Exit, PlanReport, Ratios, TimeLawPiece};
pub use profile::{Outcome, Profile};
pub use reach::{monotone_reachable_speed, reachable_speed};
pub use snapshot::PlanSnapshot;
pub use time_law::TimeLaw;

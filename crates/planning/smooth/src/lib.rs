//! Smoothing: programmed blocks in, the driven path out, within the tolerance.
//!
//! Input: [`ProgramMove`]s, programmed curves with feed and tolerance. Output: [`Output`]s, the [`PathSegment`]s of
//! the driven path, limits of the speed where it is not smooth, and a [`Mark`] where each block ends.
//!
//! A right angle, rounded within 10 um:
//!
//! ```
//! use evolvent_machine::Limits;
//! use evolvent_path::{AXES, Axes, Line};
//! use evolvent_smooth::{ProgramMove, SmootherSettings, Smoother, Tolerance};
//!
//! # let limits = Limits {
//! #     present: [true; AXES],
//! #     velocity: Axes::repeat(500.0),
//! #     acceleration: Axes::repeat(5000.0),
//! #     jerk: Axes::repeat(1e5),
//! #     travel_min: Axes::repeat(-1e3),
//! #     travel_max: Axes::repeat(1e3),
//! #     home: Axes::zeros(),
//! # };
//! let mut smoother = Smoother::new(SmootherSettings { joint_time_s: 0.001, limits });
//! let (start, mut corner, mut end) = (Axes::zeros(), Axes::zeros(), Axes::zeros());
//! (corner[0], end[0], end[1]) = (10.0, 10.0, 10.0);
//! let mut path = Vec::new();
//! for (from, to, line) in [(start, corner, 1), (corner, end, 2)] {
//!     let curve = Line::new(from, to).unwrap().into();
//!     let tolerance = Tolerance::Within { mm: 0.01, merge_mm: 0.0 };
//!     smoother.push(&ProgramMove { curve, feed_mm_s: 50.0, rapid: false, tolerance, line, block: line }, &mut path);
//! }
//! smoother.rest(&mut path);
//! assert!(smoother.deviation_mm() > 0.0 && smoother.deviation_mm() <= 0.01);
//! ```
//!
//! # Model
//!
//! - Everything refers to one parameter `u`, the programmed length. A point of the path belongs to a point of
//!   the program.
//! - The *chain* is the known programmed path as program segments. A *section* of it is between positions
//!   where the path is kept. In it, a *zone* extends from before a joint to after it; close joints share one.
//!   Outside of zones the programmed curve itself is driven.
//! - A zone becomes a cubic spline. Its knots follow the curvature of the path, its control points start on
//!   the path and are then optimised for speed inside the *tube* of the tolerance, window by window, so that
//!   output starts while the program is still being read.
//!
//! # Guarantees
//!
//! The tolerance does not depend on the optimisation: every piece is checked before output. Where no valid
//! spline is found, the path stops, returns to the programmed curve, and passes the next joints as
//! programmed; [`Smoother::failures`] counts these cases. The same blocks give the same path, bit for bit.
//! Nothing here is real-time safe.
//!
//! # Where to read on
//!
//! `docs/theory-smoothing.md` for the method; `smoother/mod.rs`, then `zone.rs` and `tube.rs`.

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

pub use block::{ProgramMove, SmootherSettings, Tolerance};
pub use output::{Mark, Output, PathSegment};
pub use smoother::Smoother;

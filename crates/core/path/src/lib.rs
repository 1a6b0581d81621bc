//! Curves by arc length: line, arc, involute, blend, spline; hole-milling synthesis.
//!
//! A path is a chain of curves. Every [`Curve`] is a small value (no heap) that carries nine axes
//! ([`Axes`]: X Y Z A B C U V W) from its start to its end; both ends are kept bit for bit as given.
//!
//! - Its *arc length* `s` is what feed is measured in: mm of XYZ, where XYZ rests mm of UVW, else degrees of ABC.
//! - Its *regular parameter* `u` is what motion is computed with: [`Curve::jet`] gives position and three
//!   derivatives by `u`, always finite. `u` is arc length on lines and arcs; it differs near an involute's base
//!   circle, where derivatives by arc length grow without bound, and on blends.
//! - [`Curve::at`] gives the same by arc length; [`Curve::tangent`], [`Curve::curvature`] and
//!   [`Curve::curvature_derivative`] speak of the XYZ curve alone.
//! - [`Curve::bounds`], [`Curve::derivative_bounds`] and [`Curve::curvature_bound`] give safe bounds over a
//!   stretch: travel, axis limits, chord error.
//! - [`classify_joint`] tells how two curves meet: smoothly, with a step that bounds the speed, or at a corner.
//!
//! [`Arc`] and [`Involute`] lie in a [`Plane`] and turn with a [`Sense`]; the third axis and all others are
//! linear in arc length. [`Blend`] is a quintic that takes over position and two derivatives at both ends;
//! [`Spline`] is one cubic piece of a spline.
//! [`Hole`] plans the milling of a hole along involutes and gives these curves with their role.
//!
//! A quarter circle of 10 mm in the XY plane:
//!
//! ```
//! use evolvent_path::{Arc, Axes, Curve, Plane, Sense};
//!
//! let (mut start, mut end) = (Axes::zeros(), Axes::zeros());
//! (start[0], end[1]) = (10.0, 10.0);
//! let arc = Arc::new(Plane::Xy, start, end, [0.0, 0.0], Sense::CounterClockwise, 0)?;
//! let curve = Curve::from(arc);
//! assert!((curve.length() - 5.0 * std::f64::consts::PI).abs() < 1e-12);
//! assert!((curve.curvature(3.0) - 0.1).abs() < 1e-12);
//! // Both ends are as given, to the last bit.
//! assert_eq!(curve.at(curve.length()).position, end);
//! # Ok::<(), evolvent_path::CurveError>(())
//! ```
//! Nothing here knows of time, machine limits or files, and nothing panics: what comes from outside is checked
//! when a curve is built, and everything after that is total.

#![expect(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "checks are written so that NaN fails them: not (x <= limit) refuses NaN, x > limit lets it pass"
)]

mod arc;
mod axis;
mod axis_mask;
mod blend;
mod canonical_move;
mod curve;
mod error;
mod hole;
mod hole_error;
mod involute;
mod jet;
mod joint;
mod line;
mod metric;
mod plane;
mod polynomial;
mod quadrature;
mod roll;
mod spindle_speed;
mod spirals;
mod spline;

pub use arc::Arc;
pub use axis::{AXES, Axes, AxisLetter};
pub use axis_mask::AxisMask;
pub use blend::Blend;
pub use canonical_move::{Move, MoveKind, PathMode};
pub use curve::{Curve, ParamCurve};
pub use error::{CurveError, MAX_ARC_TURNS, MAX_COORDINATE, MIN_RADIUS_MM};
pub use hole::{BlockFigures, Hole, HoleBlock, HolePass, HoleStart, MAX_DEPTHS, Milling, Role, depths_mm};
pub use hole_error::HoleError;
pub use involute::{Involute, InvoluteError, MAX_INVOLUTE_TURNS};
pub use jet::Jet;
pub use joint::{JointKind, JointLimits, classify_joint};
pub use line::Line;
pub use metric::{FeedMetric, feed_rate};
pub use plane::{Plane, Sense};
pub use spindle_speed::{SpindleSpeed, SurfaceSpeed};
pub use spirals::{Archimedean, half_circle_radii_mm, half_circles_length_mm, helix_length_mm};
pub use spline::Spline;

//! Curves in nine axes with position and three derivatives: line, arc, involute, quintic blend, cubic spline.
//!
//! Input: end points and the geometry of a curve in machine coordinates (mm, degrees). Output: a [`Curve`], a
//! small value without heap memory that evaluates position, derivatives, arc length and bounds.
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
//! // Both end points are kept bit for bit.
//! assert_eq!(curve.at(curve.length()).position, end);
//! # Ok::<(), evolvent_path::CurveError>(())
//! ```
//!
//! # Model
//!
//! A path is a chain of curves over nine axes ([`Axes`]: X Y Z A B C U V W). Every curve has two parameters:
//!
//! - The *regular parameter* `u`, by which all derivatives are finite. Motion is computed with it:
//!   [`Curve::jet`] returns position and three derivatives by `u`. On lines and arcs `u` is arc length; it
//!   differs near an involute's base circle, where derivatives by arc length are unbounded, and on blends and
//!   splines.
//! - The *arc length* `s` in the [feed metric](FeedMetric): mm of XYZ; if XYZ does not move, mm of UVW, else
//!   degrees of ABC. The feed word refers to it. [`Curve::at`] returns the derivatives by `s`.
//!
//! [`Arc`] and [`Involute`] are in a [`Plane`] and have a [`Sense`]; the normal axis and all others are
//! linear. A [`Blend`] matches position and two derivatives at both ends; a [`Spline`] is one piece of a
//! cubic spline. [`classify_joint`] decides whether two curves meet smoothly, with a step that bounds the
//! speed, or at a corner. [`Curve::bounds`], [`Curve::derivative_bounds`] and [`Curve::curvature_bound`]
//! bound a parameter range for travel checks, axis limits and chord error. [`Hole`] plans the milling of a
//! hole along involutes.
//!
//! # Guarantees
//!
//! Constructors check their input and return an error; nothing panics, and all evaluation is total: any
//! parameter, NaN included, gives a finite [`Curve::jet`]. End points are kept bit for bit. [`ParamCurve`]
//! states for each function whether the real-time cycle may call it. Results depend on the arguments only.
//! The crate knows no time, machine limits or files.
//!
//! # Where to read on
//!
//! [`ParamCurve`], then one curve, for example [`Involute`]; `docs/theory-involute.md` for the mathematics,
//! `docs/adr/0003-path-parameter.md` for the reason of the two parameters.

#![expect(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "checks are written so that NaN fails them: not (x <= limit) refuses NaN, x > limit lets it pass"
)]

mod angle;
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
mod involute_error;
mod jet;
mod joint;
mod line;
mod metric;
mod plane;
mod polynomial;
mod quadrature;
mod spindle_speed;
mod spirals;
mod spline;

pub use angle::{TURN_DEG, angle_within_turn, turn_onward, turn_shorter, whole_turns};
pub use arc::Arc;
pub use axis::{AXES, Axes, AxisLetter};
pub use axis_mask::AxisMask;
pub use blend::Blend;
pub use canonical_move::{Move, MoveKind, PathMode};
pub use curve::{Curve, ParamCurve};
pub use error::{CurveError, MAX_ARC_TURNS, MAX_COORDINATE, MIN_RADIUS_MM};
pub use hole::{BlockFigures, Hole, HoleBlock, HolePass, HoleStart, MAX_DEPTHS, Milling, Role, depths_mm};
pub use hole_error::HoleError;
pub use involute::{Involute, MAX_INVOLUTE_TURNS};
pub use involute_error::InvoluteError;
pub use jet::Jet;
pub use joint::{JointKind, JointLimits, classify_joint};
pub use line::Line;
pub use metric::{Feed, FeedMetric, feed_rate};
pub use plane::{Plane, Sense};
pub use spindle_speed::{SpindleSpeed, SurfaceSpeed};
pub use spirals::{Archimedean, half_circle_radii_mm, half_circles_length_mm, helix_length_mm};
pub use spline::Spline;

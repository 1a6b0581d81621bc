//! Blending, look-ahead and feed profile: path segments in, runs for the cycle out.
//!
//! The path is a chain of [`Segment`]s in one path parameter `u`: the programmed length, along which every
//! curve has finite derivatives. Where two moves meet, [`Planner`] replaces the corner by a blend within the
//! tolerance, or bounds the speed there so that the exact path can be kept.
//!
//! The limits of the axes become limits along the path ([`PathLimits`]): constants for `u'`, `u''` and `u'''`
//! on every [`Run`], a stretch of segments with like limits. On a run the motion is a jerk-limited [`Profile`],
//! solved in closed form; between runs acceleration is zero. The [`LookAhead`] gives every boundary the highest
//! speed from which all that follows can be obeyed, ending at rest at the end of what is known.
//!
//! The cycle solves the profile of the run that it enters, and of the present run again when a hold or an
//! override comes in: everything that it needs for that is in the run and in its exit speed, so it answers within
//! one cycle and asks nobody. A planner that dies leaves a plan that ends at rest on the path.
//!
//! ```
//! use evolvent_path::{Axes, Curve, Line};
//! use evolvent_planner::round_corner;
//!
//! // A right angle of two lines of 10 mm, rounded within 0.1 mm.
//! let (start, mut corner, mut end) = (Axes::zeros(), Axes::zeros(), Axes::zeros());
//! (corner[0], end[0], end[1]) = (10.0, 10.0, 10.0);
//! let left: Curve = Line::new(start, corner).unwrap().into();
//! let right: Curve = Line::new(corner, end).unwrap().into();
//! let rounding = round_corner(&left, &right, 0.1, 5.0).unwrap();
//! assert!(rounding.deviation > 0.09 && rounding.deviation <= 0.1);
//! // It begins on the left line with that line's direction.
//! let begin = Curve::from(rounding.blend).jet(0.0);
//! assert!((begin.position[0] - (10.0 - rounding.stretch)).abs() < 1e-12);
//! assert!((begin.first - left.jet(0.0).first).amax() < 1e-12);
//! ```
//! That is the classic planner: safe, simple, and the fallback. The near-optimal one, the default, has the path from
//! `evolvent-smooth` and the time law from `evolvent-timing`, in windows whose tail always ends at rest, and hands on
//! [`TimedSegment`]s, which the cycle only evaluates. Holds and overrides reach it as [`Request`]s. [`Planner`] is both of it;
//! [`PathStage`] and [`TimingStage`] are its halves, for those who have a thread for each.

mod classic;
mod corner;
mod horizon;
mod lookahead;
mod move_validator;
mod path_stage;
mod planner;
#[cfg(test)]
mod recorder;
mod step;
mod straight;
mod timing_stage;
mod validate;

pub use evolvent_timing::{
    DerivativeBounds, Outcome, PathLimits, Profile, ScalarLimits, ScalarState, lasting_speed, reachable_speed,
};

pub use corner::{Rounding, round_corner};
pub use lookahead::{LookAhead, PENDING_SEGMENTS, PENDING_STEPS};
pub use move_validator::MoveValidator;
pub use path_stage::{PathItem, PathSink, PathStage};
pub use planner::{PathRules, PlanError, Planner};
pub use step::{
    Answer, BlockMark, ExitSpeeds, PlanSink, Request, Run, Segment, SegmentMarks, Step, TimedSegment,
};
pub use timing_stage::TimingStage;

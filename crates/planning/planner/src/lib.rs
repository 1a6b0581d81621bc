//! The planner: moves in, a plan of time laws out, for the cycle to execute.
//!
//! Input: canonical moves ([`Planner::push`]) and the limits of the axes. Output, through a [`PlanSink`]:
//! [`Segment`]s of path and [`Step`]s over them.
//!
//! The corner blend of the classic planner:
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
//! // It starts on the left line, in the direction of that line.
//! let begin = Curve::from(rounding.blend).jet(0.0);
//! assert!((begin.position[0] - (10.0 - rounding.trim)).abs() < 1e-12);
//! assert!((begin.first - left.jet(0.0).first).amax() < 1e-12);
//! ```
//!
//! # Model
//!
//! The path is a chain of [`Segment`]s in one path parameter `u`, the programmed length, by which every curve
//! has finite derivatives. There are two planners:
//!
//! - The time-optimal planner, the default. [`PathStage`] smooths the path within the tolerance
//!   (`evolvent-smooth`), [`TimingStage`] finds its time law (`evolvent-timing`) in windows whose tail always
//!   ends at rest. It hands over [`TimedSegment`]s, which the cycle only evaluates. Overrides reach it as
//!   [`ReplanRequest`]s. The two stages may run in separate threads; [`Planner`] combines them.
//! - The classic planner, simpler and slower, the fallback. It replaces corners by quintic blends, or limits
//!   the speed there. The axis limits become constants for `u'`, `u''` and `u'''` on every [`Run`],
//!   consecutive segments with similar limits. On a run the motion is a jerk-limited
//!   [`Profile`] in closed form; between runs acceleration is zero. The
//!   [`Lookahead`] gives every boundary the highest speed from which all that follows can be executed. The
//!   cycle solves the profile of the run that it enters, and of the present run again after a hold or an
//!   override.
//!
//! # Guarantees
//!
//! At every moment the steps handed over end at rest on known path, so a planner that dies leaves a valid
//! plan. Plans are validated independently of the solver before they are handed over. The plan depends on the
//! moves and on the requests of the cycle, never on when either arrives. [`Segment::jet`] and
//! [`ExitSpeeds::at_override`] are real-time safe; everything else is for the planner's thread.
//!
//! # Where to read on
//!
//! `planner.rs`, then `horizon.rs` for windows and tails; `docs/architecture.md` for the connection to the
//! cycle.

mod classic;
mod corner;
mod horizon;
mod lookahead;
mod move_validator;
mod path_stage;
mod planner;
#[cfg(test)]
mod recorder;
mod speed_step;
mod step;
mod straight;
mod timing_stage;
mod validate;

pub use evolvent_timing::{
    DerivativeBounds, Outcome, PathLimits, Profile, ScalarLimits, ScalarState, monotone_reachable_speed,
    reachable_speed,
};

pub use corner::{Rounding, round_corner};
pub use lookahead::{Lookahead, PENDING_SEGMENTS, PENDING_STEPS};
pub use move_validator::{MoveValidator, TRAVEL_SLACK};
pub use path_stage::{PathItem, PathSink, PathStage};
pub use planner::{PathRules, PlanError, Planner};
pub use step::{
    BlockMark, ExitSpeeds, PlanSink, ReplanReply, ReplanRequest, Run, Segment, SegmentMarks, Step,
    TimedSegment,
};
pub use timing_stage::TimingStage;

//! Errors of planning a hole.

use thiserror::Error;

use crate::hole::MAX_DEPTHS;
use crate::{CurveError, InvoluteError, MAX_INVOLUTE_TURNS};

/// The reason why a hole cannot be milled as requested.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum HoleError {
    /// A diameter is zero, negative, NaN or out of range.
    #[error("the hole is {hole_mm} mm wide and the tool {tool_mm} mm: give two positive diameters in mm")]
    Diameter {
        /// Diameter of the hole in mm.
        hole_mm: f64,
        /// Diameter of the tool in mm.
        tool_mm: f64,
    },
    /// The tool does not fit into the hole.
    #[error("the tool of {tool_mm} mm does not fit into the hole of {hole_mm} mm: use a smaller tool")]
    ToolTooWide {
        /// Diameter of the hole in mm.
        hole_mm: f64,
        /// Diameter of the tool in mm.
        tool_mm: f64,
    },
    /// A coordinate of the centre is out of range.
    #[error("the hole's centre ({first_mm}, {second_mm}) is not usable: give two finite coordinates")]
    Centre {
        /// Coordinate along the plane's first axis in mm.
        first_mm: f64,
        /// Coordinate along the plane's second axis in mm.
        second_mm: f64,
    },
    /// The allowance is negative or leaves nothing to mill.
    #[error(
        "an allowance of {allowance_mm} mm is impossible: the tool has {limit_mm} mm of clearance, so give \
         at least 0 and less than that"
    )]
    Allowance {
        /// The requested allowance in mm.
        allowance_mm: f64,
        /// Half the difference of the diameters in mm.
        limit_mm: f64,
    },
    /// The pitch is zero, negative or not a number.
    #[error("a pitch of {pitch_mm} mm is impossible: give a positive number of mm per turn")]
    Pitch {
        /// The requested pitch in mm.
        pitch_mm: f64,
    },
    /// The pitch needs more turns than one involute block may have.
    #[error("a pitch of {pitch_mm} mm needs more than {MAX_INVOLUTE_TURNS} turns: give at least {min_mm} mm")]
    PitchTooSmall {
        /// The requested pitch in mm.
        pitch_mm: f64,
        /// The minimum possible pitch in mm.
        min_mm: f64,
    },
    /// The pitch is larger than the tool diameter.
    #[error(
        "a pitch of {pitch_mm} mm leaves material between the turns of a tool of {tool_mm} mm: reduce the \
         pitch or increase the number of turns"
    )]
    PitchTooWide {
        /// The actual pitch in mm.
        pitch_mm: f64,
        /// Diameter of the tool in mm.
        tool_mm: f64,
    },
    /// The number of turns is zero or too large.
    #[error("an involute of {turns} turns is impossible: give 1 to {MAX_INVOLUTE_TURNS}")]
    Turns {
        /// The requested number of turns.
        turns: u32,
    },
    /// The start point is not inside the final circle.
    #[error(
        "the start is {distance_mm} mm from the hole's centre, but the tool's centre moves on a circle of \
         {limit_mm} mm: start inside it"
    )]
    StartOutside {
        /// Distance from the centre of the hole in mm.
        distance_mm: f64,
        /// Radius of the final circle of the tool centre in mm.
        limit_mm: f64,
    },
    /// The radius of curvature at the start is not below that of the final circle.
    #[error(
        "a start with a radius of curvature of {radius_mm} mm is impossible: give at least 0 and less than \
         the final circle's {limit_mm} mm"
    )]
    StartRadius {
        /// The requested radius of curvature in mm.
        radius_mm: f64,
        /// Radius of the final circle of the tool centre in mm.
        limit_mm: f64,
    },
    /// The involute cannot have this length.
    #[error(
        "an involute of {length_mm} mm is impossible here: give more than 0 and at most {limit_mm} mm, or \
         more turns"
    )]
    StartLength {
        /// The requested length in mm.
        length_mm: f64,
        /// Length of the complete involute in mm.
        limit_mm: f64,
    },
    /// Depths and step contradict each other.
    #[error(
        "depths from {top_mm} mm to {bottom_mm} mm in steps of {step_mm} mm are impossible: the bottom must \
         be below the top and the step positive"
    )]
    Depth {
        /// The top in mm.
        top_mm: f64,
        /// The bottom in mm.
        bottom_mm: f64,
        /// The step in mm.
        step_mm: f64,
    },
    /// Too many depths.
    #[error("{count} depths are too many: use a larger step, at most {MAX_DEPTHS} depths are possible")]
    Depths {
        /// The number of depths needed.
        count: f64,
    },
    /// A circle could not be constructed.
    #[error(transparent)]
    Curve(#[from] CurveError),
    /// An involute could not be constructed.
    #[error(transparent)]
    Involute(#[from] InvoluteError),
}

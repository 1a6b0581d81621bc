//! What can be impossible about a hole.

use thiserror::Error;

use crate::hole::MAX_DEPTHS;
use crate::{CurveError, InvoluteError, MAX_INVOLUTE_TURNS};

/// Why a hole cannot be milled as asked.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum HoleError {
    /// A diameter is zero, negative, not a number or absurdly large.
    #[error("the hole is {hole_mm} mm wide and the tool {tool_mm} mm: give two positive diameters in mm")]
    Diameter {
        /// The hole's diameter in mm.
        hole_mm: f64,
        /// The tool's diameter in mm.
        tool_mm: f64,
    },
    /// The tool does not fit.
    #[error("the tool of {tool_mm} mm does not fit into the hole of {hole_mm} mm: take a smaller tool")]
    ToolTooWide {
        /// The hole's diameter in mm.
        hole_mm: f64,
        /// The tool's diameter in mm.
        tool_mm: f64,
    },
    /// The centre is not a usable point.
    #[error("the hole's centre ({first_mm}, {second_mm}) is not a usable point: give two finite coordinates")]
    Centre {
        /// Coordinate along the plane's first axis in mm.
        first_mm: f64,
        /// Coordinate along the plane's second axis in mm.
        second_mm: f64,
    },
    /// The allowance is negative or leaves nothing to mill.
    #[error(
        "an allowance of {allowance_mm} mm is impossible: between hole and tool there are {limit_mm} mm, so give at least 0 and less than that"
    )]
    Allowance {
        /// What was asked for in mm.
        allowance_mm: f64,
        /// Half the difference of the diameters in mm.
        limit_mm: f64,
    },
    /// The pitch is zero, negative or not a number.
    #[error("a pitch of {pitch_mm} mm is impossible: give a positive number of mm per turn")]
    Pitch {
        /// What was asked for in mm.
        pitch_mm: f64,
    },
    /// The pitch would need more turns than an involute block may have.
    #[error(
        "a pitch of {pitch_mm} mm needs more than {MAX_INVOLUTE_TURNS} turns: give at least {least_mm} mm"
    )]
    PitchTooSmall {
        /// What was asked for in mm.
        pitch_mm: f64,
        /// The least possible pitch in mm.
        least_mm: f64,
    },
    /// The pitch is wider than the tool.
    #[error(
        "a pitch of {pitch_mm} mm leaves material between the turns of a tool of {tool_mm} mm: make it smaller or the number of turns larger"
    )]
    PitchTooWide {
        /// The true pitch in mm.
        pitch_mm: f64,
        /// The tool's diameter in mm.
        tool_mm: f64,
    },
    /// The number of turns is zero or too large.
    #[error("an involute of {turns} turns is impossible: give 1 to {MAX_INVOLUTE_TURNS}")]
    Turns {
        /// What was asked for.
        turns: u32,
    },
    /// The start point is not inside the final circle.
    #[error(
        "the start lies {distance_mm} mm from the hole's centre, but the tool's centre runs on a circle of {limit_mm} mm: start inside it"
    )]
    StartOutside {
        /// Distance from the hole's centre in mm.
        distance_mm: f64,
        /// Radius of the tool centre's final circle in mm.
        limit_mm: f64,
    },
    /// The radius of curvature at the start is not below that of the final circle.
    #[error(
        "a start with a radius of curvature of {radius_mm} mm is impossible: give at least 0 and less than the final circle's {limit_mm} mm"
    )]
    StartRadius {
        /// What was asked for in mm.
        radius_mm: f64,
        /// Radius of the tool centre's final circle in mm.
        limit_mm: f64,
    },
    /// The involute cannot be that long.
    #[error(
        "an involute of {length_mm} mm is impossible here: give more than 0 and at most {limit_mm} mm, or more turns"
    )]
    StartLength {
        /// What was asked for in mm.
        length_mm: f64,
        /// Length of the whole involute in mm.
        limit_mm: f64,
    },
    /// Depth and step do not go together.
    #[error(
        "going from {top_mm} mm down to {bottom_mm} mm in steps of {step_mm} mm is impossible: the bottom must lie below the top, and the step be positive"
    )]
    Depth {
        /// The surface in mm.
        top_mm: f64,
        /// The bottom in mm.
        bottom_mm: f64,
        /// The step in mm.
        step_mm: f64,
    },
    /// Too many depths.
    #[error("{count} depths are too many: give a larger step, at most {MAX_DEPTHS} depths are possible")]
    Depths {
        /// Depths that would be needed.
        count: f64,
    },
    /// A circle could not be built.
    #[error(transparent)]
    Curve(#[from] CurveError),
    /// An involute could not be built.
    #[error(transparent)]
    Involute(#[from] InvoluteError),
}

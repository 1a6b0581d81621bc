//! Errors of constructing a line, an arc, a blend or a spline.

use thiserror::Error;

use crate::{Axes, AxisLetter};

/// Maximum magnitude of coordinates and radii, in mm or degrees (1000 km). Larger values are taken for a
/// mistake.
pub const MAX_COORDINATE: f64 = 1e9;

/// Minimum radius in mm (1 nm). Smaller values are taken for a mistake.
pub const MIN_RADIUS_MM: f64 = 1e-6;

/// Maximum number of full turns of one arc.
pub const MAX_ARC_TURNS: u32 = 1_000_000;

/// The reason why a line, arc, blend or spline cannot be constructed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CurveError {
    /// A coordinate is NaN, infinite or out of range.
    #[error("coordinate {axis} is {value}: give a number between -{MAX_COORDINATE:e} and {MAX_COORDINATE:e}")]
    Coordinate {
        /// The axis letter.
        axis: char,
        /// The given value, in mm or degrees.
        value: f64,
    },
    /// The centre is NaN, infinite or out of range.
    #[error("the centre ({first}, {second}) is not usable: give two coordinates below {MAX_COORDINATE:e} mm")]
    Centre {
        /// Coordinate along the plane's first axis in mm.
        first: f64,
        /// Coordinate along the plane's second axis in mm.
        second: f64,
    },
    /// Start and end are equal in all nine axes.
    #[error("start and end are the same point: remove the block")]
    ZeroLength,
    /// The radius at the start or at the end is zero or too small.
    #[error(
        "the arc's radius is {start_radius_mm} mm at its start and {end_radius_mm} mm at its end: move the \
         centre so that both are at least {MIN_RADIUS_MM:e} mm"
    )]
    Radius {
        /// Distance from the centre to the start in mm.
        start_radius_mm: f64,
        /// Distance from the centre to the end in mm.
        end_radius_mm: f64,
    },
    /// The sense of an arc is [`Straight`](crate::Sense::Straight).
    #[error("an arc is either clockwise or counter-clockwise: choose one")]
    Sense,
    /// Too many turns.
    #[error(
        "an arc of {turns} additional turns is too long: split it into arcs of at most {MAX_ARC_TURNS} turns"
    )]
    Turns {
        /// The requested number of additional full turns.
        turns: u32,
    },
    /// The parameter domain is out of range.
    #[error("the parameter domain of {domain} mm is out of range: give 1e-9 to {MAX_COORDINATE:e} mm")]
    Domain {
        /// The requested domain.
        domain: f64,
    },
    /// A derivative is NaN, infinite or out of range.
    #[error("derivative {order} of axis {axis} is {value}: start and end at regular points of the curves")]
    Derivative {
        /// The axis letter.
        axis: char,
        /// Order of the derivative, 1 to 3.
        order: u8,
        /// Its value.
        value: f64,
    },
}

/// The first coordinate that is out of range, if any.
pub(crate) fn bad_coordinate(axes: &Axes) -> Option<(char, f64)> {
    AxisLetter::ALL
        .into_iter()
        .map(|axis| (axis.letter(), axes[axis.index()]))
        .find(|(_, value)| !(value.abs() <= MAX_COORDINATE))
}

pub(crate) fn check_coordinates(axes: &Axes) -> Result<(), CurveError> {
    bad_coordinate(axes).map_or(Ok(()), |(axis, value)| {
        Err(CurveError::Coordinate { axis, value })
    })
}

pub(crate) fn check_centre(centre: [f64; 2]) -> Result<(), CurveError> {
    let [first, second] = centre;
    if first.abs() <= MAX_COORDINATE && second.abs() <= MAX_COORDINATE {
        Ok(())
    } else {
        Err(CurveError::Centre { first, second })
    }
}

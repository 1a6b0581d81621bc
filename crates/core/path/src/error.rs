//! What can be wrong with the data of a line, an arc or a blend.

use thiserror::Error;

use crate::{Axes, AxisLetter};

/// Coordinates and radii beyond this are taken for a mistake, in mm or degrees (1000 km).
pub const MAX_COORDINATE: f64 = 1e9;

/// Radii below this are taken for a mistake (1 nm).
pub const MIN_RADIUS_MM: f64 = 1e-6;

/// Most full turns of one arc.
pub const MAX_ARC_TURNS: u32 = 1_000_000;

/// Why a line, arc or blend cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CurveError {
    /// A coordinate is NaN, infinite or absurdly large.
    #[error("coordinate {axis} is {value}: give a number between -{MAX_COORDINATE:e} and {MAX_COORDINATE:e}")]
    Coordinate {
        /// The axis' letter.
        axis: char,
        /// What was given, in mm or degrees.
        value: f64,
    },
    /// The centre is NaN, infinite or absurdly large.
    #[error(
        "the centre ({first}, {second}) is not a usable point: give two numbers below {MAX_COORDINATE:e} mm"
    )]
    Centre {
        /// Coordinate along the plane's first axis in mm.
        first: f64,
        /// Coordinate along the plane's second axis in mm.
        second: f64,
    },
    /// Start and end are the same in all nine axes.
    #[error("start and end are the same point, so there is no path: leave the block out")]
    ZeroLength,
    /// The radius at the start or at the end is zero or too small to compute with.
    #[error(
        "the arc's radius is {start_radius_mm} mm at its start and {end_radius_mm} mm at its end: move the centre so that both are at least {MIN_RADIUS_MM:e} mm"
    )]
    Radius {
        /// Distance from the centre to the start in mm.
        start_radius_mm: f64,
        /// Distance from the centre to the end in mm.
        end_radius_mm: f64,
    },
    /// An arc needs a sense.
    #[error("an arc turns either clockwise or counter-clockwise: name one of them")]
    Sense,
    /// Too many turns.
    #[error("{turns} additional turns of one arc are too many: split it, at most {MAX_ARC_TURNS} each")]
    Turns {
        /// Additional full turns asked for.
        turns: u32,
    },
    /// A blend's parameter domain is not a usable length.
    #[error(
        "a blend over a parameter domain of {domain} mm is impossible: give at least 1e-9 mm and at most {MAX_COORDINATE:e} mm"
    )]
    Domain {
        /// The domain asked for.
        domain: f64,
    },
    /// A derivative at a blend's end is NaN, infinite or absurdly large.
    #[error("derivative {order} of axis {axis} at the blend's end is {value}: blend from a regular point")]
    Derivative {
        /// The axis' letter.
        axis: char,
        /// Order of the derivative: 1 or 2.
        order: u8,
        /// Its value.
        value: f64,
    },
}

/// The first coordinate that cannot be used, if any.
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

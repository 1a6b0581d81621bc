//! Why an involute cannot be constructed.

use thiserror::Error;

use crate::error::{MAX_COORDINATE, MIN_RADIUS_MM, bad_coordinate};
use crate::involute::MAX_INVOLUTE_TURNS;
use crate::plane::norm;
use crate::{Axes, Sense};

/// The reason why an involute cannot be constructed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum InvoluteError {
    /// A coordinate is NaN, infinite or out of range.
    #[error("coordinate {axis} is {value}: give a number between -{MAX_COORDINATE:e} and {MAX_COORDINATE:e}")]
    Coordinate {
        /// The axis letter.
        axis: char,
        /// The given value, in mm or degrees.
        value: f64,
    },
    /// The base circle is not usable.
    #[error(
        "the base circle has its centre at ({first}, {second}) mm and a radius of {base_radius_mm} mm: give \
         two finite coordinates and a radius of at least {MIN_RADIUS_MM:e} mm"
    )]
    BaseCircle {
        /// Centre along the plane's first axis in mm.
        first: f64,
        /// Centre along the plane's second axis in mm.
        second: f64,
        /// Radius in mm.
        base_radius_mm: f64,
    },
    /// The sense is [`Straight`](Sense::Straight).
    #[error("an involute is either clockwise or counter-clockwise: choose one")]
    Sense,
    /// The tolerance is negative or not a number.
    #[error("the end point tolerance is {tolerance_mm} mm: give a number that is not negative")]
    Tolerance {
        /// The given tolerance in mm.
        tolerance_mm: f64,
    },
    /// The start is inside the base circle, where no involute exists.
    #[error(
        "the start is {radius_mm} mm from the centre of the base circle, inside its radius of \
         {base_radius_mm} mm: move the start outwards or reduce the base circle"
    )]
    StartInside {
        /// Distance from the centre of the base circle in mm.
        radius_mm: f64,
        /// Radius of the base circle in mm.
        base_radius_mm: f64,
    },
    /// The end is inside the base circle, where no involute exists.
    #[error(
        "the end is {radius_mm} mm from the centre of the base circle, inside its radius of \
         {base_radius_mm} mm: move the end outwards or reduce the base circle"
    )]
    EndInside {
        /// Distance from the centre of the base circle in mm.
        radius_mm: f64,
        /// Radius of the base circle in mm.
        base_radius_mm: f64,
    },
    /// Start and end are equally far from the centre of the base circle.
    #[error(
        "start and end are {start_radius_mm} mm and {end_radius_mm} mm from the centre of the base circle, \
         but an involute changes that distance: use G2 or G3 for a circle"
    )]
    EqualRadii {
        /// Distance of the start in mm.
        start_radius_mm: f64,
        /// Distance of the end in mm.
        end_radius_mm: f64,
    },
    /// The involute has more turns than one block may have.
    #[error("the involute has {turns} turns, at most {MAX_INVOLUTE_TURNS} are possible: split it")]
    Turns {
        /// Number of turns from start to end.
        turns: f64,
    },
    /// The end point is not on the involute through the start.
    #[error(
        "the end point is {distance_mm} mm off the involute through the start, more than the tolerance of \
         {tolerance_mm} mm: it is {end_radius_mm} mm from the centre of the base circle, where the involute \
         in the same direction is at {involute_radius_mm} mm"
    )]
    OffInvolute {
        /// Distance of the end point from the involute in mm.
        distance_mm: f64,
        /// The tolerance in mm.
        tolerance_mm: f64,
        /// Distance of the end point from the centre of the base circle in mm.
        end_radius_mm: f64,
        /// Distance of the involute's point in the same direction that is nearest to that radius, in mm.
        involute_radius_mm: f64,
    },
}

/// Checks points, base circle, sense and tolerance by themselves.
pub(crate) fn check_input(
    start: &Axes,
    end: &Axes,
    centre: [f64; 2],
    base_radius_mm: f64,
    sense: Sense,
    tolerance_mm: f64,
) -> Result<(), InvoluteError> {
    for point in [start, end] {
        if let Some((axis, value)) = bad_coordinate(point) {
            return Err(InvoluteError::Coordinate { axis, value });
        }
    }
    let r = base_radius_mm;
    let [first, second] = centre;
    let usable = first.abs() <= MAX_COORDINATE && second.abs() <= MAX_COORDINATE;
    if !(usable && (MIN_RADIUS_MM..=MAX_COORDINATE).contains(&r)) {
        return Err(InvoluteError::BaseCircle {
            first,
            second,
            base_radius_mm,
        });
    }
    if sense == Sense::Straight {
        return Err(InvoluteError::Sense);
    }
    if !(tolerance_mm >= 0.0) {
        return Err(InvoluteError::Tolerance { tolerance_mm });
    }
    Ok(())
}

/// Checks that neither end is inside the base circle.
pub(crate) fn check_radii(
    centre: [f64; 2],
    r: f64,
    [start_radius_mm, end_radius_mm]: [f64; 2],
    tolerance_mm: f64,
) -> Result<(), InvoluteError> {
    // A point programmed on the base circle may have been rounded to its inside.
    let slack = (tolerance_mm + 8.0 * f64::EPSILON * (r + norm(centre))).min(0.1 * r);
    if !(start_radius_mm >= r - slack) {
        return Err(InvoluteError::StartInside {
            radius_mm: start_radius_mm,
            base_radius_mm: r,
        });
    }
    if !(end_radius_mm >= r - slack) {
        return Err(InvoluteError::EndInside {
            radius_mm: end_radius_mm,
            base_radius_mm: r,
        });
    }
    Ok(())
}

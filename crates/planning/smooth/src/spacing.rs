//! The knot spacing.
//!
//! At a joint the spacing is half the distance over which the programmed path bends away by twice the
//! tolerance (its second difference). Angles do not enter, so a true corner and a chain of a thousand chords
//! are treated alike. Away from a joint the spacing may grow by [`GROWTH`] per unit of the path.

use crate::chain::{Chain, ProgramSegment, distance};

/// Maximum growth of the spacing along the path.
pub(crate) const GROWTH: f64 = 0.15;
/// Maximum spacing in tolerances.
const MAX_TOLERANCES: f64 = 100.0;
/// Maximum and minimum spacing, mm.
const MAX_SPACING_MM: f64 = 2.0;
const MIN_SPACING_MM: f64 = 1e-7;
/// Factor between the steps of the search.
const SEARCH_FACTOR: f64 = 1.4;

/// Maximum spacing at a tolerance.
pub(crate) fn max_spacing(tolerance: f64) -> f64 {
    (MAX_TOLERANCES * tolerance).min(MAX_SPACING_MM)
}

/// The spacing at the start of a segment from the bend of the path there; `None` while too little of the path
/// is known. The search starts at `guess`.
pub(crate) fn at_joint(chain: &Chain, number: usize, guess: f64, complete: bool) -> Option<f64> {
    let segment = chain.get(number)?;
    let before = number
        .checked_sub(1)
        .and_then(|number| chain.get(number))
        .unwrap_or(segment);
    let tolerance = segment.tolerance.min(before.tolerance);
    let known = if complete { f64::INFINITY } else { chain.end() };
    let (u, here) = (segment.from, segment.position(segment.from));
    let max_spacing = 2.0 * max_spacing(tolerance);
    let (mut last, mut first) = (number, number);
    let mut bends = |x: f64| {
        last = chain.find_near(u + x, last);
        first = chain.find_near(u - x, first);
        let ahead = chain.get(last).unwrap_or(segment);
        let behind = chain.get(first).unwrap_or(segment);
        distance(&(ahead.position(u + x) + behind.position(u - x) - here * 2.0)) > 2.0 * tolerance
    };
    let mut x = guess.min(max_spacing).max(MIN_SPACING_MM);
    if u + x > known {
        return None;
    }
    if bends(x) {
        while x > MIN_SPACING_MM && bends(x) {
            x /= SEARCH_FACTOR;
        }
    } else {
        while x < max_spacing {
            let next = (x * SEARCH_FACTOR).min(max_spacing);
            if u + next > known {
                return None;
            }
            if bends(next) {
                break;
            }
            x = next;
        }
    }
    Some(0.7 * x)
}

/// The spacing inside a curved segment: half the distance over which it bends away by twice the tolerance.
pub(crate) fn inside(segment: &ProgramSegment) -> f64 {
    if segment.straight {
        return max_spacing(segment.tolerance);
    }
    let (_, second, _) = segment.curve.derivative_bounds(0.0, segment.curve.domain());
    let bend = distance(&second);
    (0.5 * (2.0 * segment.tolerance / bend).sqrt())
        .min(max_spacing(segment.tolerance))
        .max(MIN_SPACING_MM)
}

/// The spacing at `u` inside a segment, from those at its two ends.
pub(crate) fn within(segment: &ProgramSegment, at_end: f64, u: f64) -> f64 {
    (segment.spacing + GROWTH * (u - segment.from))
        .min(at_end + GROWTH * (segment.to - u))
        .min(segment.inner_spacing)
        .max(MIN_SPACING_MM)
}

//! How far apart knots are to be.
//!
//! At a joint the spacing is half the distance over which the programmed path bends away by twice the tolerance
//! (its second difference); it does not ask for angles, so a true corner and a chain of a thousand chords are the
//! same to it. Away from a joint it may grow by [`GROWTH`] per unit of the path.

use crate::chain::{Chain, ProgramSegment, distance};

/// Largest growth of the spacing along the path.
pub(crate) const GROWTH: f64 = 0.15;
/// Largest spacing in tolerances.
const MAX_TOLERANCES: f64 = 100.0;
/// Largest and smallest spacing, mm.
const MOST: f64 = 2.0;
const LEAST: f64 = 1e-7;
/// Steps of the search.
const STEP: f64 = 1.4;

/// Largest spacing at a tolerance.
pub(crate) fn most(tolerance: f64) -> f64 {
    (MAX_TOLERANCES * tolerance).min(MOST)
}

/// The spacing at the start of a link by the bend of the path there; `None` while too little of the path is known.
/// The search starts at `guess`.
pub(crate) fn at_joint(chain: &Chain, number: usize, guess: f64, complete: bool) -> Option<f64> {
    let link = chain.get(number)?;
    let before = number
        .checked_sub(1)
        .and_then(|number| chain.get(number))
        .unwrap_or(link);
    let tolerance = link.tolerance.min(before.tolerance);
    let known = if complete { f64::INFINITY } else { chain.end() };
    let (u, here) = (link.from, link.position(link.from));
    let most = 2.0 * most(tolerance);
    let (mut last, mut first) = (number, number);
    let mut bends = |x: f64| {
        last = chain.find_near(u + x, last);
        first = chain.find_near(u - x, first);
        let ahead = chain.get(last).unwrap_or(link);
        let behind = chain.get(first).unwrap_or(link);
        distance(&(ahead.position(u + x) + behind.position(u - x) - here * 2.0)) > 2.0 * tolerance
    };
    let mut x = guess.min(most).max(LEAST);
    if u + x > known {
        return None;
    }
    if bends(x) {
        while x > LEAST && bends(x) {
            x /= STEP;
        }
    } else {
        while x < most {
            let next = (x * STEP).min(most);
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

/// The spacing inside a curved link: half the distance over which it bends away by twice the tolerance.
pub(crate) fn inside(link: &ProgramSegment) -> f64 {
    if link.straight {
        return most(link.tolerance);
    }
    let (_, second, _) = link.curve.derivative_bounds(0.0, link.curve.domain());
    let bend = distance(&second);
    (0.5 * (2.0 * link.tolerance / bend).sqrt())
        .min(most(link.tolerance))
        .max(LEAST)
}

/// The spacing at `u` inside a link, by those at its two ends.
pub(crate) fn within(link: &ProgramSegment, at_end: f64, u: f64) -> f64 {
    (link.spacing + GROWTH * (u - link.from))
        .min(at_end + GROWTH * (link.to - u))
        .min(link.inner_spacing)
        .max(LEAST)
}

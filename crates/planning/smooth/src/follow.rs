//! Samples that follow the spline along the programmed path.
//!
//! On a chain of short lines a sample need not compare with the programmed point of its own parameter: any point of the
//! path nearby proves as much, and the nearest proves it best. So between rounds of the optimisation the programmed
//! points move to where the spline has come to. That never takes room from a sample, as the nearest point is no farther
//! than the one before.
//!
//! Between two samples the path must not stray from the straight between their points, or what lies between would be
//! proven by nothing; a point that would break this moves half of its way, or stays. No point moves farther from its
//! own parameter than the tolerance, so that the spline misses no programmed point by more than twice that.

use std::ops::Range;

use evolvent_path::Axes;

use crate::chain::{Chain, ProgramSegment};
use crate::tube::{Sample, dot};

/// Links that a point may pass in one go.
const MAX_LINKS: usize = 64;
/// Moves shorter than this, in tolerances, are not worth looking for what they break.
const MIN_MOVE: f64 = 0.005;

/// Whether a link is one along which samples may move.
fn passable(link: &ProgramSegment, tolerance: f64) -> bool {
    link.straight
        && link.tolerance >= tolerance
        && link.slope().as_slice()[3..].iter().all(|&rate| rate == 0.0)
}

/// How far the point of a sample of link `number` at `u` may move. Beyond the link itself only if it may `pass` joints.
pub(crate) fn range(chain: &Chain, number: usize, u: f64, pass: bool) -> (f64, f64) {
    let Some(link) = chain.get(number) else {
        return (u, u);
    };
    let tolerance = link.tolerance;
    if !passable(link, tolerance) {
        return (u, u);
    }
    let (mut low, mut high) = (link.from.min(u), link.to.max(u));
    if pass && u > link.from {
        let mut first = number;
        while low > u - tolerance
            && first > chain.first()
            && let (Some(here), Some(before)) = (chain.get(first), chain.get(first - 1))
            && !here.kept
            && passable(before, tolerance)
        {
            low = before.from;
            first -= 1;
        }
    }
    if pass && u < link.to {
        let mut last = number + 1;
        while high < u + tolerance
            && let Some(next) = chain.get(last)
            && !next.kept
            && passable(next, tolerance)
        {
            high = next.to;
            last += 1;
        }
    }
    (low.max(u - tolerance), high.min(u + tolerance))
}

/// A point of the programmed path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PathPoint {
    /// Parameter, and the number of a link that it belongs to.
    pub(crate) at: f64,
    pub(crate) link: usize,
    /// XYZ.
    pub(crate) point: [f64; 3],
}

fn minus(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    std::array::from_fn(|d| a[d] - b[d])
}

fn xyz(p: &Axes) -> [f64; 3] {
    std::array::from_fn(|d| p[d])
}

/// The nearest point to `place` of the lines within `range`, looked for from link `middle`: downhill or, if `all`,
/// everywhere.
pub(crate) fn nearest(
    chain: &Chain,
    range: (f64, f64),
    middle: usize,
    place: &[f64; 3],
    all: bool,
) -> Option<PathPoint> {
    let on = |number: usize| -> Option<(f64, PathPoint)> {
        let link = chain.get(number)?;
        let (low, high) = (link.from.max(range.0), link.to.min(range.1));
        if !(low <= high) {
            return None;
        }
        let (start, slope) = (xyz(link.start()), xyz(link.slope()));
        // Slopes of lines in XYZ are of length one.
        let at = (link.from + dot(&minus(place, &start), &slope))
            .max(low)
            .min(high);
        let point = std::array::from_fn(|d| start[d] + slope[d] * (at - link.from));
        let error = minus(place, &point);
        let spot = PathPoint {
            at,
            link: number,
            point,
        };
        Some((dot(&error, &error), spot))
    };
    let mut best = on(middle);
    for step in [1, usize::MAX] {
        let mut number = middle;
        for _ in 0..MAX_LINKS {
            number = number.wrapping_add(step);
            let Some(found) = on(number) else {
                break;
            };
            if best.is_none_or(|best| found.0 < best.0) {
                best = Some(found);
            } else if !all {
                break;
            }
        }
    }
    best.map(|(_, spot)| spot)
}

/// How far the path strays from the straight between two of its points.
fn chord_deviation(chain: &Chain, a: &PathPoint, b: &PathPoint) -> f64 {
    let (a, b) = if a.at <= b.at { (a, b) } else { (b, a) };
    let chord = minus(&b.point, &a.point);
    let length2 = dot(&chord, &chord);
    let mut most: f64 = 0.0;
    for number in a.link + 1..=b.link {
        let Some(link) = chain.get(number) else {
            break;
        };
        let off = minus(&xyz(link.start()), &a.point);
        let share = if length2 > 0.0 {
            (dot(&off, &chord) / length2).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let beside: [f64; 3] = std::array::from_fn(|d| off[d] - share * chord[d]);
        most = most.max(dot(&beside, &beside));
    }
    most.sqrt()
}

/// Moves the points of the samples `which` to where the spline by `points` is nearest; the first and the last of all
/// stay, as their neighbours are not known.
pub(crate) fn follow(chain: &Chain, samples: &mut [Sample], which: Range<usize>, points: &[Axes]) {
    for k in which.start.max(1)..which.end.min(samples.len().saturating_sub(1)) {
        let sample = samples[k];
        if !sample.moves() {
            continue;
        }
        let i = sample.interval;
        let error = sample.error(&points[i..i + 4]);
        let place = std::array::from_fn(|d| error[d] + sample.centre[d]);
        let (here, before, after) = (sample.spot(), samples[k - 1].spot(), samples[k + 1].spot());
        let holds = |spot: &PathPoint| {
            chord_deviation(chain, &before, spot) <= samples[k - 1].chord_deviation
                && chord_deviation(chain, spot, &after) <= sample.chord_deviation
        };
        let Some(best) = nearest(chain, sample.range, here.link, &place, false) else {
            continue;
        };
        if !((best.at - here.at).abs() > MIN_MOVE * sample.tolerance) {
            continue;
        }
        let mut to = best;
        if !holds(&to) {
            to.at = 0.5 * (here.at + best.at);
            to.link = chain.find_near(to.at, here.link);
            let Some(link) = chain.get(to.link) else {
                continue;
            };
            to.point = xyz(&link.position(to.at));
            let off = minus(&place, &to.point);
            if !(dot(&off, &off) < dot(&error, &error)) || !holds(&to) {
                continue;
            }
        }
        samples[k].move_to(&to);
    }
}

//! Samples that follow the spline along the programmed path.
//!
//! On a chain of short lines a sample need not be compared with the programmed point of its own parameter.
//! Any nearby point of the path proves the tolerance, and the nearest one gives the largest margin. So
//! between rounds of the optimisation the programmed points move to the nearest points of the spline. That
//! never reduces the margin of a sample, because the nearest point is not farther away than the previous one.
//!
//! Between two samples the deviation of the path from the chord between their points must stay bounded,
//! because nothing else proves the tolerance there. A point that would exceed the bound moves half the
//! distance, or stays. No point moves farther from its own parameter than the tolerance, so the spline misses
//! no programmed point by more than twice the tolerance.

use std::ops::Range;

use evolvent_path::Axes;

use crate::chain::{Chain, ProgramSegment};
use crate::tube::{Sample, dot};

/// Maximum number of segments that a point may pass in one move.
const MAX_LINKS: usize = 64;
/// Minimum length of a move, in tolerances; shorter ones do not justify the check.
const MIN_MOVE: f64 = 0.005;

/// Whether samples may move along a segment.
fn passable(segment: &ProgramSegment, tolerance: f64) -> bool {
    segment.straight
        && segment.tolerance >= tolerance
        && segment.slope().as_slice()[3..].iter().all(|&rate| rate == 0.0)
}

/// The range in which the point of a sample of segment `number` at `u` may move. It leaves the segment only
/// if `pass`.
pub(crate) fn range(chain: &Chain, number: usize, u: f64, pass: bool) -> (f64, f64) {
    let Some(segment) = chain.get(number) else {
        return (u, u);
    };
    let tolerance = segment.tolerance;
    if !passable(segment, tolerance) {
        return (u, u);
    }
    let (mut low, mut high) = (segment.from.min(u), segment.to.max(u));
    if pass && u > segment.from {
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
    if pass && u < segment.to {
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
    /// Parameter, and the number of a segment that contains it.
    pub(crate) at: f64,
    pub(crate) segment: usize,
    /// XYZ.
    pub(crate) point: [f64; 3],
}

fn minus(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    std::array::from_fn(|d| a[d] - b[d])
}

fn xyz(p: &Axes) -> [f64; 3] {
    std::array::from_fn(|d| p[d])
}

/// The point of the lines in `range` nearest to `target`, searched from segment `middle`: by descent or, if
/// `all`, exhaustively.
pub(crate) fn nearest(
    chain: &Chain,
    range: (f64, f64),
    middle: usize,
    target: &[f64; 3],
    all: bool,
) -> Option<PathPoint> {
    let on = |number: usize| -> Option<(f64, PathPoint)> {
        let segment = chain.get(number)?;
        let (low, high) = (segment.from.max(range.0), segment.to.min(range.1));
        if !(low <= high) {
            return None;
        }
        let (start, slope) = (xyz(segment.start()), xyz(segment.slope()));
        // Slopes of lines in XYZ are unit vectors.
        let at = (segment.from + dot(&minus(target, &start), &slope))
            .max(low)
            .min(high);
        let point = std::array::from_fn(|d| start[d] + slope[d] * (at - segment.from));
        let error = minus(target, &point);
        let path_point = PathPoint {
            at,
            segment: number,
            point,
        };
        Some((dot(&error, &error), path_point))
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
    best.map(|(_, path_point)| path_point)
}

/// Maximum distance of the path from the chord between two of its points.
fn chord_deviation(chain: &Chain, a: &PathPoint, b: &PathPoint) -> f64 {
    let (a, b) = if a.at <= b.at { (a, b) } else { (b, a) };
    let chord = minus(&b.point, &a.point);
    let length2 = dot(&chord, &chord);
    let mut max: f64 = 0.0;
    for number in a.segment + 1..=b.segment {
        let Some(segment) = chain.get(number) else {
            break;
        };
        let offset = minus(&xyz(segment.start()), &a.point);
        let fraction = if length2 > 0.0 {
            (dot(&offset, &chord) / length2).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let beside: [f64; 3] = std::array::from_fn(|d| offset[d] - fraction * chord[d]);
        max = max.max(dot(&beside, &beside));
    }
    max.sqrt()
}

/// Moves the points of the samples `which` to the nearest points of the spline with control points `points`.
/// The first and last samples stay because their neighbours are unknown.
pub(crate) fn follow(chain: &Chain, samples: &mut [Sample], which: Range<usize>, points: &[Axes]) {
    for k in which.start.max(1)..which.end.min(samples.len().saturating_sub(1)) {
        let sample = samples[k];
        if !sample.moves() {
            continue;
        }
        let i = sample.interval;
        let error = sample.error(&points[i..i + 4]);
        let target = std::array::from_fn(|d| error[d] + sample.centre[d]);
        let (here, before, after) = (
            sample.path_point(),
            samples[k - 1].path_point(),
            samples[k + 1].path_point(),
        );
        let holds = |path_point: &PathPoint| {
            chord_deviation(chain, &before, path_point) <= samples[k - 1].chord_deviation
                && chord_deviation(chain, path_point, &after) <= sample.chord_deviation
        };
        let Some(best) = nearest(chain, sample.range, here.segment, &target, false) else {
            continue;
        };
        if !((best.at - here.at).abs() > MIN_MOVE * sample.tolerance) {
            continue;
        }
        let mut to = best;
        if !holds(&to) {
            to.at = 0.5 * (here.at + best.at);
            to.segment = chain.find_near(to.at, here.segment);
            let Some(segment) = chain.get(to.segment) else {
                continue;
            };
            to.point = xyz(&segment.position(to.at));
            let offset = minus(&target, &to.point);
            if !(dot(&offset, &offset) < dot(&error, &error)) || !holds(&to) {
                continue;
            }
        }
        samples[k].move_to(&to);
    }
}

//! The tube around the programmed path in which the spline stays.
//!
//! A sample compares a point of the spline with the programmed path near the same parameter. Where the path
//! has dense joints that is the programmed point itself: the error stays in a ball. On a longer straight
//! segment the point may also slide along it: it stays in the capsule of all points within the tolerance `P`
//! of a part of the segment. A ball would waste `1 / sin(half the angle)` at every corner. On a chain of
//! short lines the ball itself moves: it follows the spline to the nearest programmed point, but at most by
//! `P`.

use evolvent_path::{Axes, ParamCurve, Spline};

use crate::basis::{Basis, values};
use crate::chain::{Chain, ProgramSegment, distance};
use crate::follow::{PathPoint, nearest, range};

/// Fraction of the tolerance reserved for the path between samples, if an interval has a single part.
const MARGIN_FRACTION: f64 = 0.04;
/// Maximum length of the tube along a straight segment, in tolerances.
const MAX_SLACK: f64 = 8.0;
/// A straight segment shorter than this number of knot intervals counts as dense.
const DENSE_INTERVALS: f64 = 3.0;

/// The groups of axes whose error is measured together: XYZ, UVW, A, B, C.
pub(crate) const GROUPS: [(usize, usize); 5] = [(0, 3), (6, 3), (3, 1), (4, 1), (5, 1)];

/// One constraint on the four control points of an interval.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    /// Index of the interval.
    pub(crate) interval: usize,
    /// Index into [`GROUPS`].
    pub(crate) group: usize,
    /// The basis functions at the sample.
    pub(crate) weights: [f64; 4],
    /// The programmed point.
    pub(crate) centre: [f64; 3],
    /// Direction of the straight segment, zero for a ball.
    pub(crate) along: [f64; 3],
    /// Permitted sliding distances in both directions.
    pub(crate) tangential_slack: (f64, f64),
    /// Square of the radius.
    pub(crate) radius2: f64,
    /// The distance that must not be exceeded, also between samples.
    pub(crate) tolerance: f64,
    /// Parameter of the programmed point, and a segment that contains it.
    pub(crate) at: f64,
    pub(crate) segment: usize,
    /// The range in which it may follow the spline; empty if it may not.
    pub(crate) range: (f64, f64),
    /// Permitted deviation of the path from the chord to the points of the neighbouring samples.
    pub(crate) chord_deviation: f64,
}

impl Sample {
    /// The error of a point.
    pub(crate) fn error(&self, points: &[Axes]) -> [f64; 3] {
        let (first, count) = GROUPS[self.group];
        let mut error = [0.0; 3];
        for d in 0..count {
            error[d] = -self.centre[d];
            for (weight, point) in self.weights.iter().zip(points) {
                error[d] += weight * point[first + d];
            }
        }
        error
    }

    /// The vector from the nearest point of the straight segment to the point, and whether that is inside of
    /// it.
    pub(crate) fn offset(&self, error: &[f64; 3]) -> ([f64; 3], bool) {
        let x = dot(error, &self.along);
        let nearest = x.max(-self.tangential_slack.0).min(self.tangential_slack.1);
        let offset = std::array::from_fn(|d| error[d] - nearest * self.along[d]);
        (
            offset,
            x > -self.tangential_slack.0 && x < self.tangential_slack.1,
        )
    }

    /// Whether it may follow the spline.
    pub(crate) fn moves(&self) -> bool {
        self.range.0 < self.range.1
    }

    /// Reduces the radius.
    fn reduce_radius(&mut self, by: f64) {
        let radius = (self.radius2.sqrt() - by).max(0.0);
        self.radius2 = radius * radius;
    }

    /// Its programmed point.
    pub(crate) fn path_point(&self) -> PathPoint {
        PathPoint {
            at: self.at,
            segment: self.segment,
            point: self.centre,
        }
    }

    /// Sets another programmed point.
    pub(crate) fn move_to(&mut self, path_point: &PathPoint) {
        (self.at, self.segment, self.centre) = (path_point.at, path_point.segment, path_point.point);
    }

    /// The squared distance relative to the squared radius.
    pub(crate) fn ratio(&self, error: &[f64; 3]) -> f64 {
        let (offset, _) = self.offset(error);
        dot(&offset, &offset) / self.radius2
    }
}

pub(crate) fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The straight part of the path that contains a segment, as seen from a position on it.
struct Straight {
    behind: f64,
    ahead: f64,
    /// The extent of the part of it that has the feed of the segment.
    feed_behind: f64,
    feed_ahead: f64,
    sharp: bool,
}

/// Extent of the straight part in both directions, searched up to `limit`. Everything beyond is ignored, so
/// that the result does not depend on how much more of the path is known.
fn straight(chain: &Chain, number: usize, segment: &ProgramSegment, u: f64, limit: f64) -> Straight {
    let (mut behind, mut ahead, mut sharp) = (u - segment.from, segment.to - u, false);
    let (mut feed_behind, mut feed_ahead) = (behind, ahead);
    let (mut same_behind, mut same_ahead) = (true, true);
    let mut first = number;
    while behind < limit
        && let Some(here) = chain.get(first)
    {
        let before = first.checked_sub(1).and_then(|n| chain.get(n));
        match before {
            Some(before) if !here.corner() && before.straight && before.tolerance >= segment.tolerance => {
                first -= 1;
                behind = u - before.from;
                same_behind &= before.has_feed_of(segment);
                if same_behind {
                    feed_behind = behind;
                }
            }
            _ => {
                sharp |= here.sharp;
                break;
            }
        }
    }
    let mut last = number + 1;
    while ahead < limit
        && let Some(here) = chain.get(last)
    {
        if here.corner() || !here.straight || here.tolerance < segment.tolerance {
            sharp |= here.sharp;
            break;
        }
        ahead = here.to - u;
        last += 1;
        same_ahead &= here.has_feed_of(segment);
        if same_ahead {
            feed_ahead = ahead;
        }
    }
    Straight {
        behind,
        ahead,
        feed_behind,
        feed_ahead,
        sharp,
    }
}

/// The distance ahead of a sample over which the path has to be known.
pub(crate) fn lookahead(tolerance: f64) -> f64 {
    MAX_SLACK * tolerance
}

/// How the samples of an interval cover it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SamplingCoverage {
    /// Number of equal parts; the ends of each are at most one sample distance apart.
    pub(crate) parts: usize,
    /// Maximum deviation of the programmed path from the chord between neighbouring samples.
    pub(crate) chord_deviation: f64,
}

/// Minimum and maximum number of parts of an interval. Tuned: with fewer than 4 the path often deviates too
/// far between samples, and solving again costs more than the samples.
pub(crate) const MIN_PARTS: usize = 4;
pub(crate) const MAX_PARTS: usize = 32;
/// Number of joints in an interval above which not all of them are samples.
const MAX_SAMPLED_JOINTS: usize = 3;
/// Permitted deviation of the path from the chord between samples in that case, in tolerances.
const MAX_CHORD_DEVIATION: f64 = 0.05;
/// Minimum of that, so that samples can move.
const MIN_CHORD_DEVIATION: f64 = 0.03;
/// Maximum number of halvings of a part.
const MAX_HALVINGS: u32 = 8;

/// Fraction of the tolerance for samples; with more of them, less is needed for the path in between.
fn used_fraction(parts: usize) -> f64 {
    1.0 - MARGIN_FRACTION / parts as f64
}

/// An interval between two knots, for sampling.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Interval {
    pub(crate) index: usize,
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// Start of the previous interval, and the permitted chord deviation between its samples.
    pub(crate) start_before: f64,
    pub(crate) deviation_before: f64,
}

/// Whether an interval has more joints than samples.
fn is_thinned(chain: &Chain, from: f64, to: f64) -> bool {
    chain.find(to) - chain.find(from) > MAX_SAMPLED_JOINTS
}

/// Appends the samples of one interval: at the left ends of its parts and at the joints inside, there of both
/// segments; of many joints only those at which the path turns. Returns the maximum deviation of the path
/// between the samples.
pub(crate) fn sample(
    chain: &Chain,
    interval: &Interval,
    parts: usize,
    basis: &Basis,
    active: &[bool; 9],
    samples: &mut Vec<Sample>,
) -> SamplingCoverage {
    let (from, to) = (interval.from, interval.to);
    let number = chain.find(from);
    // The first sample also ends the previous interval. If not all joints are samples there, it must not
    // slide: the chord deviation is known between the points of two samples only.
    let after_thin = is_thinned(chain, interval.start_before, from);
    let before = samples.len();
    let mut shared = before;
    let is_thinned = is_thinned(chain, from, to);
    let mut builder = SampleBuilder {
        chain,
        interval: interval.index,
        from,
        width: to - from,
        used_fraction: used_fraction(parts),
        is_thinned,
        slides: !is_thinned && !after_thin,
        basis,
        active,
        samples,
    };
    if let Some(segment) = chain.get(number)
        && segment.from == from
        && number > chain.first()
    {
        builder.add(number - 1, from);
        shared = builder.samples.len();
        builder.slides = !is_thinned;
    }
    builder.add(number, from);
    if shared == before {
        shared = builder.samples.len();
    }
    builder.slides = !is_thinned;
    let mut chord_deviation: f64 = 0.0;
    let mut left = number;
    for k in 0..parts {
        let cut = |k: usize| from + (to - from) * k as f64 / parts as f64;
        let (u0, u1) = (cut(k), if k + 1 == parts { to } else { cut(k + 1) });
        // Joints in between.
        let mut right = left;
        while let Some(next) = chain.get(right + 1)
            && next.from < u1
        {
            right += 1;
        }
        if builder.is_thinned {
            chord_deviation = chord_deviation.max(builder.joints(left + 1, right, u0, u1, MAX_HALVINGS));
        } else {
            for joint in left + 1..=right {
                builder.joint(joint);
            }
        }
        left = right;
        if k + 1 < parts {
            if let Some(next) = chain.get(left + 1)
                && next.from == u1
            {
                builder.add(left, u1);
                left += 1;
            }
            builder.add(left, u1);
        }
    }
    if is_thinned && samples[before..].iter().any(Sample::moves) {
        let min = samples[before..]
            .iter()
            .map(|sample| sample.tolerance)
            .fold(f64::INFINITY, f64::min);
        chord_deviation = chord_deviation.max(MIN_CHORD_DEVIATION * min);
    }
    if chord_deviation > 0.0 {
        for sample in &mut samples[before..] {
            sample.reduce_radius(chord_deviation);
            sample.chord_deviation = chord_deviation;
        }
    }
    if interval.deviation_before > chord_deviation {
        for sample in &mut samples[before..shared] {
            sample.reduce_radius(interval.deviation_before - chord_deviation);
        }
    }
    SamplingCoverage {
        parts,
        chord_deviation,
    }
}

/// Whether the spline keeps the tolerance also between the samples of an interval: between two samples at
/// distance `d` a curve is at most `d^2 / 8` times its maximum second derivative from the chord.
pub(crate) fn covers(
    chain: &Chain,
    cover: SamplingCoverage,
    (from, to): (f64, f64),
    basis: &Basis,
    points: &[Axes],
    (samples, next): (&[Sample], Option<&Sample>),
    (active, last): (&[bool; 9], &mut Vec<Sample>),
) -> bool {
    let width = to - from;
    let second = |order: usize| {
        (1..4).fold(points[0] * basis[0][order], |sum, l| {
            sum + points[l] * basis[l][order]
        })
    };
    let (bend, third) = (second(2), second(3));
    let mut max = distance(&bend).max(distance(&(bend + third * width)));
    let mut number = chain.find(from);
    while let Some(segment) = chain.get(number)
        && segment.from < to
    {
        if !segment.straight {
            let (a, b) = (segment.from.max(from), segment.to.min(to));
            let at = |u: f64| distance(&(bend + third * (u - from) - segment.jet(u).second));
            let (_, _, change) = segment
                .curve
                .derivative_bounds(a - segment.from, b - segment.from);
            let near = at(a).max(at(0.5 * (a + b))).max(at(b)) + 0.25 * (b - a) * distance(&change);
            max = max.max(near);
        }
        number += 1;
    }
    let gap = width / cover.parts as f64;
    let between = 0.125 * gap * gap * max;
    let holds = |sample: &Sample| {
        let used = (sample.ratio(&sample.error(points)) * sample.radius2).sqrt();
        used + between + cover.chord_deviation <= sample.tolerance
    };
    if !samples.iter().all(holds) {
        return false;
    }
    // The right end belongs to the samples of the next interval; here it is checked separately.
    last.clear();
    let mut builder = SampleBuilder {
        chain,
        interval: 0,
        from,
        width,
        used_fraction: used_fraction(cover.parts),
        is_thinned: false,
        slides: !is_thinned(chain, from, to),
        basis,
        active,
        samples: last,
    };
    let behind = chain.find(to);
    let at_joint = chain.get(behind).is_some_and(|segment| segment.from >= to) && behind > chain.first();
    builder.add(if at_joint { behind - 1 } else { behind }, to);
    if let (Some(next), Some(end)) = (next, last.first_mut())
        && (next.group, next.tolerance) == (end.group, end.tolerance)
    {
        // As held there: it may have moved, or extend along a straight part that is longer than this
        // interval.
        (end.centre, end.along, end.tangential_slack) = (next.centre, next.along, next.tangential_slack);
    }
    last.iter().all(holds)
}

/// Number of points at which a piece is compared with the program.
const CHECK_POINTS: usize = 8;

/// Whether a piece of the path, from `from` to `to`, is within the tolerance of the program at all sampled
/// points: the final check, of the curve itself and by the distance itself.
pub(crate) fn within_tolerance(chain: &Chain, (from, to): (f64, f64), piece: &Spline) -> bool {
    let mut number = chain.find(from);
    for k in 0..=CHECK_POINTS {
        let u = from + (to - from) * k as f64 / CHECK_POINTS as f64;
        number = chain.find_near(u, number);
        let Some(segment) = chain.get(number) else {
            return false;
        };
        let mut error = piece.position(u - from) - segment.position(u);
        let tolerance = segment.tolerance * (1.0 + 1e-9) + 1e-11;
        if distance(&error) <= tolerance {
            continue;
        }
        let slope = segment.slope();
        if !segment.straight || slope.as_slice()[3..].iter().any(|&rate| rate != 0.0) {
            return false;
        }
        // The nearest point of the path nearby instead of that of the same parameter.
        let position = piece.position(u - from);
        let position = std::array::from_fn(|d| position[d]);
        if error.as_slice()[3..].iter().all(|&offset| offset == 0.0)
            && let Some(near) = nearest(chain, range(chain, number, u, true), number, &position, true)
        {
            let offset: [f64; 3] = std::array::from_fn(|d| position[d] - near.point[d]);
            if dot(&offset, &offset) <= tolerance * tolerance {
                continue;
            }
        }
        // Or of the straight part, which may extend farther.
        let along = error[0] * slope[0] + error[1] * slope[1] + error[2] * slope[2];
        let straight = straight(chain, number, segment, u, along.abs());
        let nearest = along.min(straight.ahead).max(-straight.behind);
        error -= slope * nearest;
        if !(distance(&error) <= tolerance) {
            return false;
        }
    }
    true
}

struct SampleBuilder<'a> {
    chain: &'a Chain,
    interval: usize,
    from: f64,
    width: f64,
    used_fraction: f64,
    /// Whether there are fewer samples than joints: then all of them are balls.
    is_thinned: bool,
    /// Whether samples on a longer straight segment are capsules.
    slides: bool,
    basis: &'a Basis,
    active: &'a [bool; 9],
    samples: &'a mut Vec<Sample>,
}

impl SampleBuilder<'_> {
    /// Samples of both segments at a joint.
    fn joint(&mut self, number: usize) {
        if let Some(segment) = self.chain.get(number) {
            let u = segment.from;
            self.add(number - 1, u);
            self.add(number, u);
        }
    }

    /// Samples of those joints `first..=last` between `u0` and `u1` without which the chord deviation between
    /// samples would be too large; returns the remaining deviation.
    fn joints(&mut self, first: usize, last: usize, u0: f64, u1: f64, halvings: u32) -> f64 {
        if first > last {
            return 0.0;
        }
        let at = |u: f64, near: usize| {
            let segment = self.chain.get(self.chain.find_near(u, near));
            segment.map_or_else(Axes::zeros, |segment| segment.position(u))
        };
        let (p0, p1) = (at(u0, first), at(u1, last));
        let (mut worst, mut at, mut min) = (0.0, first, f64::INFINITY);
        for joint in first..=last {
            let Some(segment) = self.chain.get(joint) else {
                continue;
            };
            let straight = p0 + (p1 - p0) * ((segment.from - u0) / (u1 - u0));
            let chord_deviation = distance(&(segment.start() - straight));
            if chord_deviation > worst {
                (worst, at) = (chord_deviation, joint);
            }
            min = min.min(segment.tolerance);
        }
        let Some(&segment) = self.chain.get(at) else {
            return worst;
        };
        if worst <= MAX_CHORD_DEVIATION * min {
            return worst;
        }
        if halvings == 0 {
            for joint in first..=last {
                self.joint(joint);
            }
            return 0.0;
        }
        let before = self.joints(first, at - 1, u0, segment.from, halvings - 1);
        self.joint(at);
        before.max(self.joints(at + 1, last, segment.from, u1, halvings - 1))
    }

    fn add(&mut self, number: usize, u: f64) {
        let Some(segment) = self.chain.get(number) else {
            return;
        };
        let weights = values(self.basis, u - self.from);
        let position = segment.position(u);
        let tolerance = self.used_fraction * segment.tolerance;
        for (group, &(first, count)) in GROUPS.iter().enumerate() {
            if !self.active[first..first + count].iter().any(|&active| active) {
                continue;
            }
            let mut made = Sample {
                interval: self.interval,
                group,
                weights,
                centre: [0.0; 3],
                along: [0.0; 3],
                tangential_slack: (0.0, 0.0),
                radius2: tolerance * tolerance,
                tolerance: segment.tolerance,
                at: u,
                segment: number,
                range: (u, u),
                chord_deviation: 0.0,
            };
            made.centre[..count].copy_from_slice(&position.as_slice()[first..first + count]);
            if group == 0 && segment.straight && self.slides {
                self.lengthen(&mut made, number, segment, u);
            }
            // Other moving axes tie the point to its parameter.
            if made.along == [0.0; 3] && !self.active[3..].iter().any(|&active| active) {
                made.range = range(self.chain, number, u, self.is_thinned);
            }
            self.samples.push(made);
        }
    }

    fn lengthen(&self, made: &mut Sample, number: usize, segment: &ProgramSegment, u: f64) {
        let slope = segment.slope();
        // Other moving axes tie the point to its parameter.
        if slope.as_slice()[3..].iter().any(|&rate| rate != 0.0) {
            return;
        }
        let reach = MAX_SLACK * segment.tolerance;
        let straight = straight(
            self.chain,
            number,
            segment,
            u,
            reach.max(DENSE_INTERVALS * self.width),
        );
        if straight.behind + straight.ahead <= DENSE_INTERVALS * self.width {
            return;
        }
        // At a sharp corner the corner point must be missed by at most twice the tolerance.
        let reach = if straight.sharp { segment.tolerance } else { reach };
        // Feeds change at the parameter of a joint. A point that slid past it would have the feed of the
        // other block.
        made.tangential_slack = (
            straight.feed_behind.clamp(0.0, reach),
            straight.feed_ahead.clamp(0.0, reach),
        );
        for d in 0..3 {
            made.along[d] = slope[d];
        }
    }
}

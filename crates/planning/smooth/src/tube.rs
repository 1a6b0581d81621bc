//! The tube about the programmed path that the spline keeps to.
//!
//! A sample compares a point of the spline with the programmed path about the place of the same parameter. Where
//! the path is dense that is the programmed point itself: the error stays in a ball. On a longer straight the point
//! may also slip along it: it stays in the capsule of all points within the tolerance `P` of a part of the straight.
//! A ball would waste `1 / sin(half the angle)` at every corner. On a chain of short lines the ball itself slips: it
//! follows the spline to the nearest programmed point, but no farther than `P`.

use evolvent_path::{Axes, ParamCurve, Spline};

use crate::basis::{Basis, values};
use crate::chain::{Chain, ProgramSegment, distance};
use crate::follow::{PathPoint, nearest, range};

/// Share of the tolerance that samples leave for what lies between them, where an interval has a single part.
const UNUSED: f64 = 0.04;
/// How far along a straight the tube reaches, in tolerances.
const SLIP: f64 = 8.0;
/// A straight shorter than so many knot intervals counts as dense.
const DENSE: f64 = 3.0;

/// The groups of axes whose error is measured together: XYZ, UVW, A, B, C.
pub(crate) const GROUPS: [(usize, usize); 5] = [(0, 3), (6, 3), (3, 1), (4, 1), (5, 1)];

/// One condition on the four control points of an interval.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    /// Index of the interval.
    pub(crate) interval: usize,
    /// Index into [`GROUPS`].
    pub(crate) group: usize,
    /// The basis functions there.
    pub(crate) weights: [f64; 4],
    /// The programmed point.
    pub(crate) centre: [f64; 3],
    /// Direction of the straight, zero for a ball.
    pub(crate) along: [f64; 3],
    /// How far the point may slip to both sides.
    pub(crate) tangential_slack: (f64, f64),
    /// Square of the radius.
    pub(crate) radius2: f64,
    /// What the distance must not exceed, also beside the sample.
    pub(crate) tolerance: f64,
    /// Parameter of the programmed point and a link that it belongs to.
    pub(crate) at: f64,
    pub(crate) link: usize,
    /// Within which it may follow the spline; an empty range if it may not.
    pub(crate) range: (f64, f64),
    /// How far the path may stray from the straight to the neighbouring samples' points.
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

    /// From the nearest point of the straight to the point, and whether that is inside of the straight.
    pub(crate) fn off(&self, error: &[f64; 3]) -> ([f64; 3], bool) {
        let x = dot(error, &self.along);
        let nearest = x.max(-self.tangential_slack.0).min(self.tangential_slack.1);
        let off = std::array::from_fn(|d| error[d] - nearest * self.along[d]);
        (off, x > -self.tangential_slack.0 && x < self.tangential_slack.1)
    }

    /// Whether it may follow the spline.
    pub(crate) fn moves(&self) -> bool {
        self.range.0 < self.range.1
    }

    /// Takes a distance off the radius.
    fn narrow(&mut self, by: f64) {
        let radius = (self.radius2.sqrt() - by).max(0.0);
        self.radius2 = radius * radius;
    }

    /// Its programmed point.
    pub(crate) fn spot(&self) -> PathPoint {
        PathPoint {
            at: self.at,
            link: self.link,
            point: self.centre,
        }
    }

    /// Compares with another programmed point from now on.
    pub(crate) fn move_to(&mut self, spot: &PathPoint) {
        (self.at, self.link, self.centre) = (spot.at, spot.link, spot.point);
    }

    /// The squared distance in units of the squared radius.
    pub(crate) fn ratio(&self, error: &[f64; 3]) -> f64 {
        let (off, _) = self.off(error);
        dot(&off, &off) / self.radius2
    }
}

pub(crate) fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The straight that a link is part of, as seen from a place on it.
struct Straight {
    behind: f64,
    ahead: f64,
    sharp: bool,
}

/// How far the straight reaches to both sides, looked for up to `limit`. Whatever lies beyond does not matter, so that
/// the answer is the same however much more of the path is known.
fn straight(chain: &Chain, number: usize, link: &ProgramSegment, u: f64, limit: f64) -> Straight {
    let (mut behind, mut ahead, mut sharp) = (u - link.from, link.to - u, false);
    let mut first = number;
    while behind < limit
        && let Some(here) = chain.get(first)
    {
        let before = first.checked_sub(1).and_then(|n| chain.get(n));
        match before {
            Some(before) if !here.corner() && before.straight && before.tolerance >= link.tolerance => {
                first -= 1;
                behind = u - before.from;
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
        if here.corner() || !here.straight || here.tolerance < link.tolerance {
            sharp |= here.sharp;
            break;
        }
        ahead = here.to - u;
        last += 1;
    }
    Straight { behind, ahead, sharp }
}

/// How far ahead of a sample the path has to be known.
pub(crate) fn sight(tolerance: f64) -> f64 {
    SLIP * tolerance
}

/// How the samples of an interval cover it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SamplingCoverage {
    /// Equal parts between whose ends there is at most one sample's distance.
    pub(crate) parts: usize,
    /// How far the programmed path strays from a straight between neighbouring samples.
    pub(crate) chord_deviation: f64,
}

/// Fewest parts of an interval, and the most that are tried. With fewer than 4 the path found often strays too far
/// between samples, and finding it again costs more than they.
pub(crate) const FEWEST_PARTS: usize = 4;
pub(crate) const MAX_PARTS: usize = 32;
/// More joints than this in an interval, and not all of them are samples.
const MANY: usize = 3;
/// How far the path may stray from a straight between samples then, in tolerances.
const STRAY: f64 = 0.05;
/// How far it may at least, so that samples can move.
const STRAY_MOVED: f64 = 0.03;
/// Halvings of a part.
const HALVINGS: u32 = 8;

/// Share of the tolerance that samples may use: the more of them, the less is left for what lies between.
fn share(parts: usize) -> f64 {
    1.0 - UNUSED / parts as f64
}

/// An interval between two knots that is to be sampled.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Interval {
    pub(crate) index: usize,
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// Where the one before starts, and how far the path strays from the straights between its samples.
    pub(crate) start_before: f64,
    pub(crate) deviation_before: f64,
}

/// Whether an interval has more joints than are samples.
fn thin(chain: &Chain, from: f64, to: f64) -> bool {
    chain.find(to) - chain.find(from) > MANY
}

/// Appends the samples of one interval: the left ends of its parts and the joints inside, at a joint both links;
/// of many joints only those at which the path turns. Returns how far the path strays between them.
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
    // The first sample also ends the interval before. Where not all joints are samples there it does not slip: how far the
    // path strays is known of the straight between two samples' points.
    let after_thin = thin(chain, interval.start_before, from);
    let before = samples.len();
    let mut shared = before;
    let thin = thin(chain, from, to);
    let mut maker = Maker {
        chain,
        interval: interval.index,
        from,
        width: to - from,
        share: share(parts),
        thin,
        slips: !thin && !after_thin,
        basis,
        active,
        samples,
    };
    if let Some(link) = chain.get(number)
        && link.from == from
        && number > chain.first()
    {
        maker.add(number - 1, from);
        shared = maker.samples.len();
        maker.slips = !thin;
    }
    maker.add(number, from);
    if shared == before {
        shared = maker.samples.len();
    }
    maker.slips = !thin;
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
        if maker.thin {
            chord_deviation = chord_deviation.max(maker.joints(left + 1, right, u0, u1, HALVINGS));
        } else {
            for joint in left + 1..=right {
                maker.joint(joint);
            }
        }
        left = right;
        if k + 1 < parts {
            if let Some(next) = chain.get(left + 1)
                && next.from == u1
            {
                maker.add(left, u1);
                left += 1;
            }
            maker.add(left, u1);
        }
    }
    if thin && samples[before..].iter().any(Sample::moves) {
        let least = samples[before..]
            .iter()
            .map(|sample| sample.tolerance)
            .fold(f64::INFINITY, f64::min);
        chord_deviation = chord_deviation.max(STRAY_MOVED * least);
    }
    if chord_deviation > 0.0 {
        for sample in &mut samples[before..] {
            sample.narrow(chord_deviation);
            sample.chord_deviation = chord_deviation;
        }
    }
    if interval.deviation_before > chord_deviation {
        for sample in &mut samples[before..shared] {
            sample.narrow(interval.deviation_before - chord_deviation);
        }
    }
    SamplingCoverage {
        parts,
        chord_deviation,
    }
}

/// Whether the spline keeps to the tolerance also between the samples of an interval: between two that are `d` apart,
/// a curve is at most `d^2 / 8` times its greatest second derivative from the straight between them.
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
    let mut most = distance(&bend).max(distance(&(bend + third * width)));
    let mut number = chain.find(from);
    while let Some(link) = chain.get(number)
        && link.from < to
    {
        if !link.straight {
            let (a, b) = (link.from.max(from), link.to.min(to));
            let at = |u: f64| distance(&(bend + third * (u - from) - link.jet(u).second));
            let (_, _, change) = link.curve.derivative_bounds(a - link.from, b - link.from);
            let near = at(a).max(at(0.5 * (a + b))).max(at(b)) + 0.25 * (b - a) * distance(&change);
            most = most.max(near);
        }
        number += 1;
    }
    let gap = width / cover.parts as f64;
    let between = 0.125 * gap * gap * most;
    let holds = |sample: &Sample| {
        let used = (sample.ratio(&sample.error(points)) * sample.radius2).sqrt();
        used + between + cover.chord_deviation <= sample.tolerance
    };
    if !samples.iter().all(holds) {
        return false;
    }
    // The right end belongs to the next interval's samples; here it is looked at for itself.
    last.clear();
    let mut maker = Maker {
        chain,
        interval: 0,
        from,
        width,
        share: share(cover.parts),
        thin: false,
        slips: !thin(chain, from, to),
        basis,
        active,
        samples: last,
    };
    let behind = chain.find(to);
    let at_joint = chain.get(behind).is_some_and(|link| link.from >= to) && behind > chain.first();
    maker.add(if at_joint { behind - 1 } else { behind }, to);
    if let (Some(next), Some(end)) = (next, last.first_mut())
        && (next.group, next.tolerance) == (end.group, end.tolerance)
    {
        // As it is held there: it may have moved, or reach along a straight that is longer than this interval.
        (end.centre, end.along, end.tangential_slack) = (next.centre, next.along, next.tangential_slack);
    }
    last.iter().all(holds)
}

/// Places at which a piece is compared with the program.
const PLACES: usize = 8;

/// Whether a piece of the path, from `from` to `to`, is within the tolerance of the program wherever it is looked at: a
/// last check, of the curve itself and by the distance itself.
pub(crate) fn within_tolerance(chain: &Chain, (from, to): (f64, f64), piece: &Spline) -> bool {
    let mut number = chain.find(from);
    for k in 0..=PLACES {
        let u = from + (to - from) * k as f64 / PLACES as f64;
        number = chain.find_near(u, number);
        let Some(link) = chain.get(number) else {
            return false;
        };
        let mut error = piece.position(u - from) - link.position(u);
        let tolerance = link.tolerance * (1.0 + 1e-9) + 1e-11;
        if distance(&error) <= tolerance {
            continue;
        }
        let slope = link.slope();
        if !link.straight || slope.as_slice()[3..].iter().any(|&rate| rate != 0.0) {
            return false;
        }
        // The nearest point of the path nearby instead of that of the same parameter.
        let place = piece.position(u - from);
        let place = std::array::from_fn(|d| place[d]);
        if error.as_slice()[3..].iter().all(|&off| off == 0.0)
            && let Some(near) = nearest(chain, range(chain, number, u, true), number, &place, true)
        {
            let off: [f64; 3] = std::array::from_fn(|d| place[d] - near.point[d]);
            if dot(&off, &off) <= tolerance * tolerance {
                continue;
            }
        }
        // Or of the straight, which may reach farther.
        let along = error[0] * slope[0] + error[1] * slope[1] + error[2] * slope[2];
        let straight = straight(chain, number, link, u, along.abs());
        let nearest = along.min(straight.ahead).max(-straight.behind);
        error -= slope * nearest;
        if !(distance(&error) <= tolerance) {
            return false;
        }
    }
    true
}

struct Maker<'a> {
    chain: &'a Chain,
    interval: usize,
    from: f64,
    width: f64,
    share: f64,
    /// Whether samples are fewer than joints: then all of them are balls.
    thin: bool,
    /// Whether samples on a longer straight are capsules.
    slips: bool,
    basis: &'a Basis,
    active: &'a [bool; 9],
    samples: &'a mut Vec<Sample>,
}

impl Maker<'_> {
    /// Samples of both links at a joint.
    fn joint(&mut self, number: usize) {
        if let Some(link) = self.chain.get(number) {
            let u = link.from;
            self.add(number - 1, u);
            self.add(number, u);
        }
    }

    /// Samples of those joints `first..=last` between `u0` and `u1` without which the path would stray too far
    /// from the straight between samples; returns how far it strays.
    fn joints(&mut self, first: usize, last: usize, u0: f64, u1: f64, halvings: u32) -> f64 {
        if first > last {
            return 0.0;
        }
        let at = |u: f64, near: usize| {
            let link = self.chain.get(self.chain.find_near(u, near));
            link.map_or_else(Axes::zeros, |link| link.position(u))
        };
        let (p0, p1) = (at(u0, first), at(u1, last));
        let (mut worst, mut at, mut least) = (0.0, first, f64::INFINITY);
        for joint in first..=last {
            let Some(link) = self.chain.get(joint) else {
                continue;
            };
            let straight = p0 + (p1 - p0) * ((link.from - u0) / (u1 - u0));
            let chord_deviation = distance(&(link.start() - straight));
            if chord_deviation > worst {
                (worst, at) = (chord_deviation, joint);
            }
            least = least.min(link.tolerance);
        }
        let Some(&link) = self.chain.get(at) else {
            return worst;
        };
        if worst <= STRAY * least {
            return worst;
        }
        if halvings == 0 {
            for joint in first..=last {
                self.joint(joint);
            }
            return 0.0;
        }
        let before = self.joints(first, at - 1, u0, link.from, halvings - 1);
        self.joint(at);
        before.max(self.joints(at + 1, last, link.from, u1, halvings - 1))
    }

    fn add(&mut self, number: usize, u: f64) {
        let Some(link) = self.chain.get(number) else {
            return;
        };
        let weights = values(self.basis, u - self.from);
        let place = link.position(u);
        let tolerance = self.share * link.tolerance;
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
                tolerance: link.tolerance,
                at: u,
                link: number,
                range: (u, u),
                chord_deviation: 0.0,
            };
            made.centre[..count].copy_from_slice(&place.as_slice()[first..first + count]);
            if group == 0 && link.straight && self.slips {
                self.lengthen(&mut made, number, link, u);
            }
            // Other axes that move tie the point to its parameter.
            if made.along == [0.0; 3] && !self.active[3..].iter().any(|&active| active) {
                made.range = range(self.chain, number, u, self.thin);
            }
            self.samples.push(made);
        }
    }

    fn lengthen(&self, made: &mut Sample, number: usize, link: &ProgramSegment, u: f64) {
        let slope = link.slope();
        // Other axes that move tie the point to its parameter.
        if slope.as_slice()[3..].iter().any(|&rate| rate != 0.0) {
            return;
        }
        let reach = SLIP * link.tolerance;
        let straight = straight(self.chain, number, link, u, reach.max(DENSE * self.width));
        if straight.behind + straight.ahead <= DENSE * self.width {
            return;
        }
        // At a sharp corner no farther than that its point is missed by twice the tolerance.
        let reach = if straight.sharp { link.tolerance } else { reach };
        made.tangential_slack = (
            straight.behind.clamp(0.0, reach),
            straight.ahead.clamp(0.0, reach),
        );
        for d in 0..3 {
            made.along[d] = slope[d];
        }
    }
}

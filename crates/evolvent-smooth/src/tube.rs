//! The tube about the programmed path that the spline keeps to.
//!
//! A sample compares a point of the spline with the programmed point of the same parameter. Where the path is dense
//! the error stays in a ball. On a longer straight the point may also slip along it: an ellipsoid about
//! `p + t (d2 - d1) / 2` with the tolerance `P` across and `(d1 + d2) / 2 + P` along, where `d1` and `d2` are the
//! distances to the straight's ends, at most `4 P`. Each of its points is within `P` of the straight: a point that
//! overshoots an end by `x` has at most `sqrt(1 - ((L - P + x) / L)^2) P` across, which with
//! `x L <= P (L - P + x)`, that is `x <= P`, is within the ball about the end. A ball would waste
//! `1 / sin(half the angle)` at every corner.

use evolvent_path::Axes;

use crate::basis::{Basis, values};
use crate::chain::{Chain, Link};

/// Share of the tolerance that samples may use; the rest is for what lies between them.
pub(crate) const SHARE: f64 = 0.98;
/// How far along a straight the tube reaches, in tolerances.
const SLIP: f64 = 4.0;
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
    /// Centre of the ball or ellipsoid.
    pub(crate) centre: [f64; 3],
    /// Direction in which the ellipsoid is longer.
    pub(crate) along: [f64; 3],
    /// One less the squared ratio of the ellipsoid's axes; 0 for a ball.
    pub(crate) squash: f64,
    /// Square of the radius across.
    pub(crate) radius2: f64,
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

    /// The squared error in units of the squared radius, the direction along shortened.
    pub(crate) fn ratio(&self, error: &[f64; 3]) -> f64 {
        (dot(error, error) - self.squash * dot(error, &self.along).powi(2)) / self.radius2
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

/// How far the straight reaches to both sides, looked for up to `limit`.
fn straight(chain: &Chain, number: usize, link: &Link, u: f64, limit: f64) -> Straight {
    let (mut behind, mut ahead, mut sharp) = (u - link.from, link.to - u, false);
    let mut first = number;
    while let Some(here) = chain.get(first) {
        let before = first.checked_sub(1).and_then(|n| chain.get(n));
        match before {
            Some(before) if !here.eased && before.straight && before.tolerance >= link.tolerance => {
                if behind >= limit {
                    break;
                }
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
    while let Some(here) = chain.get(last) {
        if here.eased || !here.straight || here.tolerance < link.tolerance {
            sharp |= here.sharp;
            break;
        }
        if ahead >= limit {
            break;
        }
        ahead = here.to - u;
        last += 1;
    }
    Straight { behind, ahead, sharp }
}

/// Appends the samples of one interval: its left knot, its middle and every joint inside; at a joint both links.
pub(crate) fn sample(
    chain: &Chain,
    interval: usize,
    (from, to): (f64, f64),
    basis: &Basis,
    active: &[bool; 9],
    samples: &mut Vec<Sample>,
) {
    let middle = 0.5 * (from + to);
    let mut number = chain.find(from);
    let mut maker = Maker {
        chain,
        interval,
        width: to - from,
        basis,
        active,
        samples,
    };
    if let Some(link) = chain.get(number)
        && link.from == from
        && number > chain.first()
    {
        maker.add(number - 1, from, 0.0);
    }
    maker.add(number, from, 0.0);
    let mut open = true;
    while let Some(next) = chain.get(number + 1) {
        let u = next.from;
        if open && u > middle {
            maker.add(number, middle, middle - from);
            open = false;
        }
        if u >= to {
            break;
        }
        maker.add(number, u, u - from);
        number += 1;
        if u == middle {
            open = false;
        }
        maker.add(number, u, u - from);
    }
    if open {
        maker.add(number, middle, middle - from);
    }
}

struct Maker<'a> {
    chain: &'a Chain,
    interval: usize,
    width: f64,
    basis: &'a Basis,
    active: &'a [bool; 9],
    samples: &'a mut Vec<Sample>,
}

impl Maker<'_> {
    fn add(&mut self, number: usize, u: f64, x: f64) {
        let Some(link) = self.chain.get(number) else {
            return;
        };
        let weights = values(self.basis, x);
        let place = link.position(u);
        let tolerance = crate::timing::knob("SHARE", SHARE) * link.tolerance;
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
                squash: 0.0,
                radius2: tolerance * tolerance,
            };
            made.centre[..count].copy_from_slice(&place.as_slice()[first..first + count]);
            if group == 0 && link.straight {
                self.lengthen(&mut made, number, link, u);
            }
            self.samples.push(made);
        }
    }

    fn lengthen(&self, made: &mut Sample, number: usize, link: &Link, u: f64) {
        let slope = link.slope();
        // Other axes that move tie the point to its parameter.
        if slope.as_slice()[3..].iter().any(|&rate| rate != 0.0) {
            return;
        }
        let radius = made.radius2.sqrt();
        let reach = crate::timing::knob("SLIP", SLIP) * link.tolerance;
        let straight = straight(self.chain, number, link, u, reach.max(crate::timing::knob("DENSE", DENSE) * self.width));
        if straight.sharp || straight.behind + straight.ahead <= crate::timing::knob("DENSE", DENSE) * self.width {
            return;
        }
        let (d1, d2) = (straight.behind.clamp(0.0, reach), straight.ahead.clamp(0.0, reach));
        let half = 0.5 * (d1 + d2) + radius;
        let shift = 0.5 * (d2 - d1);
        for d in 0..3 {
            made.along[d] = slope[d];
            made.centre[d] += shift * slope[d];
        }
        made.squash = 1.0 - (radius / half) * (radius / half);
    }
}

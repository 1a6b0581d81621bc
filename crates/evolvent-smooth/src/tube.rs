//! The tube about the programmed path that the spline keeps to.
//!
//! A sample compares a point of the spline with the programmed path about the place of the same parameter. Where
//! the path is dense that is the programmed point itself: the error stays in a ball. On a longer straight the point
//! may also slip along it: it stays in the capsule of all points within the tolerance `P` of a part of the straight.
//! A ball would waste `1 / sin(half the angle)` at every corner.

use evolvent_path::Axes;

use crate::basis::{Basis, values};
use crate::chain::{Chain, Link};

/// Share of the tolerance that samples may use; the rest is for what lies between them.
pub(crate) const SHARE: f64 = 0.98;
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
    pub(crate) slip: (f64, f64),
    /// Square of the radius.
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

    /// From the nearest point of the straight to the point, and whether that is inside of the straight.
    pub(crate) fn off(&self, error: &[f64; 3]) -> ([f64; 3], bool) {
        let x = dot(error, &self.along);
        let nearest = x.max(-self.slip.0).min(self.slip.1);
        let off = std::array::from_fn(|d| error[d] - nearest * self.along[d]);
        (off, x > -self.slip.0 && x < self.slip.1)
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
        let tolerance = SHARE * link.tolerance;
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
                slip: (0.0, 0.0),
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
        let reach = SLIP * link.tolerance;
        let straight = straight(self.chain, number, link, u, reach.max(DENSE * self.width));
        if straight.sharp || straight.behind + straight.ahead <= DENSE * self.width {
            return;
        }
        made.slip = (straight.behind.clamp(0.0, reach), straight.ahead.clamp(0.0, reach));
        for d in 0..3 {
            made.along[d] = slope[d];
        }
    }
}

//! The position at which the smoothed path changes from the feed of one block to that of the next.
//!
//! The path has the parameter of the program, but its point at a joint's parameter may be before the joint or
//! after it: by the tolerance, or by twice the tolerance where samples follow the path. If the feed changed
//! at the parameter, the path in between would be driven at the feed of the wrong block, for example a cut at
//! rapid. The second criterion is the plane that bisects the joint: before it the earlier block is nearer,
//! after it the later one. The lower of the two feeds, by parameter and by plane, applies.

use evolvent_path::{Axes, ParamCurve, Spline};

use crate::chain::Chain;

/// Distance on both sides of a joint in which the path passes it, in tolerances.
const REACH: f64 = 2.0;
/// Minimum length of the sum of both directions at a joint; below it the path reverses, and no plane bisects
/// it.
const MIN_NORMAL: f64 = 0.1;
/// Number of parts of the reach that are searched, and of bisections of the part that is found.
const PARTS: usize = 8;
const BISECTIONS: usize = 30;

/// A joint between blocks of different feed.
#[derive(Clone, Copy, Debug)]
pub(super) struct FeedBoundary {
    /// Number of the segment that starts there.
    pub(super) segment: usize,
    /// Parameter of the joint, and the distance from it within which the path may pass it.
    parameter: f64,
    reach: f64,
    /// The joint, and the normal of the bisecting plane; `None` if other axes tie the path to the parameter,
    /// or if the path reverses.
    position: Axes,
    normal: Option<Axes>,
}

impl FeedBoundary {
    /// The next joint after a segment at which the feed changes, if the path may pass it before `until`.
    pub(super) fn next(chain: &Chain, number: usize, until: f64) -> Option<Self> {
        let holding = chain.get(number)?;
        let mut number = number;
        loop {
            let before = chain.get(number)?;
            number += 1;
            let segment = chain.get(number)?;
            let reach = REACH * segment.tolerance.max(before.tolerance);
            if segment.from - reach >= until {
                return None;
            }
            if !segment.has_feed_of(holding) {
                let (end, start) = (before.jet(before.to), segment.jet(segment.from));
                let tied = [end.first, start.first]
                    .iter()
                    .any(|first| first.as_slice()[3..].iter().any(|&rate| rate != 0.0));
                let normal = end.first.normalize() + start.first.normalize();
                return Some(Self {
                    segment: number,
                    parameter: segment.from,
                    reach,
                    position: start.position,
                    normal: (!tied && normal.norm() > MIN_NORMAL).then_some(normal),
                });
            }
        }
    }

    /// The parameter at which a piece of the path, from `from` to `to`, passes the joint, searched from `at`;
    /// `None` if it does not.
    pub(super) fn passed(&self, piece: &Spline, (from, to): (f64, f64), at: f64) -> Option<f64> {
        let Some(normal) = self.normal else {
            return (self.parameter <= to).then_some(self.parameter.max(at));
        };
        if self.parameter + self.reach <= at {
            return Some(at);
        }
        let (low, high) = (
            (self.parameter - self.reach).max(at),
            (self.parameter + self.reach).min(to),
        );
        if low >= high {
            return None;
        }
        let behind = |u: f64| (piece.position(u - from) - self.position).dot(&normal) >= 0.0;
        if behind(low) {
            return Some(low);
        }
        let mut before = low;
        for part in 1..=PARTS {
            let u = low + (high - low) * part as f64 / PARTS as f64;
            if behind(u) {
                let mut after = u;
                for _ in 0..BISECTIONS {
                    let middle = 0.5 * (before + after);
                    if behind(middle) {
                        after = middle;
                    } else {
                        before = middle;
                    }
                }
                return Some(after);
            }
            before = u;
        }
        // Beyond the reach the path has passed the joint, on either side of the plane.
        (high < to).then_some(high)
    }
}

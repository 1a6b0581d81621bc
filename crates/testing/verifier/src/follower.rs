//! Follows a motion along the programmed path, in its order, forwards only.
//!
//! The follower keeps a position on the program: the earliest one, not before the previous one, within the
//! tolerance of the motion's present point. If the motion matches the program in its order at all, then it
//! also matches from the earliest position on, so no backtracking is needed. (This is the greedy decision
//! procedure of the Fréchet distance, with jumps on one side.) A jump forward must not leave anything out:
//! the passed part must be within a few tolerances of the motion since the previous position, or of the
//! motion while the program position was near its present value. The second case is needed where the program
//! goes to and fro near one point: the motion does the same, and the earliest match lags there. The search
//! ends where the program leaves this neighbourhood, so its cost is proportional to the blocks passed.

use std::collections::VecDeque;

use evolvent_path::Axes;

use crate::Route;
use crate::measure::{distance, from_stretch, linear, rotary};

/// Maximum distance of a passed part from the motion, in tolerances: a corner of 120 degrees that is cut
/// within the tolerance of both sides is 2 tolerances away.
const NEIGHBOURHOOD: f64 = 4.0;
/// Maximum number of points examined between two setpoints.
const MAX_POINTS: f64 = 64.0;
/// Maximum number of points of the motion kept near one position.
const MAX_TRAIL: usize = 1000;
/// Maximum number of blocks searched after the motion was lost.
const MAX_BLOCKS: usize = 4000;
/// Number of points tried on a curve after the motion was lost.
const TRIES: usize = 64;

/// A position on the route.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RoutePosition {
    block: usize,
    u: f64,
}

/// Result of following one setpoint.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Found {
    /// Distance to the program, mm (XYZ or UVW) and degrees (the worst rotary axis).
    pub(crate) linear: f64,
    pub(crate) rotary: f64,
    /// The larger of both, relative to the tolerance.
    pub(crate) ratio: f64,
    /// The same for points on the chord from the previous setpoint, relative to tolerance plus chord error.
    pub(crate) between: f64,
    pub(crate) between_ratio: f64,
    /// The nearest block.
    pub(crate) block: usize,
    /// The first and the last block that may be in execution.
    pub(crate) first: usize,
    pub(crate) last: usize,
    /// The program cannot be followed to here in its order.
    pub(crate) lost: bool,
}

/// Results at the end of the motion.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Coverage {
    /// Ends of blocks: maximum distance from the motion, mm or degrees, and the block.
    pub(crate) farthest: (f64, usize),
    /// Number of blocks whose end the motion did not approach.
    pub(crate) missed: usize,
    /// The first of them.
    pub(crate) first_missed: Option<usize>,
    /// Points of rest: maximum distance from the nearest setpoint, and the block.
    pub(crate) rest: (f64, usize),
}

#[derive(Clone, Debug)]
pub(crate) struct Follower<'a> {
    route: &'a Route,
    /// Permitted chord error, mm.
    chord_mm: f64,
    at: RoutePosition,
    last: Axes,
    /// Points of the motion while the program position was near its present value, each with the program
    /// position.
    trail: VecDeque<(Axes, Axes)>,
    /// Distances of block ends to the motion (chords; setpoints alone), from `done` on.
    ends: VecDeque<(f64, f64)>,
    done: usize,
    coverage: Coverage,
}

impl<'a> Follower<'a> {
    pub(crate) fn new(route: &'a Route, chord_mm: f64) -> Self {
        Self {
            route,
            chord_mm,
            at: RoutePosition { block: 0, u: 0.0 },
            last: route.start(),
            trail: VecDeque::new(),
            ends: VecDeque::new(),
            done: 0,
            coverage: Coverage::default(),
        }
    }

    /// Follows the next setpoint. The route must have blocks.
    pub(crate) fn follow(&mut self, position: &Axes) -> Found {
        let from = self.last;
        self.last = *position;
        let first = self.at.block;
        let step = distance(&from, position);
        let mut found = Found::default();
        // If both ends of the chord are on one line, no points in between are needed.
        let here = &self.route.blocks[self.at.block];
        let same = here.piece.is_straight() && {
            let route_position = self.at;
            self.search(&from, position, route_position)
                .is_some_and(|to| to.block == self.at.block)
        };
        let points = if same {
            1.0
        } else {
            (step / (2.0 * self.within(self.at.block)))
                .ceil()
                .clamp(1.0, MAX_POINTS)
        };
        let mut before = from;
        for i in 1..=points as usize {
            let last = i == points as usize;
            let point = if last {
                *position
            } else {
                from + (position - from) * (i as f64 / points)
            };
            let lost = !self.advance(&before, &point);
            self.record_ends(&before, &point, last);
            let (block, gap, end) = self.nearest(&point, lost);
            let off = linear(&gap).max(rotary(&gap));
            let tolerance = self.tolerance(block);
            if last {
                found.linear = linear(&gap);
                found.rotary = rotary(&gap);
                found.ratio = off / tolerance;
                found.block = block;
                found.last = end;
            }
            found.between = found.between.max(off);
            found.between_ratio = found.between_ratio.max(off / (tolerance + self.chord_mm));
            found.lost |= lost;
            before = point;
        }
        found.first = first.min(found.block);
        self.settle(self.at.block);
        found
    }

    /// Ends the motion: the rest of the program counts as left out unless it is near.
    pub(crate) fn finish(mut self) -> Coverage {
        let blocks = self.route.blocks.len();
        let here = self.last;
        let route_position = self.at;
        self.record_ends(&here, &here, true);
        self.settle(blocks);
        if !self.ends_here(route_position) && self.coverage.missed == 0 {
            self.coverage.missed = 1;
            self.coverage.first_missed = Some(route_position.block);
        }
        self.coverage
    }

    /// Whether the rest of the program from `route_position` on stays near the motion's last point. A loop
    /// that was not driven ends at that point too, but does not stay near it.
    fn ends_here(&self, mut route_position: RoutePosition) -> bool {
        while let Some(block) = self.route.blocks.get(route_position.block) {
            let within = self.within(route_position.block);
            loop {
                let off = distance(&self.last, &block.piece.point(route_position.u));
                let margin = NEIGHBOURHOOD * within - off;
                if margin < 0.0 {
                    return false;
                }
                if route_position.u >= block.length {
                    break;
                }
                route_position.u = (route_position.u + margin.max(within / 64.0)).min(block.length);
            }
            route_position = RoutePosition {
                block: route_position.block + 1,
                u: 0.0,
            };
        }
        true
    }

    /// Tolerance of a block, and of the corner before it.
    fn tolerance(&self, block: usize) -> f64 {
        let before = &self.route.blocks[block.saturating_sub(1)];
        self.route.blocks[block]
            .tolerance
            .max(before.tolerance)
            .max(EXACT)
    }

    /// Distance within which a point counts as on the block. Wider than the tolerance, so that a motion with
    /// a small deviation is judged as a deviation and not as lost.
    fn within(&self, block: usize) -> f64 {
        1.05 * self.tolerance(block) + 4.0 * self.chord_mm
    }

    /// The same near the end of a block, whose corner also belongs to the next block.
    fn within_corner(&self, block: usize) -> f64 {
        let next = (block + 1).min(self.route.blocks.len() - 1);
        self.within(block).max(self.within(next))
    }

    /// Finds the earliest position from `route_position` on that is near `point`, if everything passed is near the
    /// motion.
    fn search(
        &self,
        before: &Axes,
        point: &Axes,
        mut route_position: RoutePosition,
    ) -> Option<RoutePosition> {
        // The position lags by up to this distance: if the tolerance decreases abruptly, this lag is not a
        // deviation.
        let behind = self.within(route_position.block);
        loop {
            let block = &self.route.blocks[route_position.block];
            let within = self.within(route_position.block);
            loop {
                let there = block.piece.point(route_position.u);
                let away = distance(point, &there);
                if away <= within {
                    return Some(route_position);
                }
                let near = NEIGHBOURHOOD * self.within_corner(route_position.block).max(behind);
                if from_stretch(&there, before, point) > near && !self.was_near(&there, near) {
                    return None;
                }
                if route_position.u >= block.length {
                    break;
                }
                // No closer position can be near enough, because no point moves faster than its parameter.
                route_position.u = (route_position.u + (away - within).max(within / 64.0)).min(block.length);
            }
            if route_position.block + 1 == self.route.blocks.len() {
                return None;
            }
            route_position = RoutePosition {
                block: route_position.block + 1,
                u: 0.0,
            };
        }
    }

    /// Whether the motion was this near while the program position was near its present value.
    fn was_near(&self, there: &Axes, near: f64) -> bool {
        (self.trail.iter()).any(|(motion, _)| distance(there, motion) <= near)
    }

    /// Advances to `point`. Returns `false` if the program does not lead there.
    fn advance(&mut self, before: &Axes, point: &Axes) -> bool {
        let found = self.search(before, point, self.at);
        let route_position = found.unwrap_or_else(|| self.recover(point));
        self.at = route_position;
        let here = self.route.blocks[route_position.block]
            .piece
            .point(route_position.u);
        let near = NEIGHBOURHOOD * self.within(route_position.block);
        while let Some((_, then)) = self.trail.front()
            && (distance(then, &here) > near || self.trail.len() >= MAX_TRAIL)
        {
            self.trail.pop_front();
        }
        if self.trail.back().is_none_or(|(motion, _)| motion != point) {
            self.trail.push_back((*point, here));
        }
        found.is_some()
    }

    /// Finds the nearest position ahead for a motion that has left the path: at most as far ahead as the
    /// motion is away. A later position counts only if it is significantly nearer: of overlapping turns the
    /// first one is taken.
    fn recover(&self, point: &Axes) -> RoutePosition {
        let off = |route_position: RoutePosition| {
            distance(
                point,
                &self.route.blocks[route_position.block]
                    .piece
                    .point(route_position.u),
            )
        };
        let away = off(self.at);
        let (u, mut min_distance) = self.route.blocks[self.at.block].piece.nearest(point, self.at.u);
        let mut best = RoutePosition {
            block: self.at.block,
            u,
        };
        let reach = 4.0 * away + 100.0 * self.within(best.block);
        let mut passed = -self.at.u;
        for index in (self.at.block..self.route.blocks.len()).take(MAX_BLOCKS) {
            let block = &self.route.blocks[index];
            let from = if index == self.at.block { self.at.u } else { 0.0 };
            let max_u = (reach - passed).min(block.length);
            let tries = if block.piece.is_straight() { 1 } else { TRIES };
            for i in 0..tries {
                let u = from + (max_u - from).max(0.0) * (i as f64 / tries as f64);
                let (u, distance) = block.piece.nearest(point, u);
                if distance < 0.5 * min_distance {
                    min_distance = distance;
                    best = RoutePosition { block: index, u };
                }
            }
            passed += block.length;
            if passed > reach {
                break;
            }
        }
        best
    }

    /// Finds the nearest position from the present one on, as far as the path stays near `point`. Returns the
    /// block, the gap, and the last block examined. After a reversal the present position lags by a tolerance
    /// while the motion leads by a tolerance.
    fn nearest(&self, point: &Axes, lost: bool) -> (usize, Axes, usize) {
        let mut index = self.at.block;
        let mut from = self.at.u;
        let mut best = (f64::INFINITY, index, 0.0);
        loop {
            let block = &self.route.blocks[index];
            let (mut u, mut off) = block.piece.nearest(point, from);
            let near = NEIGHBOURHOOD * self.within_corner(index);
            if off > self.tolerance(index) && !block.piece.is_straight() {
                (u, off) = self.nearest_around(point, index, from, (u, off), near);
            }
            if off < best.0 {
                best = (off, index, u);
            }
            let goes_on = index + 1 < self.route.blocks.len()
                && !lost
                && (distance(point, &block.end) <= near || self.was_near(&block.end, near));
            if !goes_on {
                break;
            }
            index += 1;
            from = 0.0;
        }
        let route_position = self.route.blocks[best.1].piece.point(best.2);
        (best.1, point - route_position, index)
    }

    /// Finds the nearest point of a curve from `from` on, as far as it stays within `near` of the point.
    /// Returns its parameter and distance. An arc smaller than the tolerance is near a point twice, and only
    /// the first time adjoins `from`.
    fn nearest_around(
        &self,
        point: &Axes,
        index: usize,
        from: f64,
        known: (f64, f64),
        near: f64,
    ) -> (f64, f64) {
        let block = &self.route.blocks[index];
        let finest = self.within(index) / 64.0;
        let (mut best, mut u) = (known, from);
        loop {
            let off = distance(point, &block.piece.point(u));
            if off > near {
                break;
            }
            if off < best.1 {
                best = (u, off);
            }
            if u >= block.length {
                break;
            }
            // No point moves faster than its parameter, so nothing in between is nearer than the best one.
            u = (u + (off - best.1).max(finest)).min(block.length);
        }
        let refined = block.piece.nearest(point, best.0);
        if refined.1 < best.1 { refined } else { best }
    }

    /// Records the distance of the motion from the ends of blocks that are being passed or are ahead.
    fn record_ends(&mut self, before: &Axes, point: &Axes, is_setpoint: bool) {
        let passed = self.at.block;
        for index in self.done..self.route.blocks.len() {
            let block = &self.route.blocks[index];
            let off = from_stretch(&block.end, before, point);
            // The position may lag by the tolerance of its block, even if the next ones are finer.
            let within = self.within_corner(index).max(self.within(passed));
            if index >= passed && off > 2.0 * NEIGHBOURHOOD * within {
                break;
            }
            if self.ends.len() <= index - self.done {
                self.ends.push_back((f64::INFINITY, f64::INFINITY));
            }
            let known = &mut self.ends[index - self.done];
            known.0 = known.0.min(off);
            if is_setpoint {
                known.1 = known.1.min(distance(&block.end, point));
            }
        }
    }

    /// Completes the ends before `block`.
    fn settle(&mut self, block: usize) {
        while self.done < block {
            let end = &self.route.blocks[self.done];
            let (off, setpoint) = self.ends.pop_front().unwrap_or_else(|| {
                let off = distance(&end.end, &self.last);
                (off, off)
            });
            if off > self.coverage.farthest.0 {
                self.coverage.farthest = (off, self.done);
            }
            if off > NEIGHBOURHOOD * self.within_corner(self.done) {
                self.coverage.missed += 1;
                self.coverage.first_missed.get_or_insert(self.done);
            }
            if end.rest && setpoint > self.coverage.rest.0 {
                self.coverage.rest = (setpoint, self.done);
            }
            self.done += 1;
        }
    }
}

/// Permitted deviation in exact-path mode, mm or degrees.
const EXACT: f64 = 1e-6;

//! A part of the path that becomes a spline: its knots, control points and constraints.

use std::ops::Range;

use evolvent_path::{Axes, Jet};

use crate::basis::{Basis, basis};
use crate::chain::Chain;
use crate::follow::follow;
use crate::spacing::{self, GROWTH};
use crate::tube::{Interval, MAX_PARTS, MIN_PARTS, Sample, SamplingCoverage, covers, sample};

/// Number of intervals that are settled at a time.
pub(crate) const BATCH: usize = 32;
/// Number of further intervals, placed to verify that the settled ones can be continued.
const AHEAD: usize = 8;
/// Maximum number of attempts to place a batch, with smaller spacing each time.
const ATTEMPTS: usize = 40;
/// Maximum squared error of the start, relative to the squared radius.
const START_RATIO: f64 = 0.85;
/// Minimum number of intervals of a zone.
const MIN_INTERVALS: usize = 6;
/// Number of intervals over which the spacing is adapted to the end of the zone.
const ENDING: usize = 12;

/// Maximum number of backtracking steps towards a safe solution, and their factor.
const MAX_BACKTRACKS: usize = 30;
const BACKTRACK_FACTOR: f64 = 0.8;
/// Margin, relative to the squared radius, that samples need for further steps.
const MIN_MARGIN: f64 = 1e-3;

/// The condition at an end of a zone.
#[derive(Clone, Copy, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "there are two, and they must not allocate"
)]
pub(crate) enum EndCondition {
    /// Position and two derivatives.
    Jet(Jet),
    /// The position; the path is at rest there.
    Position(Axes),
}

/// Result of extending a zone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ExtendResult {
    /// A batch was settled.
    Batch,
    /// The zone is settled to its end.
    End,
    /// More of the path must be known.
    Wait,
    /// No spacing was found that keeps the start inside the tube.
    Failed {
        /// End of the part concerned.
        until: f64,
    },
}

/// The zone under construction.
#[derive(Debug, Default)]
pub(crate) struct BlendZone {
    /// Knots; three more before the first interval and after the last.
    pub(crate) knots: Vec<f64>,
    pub(crate) bases: Vec<Basis>,
    pub(crate) points: Vec<Axes>,
    pub(crate) samples: Vec<Sample>,
    /// How the samples cover each interval.
    coverage: Vec<SamplingCoverage>,
    /// Number of settled knots.
    settled: usize,
    /// Number of control points that are final.
    pub(crate) fixed: usize,
    /// Number of control points prescribed at the end.
    pub(crate) clamped: usize,
    pub(crate) complete: bool,
    /// Knots of the last attempt. If intervals have been output, the last of those is still the first here.
    trial: Vec<f64>,
    /// Intervals that are not covered.
    open: Vec<usize>,
    /// Samples at the right end of an interval.
    last: Vec<Sample>,
    /// Samples before resampling.
    old: Vec<Sample>,
}

impl BlendZone {
    /// Starts at `u`.
    pub(crate) fn begin(&mut self, u: f64) {
        self.knots.clear();
        self.knots.extend([u; 4]);
        self.bases.clear();
        self.points.clear();
        self.samples.clear();
        self.coverage.clear();
        self.settled = 4;
        self.fixed = 0;
        self.clamped = 0;
        self.complete = false;
    }

    pub(crate) fn knot(&self, interval: usize) -> f64 {
        self.knots[interval + 3]
    }

    /// Number of settled intervals.
    pub(crate) fn intervals(&self) -> usize {
        self.bases.len()
    }

    pub(crate) fn jet(&self, interval: usize) -> Jet {
        let (basis, points) = (&self.bases[interval], &self.points[interval..interval + 4]);
        let of = |order: usize| {
            (1..4).fold(points[0] * basis[0][order], |sum, l| {
                sum + points[l] * basis[l][order]
            })
        };
        Jet {
            position: of(0),
            first: of(1),
            second: of(2),
            third: of(3),
        }
    }

    /// Places knots as far as the path permits. `start` is the condition at the start of the zone, `end` its
    /// end if known, and `reach` the position up to which spacings are determined.
    pub(crate) fn extend(
        &mut self,
        chain: &mut Chain,
        start: &EndCondition,
        end: Option<(f64, EndCondition)>,
        reach: f64,
        active: &[bool; 9],
    ) -> ExtendResult {
        if self.complete {
            return ExtendResult::End;
        }
        let last = self.knots[self.knots.len() - 1];
        if end.is_some_and(|(end, _)| end <= last) {
            return ExtendResult::Failed { until: last };
        }
        // Beyond the chain nothing is known, even if the path ends there.
        let reach = reach.min(chain.end());
        let mut until = last;
        let (points, bases, samples) = (self.points.len(), self.bases.len(), self.samples.len());
        let settled = self.settled;
        for _ in 0..ATTEMPTS {
            self.knots.truncate(settled);
            self.points.truncate(points);
            self.bases.truncate(bases);
            self.samples.truncate(samples);
            self.coverage.truncate(bases);
            let Some(complete) = self.place_knots(chain, end.map(|(u, _)| u), reach) else {
                self.knots.truncate(settled);
                return ExtendResult::Wait;
            };
            self.start_points(
                chain,
                start,
                end.filter(|_| complete).map(|(_, end_condition)| end_condition),
            );
            match self.condition(chain, active) {
                Some(interval) => {
                    let width = self.knot(interval + 1) - self.knot(interval);
                    let middle = 0.5 * (self.knot(interval + 1) + self.knot(interval));
                    until = self.knot(interval + 1);
                    shrink(chain, middle, width);
                }
                None if complete => {
                    self.settled = self.knots.len();
                    self.complete = true;
                    return ExtendResult::End;
                }
                None => {
                    // What was placed ahead is placed again next time.
                    self.settled = settled + BATCH;
                    self.knots.truncate(self.settled);
                    self.points.truncate(self.settled - 3);
                    self.bases.truncate(self.settled - 6);
                    let count = self.bases.len();
                    self.coverage.truncate(count);
                    let kept = self.samples.partition_point(|sample| sample.interval < count);
                    self.samples.truncate(kept);
                    return ExtendResult::Batch;
                }
            }
        }
        self.knots.truncate(settled);
        self.points.truncate(points);
        self.bases.truncate(bases);
        self.samples.truncate(samples);
        self.coverage.truncate(bases);
        ExtendResult::Failed { until }
    }

    /// Places knots; returns whether the end was reached, or `None` if the path is not known far enough.
    fn place_knots(&mut self, chain: &Chain, end: Option<f64>, reach: f64) -> Option<bool> {
        let target = self.knots.len() + BATCH + AHEAD;
        let mut near = chain.find(*self.knots.last()?);
        self.trial.clear();
        while self.knots.len() < target {
            let u = *self.knots.last()?;
            if let Some(end) = end
                && self.finish(chain, u, end, &mut near)
            {
                return Some(true);
            }
            let next_width = next_width(chain, u, &mut near);
            if end.is_none() && u + next_width + next_width / GROWTH > reach {
                return None;
            }
            self.knots.push(u + next_width);
        }
        Some(false)
    }

    /// Distributes the last knots if the end is near.
    fn finish(&mut self, chain: &Chain, from: f64, end: f64, near: &mut usize) -> bool {
        // The knots of the last attempt from the previous knot are those that would be tried now.
        if self.trial.get(1) == Some(&from) {
            self.trial.remove(0);
        } else {
            self.trial.clear();
            self.trial.push(from);
        }
        let mut u = self.trial.last().copied().unwrap_or(from);
        while u < end {
            if self.trial.len() > ENDING {
                return false;
            }
            u += next_width(chain, u, near);
            self.trial.push(u);
        }
        let last = self.trial.len() - 1;
        let before = self.trial[last - 1];
        let fraction = (end - before) / (self.trial[last] - before);
        let left = (last - 1) as f64 + fraction;
        let begun = self.knots.len() == 4;
        let min = if begun { MIN_INTERVALS } else { 1 };
        // Of two possible counts the smaller, if that stretches the intervals only slightly.
        let count = ((left - 0.1).ceil().max(1.0) as usize).max(min);
        for k in 1..count {
            let w = left * k as f64 / count as f64;
            let j = (w.floor() as usize).min(last - 1);
            let (a, b) = (self.trial[j], self.trial[j + 1]);
            self.knots.push(a + (b - a) * (w - j as f64));
        }
        self.knots.extend([end; 4]);
        true
    }

    /// Control points of the new knots: on the programmed path, so that the start is a moving average of it,
    /// except those that an end condition prescribes.
    fn start_points(&mut self, chain: &Chain, start: &EndCondition, end: Option<EndCondition>) {
        let first = self.points.len();
        let mut near = chain.find(self.knots[first + 1]);
        for j in first..self.knots.len() - 3 {
            let u = (self.knots[j + 1] + self.knots[j + 2] + self.knots[j + 3]) / 3.0;
            near = chain.find_near(u, near);
            self.points.push(
                chain
                    .get(near)
                    .map_or_else(Axes::zeros, |segment| segment.position(u)),
            );
        }
        if first == 0 {
            let (h1, h2) = (self.knots[4] - self.knots[3], self.knots[5] - self.knots[4]);
            let clamped = clamped(start, h1, h2, 1.0);
            self.fixed = clamped.1;
            self.points[..self.fixed].copy_from_slice(&clamped.0[..self.fixed]);
        }
        if let Some(end) = end {
            // The three coincident end knots give one point too many.
            self.points.truncate(self.knots.len() - 4);
            let n = self.knots.len();
            let (h1, h2) = (
                self.knots[n - 4] - self.knots[n - 5],
                self.knots[n - 5] - self.knots[n - 6],
            );
            let clamped = clamped(&end, h1, h2, -1.0);
            self.clamped = clamped.1;
            let count = self.points.len();
            for k in 0..self.clamped {
                self.points[count - 1 - k] = clamped.0[k];
            }
        }
        let intervals = self.points.len() - 3;
        for i in self.bases.len()..intervals.min(self.knots.len() - 6) {
            let six: [f64; 6] = std::array::from_fn(|k| self.knots[i + 1 + k]);
            self.bases.push(basis(&six));
        }
    }

    /// An interval as seen by its samples. The previous one may have been output already; its end does not
    /// change any more.
    fn interval(&self, index: usize) -> Interval {
        let before = index.checked_sub(1).and_then(|before| self.coverage.get(before));
        Interval {
            index,
            from: self.knot(index),
            to: self.knot(index + 1),
            start_before: self.knots[index + 2],
            deviation_before: before.map_or(0.0, |coverage| coverage.chord_deviation),
        }
    }

    /// Samples of the new intervals; returns the first interval whose start is not well inside the tube.
    fn condition(&mut self, chain: &Chain, active: &[bool; 9]) -> Option<usize> {
        for i in self.coverage.len()..self.bases.len() {
            let from = self.samples.len();
            let range = (self.knot(i), self.knot(i + 1));
            let points = &self.points[i..i + 4];
            let mut parts = MIN_PARTS;
            loop {
                self.samples.truncate(from);
                let interval = self.interval(i);
                let basis = &self.bases[i];
                let coverage = sample(chain, &interval, parts, basis, active, &mut self.samples);
                let samples = &self.samples[from..];
                let bad = samples
                    .iter()
                    .any(|sample| !(sample.ratio(&sample.error(points)) <= START_RATIO));
                if bad {
                    return Some(i);
                }
                let last = (active, &mut self.last);
                if covers(
                    chain,
                    coverage,
                    range,
                    &self.bases[i],
                    points,
                    (samples, None),
                    last,
                ) {
                    self.coverage.push(coverage);
                    break;
                }
                parts *= 2;
                if parts > MAX_PARTS {
                    return Some(i);
                }
            }
        }
        None
    }

    /// Indices of the samples of the intervals `from..to`.
    pub(crate) fn samples_of(&self, from: usize, to: usize) -> Range<usize> {
        let of = |interval: usize| self.samples.partition_point(|sample| sample.interval < interval);
        of(from)..of(to)
    }

    /// Whether the spline keeps the tolerance in the whole interval.
    fn is_covered(&mut self, chain: &Chain, interval: usize, active: &[bool; 9]) -> bool {
        let samples = self.samples_of(interval, interval + 1);
        let next = self.samples.get(samples.end).copied();
        covers(
            chain,
            self.coverage[interval],
            (self.knot(interval), self.knot(interval + 1)),
            &self.bases[interval],
            &self.points[interval..interval + 4],
            (&self.samples[samples], next.as_ref()),
            (active, &mut self.last),
        )
    }

    /// Adds samples to those of the intervals `from..to` that are not covered, and returns whether all were.
    /// Those that were not stay marked for [`relax_toward`](Self::relax_toward).
    pub(crate) fn ensure_coverage(
        &mut self,
        chain: &Chain,
        from: usize,
        to: usize,
        active: &[bool; 9],
    ) -> bool {
        self.open.clear();
        for i in from..to {
            if !self.is_covered(chain, i, active) {
                self.open.push(i);
                self.coverage[i].parts = (2 * self.coverage[i].parts).min(MAX_PARTS);
            }
        }
        if !self.open.is_empty() {
            self.resample(chain, from, false, active);
        }
        self.open.is_empty()
    }

    /// Moves the free control points of the intervals that were not covered back towards `safe`.
    pub(crate) fn relax_toward(&mut self, safe: &[Axes], free: (usize, usize), fraction: f64) {
        for &i in &self.open {
            for j in i.max(free.0)..(i + 4).min(free.1) {
                self.points[j] = safe[j] + (self.points[j] - safe[j]) * fraction;
            }
        }
    }

    /// Recreates the samples because other axes move.
    pub(crate) fn measure(&mut self, chain: &Chain, active: &[bool; 9]) {
        self.resample(chain, 0, true, active);
    }

    /// Recreates the samples of the intervals from `from`, all or those in `open`, because others have moved.
    fn resample(&mut self, chain: &Chain, from: usize, all: bool, active: &[bool; 9]) {
        let first = self.samples.partition_point(|sample| sample.interval < from);
        self.old.clear();
        self.old.extend_from_slice(&self.samples[first..]);
        self.samples.truncate(first);
        let mut at = 0;
        for i in from..self.coverage.len() {
            let count = self.old[at..].partition_point(|sample| sample.interval <= i);
            if all || self.open.contains(&i) {
                let (interval, parts) = (self.interval(i), self.coverage[i].parts);
                let basis = &self.bases[i];
                self.coverage[i] = sample(chain, &interval, parts, basis, active, &mut self.samples);
            } else {
                self.samples.extend_from_slice(&self.old[at..at + count]);
            }
            at += count;
        }
        self.follow(chain, from, self.coverage.len());
    }

    /// Moves the samples of the intervals `from..to` to the spline.
    pub(crate) fn follow(&mut self, chain: &Chain, from: usize, to: usize) {
        let samples = self.samples_of(from, to);
        follow(chain, &mut self.samples, samples, &self.points);
    }

    /// Moves free control points back towards `safe` where samples have no margin, until all have one;
    /// returns whether they have. Control points elsewhere stay.
    pub(crate) fn backtrack(&mut self, safe: &[Axes], free: (usize, usize), from: usize, to: usize) -> bool {
        let samples = self.samples_of(from, to);
        for sample in &mut self.samples[samples.clone()] {
            // The safe solution may use more of the tolerance next to the previous samples than samples may.
            let used = sample.ratio(&sample.error(&safe[sample.interval..sample.interval + 4]));
            if used > 1.0 - 2.0 * MIN_MARGIN {
                let max = sample.tolerance * sample.tolerance;
                let wider = sample.radius2 * used / (1.0 - 2.0 * MIN_MARGIN);
                sample.radius2 = wider.min(max).max(sample.radius2);
            }
        }
        for _ in 0..MAX_BACKTRACKS {
            self.open.clear();
            for sample in &self.samples[samples.clone()] {
                let i = sample.interval;
                let margin = 1.0 - sample.ratio(&sample.error(&self.points[i..i + 4]));
                if !(margin >= MIN_MARGIN) && self.open.last() != Some(&i) {
                    self.open.push(i);
                }
            }
            if self.open.is_empty() {
                return true;
            }
            self.relax_toward(safe, free, BACKTRACK_FACTOR);
        }
        false
    }

    /// Drops the first intervals.
    pub(crate) fn forget(&mut self, intervals: usize) {
        self.knots.drain(..intervals);
        self.points.drain(..intervals);
        self.bases.drain(..intervals);
        self.coverage.drain(..intervals);
        let behind = self.samples.partition_point(|sample| sample.interval < intervals);
        self.samples.drain(..behind);
        for sample in &mut self.samples {
            sample.interval -= intervals;
        }
        self.settled -= intervals;
        self.fixed -= intervals;
    }
}

/// Width of the next interval: the spacing at its middle.
fn next_width(chain: &Chain, u: f64, near: &mut usize) -> f64 {
    let at = |u: f64, near: &mut usize| {
        *near = chain.find_near(u, *near);
        let Some(segment) = chain.get(*near) else {
            return 1.0;
        };
        let at_end = chain
            .get(*near + 1)
            .map_or(chain.end_spacing, |next| next.spacing);
        spacing::within(segment, at_end, u)
    };
    let mut next_width = at(u, near);
    for _ in 0..2 {
        next_width = at(u + 0.5 * next_width, near);
    }
    next_width
}

/// Reduces the spacing around an interval.
fn shrink(chain: &mut Chain, u: f64, width: f64) {
    let number = chain.find(u);
    if let Some(segment) = chain.get_mut(number)
        && !segment.straight
    {
        segment.inner_spacing = segment.inner_spacing.min(0.7 * width);
    }
    for joint in [number, number + 1] {
        if let Some(segment) = chain.get_mut(joint) {
            segment.spacing = (0.8 * segment.spacing).min(0.7 * width);
        }
        spread(chain, joint);
    }
}

/// Propagates the spacing limit of a joint to both sides.
pub(crate) fn spread(chain: &mut Chain, number: usize) {
    let Some(&segment) = chain.get(number) else {
        return;
    };
    let (mut spacing, mut u) = (segment.spacing, segment.from);
    let mut at = number;
    while at > chain.first() {
        at -= 1;
        let Some(segment) = chain.get_mut(at) else {
            break;
        };
        spacing += GROWTH * (u - segment.from);
        u = segment.from;
        if segment.spacing <= spacing {
            break;
        }
        segment.spacing = spacing;
    }
    let (mut spacing, mut u) = (segment.spacing, segment.from);
    let mut at = number + 1;
    while let Some(segment) = chain.get_mut(at) {
        spacing += GROWTH * (segment.from - u);
        u = segment.from;
        if segment.spacing <= spacing {
            break;
        }
        segment.spacing = spacing;
        at += 1;
    }
}

/// The control points that an end condition prescribes, from the end inwards, and their number. `h1`, `h2`
/// are the widths of the intervals from the end inwards, `sign` is -1 at the end of a zone.
fn clamped(end_condition: &EndCondition, h1: f64, h2: f64, sign: f64) -> ([Axes; 3], usize) {
    match end_condition {
        EndCondition::Position(position) => ([*position; 3], 1),
        EndCondition::Jet(jet) => {
            let first = jet.first * sign;
            let second = first + jet.second * (0.5 * h1);
            let c1 = jet.position + first * (h1 / 3.0);
            let c2 = c1 + second * ((h1 + h2) / 3.0);
            ([jet.position, c1, c2], 3)
        }
    }
}

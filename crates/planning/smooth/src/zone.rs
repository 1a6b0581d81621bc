//! A stretch of the path that becomes a spline: its knots, control points and conditions.

use std::ops::Range;

use evolvent_path::{Axes, Jet};

use crate::basis::{Basis, basis};
use crate::chain::Chain;
use crate::follow::follow;
use crate::spacing::{self, GROWTH};
use crate::tube::{FEWEST_PARTS, Interval, MAX_PARTS, Sample, SamplingCoverage, covers, sample};

/// Intervals that are settled at a time.
pub(crate) const BATCH: usize = 32;
/// Intervals beyond, laid to see that the settled ones can be continued.
const AHEAD: usize = 8;
/// Attempts to lay a batch, with smaller spacing each time.
const ATTEMPTS: usize = 40;
/// Largest squared error, in units of the squared radius, of the start.
const START_RATIO: f64 = 0.85;
/// Fewest intervals of a zone.
const FEWEST: usize = 6;
/// Intervals over which the spacing is adapted to meet the zone's end.
const ENDING: usize = 12;

/// Steps back towards a safe solution, and their factor.
const RETREATS: usize = 30;
const RETREAT: f64 = 0.8;
/// Room, as a share of the squared radius, that samples need for a way on.
const MIN_DISTANCE: f64 = 1e-3;

/// What is kept at an end of a zone.
#[derive(Clone, Copy, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "there are two, and they must not allocate"
)]
pub(crate) enum EndCondition {
    /// Position and two derivatives.
    Jet(Jet),
    /// The position: the path is at rest there.
    Place(Axes),
}

/// Progress of laying.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ExtendResult {
    /// A batch was settled.
    Batch,
    /// The zone is settled to its end.
    End,
    /// More of the path must be known.
    Wait,
    /// No spacing was found that keeps the start in the tube.
    Failed {
        /// Up to where the trouble reaches.
        until: f64,
    },
}

/// The zone that is being built.
#[derive(Debug, Default)]
pub(crate) struct BlendZone {
    /// Knots; three more before the first interval, and behind the last.
    pub(crate) knots: Vec<f64>,
    pub(crate) bases: Vec<Basis>,
    pub(crate) points: Vec<Axes>,
    pub(crate) samples: Vec<Sample>,
    /// How the samples cover each interval.
    covers: Vec<SamplingCoverage>,
    /// Knots that are settled.
    settled: usize,
    /// Control points that do not change any more.
    pub(crate) fixed: usize,
    /// Control points kept at the end.
    pub(crate) clamped: usize,
    pub(crate) complete: bool,
    /// Intervals that were given away: the first of those is still here when this is not 0.
    trial: Vec<f64>,
    /// Intervals with something amiss.
    open: Vec<usize>,
    /// Samples at an interval's right end.
    last: Vec<Sample>,
    /// Samples before they are made anew.
    old: Vec<Sample>,
}

impl BlendZone {
    /// Begins at `u`.
    pub(crate) fn begin(&mut self, u: f64) {
        self.knots.clear();
        self.knots.extend([u; 4]);
        self.bases.clear();
        self.points.clear();
        self.samples.clear();
        self.covers.clear();
        self.settled = 4;
        self.fixed = 0;
        self.clamped = 0;
        self.complete = false;
    }

    pub(crate) fn knot(&self, interval: usize) -> f64 {
        self.knots[interval + 3]
    }

    /// Settled intervals.
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

    /// Lays knots as far as the path allows. `start` is the clamp at the zone's start, `end` where it ends, if that
    /// is known, and `reach` up to where spacings are settled.
    pub(crate) fn lay(
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
        // Beyond the chain nothing is known, even where no more will come.
        let reach = reach.min(chain.end());
        let mut until = last;
        let (points, bases, samples) = (self.points.len(), self.bases.len(), self.samples.len());
        let settled = self.settled;
        for _ in 0..ATTEMPTS {
            self.knots.truncate(settled);
            self.points.truncate(points);
            self.bases.truncate(bases);
            self.samples.truncate(samples);
            self.covers.truncate(bases);
            let Some(complete) = self.place_knots(chain, end.map(|(u, _)| u), reach) else {
                self.knots.truncate(settled);
                return ExtendResult::Wait;
            };
            self.start_points(chain, start, end.filter(|_| complete).map(|(_, clamp)| clamp));
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
                    // What was laid ahead is laid again next time.
                    self.settled = settled + BATCH;
                    self.knots.truncate(self.settled);
                    self.points.truncate(self.settled - 3);
                    self.bases.truncate(self.settled - 6);
                    let count = self.bases.len();
                    self.covers.truncate(count);
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
        self.covers.truncate(bases);
        ExtendResult::Failed { until }
    }

    /// Places knots; whether the end was reached, `None` if the path is not known far enough.
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
            let step = step(chain, u, &mut near);
            if end.is_none() && u + step + step / GROWTH > reach {
                return None;
            }
            self.knots.push(u + step);
        }
        Some(false)
    }

    /// Distributes the last knots, if the end is near.
    fn finish(&mut self, chain: &Chain, from: f64, end: f64, near: &mut usize) -> bool {
        // The knots tried last time from the knot before are those that would be tried now.
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
            u += step(chain, u, near);
            self.trial.push(u);
        }
        let last = self.trial.len() - 1;
        let before = self.trial[last - 1];
        let share = (end - before) / (self.trial[last] - before);
        let left = (last - 1) as f64 + share;
        let begun = self.knots.len() == 4;
        let least = if begun { FEWEST } else { 1 };
        // Of two possible counts the smaller, if that stretches the intervals little.
        let count = ((left - 0.1).ceil().max(1.0) as usize).max(least);
        for k in 1..count {
            let w = left * k as f64 / count as f64;
            let j = (w.floor() as usize).min(last - 1);
            let (a, b) = (self.trial[j], self.trial[j + 1]);
            self.knots.push(a + (b - a) * (w - j as f64));
        }
        self.knots.extend([end; 4]);
        true
    }

    /// Control points that the new knots determine: on the programmed path, so that the start is a moving average
    /// of it, but for those that a clamp prescribes.
    fn start_points(&mut self, chain: &Chain, start: &EndCondition, end: Option<EndCondition>) {
        let first = self.points.len();
        let mut near = chain.find(self.knots[first + 1]);
        for j in first..self.knots.len() - 3 {
            let u = (self.knots[j + 1] + self.knots[j + 2] + self.knots[j + 3]) / 3.0;
            near = chain.find_near(u, near);
            self.points
                .push(chain.get(near).map_or_else(Axes::zeros, |link| link.position(u)));
        }
        if first == 0 {
            let (h1, h2) = (self.knots[4] - self.knots[3], self.knots[5] - self.knots[4]);
            let clamped = clamped(start, h1, h2, 1.0);
            self.fixed = clamped.1;
            self.points[..self.fixed].copy_from_slice(&clamped.0[..self.fixed]);
        }
        if let Some(end) = end {
            // The three coincident end knots make one point too many.
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

    /// An interval as its samples see it. Of one before that was given away nothing is left; its end does not change any more.
    fn interval(&self, index: usize) -> Interval {
        let before = index.checked_sub(1).and_then(|before| self.covers.get(before));
        Interval {
            index,
            from: self.knot(index),
            to: self.knot(index + 1),
            start_before: self.knots[index + 2],
            deviation_before: before.map_or(0.0, |cover| cover.chord_deviation),
        }
    }

    /// Samples of the new intervals; the first interval whose start is not well inside the tube.
    fn condition(&mut self, chain: &Chain, active: &[bool; 9]) -> Option<usize> {
        for i in self.covers.len()..self.bases.len() {
            let from = self.samples.len();
            let range = (self.knot(i), self.knot(i + 1));
            let points = &self.points[i..i + 4];
            let mut parts = FEWEST_PARTS;
            loop {
                self.samples.truncate(from);
                let interval = self.interval(i);
                let basis = &self.bases[i];
                let cover = sample(chain, &interval, parts, basis, active, &mut self.samples);
                let samples = &self.samples[from..];
                let bad = samples
                    .iter()
                    .any(|sample| !(sample.ratio(&sample.error(points)) <= START_RATIO));
                if bad {
                    return Some(i);
                }
                let last = (active, &mut self.last);
                if covers(chain, cover, range, &self.bases[i], points, (samples, None), last) {
                    self.covers.push(cover);
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

    /// Places of the samples of the intervals `from..to`.
    pub(crate) fn samples_of(&self, from: usize, to: usize) -> Range<usize> {
        let of = |interval: usize| self.samples.partition_point(|sample| sample.interval < interval);
        of(from)..of(to)
    }

    /// Whether the spline keeps to the tolerance in all of an interval.
    fn covered(&mut self, chain: &Chain, interval: usize, active: &[bool; 9]) -> bool {
        let samples = self.samples_of(interval, interval + 1);
        let next = self.samples.get(samples.end).copied();
        covers(
            chain,
            self.covers[interval],
            (self.knot(interval), self.knot(interval + 1)),
            &self.bases[interval],
            &self.points[interval..interval + 4],
            (&self.samples[samples], next.as_ref()),
            (active, &mut self.last),
        )
    }

    /// Adds samples to those of the intervals `from..to` that are not covered; whether all were. Those that were not
    /// stay marked for [`relax_toward`](Self::give_way).
    pub(crate) fn cover(&mut self, chain: &Chain, from: usize, to: usize, active: &[bool; 9]) -> bool {
        self.open.clear();
        for i in from..to {
            if !self.covered(chain, i, active) {
                self.open.push(i);
                self.covers[i].parts = (2 * self.covers[i].parts).min(MAX_PARTS);
            }
        }
        if !self.open.is_empty() {
            self.resample(chain, from, false, active);
        }
        self.open.is_empty()
    }

    /// Brings the free control points of the intervals that were not covered back towards `safe`.
    pub(crate) fn relax_toward(&mut self, safe: &[Axes], free: (usize, usize), share: f64) {
        for &i in &self.open {
            for j in i.max(free.0)..(i + 4).min(free.1) {
                self.points[j] = safe[j] + (self.points[j] - safe[j]) * share;
            }
        }
    }

    /// Makes the samples anew because other axes move.
    pub(crate) fn measure(&mut self, chain: &Chain, active: &[bool; 9]) {
        self.resample(chain, 0, true, active);
    }

    /// Makes the samples of intervals from `from` on anew, of all or of those that are `open`: others have moved.
    fn resample(&mut self, chain: &Chain, from: usize, all: bool, active: &[bool; 9]) {
        let first = self.samples.partition_point(|sample| sample.interval < from);
        self.old.clear();
        self.old.extend_from_slice(&self.samples[first..]);
        self.samples.truncate(first);
        let mut at = 0;
        for i in from..self.covers.len() {
            let count = self.old[at..].partition_point(|sample| sample.interval <= i);
            if all || self.open.contains(&i) {
                let (interval, parts) = (self.interval(i), self.covers[i].parts);
                let basis = &self.bases[i];
                self.covers[i] = sample(chain, &interval, parts, basis, active, &mut self.samples);
            } else {
                self.samples.extend_from_slice(&self.old[at..at + count]);
            }
            at += count;
        }
        self.follow(chain, from, self.covers.len());
    }

    /// Moves the samples of the intervals `from..to` to where the spline is.
    pub(crate) fn follow(&mut self, chain: &Chain, from: usize, to: usize) {
        let samples = self.samples_of(from, to);
        follow(chain, &mut self.samples, samples, &self.points);
    }

    /// Brings free control points back towards `safe` where samples have no room, until all have; whether they have.
    /// Those elsewhere stay what they are.
    pub(crate) fn retreat(&mut self, safe: &[Axes], free: (usize, usize), from: usize, to: usize) -> bool {
        let samples = self.samples_of(from, to);
        for sample in &mut self.samples[samples.clone()] {
            // What is safe may use more of the tolerance beside the samples of before than samples may.
            let used = sample.ratio(&sample.error(&safe[sample.interval..sample.interval + 4]));
            if used > 1.0 - 2.0 * MIN_DISTANCE {
                let most = sample.tolerance * sample.tolerance;
                let wider = sample.radius2 * used / (1.0 - 2.0 * MIN_DISTANCE);
                sample.radius2 = wider.min(most).max(sample.radius2);
            }
        }
        for _ in 0..RETREATS {
            self.open.clear();
            for sample in &self.samples[samples.clone()] {
                let i = sample.interval;
                let room = 1.0 - sample.ratio(&sample.error(&self.points[i..i + 4]));
                if !(room >= MIN_DISTANCE) && self.open.last() != Some(&i) {
                    self.open.push(i);
                }
            }
            if self.open.is_empty() {
                return true;
            }
            self.relax_toward(safe, free, RETREAT);
        }
        false
    }

    /// Forgets the first intervals.
    pub(crate) fn forget(&mut self, intervals: usize) {
        self.knots.drain(..intervals);
        self.points.drain(..intervals);
        self.bases.drain(..intervals);
        self.covers.drain(..intervals);
        let behind = self.samples.partition_point(|sample| sample.interval < intervals);
        self.samples.drain(..behind);
        for sample in &mut self.samples {
            sample.interval -= intervals;
        }
        self.settled -= intervals;
        self.fixed -= intervals;
    }
}

/// The next interval's width: the spacing at its middle.
fn step(chain: &Chain, u: f64, near: &mut usize) -> f64 {
    let at = |u: f64, near: &mut usize| {
        *near = chain.find_near(u, *near);
        let Some(link) = chain.get(*near) else {
            return 1.0;
        };
        let at_end = chain
            .get(*near + 1)
            .map_or(chain.end_spacing, |next| next.spacing);
        spacing::within(link, at_end, u)
    };
    let mut step = at(u, near);
    for _ in 0..2 {
        step = at(u + 0.5 * step, near);
    }
    step
}

/// Asks for smaller spacing about an interval.
fn shrink(chain: &mut Chain, u: f64, width: f64) {
    let number = chain.find(u);
    if let Some(link) = chain.get_mut(number)
        && !link.straight
    {
        link.inner_spacing = link.inner_spacing.min(0.7 * width);
    }
    for joint in [number, number + 1] {
        if let Some(link) = chain.get_mut(joint) {
            link.spacing = (0.8 * link.spacing).min(0.7 * width);
        }
        spread(chain, joint);
    }
}

/// Carries the bound of a joint's spacing to both sides.
pub(crate) fn spread(chain: &mut Chain, number: usize) {
    let Some(&link) = chain.get(number) else {
        return;
    };
    let (mut spacing, mut u) = (link.spacing, link.from);
    let mut at = number;
    while at > chain.first() {
        at -= 1;
        let Some(link) = chain.get_mut(at) else {
            break;
        };
        spacing += GROWTH * (u - link.from);
        u = link.from;
        if link.spacing <= spacing {
            break;
        }
        link.spacing = spacing;
    }
    let (mut spacing, mut u) = (link.spacing, link.from);
    let mut at = number + 1;
    while let Some(link) = chain.get_mut(at) {
        spacing += GROWTH * (link.from - u);
        u = link.from;
        if link.spacing <= spacing {
            break;
        }
        link.spacing = spacing;
        at += 1;
    }
}

/// The control points that a clamp prescribes, from the end inwards, and their number; `h1`, `h2` are the widths of
/// the intervals from the end inwards, `sign` -1 at a zone's end.
fn clamped(clamp: &EndCondition, h1: f64, h2: f64, sign: f64) -> ([Axes; 3], usize) {
    match clamp {
        EndCondition::Place(place) => ([*place; 3], 1),
        EndCondition::Jet(jet) => {
            let first = jet.first * sign;
            let second = first + jet.second * (0.5 * h1);
            let c1 = jet.position + first * (h1 / 3.0);
            let c2 = c1 + second * ((h1 + h2) / 3.0);
            ([jet.position, c1, c2], 3)
        }
    }
}

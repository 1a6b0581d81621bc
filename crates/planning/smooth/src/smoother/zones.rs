//! A zone from its first joint to its end: its extent, and its intervals as they become final.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Curve, Jet, ParamCurve, Spline};

use super::feed_boundary::FeedBoundary;
use super::{EXTENT, Ending, MIN_LENGTH, Smoother, State, release};
use crate::chain::Chain;
use crate::spacing::{self, GROWTH};
use crate::tube::within_tolerance;
use crate::zone::{BATCH, EndCondition, ExtendResult, spread};
use crate::zone_solver::{Context, WINDOW};
use crate::{Output, PathSegment};

/// Minimum excess over the travel that counts as outside, mm or degrees.
const MIN_EXCESS: f64 = 5e-7;
/// Maximum number of intervals of a zone from joint to joint; a few hundred are usual.
const MAX_INTERVALS: usize = 2000;

impl Smoother {
    /// The end of the zone, as far as known; also the last joint known to be in it.
    pub(super) fn zone_end(
        &mut self,
        joint: usize,
        ending: Option<Ending>,
    ) -> (usize, Option<(f64, EndCondition)>) {
        let complete = ending.is_some();
        let mut joint = joint;
        loop {
            let (Some(&segment), Some(extent)) = (self.chain.get(joint), self.extent(joint, complete)) else {
                return (joint, None);
            };
            let leave = segment.from + extent;
            let gap = 2.0 * (segment.spacing + GROWTH * extent);
            if let Some(next) = self.smoothed(joint + 1) {
                let (Some(&following), Some(before)) = (self.chain.get(next), self.extent(next, complete))
                else {
                    return (joint, None);
                };
                if following.from - before > leave + gap {
                    return (joint, Some((leave, EndCondition::Jet(self.jet(leave)))));
                }
                joint = next;
                continue;
            }
            let end = self.chain.end();
            if let Some(ending) = ending {
                if end > leave + gap {
                    return (joint, Some((leave, EndCondition::Jet(self.jet(leave)))));
                }
                let run = end - segment.from;
                let end_condition = if ending == Ending::Rest && run < 4.0 * segment.tolerance {
                    EndCondition::Position(self.end_jet().position)
                } else {
                    self.chain.end_spacing = 0.5 * run;
                    self.spread_from_end();
                    EndCondition::Jet(self.end_jet())
                };
                return (joint, Some((end, end_condition)));
            }
            let max = EXTENT * spacing::max_spacing(segment.tolerance);
            if end > leave + gap + max {
                return (joint, Some((leave, EndCondition::Jet(self.jet(leave)))));
            }
            return (joint, None);
        }
    }

    fn end_jet(&self) -> Jet {
        let number = self.chain.next().wrapping_sub(1);
        match self.chain.get(number) {
            Some(segment) => segment.curve.jet(segment.curve.domain()),
            None => Jet::at_rest(self.chain.position(self.chain.end())),
        }
    }

    fn spread_from_end(&mut self) {
        let number = self.chain.next().wrapping_sub(1);
        let bound = self.chain.end_spacing;
        if let Some(segment) = self.chain.get_mut(number) {
            segment.spacing = segment.spacing.min(bound + GROWTH * (segment.to - segment.from));
            spread(&mut self.chain, number);
        }
    }

    pub(super) fn advance_zone(
        &mut self,
        start: EndCondition,
        joint: usize,
        end: Option<(f64, EndCondition)>,
        ending: Option<Ending>,
        out: &mut Vec<Output>,
    ) -> bool {
        let (joint, end) = match end {
            Some(end) => (joint, Some(end)),
            None => self.zone_end(joint, ending),
        };
        self.state = State::BlendZone { start, joint, end };
        if self.spent.1 != joint {
            self.spent = (0, joint);
        }
        loop {
            let ready = self.zone.complete || self.zone.intervals() >= self.zone.fixed + WINDOW;
            if !ready {
                let mut reach = self.reach(ending.is_some());
                if end.is_none() {
                    // Knots must fit where the zone may end.
                    let leave = self
                        .chain
                        .get(joint)
                        .map_or(reach, |segment| segment.from + EXTENT * segment.spacing);
                    reach = reach.min(leave);
                }
                match self
                    .zone
                    .extend(&mut self.chain, &start, end, reach, &self.active)
                {
                    ExtendResult::Batch | ExtendResult::End if self.spent.0 > MAX_INTERVALS => {
                        self.fall_back(self.zone.knot(self.zone.intervals()), out);
                        return true;
                    }
                    ExtendResult::Batch | ExtendResult::End => {
                        self.spent.0 += BATCH;
                        continue;
                    }
                    ExtendResult::Wait => return false,
                    ExtendResult::Failed { until } => {
                        self.fall_back(until, out);
                        return true;
                    }
                }
            }
            let rests = (
                if self.departure.moving {
                    f64::NEG_INFINITY
                } else {
                    self.kept
                },
                if self.at_end {
                    self.chain.end()
                } else {
                    f64::INFINITY
                },
            );
            let context = Context {
                chain: &self.chain,
                scales: &self.scales,
                rests,
                measured: &self.active,
                limits: &self.settings.limits,
            };
            self.finder.optimize(&mut self.zone, &context);
            if let Some(until) = self.output_final(end.map(|(_, end_condition)| end_condition), out) {
                self.fall_back(until, out);
                return true;
            }
            if self.zone.complete && self.zone.intervals() == 0 {
                self.offset_point = None;
                self.state = State::Exact;
                return true;
            }
        }
    }

    /// The end of the feed of a segment by the parameter, at most `to`.
    fn feed_end(&self, number: usize, to: f64) -> f64 {
        let mut number = number;
        let Some(first) = self.chain.get(number) else {
            return to;
        };
        let mut end = first.to;
        while end < to {
            number += 1;
            match self.chain.get(number) {
                Some(next) if next.has_feed_of(first) => end = next.to,
                Some(_) => break,
                None => return to,
            }
        }
        end.min(to)
    }

    /// Outputs the intervals that are final. If one of them is invalid, outputs those before it and returns
    /// its end.
    fn output_final(&mut self, end: Option<EndCondition>, out: &mut Vec<Output>) -> Option<f64> {
        let count = self.zone.intervals();
        let done = self.zone.fixed.saturating_sub(3).min(count);
        let (mut gone, mut bad) = (0, None);
        for i in 0..done {
            let zone = &self.zone;
            let jet = zone.jet(i);
            let behind = match end {
                _ if i + 1 < count => zone.jet(i + 1).position,
                Some(EndCondition::Jet(jet)) => jet.position,
                Some(EndCondition::Position(position)) => position,
                None => break,
            };
            let (from, to) = (zone.knot(i), zone.knot(i + 1));
            let spline = Spline::new(&jet, behind, to - from).ok();
            let Some(spline) = spline.filter(|spline| {
                within_tolerance(&self.chain, (from, to), spline)
                    && is_in_travel(spline, &self.chain, from, &self.settings.limits)
            }) else {
                bad = Some(to);
                break;
            };
            gone = i + 1;
            self.output_interval(&spline, (from, to), out);
            self.cursor = to;
            self.offset_point = Some(behind);
            release(&mut self.marks, self.base + to, out);
        }
        let zone = &self.zone;
        for sample in zone.samples.iter().take_while(|sample| sample.interval < gone) {
            let error = sample.error(&zone.points[sample.interval..sample.interval + 4]);
            let used = sample.ratio(&error).sqrt() * sample.radius2.sqrt();
            self.tally.deviation = self.tally.deviation.max(used);
        }
        self.zone.forget(gone);
        bad
    }

    /// Outputs a final interval, divided where the feed changes.
    fn output_interval(&mut self, spline: &Spline, (from, to): (f64, f64), out: &mut Vec<Output>) {
        let mut at = from;
        loop {
            // Joints at which the feed does not change need not be examined again.
            while let (Some(here), Some(next)) = (
                self.chain.get(self.feed_segment),
                self.chain.get(self.feed_segment + 1),
            ) && next.from <= at
                && next.has_feed_of(here)
            {
                self.feed_segment += 1;
            }
            let boundary = FeedBoundary::next(&self.chain, self.feed_segment, to);
            let passed = boundary.and_then(|boundary| boundary.passed(spline, (from, to), at));
            let by_parameter = self.chain.find(at + MIN_LENGTH);
            let Some(segment) = self.chain.get(by_parameter) else {
                break;
            };
            let stop = self.feed_end(by_parameter, to).min(passed.unwrap_or(to));
            let stop = if stop < to - MIN_LENGTH { stop } else { to };
            let slower = self
                .chain
                .get(self.feed_segment)
                .filter(|nearest| nearest.metric == segment.metric && nearest.feed_mm_s < segment.feed_mm_s);
            let segment = slower.unwrap_or(segment);
            if stop - at > MIN_LENGTH {
                out.push(Output::Segment(PathSegment {
                    curve: Curve::Spline(*spline),
                    from: at - from,
                    length: stop - at,
                    feed_mm_s: segment.feed_mm_s,
                    metric: segment.metric,
                    rapid: segment.rapid,
                    blend: true,
                    joint: std::mem::take(&mut self.departure.joint),
                }));
                at = stop;
                release(&mut self.marks, self.base + at, out);
            }
            if let Some(boundary) = boundary
                && passed.is_some_and(|passed| passed <= stop)
            {
                self.feed_segment = boundary.segment;
            } else if at >= to - MIN_LENGTH {
                break;
            }
        }
    }
}

/// Whether a piece stays within the travel, except for axes whose program does not.
fn is_in_travel(piece: &Spline, chain: &Chain, from: f64, limits: &Limits) -> bool {
    let (low, high) = piece.bounds(0.0, piece.domain());
    let programmed = chain.position(from);
    (0..AXES).filter(|&i| limits.present[i]).all(|i| {
        let (min, max) = (
            limits.travel_min[i] - MIN_EXCESS,
            limits.travel_max[i] + MIN_EXCESS,
        );
        !(min..=max).contains(&programmed[i]) || (low[i] >= min && high[i] <= max)
    })
}

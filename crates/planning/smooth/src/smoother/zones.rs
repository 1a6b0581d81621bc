//! A zone from its first joint to its end: how far it goes, and its intervals as they become final.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Curve, Jet, ParamCurve, Spline};

use super::{EXTENT, Ending, SHORTEST, Smoother, State, release};
use crate::chain::Chain;
use crate::spacing::{self, GROWTH};
use crate::tube::within_tolerance;
use crate::zone::{BATCH, EndCondition, ExtendResult, spread};
use crate::zone_solver::{Scene, WINDOW};
use crate::{Output, Stretch};

/// Beyond the travel by more than this is outside, mm or degrees.
const OUTSIDE: f64 = 5e-7;
/// Intervals that a zone may take from joint to joint; a few hundred are usual.
const MAX_INTERVALS: usize = 2000;

impl Smoother {
    /// Where the zone ends, as far as that is known by now; also the last joint known to be in it.
    pub(super) fn zone_end(
        &mut self,
        joint: usize,
        ending: Option<Ending>,
    ) -> (usize, Option<(f64, EndCondition)>) {
        let complete = ending.is_some();
        let mut joint = joint;
        loop {
            let (Some(&link), Some(extent)) = (self.chain.get(joint), self.extent(joint, complete)) else {
                return (joint, None);
            };
            let leave = link.from + extent;
            let gap = 2.0 * (link.spacing + GROWTH * extent);
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
                let run = end - link.from;
                let clamp = if ending == Ending::Rest && run < 4.0 * link.tolerance {
                    EndCondition::Place(self.end_jet().position)
                } else {
                    self.chain.end_spacing = 0.5 * run;
                    self.spread_from_end();
                    EndCondition::Jet(self.end_jet())
                };
                return (joint, Some((end, clamp)));
            }
            let most = EXTENT * spacing::most(link.tolerance);
            if end > leave + gap + most {
                return (joint, Some((leave, EndCondition::Jet(self.jet(leave)))));
            }
            return (joint, None);
        }
    }

    fn end_jet(&self) -> Jet {
        let number = self.chain.next().wrapping_sub(1);
        match self.chain.get(number) {
            Some(link) => link.curve.jet(link.curve.domain()),
            None => Jet::at_rest(self.chain.position(self.chain.end())),
        }
    }

    fn spread_from_end(&mut self) {
        let number = self.chain.next().wrapping_sub(1);
        let bound = self.chain.end_spacing;
        if let Some(link) = self.chain.get_mut(number) {
            link.spacing = link.spacing.min(bound + GROWTH * (link.to - link.from));
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
                    // Where the zone may end, knots have to fit.
                    let leave = self
                        .chain
                        .get(joint)
                        .map_or(reach, |link| link.from + EXTENT * link.spacing);
                    reach = reach.min(leave);
                }
                match self.zone.lay(&mut self.chain, &start, end, reach, &self.active) {
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
                if self.moving { f64::NEG_INFINITY } else { self.kept },
                if self.at_end {
                    self.chain.end()
                } else {
                    f64::INFINITY
                },
            );
            let scene = Scene {
                chain: &self.chain,
                scales: &self.scales,
                rests,
                measured: &self.active,
                limits: &self.settings.limits,
            };
            self.finder.find(&mut self.zone, &scene);
            if let Some(until) = self.emit(end.map(|(_, clamp)| clamp), out) {
                self.fall_back(until, out);
                return true;
            }
            if self.zone.complete && self.zone.intervals() == 0 {
                self.off = None;
                self.state = State::Exact;
                return true;
            }
        }
    }

    /// Brings out the intervals that are final. If one of them is not what it should be, those before it come out, and
    /// it returns where the bad one ends.
    fn emit(&mut self, end: Option<EndCondition>, out: &mut Vec<Output>) -> Option<f64> {
        let zone = &self.zone;
        let count = zone.intervals();
        let done = zone.fixed.saturating_sub(3).min(count);
        let (mut gone, mut bad) = (0, None);
        for i in 0..done {
            let jet = zone.jet(i);
            let behind = match end {
                _ if i + 1 < count => zone.jet(i + 1).position,
                Some(EndCondition::Jet(jet)) => jet.position,
                Some(EndCondition::Place(place)) => place,
                None => break,
            };
            let (from, to) = (zone.knot(i), zone.knot(i + 1));
            let spline = Spline::new(&jet, behind, to - from).ok();
            let Some(spline) = spline.filter(|spline| {
                within_tolerance(&self.chain, (from, to), spline)
                    && inside(spline, &self.chain, from, &self.settings.limits)
            }) else {
                bad = Some(to);
                break;
            };
            gone = i + 1;
            let curve = Curve::Spline(spline);
            let mut number = self.chain.find(from);
            let mut at = from;
            while let Some(link) = self.chain.get(number) {
                let mut stop = link.to;
                number += 1;
                while stop < to
                    && let Some(next) = self.chain.get(number)
                    && (next.feed, next.rapid) == (link.feed, link.rapid)
                {
                    stop = next.to;
                    number += 1;
                }
                let last = stop >= to - SHORTEST;
                let stop = if last { to } else { stop };
                if stop - at > SHORTEST {
                    out.push(Output::Stretch(Stretch {
                        curve,
                        from: at - from,
                        length: stop - at,
                        feed: link.feed,
                        rapid: link.rapid,
                        blend: true,
                        joint: std::mem::take(&mut self.joint),
                    }));
                    at = stop;
                    release(&mut self.marks, self.base + at, out);
                }
                if last {
                    break;
                }
            }
            self.cursor = to;
            self.off = Some(behind);
            release(&mut self.marks, self.base + to, out);
        }
        for sample in zone.samples.iter().take_while(|sample| sample.interval < gone) {
            let error = sample.error(&zone.points[sample.interval..sample.interval + 4]);
            let used = sample.ratio(&error).sqrt() * sample.radius2.sqrt();
            self.deviation = self.deviation.max(used);
        }
        self.zone.forget(gone);
        bad
    }
}

/// Whether a piece stays in the travel, but for axes whose program does not.
fn inside(piece: &Spline, chain: &Chain, from: f64, limits: &Limits) -> bool {
    let (low, high) = piece.bounds(0.0, piece.domain());
    let programmed = chain.position(from);
    (0..AXES).filter(|&i| limits.present[i]).all(|i| {
        let (least, most) = (limits.travel_min[i] - OUTSIDE, limits.travel_max[i] + OUTSIDE);
        !(least..=most).contains(&programmed[i]) || (low[i] >= least && high[i] <= most)
    })
}

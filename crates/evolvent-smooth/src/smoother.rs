//! Blocks in, path out.

use std::collections::VecDeque;
use std::ops::Range;

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, Curve, Jet, ParamCurve, Spline};

use crate::chain::{Chain, Link, distance};
use crate::finder::{Finder, Scene, WINDOW};
use crate::joint::{JointKind, judge};
use crate::spacing::{self, GROWTH};
use crate::tube::{keeps, sight};
use crate::weights::Scales;
use crate::zone::{BATCH, Clamp, Laid, Zone, spread};
use crate::{Block, Mark, Output, Settings, Stretch, Tolerance};

/// How far a zone reaches to each side of a joint, in spacings there: where the spacing has grown for 20 knots.
const EXTENT: f64 = 150.0;
/// Stretches shorter than this are rounding, parameter units.
const SHORTEST: f64 = 1e-12;
/// Beyond the travel by more than this is outside, mm or degrees.
const OUTSIDE: f64 = 5e-7;
/// Intervals that a zone may take from joint to joint; a few hundred are usual.
const MOST_INTERVALS: usize = 2000;
/// Halvings of the straight that leads back to the program.
const HALVINGS: usize = 40;

/// Whether the path is on the programmed curve or in a zone that becomes a spline.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one, and it must not allocate")]
enum State {
    Exact,
    Zone {
        start: Clamp,
        /// Number of the last joint that is known to belong to it.
        joint: usize,
        end: Option<(f64, Clamp)>,
    },
}

/// How a section of the path ends.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Ending {
    /// At rest.
    Rest,
    /// At a joint that is kept, or smooth.
    Moving,
}

/// Turns programmed blocks into the path that is driven.
///
/// Nothing here may be called by the real-time cycle. After the first few thousand blocks no memory is allocated.
#[derive(Debug)]
pub struct Smoother {
    settings: Settings,
    scales: Scales,
    /// The path since the last place at which it is kept: the section.
    chain: Chain,
    state: State,
    zone: Zone,
    finder: Finder,
    last: Option<Block>,
    marks: VecDeque<Mark>,
    /// Parameter of the section's start since the smoother was made, and what has come out of the section.
    base: f64,
    cursor: f64,
    /// The next joint whose spacing is to be found, the last spacing, and the next joint to be eased.
    unripe: usize,
    guess: f64,
    /// Links of which none is to be eased.
    plain: Range<usize>,
    /// Up to where joints of the section are kept: its start, or a joint that could not be eased.
    kept: f64,
    /// Where the zone has come to, if that is not the programmed point.
    off: Option<Axes>,
    /// Intervals since the zone's last joint became known, and that joint.
    spent: (usize, usize),
    /// Whether the path leaves the last kept place in motion, and whether that is a joint.
    moving: bool,
    joint: bool,
    active: [bool; AXES],
    /// How far samples look ahead in this section.
    sight: f64,
    deviation: f64,
    failures: u64,
    at_end: bool,
}

impl Smoother {
    /// At rest at the start of the first block.
    #[must_use]
    pub fn new(settings: Settings) -> Self {
        let mut chain = Chain::default();
        chain.clear();
        Self {
            settings,
            scales: Scales::new(&settings.limits),
            chain,
            state: State::Exact,
            zone: Zone::default(),
            finder: Finder::default(),
            last: None,
            marks: VecDeque::new(),
            base: 0.0,
            cursor: 0.0,
            unripe: 1,
            guess: 0.01,
            plain: 0..0,
            kept: 0.0,
            off: None,
            spent: (0, 0),
            moving: false,
            joint: false,
            active: [false; AXES],
            sight: 0.0,
            deviation: 0.0,
            failures: 0,
            at_end: false,
        }
    }

    /// Appends a block; whatever of the path is settled by it comes out.
    pub fn push(&mut self, block: &Block, out: &mut Vec<Output>) {
        let length = block.curve.domain();
        let mark = |end: f64| Mark {
            end,
            line: block.line,
            block: block.block,
            rapid: block.rapid,
        };
        if !(length > 0.0 && length.is_finite()) {
            self.marks.push_back(mark(self.base + self.chain.end()));
            self.release_marks(out);
            return;
        }
        let mut link = Link::new(block, self.chain.end());
        if let Some(last) = self.last {
            let (end, start) = (last.curve.jet(last.curve.domain()), block.curve.jet(0.0));
            let (limits, joint_time) = (&self.settings.limits, self.settings.joint_time_s);
            let kind = judge(&end, &start, limits, joint_time);
            let free = last.tolerance.mm() > 0.0 && block.tolerance.mm() > 0.0;
            let either = last.tolerance.mm() > 0.0 || block.tolerance.mm() > 0.0;
            match kind {
                _ if last.tolerance == Tolerance::Stop => self.section(Ending::Rest, Some(0.0), out),
                JointKind::Smooth if free => {}
                JointKind::Smooth if either => self.section(Ending::Moving, None, out),
                JointKind::Smooth => {}
                JointKind::Step { speed } if free => {
                    link.eased = true;
                    link.exact_speed = speed;
                    let turn = end.first.fixed_rows::<3>(0).dot(&start.first.fixed_rows::<3>(0));
                    link.sharp = turn < -0.5;
                }
                JointKind::Step { speed } => {
                    let ending = if speed > 0.0 { Ending::Moving } else { Ending::Rest };
                    self.section(ending, Some(speed), out);
                }
            }
            let from = self.chain.end();
            link.to += from - link.from;
            link.from = from;
        }
        link.inner_spacing = spacing::inside(&link);
        self.sight = self.sight.max(sight(link.tolerance));
        if link.tolerance > 0.0 {
            let before = self.active;
            let (first, ..) = block.curve.derivative_bounds(0.0, length);
            for i in 0..AXES {
                self.active[i] |= first[i] != 0.0;
            }
            if self.active != before && matches!(self.state, State::Zone { .. }) {
                // What is laid but not final may now move in these axes too.
                self.zone.measure(&self.chain, &self.active);
            }
        }
        self.chain.push(link);
        self.last = Some(*block);
        self.marks.push_back(mark(self.base + self.chain.end()));
        self.advance(None, out);
    }

    /// The path comes to rest at the end of what was pushed: all of it comes out.
    pub fn rest(&mut self, out: &mut Vec<Output>) {
        if self.last.is_some() {
            self.section(Ending::Rest, Some(0.0), out);
            self.last = None;
        }
        self.release_marks(out);
    }

    /// Largest distance of the path that came out from the programmed one, mm (or degrees of a rotary axis).
    #[must_use]
    pub fn deviation_mm(&self) -> f64 {
        self.deviation
    }

    /// How often no smooth path was found, and joints were passed as programmed instead.
    #[must_use]
    pub fn failures(&self) -> u64 {
        self.failures
    }

    /// Brings out all of the section and begins the next.
    fn section(&mut self, ending: Ending, cap: Option<f64>, out: &mut Vec<Output>) {
        self.at_end = ending == Ending::Rest;
        self.advance(Some(ending), out);
        if self.chain.end() - self.cursor > SHORTEST {
            self.fall_back(f64::INFINITY, out);
            self.advance(Some(ending), out);
        }
        self.at_end = false;
        if let Some(speed) = cap {
            out.push(Output::Cap { speed });
        }
        self.base += self.chain.end();
        self.chain.clear();
        self.state = State::Exact;
        self.cursor = 0.0;
        self.unripe = 1;
        self.plain = 0..0;
        self.kept = 0.0;
        self.off = None;
        self.moving = ending == Ending::Moving;
        self.joint = self.moving && cap.is_some();
        self.active = [false; AXES];
        self.sight = 0.0;
    }

    fn advance(&mut self, ending: Option<Ending>, out: &mut Vec<Output>) {
        self.ripen(ending.is_some());
        loop {
            let more = match self.state {
                State::Exact => self.advance_exact(ending, out),
                State::Zone { start, joint, end } => self.advance_zone(start, joint, end, ending, out),
            };
            if !more {
                break;
            }
        }
        let keep = 2.0
            * self
                .chain
                .get(self.chain.first())
                .map_or(0.0, |link| spacing::most(link.tolerance));
        // A zone's last joint tells where the zone ends.
        let needed = match self.state {
            State::Zone { joint, .. } => self.chain.get(joint).map_or(self.cursor, |link| link.from),
            State::Exact => self.cursor,
        };
        self.chain.forget(needed.min(self.cursor) - keep);
    }

    /// Finds the spacing at the joints for which enough of the path is known.
    fn ripen(&mut self, complete: bool) {
        while let Some(link) = self.chain.get(self.unripe) {
            let before = self.unripe.checked_sub(1).and_then(|n| self.chain.get(n));
            let inherited = before.map_or(f64::INFINITY, |b| b.spacing + GROWTH * (link.from - b.from));
            let own = if link.eased {
                let Some(own) = spacing::at_joint(&self.chain, self.unripe, self.guess, complete) else {
                    return;
                };
                self.guess = 2.0 * own;
                own
            } else {
                f64::INFINITY
            };
            if let Some(link) = self.chain.get_mut(self.unripe) {
                link.spacing = link.spacing.min(own).min(inherited);
            }
            spread(&mut self.chain, self.unripe);
            self.unripe += 1;
        }
    }

    /// Up to where the spacing is settled.
    fn reach(&self, complete: bool) -> f64 {
        match self.chain.get(self.unripe) {
            Some(link) => link.from,
            None if complete => return f64::INFINITY,
            None => self.chain.end(),
        }
        .min(self.chain.end() - self.sight)
    }

    /// The first joint from `number` on that is eased.
    fn eased(&mut self, number: usize) -> Option<usize> {
        let from = number.max(self.chain.first());
        if !self.plain.contains(&from) {
            self.plain = from..from;
        }
        // Only links to come are ever marked, so what was looked through need not be again.
        while let Some(link) = self.chain.get(self.plain.end) {
            if link.eased {
                return Some(self.plain.end);
            }
            self.plain.end += 1;
        }
        None
    }

    /// How far a joint's zone reaches, once its spacing is settled.
    fn extent(&self, number: usize, complete: bool) -> Option<f64> {
        let link = self.chain.get(number)?;
        let settled =
            number < self.unripe && (complete || link.from + link.spacing / GROWTH <= self.reach(complete));
        settled.then_some(EXTENT * link.spacing)
    }

    fn advance_exact(&mut self, ending: Option<Ending>, out: &mut Vec<Output>) -> bool {
        let first = self.chain.find(self.cursor) + 1;
        let Some(joint) = self.eased(first) else {
            let end = self.chain.end();
            let most = self
                .chain
                .get(self.chain.next().wrapping_sub(1))
                .map_or(0.0, |link| EXTENT * spacing::most(link.tolerance));
            let to = if ending.is_some() { end } else { end - most };
            self.exact(to, out);
            return false;
        };
        let Some(extent) = self.extent(joint, ending.is_some()) else {
            return false;
        };
        let Some(&link) = self.chain.get(joint) else {
            return false;
        };
        let from = (link.from - extent).max(self.cursor).max(self.kept);
        self.exact(from, out);
        // A curve shorter than rounding may lie between.
        self.cursor = from;
        let run = link.from - self.cursor;
        let at_start = self.cursor <= self.kept;
        let start = if at_start && !self.moving && run < 4.0 * link.tolerance {
            Clamp::Place(self.chain.position(self.cursor))
        } else {
            if at_start {
                let number = self.chain.find(self.cursor);
                if let Some(link) = self.chain.get_mut(number) {
                    link.spacing = link.spacing.min(0.5 * run);
                }
                spread(&mut self.chain, number);
            }
            Clamp::Jet(self.jet(self.cursor))
        };
        self.zone.begin(self.cursor);
        self.spent = (0, joint);
        self.state = State::Zone {
            start,
            joint,
            end: None,
        };
        true
    }

    fn jet(&self, u: f64) -> Jet {
        match self.chain.get(self.chain.find(u)) {
            Some(link) => link.jet(u),
            None => Jet::at_rest(self.chain.position(u)),
        }
    }

    /// Where the zone ends, as far as that is known by now; also the last joint known to be in it.
    fn zone_end(&mut self, joint: usize, ending: Option<Ending>) -> (usize, Option<(f64, Clamp)>) {
        let complete = ending.is_some();
        let mut joint = joint;
        loop {
            let (Some(&link), Some(extent)) = (self.chain.get(joint), self.extent(joint, complete)) else {
                return (joint, None);
            };
            let leave = link.from + extent;
            let gap = 2.0 * (link.spacing + GROWTH * extent);
            if let Some(next) = self.eased(joint + 1) {
                let (Some(&following), Some(before)) = (self.chain.get(next), self.extent(next, complete))
                else {
                    return (joint, None);
                };
                if following.from - before > leave + gap {
                    return (joint, Some((leave, Clamp::Jet(self.jet(leave)))));
                }
                joint = next;
                continue;
            }
            let end = self.chain.end();
            if let Some(ending) = ending {
                if end > leave + gap {
                    return (joint, Some((leave, Clamp::Jet(self.jet(leave)))));
                }
                let run = end - link.from;
                let clamp = if ending == Ending::Rest && run < 4.0 * link.tolerance {
                    Clamp::Place(self.end_jet().position)
                } else {
                    self.chain.end_spacing = 0.5 * run;
                    self.spread_from_end();
                    Clamp::Jet(self.end_jet())
                };
                return (joint, Some((end, clamp)));
            }
            let most = EXTENT * spacing::most(link.tolerance);
            if end > leave + gap + most {
                return (joint, Some((leave, Clamp::Jet(self.jet(leave)))));
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

    fn advance_zone(
        &mut self,
        start: Clamp,
        joint: usize,
        end: Option<(f64, Clamp)>,
        ending: Option<Ending>,
        out: &mut Vec<Output>,
    ) -> bool {
        let (joint, end) = match end {
            Some(end) => (joint, Some(end)),
            None => self.zone_end(joint, ending),
        };
        self.state = State::Zone { start, joint, end };
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
                    Laid::Batch | Laid::End if self.spent.0 > MOST_INTERVALS => {
                        self.fall_back(self.zone.knot(self.zone.intervals()), out);
                        return true;
                    }
                    Laid::Batch | Laid::End => {
                        self.spent.0 += BATCH;
                        continue;
                    }
                    Laid::Wait => return false,
                    Laid::Failed { until } => {
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
    fn emit(&mut self, end: Option<Clamp>, out: &mut Vec<Output>) -> Option<f64> {
        let zone = &self.zone;
        let count = zone.intervals();
        let done = zone.fixed.saturating_sub(3).min(count);
        let (mut gone, mut bad) = (0, None);
        for i in 0..done {
            let jet = zone.jet(i);
            let behind = match end {
                _ if i + 1 < count => zone.jet(i + 1).position,
                Some(Clamp::Jet(jet)) => jet.position,
                Some(Clamp::Place(place)) => place,
                None => break,
            };
            let (from, to) = (zone.knot(i), zone.knot(i + 1));
            let spline = Spline::new(&jet, behind, to - from).ok();
            let Some(spline) = spline.filter(|spline| {
                keeps(&self.chain, (from, to), spline)
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

    /// Gives up the zone: comes to rest where the path has come to, returns to the programmed curve, and keeps the joints
    /// up to `until`, and at least one, as they are programmed.
    fn fall_back(&mut self, until: f64, out: &mut Vec<Output>) {
        self.failures += 1;
        self.state = State::Exact;
        if let Some(place) = self.off.take() {
            out.push(Output::Cap { speed: 0.0 });
            self.lead_back(place, out);
            out.push(Output::Cap { speed: 0.0 });
            self.kept = self.cursor;
            self.moving = false;
            self.joint = false;
            // At rest: whatever joint is here has been passed.
            let here = self.chain.find(self.cursor);
            if let Some(link) = self.chain.get_mut(here)
                && link.from >= self.cursor - SHORTEST
            {
                link.kept = link.corner();
                link.eased = false;
            }
        }
        let mut until = until;
        if let Some(joint) = self.eased(self.chain.find(self.cursor) + 1)
            && let Some(link) = self.chain.get(joint)
        {
            until = until.max(link.from);
        }
        let mut number = self.chain.find(self.cursor) + 1;
        while let Some(link) = self.chain.get_mut(number)
            && link.from <= until
        {
            if link.eased {
                link.eased = false;
                link.kept = true;
                link.unsaid = true;
                self.kept = link.from;
            }
            number += 1;
        }
    }

    /// From `place`, within the tolerance of the programmed point, straight back to the programmed curve.
    ///
    /// On a straight all of the way is within the tolerance, as both ends are. On a curve the way strays from it by at
    /// most `b L^2 / 2 s (1 - s)` more than `(1 - s) e`, where `s` is the share of its length `L`, `e` the distance at
    /// its start and `b` a bound of the second derivative: never more than `e` if `b L^2 / 2` is not.
    fn lead_back(&mut self, place: Axes, out: &mut Vec<Output>) {
        let mut number = self.chain.find(self.cursor);
        while let Some(link) = self.chain.get(number)
            && link.to - self.cursor <= SHORTEST
        {
            number += 1;
        }
        let Some(link) = self.chain.get(number) else {
            return;
        };
        let error = distance(&(place - link.position(self.cursor)));
        let mut length = link.to - self.cursor;
        if !link.straight {
            let from = (self.cursor - link.from).max(0.0);
            for _ in 0..HALVINGS {
                let (_, second, _) = link.curve.derivative_bounds(from, from + length);
                let stray = 0.5 * distance(&second) * length * length;
                if stray <= error || error + 0.25 * stray <= link.tolerance {
                    break;
                }
                length *= 0.5;
            }
        } else if length > 4.0 * link.tolerance {
            length = 4.0 * link.tolerance;
        }
        // Where the point that it is within the tolerance of lies on another link, a shorter way may be needed.
        let mut found = None;
        for _ in 0..HALVINGS {
            let to = if length < link.to - self.cursor {
                self.cursor + length
            } else {
                link.to
            };
            let end = if to < link.to {
                link.position(to)
            } else {
                link.curve.end()
            };
            let mut jet = Jet::at_rest(place);
            jet.first = (end - place) / (to - self.cursor);
            // A way of no length is none: then the curve can go on from here.
            let Ok(spline) = Spline::new(&jet, end, to - self.cursor) else {
                break;
            };
            found = Some((spline, to));
            if keeps(&self.chain, (self.cursor, to), &spline) {
                break;
            }
            length *= 0.5;
        }
        let Some((spline, to)) = found else {
            return;
        };
        let length = to - self.cursor;
        out.push(Output::Stretch(Stretch {
            curve: Curve::Spline(spline),
            from: 0.0,
            length,
            feed: link.feed,
            rapid: link.rapid,
            blend: true,
            joint: false,
        }));
        self.cursor = to;
        self.release_marks(out);
    }

    /// Brings out the programmed path up to `to`.
    fn exact(&mut self, to: f64, out: &mut Vec<Output>) {
        let mut number = self.chain.find(self.cursor);
        while let Some(link) = self.chain.get(number) {
            let stop = link.to.min(to);
            if stop - self.cursor > SHORTEST {
                out.push(Output::Stretch(Stretch {
                    curve: link.curve,
                    from: self.cursor - link.from,
                    length: stop - self.cursor,
                    feed: link.feed,
                    rapid: link.rapid,
                    blend: false,
                    joint: std::mem::take(&mut self.joint),
                }));
                self.cursor = stop;
            }
            let end = link.to;
            if end > to {
                break;
            }
            self.release_marks(out);
            number += 1;
            if let Some(next) = self.chain.get_mut(number)
                && std::mem::take(&mut next.unsaid)
            {
                let speed = next.exact_speed;
                out.push(Output::Cap { speed });
                self.moving = speed > 0.0;
                self.joint = self.moving;
            }
            if end >= to {
                break;
            }
        }
        self.release_marks(out);
    }

    /// Brings out the marks of what has come out.
    fn release_marks(&mut self, out: &mut Vec<Output>) {
        release(&mut self.marks, self.base + self.cursor, out);
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

/// Brings out the marks up to `end`.
fn release(marks: &mut VecDeque<Mark>, end: f64, out: &mut Vec<Output>) {
    while let Some(mark) = marks.front()
        && mark.end <= end + SHORTEST
    {
        out.push(Output::Mark(*mark));
        marks.pop_front();
    }
}

#[cfg(test)]
#[path = "../tests/common/mod.rs"]
mod common;

#[cfg(test)]
mod tests {
    use super::common::{Kind, Random, check, equal_limits, limits, program, settings, within};
    use super::{Smoother, State};

    /// Programs of which some zones are given up at random places, as if they had failed.
    #[test]
    fn a_path_whose_zones_are_given_up_anywhere_still_keeps_to_the_tolerance() {
        let mut random = Random(0x5300_0011);
        let mut given_up = 0;
        for case in 0..16 {
            let smallest = random.log(1e-3, 0.3);
            let kind = Kind {
                smallest,
                largest: smallest * random.log(1.0, 300.0),
                curves: case % 2 == 0,
                other_axes: case % 3 == 0,
                mixed: case % 4 == 0,
                flat: false,
            };
            let tolerance = within(random.log(1e-3, 1.0));
            let blocks = program(&mut random, kind, 60, tolerance);
            let machine = if case % 2 == 0 {
                limits(&mut random)
            } else {
                equal_limits(200.0, 2000.0, 50_000.0)
            };
            let (mut smoother, mut out) = (Smoother::new(settings(machine)), Vec::new());
            for block in &blocks {
                smoother.push(block, &mut out);
                if matches!(smoother.state, State::Zone { .. }) && random.unit() < 0.2 {
                    given_up += u64::from(smoother.off.is_some());
                    let until = smoother.cursor + random.log(1e-3, 10.0) * smallest;
                    smoother.fall_back(until, &mut out);
                }
            }
            smoother.rest(&mut out);
            check(&blocks, &out, 5, &format!("case {case} {tolerance:?}"));
        }
        assert!(given_up > 8, "{given_up}");
    }
}

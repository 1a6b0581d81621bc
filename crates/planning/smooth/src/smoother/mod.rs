//! Blocks in, path out.

mod fallback;
mod zones;

use std::collections::VecDeque;
use std::ops::Range;

use evolvent_path::{AXES, Axes, Jet, JointKind, JointLimits, classify_joint};

use crate::chain::{Chain, ProgramSegment};
use crate::spacing::{self, GROWTH};
use crate::tube::sight;
use crate::weights::Scales;
use crate::zone::{BlendZone, EndCondition, spread};
use crate::zone_solver::ZoneSolver;
use crate::{Block, Mark, Output, Settings, Stretch, Tolerance};

/// How far a zone reaches to each side of a joint, in spacings there: where the spacing has grown for 20 knots.
const EXTENT: f64 = 150.0;
/// Stretches shorter than this are rounding, parameter units.
const SHORTEST: f64 = 1e-12;

/// Whether the path is on the programmed curve or in a zone that becomes a spline.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one, and it must not allocate")]
enum State {
    Exact,
    BlendZone {
        start: EndCondition,
        /// Number of the last joint that is known to belong to it.
        joint: usize,
        end: Option<(f64, EndCondition)>,
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
    zone: BlendZone,
    finder: ZoneSolver,
    last: Option<Block>,
    marks: VecDeque<Mark>,
    /// Parameter of the section's start since the smoother was made, and what has come out of the section.
    base: f64,
    cursor: f64,
    /// The next joint whose spacing is to be found, the last spacing, and the next joint to be eased.
    spacing_pending: usize,
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
            zone: BlendZone::default(),
            finder: ZoneSolver::default(),
            last: None,
            marks: VecDeque::new(),
            base: 0.0,
            cursor: 0.0,
            spacing_pending: 1,
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
        let mut link = ProgramSegment::new(block, self.chain.end());
        if let Some(last) = self.last {
            let (end, start) = (last.curve.jet(last.curve.domain()), block.curve.jet(0.0));
            let joint_limits = JointLimits {
                present: self.settings.limits.present,
                jerk: self.settings.limits.jerk,
                joint_time_s: self.settings.joint_time_s,
            };
            let kind = classify_joint(&end, &start, &joint_limits);
            let free = last.tolerance.mm() > 0.0 && block.tolerance.mm() > 0.0;
            let either = last.tolerance.mm() > 0.0 || block.tolerance.mm() > 0.0;
            match kind {
                _ if last.tolerance == Tolerance::Stop => self.section(Ending::Rest, Some(0.0), out),
                JointKind::Smooth if free => {}
                JointKind::Smooth if either => self.section(Ending::Moving, None, out),
                JointKind::Smooth => {}
                JointKind::Step { .. } | JointKind::Corner if free => {
                    link.smoothed = true;
                    link.exact_speed = kind.max_speed();
                    let turn = end.first.fixed_rows::<3>(0).dot(&start.first.fixed_rows::<3>(0));
                    link.sharp = turn < -0.5;
                }
                JointKind::Step { max_speed } => self.section(Ending::Moving, Some(max_speed), out),
                JointKind::Corner => self.section(Ending::Rest, Some(0.0), out),
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
            if self.active != before && matches!(self.state, State::BlendZone { .. }) {
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
        self.spacing_pending = 1;
        self.plain = 0..0;
        self.kept = 0.0;
        self.off = None;
        self.moving = ending == Ending::Moving;
        self.joint = self.moving && cap.is_some();
        self.active = [false; AXES];
        self.sight = 0.0;
    }

    fn advance(&mut self, ending: Option<Ending>, out: &mut Vec<Output>) {
        self.resolve_spacing(ending.is_some());
        loop {
            let more = match self.state {
                State::Exact => self.advance_exact(ending, out),
                State::BlendZone { start, joint, end } => self.advance_zone(start, joint, end, ending, out),
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
            State::BlendZone { joint, .. } => self.chain.get(joint).map_or(self.cursor, |link| link.from),
            State::Exact => self.cursor,
        };
        self.chain.forget(needed.min(self.cursor) - keep);
    }

    /// Finds the spacing at the joints for which enough of the path is known.
    fn resolve_spacing(&mut self, complete: bool) {
        while let Some(link) = self.chain.get(self.spacing_pending) {
            let before = self
                .spacing_pending
                .checked_sub(1)
                .and_then(|n| self.chain.get(n));
            let inherited = before.map_or(f64::INFINITY, |b| b.spacing + GROWTH * (link.from - b.from));
            let own = if link.smoothed {
                let Some(own) = spacing::at_joint(&self.chain, self.spacing_pending, self.guess, complete)
                else {
                    return;
                };
                self.guess = 2.0 * own;
                own
            } else {
                f64::INFINITY
            };
            if let Some(link) = self.chain.get_mut(self.spacing_pending) {
                link.spacing = link.spacing.min(own).min(inherited);
            }
            spread(&mut self.chain, self.spacing_pending);
            self.spacing_pending += 1;
        }
    }

    /// Up to where the spacing is settled.
    fn reach(&self, complete: bool) -> f64 {
        match self.chain.get(self.spacing_pending) {
            Some(link) => link.from,
            None if complete => return f64::INFINITY,
            None => self.chain.end(),
        }
        .min(self.chain.end() - self.sight)
    }

    /// The first joint from `number` on that is eased.
    fn smoothed(&mut self, number: usize) -> Option<usize> {
        let from = number.max(self.chain.first());
        if !self.plain.contains(&from) {
            self.plain = from..from;
        }
        // Only links to come are ever marked, so what was looked through need not be again.
        while let Some(link) = self.chain.get(self.plain.end) {
            if link.smoothed {
                return Some(self.plain.end);
            }
            self.plain.end += 1;
        }
        None
    }

    /// How far a joint's zone reaches, once its spacing is settled.
    fn extent(&self, number: usize, complete: bool) -> Option<f64> {
        let link = self.chain.get(number)?;
        let settled = number < self.spacing_pending
            && (complete || link.from + link.spacing / GROWTH <= self.reach(complete));
        settled.then_some(EXTENT * link.spacing)
    }

    fn advance_exact(&mut self, ending: Option<Ending>, out: &mut Vec<Output>) -> bool {
        let first = self.chain.find(self.cursor) + 1;
        let Some(joint) = self.smoothed(first) else {
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
            EndCondition::Place(self.chain.position(self.cursor))
        } else {
            if at_start {
                let number = self.chain.find(self.cursor);
                if let Some(link) = self.chain.get_mut(number) {
                    link.spacing = link.spacing.min(0.5 * run);
                }
                spread(&mut self.chain, number);
            }
            EndCondition::Jet(self.jet(self.cursor))
        };
        self.zone.begin(self.cursor);
        self.spent = (0, joint);
        self.state = State::BlendZone {
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
#[path = "../../tests/common/mod.rs"]
mod common;

#[cfg(test)]
mod tests {
    use super::common::{Kind, Random, check, equal_limits, limits, program, settings, within};
    use super::{Smoother, State};

    /// Programs of which some zones are given up at random places, as if they had failed.
    #[test]
    fn a_path_whose_zones_are_given_up_anywhere_still_keeps_to_the_tolerance() {
        let mut random = Random::from_state(0x5300_0011);
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
                if matches!(smoother.state, State::BlendZone { .. }) && random.unit() < 0.2 {
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

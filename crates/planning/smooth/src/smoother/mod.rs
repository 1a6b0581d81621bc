//! Blocks in, path out.

mod fallback;
mod feed_boundary;
mod zones;

use std::collections::VecDeque;
use std::ops::Range;

use evolvent_path::{AXES, Axes, Jet, JointKind, JointLimits, classify_joint};

use crate::chain::{Chain, ProgramSegment};
use crate::spacing::{self, GROWTH};
use crate::tube::lookahead;
use crate::weights::Scales;
use crate::zone::{BlendZone, EndCondition, spread};
use crate::zone_solver::ZoneSolver;
use crate::{Mark, Output, PathSegment, ProgramMove, SmootherSettings, Tolerance};

/// Extent of a zone on each side of a joint, in spacings there: the spacing has grown over 20 knots by then.
const EXTENT: f64 = 150.0;
/// Minimum length of a segment, parameter units; shorter ones are rounding.
const MIN_LENGTH: f64 = 1e-12;

/// Whether the path follows the programmed curve or is in a zone that becomes a spline.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one, and it must not allocate")]
enum State {
    Exact,
    BlendZone {
        start: EndCondition,
        /// Number of the last joint known to be in it.
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

/// Converts programmed blocks into the driven path.
///
/// Not real-time safe. After the first few thousand blocks no memory is allocated.
#[derive(Debug)]
pub struct Smoother {
    settings: SmootherSettings,
    scales: Scales,
    /// The path since the last position at which it is kept: the section.
    chain: Chain,
    state: State,
    zone: BlendZone,
    finder: ZoneSolver,
    last: Option<ProgramMove>,
    marks: VecDeque<Mark>,
    /// Parameter of the section's start since the smoother was created, and the end of the section's output.
    base: f64,
    cursor: f64,
    spacing: SpacingProgress,
    /// Segments whose joints need no smoothing.
    unsmoothed: Range<usize>,
    /// Position up to which joints of the section are kept: its start, or a joint that could not be smoothed.
    kept: f64,
    /// The present end of a zone, if it differs from the programmed point.
    offset_point: Option<Axes>,
    /// Number of the segment whose feed holds at the present end of a zone.
    feed_segment: usize,
    /// Number of intervals since the last joint of the zone became known, and that joint.
    spent: (usize, usize),
    /// Whether the path leaves the last kept position in motion, and whether that is a joint.
    departure: Departure,
    active: [bool; AXES],
    /// Lookahead of the samples in this section.
    lookahead: f64,
    tally: Tally,
    at_end: bool,
}

/// How far the knot spacing at joints is determined.
#[derive(Clone, Debug)]
struct SpacingProgress {
    /// The next joint without spacing.
    next: usize,
    /// The spacing from which that of the next joint is searched.
    guess: f64,
}

/// How the path leaves the last position at which it is kept.
#[derive(Clone, Copy, Debug, Default)]
struct Departure {
    /// In motion.
    moving: bool,
    /// That position is a joint, in motion.
    joint: bool,
}

/// Results since the smoother was created.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    /// Maximum deviation from the programmed path.
    deviation: f64,
    /// Number of zones without solution.
    failures: u64,
}

impl Smoother {
    /// Starts at rest at the beginning of the first block.
    #[must_use]
    pub fn new(settings: SmootherSettings) -> Self {
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
            spacing: SpacingProgress { next: 1, guess: 0.01 },
            unsmoothed: 0..0,
            kept: 0.0,
            offset_point: None,
            feed_segment: 0,
            spent: (0, 0),
            departure: Departure::default(),
            active: [false; AXES],
            lookahead: 0.0,
            tally: Tally::default(),
            at_end: false,
        }
    }

    /// Appends a block and outputs the path that is thereby determined.
    pub fn push(&mut self, block: &ProgramMove, out: &mut Vec<Output>) {
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
        let mut segment = ProgramSegment::new(block, self.chain.end());
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
                    segment.smoothed = true;
                    segment.exact_speed = kind.max_speed();
                    let turn = end.first.fixed_rows::<3>(0).dot(&start.first.fixed_rows::<3>(0));
                    segment.sharp = turn < -0.5;
                }
                JointKind::Step { max_speed } => self.section(Ending::Moving, Some(max_speed), out),
                JointKind::Corner => self.section(Ending::Rest, Some(0.0), out),
            }
            let from = self.chain.end();
            segment.to += from - segment.from;
            segment.from = from;
        }
        segment.inner_spacing = spacing::inside(&segment);
        self.lookahead = self.lookahead.max(lookahead(segment.tolerance));
        if segment.tolerance > 0.0 {
            let before = self.active;
            let (first, ..) = block.curve.derivative_bounds(0.0, length);
            for i in 0..AXES {
                self.active[i] |= first[i] != 0.0;
            }
            if self.active != before && matches!(self.state, State::BlendZone { .. }) {
                // Control points that are not final may now move in these axes too.
                self.zone.measure(&self.chain, &self.active);
            }
        }
        self.chain.push(segment);
        self.last = Some(*block);
        self.marks.push_back(mark(self.base + self.chain.end()));
        self.advance(None, out);
    }

    /// Stops at the end of the last block and outputs the complete path.
    pub fn rest(&mut self, out: &mut Vec<Output>) {
        if self.last.is_some() {
            self.section(Ending::Rest, Some(0.0), out);
            self.last = None;
        }
        self.release_marks(out);
    }

    /// Maximum distance so far between the path and the programmed one, mm (or degrees of a rotary axis).
    #[must_use]
    pub fn deviation_mm(&self) -> f64 {
        self.tally.deviation
    }

    /// Number of times that no smooth path was found and joints were passed as programmed.
    #[must_use]
    pub fn failures(&self) -> u64 {
        self.tally.failures
    }

    /// Outputs the rest of the section and starts the next one.
    fn section(&mut self, ending: Ending, cap: Option<f64>, out: &mut Vec<Output>) {
        self.at_end = ending == Ending::Rest;
        self.advance(Some(ending), out);
        if self.chain.end() - self.cursor > MIN_LENGTH {
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
        self.spacing.next = 1;
        self.unsmoothed = 0..0;
        self.kept = 0.0;
        self.offset_point = None;
        self.departure.moving = ending == Ending::Moving;
        self.departure.joint = self.departure.moving && cap.is_some();
        self.active = [false; AXES];
        self.lookahead = 0.0;
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
                .map_or(0.0, |segment| spacing::max_spacing(segment.tolerance));
        // The last joint of a zone determines its end, and the joint that the path passes next the feed.
        let needed = match self.state {
            State::BlendZone { joint, .. } => {
                let last = self.chain.get(joint).map_or(self.cursor, |segment| segment.from);
                let passing = self.chain.get(self.feed_segment);
                last.min(passing.map_or(self.cursor, |segment| segment.to))
            }
            State::Exact => self.cursor,
        };
        self.chain.forget(needed.min(self.cursor) - keep);
    }

    /// Determines the spacing at the joints for which enough of the path is known.
    fn resolve_spacing(&mut self, complete: bool) {
        while let Some(segment) = self.chain.get(self.spacing.next) {
            let before = self.spacing.next.checked_sub(1).and_then(|n| self.chain.get(n));
            let inherited = before.map_or(f64::INFINITY, |b| b.spacing + GROWTH * (segment.from - b.from));
            let own = if segment.smoothed {
                let Some(own) =
                    spacing::at_joint(&self.chain, self.spacing.next, self.spacing.guess, complete)
                else {
                    return;
                };
                self.spacing.guess = 2.0 * own;
                own
            } else {
                f64::INFINITY
            };
            if let Some(segment) = self.chain.get_mut(self.spacing.next) {
                segment.spacing = segment.spacing.min(own).min(inherited);
            }
            spread(&mut self.chain, self.spacing.next);
            self.spacing.next += 1;
        }
    }

    /// Position up to which the spacing is determined.
    fn reach(&self, complete: bool) -> f64 {
        match self.chain.get(self.spacing.next) {
            Some(segment) => segment.from,
            None if complete => return f64::INFINITY,
            None => self.chain.end(),
        }
        .min(self.chain.end() - self.lookahead)
    }

    /// The first joint from `number` that is smoothed.
    fn smoothed(&mut self, number: usize) -> Option<usize> {
        let from = number.max(self.chain.first());
        if !self.unsmoothed.contains(&from) {
            self.unsmoothed = from..from;
        }
        // Only later segments are ever marked, so earlier ones need not be searched again.
        while let Some(segment) = self.chain.get(self.unsmoothed.end) {
            if segment.smoothed {
                return Some(self.unsmoothed.end);
            }
            self.unsmoothed.end += 1;
        }
        None
    }

    /// Extent of a joint's zone, once its spacing is determined.
    fn extent(&self, number: usize, complete: bool) -> Option<f64> {
        let segment = self.chain.get(number)?;
        let settled = number < self.spacing.next
            && (complete || segment.from + segment.spacing / GROWTH <= self.reach(complete));
        settled.then_some(EXTENT * segment.spacing)
    }

    fn advance_exact(&mut self, ending: Option<Ending>, out: &mut Vec<Output>) -> bool {
        let first = self.chain.find(self.cursor) + 1;
        let Some(joint) = self.smoothed(first) else {
            let end = self.chain.end();
            let max = self
                .chain
                .get(self.chain.next().wrapping_sub(1))
                .map_or(0.0, |segment| EXTENT * spacing::max_spacing(segment.tolerance));
            let to = if ending.is_some() { end } else { end - max };
            self.output_exact(to, out);
            return false;
        };
        let Some(extent) = self.extent(joint, ending.is_some()) else {
            return false;
        };
        let Some(&segment) = self.chain.get(joint) else {
            return false;
        };
        let from = (segment.from - extent).max(self.cursor).max(self.kept);
        self.output_exact(from, out);
        // A curve shorter than rounding may be in between.
        self.cursor = from;
        let run = segment.from - self.cursor;
        let at_start = self.cursor <= self.kept;
        let start = if at_start && !self.departure.moving && run < 4.0 * segment.tolerance {
            EndCondition::Position(self.chain.position(self.cursor))
        } else {
            if at_start {
                let number = self.chain.find(self.cursor);
                if let Some(segment) = self.chain.get_mut(number) {
                    segment.spacing = segment.spacing.min(0.5 * run);
                }
                spread(&mut self.chain, number);
            }
            EndCondition::Jet(self.jet(self.cursor))
        };
        self.zone.begin(self.cursor);
        self.feed_segment = self.chain.find(self.cursor);
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
            Some(segment) => segment.jet(u),
            None => Jet::at_rest(self.chain.position(u)),
        }
    }

    /// Outputs the programmed path up to `to`.
    fn output_exact(&mut self, to: f64, out: &mut Vec<Output>) {
        let mut number = self.chain.find(self.cursor);
        while let Some(segment) = self.chain.get(number) {
            let stop = segment.to.min(to);
            if stop - self.cursor > MIN_LENGTH {
                out.push(Output::Segment(PathSegment {
                    curve: segment.curve,
                    from: self.cursor - segment.from,
                    length: stop - self.cursor,
                    feed_mm_s: segment.feed_mm_s,
                    metric: segment.metric,
                    rapid: segment.rapid,
                    blend: false,
                    joint: std::mem::take(&mut self.departure.joint),
                }));
                self.cursor = stop;
            }
            let end = segment.to;
            if end > to {
                break;
            }
            self.release_marks(out);
            number += 1;
            if let Some(next) = self.chain.get_mut(number)
                && std::mem::take(&mut next.cap_pending)
            {
                let speed = next.exact_speed;
                out.push(Output::Cap { speed });
                self.departure.moving = speed > 0.0;
                self.departure.joint = self.departure.moving;
            }
            if end >= to {
                break;
            }
        }
        self.release_marks(out);
    }

    /// Outputs the marks of the path output so far.
    fn release_marks(&mut self, out: &mut Vec<Output>) {
        release(&mut self.marks, self.base + self.cursor, out);
    }
}

/// Outputs the marks up to `end`.
fn release(marks: &mut VecDeque<Mark>, end: f64, out: &mut Vec<Output>) {
    while let Some(mark) = marks.front()
        && mark.end <= end + MIN_LENGTH
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

    /// Programs in which zones are abandoned at random, as if they had failed.
    #[test]
    fn abandoned_zones_keep_the_tolerance() {
        let mut random = Random::from_state(0x5300_0011);
        let mut abandoned = 0;
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
                    abandoned += u64::from(smoother.offset_point.is_some());
                    let until = smoother.cursor + random.log(1e-3, 10.0) * smallest;
                    smoother.fall_back(until, &mut out);
                }
            }
            smoother.rest(&mut out);
            check(&blocks, &out, 5, &format!("case {case} {tolerance:?}"));
        }
        assert!(abandoned > 8, "{abandoned}");
    }
}

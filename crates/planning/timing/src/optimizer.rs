//! The planner of one window.

use crate::check::{Checked, check as check_between};
use crate::error::FeedError;
use crate::grid::{Grid, Place};
use crate::limits::PathLimits;
use crate::piece::{Entry, Exit, Piece, PlanReport, Ratios};
use crate::solver::{FIRST, Solver};
use crate::spans;
use crate::start;
use crate::time_law::TimeLaw;
use crate::warm_start::{Segment, WarmStart};
use crate::window::{Span, Window};

/// Most intervals of one window, so that a re-plan of three axes stays below 5 ms.
pub const MAX_INTERVALS: usize = 320;
/// Most spans that they are divided into.
pub(crate) const MAX_SPANS: usize = MAX_INTERVALS + 200;
/// Share of the jerk limit that the last stub of an open window may use.
const GENTLE: f64 = 0.25;
/// How many times as many Newton steps a plan from rest has: broken off it would be driven to its end, and no cycle waits.
const AT_REST: u32 = 5;
/// Most Newton steps of one plan, and the share of them that is kept from the way to its centre.
const MAX_STEPS: u32 = 48;
const CENTRE_FRACTION: u32 = 6;
/// Most rounds of checking and correcting, and steps of each.
const POLISHES: usize = 4;
const POLISH_STEPS: u32 = 8;
/// Shares of the way from its start that a plan goes if it cannot be driven as far as it went. The first cost next to
/// nothing: an excess of a hundredth at one corner must not slow a hundred millimetres down.
const RETREATS: [f64; 8] = [0.998, 0.99, 0.97, 0.9, 0.75, 0.5, 0.25, 0.0];
/// Most crawls that are tried, each at this share of the `u'^2` of the one before.
const CRAWLS: usize = 40;
const SLOWER: f64 = 0.3;

/// What is to be planned: from a place and a state of motion to the end of a window.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WindowProblem<'a> {
    pub(crate) grid: &'a Grid,
    pub(crate) from: Place,
    /// Speed and acceleration at the start.
    pub(crate) state: (f64, f64),
    pub(crate) until: u64,
    pub(crate) factor: f64,
    /// Share of the jerk limit that the last stub may use.
    pub(crate) gentle: f64,
    /// Whether the motion is to change at once: stations close enough for that.
    pub(crate) quick: bool,
    /// Whether the last stub may take a whole interval: not the only one that is new.
    pub(crate) whole: bool,
}

/// Plans windows of a [`Grid`].
#[derive(Clone, Debug)]
pub struct Optimizer {
    pub(crate) limits: PathLimits,
    pub(crate) window: Window,
    pub(crate) solver: Solver,
    pub(crate) scratch: Vec<Span>,
    pub(crate) segments: Vec<Segment>,
    pub(crate) goal: Vec<f64>,
    pub(crate) guide: start::InitialGuess,
    pub(crate) kept: WarmStart,
    /// Newton steps that one plan in motion or stop may take.
    most_steps: u32,
    /// Those of the plan or stop at hand.
    steps: u32,
}

impl Optimizer {
    /// Allocates for the largest window.
    #[must_use]
    pub fn new(limits: &PathLimits) -> Self {
        let stations = MAX_SPANS;
        Self {
            limits: limits.clone(),
            window: Window::with_capacity(stations),
            solver: Solver::with_capacity(stations),
            scratch: Vec::with_capacity(stations + 2),
            segments: Vec::with_capacity(stations),
            goal: Vec::with_capacity(2 * stations + 1),
            guide: start::InitialGuess::with_capacity(stations),
            kept: WarmStart::with_capacity(stations),
            most_steps: MAX_STEPS,
            steps: MAX_STEPS,
        }
    }

    /// Bounds the work of a plan in motion or a stop: so many Newton steps, 48 if nothing else is said; five times as many
    /// from rest, where nothing waits but the start. What is found by then is
    /// handed out; it keeps all limits, but is the slower the fewer steps there are.
    #[must_use]
    pub fn with_steps(mut self, most: u32) -> Self {
        self.most_steps = most;
        self
    }

    /// Drops everything that earlier plans have left, so that the next answer depends on its arguments alone.
    ///
    /// Nothing is left to go on from then: a plan from a moving state fails with [`FeedError::NoMotion`], and a stop
    /// is tried in closed form only, until a plan from rest has been made. Cycle: no.
    pub fn forget(&mut self) {
        self.kept.forget();
    }

    /// Newton steps of the last plan or stop, whatever came of it.
    #[must_use]
    pub fn iterations(&self) -> u32 {
        self.solver.iterations
    }

    /// A near-optimal plan from `from` to the end of interval `until - 1`, at `feed_factor` (0.001 to 2) times the
    /// programmed feeds; rapids are not scaled. It replaces what `out` held. Cycle: no.
    ///
    /// # Errors
    /// See [`FeedError`]; `out` is then empty and the plan before stays valid.
    #[expect(
        clippy::too_many_arguments,
        reason = "one call with all that a plan depends on"
    )]
    pub fn plan(
        &mut self,
        grid: &Grid,
        from: Place,
        entry: Entry,
        until: u64,
        exit: Exit,
        feed_factor: f64,
        out: &mut Vec<Piece>,
    ) -> Result<PlanReport, FeedError> {
        out.clear();
        let (v, a) = match entry {
            Entry::Rest => (0.0, 0.0),
            Entry::Moving { v, a } => (v, a),
        };
        check(grid, from, until, v, a, feed_factor)?;
        self.steps = match entry {
            Entry::Rest => AT_REST * self.most_steps,
            Entry::Moving { .. } => self.most_steps,
        };
        let job = WindowProblem {
            grid,
            from,
            state: (v, a),
            until,
            factor: feed_factor,
            gentle: if exit == Exit::Open { GENTLE } else { 1.0 },
            quick: feed_factor < self.kept.factor,
            whole: entry == Entry::Rest || until > self.kept.until.saturating_add(1),
        };
        let found = match entry {
            Entry::Rest => self.begin(&job),
            Entry::Moving { .. } => self.continue_from(&job, out),
        };
        let Some(gap) = found else {
            out.clear();
            return Err(FeedError::NoMotion {
                interval: from.interval,
                x: from.x,
                v,
                a,
            });
        };
        let stations = if gap.is_nan() { 0 } else { self.window.n() + 1 };
        let mut worst = Ratios::default();
        if stations > 0 {
            worst = self.refine(grid, feed_factor);
            let head = out.len();
            self.write(out);
            self.kept
                .keep(&out[..head], &self.window, &self.solver.x, until, feed_factor);
        }
        Ok(PlanReport {
            iterations: self.solver.iterations,
            gap: gap.max(0.0),
            duration: out.iter().map(|piece| piece.duration).sum(),
            stations,
            warm: entry != Entry::Rest,
            worst,
        })
    }

    /// Steps that are left for the way to the centre; some are kept for what a check between stations may find.
    pub(crate) fn centre_steps(&self) -> u32 {
        let kept = self.steps / CENTRE_FRACTION;
        (self.steps - kept).saturating_sub(self.solver.iterations)
    }

    /// Checks between stations and keeps away from the limits where that finds them exceeded. If there are no steps left
    /// for that, the plan goes back towards the motion that it began with, which keeps them.
    pub(crate) fn refine(&mut self, grid: &Grid, factor: f64) -> Ratios {
        let mut checked = self.check_between(grid, factor);
        for _ in 1..POLISHES {
            let left = self.steps.saturating_sub(self.solver.iterations);
            if !checked.raised || left == 0 {
                break;
            }
            self.solver.follow_stiff(&self.window, left.min(POLISH_STEPS));
            checked = self.check_between(grid, factor);
        }
        self.solver.mark_end();
        for share in RETREATS {
            if !checked.broken {
                break;
            }
            if self.solver.retreat(&self.window, share) {
                checked = self.check_between(grid, factor);
            }
        }
        checked.worst
    }

    fn check_between(&mut self, grid: &Grid, factor: f64) -> Checked {
        check_between(&self.window, grid, factor, &self.solver.x, &mut self.solver.stiff)
    }

    /// A plan without anything to start from. Returns the barrier parameter reached.
    fn begin(&mut self, job: &WindowProblem<'_>) -> Option<f64> {
        self.window.from_rest = true;
        self.window.spans.clear();
        spans::plain(job.grid, job.from, job.until, &mut self.window.spans);
        for reverse in [false, true] {
            self.grade(job, reverse);
        }
        self.balance(true);
        if self.window.spans.len() < 3 || !self.window.fetch(job.grid) {
            return None;
        }
        self.window.pack(&self.limits, job.factor, job.gentle);
        self.solver.begin(self.window.n());
        let mut level = start::crawl_level(&self.window, 0, &self.limits);
        for _ in 0..CRAWLS {
            start::feasible_start(&self.window, level, &mut self.solver.x);
            if self.solver.feasible(&self.window) {
                self.solver.mark();
                self.lead();
                return Some(self.solver.descend(&self.window, FIRST, self.centre_steps()));
            }
            level *= SLOWER;
        }
        None
    }

    /// Brings a crawl nearer to what the path allows.
    pub(crate) fn lead(&mut self) {
        start::guide(&self.window, &self.limits, &self.solver.x, &mut self.guide);
        self.solver.lead(&self.window, &self.guide);
    }

    /// Lets lengths change gently between the stubs.
    pub(crate) fn balance(&mut self, first: bool) {
        let spans = &mut self.window.spans;
        let (stub, count) = (spans.pop(), spans.len());
        let first = (first && count > 0).then(|| spans.remove(0));
        spans::balance(spans, MAX_SPANS - 2, &mut self.scratch);
        if let Some(first) = first {
            spans.insert(0, first);
        }
        spans.extend(stub);
    }

    /// Divides the spans of the end that is at rest.
    pub(crate) fn grade(&mut self, job: &WindowProblem<'_>, reverse: bool) {
        spans::grade(&mut self.window.spans, job, reverse, MAX_SPANS, &mut self.scratch);
    }

    /// The iterate as pieces.
    pub(crate) fn write(&self, out: &mut Vec<Piece>) {
        let (window, x) = (&self.window, &self.solver.x);
        let n = window.n();
        let lead = usize::from(window.from_rest);
        for (i, (span, cell)) in window.spans.iter().zip(&window.cells).enumerate() {
            let length = span.length;
            let (law, duration) = if i < lead {
                // v = 3 x / t at the far end.
                let duration = 3.0 * length / x.a[0].sqrt();
                (
                    TimeLaw::Jerk {
                        v: 0.0,
                        a: 0.0,
                        j: 6.0 * length / (duration * duration * duration),
                    },
                    duration,
                )
            } else if i == n + lead {
                let v = x.a[n].sqrt();
                let duration = 3.0 * length / v;
                (
                    TimeLaw::Jerk {
                        v,
                        a: -2.0 * v / duration,
                        j: 2.0 * v / (duration * duration),
                    },
                    duration,
                )
            } else {
                let k = i - lead;
                let law = TimeLaw::Flow {
                    v: x.a[k].sqrt(),
                    b: x.b[k],
                    c: x.c[k],
                };
                (law, law.duration(length))
            };
            out.push(Piece {
                law,
                length,
                duration,
                stretch: cell.stretch,
                from: cell.from,
                interval: span.interval,
            });
        }
    }
}

/// Refuses what is not on the grid, too large or not a number.
pub(crate) fn check(
    grid: &Grid,
    from: Place,
    until: u64,
    v: f64,
    a: f64,
    factor: f64,
) -> Result<(), FeedError> {
    let known = grid
        .interval_length(from.interval)
        .is_some_and(|length| from.x >= 0.0 && from.x <= length);
    if !known || until <= from.interval || until > grid.end() {
        return Err(FeedError::Place {
            interval: from.interval,
            x: from.x,
            first: grid.first(),
            until: until.min(grid.end()),
        });
    }
    let (intervals, most) = (until - from.interval, MAX_INTERVALS as u64);
    if intervals > most {
        return Err(FeedError::Window { intervals, most });
    }
    if v >= 0.0 && v.is_finite() && a.is_finite() && (0.001..=2.0).contains(&factor) {
        Ok(())
    } else {
        Err(FeedError::State { v, a, factor })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use evolvent_machine::Limits;
    use evolvent_path::{AXES, Axes, Line};

    use super::*;
    use crate::barrier::constraint_ratio;

    /// What the check finds on a small part of the motion is next to nothing beside the weight of the whole, by which
    /// a centre is judged otherwise.
    #[test]
    fn a_stiffer_interval_keeps_away_from_its_limit_however_little_time_it_takes() {
        let limits = Limits {
            present: [true; AXES],
            velocity: Axes::repeat(500.0),
            acceleration: Axes::repeat(5000.0),
            jerk: Axes::repeat(2e5),
            travel_min: Axes::repeat(-1e4),
            travel_max: Axes::repeat(1e4),
            home: Axes::zeros(),
        };
        let limits = PathLimits::new(limits, 1e5, 1.0);
        let mut grid = Grid::new(&limits);
        let mut end = Axes::zeros();
        end[0] = 100.0;
        let line = Line::new(Axes::zeros(), end).expect("line");
        grid.push(&line.into(), 0.0, 100.0, 10.0);
        let mut optimizer = Optimizer::new(&limits);
        let (start, mut out) = (Place { interval: 0, x: 0.0 }, Vec::new());
        let report = optimizer.plan(&grid, start, Entry::Rest, grid.end(), Exit::Rest, 1.0, &mut out);
        let total = report.expect("plan").duration;
        let (window, x) = (&optimizer.window, &optimizer.solver.x);
        let left = |x: &_, k: usize| 1.0 - constraint_ratio(window, k, x).1;
        let k = (0..window.n())
            .min_by(|a, b| left(x, *a).total_cmp(&left(x, *b)))
            .expect("an interval");
        let (before, time) = (left(x, k), window.d[k] / x.a[k].sqrt());
        assert!(
            before < 0.01 && time < 1e-3 * total,
            "{before}, {time} of {total}"
        );
        optimizer.solver.stiff[k] *= 125.0;
        optimizer.solver.follow_stiff(&optimizer.window, POLISH_STEPS);
        let after = 1.0 - constraint_ratio(&optimizer.window, k, &optimizer.solver.x).1;
        assert!(after > 5.0 * before, "{before} of the limit left, then {after}");
    }
}

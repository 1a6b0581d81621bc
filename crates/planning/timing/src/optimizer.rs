//! Plans one window.

use crate::check::{Checked, check as check_between};
use crate::error::FeedError;
use crate::grid::{Grid, PathPosition};
use crate::limits::PathLimits;
use crate::piece::{Entry, Exit, PlanReport, Ratios, TimeLawPiece};
use crate::solver::{MU_FROM_REST, Solver};
use crate::spans;
use crate::start;
use crate::time_law::TimeLaw;
use crate::warm_start::{SolvedSpan, WarmStart};
use crate::window::{Span, Window};

/// Maximum number of intervals of one window, so that replanning three axes takes less than 5 ms.
pub const MAX_INTERVALS: usize = 320;
/// Maximum number of spans into which they are divided.
pub(crate) const MAX_SPANS: usize = MAX_INTERVALS + 200;
/// Fraction of the jerk limit for the last stub of an open window.
const OPEN_END_JERK_FRACTION: f64 = 0.25;
/// Factor on the number of Newton steps for a plan from rest: stopped early it would be executed to its end,
/// and no cycle waits for it.
const REST_STEP_FACTOR: u32 = 5;
/// Maximum number of Newton steps of one plan, and the reciprocal of the fraction reserved for refinement.
const MAX_STEPS: u32 = 48;
const REFINEMENT_DIVISOR: u32 = 6;
/// Maximum rounds of checking and correcting, and steps of each.
const MAX_REFINEMENTS: usize = 4;
const REFINEMENT_STEPS: u32 = 8;
/// Fractions of the difference between start and result to which a plan backtracks if the result exceeds the
/// limits. The first cost almost nothing: an excess of 1 % at one corner must not slow down 100 mm.
const BACKTRACK_FRACTIONS: [f64; 8] = [0.998, 0.99, 0.97, 0.9, 0.75, 0.5, 0.25, 0.0];
/// Maximum number of slow start motions that are tried, and the factor of `u'^2` from one to the next.
const MAX_CRAWLS: usize = 40;
const CRAWL_FACTOR: f64 = 0.3;

/// The problem of a window: from a position and a state of motion to the end of the window.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WindowProblem<'a> {
    pub(crate) grid: &'a Grid,
    pub(crate) from: PathPosition,
    /// Speed and acceleration at the start.
    pub(crate) state: (f64, f64),
    pub(crate) until: u64,
    pub(crate) factor: f64,
    /// Fraction of the jerk limit for the last stub.
    pub(crate) end_jerk_fraction: f64,
    /// Whether the motion has to change at once, which needs dense stations.
    pub(crate) dense: bool,
    /// Whether the last stub may fill its interval because it is not the only new one.
    pub(crate) whole: bool,
}

/// Plans windows of a [`Grid`].
#[derive(Clone, Debug)]
pub struct Optimizer {
    pub(crate) limits: PathLimits,
    pub(crate) window: Window,
    pub(crate) solver: Solver,
    pub(crate) scratch: Vec<Span>,
    pub(crate) solved_spans: Vec<SolvedSpan>,
    pub(crate) goal: Vec<f64>,
    pub(crate) initial_guess: start::InitialGuess,
    pub(crate) last_plan: WarmStart,
    /// Maximum Newton steps of a plan from motion or a stop.
    max_steps: u32,
    /// Maximum Newton steps of the present plan.
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
            solved_spans: Vec::with_capacity(stations),
            goal: Vec::with_capacity(2 * stations + 1),
            initial_guess: start::InitialGuess::with_capacity(stations),
            last_plan: WarmStart::with_capacity(stations),
            max_steps: MAX_STEPS,
            steps: MAX_STEPS,
        }
    }

    /// Limits the work of a plan from motion or a stop to this number of Newton steps (default 48); plans
    /// from rest, for which only the start waits, may use five times as many. Fewer steps give a slower plan,
    /// which still keeps all limits.
    #[must_use]
    pub fn with_steps(mut self, max: u32) -> Self {
        self.max_steps = max;
        self
    }

    /// Drops the state of earlier plans, so that the next result depends on its arguments alone.
    ///
    /// Until a plan from rest has been made, a plan from motion fails with [`FeedError::NoMotion`], and a
    /// stop is attempted in closed form only. Not real-time safe.
    pub fn forget(&mut self) {
        self.last_plan.forget();
    }

    /// Newton steps of the last plan or stop, successful or not.
    #[must_use]
    pub fn iterations(&self) -> u32 {
        self.solver.iterations
    }

    /// Plans a time-optimal motion from `from` to the end of interval `until - 1`, at `feed_factor` (0.001 to
    /// 2) times the programmed feeds; rapids are not scaled. Replaces the contents of `out`. Not real-time
    /// safe.
    ///
    /// # Errors
    /// See [`FeedError`]; `out` is then empty and the previous plan stays valid.
    #[expect(
        clippy::too_many_arguments,
        reason = "one call with all that a plan depends on"
    )]
    pub fn plan(
        &mut self,
        grid: &Grid,
        from: PathPosition,
        entry: Entry,
        until: u64,
        exit: Exit,
        feed_factor: f64,
        out: &mut Vec<TimeLawPiece>,
    ) -> Result<PlanReport, FeedError> {
        out.clear();
        let (v, a) = match entry {
            Entry::Rest => (0.0, 0.0),
            Entry::Moving { v, a } => (v, a),
        };
        check(grid, from, until, v, a, feed_factor)?;
        self.steps = match entry {
            Entry::Rest => REST_STEP_FACTOR * self.max_steps,
            Entry::Moving { .. } => self.max_steps,
        };
        let problem = WindowProblem {
            grid,
            from,
            state: (v, a),
            until,
            factor: feed_factor,
            end_jerk_fraction: if exit == Exit::Open {
                OPEN_END_JERK_FRACTION
            } else {
                1.0
            },
            dense: feed_factor < self.last_plan.factor,
            whole: entry == Entry::Rest || until > self.last_plan.until.saturating_add(1),
        };
        let found = match entry {
            Entry::Rest => self.plan_from_rest(&problem),
            Entry::Moving { .. } => self.continue_from(&problem, out),
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
            self.last_plan
                .keep(&out[..head], &self.window, &self.solver.x, until, feed_factor);
        }
        Ok(PlanReport {
            iterations: self.solver.iterations,
            gap: gap.max(0.0),
            duration_s: out.iter().map(|piece| piece.duration_s).sum(),
            stations,
            warm: entry != Entry::Rest,
            worst,
        })
    }

    /// Remaining steps for centring; some are reserved for corrections after the check between stations.
    pub(crate) fn centre_steps(&self) -> u32 {
        let kept = self.steps / REFINEMENT_DIVISOR;
        (self.steps - kept).saturating_sub(self.solver.iterations)
    }

    /// Checks the plan between stations and raises constraint weights where limits are exceeded. If no steps
    /// remain for that, the plan backtracks towards its feasible start.
    pub(crate) fn refine(&mut self, grid: &Grid, factor: f64) -> Ratios {
        let mut checked = self.check_between(grid, factor);
        for _ in 1..MAX_REFINEMENTS {
            let left = self.steps.saturating_sub(self.solver.iterations);
            if !checked.weights_raised || left == 0 {
                break;
            }
            self.solver
                .recentre_weighted(&self.window, left.min(REFINEMENT_STEPS));
            checked = self.check_between(grid, factor);
        }
        self.solver.mark_end();
        for fraction in BACKTRACK_FRACTIONS {
            if !checked.violated {
                break;
            }
            if self.solver.backtrack(&self.window, fraction) {
                checked = self.check_between(grid, factor);
            }
        }
        checked.worst
    }

    fn check_between(&mut self, grid: &Grid, factor: f64) -> Checked {
        check_between(
            &self.window,
            grid,
            factor,
            &self.solver.x,
            &mut self.solver.constraint_weight,
        )
    }

    /// Plans from rest, without a warm start. Returns the final barrier parameter.
    fn plan_from_rest(&mut self, problem: &WindowProblem<'_>) -> Option<f64> {
        self.window.from_rest = true;
        self.window.spans.clear();
        spans::plain(problem.grid, problem.from, problem.until, &mut self.window.spans);
        for reverse in [false, true] {
            self.grade(problem, reverse);
        }
        self.balance(true);
        if self.window.spans.len() < 3 || !self.window.fetch(problem.grid) {
            return None;
        }
        self.window
            .pack(&self.limits, problem.factor, problem.end_jerk_fraction);
        self.solver.reset(self.window.n());
        let mut level = start::crawl_level(&self.window, 0, &self.limits);
        for _ in 0..MAX_CRAWLS {
            start::feasible_start(&self.window, level, &mut self.solver.x);
            if self.solver.feasible(&self.window) {
                self.solver.mark();
                self.apply_initial_guess();
                return Some(
                    self.solver
                        .descend(&self.window, MU_FROM_REST, self.centre_steps()),
                );
            }
            level *= CRAWL_FACTOR;
        }
        None
    }

    /// Accelerates a slow start motion towards what the path permits.
    pub(crate) fn apply_initial_guess(&mut self) {
        start::initial_guess(
            &self.window,
            &self.limits,
            &self.solver.x,
            &mut self.initial_guess,
        );
        self.solver.approach_guess(&self.window, &self.initial_guess);
    }

    /// Limits the ratio of neighbouring span lengths between the stubs.
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

    /// Divides the spans near the end that is at rest.
    pub(crate) fn grade(&mut self, problem: &WindowProblem<'_>, reverse: bool) {
        spans::grade(
            &mut self.window.spans,
            problem,
            reverse,
            MAX_SPANS,
            &mut self.scratch,
        );
    }

    /// Writes the iterate as pieces.
    pub(crate) fn write(&self, out: &mut Vec<TimeLawPiece>) {
        let (window, x) = (&self.window, &self.solver.x);
        let n = window.n();
        let lead = usize::from(window.from_rest);
        for (i, (span, cell)) in window.spans.iter().zip(&window.cells).enumerate() {
            let length = span.length;
            let (law, duration) = if i < lead {
                // v = 3 x / t at the far end.
                let duration = 3.0 * length / x.a[0].sqrt();
                (
                    TimeLaw::ConstantJerk {
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
                    TimeLaw::ConstantJerk {
                        v,
                        a: -2.0 * v / duration,
                        j: 2.0 * v / (duration * duration),
                    },
                    duration,
                )
            } else {
                let k = i - lead;
                let law = TimeLaw::LinearAcceleration {
                    v: x.a[k].sqrt(),
                    b: x.b[k],
                    c: x.c[k],
                };
                (law, law.duration(length))
            };
            out.push(TimeLawPiece {
                law,
                length,
                duration_s: duration,
                segment: cell.segment,
                from: cell.from,
                interval: span.interval,
            });
        }
    }
}

/// Rejects positions outside of the grid, windows that are too large, and invalid numbers.
pub(crate) fn check(
    grid: &Grid,
    from: PathPosition,
    until: u64,
    v: f64,
    a: f64,
    factor: f64,
) -> Result<(), FeedError> {
    let known = grid
        .interval_length(from.interval)
        .is_some_and(|length| from.x >= 0.0 && from.x <= length);
    if !known || until <= from.interval || until > grid.end() {
        return Err(FeedError::PathPosition {
            interval: from.interval,
            x: from.x,
            first: grid.first(),
            until: until.min(grid.end()),
        });
    }
    let (intervals, max) = (until - from.interval, MAX_INTERVALS as u64);
    if intervals > max {
        return Err(FeedError::Window { intervals, max });
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

    /// An excess in a small part of the motion is negligible compared to the weight of the whole, which
    /// otherwise decides when an iterate counts as centred.
    #[test]
    fn a_higher_constraint_weight_increases_the_margin() {
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
        let (start, mut out) = (PathPosition { interval: 0, x: 0.0 }, Vec::new());
        let report = optimizer.plan(&grid, start, Entry::Rest, grid.end(), Exit::Rest, 1.0, &mut out);
        let total = report.expect("plan").duration_s;
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
        optimizer.solver.constraint_weight[k] *= 125.0;
        optimizer
            .solver
            .recentre_weighted(&optimizer.window, REFINEMENT_STEPS);
        let after = 1.0 - constraint_ratio(&optimizer.window, k, &optimizer.solver.x).1;
        assert!(after > 5.0 * before, "{before} of the limit left, then {after}");
    }
}

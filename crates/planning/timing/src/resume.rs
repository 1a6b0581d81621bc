//! Continues from the last plan.

use crate::barrier::{Iterate, constraint_ratio};
use crate::check::WEIGHT_FACTOR;
use crate::closed_form;
use crate::grid::PathPosition;
use crate::optimizer::{MAX_SPANS, Optimizer, WindowProblem};
use crate::piece::TimeLawPiece;
use crate::solver::MU_WARM;
use crate::spans;
use crate::start;
use crate::time_law::TimeLaw;
use crate::warm_start::{ResumePoint, WarmStart};
use crate::window::{Span, Window};

/// Minimum number of intervals over the stopping distance, if a stop is requested.
const STOP_INTERVALS: f64 = 16.0;
/// If the motion has to decelerate to a cap: the weight of that relative to the duration, the maximum number
/// of rounds of two steps, their barrier parameter, and the factor by which the cap of a round exceeds
/// `u'^2`.
const CAP_PENALTY: f64 = 3.0;
const MAX_CAP_ROUNDS: usize = 25;
const CAP_MU: f64 = 0.01;
const CAP_FACTOR: f64 = 1.03;
/// Maximum ratio of acceleration and of jerk at the start.
const MAX_START_RATIO: (f64, f64) = (1.001, 1.012);
/// Margin for a start on a limit, as a fraction of the limit.
const START_MARGIN: f64 = 1e-4;
/// Rounding of `u'^2`, relative.
const ROUNDING: f64 = 1e-9;
/// Relative excess of `u'^2` over its cap from which a start is decelerated.
const MIN_EXCESS: f64 = 1e-3;
/// Maximum ratio of a new slow motion, how many are tried, and the factor of `u'^2` from one to the next.
const MAX_CRAWL_RATIO: f64 = 0.95;
const MAX_CRAWLS: usize = 20;
const CRAWL_FACTOR: f64 = 0.3;

/// What remains of the last plan besides its segments.
struct Remainder {
    /// The remainder of the last stub.
    stub: Span,
    /// `u'^2` at its start.
    square: f64,
    /// The state at the start of the segments; `None` if pieces in closed form precede them.
    state: Option<(f64, f64)>,
}

impl Optimizer {
    /// Plans a continuation of the last plan. Returns the final barrier parameter; NaN if nothing remained to
    /// be planned and `out` is complete.
    pub(crate) fn continue_from(
        &mut self,
        problem: &WindowProblem<'_>,
        out: &mut Vec<TimeLawPiece>,
    ) -> Option<f64> {
        if let Some(gap) = self.reduce_feed(problem, out) {
            return Some(gap);
        }
        out.clear();
        if !self.resume(problem, out)? {
            return Some(f64::NAN);
        }
        Some(self.solver.descend(&self.window, MU_WARM, self.centre_steps()))
    }

    /// Sets window and iterate to the remainder of the last plan from a position on, and to a slow motion on
    /// the new path. The remainder of a first stub is written to `out` at once. Returns false if nothing
    /// remains to be planned.
    pub(crate) fn resume(
        &mut self,
        problem: &WindowProblem<'_>,
        out: &mut Vec<TimeLawPiece>,
    ) -> Option<bool> {
        let found = self
            .last_plan
            .find(problem.grid, problem.from, problem.state.0, problem.state.1)?;
        let last = self.last_plan.last?;
        let more = problem.until > self.last_plan.until;
        self.solved_spans.clear();
        if let ResumePoint::LastStub(x) = found
            && !more
        {
            out.push(self.remainder_of_last_stub(problem, &last, x)?);
            self.solver.iterations = 0;
            return Some(false);
        }
        let remainder = self.take_remainder(problem, found, &last, out)?;
        let old = self.solved_spans.len();
        if more {
            WarmStart::release(
                remainder.stub,
                remainder.square,
                remainder.square / 3.0,
                &mut self.solved_spans,
            );
        }
        self.divide(problem, (!more).then_some(last));
        if let Some(state) = remainder.state
            && problem.dense
        {
            self.divide_for_stop(problem, state)?;
        }
        if self.window.spans.len() < 2 || !self.window.fetch(problem.grid) {
            return None;
        }
        self.window
            .pack(&self.limits, problem.factor, problem.end_jerk_fraction);
        self.solver.reset(self.window.n());
        if more {
            self.crawl_beyond(&remainder, old)?;
        } else {
            self.keep_last_stub(&last, remainder.square);
        }
        self.make_start_feasible(remainder.state)?;
        Some(true)
    }

    /// The piece to rest from offset `x`, if only a part of the last stub remains.
    fn remainder_of_last_stub(
        &self,
        problem: &WindowProblem<'_>,
        last: &Span,
        x: f64,
    ) -> Option<TimeLawPiece> {
        let cell = problem.grid.cell(last.interval)?;
        // The stub's own jerk up to its end: exact even for a tiny remainder.
        let (v, a) = problem.state;
        let whole = 3.0 * last.length / self.last_plan.last_a.sqrt();
        let j = 6.0 * last.length / (whole * whole * whole);
        let duration = -a / j;
        Some(TimeLawPiece {
            law: TimeLaw::ConstantJerk { v, a, j },
            length: last.length - x,
            duration_s: duration,
            segment: cell.segment,
            from: cell.from + (last.x + x),
            interval: last.interval,
        })
    }

    /// Takes the remainder of the last plan: pieces in closed form into `out`, segments into those of the new
    /// plan.
    fn take_remainder(
        &mut self,
        problem: &WindowProblem<'_>,
        found: ResumePoint,
        last: &Span,
        out: &mut Vec<TimeLawPiece>,
    ) -> Option<Remainder> {
        let whole = |state| Remainder {
            stub: *last,
            square: self.last_plan.last_a,
            state,
        };
        match found {
            ResumePoint::Head(k, t) => {
                let remainder = whole(None);
                let head = self.last_plan.head.get(k..)?;
                out.push(remainder_of_piece(head.first()?, t));
                out.extend_from_slice(&head[1..]);
                self.last_plan.remainder(0, 0.0, &mut self.solved_spans);
                Some(remainder)
            }
            ResumePoint::FirstStub(x) => {
                let remainder = whole(None);
                out.push(self.remainder_of_first_stub(problem, x)?);
                self.last_plan.remainder(0, 0.0, &mut self.solved_spans);
                Some(remainder)
            }
            ResumePoint::SolvedSpan(k, x) => {
                let remainder = whole(Some(problem.state));
                self.last_plan.remainder(k, x, &mut self.solved_spans);
                Some(remainder)
            }
            ResumePoint::LastStub(x) => Some(Remainder {
                stub: Span {
                    x: last.x + x,
                    length: last.length - x,
                    ..*last
                },
                square: problem.state.0 * problem.state.0,
                state: Some(problem.state),
            }),
        }
    }

    /// The remainder of the first stub from offset `x`.
    fn remainder_of_first_stub(&self, problem: &WindowProblem<'_>, x: f64) -> Option<TimeLawPiece> {
        let span = self.last_plan.first?;
        let end = self.last_plan.solved_spans.first()?;
        let cell = problem.grid.cell(span.interval)?;
        let whole = 3.0 * span.length / end.a.sqrt();
        let j = 6.0 * span.length / (whole * whole * whole);
        let fraction = libm::cbrt(x / span.length);
        let t = fraction * whole;
        Some(TimeLawPiece {
            law: TimeLaw::ConstantJerk {
                v: 0.5 * j * t * t,
                a: j * t,
                j,
            },
            length: span.length - x,
            duration_s: whole - t,
            segment: cell.segment,
            from: cell.from + span.x + x,
            interval: span.interval,
        })
    }

    /// Divides the window: the segments unchanged, then the new path, or the last stub if there is none.
    fn divide(&mut self, problem: &WindowProblem<'_>, last: Option<Span>) {
        let spans = &mut self.window.spans;
        self.window.from_rest = false;
        spans.clear();
        spans.extend(self.solved_spans.iter().map(|solved_span| solved_span.span));
        if let Some(last) = last {
            spans.push(last);
            return;
        }
        let new = PathPosition {
            interval: self.last_plan.until,
            x: 0.0,
        };
        spans::plain(problem.grid, new, problem.until, spans);
        self.grade(problem, true);
        self.balance(false);
    }

    /// Divides the stopping distance more finely.
    fn divide_for_stop(&mut self, problem: &WindowProblem<'_>, (v, a): (f64, f64)) -> Option<()> {
        let reach = closed_form::reach(problem.grid, problem.from, v, a, problem.until);
        let stub = self.window.spans.pop()?;
        let capacity = MAX_SPANS - 1;
        spans::subdivide(
            &mut self.window.spans,
            1.2 * reach,
            reach / STOP_INTERVALS,
            capacity,
            &mut self.scratch,
        );
        self.window.spans.push(stub);
        Some(())
    }

    /// Sets the iterate to the first `old` segments, the last stub passed without a stop, and a slow motion
    /// after it within the limits. `None` if none of the attempts is within the limits, or if the window is
    /// full.
    fn crawl_beyond(&mut self, remainder: &Remainder, old: usize) -> Option<()> {
        let n = self.window.n();
        let mut level = remainder.square / 3.0;
        let released = start::fill(&self.window, &self.solved_spans[..old], &mut self.solver.x);
        let fresh = start::fill(&self.window, &self.solved_spans, &mut self.solver.x);
        if fresh >= n {
            // No station between the slow motion and the last stub: the window is full.
            return None;
        }
        level = level.min(start::crawl_level(&self.window, fresh, &self.limits));
        for _ in 0..MAX_CRAWLS {
            self.solved_spans.truncate(old);
            WarmStart::release(remainder.stub, remainder.square, level, &mut self.solved_spans);
            let fresh = start::fill(&self.window, &self.solved_spans, &mut self.solver.x);
            start::crawl_to_end(&self.window, fresh, level, start::FADE, &mut self.solver.x);
            if self.crawl_fits(released) {
                return Some(());
            }
            level *= CRAWL_FACTOR;
        }
        None
    }

    /// Whether the iterate is well within the limits from station `first`.
    fn crawl_fits(&self, first: usize) -> bool {
        let (window, x, n) = (&self.window, &self.solver.x, self.window.n());
        (first..n).all(|k| {
            let (a, j) = constraint_ratio(window, k, x);
            a.max(j) < MAX_CRAWL_RATIO
        }) && -x.b[n] < MAX_CRAWL_RATIO * window.end.max_b
    }

    /// Sets the iterate to the segments followed by the last stub.
    fn keep_last_stub(&mut self, last: &Span, square: f64) {
        let n = self.window.n();
        start::fill(&self.window, &self.solved_spans, &mut self.solver.x);
        self.solver.x.a[n] = square;
        self.solver.x.b[n] = -square / (1.5 * last.length);
        self.window.end.max_b = self
            .window
            .end
            .max_b
            .max(-(1.0 + START_MARGIN) * self.solver.x.b[n]);
    }

    /// Makes the start feasible: margins at limits that it reaches, caps that it exceeds raised and lowered
    /// again, and the given state where it differs from the last plan's by rounding.
    fn make_start_feasible(&mut self, state: Option<(f64, f64)>) -> Option<()> {
        self.relax_start()?;
        let above = self.relax_caps();
        self.window.lifted = above;
        if let Some((v, a)) = state {
            let by = (v * v - self.solver.x.a[0], a - self.solver.x.b[0]);
            if by != (0.0, 0.0) {
                self.solver.shift_start(&self.window, by);
            }
        }
        if !self.solver.feasible(&self.window) {
            return None;
        }
        self.solver.mark();
        if above {
            self.lower_caps();
        }
        Some(())
    }

    /// Relaxes constraints where the start is on or slightly beyond a limit, which happens between the
    /// stations of its own plan. `None` if it is too far beyond.
    fn relax_start(&mut self) -> Option<()> {
        let n = self.window.n();
        for k in 0..n {
            let (a, j) = constraint_ratio(&self.window, k, &self.solver.x);
            if a > MAX_START_RATIO.0 || j > MAX_START_RATIO.1 {
                return None;
            }
            let relaxation = |y: f64| {
                if y > 1.0 - START_MARGIN {
                    1.0 / (y * (1.0 + START_MARGIN)).max(1.0)
                } else {
                    1.0
                }
            };
            self.window.relaxation[k] = (relaxation(a), relaxation(j));
        }
        Some(())
    }

    /// Raises the caps that the start exceeds, and penalises the speed there: after a reduced override, or a
    /// joint limit that came later than the plan. Returns whether any cap is exceeded by more than rounding.
    fn relax_caps(&mut self) -> bool {
        let (window, x) = (&mut self.window, &self.solver.x);
        let n = window.n();
        self.goal.clear();
        self.goal.extend_from_slice(&window.cap);
        self.goal.extend_from_slice(&window.middle_cap);
        let mut above = false;
        for k in 0..n {
            let d = window.d[k];
            let middle = middle(window, x, k);
            let (mut excess, mut uses_margin) = (false, false);
            // The caps by axes and chord error, at any feed.
            let here = &window.cells[window.span_index(k)];
            let next = &window.cells[window.span_index(k) + 1];
            let hard = [
                here.points[1].speed_u_s,
                here.points[2].speed_u_s.min(next.points[0].speed_u_s),
            ];
            for (cap, value, hard) in [
                (&mut window.middle_cap[k], middle, hard[0]),
                (&mut window.cap[k + 1], x.a[k + 1], hard[1]),
            ] {
                excess |= value > *cap * (1.0 + MIN_EXCESS);
                let max = if excess {
                    (CAP_FACTOR * value).min(hard * hard)
                } else {
                    value
                };
                uses_margin |= value > *cap;
                *cap = cap.max(max.max(value * (1.0 + START_MARGIN)));
            }
            if uses_margin && !excess {
                // A used-up margin above a cap would be granted again by the next plan, and the next.
                self.solver.constraint_weight[k] *= WEIGHT_FACTOR;
            }
            if excess {
                above = true;
                let goal = self.goal[n + 1 + k].min(self.goal[k + 1]);
                let pull = CAP_PENALTY * d / (goal * goal.sqrt());
                self.solver.pull[k] += 0.5 * pull;
                self.solver.pull[k + 1] += 0.5 * pull;
            }
        }
        above
    }

    /// Decelerates to the caps that were raised, as fast as the limits permit. Where they are reached they
    /// apply again; before that the value reached is the cap.
    fn lower_caps(&mut self) {
        let n = self.window.n();
        for _ in 0..MAX_CAP_ROUNDS {
            self.solver.centre(&self.window, CAP_MU, 2);
            let (window, x) = (&mut self.window, &self.solver.x);
            let mut above = false;
            for k in 0..n {
                let middle = middle(window, x, k);
                for (cap, value, goal) in [
                    (&mut window.middle_cap[k], middle, self.goal[n + 1 + k]),
                    (&mut window.cap[k + 1], x.a[k + 1], self.goal[k + 1]),
                ] {
                    if *cap > goal * (1.0 + MIN_EXCESS) {
                        *cap = (value * CAP_FACTOR).max(goal).min(*cap);
                        above |= *cap > goal;
                    }
                }
            }
            for k in 0..n {
                // The control cap must leave a margin for the value between the stations.
                let control = x.a[k] + window.d[k] * x.b[k];
                if control * (1.0 + MIN_EXCESS) > window.control_cap(k) && control > self.goal[n + 1 + k] {
                    window.middle_cap[k] = control * CAP_FACTOR;
                    above = true;
                } else if control >= window.control_cap(k) * (1.0 - ROUNDING) {
                    window.middle_cap[k] = control * (1.0 + START_MARGIN);
                }
            }
            for k in 0..n {
                // Once everything is within its cap, the penalty ends.
                let near = 1.0 + MIN_EXCESS;
                if window.middle_cap[k] <= near * self.goal[n + 1 + k]
                    && window.cap[k + 1] <= near * self.goal[k + 1]
                {
                    self.solver.pull[k + 1] = 0.0;
                }
            }
            if !above {
                break;
            }
        }
    }
}

/// The remainder of a piece from time `t`.
fn remainder_of_piece(piece: &TimeLawPiece, t: f64) -> TimeLawPiece {
    let (now, jerk) = piece.law.at(t);
    TimeLawPiece {
        law: TimeLaw::ConstantJerk {
            v: now.v,
            a: now.a,
            j: jerk,
        },
        length: piece.length - now.x,
        duration_s: piece.duration_s - t,
        from: piece.from + now.x,
        ..*piece
    }
}

/// The value for which the cap in the middle of interval `k` needs a margin: the value there, or the control
/// value if that does not fit below the caps at the ends either.
fn middle(window: &Window, x: &Iterate, k: usize) -> f64 {
    let d = window.d[k];
    let control = x.a[k] + d * x.b[k];
    let middle = x.a[k] + d * (x.b[k] + 0.25 * d * x.c[k]);
    if control > window.control_cap(k) * (1.0 - START_MARGIN) {
        middle.max(control)
    } else {
        middle
    }
}

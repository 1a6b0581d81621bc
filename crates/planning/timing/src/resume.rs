//! Going on from the last plan.

use crate::barrier::{Iterate, constraint_ratio};
use crate::check::STIFFER;
use crate::closed_form;
use crate::grid::Place;
use crate::optimizer::{MAX_SPANS, Optimizer, WindowProblem};
use crate::piece::Piece;
use crate::solver::KNOWN;
use crate::spans;
use crate::start;
use crate::time_law::TimeLaw;
use crate::warm_start::{Found, WarmStart};
use crate::window::{Span, Window};

/// Least intervals of the distance of a stop, where one is asked for.
const STOP_INTERVALS: f64 = 16.0;
/// Where the motion has to come down to a cap: how strongly against the duration, in at most how many rounds of two
/// steps, at which barrier parameter, and by which factor of `u'^2` the cap of a round lies above it.
const PULL: f64 = 3.0;
const LOWERINGS: usize = 25;
const LOWERING_MU: f64 = 0.01;
const ABOVE: f64 = 1.03;
/// By how much a start may lie beyond the rows of acceleration and jerk.
const MAX_STRAIN: (f64, f64) = (1.001, 1.012);
/// Room that a start on a limit is given, as a share of the limit.
const ROOM: f64 = 1e-4;
/// Rounding of `u'^2`, as a share of it.
const ROUNDING: f64 = 1e-9;
/// By which share of a cap of `u'^2` a start may lie above it before it is brought down.
const EXCESS: f64 = 1e-3;
/// How far within the limits a new crawl has to be, how often a slower one is tried, and at which share.
const CRAWL_STRAIN: f64 = 0.95;
const CRAWLS: usize = 20;
const SLOWER: f64 = 0.3;

impl Optimizer {
    /// A plan that goes on from the last one. Returns the barrier parameter reached; NaN where nothing was left to
    /// be planned, and `out` holds all of it.
    pub(crate) fn continue_from(&mut self, job: &WindowProblem<'_>, out: &mut Vec<Piece>) -> Option<f64> {
        if let Some(gap) = self.lower(job, out) {
            return Some(gap);
        }
        out.clear();
        if !self.resume(job, out)? {
            return Some(f64::NAN);
        }
        Some(self.solver.descend(&self.window, KNOWN, self.centre_steps()))
    }

    /// Sets window and iterate to what is left of the last plan from a place on, and to a crawl on what is new. What
    /// is left of a first stub goes to `out` at once. False where nothing is left to be planned.
    pub(crate) fn resume(&mut self, job: &WindowProblem<'_>, out: &mut Vec<Piece>) -> Option<bool> {
        let WindowProblem {
            grid,
            from,
            until,
            factor,
            ..
        } = *job;
        let found = self.kept.find(grid, from, job.state.0, job.state.1)?;
        let last = self.kept.last?;
        let more = until > self.kept.until;
        self.segments.clear();
        let (mut stub, mut square, mut state) = (last, self.kept.last_a, Some(job.state));
        match found {
            Found::Head(k, t) => {
                let head = self.kept.head.get(k..)?;
                let first = head.first()?;
                let ((now, jerk), gone) = (first.law.at(t), first.law.at(t).0.x);
                out.push(Piece {
                    law: TimeLaw::Jerk {
                        v: now.v,
                        a: now.a,
                        j: jerk,
                    },
                    length: first.length - gone,
                    duration: first.duration - t,
                    from: first.from + gone,
                    ..*first
                });
                out.extend_from_slice(&head[1..]);
                self.kept.rest(0, 0.0, &mut self.segments);
                state = None;
            }
            Found::FirstStub(x) => {
                let span = self.kept.first?;
                let end = self.kept.segments.first()?;
                let cell = grid.cell(span.interval)?;
                let whole = 3.0 * span.length / end.a.sqrt();
                let j = 6.0 * span.length / (whole * whole * whole);
                let share = libm::cbrt(x / span.length);
                let t = share * whole;
                out.push(Piece {
                    law: TimeLaw::Jerk {
                        v: 0.5 * j * t * t,
                        a: j * t,
                        j,
                    },
                    length: span.length - x,
                    duration: whole - t,
                    stretch: cell.stretch,
                    from: cell.from + span.x + x,
                    interval: span.interval,
                });
                self.kept.rest(0, 0.0, &mut self.segments);
                state = None;
            }
            Found::Segment(k, x) => self.kept.rest(k, x, &mut self.segments),
            Found::LastStub(x) => {
                let left = last.length - x;
                stub = Span {
                    x: last.x + x,
                    length: left,
                    ..last
                };
                square = state?.0 * state?.0;
                if !more {
                    let cell = grid.cell(last.interval)?;
                    // The stub's own jerk to its end: exact also where next to nothing is left.
                    let (v, a) = job.state;
                    let whole = 3.0 * last.length / self.kept.last_a.sqrt();
                    let j = 6.0 * last.length / (whole * whole * whole);
                    let duration = -a / j;
                    out.push(Piece {
                        law: TimeLaw::Jerk { v, a, j },
                        length: left,
                        duration,
                        stretch: cell.stretch,
                        from: cell.from + stub.x,
                        interval: last.interval,
                    });
                    self.solver.iterations = 0;
                    return Some(false);
                }
            }
        }
        let old = self.segments.len();
        if more {
            WarmStart::release(stub, square, square / 3.0, &mut self.segments);
        }
        self.window.from_rest = false;
        self.window.spans.clear();
        self.window
            .spans
            .extend(self.segments.iter().map(|segment| segment.span));
        if more {
            spans::plain(
                grid,
                Place {
                    interval: self.kept.until,
                    x: 0.0,
                },
                until,
                &mut self.window.spans,
            );
            self.grade(job, true);
            self.balance(false);
        } else {
            self.window.spans.push(last);
        }
        if let Some((v, a)) = state
            && job.quick
        {
            let reach = closed_form::reach(grid, from, v, a, until);
            let stub = self.window.spans.pop()?;
            let room = MAX_SPANS - 1;
            spans::subdivide(
                &mut self.window.spans,
                1.2 * reach,
                reach / STOP_INTERVALS,
                room,
                &mut self.scratch,
            );
            self.window.spans.push(stub);
        }
        if self.window.spans.len() < 2 || !self.window.fetch(grid) {
            return None;
        }
        self.window.pack(&self.limits, factor, job.gentle);
        let n = self.window.n();
        self.solver.begin(n);
        if more {
            let mut level = square / 3.0;
            let released = start::fill(&self.window, &self.segments[..old], &mut self.solver.x);
            let fresh = start::fill(&self.window, &self.segments, &mut self.solver.x);
            if fresh >= n {
                // No station left between the crawl and the last stub: the window is full.
                return None;
            }
            level = level.min(start::crawl_level(&self.window, fresh, &self.limits));
            let mut fits = false;
            for _ in 0..CRAWLS {
                self.segments.truncate(old);
                WarmStart::release(stub, square, level, &mut self.segments);
                let fresh = start::fill(&self.window, &self.segments, &mut self.solver.x);
                start::crawl_to_end(&self.window, fresh, level, start::FADE, &mut self.solver.x);
                if (released..n).all(|k| {
                    let (a, j) = constraint_ratio(&self.window, k, &self.solver.x);
                    a.max(j) < CRAWL_STRAIN
                }) && -self.solver.x.b[n] < CRAWL_STRAIN * self.window.end.most
                {
                    fits = true;
                    break;
                }
                level *= SLOWER;
            }
            if !fits {
                return None;
            }
        } else {
            start::fill(&self.window, &self.segments, &mut self.solver.x);
            self.solver.x.a[n] = square;
            self.solver.x.b[n] = -square / (1.5 * last.length);
            self.window.end.most = self.window.end.most.max(-(1.0 + ROOM) * self.solver.x.b[n]);
        }
        self.loosen()?;
        let above = self.relax_caps();
        self.window.lifted = above;
        if let Some((v, a)) = state {
            let by = (v * v - self.solver.x.a[0], a - self.solver.x.b[0]);
            if by != (0.0, 0.0) {
                self.solver.steer(&self.window, by);
            }
        }
        if !self.solver.feasible(&self.window) {
            return None;
        }
        self.solver.mark();
        if above {
            self.lower_caps();
        }
        Some(true)
    }

    /// Makes room where the start lies on or slightly beyond a limit: between the stations of the plan that it comes
    /// from. `None` where it lies too far beyond.
    fn loosen(&mut self) -> Option<()> {
        let n = self.window.n();
        for k in 0..n {
            let (a, j) = constraint_ratio(&self.window, k, &self.solver.x);
            if a > MAX_STRAIN.0 || j > MAX_STRAIN.1 {
                return None;
            }
            let loose = |y: f64| {
                if y > 1.0 - ROOM {
                    1.0 / (y * (1.0 + ROOM)).max(1.0)
                } else {
                    1.0
                }
            };
            self.window.loose[k] = (loose(a), loose(j));
        }
        Some(())
    }

    /// Lifts the caps that the start exceeds above it, and pulls the motion down there: an override was lowered, or a
    /// joint's bound came later than the plan. Says whether it exceeds any by more than rounding.
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
            let (mut excess, mut creeps) = (false, false);
            // What the axes and the chord error allow, whatever the feed.
            let here = &window.cells[window.span_index(k)];
            let next = &window.cells[window.span_index(k) + 1];
            let hard = [
                here.points[1].speed,
                here.points[2].speed.min(next.points[0].speed),
            ];
            for (cap, value, hard) in [
                (&mut window.middle_cap[k], middle, hard[0]),
                (&mut window.cap[k + 1], x.a[k + 1], hard[1]),
            ] {
                excess |= value > *cap * (1.0 + EXCESS);
                let most = if excess {
                    (ABOVE * value).min(hard * hard)
                } else {
                    value
                };
                creeps |= value > *cap;
                *cap = cap.max(most.max(value * (1.0 + ROOM)));
            }
            if creeps && !excess {
                // Room above a cap that is used up would be given again by the next plan, and the next.
                self.solver.stiff[k] *= STIFFER;
            }
            if excess {
                above = true;
                let goal = self.goal[n + 1 + k].min(self.goal[k + 1]);
                let pull = PULL * d / (goal * goal.sqrt());
                self.solver.pull[k] += 0.5 * pull;
                self.solver.pull[k + 1] += 0.5 * pull;
            }
        }
        above
    }

    /// Brings the motion down to the caps that were lifted, as fast as the limits allow; where that is, they hold
    /// again, and before it what was reached is the cap.
    fn lower_caps(&mut self) {
        let n = self.window.n();
        for _ in 0..LOWERINGS {
            self.solver.centre(&self.window, LOWERING_MU, 2);
            let (window, x) = (&mut self.window, &self.solver.x);
            let mut above = false;
            for k in 0..n {
                let middle = middle(window, x, k);
                for (cap, value, goal) in [
                    (&mut window.middle_cap[k], middle, self.goal[n + 1 + k]),
                    (&mut window.cap[k + 1], x.a[k + 1], self.goal[k + 1]),
                ] {
                    if *cap > goal * (1.0 + EXCESS) {
                        *cap = (value * ABOVE).max(goal).min(*cap);
                        above |= *cap > goal;
                    }
                }
            }
            for k in 0..n {
                // Caps that fall with the ends must leave the way between them.
                let control = x.a[k] + window.d[k] * x.b[k];
                if control * (1.0 + EXCESS) > window.control_cap(k) && control > self.goal[n + 1 + k] {
                    window.middle_cap[k] = control * ABOVE;
                    above = true;
                } else if control >= window.control_cap(k) * (1.0 - ROUNDING) {
                    window.middle_cap[k] = control * (1.0 + ROOM);
                }
            }
            for k in 0..n {
                // Once all is within its cap there, nothing need pull any more.
                let near = 1.0 + EXCESS;
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

/// What the cap in the middle of interval `k` has to leave room for: the speed there, or the greatest that the
/// interval may reach, where that does not fit below the caps at its ends either.
fn middle(window: &Window, x: &Iterate, k: usize) -> f64 {
    let d = window.d[k];
    let control = x.a[k] + d * x.b[k];
    let middle = x.a[k] + d * (x.b[k] + 0.25 * d * x.c[k]);
    if control > window.control_cap(k) * (1.0 - ROOM) {
        middle.max(control)
    } else {
        middle
    }
}

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

/// What is left of the last plan besides its segments.
struct Rest {
    /// Of the last stub.
    stub: Span,
    /// `u'^2` where that begins.
    square: f64,
    /// The state with which the segments begin; none where pieces in closed form come before them.
    state: Option<(f64, f64)>,
}

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
        let found = self.kept.find(job.grid, job.from, job.state.0, job.state.1)?;
        let last = self.kept.last?;
        let more = job.until > self.kept.until;
        self.segments.clear();
        if let Found::LastStub(x) = found
            && !more
        {
            out.push(self.rest_of_last_stub(job, &last, x)?);
            self.solver.iterations = 0;
            return Some(false);
        }
        let rest = self.take_rest(job, found, &last, out)?;
        let old = self.segments.len();
        if more {
            WarmStart::release(rest.stub, rest.square, rest.square / 3.0, &mut self.segments);
        }
        self.divide(job, (!more).then_some(last));
        if let Some(state) = rest.state
            && job.quick
        {
            self.divide_for_stop(job, state)?;
        }
        if self.window.spans.len() < 2 || !self.window.fetch(job.grid) {
            return None;
        }
        self.window.pack(&self.limits, job.factor, job.gentle);
        self.solver.begin(self.window.n());
        if more {
            self.crawl_beyond(&rest, old)?;
        } else {
            self.keep_last_stub(&last, rest.square);
        }
        self.enter_limits(rest.state)?;
        Some(true)
    }

    /// The piece to rest, where nothing but a part of the last stub is left, from offset `x` on.
    fn rest_of_last_stub(&self, job: &WindowProblem<'_>, last: &Span, x: f64) -> Option<Piece> {
        let cell = job.grid.cell(last.interval)?;
        // The stub's own jerk to its end: exact also where next to nothing is left.
        let (v, a) = job.state;
        let whole = 3.0 * last.length / self.kept.last_a.sqrt();
        let j = 6.0 * last.length / (whole * whole * whole);
        let duration = -a / j;
        Some(Piece {
            law: TimeLaw::Jerk { v, a, j },
            length: last.length - x,
            duration,
            stretch: cell.stretch,
            from: cell.from + (last.x + x),
            interval: last.interval,
        })
    }

    /// Takes what is left of the last plan: pieces in closed form into `out`, segments into those of the new plan.
    fn take_rest(
        &mut self,
        job: &WindowProblem<'_>,
        found: Found,
        last: &Span,
        out: &mut Vec<Piece>,
    ) -> Option<Rest> {
        let whole = |state| Rest {
            stub: *last,
            square: self.kept.last_a,
            state,
        };
        match found {
            Found::Head(k, t) => {
                let rest = whole(None);
                let head = self.kept.head.get(k..)?;
                out.push(rest_of_piece(head.first()?, t));
                out.extend_from_slice(&head[1..]);
                self.kept.rest(0, 0.0, &mut self.segments);
                Some(rest)
            }
            Found::FirstStub(x) => {
                let rest = whole(None);
                out.push(self.rest_of_first_stub(job, x)?);
                self.kept.rest(0, 0.0, &mut self.segments);
                Some(rest)
            }
            Found::Segment(k, x) => {
                let rest = whole(Some(job.state));
                self.kept.rest(k, x, &mut self.segments);
                Some(rest)
            }
            Found::LastStub(x) => Some(Rest {
                stub: Span {
                    x: last.x + x,
                    length: last.length - x,
                    ..*last
                },
                square: job.state.0 * job.state.0,
                state: Some(job.state),
            }),
        }
    }

    /// What is left of the first stub from offset `x` on.
    fn rest_of_first_stub(&self, job: &WindowProblem<'_>, x: f64) -> Option<Piece> {
        let span = self.kept.first?;
        let end = self.kept.segments.first()?;
        let cell = job.grid.cell(span.interval)?;
        let whole = 3.0 * span.length / end.a.sqrt();
        let j = 6.0 * span.length / (whole * whole * whole);
        let share = libm::cbrt(x / span.length);
        let t = share * whole;
        Some(Piece {
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
        })
    }

    /// Divides the window: the segments as they are, then the new path, or the last stub where there is none.
    fn divide(&mut self, job: &WindowProblem<'_>, last: Option<Span>) {
        let spans = &mut self.window.spans;
        self.window.from_rest = false;
        spans.clear();
        spans.extend(self.segments.iter().map(|segment| segment.span));
        if let Some(last) = last {
            spans.push(last);
            return;
        }
        let new = Place {
            interval: self.kept.until,
            x: 0.0,
        };
        spans::plain(job.grid, new, job.until, spans);
        self.grade(job, true);
        self.balance(false);
    }

    /// Divides the way of a stop more finely.
    fn divide_for_stop(&mut self, job: &WindowProblem<'_>, (v, a): (f64, f64)) -> Option<()> {
        let reach = closed_form::reach(job.grid, job.from, v, a, job.until);
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
        Some(())
    }

    /// Sets the iterate to the first `old` segments, the last stub gone through without coming to rest, and a crawl
    /// behind it that keeps the limits. `None` where no crawl that was tried does, or the window is full.
    fn crawl_beyond(&mut self, rest: &Rest, old: usize) -> Option<()> {
        let n = self.window.n();
        let mut level = rest.square / 3.0;
        let released = start::fill(&self.window, &self.segments[..old], &mut self.solver.x);
        let fresh = start::fill(&self.window, &self.segments, &mut self.solver.x);
        if fresh >= n {
            // No station left between the crawl and the last stub: the window is full.
            return None;
        }
        level = level.min(start::crawl_level(&self.window, fresh, &self.limits));
        for _ in 0..CRAWLS {
            self.segments.truncate(old);
            WarmStart::release(rest.stub, rest.square, level, &mut self.segments);
            let fresh = start::fill(&self.window, &self.segments, &mut self.solver.x);
            start::crawl_to_end(&self.window, fresh, level, start::FADE, &mut self.solver.x);
            if self.crawl_fits(released) {
                return Some(());
            }
            level *= SLOWER;
        }
        None
    }

    /// Whether the iterate keeps well within the limits from station `first` on.
    fn crawl_fits(&self, first: usize) -> bool {
        let (window, x, n) = (&self.window, &self.solver.x, self.window.n());
        (first..n).all(|k| {
            let (a, j) = constraint_ratio(window, k, x);
            a.max(j) < CRAWL_STRAIN
        }) && -x.b[n] < CRAWL_STRAIN * window.end.most
    }

    /// Sets the iterate to the segments and the last stub behind them.
    fn keep_last_stub(&mut self, last: &Span, square: f64) {
        let n = self.window.n();
        start::fill(&self.window, &self.segments, &mut self.solver.x);
        self.solver.x.a[n] = square;
        self.solver.x.b[n] = -square / (1.5 * last.length);
        self.window.end.most = self.window.end.most.max(-(1.0 + ROOM) * self.solver.x.b[n]);
    }

    /// Makes the start feasible: room at limits that it lies on, caps that it exceeds lifted and lowered again, and
    /// the state given, where rounding tells it from the last plan's.
    fn enter_limits(&mut self, state: Option<(f64, f64)>) -> Option<()> {
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
        Some(())
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

/// What is left of a piece from time `t` on.
fn rest_of_piece(piece: &Piece, t: f64) -> Piece {
    let (now, jerk) = piece.law.at(t);
    Piece {
        law: TimeLaw::Jerk {
            v: now.v,
            a: now.a,
            j: jerk,
        },
        length: piece.length - now.x,
        duration: piece.duration - t,
        from: piece.from + now.x,
        ..*piece
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

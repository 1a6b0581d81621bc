//! The planner of one window.

use crate::barrier::strain;
use crate::check::check as check_between;
use crate::error::FeedError;
use crate::grid::{Grid, Place};
use crate::kept::{Found, Kept, Segment};
use crate::law::Law;
use crate::limits::PathLimits;
use crate::profile::Profile;
use crate::solver::{LAST, Solver};
use crate::spans;
use crate::start;
use crate::stop;
use crate::window::{Span, Window};

/// Most intervals of one window, so that a re-plan of three axes stays below 5 ms.
pub const MOST_INTERVALS: usize = 320;
/// Spans that the ends of a window may be divided into beyond its intervals.
const MORE_SPANS: usize = 200;
/// Share of the jerk limit that the last stub of an open window may use.
const GENTLE: f64 = 0.25;
/// Most Newton steps of one plan from rest.
const MOST_STEPS: u32 = 200;
/// Most rounds of checking and correcting, and steps of each.
const POLISHES: usize = 4;
const POLISH_STEPS: u32 = 8;
/// Share of its speed that a stop comes down to before it is brought to rest in closed form.
const CRAWL_SHARE: f64 = 0.03;
/// Least intervals of the distance of a stop, where one is asked for.
const STOP_INTERVALS: f64 = 16.0;
/// Places of each interval from which a stop in closed form is tried.
const STOP_PARTS: u32 = 4;
/// Where the motion has to come down to a cap: how strongly against the duration, in at most how many rounds of two
/// steps, at which barrier parameter, and by which factor of `u'^2` the cap of a round lies above it.
const PULL: f64 = 3.0;
const LOWERINGS: usize = 25;
const LOWERING_MU: f64 = 0.01;
const ABOVE: f64 = 1.03;
/// By how much a start may lie beyond the rows of acceleration and jerk.
const MOST_STRAIN: (f64, f64) = (1.001, 1.012);
/// Room that a start on a limit is given, as a share of the limit.
const ROOM: f64 = 1e-4;
/// By which share of a cap of `u'^2` a start may lie above it before it is brought down.
const EXCESS: f64 = 1e-3;

/// A part of the time law: contiguous with its neighbours, the last one ends at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// How the parameter runs.
    pub law: Law,
    /// Length in parameter units.
    pub length: f64,
    /// Duration in s.
    pub duration: f64,
    /// Absolute index of the stretch that it lies in.
    pub stretch: u64,
    /// Offset of its start from the stretch's.
    pub from: f64,
    /// Absolute index of its grid interval.
    pub interval: u64,
}

/// How a plan begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Entry {
    /// At rest.
    Rest,
    /// Moving with this speed and acceleration of the parameter.
    Moving {
        /// Speed, per s.
        v: f64,
        /// Acceleration, per s2.
        a: f64,
    },
}

/// How a plan ends: always at rest at the very end of its window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// The motion is meant to rest there: as fast as the limits allow.
    Rest,
    /// More path will follow: the last interval is gone through gently enough for the motion to go on instead.
    Open,
}

/// The largest ratio of what an axis does to its limit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ratios {
    /// Velocity of an axis, or of the feed.
    pub velocity: f64,
    /// Acceleration.
    pub acceleration: f64,
    /// Jerk.
    pub jerk: f64,
}

/// What a plan came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanReport {
    /// Newton steps.
    pub iterations: u32,
    /// By what share of its duration the plan may at most be slower than the optimum on its stations, as the
    /// barrier's parameter tells (exact for a convex problem).
    pub gap: f64,
    /// Seconds.
    pub duration: f64,
    /// Stations of the window.
    pub stations: usize,
    /// Whether the last plan served as the start.
    pub warm: bool,
    /// The largest ratios found by the check between stations.
    pub worst: Ratios,
}

/// What a stop came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopReport {
    /// Seconds until rest.
    pub duration: f64,
    /// Parameter length until rest.
    pub length: f64,
    /// Newton steps; none where the closed form served.
    pub iterations: u32,
    /// The largest ratios found by the check between stations.
    pub worst: Ratios,
}

/// Plans windows of a [`Grid`].
#[derive(Clone, Debug)]
pub struct Optimizer {
    limits: PathLimits,
    window: Window,
    solver: Solver,
    guess: Vec<f64>,
    scratch: Vec<Span>,
    segments: Vec<Segment>,
    goal: Vec<f64>,
    kept: Kept,
}

impl Optimizer {
    /// Allocates for the largest window.
    #[must_use]
    pub fn new(limits: &PathLimits) -> Self {
        let stations = MOST_INTERVALS + MORE_SPANS;
        Self {
            limits: limits.clone(),
            window: Window::with_capacity(stations),
            solver: Solver::with_capacity(stations),
            guess: Vec::with_capacity(stations + 1),
            scratch: Vec::with_capacity(stations + 2),
            segments: Vec::with_capacity(stations),
            goal: Vec::with_capacity(2 * stations + 1),
            kept: Kept::with_capacity(stations),
        }
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
        let gentle = if exit == Exit::Open { GENTLE } else { 1.0 };
        let found = match entry {
            Entry::Rest => self.from_rest(grid, from, until, feed_factor, gentle),
            Entry::Moving { v, a } => self.from_motion(grid, from, (v, a), until, feed_factor, gentle, out),
        };
        let Some(gap) = found else {
            self.kept.valid = false;
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
            worst = self.polish(grid, feed_factor);
            self.write(out);
            self.kept.keep(&self.window, &self.solver.x, until, feed_factor);
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

    /// Checks between stations and keeps away from the limits where that finds them exceeded.
    fn polish(&mut self, grid: &Grid, factor: f64) -> Ratios {
        let mut worst = Ratios::default();
        for _ in 0..POLISHES {
            let (found, raised) =
                check_between(&self.window, grid, factor, &self.solver.x, &mut self.solver.stiff);
            worst = found;
            if !raised {
                break;
            }
            self.solver.descend(&self.window, LAST, POLISH_STEPS);
        }
        worst
    }

    /// A plan without anything to start from. Returns the barrier parameter reached.
    fn from_rest(&mut self, grid: &Grid, from: Place, until: u64, factor: f64, gentle: f64) -> Option<f64> {
        self.window.from_rest = true;
        self.window.spans.clear();
        spans::plain(grid, from, until, &mut self.window.spans);
        for reverse in [false, true] {
            self.grade(grid, factor, reverse);
        }
        self.balance(true);
        if self.window.spans.len() < 3 || !self.window.fetch(grid) {
            return None;
        }
        self.window.pack(&self.limits, factor, gentle);
        self.solver.begin(self.window.n());
        let mut level = start::crawl_level(&self.window, 0, &self.limits);
        for _ in 0..40 {
            start::crawl(&self.window, level, &mut self.solver.x);
            if self.solver.feasible(&self.window) {
                start::guess(&self.window, &self.limits, 0.0, &mut self.guess);
                self.solver.lift(&self.window, &self.guess, 30);
                return Some(self.solver.descend(&self.window, Solver::first(), MOST_STEPS));
            }
            level *= 0.3;
        }
        None
    }

    /// Lets lengths change gently between the stubs.
    fn balance(&mut self, first: bool) {
        let spans = &mut self.window.spans;
        let (stub, count) = (spans.pop(), spans.len());
        let first = (first && count > 0).then(|| spans.remove(0));
        spans::balance(spans, MOST_INTERVALS + MORE_SPANS - 2, &mut self.scratch);
        if let Some(first) = first {
            spans.insert(0, first);
        }
        spans.extend(stub);
    }

    fn grade(&mut self, grid: &Grid, factor: f64, reverse: bool) {
        let room = MOST_INTERVALS + MORE_SPANS;
        spans::grade(
            &mut self.window,
            grid,
            &self.limits,
            factor,
            reverse,
            room,
            &mut self.scratch,
        );
    }

    /// A plan that goes on from the last one. Returns the barrier parameter reached; NaN where nothing was left to
    /// be planned.
    fn from_motion(
        &mut self,
        grid: &Grid,
        from: Place,
        state: (f64, f64),
        until: u64,
        factor: f64,
        gentle: f64,
        out: &mut Vec<Piece>,
    ) -> Option<f64> {
        if !self.resume(
            grid,
            from,
            state,
            until,
            factor,
            gentle,
            factor < self.kept.factor,
            out,
        )? {
            return Some(f64::NAN);
        }
        if until > self.kept.until {
            let first_a = self.solver.x.a[0];
            start::guess(&self.window, &self.limits, first_a, &mut self.guess);
            self.solver.lift(&self.window, &self.guess, 30);
        }
        Some(self.solver.descend(&self.window, Solver::first(), MOST_STEPS))
    }

    /// `quick` asks for stations close enough for a stop or a fall of speed at once.
    ///
    /// Sets window and iterate to what is left of the last plan from a place on, and to a crawl on what is new. False
    /// where nothing is left to be planned.
    fn resume(
        &mut self,
        grid: &Grid,
        from: Place,
        state: (f64, f64),
        until: u64,
        factor: f64,
        gentle: f64,
        quick: bool,
        out: &mut Vec<Piece>,
    ) -> Option<bool> {
        let found = self.kept.find(from, state.0, state.1)?;
        let last = self.kept.last?;
        let more = until > self.kept.until;
        self.segments.clear();
        let (mut stub, mut square, mut state) = (last, self.kept.last_a, Some(state));
        match found {
            Found::FirstStub(x) => {
                let span = self.kept.first?;
                let end = self.kept.segments.first()?;
                let cell = grid.cell(span.interval)?;
                let whole = 3.0 * span.length / end.a.sqrt();
                let j = 6.0 * span.length / (whole * whole * whole);
                let share = libm::cbrt(x / span.length);
                let t = share * whole;
                out.push(Piece {
                    law: Law::Jerk {
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
                    let v = square.sqrt();
                    let duration = 3.0 * left / v;
                    out.push(Piece {
                        law: Law::Jerk {
                            v,
                            a: -2.0 * v / duration,
                            j: 2.0 * v / (duration * duration),
                        },
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
            Kept::release(stub, square, square / 3.0, &mut self.segments);
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
            self.grade(grid, factor, true);
            self.balance(false);
        } else {
            self.window.spans.push(last);
        }
        if let Some((v, a)) = state
            && quick
        {
            let reach = stop::reach(grid, from, v, a, until);
            let stub = self.window.spans.pop()?;
            let room = MOST_INTERVALS + MORE_SPANS - 1;
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
        self.window.pack(&self.limits, factor, gentle);
        let n = self.window.n();
        self.solver.begin(n);
        if more {
            let mut level = square / 3.0;
            let released = start::fill(&self.window, &self.segments[..old], &mut self.solver.x);
            let fresh = start::fill(&self.window, &self.segments, &mut self.solver.x);
            level = level.min(start::crawl_level(&self.window, fresh, &self.limits));
            let mut fits = false;
            for _ in 0..20 {
                self.segments.truncate(old);
                Kept::release(stub, square, level, &mut self.segments);
                let fresh = start::fill(&self.window, &self.segments, &mut self.solver.x);
                start::crawl_to_end(&self.window, fresh, level, &mut self.solver.x);
                if (released..n).all(|k| {
                    let (a, j) = strain(&self.window, k, &self.solver.x);
                    a.max(j) < 0.95
                }) && -self.solver.x.b[n] < 0.95 * self.window.end.most
                {
                    fits = true;
                    break;
                }
                level *= 0.3;
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
        let above = self.lift_caps();
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
            let (a, j) = strain(&self.window, k, &self.solver.x);
            if a > MOST_STRAIN.0 || j > MOST_STRAIN.1 {
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
    fn lift_caps(&mut self) -> bool {
        let (window, x) = (&mut self.window, &self.solver.x);
        let n = window.n();
        self.goal.clear();
        self.goal.extend_from_slice(&window.cap);
        self.goal.extend_from_slice(&window.middle_cap);
        let mut above = false;
        for k in 0..n {
            let d = window.d[k];
            let middle = x.a[k] + d * (x.b[k] + 0.25 * d * x.c[k]);
            let mut excess = false;
            for (cap, value) in [
                (&mut window.middle_cap[k], middle),
                (&mut window.cap[k + 1], x.a[k + 1]),
            ] {
                excess |= value > *cap * (1.0 + EXCESS);
                let room = if excess { ABOVE } else { 1.0 + ROOM };
                *cap = cap.max(value * room);
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
                let d = window.d[k];
                let middle = x.a[k] + d * (x.b[k] + 0.25 * d * x.c[k]);
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
                // Once all is within its cap there, nothing need pull any more.
                if window.middle_cap[k] <= self.goal[n + 1 + k] && window.cap[k + 1] <= self.goal[k + 1] {
                    self.solver.pull[k + 1] = 0.0;
                }
            }
            if !above {
                break;
            }
        }
    }

    /// The iterate as pieces.
    fn write(&self, out: &mut Vec<Piece>) {
        let (window, x) = (&self.window, &self.solver.x);
        let n = window.n();
        let lead = usize::from(window.from_rest);
        for (i, (span, cell)) in window.spans.iter().zip(&window.cells).enumerate() {
            let length = span.length;
            let (law, duration) = if i < lead {
                // v = 3 x / t at the far end.
                let duration = 3.0 * length / x.a[0].sqrt();
                (
                    Law::Jerk {
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
                    Law::Jerk {
                        v,
                        a: -2.0 * v / duration,
                        j: 2.0 * v / (duration * duration),
                    },
                    duration,
                )
            } else {
                let k = i - lead;
                let law = Law::Flow {
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

    /// Comes to rest as soon as the axes allow, before the end of interval `until - 1`. Cycle: no.
    ///
    /// # Errors
    /// See [`FeedError`]; `out` is then empty and the plan before, which ends at rest, stays valid.
    #[expect(
        clippy::too_many_arguments,
        reason = "one call with all that a stop depends on"
    )]
    pub fn stop(
        &mut self,
        grid: &Grid,
        from: Place,
        v: f64,
        a: f64,
        until: u64,
        out: &mut Vec<Piece>,
    ) -> Result<StopReport, FeedError> {
        out.clear();
        check(grid, from, until, v, a, 1.0)?;
        let none = FeedError::NoMotion {
            interval: from.interval,
            x: from.x,
            v,
            a,
        };
        self.solver.iterations = 0;
        let mut worst = self.quick_stop(grid, from, (v, a), until, stop::FEW_SHARES, out);
        if worst.is_none() {
            worst = self.best_stop(grid, from, (v, a), until, out);
        }
        if worst.is_none() {
            worst = self.quick_stop(grid, from, (v, a), until, stop::ALL_SHARES, out);
        }
        self.kept.valid = false;
        let Some(worst) = worst else {
            out.clear();
            return Err(none);
        };
        Ok(StopReport {
            duration: out.iter().map(|piece| piece.duration).sum(),
            length: out.iter().map(|piece| piece.length).sum(),
            iterations: self.solver.iterations,
            worst,
        })
    }

    /// A stop in closed form.
    fn quick_stop(
        &mut self,
        grid: &Grid,
        from: Place,
        state: (f64, f64),
        until: u64,
        shares: usize,
        out: &mut Vec<Piece>,
    ) -> Option<Ratios> {
        out.clear();
        let (profile, worst) = stop::brake(grid, from, state.0, state.1, until, shares)?;
        stop::write(grid, from, until, &profile, out).then_some(worst)
    }

    /// A stop by the solver: what is left of the last plan, slowed down as much as the limits allow, to where a stop
    /// in closed form does the rest.
    fn best_stop(
        &mut self,
        grid: &Grid,
        from: Place,
        state: (f64, f64),
        until: u64,
        out: &mut Vec<Piece>,
    ) -> Option<Ratios> {
        out.clear();
        let until = until.min(self.kept.until);
        if !self.resume(grid, from, state, self.kept.until, 2.0, 1.0, true, out)? {
            return Some(Ratios::default());
        }
        let n = self.window.n();
        // What it costs to be faster than a crawl, against the duration's gain.
        let crawl = CRAWL_SHARE * state.0;
        let scale = 1.5 / (crawl * crawl * crawl);
        for k in 0..n {
            for at in [k, k + 1] {
                self.solver.pull[at] += 0.5 * scale * self.window.d[k];
            }
        }
        self.solver.descend(&self.window, Solver::first(), MOST_STEPS);
        let mut worst = self.polish(grid, 2.0);
        let head = out.len();
        self.write(out);
        // The quickest change to a stop in closed form, from any of several places of each interval.
        let mut best: Option<(usize, f64, Profile, Ratios, f64)> = None;
        let whole: f64 = out[head..].iter().map(|piece| piece.duration).sum();
        let mut begin = 0.0;
        for k in 0..n {
            let (piece, span) = (out[head + k], self.window.spans[k]);
            for part in 0..STOP_PARTS {
                let t = piece.duration * f64::from(part) / f64::from(STOP_PARTS);
                let state = piece.law.at(t).0;
                let place = Place {
                    interval: span.interval,
                    x: span.x + state.x,
                };
                if begin + t >= best.as_ref().map_or(whole, |found| found.4) {
                    continue;
                }
                let found = stop::brake(grid, place, state.v, state.a, until, stop::ALL_SHARES);
                if let Some((profile, ratios)) = found {
                    let end = begin + t + profile.duration();
                    if end < best.as_ref().map_or(whole, |found| found.4) {
                        best = Some((k, t, profile, ratios, end));
                    }
                }
            }
            begin += piece.duration;
        }
        let Some((k, t, profile, ratios, _)) = best else {
            return Some(worst);
        };
        out.truncate(head + k + 1);
        let piece = out.last_mut()?;
        let length = piece.law.at(t).0.x;
        (piece.duration, piece.length) = (t, length);
        if length <= 0.0 {
            out.pop();
        }
        let span = self.window.spans[k];
        let place = Place {
            interval: span.interval,
            x: span.x + length,
        };
        worst.include(&ratios);
        stop::write(grid, place, until, &profile, out).then_some(worst)
    }
}

/// Refuses what is not on the grid, too large or not a number.
fn check(grid: &Grid, from: Place, until: u64, v: f64, a: f64, factor: f64) -> Result<(), FeedError> {
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
    let (intervals, most) = (until - from.interval, MOST_INTERVALS as u64);
    if intervals > most {
        return Err(FeedError::Window { intervals, most });
    }
    if v >= 0.0 && v.is_finite() && a.is_finite() && (0.001..=2.0).contains(&factor) {
        Ok(())
    } else {
        Err(FeedError::State { v, a, factor })
    }
}

//! The planner of one window.

use crate::error::FeedError;
use crate::grid::{Grid, Place};
use crate::law::Law;
use crate::limits::PathLimits;
use crate::solver::Solver;
use crate::spans;
use crate::start;
use crate::window::{Span, Window};

/// Most intervals of one window, so that a re-plan of three axes stays below 5 ms.
pub const MOST_INTERVALS: usize = 320;
/// Spans that the ends of a window may be divided into beyond its intervals.
const MORE_SPANS: usize = 200;
/// Share of the jerk limit that the last stub of an open window may use.
const GENTLE: f64 = 0.25;
/// Most Newton steps of one plan from rest.
const MOST_STEPS: u32 = 200;

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
        let none = FeedError::NoMotion {
            interval: from.interval,
            x: from.x,
            v,
            a,
        };
        if entry != Entry::Rest {
            return Err(none);
        }
        let gentle = if exit == Exit::Open { GENTLE } else { 1.0 };
        self.window.from_rest = true;
        self.window.spans.clear();
        spans::plain(grid, from, until, &mut self.window.spans);
        let room = MOST_INTERVALS + MORE_SPANS;
        for reverse in [false, true] {
            spans::grade(
                &mut self.window,
                grid,
                &self.limits,
                feed_factor,
                reverse,
                room,
                &mut self.scratch,
            );
        }
        if self.window.spans.len() < 3 || !self.window.fetch(grid) {
            return Err(none);
        }
        self.window.pack(&self.limits, feed_factor, gentle);
        self.solver.iterations = 0;
        self.solver.stiff.clear();
        self.solver.x.reset(self.window.n());
        let mut level = start::crawl_level(&self.window, 0, &self.limits);
        let mut found = false;
        for _ in 0..40 {
            start::crawl(&self.window, level, &mut self.solver.x);
            if self.solver.feasible(&self.window) {
                found = true;
                break;
            }
            level *= 0.3;
        }
        if !found {
            return Err(none);
        }
        start::guess(&self.window, &self.limits, 0.0, &mut self.guess);
        self.solver.lift(&self.window, &self.guess, 30);
        let gap = self.solver.descend(&self.window, Solver::first(), MOST_STEPS);
        self.write(out);
        Ok(PlanReport {
            iterations: self.solver.iterations,
            gap,
            duration: out.iter().map(|piece| piece.duration).sum(),
            stations: self.window.n() + 1,
            warm: false,
            worst: Ratios::default(),
        })
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
        Err(FeedError::NoMotion {
            interval: from.interval,
            x: from.x,
            v,
            a,
        })
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

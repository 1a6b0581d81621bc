//! Coming to rest as soon as possible.

use crate::error::FeedError;
use crate::grid::{Grid, Place};
use crate::optimizer::{Optimizer, WindowProblem, check};
use crate::piece::{Piece, Ratios, StopReport};
use crate::profile::Profile;
use crate::solver::FIRST;
use crate::stop;

/// Share of its speed that a stop comes down to before it is brought to rest in closed form.
const CRAWL_FRACTION: f64 = 0.03;
/// Places of each interval from which a stop in closed form is tried.
const STOP_PARTS: u32 = 4;

impl Optimizer {
    /// Comes to rest as soon as the axes allow, before the end of interval `until - 1`. Cycle: no.
    ///
    /// # Errors
    /// See [`FeedError`]; `out` is then empty and the plan before, which ends at rest, stays valid.
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
        let job = WindowProblem {
            grid,
            from,
            state: (v, a),
            until,
            factor: 2.0,
            gentle: 1.0,
            quick: true,
            whole: false,
        };
        let none = FeedError::NoMotion {
            interval: from.interval,
            x: from.x,
            v,
            a,
        };
        self.solver.iterations = 0;
        self.limit_stop();
        let mut worst = self.quick_stop(&job, stop::FEW_SHARES, out);
        if worst.is_none() {
            worst = self.best_stop(&job, out);
        }
        if worst.is_none() {
            worst = self.quick_stop(&job, stop::ALL_SHARES, out);
        }
        self.kept.forget();
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
    fn quick_stop(&mut self, job: &WindowProblem<'_>, shares: usize, out: &mut Vec<Piece>) -> Option<Ratios> {
        out.clear();
        let WindowProblem {
            grid, from, until, ..
        } = *job;
        let (profile, worst) = stop::brake(grid, from, job.state.0, job.state.1, until, shares)?;
        stop::write(grid, from, until, &profile, out).then_some(worst)
    }

    /// A stop by the solver: what is left of the last plan, slowed down as much as the limits allow, to where a stop
    /// in closed form does the rest.
    fn best_stop(&mut self, job: &WindowProblem<'_>, out: &mut Vec<Piece>) -> Option<Ratios> {
        out.clear();
        let (grid, state) = (job.grid, job.state);
        if !self.kept.valid {
            return None;
        }
        let until = job.until.min(self.kept.until);
        let whole = WindowProblem {
            until: self.kept.until,
            ..*job
        };
        if !self.resume(&whole, out)? {
            return Some(Ratios::default());
        }
        let n = self.window.n();
        // What it costs to be faster than a crawl, against the duration's gain.
        let feasible_start = CRAWL_FRACTION * state.0;
        let scale = 1.5 / (feasible_start * feasible_start * feasible_start);
        for k in 0..n {
            for at in [k, k + 1] {
                self.solver.pull[at] += 0.5 * scale * self.window.d[k];
            }
        }
        self.solver.descend(&self.window, FIRST, self.centre_steps());
        let mut worst = self.refine(grid, job.factor);
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

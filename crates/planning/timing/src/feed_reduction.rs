//! Coming down to a feed that was lowered.
//!
//! The way down is in closed form, with constant limits that all axes keep along it, to just below the new feed. From
//! there the motion is planned as if it had always gone at that speed. The solver alone would come down to where its
//! stations permit: they lie as far apart as speed before asks for, and a tenth or a thousandth of it is reached and
//! held within a small part of an interval.

use crate::closed_form;
use crate::grid::Place;
use crate::optimizer::{Optimizer, WindowProblem};
use crate::piece::Piece;
use crate::solver::FIRST;
use crate::spans;
use crate::start;

/// By which share the speed has to exceed the feed.
const EXCESS: f64 = 1e-3;
/// Share of the feed that is come down to: within the barrier of the caps, and a thousandth of it is not missed.
const SHARE: f64 = 0.9994;
/// How much lower the least cap of the whole window may be.
const FAR: f64 = 0.9;
/// Lengths of the last stub over which the crawl at this speed may be brought to rest.
const FADES: [f64; 5] = [20.0, 100.0, 500.0, 2500.0, 12_500.0];

impl Optimizer {
    /// A plan that first comes down to a feed below the present speed; that part goes to `out` at once. `None` where
    /// speed is not above the feed, or this way is not open. Returns the barrier parameter reached.
    pub(crate) fn lower(&mut self, job: &WindowProblem<'_>, out: &mut Vec<Piece>) -> Option<f64> {
        let WindowProblem {
            grid,
            from,
            until,
            factor,
            state: (v, a),
            ..
        } = *job;
        self.kept.find(grid, from, v, a)?;
        let feed = closed_form::least_cap(grid, from, until, 0.0, factor)?;
        if v <= feed * (1.0 + EXCESS) {
            return None;
        }
        let (reach, kept) = (closed_form::reach(grid, from, v, a, until), out.len());
        let near = SHARE * closed_form::least_cap(grid, from, until, reach, factor)?;
        self.lower_to(job, near, out).or_else(|| {
            // The feed is one of the path, the solver's that of a curve's parameter, and farther on its cap may be a little lower.
            let far = SHARE
                * closed_form::least_cap(grid, from, until, closed_form::room(grid, from, until), factor)?;
            out.truncate(kept);
            (far < near && far >= FAR * near).then(|| self.lower_to(job, far, out))?
        })
    }

    fn lower_to(&mut self, job: &WindowProblem<'_>, speed: f64, out: &mut Vec<Piece>) -> Option<f64> {
        let WindowProblem {
            grid,
            from,
            until,
            factor,
            state: (v, a),
            ..
        } = *job;
        let profile = closed_form::slow_down(grid, from, (v, a), until, speed)?;
        if !closed_form::write(grid, from, until, &profile, out) {
            return None;
        }
        let last = out.last()?;
        let (_, begin) = grid.stretch_of(last.interval)?;
        let (x, length) = (
            last.from - begin + last.length,
            grid.interval_length(last.interval)?,
        );
        let place = if x >= length {
            Place {
                interval: last.interval + 1,
                x: 0.0,
            }
        } else {
            Place {
                interval: last.interval,
                x,
            }
        };
        self.window.from_rest = false;
        self.window.spans.clear();
        spans::plain(grid, place, until, &mut self.window.spans);
        self.grade(job, true);
        self.balance(false);
        if self.window.spans.len() < 3 || !self.window.fetch(grid) {
            return None;
        }
        self.window.pack(&self.limits, factor, job.gentle);
        self.solver.begin(self.window.n());
        for fade in FADES {
            start::crawl_to_end(&self.window, 0, speed * speed, fade, &mut self.solver.x);
            if self.solver.feasible(&self.window) {
                self.solver.mark();
                self.lead();
                return Some(self.solver.descend(&self.window, FIRST, self.centre_steps()));
            }
        }
        None
    }
}

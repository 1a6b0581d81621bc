//! Deceleration to a feed that was reduced.
//!
//! The deceleration has a closed form, with constant limits that all axes keep along it, down to just below
//! the new feed. From there the motion is planned as if it had always had that speed. The solver alone would
//! reach the new feed only where its stations permit: their distances follow the old speed, and a tenth or a
//! thousandth of it is reached within a small part of an interval.

use crate::closed_form;
use crate::grid::PathPosition;
use crate::optimizer::{Optimizer, WindowProblem};
use crate::piece::TimeLawPiece;
use crate::solver::MU_FROM_REST;
use crate::spans;
use crate::start;

/// Minimum excess of the speed over the feed, relative.
const MIN_EXCESS: f64 = 1e-3;
/// Target speed as a fraction of the feed: inside the barrier of the caps, at a cost below 0.1 %.
const TARGET_FRACTION: f64 = 0.9994;
/// Minimum ratio of the lowest cap of the whole window to that near the start.
const FAR_FRACTION: f64 = 0.9;
/// Lengths of the last stub over which the motion at this speed may stop, in stub lengths.
const FADES: [f64; 5] = [20.0, 100.0, 500.0, 2500.0, 12_500.0];

impl Optimizer {
    /// Plans a deceleration to a feed below the present speed, which is written to `out`, and the motion
    /// after it. `None` if the speed is not above the feed, or if this method fails. Returns the final
    /// barrier parameter.
    pub(crate) fn reduce_feed(
        &mut self,
        problem: &WindowProblem<'_>,
        out: &mut Vec<TimeLawPiece>,
    ) -> Option<f64> {
        let WindowProblem {
            grid,
            from,
            until,
            factor,
            state: (v, a),
            ..
        } = *problem;
        self.last_plan.find(grid, from, v, a)?;
        let feed = closed_form::min_cap(grid, from, until, 0.0, factor)?;
        if v <= feed * (1.0 + MIN_EXCESS) {
            return None;
        }
        let (reach, head_length) = (closed_form::reach(grid, from, v, a, until), out.len());
        let near = TARGET_FRACTION * closed_form::min_cap(grid, from, until, reach, factor)?;
        self.reduce_feed_to(problem, near, out).or_else(|| {
            // The feed refers to the path, the solver's speed to a curve's parameter, so the cap farther on
            // may be slightly lower.
            let far = TARGET_FRACTION
                * closed_form::min_cap(
                    grid,
                    from,
                    until,
                    closed_form::known_length(grid, from, until),
                    factor,
                )?;
            out.truncate(head_length);
            (far < near && far >= FAR_FRACTION * near).then(|| self.reduce_feed_to(problem, far, out))?
        })
    }

    fn reduce_feed_to(
        &mut self,
        problem: &WindowProblem<'_>,
        speed: f64,
        out: &mut Vec<TimeLawPiece>,
    ) -> Option<f64> {
        let WindowProblem {
            grid,
            from,
            until,
            factor,
            state: (v, a),
            ..
        } = *problem;
        let profile = closed_form::slow_down(grid, from, (v, a), until, speed)?;
        if !closed_form::write(grid, from, until, &profile, out) {
            return None;
        }
        let last = out.last()?;
        let (_, begin) = grid.segment_of(last.interval)?;
        let (x, length) = (
            last.from - begin + last.length,
            grid.interval_length(last.interval)?,
        );
        let position = if x >= length {
            PathPosition {
                interval: last.interval + 1,
                x: 0.0,
            }
        } else {
            PathPosition {
                interval: last.interval,
                x,
            }
        };
        self.window.from_rest = false;
        self.window.spans.clear();
        spans::plain(grid, position, until, &mut self.window.spans);
        self.grade(problem, true);
        self.balance(false);
        if self.window.spans.len() < 3 || !self.window.fetch(grid) {
            return None;
        }
        self.window.pack(&self.limits, factor, problem.end_jerk_fraction);
        self.solver.reset(self.window.n());
        for fade in FADES {
            start::crawl_to_end(&self.window, 0, speed * speed, fade, &mut self.solver.x);
            if self.solver.feasible(&self.window) {
                self.solver.mark();
                self.apply_initial_guess();
                return Some(
                    self.solver
                        .descend(&self.window, MU_FROM_REST, self.centre_steps()),
                );
            }
        }
        None
    }
}

//! Newton's method with feasible iterates on the barrier function of one window.

use crate::barrier::{Iterate, Local, Objective, assemble, interval_time, value};
use crate::riccati::Riccati;
use crate::start::InitialGuess;
use crate::window::Window;

/// Barrier parameter at the start of a plan from rest, relative to the duration.
pub(crate) const MU_FROM_REST: f64 = 0.1;
/// The same where most of the motion is known.
pub(crate) const MU_WARM: f64 = 0.04;
/// The final barrier parameter.
pub(crate) const MU_FINAL: f64 = 4e-4;
/// Factor of the barrier parameter from one centre to the next.
const MU_FACTOR: f64 = 0.2;
/// Newton decrement, relative to the barrier's weight, below which an iterate counts as centred.
const CENTRED: f64 = 0.02;
/// Maximum fraction of the distance to the nearest cap that a step may take.
const MAX_STEP_FRACTION: f64 = 0.98;
/// Factor of the backtracking line search.
const BACKTRACK_FACTOR: f64 = 0.75;
/// Weight of the first derivative of the speed in the approach to the initial guess.
const GUESS_SLOPE_WEIGHT: f64 = 0.02;
/// Initial weight of its second derivative, the factor by which it grows after an infeasible attempt, and the
/// number of attempts.
const GUESS_SMOOTHNESS: f64 = 0.2;
const GUESS_SMOOTHNESS_FACTOR: f64 = 5.0;
const MAX_GUESSES: usize = 3;
/// Fraction of the difference to the initial guess.
const GUESS_FRACTION: f64 = 0.95;
/// Maximum number of backtracking steps of one line search.
const MAX_BACKTRACKS: usize = 30;

/// The state and working memory of the method.
#[derive(Clone, Debug, Default)]
pub(crate) struct Solver {
    pub(crate) x: Iterate,
    trial: Iterate,
    /// A feasible iterate to backtrack to, and the result from which to backtrack.
    base: Iterate,
    far: Iterate,
    step: Iterate,
    local: Local,
    riccati: Riccati,
    pub(crate) objective: Objective,
    /// Factors on the barrier weights of the intervals, raised where the check between stations finds an
    /// excess.
    pub(crate) constraint_weight: Vec<f64>,
    /// Linear weights on `u'^2` at stations where the speed has to fall below that of the start.
    pub(crate) pull: Vec<f64>,
    pub(crate) iterations: u32,
}

impl Solver {
    pub(crate) fn with_capacity(stations: usize) -> Self {
        Self {
            x: Iterate::with_capacity(stations),
            trial: Iterate::with_capacity(stations),
            base: Iterate::with_capacity(stations),
            far: Iterate::with_capacity(stations),
            step: Iterate::with_capacity(stations),
            local: Local {
                g: Vec::with_capacity(stations + 1),
                h: Vec::with_capacity(stations + 1),
            },
            riccati: Riccati::with_capacity(stations),
            objective: Objective {
                linear: Vec::with_capacity(stations + 1),
                weight: Vec::with_capacity(stations),
            },
            constraint_weight: Vec::with_capacity(stations),
            pull: Vec::with_capacity(stations + 1),
            iterations: 0,
        }
    }

    /// Prepares for a window of `n` intervals.
    pub(crate) fn reset(&mut self, n: usize) {
        self.iterations = 0;
        self.constraint_weight.clear();
        self.constraint_weight.resize(n, 1.0);
        self.pull.clear();
        self.pull.resize(n + 1, 0.0);
        self.x.reset(n);
    }

    /// Shifts the first state slightly, and the following states at minimum cost to the barrier.
    pub(crate) fn shift_start(&mut self, window: &Window, by: (f64, f64)) {
        self.time_objective(window, MU_FROM_REST);
        assemble(window, &self.objective, &self.x, &mut self.local);
        self.local.g.fill([0.0; 3]);
        let _ = self.riccati.step(window, &self.local, by, &mut self.step);
        self.trial.copy(&self.x);
        self.x.along(&self.trial, &self.step, 1.0);
    }

    /// Moves a slow start motion towards the initial guess if that stays feasible: one least-squares step in
    /// which the speed follows the guess and its derivatives are small over the guess's lengths.
    pub(crate) fn approach_guess(&mut self, window: &Window, initial_guess: &InitialGuess) {
        let n = window.n();
        self.local.g.clear();
        self.local.h.clear();
        self.trial.copy(&self.x);
        let mut smooth = GUESS_SMOOTHNESS;
        for _ in 0..MAX_GUESSES {
            self.local.g.clear();
            self.local.h.clear();
            for k in 0..=n {
                let (goal, length, d) = (
                    initial_guess.a[k],
                    initial_guess.length[k],
                    window.d[k.min(n - 1)],
                );
                let (a, b) = (self.trial.a[k], self.trial.b[k]);
                let c = if k < n { self.trial.c[k] } else { 0.0 };
                let h = d / (goal * goal * goal.sqrt());
                let hb = GUESS_SLOPE_WEIGHT * h * length * length;
                let hc = smooth * h * length * length * length * length;
                self.local.g.push([h * (a - goal), hb * b, hc * c]);
                self.local.h.push([h, 0.0, hb, 0.0, 0.0, hc]);
            }
            let _ = self.riccati.step(window, &self.local, (0.0, 0.0), &mut self.step);
            self.x.along(&self.trial, &self.step, GUESS_FRACTION);
            if self.feasible(window) {
                return;
            }
            smooth *= GUESS_SMOOTHNESS_FACTOR;
        }
        self.x.copy(&self.trial);
    }

    /// Saves the iterate as the one to backtrack to.
    pub(crate) fn mark(&mut self) {
        self.base.copy(&self.x);
    }

    /// Saves the iterate as the one to backtrack from.
    pub(crate) fn mark_end(&mut self) {
        self.far.copy(&self.x);
    }

    /// Moves to a fraction of the difference between the two saved iterates. False if that is infeasible.
    pub(crate) fn backtrack(&mut self, window: &Window, fraction: f64) -> bool {
        self.step.copy(&self.far);
        for (to, from) in [
            (&mut self.step.a, &self.base.a),
            (&mut self.step.b, &self.base.b),
            (&mut self.step.c, &self.base.c),
        ] {
            for (to, from) in to.iter_mut().zip(from) {
                *to -= from;
            }
        }
        self.x.along(&self.base, &self.step, fraction);
        self.feasible(window)
    }

    /// Whether the iterate is strictly within all limits.
    pub(crate) fn feasible(&mut self, window: &Window) -> bool {
        self.time_objective(window, 1.0);
        value(window, &self.objective, &self.x).is_some()
    }

    /// Sets the duration as objective, and the barrier weights from the present durations of the intervals.
    fn time_objective(&mut self, window: &Window, mu: f64) {
        let n = window.n();
        self.objective.linear.clone_from(&self.pull);
        self.objective.weight.clear();
        for k in 0..n {
            let (d, a) = (window.d[k], self.x.a[k]);
            let middle = a + d * (self.x.b[k] + 0.25 * d * self.x.c[k]);
            let time = interval_time(d, a, middle.max(1e-300), self.x.a[k + 1]);
            let pull = 0.5 * (self.pull[k] * a + self.pull[k + 1] * self.x.a[k + 1]);
            self.objective
                .weight
                .push(mu * (time + pull) * self.constraint_weight[k]);
        }
    }

    /// Follows the central path from barrier parameter `mu` down to [`MU_FINAL`] in at most `max` steps.
    /// Returns the final barrier parameter.
    pub(crate) fn descend(&mut self, window: &Window, mut mu: f64, max: u32) -> f64 {
        let limit = self.iterations + max;
        loop {
            self.time_objective(window, mu);
            let left = limit.saturating_sub(self.iterations);
            let fraction = if mu > MU_FINAL { 10.0 * CENTRED } else { CENTRED };
            self.newton(window, left, fraction * self.weight());
            if mu <= MU_FINAL || self.iterations >= limit {
                return mu;
            }
            mu = (mu * MU_FACTOR).max(MU_FINAL);
        }
    }

    /// Performs a few steps at barrier parameter `mu`.
    pub(crate) fn centre(&mut self, window: &Window, mu: f64, max: u32) {
        self.time_objective(window, mu);
        self.newton(window, max, CENTRED * self.weight());
    }

    /// Performs a few steps at [`MU_FINAL`] after some constraint weights were raised. The decrement there is
    /// small compared to the weight of the whole window, so the smallest raised weight is the measure.
    pub(crate) fn recentre_weighted(&mut self, window: &Window, max: u32) {
        self.time_objective(window, MU_FINAL);
        let weights_raised = (self.objective.weight.iter().zip(&self.constraint_weight))
            .filter(|(_, constraint_weight)| **constraint_weight > 1.0)
            .map(|(weight, _)| *weight)
            .fold(self.weight(), f64::min);
        self.newton(window, max, CENTRED * weights_raised);
    }

    fn weight(&self) -> f64 {
        self.objective.weight.iter().sum()
    }

    /// Performs at most `max` Newton steps, until the predicted decrease is below `centred`.
    fn newton(&mut self, window: &Window, max: u32, centred: f64) {
        let Some(mut now) = value(window, &self.objective, &self.x) else {
            return;
        };
        self.trial.copy(&self.x);
        for _ in 0..max {
            self.iterations += 1;
            assemble(window, &self.objective, &self.x, &mut self.local);
            let slope = self.riccati.step(window, &self.local, (0.0, 0.0), &mut self.step);
            // NaN is not a descent.
            if slope.is_nan() || slope >= -centred {
                return;
            }
            let Some(next) = self.search(window, now, slope) else {
                return;
            };
            std::mem::swap(&mut self.x, &mut self.trial);
            now = next;
        }
    }

    /// Line search: a feasible step along the direction that decreases the function. Returns the new value.
    fn search(&mut self, window: &Window, now: f64, slope: f64) -> Option<f64> {
        let mut t: f64 = 1.0;
        for ((step, a), cap) in self.step.a.iter().zip(&self.x.a).zip(&window.cap) {
            if *step > 0.0 {
                t = t.min(MAX_STEP_FRACTION * (cap - a) / step);
            } else if *step < 0.0 {
                t = t.min(-MAX_STEP_FRACTION * a / step);
            }
        }
        for _ in 0..MAX_BACKTRACKS {
            self.trial.along(&self.x, &self.step, t);
            if let Some(next) = value(window, &self.objective, &self.trial)
                && next <= now + 1e-4 * t * slope
            {
                return Some(next);
            }
            t *= BACKTRACK_FACTOR;
        }
        None
    }
}

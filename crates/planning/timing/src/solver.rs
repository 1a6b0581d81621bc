//! Newton's method with feasible iterates on the barrier function of one window.

use crate::barrier::{Iterate, Local, Objective, assemble, interval_time, value};
use crate::riccati::Riccati;
use crate::start::InitialGuess;
use crate::window::Window;

/// Barrier parameter at the start, relative to the duration.
pub(crate) const FIRST: f64 = 0.1;
/// The same where most of the motion is known.
pub(crate) const KNOWN: f64 = 0.04;
/// ... and at the end.
pub(crate) const LAST: f64 = 4e-4;
/// By which it falls from one centre to the next.
const FALL: f64 = 0.2;
/// Newton's decrement, as a share of the barrier's weight, below which an iterate counts as centred.
const CENTRED: f64 = 0.02;
/// Share of the way to the nearest cap that a step may go.
const TO_CAP: f64 = 0.98;
/// Steps are shortened by this factor until they are feasible and descend.
const SHORTER: f64 = 0.75;
/// How much the first derivative of speed counts beside its distance from a guide.
const LEAD_SLOPE: f64 = 0.02;
/// How much the second derivative counts at first, and by which factor more where that leads out of the limits, in at
/// most so many tries.
const LEAD_SMOOTH: f64 = 0.2;
const SMOOTHER: f64 = 5.0;
const LEADS: usize = 3;
/// Share of the way to the guide that is gone.
const LEAD_FRACTION: f64 = 0.95;
/// Most shortenings of one step.
const SHORTENINGS: usize = 30;

/// Working memory of the method.
#[derive(Clone, Debug, Default)]
pub(crate) struct Solver {
    pub(crate) x: Iterate,
    trial: Iterate,
    /// An iterate to go back to, and the one from which that is done.
    base: Iterate,
    far: Iterate,
    step: Iterate,
    local: Local,
    riccati: Riccati,
    pub(crate) objective: Objective,
    /// Factors on the barrier's weights, where the motion shall keep away from the limits.
    pub(crate) stiff: Vec<f64>,
    /// Linear weights on `u'^2` at stations that have to come down below what the start has there.
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
            stiff: Vec::with_capacity(stations),
            pull: Vec::with_capacity(stations + 1),
            iterations: 0,
        }
    }

    /// Forgets what an earlier window needed.
    pub(crate) fn begin(&mut self, n: usize) {
        self.iterations = 0;
        self.stiff.clear();
        self.stiff.resize(n, 1.0);
        self.pull.clear();
        self.pull.resize(n + 1, 0.0);
        self.x.reset(n);
    }

    /// Moves the first state by a little, and what follows with it, by the steering that costs the barrier least.
    pub(crate) fn steer(&mut self, window: &Window, by: (f64, f64)) {
        self.time_objective(window, FIRST);
        assemble(window, &self.objective, &self.x, &mut self.local);
        self.local.g.fill([0.0; 3]);
        let _ = self.riccati.step(window, &self.local, by, &mut self.step);
        self.trial.copy(&self.x);
        self.x.along(&self.trial, &self.step, 1.0);
    }

    /// Leads a crawl from rest towards a guide, if that stays within the limits: one step of least squares, in which speed
    /// follows the guide and its derivatives are small over the guide's lengths.
    pub(crate) fn lead(&mut self, window: &Window, guide: &InitialGuess) {
        let n = window.n();
        self.local.g.clear();
        self.local.h.clear();
        self.trial.copy(&self.x);
        let mut smooth = LEAD_SMOOTH;
        for _ in 0..LEADS {
            self.local.g.clear();
            self.local.h.clear();
            for k in 0..=n {
                let (aim, length, d) = (guide.a[k], guide.length[k], window.d[k.min(n - 1)]);
                let (a, b) = (self.trial.a[k], self.trial.b[k]);
                let c = if k < n { self.trial.c[k] } else { 0.0 };
                let h = d / (aim * aim * aim.sqrt());
                let hb = LEAD_SLOPE * h * length * length;
                let hc = smooth * h * length * length * length * length;
                self.local.g.push([h * (a - aim), hb * b, hc * c]);
                self.local.h.push([h, 0.0, hb, 0.0, 0.0, hc]);
            }
            let _ = self.riccati.step(window, &self.local, (0.0, 0.0), &mut self.step);
            self.x.along(&self.trial, &self.step, LEAD_FRACTION);
            if self.feasible(window) {
                return;
            }
            smooth *= SMOOTHER;
        }
        self.x.copy(&self.trial);
    }

    /// Marks the iterate as one to go back to.
    pub(crate) fn mark(&mut self) {
        self.base.copy(&self.x);
    }

    /// Marks the iterate as one to go back from.
    pub(crate) fn mark_end(&mut self) {
        self.far.copy(&self.x);
    }

    /// Goes back to a share of the way from the marked iterate to the marked end. False where that is not within the
    /// limits.
    pub(crate) fn retreat(&mut self, window: &Window, share: f64) -> bool {
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
        self.x.along(&self.base, &self.step, share);
        self.feasible(window)
    }

    /// Whether the iterate is strictly within all limits.
    pub(crate) fn feasible(&mut self, window: &Window) -> bool {
        self.time_objective(window, 1.0);
        value(window, &self.objective, &self.x).is_some()
    }

    /// Duration as objective, barrier weights by the present times.
    fn time_objective(&mut self, window: &Window, mu: f64) {
        let n = window.n();
        self.objective.linear.clone_from(&self.pull);
        self.objective.weight.clear();
        for k in 0..n {
            let (d, a) = (window.d[k], self.x.a[k]);
            let middle = a + d * (self.x.b[k] + 0.25 * d * self.x.c[k]);
            let time = interval_time(d, a, middle.max(1e-300), self.x.a[k + 1]);
            let pull = 0.5 * (self.pull[k] * a + self.pull[k + 1] * self.x.a[k + 1]);
            self.objective.weight.push(mu * (time + pull) * self.stiff[k]);
        }
    }

    /// Follows the centres from barrier parameter `mu` down to [`LAST`], in at most `most` steps. Returns the barrier
    /// parameter reached.
    pub(crate) fn descend(&mut self, window: &Window, mut mu: f64, most: u32) -> f64 {
        let limit = self.iterations + most;
        loop {
            self.time_objective(window, mu);
            let left = limit.saturating_sub(self.iterations);
            let share = if mu > LAST { 10.0 * CENTRED } else { CENTRED };
            self.newton(window, left, share * self.weight());
            if mu <= LAST || self.iterations >= limit {
                return mu;
            }
            mu = (mu * FALL).max(LAST);
        }
    }

    /// A few steps at barrier parameter `mu`.
    pub(crate) fn centre(&mut self, window: &Window, mu: f64, most: u32) {
        self.time_objective(window, mu);
        self.newton(window, most, CENTRED * self.weight());
    }

    /// A few steps at [`LAST`] after some intervals were made stiffer. How far from its centre the motion is there says
    /// nothing beside the weight of the whole: it is measured by the least of the weights that were raised.
    pub(crate) fn follow_stiff(&mut self, window: &Window, most: u32) {
        self.time_objective(window, LAST);
        let raised = (self.objective.weight.iter().zip(&self.stiff))
            .filter(|(_, stiff)| **stiff > 1.0)
            .map(|(weight, _)| *weight)
            .fold(self.weight(), f64::min);
        self.newton(window, most, CENTRED * raised);
    }

    fn weight(&self) -> f64 {
        self.objective.weight.iter().sum()
    }

    /// At most `most` steps, until one promises less than `centred`.
    fn newton(&mut self, window: &Window, most: u32, centred: f64) {
        let Some(mut now) = value(window, &self.objective, &self.x) else {
            return;
        };
        self.trial.copy(&self.x);
        for _ in 0..most {
            self.iterations += 1;
            assemble(window, &self.objective, &self.x, &mut self.local);
            let slope = self.riccati.step(window, &self.local, (0.0, 0.0), &mut self.step);
            // NaN is no descent either.
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

    /// A feasible step along the direction that descends; its value.
    fn search(&mut self, window: &Window, now: f64, slope: f64) -> Option<f64> {
        let mut t: f64 = 1.0;
        for ((step, a), cap) in self.step.a.iter().zip(&self.x.a).zip(&window.cap) {
            if *step > 0.0 {
                t = t.min(TO_CAP * (cap - a) / step);
            } else if *step < 0.0 {
                t = t.min(-TO_CAP * a / step);
            }
        }
        for _ in 0..SHORTENINGS {
            self.trial.along(&self.x, &self.step, t);
            if let Some(next) = value(window, &self.objective, &self.trial)
                && next <= now + 1e-4 * t * slope
            {
                return Some(next);
            }
            t *= SHORTER;
        }
        None
    }
}

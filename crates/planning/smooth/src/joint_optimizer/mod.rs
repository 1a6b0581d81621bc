//! Joint optimisation of path and time law.
//!
//! Along the parameter `u` let `a = u'^2`, `b = u''` and `c = u''' / u'`; then `da/du = 2 b`, `db/du = c`,
//! and velocity, acceleration and jerk of an axis are `q' sqrt(a)`, `q'' a + q' b` and
//! `sqrt(a) (q''' a + 3 q'' b + q' c)`. Here `a` is a quadratic spline, so that `c` is constant between
//! stations. Its coefficients and the control points of the path are the unknowns of one problem: minimum
//! time, the integral of `du / sqrt(a)`, subject to the axis limits and the tube, by a log barrier with
//! decreasing weight. Alternating between path and law stalls: where limits are active almost everywhere,
//! both can only change together.
//!
//! Every constraint belongs to one interval of the path, so the matrix is banded. Second derivatives are
//! those of barrier and time, not of the constraints (Gauss-Newton). The law is then discarded: the ends of
//! the window are free, so it is not executed.

mod cell;
mod law_local;
mod layout;
mod local;
mod start;

use evolvent_path::{AXES, Axes};

use self::cell::{Cell, LAW, STATIONS, of3};
use self::law_local::LawLocal;
use self::layout::{Layout, NONE};
use self::local::Local;
use crate::chain::Chain;
use crate::follow::follow;
use crate::tube::Sample;
use crate::weights::Scales;
use crate::zone::BlendZone;

/// Factor of the initial law, so that it has a margin.
const INITIAL_FACTOR: f64 = 0.8;
/// Barrier weight: fraction of the time in the first round, factor between rounds; number of rounds and
/// Newton steps of each.
const BARRIER: f64 = 0.5;
const BARRIER_FACTOR: f64 = 0.25;
const ROUNDS: usize = 4;
const STEPS: usize = 4;
/// A round ends when the predicted decrease, in barrier weights, is below this.
const DECREASE_TOLERANCE: f64 = 0.01;
/// Factor and maximum number of backtracking steps of the line search.
const BACKTRACK_FACTOR: f64 = 0.6;
const MAX_BACKTRACKS: usize = 25;
/// For the law alone: factor of the barrier between rounds, rounds, steps of each, and the final barrier.
const LAW_FACTOR: f64 = 0.2;
const LAW_ROUNDS: usize = 6;
const LAW_STEPS: usize = 10;
const LAW_FINAL_BARRIER: f64 = 0.02;

/// A window of the spline and the limits of the speed on it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window<'a> {
    pub(crate) zone: &'a BlendZone,
    /// First and last interval.
    pub(crate) from: usize,
    pub(crate) to: usize,
    /// Range of the free control points.
    pub(crate) free: (usize, usize),
    pub(crate) scales: &'a Scales,
    pub(crate) active: &'a [bool; AXES],
    /// Feed limit of each interval.
    pub(crate) feeds: &'a [f64],
    /// Positions before and after the window where the path stops; infinite if it does not.
    pub(crate) rests: (f64, f64),
}

/// Working memory, kept between solutions.
#[derive(Debug, Default)]
pub(crate) struct JointOptimizer {
    cells: Vec<Cell>,
    /// Weight of the samples of each interval.
    weights: Vec<f64>,
    alpha: Vec<f64>,
    points: Vec<Axes>,
    trial_alpha: Vec<f64>,
    trial_points: Vec<Axes>,
    matrix: Vec<f64>,
    gradient: Vec<f64>,
    step: Vec<f64>,
}

impl JointOptimizer {
    /// Improves the free control points of `points` and returns whether it did. They stay strictly inside the
    /// tube.
    pub(crate) fn improve(
        &mut self,
        window: &Window<'_>,
        chain: &Chain,
        samples: &mut [Sample],
        points: &mut [Axes],
    ) -> bool {
        match window.active.iter().filter(|&&active| active).count() {
            0 => false,
            1 | 2 => self.run::<2>(window, chain, samples, points),
            3 => self.run::<3>(window, chain, samples, points),
            4 | 5 => self.run::<5>(window, chain, samples, points),
            _ => self.run::<9>(window, chain, samples, points),
        }
    }

    fn run<const D: usize>(
        &mut self,
        window: &Window<'_>,
        chain: &Chain,
        samples: &mut [Sample],
        points: &mut [Axes],
    ) -> bool {
        let layout = Layout::<D>::new(window);
        if window.to <= window.from {
            return false;
        }
        self.prepare(window, &layout, samples);
        self.points.clear();
        self.points.extend_from_slice(points);
        if !self.begin(window, &layout) {
            return false;
        }
        let rows = (self.cells.len() * (4 + 4 * D)) as f64;
        let Some(time) = self.merit(window, &layout, samples, &self.points, &self.alpha, 0.0) else {
            return false;
        };
        let mut mu = time / rows;
        for _ in 0..LAW_ROUNDS {
            self.law_round(window, &layout, mu, DECREASE_TOLERANCE * mu * rows);
            let Some(time) = self.merit(window, &layout, samples, &self.points, &self.alpha, 0.0) else {
                return false;
            };
            if mu < LAW_FINAL_BARRIER * time / rows {
                break;
            }
            mu *= LAW_FACTOR;
        }
        let time = self
            .merit(window, &layout, samples, &self.points, &self.alpha, 0.0)
            .unwrap_or(time);
        for alpha in &mut self.alpha {
            *alpha *= INITIAL_FACTOR;
        }
        let mut mu = BARRIER * time / rows;
        for _ in 0..ROUNDS {
            let Some(merit) = self.merit(window, &layout, samples, &self.points, &self.alpha, mu) else {
                break;
            };
            self.round(
                window,
                &layout,
                samples,
                mu,
                merit,
                DECREASE_TOLERANCE * mu * rows,
            );
            follow(chain, samples, 0..samples.len(), &self.points);
            mu *= BARRIER_FACTOR;
        }
        points.copy_from_slice(&self.points);
        true
    }

    /// Newton steps at one barrier weight.
    fn round<const D: usize>(
        &mut self,
        window: &Window<'_>,
        layout: &Layout<D>,
        samples: &[Sample],
        mu: f64,
        mut merit: f64,
        enough: f64,
    ) {
        let size = layout.size();
        for _ in 0..STEPS {
            self.assemble(window, layout, samples, mu);
            self.solve(layout);
            let slope: f64 = (0..size).map(|k| self.gradient[k] * self.step[k]).sum();
            if !(slope < -enough) {
                return;
            }
            let Some(value) = self.descend(window, layout, Some(samples), mu, merit, slope) else {
                return;
            };
            merit = value;
        }
    }

    /// Newton steps of the law alone.
    fn law_round<const D: usize>(&mut self, window: &Window<'_>, layout: &Layout<D>, mu: f64, enough: f64) {
        const BAND: usize = 3;
        let size = self.alpha.len();
        let scales: [[f64; 3]; D] = std::array::from_fn(|d| scale(window, layout.axes[d]));
        let Some(mut merit) = self.merit(window, layout, &[], &self.points, &self.alpha, mu) else {
            return;
        };
        for _ in 0..LAW_STEPS {
            self.matrix.clear();
            self.matrix.resize((size + BAND) * BAND, 0.0);
            self.gradient.clear();
            self.gradient.resize(size + BAND, 0.0);
            for group in 0..layout.intervals {
                let i = layout.from + group;
                let points: [[f64; 4]; D] =
                    std::array::from_fn(|d| std::array::from_fn(|l| self.points[i + l][layout.axes[d]]));
                let mut local = LawLocal::new();
                for k in 0..STATIONS {
                    let s = group * STATIONS + k;
                    let feed = window.feeds[group];
                    local.cell(
                        &self.cells[s],
                        k,
                        &self.alpha[s..s + 3],
                        &points,
                        &scales,
                        (layout, feed),
                        mu,
                    );
                }
                for x in 0..LAW {
                    let c = group * STATIONS + x;
                    self.gradient[c] += local.gradient[x];
                    for y in x..(x + 3).min(LAW) {
                        self.matrix[c * BAND + y - x] += local.law[y][x];
                    }
                }
            }
            self.step.clear();
            self.step.extend(self.gradient.iter().map(|g| -g));
            crate::band::solve(&mut self.matrix, &mut self.step, size, BAND);
            let slope: f64 = (0..size).map(|k| self.gradient[k] * self.step[k]).sum();
            if !(slope < -enough) {
                return;
            }
            let Some(value) = self.descend(window, layout, None, mu, merit, slope) else {
                return;
            };
            merit = value;
        }
    }

    /// Line search: shortens the step until the merit decreases sufficiently, and takes it. Returns the
    /// merit, or `None` if no step decreases it. Without samples the step changes the law alone.
    fn descend<const D: usize>(
        &mut self,
        window: &Window<'_>,
        layout: &Layout<D>,
        samples: Option<&[Sample]>,
        mu: f64,
        merit: f64,
        slope: f64,
    ) -> Option<f64> {
        let mut length = 1.0;
        for _ in 0..MAX_BACKTRACKS {
            self.trial_alpha.clear();
            for (j, alpha) in self.alpha.iter().enumerate() {
                let at = if samples.is_some() { layout.alpha(j) } else { j };
                self.trial_alpha.push(alpha + length * self.step[at]);
            }
            let value = if let Some(samples) = samples {
                self.trial_points.clear();
                self.trial_points.extend_from_slice(&self.points);
                for j in layout.free.0..layout.free.1 {
                    let at = layout.point(j);
                    if at != NONE {
                        for d in 0..D {
                            self.trial_points[j][layout.axes[d]] += length * self.step[at + d];
                        }
                    }
                }
                self.merit(window, layout, samples, &self.trial_points, &self.trial_alpha, mu)
            } else {
                self.merit(window, layout, &[], &self.points, &self.trial_alpha, mu)
            };
            if let Some(value) = value
                && value <= merit + 1e-4 * length * slope
            {
                std::mem::swap(&mut self.alpha, &mut self.trial_alpha);
                if samples.is_some() {
                    std::mem::swap(&mut self.points, &mut self.trial_points);
                }
                return Some(value);
            }
            length *= BACKTRACK_FACTOR;
        }
        None
    }

    /// Time plus barrier; `None` outside of the limits.
    fn merit<const D: usize>(
        &self,
        window: &Window<'_>,
        layout: &Layout<D>,
        samples: &[Sample],
        points: &[Axes],
        alpha: &[f64],
        mu: f64,
    ) -> Option<f64> {
        let (mut time, mut product, mut logs) = (0.0, 1.0f64, 0.0);
        let scales: [[f64; 3]; D] = std::array::from_fn(|d| scale(window, layout.axes[d]));
        let mut local = [[0.0; 4]; D];
        for (s, cell) in self.cells.iter().enumerate() {
            let i = layout.from + s / STATIONS;
            if s % STATIONS == 0 {
                for d in 0..D {
                    local[d] = std::array::from_fn(|l| points[i + l][layout.axes[d]]);
                }
            }
            let alpha = &alpha[s..s + 3];
            let middle = of3(&cell.middle, alpha);
            if !(middle > 0.0) {
                return None;
            }
            time += cell.width * 2.0 / (3.0 * middle.sqrt());
            for end in 0..2 {
                let law = cell.law(end, alpha);
                if !(law[0] > 0.0) {
                    return None;
                }
                time += cell.width / (6.0 * law[0].sqrt());
                let (mut metric, mut min, mut product_max) = (0.0, f64::INFINITY, 1.0);
                let mut margin = |x: f64| {
                    min = min.min(x);
                    product_max *= x;
                };
                for d in 0..D {
                    let motion = cell.motion(end, law, &local[d], scales[d]);
                    margin(1.0 - motion.jerk * motion.jerk);
                    if end == 0 {
                        margin(1.0 - motion.acceleration * motion.acceleration);
                        margin(1.0 - motion.velocity2);
                        if layout.metric[d] {
                            metric += motion.q[0] * motion.q[0];
                        }
                    }
                }
                if end == 0 {
                    let feed = window.feeds[i - layout.from];
                    margin(1.0 - law[0] * metric / (feed * feed));
                    margin(1.0 - law[0] / cell.cap);
                }
                if !(min > 0.0) {
                    return None;
                }
                product *= product_max;
                if product < 1e-150 {
                    logs += libm::log(product);
                    product = 1.0;
                }
            }
        }
        if !(product > 0.0) {
            return None;
        }
        logs += libm::log(product);
        // The samples of an interval share their weight, and so one logarithm.
        let mut samples = samples.iter().peekable();
        while let Some(first) = samples.next() {
            let i = first.interval;
            let mut sample = first;
            let (mut product, mut tube) = (1.0, 0.0);
            loop {
                let margin = 1.0 - sample.ratio(&sample.error(&points[i..i + 4]));
                if !(margin > 0.0) {
                    return None;
                }
                product *= margin;
                if product < 1e-150 {
                    tube += libm::log(product);
                    product = 1.0;
                }
                match samples.next_if(|next| next.interval == i) {
                    Some(next) => sample = next,
                    None => break,
                }
            }
            logs += self.weights[i - layout.from] * (tube + libm::log(product));
        }
        Some(time - mu * logs)
    }

    /// Gradient and lower half of the Hessian by columns: entry `(r, c)` at `c * BAND + r - c`.
    fn assemble<const D: usize>(
        &mut self,
        window: &Window<'_>,
        layout: &Layout<D>,
        samples: &[Sample],
        mu: f64,
    ) {
        let band = Layout::<D>::BAND;
        let size = layout.size();
        self.matrix.clear();
        self.matrix.resize((size + band) * band, 0.0);
        self.gradient.clear();
        self.gradient.resize(size + band, 0.0);
        let scales: [[f64; 3]; D] = std::array::from_fn(|d| scale(window, layout.axes[d]));
        let mut at = 0;
        for group in 0..layout.intervals {
            let mut local = Local::<D>::new();
            let i = layout.from + group;
            let points: [[f64; 4]; D] =
                std::array::from_fn(|d| std::array::from_fn(|l| self.points[i + l][layout.axes[d]]));
            let feed = window.feeds[group];
            for k in 0..STATIONS {
                let s = group * STATIONS + k;
                local.cell(
                    &self.cells[s],
                    k,
                    &self.alpha[s..s + 3],
                    &points,
                    &scales,
                    (layout, feed),
                    mu,
                );
            }
            while let Some(sample) = samples.get(at)
                && sample.interval == i
            {
                local.sample(sample, &self.points[i..i + 4], layout, mu * self.weights[group]);
                at += 1;
            }
            local.scatter(group, layout, &mut self.matrix, &mut self.gradient);
        }
    }

    /// The Newton step, by an LDL' factorisation.
    fn solve<const D: usize>(&mut self, layout: &Layout<D>) {
        let size = layout.size();
        self.step.clear();
        self.step.extend(self.gradient.iter().map(|g| -g));
        crate::band::solve(&mut self.matrix, &mut self.step, size, Layout::<D>::BAND);
    }
}

/// Reciprocal limits of an axis; zero for a padding axis.
fn scale(window: &Window<'_>, axis: usize) -> [f64; 3] {
    if !window.active[axis] {
        return [0.0; 3];
    }
    let scales = window.scales;
    [
        scales.velocity[axis],
        scales.acceleration[axis],
        scales.jerk[axis],
    ]
}

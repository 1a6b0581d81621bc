//! Path and time law found together.
//!
//! Along the parameter `u` let `a = u'^2`, `b = u''` and `c = u''' / u'`; then `da/du = 2 b`, `db/du = c`, and velocity,
//! acceleration and jerk of an axis are `q' sqrt(a)`, `q'' a + q' b` and `sqrt(a) (q''' a + 3 q'' b + q' c)`. Here `a` is
//! a quadratic spline, so that `c` is constant between stations. Its coefficients and the control points of the
//! path are the unknowns of one problem: least time, the integral of `du / sqrt(a)`, inside the axes' limits and the
//! tube, by a log barrier whose weight falls. Either alone gets stuck: where limits are reached nearly everywhere, path
//! and law can only move together.
//!
//! Every condition belongs to one interval of the path, so the matrix is banded. Second derivatives are those of
//! barrier and time, not of the conditions (Gauss and Newton). The law is then forgotten; the window's ends are free,
//! so it is not what will be driven.

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

/// Factor of the law, so that it begins with room.
const EASE: f64 = 0.8;
/// Weight of the barrier: share of the time in the first round, factor between rounds.
const BARRIER: f64 = 0.5;
const FACTOR: f64 = 0.25;
const ROUNDS: usize = 4;
const STEPS: usize = 4;
/// Decrease, in barrier weights, below which a round is done.
const ENOUGH: f64 = 0.01;
/// Shortenings of a step.
const SHORTER: f64 = 0.6;
const SHORTENINGS: usize = 25;
/// The law alone: factor of the barrier between rounds, rounds, their steps, and the barrier at which it is enough.
const LAW_FACTOR: f64 = 0.2;
const LAW_ROUNDS: usize = 6;
const LAW_STEPS: usize = 10;
const LAW_ENDS: f64 = 0.02;

/// A window of the spline and what bounds the speed on it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window<'a> {
    pub(crate) zone: &'a BlendZone,
    /// Intervals.
    pub(crate) from: usize,
    pub(crate) to: usize,
    /// Free control points.
    pub(crate) free: (usize, usize),
    pub(crate) scales: &'a Scales,
    pub(crate) active: &'a [bool; AXES],
    /// Bound of the feed of each interval.
    pub(crate) feeds: &'a [f64],
    /// Where the path is at rest before and behind; infinite where it is not.
    pub(crate) rests: (f64, f64),
}

/// Memory that is kept between solutions.
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
    /// Improves the free control points of `points`; whether it did. They stay strictly inside the tube.
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
            self.law_round(window, &layout, mu, ENOUGH * mu * rows);
            let Some(time) = self.merit(window, &layout, samples, &self.points, &self.alpha, 0.0) else {
                return false;
            };
            if mu < LAW_ENDS * time / rows {
                break;
            }
            mu *= LAW_FACTOR;
        }
        let time = self
            .merit(window, &layout, samples, &self.points, &self.alpha, 0.0)
            .unwrap_or(time);
        for alpha in &mut self.alpha {
            *alpha *= EASE;
        }
        let mut mu = BARRIER * time / rows;
        for _ in 0..ROUNDS {
            let Some(merit) = self.merit(window, &layout, samples, &self.points, &self.alpha, mu) else {
                break;
            };
            self.round(window, &layout, samples, mu, merit, ENOUGH * mu * rows);
            follow(chain, samples, 0..samples.len(), &self.points);
            mu *= FACTOR;
        }
        points.copy_from_slice(&self.points);
        true
    }

    /// Newton steps with one weight of the barrier.
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

    /// Shortens the step until it lowers the merit by enough, and takes it: the merit there, or `None` where it never does. Without
    /// samples the step is one of the law alone.
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
        for _ in 0..SHORTENINGS {
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
            length *= SHORTER;
        }
        None
    }

    /// Time and barrier; `None` outside.
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
                let (mut metric, mut least, mut rooms) = (0.0, f64::INFINITY, 1.0);
                let mut room = |x: f64| {
                    least = least.min(x);
                    rooms *= x;
                };
                for d in 0..D {
                    let motion = cell.motion(end, law, &local[d], scales[d]);
                    room(1.0 - motion.jerk * motion.jerk);
                    if end == 0 {
                        room(1.0 - motion.acceleration * motion.acceleration);
                        room(1.0 - motion.velocity2);
                        if layout.metric[d] {
                            metric += motion.q[0] * motion.q[0];
                        }
                    }
                }
                if end == 0 {
                    let feed = window.feeds[i - layout.from];
                    room(1.0 - law[0] * metric / (feed * feed));
                    room(1.0 - law[0] / cell.cap);
                }
                if !(least > 0.0) {
                    return None;
                }
                product *= rooms;
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
        // The samples of an interval share their weight, and so their logarithm.
        let mut samples = samples.iter().peekable();
        while let Some(first) = samples.next() {
            let i = first.interval;
            let mut sample = first;
            let (mut product, mut tube) = (1.0, 0.0);
            loop {
                let room = 1.0 - sample.ratio(&sample.error(&points[i..i + 4]));
                if !(room > 0.0) {
                    return None;
                }
                product *= room;
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

    /// The Newton step, by an LDL' factorisation that updates to the right.
    fn solve<const D: usize>(&mut self, layout: &Layout<D>) {
        let size = layout.size();
        self.step.clear();
        self.step.extend(self.gradient.iter().map(|g| -g));
        crate::band::solve(&mut self.matrix, &mut self.step, size, Layout::<D>::BAND);
    }
}

/// Reciprocal limits of an axis; zero for one that only fills up.
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

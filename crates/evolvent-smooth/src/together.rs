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

use evolvent_path::{AXES, Axes};

use crate::basis::Basis;
use crate::chain::Chain;
use crate::follow::follow;
use crate::joint::metric_axes;
use crate::newton::order;
use crate::tube::{GROUPS, Sample, dot};
use crate::weights::Scales;
use crate::zone::Zone;

/// Stations in an interval.
const STATIONS: usize = 2;
/// Coefficients of the law that an interval sees.
const LAW: usize = STATIONS + 2;
/// Share of the local limits that the first law uses, and stations to each side over which it is levelled.
const BEGIN: f64 = 0.5;
const LEVEL: usize = 4;
/// Room that the first law leaves.
const ROOM: f64 = 0.8;
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
/// A bound of speed that is used less than this does not count in second derivatives.
const ASLEEP: f64 = 0.2;
/// Least `|q'|` by which the speed of the parameter is bounded, as a share of one.
const SLOWEST_RATE: f64 = 0.3;
/// The law alone: factor of the barrier between rounds, rounds, their steps, and the barrier at which it is enough.
const LAW_FACTOR: f64 = 0.2;
const LAW_ROUNDS: usize = 6;
const LAW_STEPS: usize = 10;
const LAW_ENDS: f64 = 0.02;
const NONE: usize = usize::MAX;

/// A window of the spline and what bounds the speed on it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window<'a> {
    pub(crate) zone: &'a Zone,
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
pub(crate) struct Together {
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

/// Between two stations: how the law and the path follow from their coefficients at both.
#[derive(Clone, Copy, Debug)]
struct Cell {
    width: f64,
    /// Derivatives of `a` and `b` by three coefficients of the law, at both ends; of `c`; of `a` in the middle.
    a: [[f64; 3]; 2],
    b: [[f64; 3]; 2],
    c: [f64; 3],
    middle: [f64; 3],
    /// First, second and third derivative of the four basis functions, at both ends.
    path: [[[f64; 4]; 3]; 2],
    /// Bound of `a`.
    cap: f64,
}

struct Layout<const D: usize> {
    axes: [usize; D],
    columns: [usize; AXES],
    /// Axes that the feed speaks of.
    metric: [bool; D],
    from: usize,
    intervals: usize,
    free: (usize, usize),
}

impl<const D: usize> Layout<D> {
    const GROUP: usize = D + STATIONS;
    const BAND: usize = 4 * Self::GROUP;
    /// Columns before the first interval's: its first control points and coefficients of the law.
    const PREFIX: usize = 3 * D + 2;

    fn new(window: &Window<'_>) -> Self {
        let (mut axes, mut columns) = ([0; D], [NONE; AXES]);
        for (d, axis) in order(window.active).take(D).enumerate() {
            axes[d] = axis;
            // Axes that only fill up have no part in the problem.
            if window.active[axis] {
                columns[axis] = d;
            }
        }
        let metric = metric_axes(window.active);
        Self {
            axes,
            columns,
            metric: axes.map(|axis| metric[axis] && window.active[axis]),
            from: window.from,
            intervals: window.to - window.from,
            free: window.free,
        }
    }

    fn size(&self) -> usize {
        Self::PREFIX + self.intervals * Self::GROUP
    }

    /// Column of a coefficient of the law.
    fn alpha(&self, j: usize) -> usize {
        if j < 2 {
            3 * D + j
        } else {
            Self::PREFIX + (j - 2) / STATIONS * Self::GROUP + (j - 2) % STATIONS
        }
    }

    /// First column of a control point; `NONE` if it is fixed.
    fn point(&self, j: usize) -> usize {
        if j < self.free.0 || j >= self.free.1 {
            NONE
        } else if j < self.from + 3 {
            (j - self.from) * D
        } else {
            Self::PREFIX + (j - 3 - self.from) * Self::GROUP + STATIONS
        }
    }
}

/// Jerk, acceleration and velocity of one axis at one end of a cell, in units of the limits.
#[derive(Clone, Copy)]
struct Motion {
    q: [f64; 3],
    jerk: f64,
    acceleration: f64,
    velocity2: f64,
}

fn of3(weights: &[f64; 3], values: &[f64]) -> f64 {
    weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]
}

fn of4(weights: &[f64; 4], values: &[f64; 4]) -> f64 {
    weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2] + weights[3] * values[3]
}

impl Cell {
    fn motion(&self, end: usize, law: [f64; 3], points: &[f64; 4], scale: [f64; 3]) -> Motion {
        let q: [f64; 3] = std::array::from_fn(|order| of4(&self.path[end][order], points));
        let [a, b, c] = law;
        let v = q[0] * scale[0];
        Motion {
            q,
            jerk: a.sqrt() * (q[2] * a + 3.0 * q[1] * b + q[0] * c) * scale[2],
            acceleration: (q[1] * a + q[0] * b) * scale[1],
            velocity2: a * v * v,
        }
    }

    fn law(&self, end: usize, alpha: &[f64]) -> [f64; 3] {
        [
            of3(&self.a[end], alpha),
            of3(&self.b[end], alpha),
            of3(&self.c, alpha),
        ]
    }
}

impl Together {
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
            let mut length = 1.0;
            let mut better = false;
            for _ in 0..SHORTENINGS {
                self.trial_alpha.clear();
                for (j, alpha) in self.alpha.iter().enumerate() {
                    self.trial_alpha.push(alpha + length * self.step[layout.alpha(j)]);
                }
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
                let value = self.merit(window, layout, samples, &self.trial_points, &self.trial_alpha, mu);
                if let Some(value) = value
                    && value <= merit + 1e-4 * length * slope
                {
                    merit = value;
                    better = true;
                    break;
                }
                length *= SHORTER;
            }
            if !better {
                return;
            }
            std::mem::swap(&mut self.alpha, &mut self.trial_alpha);
            std::mem::swap(&mut self.points, &mut self.trial_points);
        }
    }

    /// Newton steps of the law alone.
    fn law_round<const D: usize>(&mut self, window: &Window<'_>, layout: &Layout<D>, mu: f64, enough: f64) {
        const BAND: usize = 3;
        let size = self.alpha.len();
        let scales: [[f64; 3]; D] = std::array::from_fn(|d| scale(window, layout.axes[d]));
        let Some(mut merit) = self.law_merit(window, layout, &self.alpha, mu) else {
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
            let mut length = 1.0;
            let mut better = false;
            for _ in 0..SHORTENINGS {
                self.trial_alpha.clear();
                for (alpha, step) in self.alpha.iter().zip(&self.step) {
                    self.trial_alpha.push(alpha + length * step);
                }
                if let Some(value) = self.law_merit(window, layout, &self.trial_alpha, mu)
                    && value <= merit + 1e-4 * length * slope
                {
                    merit = value;
                    better = true;
                    break;
                }
                length *= SHORTER;
            }
            if !better {
                return;
            }
            std::mem::swap(&mut self.alpha, &mut self.trial_alpha);
        }
    }

    /// Time and barrier of the law's limits; `None` outside.
    fn law_merit<const D: usize>(
        &self,
        window: &Window<'_>,
        layout: &Layout<D>,
        alpha: &[f64],
        mu: f64,
    ) -> Option<f64> {
        self.merit(window, layout, &[], &self.points, alpha, mu)
    }

    fn prepare<const D: usize>(&mut self, window: &Window<'_>, layout: &Layout<D>, samples: &[Sample]) {
        let zone = window.zone;
        let most = |scale: &Axes| {
            layout
                .axes
                .iter()
                .filter(|&&i| window.active[i])
                .map(|&i| scale[i])
                .fold(0.0, f64::max)
                .max(1e-12)
        };
        let (velocity, acceleration, jerk) = (
            most(&window.scales.velocity),
            most(&window.scales.acceleration),
            most(&window.scales.jerk),
        );
        let part = |i: usize| {
            let i = i.clamp(window.from, window.to - 1);
            (zone.knot(i + 1) - zone.knot(i)) / STATIONS as f64
        };
        self.cells.clear();
        self.weights.clear();
        let mut at = 0;
        for i in window.from..window.to {
            let basis: &Basis = &zone.bases[i];
            let width = part(i);
            for k in 0..STATIONS {
                let before = if k == 0 { part(i.max(1) - 1) } else { width };
                let after = if k + 1 == STATIONS { part(i + 1) } else { width };
                let (w0, w1) = (1.0 / (before + width), 1.0 / (width + after));
                let a = [[width * w0, before * w0, 0.0], [0.0, after * w1, width * w1]];
                let b = [[-w0, w0, 0.0], [0.0, -w1, w1]];
                let c: [f64; 3] = std::array::from_fn(|j| (b[1][j] - b[0][j]) / width);
                let middle = std::array::from_fn(|j| a[0][j] + width * (b[0][j] + 0.25 * width * c[j]));
                let path = [k, k + 1].map(|k| {
                    let x = width * k as f64;
                    [
                        basis.map(|f| f[1] + x * (f[2] + 0.5 * x * f[3])),
                        basis.map(|f| f[2] + x * f[3]),
                        basis.map(|f| f[3]),
                    ]
                });
                let u = zone.knot(i) + width * k as f64;
                let mut cap = 1.0 / (SLOWEST_RATE * velocity);
                for rest in [u - window.rests.0, window.rests.1 - u] {
                    // From rest with the largest jerk: v^3 = 9/2 J s^2.
                    let rest = rest.max(0.2 * width);
                    cap = cap
                        .min(libm::cbrt(4.5 * rest * rest / jerk))
                        .min((2.0 * rest / acceleration).sqrt());
                }
                self.cells.push(Cell {
                    width,
                    a,
                    b,
                    c,
                    middle,
                    path,
                    cap: cap * cap,
                });
            }
            let count = samples[at..].partition_point(|sample| sample.interval <= i);
            at += count;
            self.weights.push(STATIONS as f64 / count.max(1) as f64);
        }
    }

    /// A slow law by the local limits, slowed until it has room everywhere.
    fn begin<const D: usize>(&mut self, window: &Window<'_>, layout: &Layout<D>) -> bool {
        let count = self.cells.len() + 2;
        // What each coefficient's cell allows at constant speed; the outermost repeat.
        self.trial_alpha.clear();
        for j in 0..count {
            let cell = j.saturating_sub(1).min(self.cells.len() - 1);
            let i = layout.from + cell / STATIONS;
            let mut most = self.cells[cell].cap;
            let (mut first, mut second, mut third) = (0.0, 0.0, 0.0);
            let mut feed = 0.0;
            for d in 0..D {
                let axis = layout.axes[d];
                let points: [f64; 4] = std::array::from_fn(|l| self.points[i + l][axis]);
                let path = &self.cells[cell].path[0];
                let rate = of4(&path[0], &points);
                first = f64::max(first, (rate * window.scales.velocity[axis]).abs());
                let acceleration = of4(&path[1], &points) * window.scales.acceleration[axis];
                let jerk = of4(&path[2], &points) * window.scales.jerk[axis];
                second += acceleration * acceleration;
                third += jerk * jerk;
                if layout.metric[d] {
                    feed += rate * rate;
                }
            }
            let feed = feed.sqrt() / window.feeds[i - layout.from];
            let slowest = first.max(feed).max(1e-12);
            most = most.min(1.0 / (slowest * slowest));
            most = most.min(1.0 / second.sqrt().max(1e-12));
            let slow = libm::cbrt(1.0 / third.sqrt().max(1e-18));
            self.trial_alpha.push(BEGIN * most.min(slow * slow));
        }
        // The least of the neighbours, then averages.
        let near = |k: usize| k.saturating_sub(LEVEL)..(k + LEVEL + 1).min(count);
        self.alpha.clear();
        for k in 0..count {
            let least = self.trial_alpha[near(k)]
                .iter()
                .copied()
                .fold(f64::INFINITY, f64::min);
            self.alpha.push(least);
        }
        for k in 0..count {
            let part = &self.alpha[near(k)];
            self.trial_alpha[k] = part.iter().sum::<f64>() / part.len() as f64;
        }
        std::mem::swap(&mut self.alpha, &mut self.trial_alpha);
        let mut factor: f64 = 1.0;
        for (s, cell) in self.cells.iter().enumerate() {
            let i = layout.from + s / STATIONS;
            let alpha = &self.alpha[s..s + 3];
            let feed = window.feeds[i - layout.from];
            for end in 0..2 {
                let law = cell.law(end, alpha);
                let mut metric = 0.0;
                for d in 0..D {
                    let axis = layout.axes[d];
                    let points: [f64; 4] = std::array::from_fn(|l| self.points[i + l][axis]);
                    let motion = cell.motion(end, law, &points, scale(window, axis));
                    factor = factor
                        .min(1.0 / libm::cbrt(motion.jerk * motion.jerk))
                        .min(1.0 / motion.acceleration.abs())
                        .min(1.0 / motion.velocity2);
                    if layout.metric[d] {
                        metric += motion.q[0] * motion.q[0];
                    }
                }
                factor = factor
                    .min(feed * feed / (law[0] * metric).max(1e-12))
                    .min(cell.cap / law[0]);
            }
        }
        let factor = ROOM * factor;
        for alpha in &mut self.alpha {
            *alpha *= factor;
        }
        factor > 0.0
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

/// What one interval adds where the path is fixed.
struct LawLocal {
    law: [[f64; LAW]; LAW],
    gradient: [f64; LAW],
}

impl LawLocal {
    fn new() -> Self {
        Self {
            law: [[0.0; LAW]; LAW],
            gradient: [0.0; LAW],
        }
    }

    fn row(&mut self, k: usize, values: &[f64; 3], g: f64, h: f64) {
        for x in 0..3 {
            self.gradient[k + x] += g * values[x];
            for y in 0..=x {
                self.law[k + x][k + y] += h * values[x] * values[y];
            }
        }
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "the innermost loop: all of them are at hand where it is called"
    )]
    fn cell<const D: usize>(
        &mut self,
        cell: &Cell,
        k: usize,
        alpha: &[f64],
        points: &[[f64; 4]; D],
        scales: &[[f64; 3]; D],
        (layout, feed): (&Layout<D>, f64),
        mu: f64,
    ) {
        let width = cell.width;
        let middle = of3(&cell.middle, alpha);
        let root = middle.sqrt();
        let (g, h) = (
            -width / (3.0 * middle * root),
            width / (2.0 * middle * middle * root),
        );
        self.row(k, &cell.middle, g, h);
        for end in 0..2 {
            let law = cell.law(end, alpha);
            let [a, ..] = law;
            let (da, db, dc) = (&cell.a[end], &cell.b[end], &cell.c);
            let root = a.sqrt();
            self.row(k, da, -width / (12.0 * a * root), width / (8.0 * a * a * root));
            let mut metric = 0.0;
            // Bounds of `a` alone: their slopes and curvatures add up.
            let inverse = mu / (cell.cap - a);
            let (mut slope, mut bend) = (inverse, inverse * inverse / mu);
            for d in 0..D {
                let scale = scales[d];
                let motion = cell.motion(end, law, &points[d], scale);
                let [q1, q2, q3] = motion.q;
                let inverse = mu / (1.0 - motion.jerk * motion.jerk);
                let g = 2.0 * motion.jerk * inverse;
                let h = 2.0 * (1.0 + motion.jerk * motion.jerk) * inverse * inverse / mu;
                let (ra, half) = (root * scale[2], 0.5 * motion.jerk / a);
                let values =
                    std::array::from_fn(|j| ra * (q3 * da[j] + 3.0 * q2 * db[j] + q1 * dc[j]) + half * da[j]);
                self.row(k, &values, g, h);
                if end != 0 {
                    continue;
                }
                let v = motion.acceleration;
                let inverse = mu / (1.0 - v * v);
                let (g, h) = (2.0 * v * inverse, 2.0 * (1.0 + v * v) * inverse * inverse / mu);
                let values = std::array::from_fn(|j| scale[1] * (q2 * da[j] + q1 * db[j]));
                self.row(k, &values, g, h);
                let used = motion.velocity2 / a;
                let inverse = mu * used / (1.0 - motion.velocity2);
                slope += inverse;
                bend += inverse * inverse / mu;
                if layout.metric[d] {
                    metric += q1 * q1;
                }
            }
            if end != 0 {
                continue;
            }
            let used = metric / (feed * feed);
            let inverse = mu * used / (1.0 - a * used);
            slope += inverse;
            bend += inverse * inverse / mu;
            self.row(k, da, slope, bend);
        }
    }
}

/// What one interval adds: by the law's coefficients, and axis by axis by the four control points.
struct Local<const D: usize> {
    law: [[f64; LAW]; LAW],
    mixed: [[[f64; LAW]; 4]; D],
    points: [[[[f64; D]; D]; 4]; 4],
    law_gradient: [f64; LAW],
    point_gradient: [[f64; D]; 4],
}

impl<const D: usize> Local<D> {
    fn new() -> Self {
        Self {
            law: [[0.0; LAW]; LAW],
            mixed: [[[0.0; LAW]; 4]; D],
            points: [[[[0.0; D]; D]; 4]; 4],
            law_gradient: [0.0; LAW],
            point_gradient: [[0.0; D]; 4],
        }
    }

    /// A function of the law alone, from its `k`-th coefficient, with slope `g` and curvature `h` of the merit by it.
    fn law_row(&mut self, k: usize, values: &[f64; 3], g: f64, h: f64) {
        for x in 0..3 {
            self.law_gradient[k + x] += g * values[x];
            for y in 0..=x {
                self.law[k + x][k + y] += h * values[x] * values[y];
            }
        }
    }

    /// A function of the law and one axis of the control points.
    fn row(&mut self, k: usize, d: usize, law: &[f64; 3], points: &[f64; 4], g: f64, h: f64) {
        self.law_row(k, law, g, h);
        for l in 0..4 {
            self.point_gradient[l][d] += g * points[l];
            let hp = h * points[l];
            for x in 0..3 {
                self.mixed[d][l][k + x] += hp * law[x];
            }
            for m in 0..=l {
                self.points[l][m][d][d] += hp * points[m];
            }
        }
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "the innermost loop: all of them are at hand where it is called"
    )]
    fn cell(
        &mut self,
        cell: &Cell,
        k: usize,
        alpha: &[f64],
        points: &[[f64; 4]; D],
        scales: &[[f64; 3]; D],
        (layout, feed): (&Layout<D>, f64),
        mu: f64,
    ) {
        let width = cell.width;
        let middle = of3(&cell.middle, alpha);
        let root = middle.sqrt();
        self.law_row(
            k,
            &cell.middle,
            -width / (3.0 * middle * root),
            width / (2.0 * middle * middle * root),
        );
        for end in 0..2 {
            let law = cell.law(end, alpha);
            let [a, b, c] = law;
            let (da, db, dc) = (&cell.a[end], &cell.b[end], &cell.c);
            let path = &cell.path[end];
            let root = a.sqrt();
            self.law_row(k, da, -width / (12.0 * a * root), width / (8.0 * a * a * root));
            let mut metric = 0.0;
            let mut rates = [0.0; D];
            for d in 0..D {
                let scale = scales[d];
                let motion = cell.motion(end, law, &points[d], scale);
                let [q1, q2, q3] = motion.q;
                // Jerk: -ln(1 - j^2).
                let inverse = mu / (1.0 - motion.jerk * motion.jerk);
                let (g, h) = (
                    2.0 * motion.jerk * inverse,
                    2.0 * (1.0 + motion.jerk * motion.jerk) * inverse * inverse / mu,
                );
                let (ra, half) = (root * scale[2], 0.5 * motion.jerk / a);
                let by_law =
                    std::array::from_fn(|j| ra * (q3 * da[j] + 3.0 * q2 * db[j] + q1 * dc[j]) + half * da[j]);
                let (w1, w2, w3) = (ra * c, 3.0 * ra * b, ra * a);
                let by_points = std::array::from_fn(|l| w3 * path[2][l] + w2 * path[1][l] + w1 * path[0][l]);
                self.row(k, d, &by_law, &by_points, g, h);
                if end != 0 {
                    continue;
                }
                let v = motion.acceleration;
                let inverse = mu / (1.0 - v * v);
                let (g, h) = (2.0 * v * inverse, 2.0 * (1.0 + v * v) * inverse * inverse / mu);
                let s = scale[1];
                let by_law = std::array::from_fn(|j| s * (q2 * da[j] + q1 * db[j]));
                let by_points = std::array::from_fn(|l| s * (path[1][l] * a + path[0][l] * b));
                self.row(k, d, &by_law, &by_points, g, h);
                // Velocity: -ln(1 - v^2).
                let inverse = mu / (1.0 - motion.velocity2);
                let h = if motion.velocity2 > ASLEEP {
                    inverse * inverse / mu
                } else {
                    0.0
                };
                let s = scale[0] * scale[0] * q1;
                let by_law = da.map(|x| s * q1 * x);
                let by_points = path[0].map(|x| 2.0 * a * s * x);
                self.row(k, d, &by_law, &by_points, inverse, h);
                rates[d] = q1;
                if layout.metric[d] {
                    metric += q1 * q1;
                }
            }
            if end != 0 {
                continue;
            }
            let inverse = mu / (cell.cap - a);
            self.law_row(k, da, inverse, inverse * inverse / mu);
            if feed.is_finite() {
                let f = 1.0 / (feed * feed);
                let used = a * metric * f;
                let inverse = mu / (1.0 - used);
                let h = if used > ASLEEP {
                    inverse * inverse / mu
                } else {
                    0.0
                };
                self.feed(
                    k,
                    &da.map(|x| metric * f * x),
                    &path[0],
                    &rates,
                    2.0 * a * f,
                    (inverse, h),
                    layout,
                );
            }
        }
    }

    /// The bound of the feed, which joins the axes.
    #[expect(clippy::too_many_arguments, reason = "one row of the problem")]
    fn feed(
        &mut self,
        k: usize,
        law: &[f64; 3],
        first: &[f64; 4],
        rates: &[f64; D],
        factor: f64,
        (g, h): (f64, f64),
        layout: &Layout<D>,
    ) {
        self.law_row(k, law, g, h);
        let rates: [f64; D] = std::array::from_fn(|d| if layout.metric[d] { factor * rates[d] } else { 0.0 });
        for l in 0..4 {
            for d in 0..D {
                self.point_gradient[l][d] += g * first[l] * rates[d];
            }
            if h == 0.0 {
                continue;
            }
            for d in 0..D {
                let hp = h * first[l] * rates[d];
                for x in 0..3 {
                    self.mixed[d][l][k + x] += hp * law[x];
                }
                for m in 0..=l {
                    for e in 0..D {
                        self.points[l][m][d][e] += hp * first[m] * rates[e];
                    }
                }
            }
        }
    }

    fn sample(&mut self, sample: &Sample, points: &[Axes], layout: &Layout<D>, mu: f64) {
        let error = sample.error(points);
        let (off, inside) = sample.off(&error);
        let inverse = 1.0 / (1.0 - dot(&off, &off) / sample.radius2);
        let h1 = 2.0 * mu * inverse / sample.radius2;
        let h2 = 2.0 * inverse / sample.radius2;
        let flat = f64::from(u8::from(inside));
        let (first, count) = GROUPS[sample.group];
        // In the problem's axes.
        let (mut g, mut t, mut own) = ([0.0; D], [0.0; D], [0.0; D]);
        for p in 0..count {
            let column = layout.columns[first + p];
            if column != NONE {
                g[column] = off[p];
                t[column] = sample.along[p];
                own[column] = h1;
            }
        }
        for l in 0..4 {
            for d in 0..D {
                self.point_gradient[l][d] += h1 * sample.weights[l] * g[d];
            }
        }
        let mut block = [[0.0; D]; D];
        for d in 0..D {
            for e in 0..D {
                block[d][e] = h1 * (h2 * g[d] * g[e] - flat * t[d] * t[e]);
            }
            block[d][d] += own[d];
        }
        for l in 0..4 {
            for m in 0..=l {
                let w = sample.weights[l] * sample.weights[m];
                for d in 0..D {
                    for e in 0..D {
                        self.points[l][m][d][e] += w * block[d][e];
                    }
                }
            }
        }
    }

    fn scatter(&self, group: usize, layout: &Layout<D>, matrix: &mut [f64], gradient: &mut [f64]) {
        let band = Layout::<D>::BAND;
        let i = layout.from + group;
        let law: [usize; LAW] = std::array::from_fn(|j| layout.alpha(group * STATIONS + j));
        let points: [usize; 4] = std::array::from_fn(|l| layout.point(i + l));
        let mut add = |r: usize, c: usize, value: f64| {
            let (r, c) = if r >= c { (r, c) } else { (c, r) };
            matrix[c * band + r - c] += value;
        };
        for x in 0..LAW {
            gradient[law[x]] += self.law_gradient[x];
            for y in 0..=x {
                add(law[x], law[y], self.law[x][y]);
            }
        }
        for l in 0..4 {
            if points[l] == NONE {
                continue;
            }
            for d in 0..D {
                gradient[points[l] + d] += self.point_gradient[l][d];
                for x in 0..LAW {
                    add(points[l] + d, law[x], self.mixed[d][l][x]);
                }
            }
            for m in 0..=l {
                if points[m] == NONE {
                    continue;
                }
                for d in 0..D {
                    for e in 0..D {
                        if l != m || d >= e {
                            add(points[l] + d, points[m] + e, self.points[l][m][d][e]);
                        }
                    }
                }
            }
        }
    }
}

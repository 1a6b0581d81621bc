//! Start of the optimisation: the stations of a window, and a slow law on them.

use evolvent_path::Axes;

use super::cell::{Cell, STATIONS, of4};
use super::layout::Layout;
use super::{JointOptimizer, Window, scale};
use crate::basis::Basis;
use crate::tube::Sample;

/// Fraction of the local limits that the initial law uses, and the number of stations on each side over which
/// it is smoothed.
const INITIAL_FRACTION: f64 = 0.5;
const SMOOTHING_STATIONS: usize = 4;
/// Fraction of the limits up to which the initial law may go.
const MARGIN: f64 = 0.8;
/// Lower bound of `|q'|`, relative to 1, in the speed limit of the parameter.
const MIN_RATE: f64 = 0.3;

impl JointOptimizer {
    /// Computes the intervals of the window's path and the weights of its samples.
    pub(super) fn prepare<const D: usize>(
        &mut self,
        window: &Window<'_>,
        layout: &Layout<D>,
        samples: &[Sample],
    ) {
        let zone = window.zone;
        let max = |scale: &Axes| {
            layout
                .axes
                .iter()
                .filter(|&&i| window.active[i])
                .map(|&i| scale[i])
                .fold(0.0, f64::max)
                .max(1e-12)
        };
        let (velocity, acceleration, jerk) = (
            max(&window.scales.velocity),
            max(&window.scales.acceleration),
            max(&window.scales.jerk),
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
                let mut cap = 1.0 / (MIN_RATE * velocity);
                for rest in [u - window.rests.0, window.rests.1 - u] {
                    // From rest with maximum jerk: v^3 = 9/2 J s^2.
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

    /// A slow law from the local limits, slowed down until it has a margin everywhere.
    pub(super) fn begin<const D: usize>(&mut self, window: &Window<'_>, layout: &Layout<D>) -> bool {
        let count = self.cells.len() + 2;
        // The constant speed that the interval of each coefficient permits; the outermost are repeated.
        self.trial_alpha.clear();
        for j in 0..count {
            let cell = j.saturating_sub(1).min(self.cells.len() - 1);
            let i = layout.from + cell / STATIONS;
            let mut max = self.cells[cell].cap;
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
            max = max.min(1.0 / (slowest * slowest));
            max = max.min(1.0 / second.sqrt().max(1e-12));
            let slow = libm::cbrt(1.0 / third.sqrt().max(1e-18));
            self.trial_alpha.push(INITIAL_FRACTION * max.min(slow * slow));
        }
        // The minimum over the neighbours, then averages.
        let near = |k: usize| k.saturating_sub(SMOOTHING_STATIONS)..(k + SMOOTHING_STATIONS + 1).min(count);
        self.alpha.clear();
        for k in 0..count {
            let min = self.trial_alpha[near(k)]
                .iter()
                .copied()
                .fold(f64::INFINITY, f64::min);
            self.alpha.push(min);
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
        let factor = MARGIN * factor;
        for alpha in &mut self.alpha {
            *alpha *= factor;
        }
        factor > 0.0
    }
}

//! A tooth period in elements of at most one wave: the map of the state over each of them.
//!
//! A motion with the multiplier `mu` has `r(t - T) = r(t) / mu`, so the delay equation is an ordinary one,
//!
//! ```text
//! m q'' + c q' + k q = -p h(t) r(t),     p = w (1 - 1 / mu)
//! ```
//!
//! with one complex number `p` for depth and multiplier. Over an element the force is a polynomial through
//! Gauss points, and the modes follow it exactly (Volterra equation). The map of the state is then a power
//! series in `p` with real coefficients, computed once for all depths and multipliers. The coefficients have
//! terms of both signs, so elements are short enough that the series needs few terms.

use nalgebra::Complex;

use super::{MillingDelay, Stretch};
use crate::error::ChatterError;
use crate::lobe::Mode;

type C = Complex<f64>;

/// Approximate number of terms of the power series of an element.
const USUAL_TERMS: f64 = 20.0;
/// Maximum number of complex multiplications of one characteristic value: about 10 ms, and ten times as much
/// with many modes.
const MAX_VALUE_WORK: f64 = 4e6;
/// Maximum number of terms of the power series of an element.
const MAX_TERMS: usize = 64;

/// The maps over the elements of a tooth period, for all `|p|` up to a bound.
pub(super) struct Elements {
    states: usize,
    elements: Vec<Element>,
    /// The bound of `|p|`, which scales the terms.
    max_p: f64,
}

enum Element {
    /// No tooth cuts: by rows.
    Free(Vec<f64>),
    /// Terms of the power series in `-p / max_p`, each by rows.
    Cutting(Vec<Vec<f64>>),
}

/// Force of each mode per deflection, relative to its stiffness: its norm bounds the rate of change of
/// vibrations.
pub(super) struct Strength {
    /// Mean over the period, 1/s per m of depth.
    pub(super) mean: f64,
    /// Maximum, 1/s per m of depth.
    max: f64,
}

impl Strength {
    /// Frobenius norm of the force on the complex amplitudes of the modes, each scaled by the root of its
    /// impedance.
    pub(super) fn new(delay: &MillingDelay) -> Self {
        const POINTS: usize = 64;
        let impedance = |mode: &Mode| mode.stiffness_n_m / (std::f64::consts::TAU * mode.frequency_hz);
        let (mut sum, mut max) = (0.0, 0.0_f64);
        for stretch in delay.stretches.iter().filter(|stretch| stretch.cuts) {
            let length = stretch.end - stretch.start;
            for k in 0..POINTS {
                let factors = delay.factors(stretch.start + (k as f64 + 0.5) / POINTS as f64 * length);
                let mut square = 0.0;
                for (mode, row, gain) in &delay.modes {
                    for (other, column, other_gain) in &delay.modes {
                        let force = factors[*row][*column];
                        let damped = 1.0 - mode.damping_ratio * mode.damping_ratio;
                        square += (gain * other_gain).abs() * force * force
                            / (impedance(mode) * impedance(other) * damped);
                    }
                }
                let norm = libm::sqrt(square);
                sum += norm * length / POINTS as f64;
                max = max.max(norm);
            }
        }
        Self {
            mean: sum / delay.period_s,
            max,
        }
    }
}

impl Elements {
    /// Waves of the fastest mode in the cut of one tooth period.
    pub(super) fn waves(delay: &MillingDelay) -> f64 {
        let fastest = delay.modes.iter().map(|(mode, ..)| mode.frequency_hz);
        let cutting = delay.stretches.iter().filter(|stretch| stretch.cuts);
        fastest.fold(0.0, f64::max) * cutting.map(|stretch| stretch.end - stretch.start).sum::<f64>()
    }

    /// Number of elements in a section: at most one wave in each, including the effect of the cut, and a
    /// small force in each.
    fn count(delay: &MillingDelay, stretch: &Stretch, strength: &Strength, max_p: f64) -> f64 {
        let fastest = delay.modes.iter().map(|(mode, ..)| mode.frequency_hz);
        let turns = match delay.force {
            super::Force::Constant(_) => 0.0,
            super::Force::Teeth { turn, .. } => turn / std::f64::consts::PI,
        };
        let waves_s = fastest.fold(0.0, f64::max) + turns;
        let length = stretch.end - stretch.start;
        libm::ceil((waves_s * length).max(0.5 * max_p * strength.max * length)).max(1.0)
    }

    /// Complex multiplications of one characteristic value.
    pub(super) fn work(delay: &MillingDelay, strength: &Strength, max_p: f64) -> f64 {
        let states = delay.states() as f64;
        let cutting = delay.stretches.iter().filter(|stretch| stretch.cuts);
        let count: f64 = cutting
            .map(|stretch| Self::count(delay, stretch, strength, max_p))
            .sum();
        count * states * states * (USUAL_TERMS + 6.0 * states)
    }

    /// Computes the elements with `nodes` Gauss points each, for `|p|` up to `max_p`.
    ///
    /// # Errors
    /// A period with too many waves.
    pub(super) fn new(
        delay: &MillingDelay,
        strength: &Strength,
        nodes: usize,
        max_p: f64,
    ) -> Result<Self, ChatterError> {
        let states = delay.states();
        let waves = Self::waves(delay);
        let max_work = MAX_VALUE_WORK * (0.25 * (states * states) as f64).clamp(1.0, 10.0);
        if Self::work(delay, strength, max_p) > max_work {
            return Err(ChatterError::TooManyWaves {
                waves,
                modes: states / 2,
            });
        }
        let mut elements = Vec::new();
        for stretch in &delay.stretches {
            let length = stretch.end - stretch.start;
            if !stretch.cuts {
                elements.push(Element::Free(free(delay, length)));
                continue;
            }
            let count = Self::count(delay, stretch, strength, max_p);
            let rule = ElementRule::new(delay, nodes, length / count);
            for k in 0..count as usize {
                let start = stretch.start + k as f64 / count * length;
                let terms = rule
                    .terms(delay, start, max_p)
                    .ok_or(ChatterError::Unresolved { waves })?;
                elements.push(Element::Cutting(terms));
            }
        }
        Ok(Self {
            states,
            elements,
            max_p,
        })
    }

    /// Maximum growth of a motion within a period at a `p`.
    pub(super) fn growth(&self, p: C) -> f64 {
        let d = self.states;
        let u = -p / self.max_p;
        let mut map = vec![C::ZERO; d * d];
        for k in 0..d {
            map[k * d + k] = C::ONE;
        }
        let (mut own, mut next) = (map.clone(), map.clone());
        // Logarithms: the size since the beginning, its minimum, and the maximum growth since then.
        let (mut size, mut min, mut max) = (0.0_f64, 0.0_f64, 0.0_f64);
        for element in &self.elements {
            for (k, row) in own.chunks_exact_mut(d).enumerate() {
                row.fill(C::ZERO);
                element.row(k, d, u, row);
            }
            for (row, own) in next.chunks_exact_mut(d).zip(own.chunks_exact(d)) {
                row.fill(C::ZERO);
                for (factor, source) in own.iter().zip(map.chunks_exact(d)) {
                    for (target, source) in row.iter_mut().zip(source) {
                        *target += factor * source;
                    }
                }
            }
            let norm = libm::sqrt(next.iter().map(C::norm_sqr).sum::<f64>() / d as f64);
            if !(norm > 0.0 && norm.is_finite()) {
                break;
            }
            for (target, source) in map.iter_mut().zip(&next) {
                *target = source / norm;
            }
            size += libm::log(norm);
            min = min.min(size);
            max = max.max(size - min);
        }
        libm::exp(max)
    }

    /// `det(1 - z M(p))`, with `M(p)` the map of the state over a period.
    ///
    /// The states between elements are eliminated one after the other, with pivoting, from the equations of
    /// both ends of each element. A product of the maps would lose a motion that decays while another grows
    /// by 1e10.
    pub(super) fn determinant(&self, p: C, z: C) -> C {
        let d = self.states;
        let u = -p / self.max_p;
        let width = 3 * d;
        // Columns: the state in between, at the beginning, and at the end. Rows: the elements so far, the
        // next one.
        let mut rows = vec![C::ZERO; 2 * d * width];
        // Before the first element the state in between is that at the beginning.
        for k in 0..d {
            rows[k * width + k] = C::ONE;
            rows[k * width + d + k] = -C::ONE;
        }
        let mut product = C::ONE;
        for element in &self.elements {
            for (k, row) in rows.chunks_exact_mut(width).enumerate() {
                row[2 * d..].fill(C::ZERO);
                if k >= d {
                    row.fill(C::ZERO);
                    row[d + k] = C::ONE;
                    element.row(k - d, d, u, &mut row[..d]);
                }
            }
            product *= eliminate(&mut rows, 2 * d, width, d);
            // The end of the element is the next state in between.
            let (before, after) = rows.split_at_mut(d * width);
            for (target, source) in before.chunks_exact_mut(width).zip(after.chunks_exact(width)) {
                target[..d].copy_from_slice(&source[2 * d..]);
                target[d..2 * d].copy_from_slice(&source[d..2 * d]);
            }
        }
        // The beginning is z times the end.
        let mut last = vec![C::ZERO; d * d];
        for (target, row) in last.chunks_exact_mut(d).zip(rows.chunks_exact(width)) {
            for ((target, end), begin) in target.iter_mut().zip(&row[..d]).zip(&row[d..2 * d]) {
                *target = end + z * begin;
            }
        }
        product * eliminate(&mut last, d, d, d)
    }
}

impl Element {
    /// A row of the map, negated.
    fn row(&self, k: usize, d: usize, u: C, row: &mut [C]) {
        let part = k * d..(k + 1) * d;
        match self {
            Self::Free(free) => {
                for (target, free) in row.iter_mut().zip(&free[part]) {
                    *target = C::new(-free, 0.0);
                }
            }
            Self::Cutting(terms) => {
                for term in terms.iter().rev() {
                    for (target, term) in row.iter_mut().zip(&term[part.clone()]) {
                        *target = *target * u - *term;
                    }
                }
            }
        }
    }
}

/// Eliminates the first `columns` columns by partial pivoting; returns the product of the pivots with the
/// sign of the swaps.
fn eliminate(matrix: &mut [C], rows: usize, width: usize, columns: usize) -> C {
    let mut product = C::ONE;
    for step in 0..columns {
        let largest = (step..rows)
            .max_by(|a, b| {
                let [a, b] = [a, b].map(|row| matrix[row * width + step].norm_sqr());
                a.total_cmp(&b)
            })
            .unwrap_or(step);
        if largest != step {
            for column in step..width {
                matrix.swap(step * width + column, largest * width + column);
            }
            product = -product;
        }
        let pivot = matrix[step * width + step];
        product *= pivot;
        if pivot == C::ZERO {
            return C::ZERO;
        }
        let inverse = pivot.inv();
        let (above, below) = matrix.split_at_mut((step + 1) * width);
        let source = &above[step * width + step..];
        for row in below.chunks_exact_mut(width).take(rows - step - 1) {
            let factor = row[step] * inverse;
            for (target, source) in row[step..].iter_mut().zip(source) {
                *target -= factor * source;
            }
        }
    }
    product
}

/// Free motion of a mode over a time from deflection 1, and from velocity omega: deflection, and velocity
/// over omega.
fn swing(mode: &Mode, time: f64) -> [[f64; 2]; 2] {
    let omega = std::f64::consts::TAU * mode.frequency_hz;
    let ratio = mode.damping_ratio;
    let damped = libm::sqrt(1.0 - ratio * ratio);
    let decay = libm::exp(-ratio * omega * time);
    let (c, s) = (
        decay * libm::cos(damped * omega * time),
        decay * libm::sin(damped * omega * time) / damped,
    );
    [[c + ratio * s, s], [-s, c - ratio * s]]
}

/// The free motion of all modes; states are deflection and velocity over omega, by modes.
fn free(delay: &MillingDelay, time: f64) -> Vec<f64> {
    let d = delay.states();
    let mut map = vec![0.0; d * d];
    for (i, (mode, ..)) in delay.modes.iter().enumerate() {
        let swing = swing(mode, time);
        for (row, swing) in swing.iter().enumerate() {
            for (column, value) in swing.iter().enumerate() {
                map[(2 * i + row) * d + 2 * i + column] = *value;
            }
        }
    }
    map
}

/// Data common to all elements of one length.
struct ElementRule {
    length: f64,
    points: Vec<f64>,
    /// Deflection along each direction at each point, per force at each point along it: direction, point,
    /// point.
    inner: Vec<Vec<f64>>,
    /// Deflection along each direction at each point, of each state at the start: direction, point, state.
    start: Vec<Vec<f64>>,
    /// State at the end, per force along the mode's direction at each point: state, point.
    end: Vec<f64>,
    /// State at the end of each state at the start.
    free: Vec<f64>,
}

impl ElementRule {
    fn new(delay: &MillingDelay, nodes: usize, length: f64) -> Self {
        let (d, r) = (delay.states(), delay.directions);
        let (points, _) = gauss(nodes);
        // The motion within an element is a wave times a polynomial: twice its degree is more than enough.
        let (inner_points, weights) = gauss(2 * nodes + 8);
        let mut inner = vec![vec![0.0; nodes * nodes]; r];
        let mut start = vec![vec![0.0; nodes * d]; r];
        let mut end = vec![0.0; d * nodes];
        for (row, upto) in points.iter().copied().chain([1.0]).enumerate() {
            for (point, weight) in inner_points.iter().zip(&weights) {
                let at = upto * point;
                let basis = lagrange(&points, at);
                for (i, (mode, direction, gain)) in delay.modes.iter().enumerate() {
                    let omega = std::f64::consts::TAU * mode.frequency_hz;
                    // Acceleration over omega per force.
                    let factor = gain * omega / mode.stiffness_n_m * weight * upto * length;
                    let [[_, deflection], [_, velocity]] = swing(mode, (upto - at) * length);
                    for (j, basis) in basis.iter().enumerate() {
                        if row < nodes {
                            inner[*direction][row * nodes + j] += factor * deflection * basis;
                        } else {
                            end[2 * i * nodes + j] += factor * deflection * basis;
                            end[(2 * i + 1) * nodes + j] += factor * velocity * basis;
                        }
                    }
                }
            }
        }
        for (row, point) in points.iter().enumerate() {
            for (i, (mode, direction, _)) in delay.modes.iter().enumerate() {
                let [of_deflection, _] = swing(mode, point * length);
                start[*direction][row * d + 2 * i] = of_deflection[0];
                start[*direction][row * d + 2 * i + 1] = of_deflection[1];
            }
        }
        Self {
            length,
            points,
            inner,
            start,
            end,
            free: free(delay, length),
        }
    }

    /// Terms of the power series in `-p / max_p` from a time of the period on; `None` if too many are
    /// needed.
    fn terms(&self, delay: &MillingDelay, from: f64, max_p: f64) -> Option<Vec<Vec<f64>>> {
        let (d, r, n) = (delay.states(), delay.directions, self.points.len());
        let factors: Vec<_> = self
            .points
            .iter()
            .map(|point| delay.factors(from + point * self.length))
            .collect();
        let mut terms = vec![self.free.clone()];
        // Deflections at the points, of each state at the start.
        let mut deflections = self.start.clone();
        let mut forces = vec![vec![0.0; n * d]; r];
        while terms.len() < MAX_TERMS {
            for (row, force) in forces.iter_mut().enumerate() {
                force.fill(0.0);
                for (column, deflection) in deflections.iter().enumerate() {
                    for ((force, deflection), factors) in force
                        .chunks_exact_mut(d)
                        .zip(deflection.chunks_exact(d))
                        .zip(&factors)
                    {
                        let factor = max_p * factors[row][column];
                        for (force, deflection) in force.iter_mut().zip(deflection) {
                            *force += factor * deflection;
                        }
                    }
                }
            }
            let mut term = vec![0.0; d * d];
            for (state, target) in term.chunks_exact_mut(d).enumerate() {
                let (_, direction, _) = delay.modes[state / 2];
                let weights = &self.end[state * n..(state + 1) * n];
                for (weight, force) in weights.iter().zip(forces[direction].chunks_exact(d)) {
                    for (target, force) in target.iter_mut().zip(force) {
                        *target += weight * force;
                    }
                }
            }
            let size = term.iter().fold(0.0_f64, |max, x| max.max(x.abs()));
            if !size.is_finite() {
                return None;
            }
            terms.push(term);
            // The terms fall like those of an exponential series or faster.
            if size < 1e-17 {
                return Some(terms);
            }
            for (direction, deflection) in deflections.iter_mut().enumerate() {
                deflection.fill(0.0);
                for (weights, target) in self.inner[direction]
                    .chunks_exact(n)
                    .zip(deflection.chunks_exact_mut(d))
                {
                    for (weight, force) in weights.iter().zip(forces[direction].chunks_exact(d)) {
                        for (target, force) in target.iter_mut().zip(force) {
                            *target += weight * force;
                        }
                    }
                }
            }
        }
        None
    }
}

/// Lagrange polynomials of the points at `x`.
fn lagrange(points: &[f64], x: f64) -> Vec<f64> {
    let others = |j: usize| points.iter().enumerate().filter(move |(k, _)| *k != j);
    points
        .iter()
        .enumerate()
        .map(|(j, point)| {
            others(j)
                .map(|(_, other)| (x - other) / (point - other))
                .product()
        })
        .collect()
}

/// Gauss points and weights from 0 to 1: roots of the Legendre polynomial by Newton's method.
fn gauss(count: usize) -> (Vec<f64>, Vec<f64>) {
    let n = count as f64;
    let value = |x: f64| {
        let (mut before, mut here) = (1.0, x);
        for k in 2..=count {
            let k = k as f64;
            (before, here) = (here, ((2.0 * k - 1.0) * x * here - (k - 1.0) * before) / k);
        }
        (here, n * (x * here - before) / (x * x - 1.0))
    };
    let rule = (0..count).map(|k| {
        let mut x = -libm::cos(std::f64::consts::PI * (k as f64 + 0.75) / (n + 0.5));
        for _ in 0..20 {
            let (here, slope) = value(x);
            x -= here / slope;
        }
        let slope = value(x).1;
        (0.5 * (1.0 + x), 1.0 / ((1.0 - x * x) * slope * slope))
    });
    rule.unzip()
}

//! The characteristic function of the delay equation, whose zeros are the inverse multipliers.
//!
//! `g(z) = det(1 - z M(w (1 - z)))`, with `M(p)` the map of the state over a period ([`super::elements`]) and
//! `z = 1 / mu`, has no poles, and is 1 at z = 0. The cut is stable if it has no zero within the unit circle;
//! the number of turns of its argument along the circle counts them (H. Nyquist). Its values at N points of
//! the circle give N coefficients of its power series, and the last of these show whether N suffices. Turns
//! are counted, and zeros are found, by the series.

use nalgebra::Complex;

use super::elements::Elements;

type C = Complex<f64>;

/// Maximum number of times that the number of points is doubled.
const MAX_DOUBLINGS: usize = 3;
/// Maximum rounding error of `g`, relative to its largest value.
const MAX_ROUNDING: f64 = 1e-6;

/// `g` at a depth and an inverse multiplier.
pub(super) fn characteristic(elements: &Elements, depth: f64, z: C) -> C {
    elements.determinant((C::ONE - z) * depth, z)
}

/// `g` on and within a circle about 0, as a power series.
pub(super) struct Circle {
    radius: f64,
    /// Coefficients of the powers of `z / radius`.
    coefficients: Vec<f64>,
}

impl Circle {
    /// Computes the series with as many points, starting with `points`, as bring the last coefficients to 0
    /// within rounding. `None` if there are too many, or if the motion grows so much within a period that the
    /// smaller values are lost.
    pub(super) fn new(elements: &Elements, depth: f64, radius: f64, points: usize) -> Option<Self> {
        let mut count = points.next_multiple_of(16).max(32);
        let at = |k: usize, count: usize| {
            let angle = std::f64::consts::TAU * k as f64 / count as f64;
            let z = C::new(radius * libm::cos(angle), radius * libm::sin(angle));
            characteristic(elements, depth, z)
        };
        // Real coefficients: the lower half of the circle is the conjugate of the upper one.
        let mut values: Vec<C> = (0..=count / 2).map(|k| at(k, count)).collect();
        let mut before = f64::INFINITY;
        for _ in 0..=MAX_DOUBLINGS {
            // `max` would ignore NaN.
            if values.iter().any(|value| value.norm().is_nan()) {
                return None;
            }
            let largest = values.iter().fold(0.0_f64, |max, value| max.max(value.norm()));
            if largest >= 1e9 {
                return None;
            }
            let coefficients = coefficients(&values);
            let size = |part: &[f64]| part.iter().fold(0.0_f64, |max, value| max.max(value.abs()));
            let tail = size(&coefficients[count - count / 8..]);
            // A truncated series falls steeply; rounding errors, which are larger if a motion grows and
            // decays within a period, do not.
            let is_rounding = size(&coefficients[count / 2..count - count / 4]) <= 30.0 * tail;
            let permitted = if is_rounding { MAX_ROUNDING } else { 1e-11 };
            if tail <= permitted * largest.max(1.0) && (coefficients[0] - 1.0).abs() <= 1e-6 {
                return Some(Self { radius, coefficients });
            }
            // More points do not help.
            if is_rounding && tail > 0.1 * before {
                return None;
            }
            before = tail;
            count *= 2;
            let mut both = Vec::with_capacity(count / 2 + 1);
            for (k, value) in values.iter().enumerate() {
                if k > 0 {
                    both.push(at(2 * k - 1, count));
                }
                both.push(*value);
            }
            values = both;
        }
        None
    }

    /// `g` and its derivative by `z / radius`, at a `z / radius`.
    fn value(&self, z: C) -> (C, C) {
        let (mut value, mut slope) = (C::ZERO, C::ZERO);
        for coefficient in self.coefficients.iter().rev() {
            slope = slope * z + value;
            value = value * z + *coefficient;
        }
        (value, slope)
    }

    /// Points of the upper half of the circle, so close that `g` changes by less than its magnitude between
    /// neighbours: the angle, `g` and the magnitude of its logarithmic derivative.
    fn walk(&self) -> Vec<(f64, C, f64)> {
        let at = |angle: f64| {
            let (value, slope) = self.value(C::new(libm::cos(angle), libm::sin(angle)));
            (angle, value, slope.norm() / value.norm())
        };
        let pi = std::f64::consts::PI;
        let count = self.coefficients.len() / 2;
        let mut walked = vec![at(0.0)];
        let mut ahead: Vec<_> = (1..=count)
            .rev()
            .map(|k| at(pi * k as f64 / count as f64))
            .collect();
        while let (Some(here), Some(next)) = (walked.last().copied(), ahead.last().copied()) {
            let step = next.0 - here.0;
            if step * here.2.max(next.2) > 0.7 && step > 1e-11 {
                ahead.push(at(here.0 + 0.5 * step));
            } else {
                walked.push(next);
                ahead.pop();
            }
        }
        walked
    }

    /// Number of zeros within the circle.
    pub(super) fn zeros(&self) -> usize {
        let turns: f64 = self
            .walk()
            .windows(2)
            .map(|pair| (pair[1].1 / pair[0].1).arg())
            .sum();
        // The lower half has as many turns.
        libm::round(turns / std::f64::consts::PI).max(0.0) as usize
    }

    /// Zeros near the circle and within, by Newton's method from the points of the circle that are nearest to
    /// any: `z` in the upper half, without duplicates.
    pub(super) fn nearest_zeros(&self) -> Vec<C> {
        let walked = self.walk();
        let nearness = |k: usize| walked.get(k).map_or(0.0, |point| point.2);
        let mut zeros: Vec<C> = Vec::new();
        for (k, (angle, ..)) in walked.iter().enumerate() {
            let before = k.checked_sub(1).map_or(0.0, nearness);
            if before > nearness(k) || nearness(k + 1) > nearness(k) {
                continue;
            }
            let mut z = C::new(libm::cos(*angle), libm::sin(*angle));
            let mut is_found = false;
            for _ in 0..40 {
                let (value, slope) = self.value(z);
                let step = value / slope;
                // Stays within the range of the series.
                let step = step * (0.2 / step.norm()).min(1.0);
                z -= step;
                if z.norm() > 1.2 || !step.norm().is_finite() {
                    break;
                }
                if step.norm() < 1e-12 {
                    is_found = true;
                    break;
                }
            }
            let z = C::new(z.re, z.im.abs());
            if is_found && zeros.iter().all(|known| (known - z).norm() > 1e-8) {
                zeros.push(z);
            }
        }
        for zero in &mut zeros {
            *zero *= self.radius;
        }
        zeros.sort_by(|a, b| a.norm().total_cmp(&b.norm()));
        zeros
    }
}

/// Coefficients of a real power series from its values at equally spaced points of the upper half of the unit
/// circle.
fn coefficients(values: &[C]) -> Vec<f64> {
    let half = values.len() - 1;
    let count = 2 * half;
    let table: Vec<(f64, f64)> = (0..count)
        .map(|k| {
            let angle = std::f64::consts::TAU * k as f64 / count as f64;
            (libm::cos(angle), libm::sin(angle))
        })
        .collect();
    (0..count)
        .map(|power| {
            let sum: f64 = values
                .iter()
                .enumerate()
                .map(|(k, value)| {
                    let (c, s) = table[k * power % count];
                    let part = value.re * c + value.im * s;
                    if k == 0 || k == half { part } else { 2.0 * part }
                })
                .sum();
            sum / count as f64
        })
        .collect()
}

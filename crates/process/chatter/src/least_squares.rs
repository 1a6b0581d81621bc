//! The published method of least squares, for comparison.
//!
//! S. L. Leonov and E. V. Veglov use sines for both deflections, with unknown amplitudes, phase, frequency
//! and means, and minimise the squared residuals of both equations over a period (their equation 4). Because
//! rest is always a minimum, they use three stages: step the amplitudes and fit frequency and phase, noting
//! local minima; refine the amplitudes; refine everything. This implementation uses one frequency (two drift
//! apart to meaningless values) and any number of harmonics.
//!
//! With one harmonic, the residual at the true cycle is not zero: the minimum is beside it, and there are
//! minima without a cycle. With five harmonics, [`Fit::normalised`] distinguishes them: 1e-9 to 3e-6 at true
//! cycles, 1e-4 and more at false ones.

use crate::elimination::solve;
use crate::error::{ChatterError, number};
use crate::model::{Model, State};

/// Samples over a period.
const SAMPLES: usize = 64;
/// Steps of the amplitude of V2, and the range relative to the amplitude at which the speed reaches the
/// floor. False minima beyond it are part of the method.
const STEPS: usize = 36;
const REACH: f64 = 1.5;
/// Steps of the ratio of the amplitudes.
const RATIOS: usize = 10;
/// Fitted unknowns before the higher harmonics: w, phase, A1, A2, V10, V20.
const BASIC: usize = 6;

/// A minimum of the squared residual.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Amplitudes of the fundamentals of V1 and V2, m.
    pub amplitude_m: [f64; 2],
    /// Means of V1 and V2, m.
    pub mean_m: [f64; 2],
    /// Mean over the period of the squared residuals of both equations, N2.
    pub residual_n2: f64,
    /// ... over the square of the largest elastic force `C2 A2`.
    pub normalised: f64,
    /// Whether the motion reaches speeds at which the force law is not trusted.
    pub reaches_floor: bool,
}

/// The function that is minimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// The squared residual, as published.
    Residual,
    /// The squared residual over the square of the elastic force.
    Normalised,
}

/// The least squares in three stages.
///
/// `harmonics` from 1 to 16. The result contains the minima of the third stage, in ascending order of
/// amplitude.
///
/// # Errors
/// A number of harmonics out of range, no steady cut, a separate law for the radial force.
pub fn least_squares(
    model: &Model<'_>,
    harmonics: usize,
    measure: Measure,
) -> Result<Vec<Fit>, ChatterError> {
    number("harmonics", harmonics as f64, 1.0, 16.0)?;
    if model.has_radial_law() {
        return Err(ChatterError::RadialLaw);
    }
    let search = Search {
        model,
        harmonics,
        measure,
    };
    let rest = model.equilibrium()?;
    let tool = model.tool();
    let omega = std::f64::consts::TAU * tool.axes[1].frequency_hz();
    let max = (tool.speed_m_min - tool.floor_m_min) / 60.0 / omega;
    // First stage: amplitudes in steps (those of V1 by their ratio to V2), with frequency and phase fitted at
    // each.
    let mut stepped: Vec<Option<(f64, Vec<f64>)>> = Vec::with_capacity(STEPS);
    for i in 0..STEPS {
        let second = REACH * max * (i + 1) as f64 / STEPS as f64;
        let mut best: Option<(f64, Vec<f64>)> = None;
        for k in 0..RATIOS {
            let first = second * libm::pow(10.0, -3.0 + 3.0 * k as f64 / (RATIOS - 1) as f64);
            for start in 0..4 {
                let mut unknowns = vec![0.0; search.size()];
                let phase = std::f64::consts::FRAC_PI_2 * f64::from(start);
                let [mean_1, mean_2] = rest.deflection_m;
                unknowns[..BASIC].copy_from_slice(&[omega, phase, first, second, mean_1, mean_2]);
                let value = search.fit(&mut unknowns, &[0, 1], 8);
                if let Some(value) = value.filter(|value| best.as_ref().is_none_or(|best| *value < best.0)) {
                    best = Some((value, unknowns));
                }
            }
        }
        stepped.push(best);
    }
    let value = |i: usize| {
        let at = stepped.get(i).and_then(Option::as_ref);
        at.map_or(f64::INFINITY, |best| best.0)
    };
    let mut fits: Vec<Fit> = Vec::new();
    // The first step is next to rest, which is always a minimum.
    for i in 1..STEPS {
        let lowest = value(i - 1) > value(i) && value(i + 1) > value(i);
        let Some(Some((_, start))) = stepped.get(i).filter(|_| lowest) else {
            continue;
        };
        let mut unknowns = start.clone();
        // Second and third stage.
        let all: Vec<usize> = (0..search.size()).collect();
        if search.fit(&mut unknowns, &[2, 3], 30).is_none() || search.fit(&mut unknowns, &all, 200).is_none()
        {
            continue;
        }
        let Some(fit) = search.report(&unknowns) else {
            continue;
        };
        // Converged to rest, or diverged.
        let amplitude = fit.amplitude_m[1];
        let known = |other: &Fit| (other.amplitude_m[1] / amplitude - 1.0).abs() < 1e-3;
        if (0.02 * max..2.0 * REACH * max).contains(&amplitude) && !fits.iter().any(known) {
            fits.push(fit);
        }
    }
    fits.sort_by(|a, b| a.amplitude_m[1].total_cmp(&b.amplitude_m[1]));
    Ok(fits)
}

struct Search<'a, 'b> {
    model: &'a Model<'b>,
    harmonics: usize,
    measure: Measure,
}

impl Search<'_, '_> {
    fn size(&self) -> usize {
        BASIC + 4 * (self.harmonics - 1)
    }

    /// Value, first and second derivative by the angle, of the component of V1 or V2 that belongs to an
    /// unknown, per unit of it; and its coordinate.
    fn part(&self, unknowns: &[f64], unknown: usize, angle: f64) -> (usize, [f64; 3]) {
        let wave = |n: f64, sine: bool| {
            let (c, s) = (libm::cos(n * angle), libm::sin(n * angle));
            if sine {
                [s, n * c, -n * n * s]
            } else {
                [c, -n * s, -n * n * c]
            }
        };
        match unknown {
            1 | 2 => {
                let (c, s) = (libm::cos(angle + unknowns[1]), libm::sin(angle + unknowns[1]));
                let first = unknowns[2];
                if unknown == 2 {
                    (0, [c, -s, -c])
                } else {
                    (0, [-first * s, -first * c, first * s])
                }
            }
            3 => (1, wave(1.0, false)),
            4 => (0, [1.0, 0.0, 0.0]),
            5 => (1, [1.0, 0.0, 0.0]),
            _ => {
                let k = unknown - BASIC;
                let n = (k / 4 + 2) as f64;
                (k % 4 / 2, wave(n, k % 2 == 1))
            }
        }
    }

    /// Residuals at all samples and their derivatives by the free unknowns, optionally scaled by the elastic
    /// force, and the lowest speed; `None` where the law has no force.
    fn residuals(&self, unknowns: &[f64], free: &[usize]) -> Option<(Vec<f64>, Vec<f64>, f64)> {
        let model = self.model;
        let omega = unknowns[0];
        let axes = model.axes();
        let scale = match self.measure {
            Measure::Residual => 1.0,
            Measure::Normalised => 1.0 / (axes[1].stiffness_n_m * unknowns[3]),
        };
        let mut residuals = Vec::with_capacity(2 * SAMPLES);
        let mut derivatives = Vec::with_capacity(2 * SAMPLES * free.len());
        let floor = model.tool().floor_m_min;
        let mut lowest = f64::INFINITY;
        for sample in 0..SAMPLES {
            let angle = std::f64::consts::TAU * sample as f64 / SAMPLES as f64;
            // Value and derivatives by the angle of V1 and V2.
            let mut motion = [[0.0; 3]; 2];
            for unknown in 2..self.size() {
                let (coordinate, part) = self.part(unknowns, unknown, angle);
                for (sum, part) in motion[coordinate].iter_mut().zip(part) {
                    *sum += unknowns[unknown] * part;
                }
            }
            let state = State::new(
                motion[0][0],
                motion[1][0],
                omega * motion[0][1],
                omega * motion[1][1],
            );
            let (speed, depth) = model.cut_at(&state);
            if !(speed.is_finite() && depth.is_finite()) {
                return None;
            }
            lowest = lowest.min(speed);
            let pull = model.pull(speed.max(floor), depth).ok()?;
            let e = model.direction();
            for i in 0..2 {
                let axis = &axes[i];
                let own = axis.mass_kg * omega * omega * motion[i][2]
                    + axis.damping_ns_m * omega * motion[i][1]
                    + axis.stiffness_n_m * motion[i][0];
                let residual = own - e[i] * pull.force;
                residuals.push(scale * residual);
                for &unknown in free {
                    let mut by = if unknown == 0 {
                        let (_, z1) = model.machine_axes(motion[0][1], motion[1][1]);
                        2.0 * axis.mass_kg * omega * motion[i][2] + axis.damping_ns_m * motion[i][1]
                            - e[i] * pull.per_zdot * z1
                    } else {
                        let (coordinate, part) = self.part(unknowns, unknown, angle);
                        let at = |value: f64| {
                            if coordinate == 0 {
                                (value, 0.0)
                            } else {
                                (0.0, value)
                            }
                        };
                        let (v, rate) = (at(part[0]), at(omega * part[1]));
                        let (y, _) = model.machine_axes(v.0, v.1);
                        let (_, z_dot) = model.machine_axes(rate.0, rate.1);
                        let own = if coordinate == i {
                            axis.mass_kg * omega * omega * part[2]
                                + axis.damping_ns_m * omega * part[1]
                                + axis.stiffness_n_m * part[0]
                        } else {
                            0.0
                        };
                        own - e[i] * (pull.per_y * y + pull.per_zdot * z_dot)
                    };
                    by *= scale;
                    if unknown == 3 && self.measure == Measure::Normalised {
                        by -= scale * residual / unknowns[3];
                    }
                    derivatives.push(by);
                }
            }
        }
        Some((residuals, derivatives, lowest))
    }

    /// Levenberg-Marquardt method on the unknowns `free`; returns the mean squared residual.
    fn fit(&self, unknowns: &mut Vec<f64>, free: &[usize], max: usize) -> Option<f64> {
        let count = free.len();
        let mean = |residuals: &[f64]| residuals.iter().map(|r| r * r).sum::<f64>() / SAMPLES as f64;
        let (mut residuals, mut derivatives, _) = self.residuals(unknowns, free)?;
        let mut value = mean(&residuals);
        let mut damping = 1e-3;
        for _ in 0..max {
            let mut normal = vec![0.0; count * count];
            let mut gradient = vec![0.0; count];
            for (row, residual) in derivatives.chunks_exact(count).zip(&residuals) {
                for i in 0..count {
                    gradient[i] -= row[i] * residual;
                    for k in 0..count {
                        normal[i * count + k] += row[i] * row[k];
                    }
                }
            }
            let mut improved = false;
            while damping < 1e12 {
                let mut matrix = normal.clone();
                for i in 0..count {
                    matrix[i * count + i] *= 1.0 + damping;
                }
                let mut step = gradient.clone();
                let mut trial = unknowns.clone();
                if solve::<1>(&mut matrix, &mut step, count) {
                    for (unknown, step) in free.iter().zip(&step) {
                        trial[*unknown] += step;
                    }
                    if let Some((next, by, _)) = self.residuals(&trial, free).filter(|_| trial[3] > 0.0)
                        && mean(&next) < value
                    {
                        improved = value - mean(&next) > 1e-13 * value;
                        value = mean(&next);
                        (*unknowns, residuals, derivatives) = (trial, next, by);
                        damping *= 0.2;
                        break;
                    }
                }
                damping *= 4.0;
            }
            if !improved {
                break;
            }
        }
        Some(value)
    }

    fn report(&self, unknowns: &[f64]) -> Option<Fit> {
        let plain = Search {
            measure: Measure::Residual,
            ..*self
        };
        let (residuals, _, lowest) = plain.residuals(unknowns, &[])?;
        let residual_n2 = residuals.iter().map(|r| r * r).sum::<f64>() / SAMPLES as f64;
        let elastic = self.model.axes()[1].stiffness_n_m * unknowns[3];
        Some(Fit {
            frequency_hz: unknowns[0] / std::f64::consts::TAU,
            amplitude_m: [unknowns[2].abs(), unknowns[3]],
            mean_m: [unknowns[4], unknowns[5]],
            residual_n2,
            normalised: residual_n2 / (elastic * elastic),
            reaches_floor: lowest <= self.model.tool().floor_m_min,
        })
    }
}

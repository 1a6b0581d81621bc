//! Harmonic balance along a branch of motions.
//!
//! Both equations of motion are linear except for one scalar, the tangential force. Its harmonics `P_n`
//! therefore determine the motion: `V_i,n = e_i P_n / (C_i - m_i n^2 w^2 + i n w (G_i + D m_i))`, with the
//! directions `e_i` of the force and an extra damping `D` proportional to the masses, 1/s. The amplitude `A`
//! of the driving coordinate and its phase (a cosine) give `P_1` from `w` and `D`. This leaves 2 N + 2
//! unknowns, `P_0, w, D, P_2 .. P_N, A`, for 2 N + 1 equations: the force of the motion must have these
//! harmonics. The solutions are curves. One linear [`Condition`] selects a point: its amplitude, its extra
//! damping (0: a cycle), or its position along a tangent, which also passes points at which the curve turns
//! back in `A`. The force is sampled over a period (alternating between frequency and time), the Jacobian is
//! exact, and Newton's method needs two or three steps.

use nalgebra::Complex;

use crate::elimination::solve;
use crate::error::ChatterError;
use crate::model::{Equilibrium, Model};
use crate::pair::PairBalance;

type C = Complex<f64>;

/// A periodic motion with extra damping.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Balanced {
    /// `P_0, w, D, Re P_2, -Im P_2, ..., A`; `A` is the amplitude of the driving coordinate, m.
    pub(crate) unknowns: Vec<f64>,
    /// Their derivatives along the curve by the condition.
    pub(crate) tangent: Vec<f64>,
    /// Steps of Newton's method.
    pub(crate) steps: usize,
    /// Lowest and highest cutting speed, m/min.
    pub(crate) speeds: [f64; 2],
    /// Lowest and highest depth of cut, mm.
    pub(crate) depths: [f64; 2],
    /// Fraction of the period out of contact.
    pub(crate) free: f64,
}

impl Balanced {
    pub(crate) fn amplitude(&self) -> f64 {
        self.unknowns.last().copied().unwrap_or(f64::NAN)
    }

    pub(crate) fn omega(&self) -> f64 {
        self.unknowns[1]
    }

    /// The extra damping that makes it periodic, 1/s: positive if it would grow without.
    pub(crate) fn extra(&self) -> f64 {
        self.unknowns[2]
    }

    /// Derivative of the amplitude along the curve.
    pub(crate) fn tangent_amplitude(&self) -> f64 {
        self.tangent.last().copied().unwrap_or(f64::NAN)
    }

    /// Derivative of the extra damping by the amplitude, 1/s per m.
    pub(crate) fn extra_slope(&self) -> f64 {
        self.tangent[2] / self.tangent_amplitude()
    }
}

/// The condition that selects a point of a curve.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Condition<'a> {
    /// The amplitude of the driver, m.
    Amplitude(f64),
    /// The extra damping, 1/s.
    Extra(f64),
    /// Weights of the unknowns, and their weighted sum.
    Along(&'a [f64], f64),
}

/// Working memory and tables for a number of harmonics, for any number of models.
#[derive(Clone, Debug)]
pub(crate) struct Balance {
    harmonics: usize,
    samples: usize,
    /// Residual, relative to the force, before the last step of Newton's method, which squares it.
    tolerance: f64,
    /// `cos n t` and `sin n t` up to twice the harmonics, sample by sample: `[sample][2 n], [2 n + 1]`.
    waves: Vec<f64>,
    matrix: Vec<f64>,
    rhs: Vec<f64>,
    /// Derivatives of the complex harmonics of y and z' by each unknown: `[unknown][n]`.
    by: Vec<[C; 2]>,
    /// For two laws of force.
    pair: Option<Box<PairBalance>>,
    /// Sums over the samples of force, and of its derivatives by y and z', times the waves.
    sums: [Vec<f64>; 3],
}

/// Harmonics of y and z' for a force, with derivatives by `w` and `D`.
struct Response {
    y: C,
    w: C,
    y_by: [C; 2],
    w_by: [C; 2],
}

impl Balance {
    pub(crate) fn new(harmonics: usize) -> Self {
        let harmonics = harmonics.clamp(1, 64);
        // Enough samples that aliases are far beyond the harmonics that are kept.
        let samples = (12 * harmonics).max(64);
        Self::with_samples(harmonics, samples)
    }

    pub(crate) fn with_samples(harmonics: usize, samples: usize) -> Self {
        let harmonics = harmonics.clamp(1, 64);
        let mut waves = Vec::with_capacity(samples * 2 * (2 * harmonics + 1));
        for j in 0..samples {
            for n in 0..=2 * harmonics {
                // Reduced first, so that equal angles have equal bits.
                let angle = std::f64::consts::TAU * ((j * n) % samples) as f64 / samples as f64;
                waves.push(libm::cos(angle));
                waves.push(libm::sin(angle));
            }
        }
        let size = 2 * harmonics + 1;
        Self {
            harmonics,
            samples,
            tolerance: 1e-7,
            waves,
            matrix: vec![0.0; (size + 1) * (size + 1)],
            rhs: vec![0.0; (size + 1) * 2],
            pair: None,
            by: vec![[C::ZERO; 2]; (size + 1) * (harmonics + 1)],
            sums: [const { Vec::new() }; 3].map(|_: Vec<f64>| vec![0.0; 2 * size]),
        }
    }

    /// Ends Newton's method once the residual is below this fraction of the force, before a last step.
    pub(crate) fn until(self, tolerance: f64) -> Self {
        Self { tolerance, ..self }
    }

    pub(crate) fn harmonics(&self) -> usize {
        self.harmonics
    }

    /// Number of equations of the balance of a model; there is one more unknown.
    fn equations(&self, model: &Model<'_>) -> usize {
        if model.has_radial_law() {
            PairBalance::equations(self.harmonics)
        } else {
            2 * self.harmonics + 1
        }
    }

    /// Unknowns of a motion about the steady cut without higher harmonics.
    pub(crate) fn start(
        &self,
        model: &Model<'_>,
        driver: usize,
        rest: &Equilibrium,
        [omega, extra, amplitude]: [f64; 3],
    ) -> Vec<f64> {
        let size = self.equations(model);
        let mut unknowns = vec![0.0; size + 1];
        unknowns[0] = rest.force_n;
        if model.has_radial_law() {
            let elastic = |i: usize| model.axes()[i].stiffness_n_m * rest.deflection_m[i];
            unknowns[0] = elastic(driver);
            unknowns[2 * self.harmonics + 1] = elastic(1 - driver);
        }
        unknowns[1] = omega;
        unknowns[2] = extra;
        unknowns[size] = amplitude;
        unknowns
    }

    /// The unknowns of a motion from a balance with fewer harmonics.
    pub(crate) fn widened(&self, model: &Model<'_>, unknowns: &[f64]) -> Vec<f64> {
        let (forces, amplitude) = unknowns.split_at(unknowns.len() - 1);
        let axes = if model.has_radial_law() { 2 } else { 1 };
        let mut wide = Vec::with_capacity(self.equations(model) + 1);
        for force in forces.chunks(forces.len() / axes) {
            wide.extend(force);
            wide.resize(wide.len() + 2 * self.harmonics + 1 - force.len(), 0.0);
        }
        wide.extend(amplitude);
        wide
    }

    /// The motion that satisfies a condition, driven by coordinate `driver` (0 or 1), by Newton's method from
    /// `unknowns`.
    ///
    /// `None` if 12 steps do not balance the force.
    ///
    /// # Errors
    /// The law has no force at some point of the motion.
    pub(crate) fn solve(
        &mut self,
        model: &Model<'_>,
        driver: usize,
        unknowns: Vec<f64>,
        condition: Condition<'_>,
    ) -> Result<Option<Balanced>, ChatterError> {
        let size = self.equations(model);
        let full = size + 1;
        self.matrix.resize(full * full, 0.0);
        self.rhs.resize(2 * full, 0.0);
        let mut at = Balanced {
            unknowns,
            tangent: vec![0.0; full],
            steps: 0,
            speeds: [0.0; 2],
            depths: [0.0; 2],
            free: 0.0,
        };
        for step in 1..=12 {
            let Some(residual) = self.linearise(model, driver, &mut at)? else {
                return Ok(None);
            };
            // Relative to the mean force, and to the elastic force of the amplitude, which may be tiny.
            let elastic = model.axes()[driver].stiffness_n_m * at.amplitude();
            let mean = if model.has_radial_law() {
                at.unknowns[0]
                    .abs()
                    .max(at.unknowns[2 * self.harmonics + 1].abs())
            } else {
                at.unknowns[0].abs()
            };
            let scale = mean.min(elastic);
            let row = &mut self.matrix[size * full..];
            let miss = match condition {
                Condition::Amplitude(amplitude) => {
                    row.fill(0.0);
                    row[size] = 1.0;
                    at.amplitude() - amplitude
                }
                Condition::Extra(extra) => {
                    row.fill(0.0);
                    row[2] = 1.0;
                    at.extra() - extra
                }
                Condition::Along(weights, value) => {
                    row.copy_from_slice(weights);
                    let sum: f64 = weights.iter().zip(&at.unknowns).map(|(w, x)| w * x).sum();
                    sum - value
                }
            };
            self.rhs[2 * size] = miss;
            for k in 0..size {
                self.rhs[2 * k + 1] = 0.0;
            }
            self.rhs[2 * size + 1] = 1.0;
            if !solve::<2>(&mut self.matrix, &mut self.rhs, full) {
                return Ok(None);
            }
            for k in 0..full {
                at.unknowns[k] -= self.rhs[2 * k];
                at.tangent[k] = self.rhs[2 * k + 1];
            }
            let possible = at.unknowns[1] > 0.0 && at.unknowns[1].is_finite() && at.amplitude() > 0.0;
            if !possible {
                return Ok(None);
            }
            // The present step squares the error.
            if residual <= self.tolerance * scale {
                at.steps = step;
                return Ok(Some(at));
            }
        }
        Ok(None)
    }

    fn response(&self, model: &Model<'_>, n: usize, omega: f64, extra: f64) -> Response {
        let n = n as f64;
        let one = |i: usize| {
            let axis = &model.axes()[i];
            let damping = axis.damping_ns_m + extra * axis.mass_kg;
            let stiffness = C::new(
                axis.stiffness_n_m - axis.mass_kg * n * n * omega * omega,
                n * omega * damping,
            );
            let e = model.direction()[i];
            let h = stiffness.inv();
            let by_omega = -h * h * C::new(-2.0 * axis.mass_kg * n * n * omega, n * damping);
            let by_extra = -h * h * C::new(0.0, n * omega * axis.mass_kg);
            [h * e, by_omega * e, by_extra * e]
        };
        let (first, second) = (one(0), one(1));
        let mixed = |k: usize| {
            let (c, s) = model.machine_axes(1.0, 0.0);
            // y = V1 c - V2 s, z = V1 s + V2 c.
            (first[k] * c - second[k] * s, first[k] * s + second[k] * c)
        };
        let turn = C::new(0.0, n * omega);
        let ((y, z), (y_w, z_w), (y_d, z_d)) = (mixed(0), mixed(1), mixed(2));
        Response {
            y,
            w: turn * z,
            y_by: [y_w, y_d],
            w_by: [turn * z_w + C::new(0.0, n) * z, turn * z_d],
        }
    }

    /// `P_1` for the amplitude of the driver, and its derivatives by `w` and `D`.
    fn first_force(model: &Model<'_>, driver: usize, amplitude: f64, omega: f64, extra: f64) -> [C; 3] {
        let axis = &model.axes()[driver];
        let part = amplitude / model.direction()[driver];
        let damping = axis.damping_ns_m + extra * axis.mass_kg;
        let stiffness = C::new(axis.stiffness_n_m - axis.mass_kg * omega * omega, omega * damping);
        [
            stiffness * part,
            C::new(-2.0 * axis.mass_kg * omega, damping) * part,
            C::new(0.0, omega * axis.mass_kg) * part,
        ]
    }

    /// Fills the matrix except for the condition's row, and the residual as first right-hand side; returns
    /// the largest residual.
    fn linearise(
        &mut self,
        model: &Model<'_>,
        driver: usize,
        at: &mut Balanced,
    ) -> Result<Option<f64>, ChatterError> {
        if model.has_radial_law() {
            let harmonics = self.harmonics;
            let pair = self
                .pair
                .get_or_insert_with(|| Box::new(PairBalance::new(harmonics)));
            return pair.linearise(model, driver, at, &self.waves, &mut self.matrix, &mut self.rhs);
        }
        let (harmonics, samples) = (self.harmonics, self.samples);
        let size = 2 * harmonics + 1;
        let (omega, extra) = (at.unknowns[1], at.unknowns[2]);
        let first = Self::first_force(model, driver, at.amplitude(), omega, extra);
        // Column `size` is that of the amplitude.
        let stride = harmonics + 1;
        self.by.fill([C::ZERO; 2]);
        let mut motion = [[C::ZERO; 2]; 65];
        for n in 0..=harmonics {
            let response = self.response(model, n, omega, extra);
            let force = match n {
                0 => C::new(at.unknowns[0], 0.0),
                1 => first[0],
                _ => C::new(at.unknowns[2 * n - 1], -at.unknowns[2 * n]),
            };
            motion[n] = [response.y * force, response.w * force];
            for k in 0..2 {
                // w and D act through the response, and on the first harmonic through its force.
                let through = if n == 1 { first[k + 1] } else { C::ZERO };
                self.by[(k + 1) * stride + n] = [
                    response.y_by[k] * force + response.y * through,
                    response.w_by[k] * force + response.w * through,
                ];
            }
            match n {
                0 => self.by[0] = [response.y, response.w],
                1 => {
                    let part = first[0] / at.amplitude();
                    self.by[size * stride + 1] = [response.y * part, response.w * part];
                }
                _ => {
                    self.by[(2 * n - 1) * stride + n] = [response.y, response.w];
                    let turned = C::new(0.0, -1.0);
                    self.by[2 * n * stride + n] = [response.y * turned, response.w * turned];
                }
            }
        }
        self.rhs.fill(0.0);
        for sum in &mut self.sums {
            sum.fill(0.0);
        }
        (at.speeds, at.depths, at.free) = (
            [f64::INFINITY, f64::NEG_INFINITY],
            [f64::INFINITY, f64::NEG_INFINITY],
            0.0,
        );
        let tool = model.tool();
        let (speed, depth) = (tool.speed_m_min, tool.depth_mm);
        for waves in self.waves.chunks_exact(2 * size) {
            let (mut y, mut w) = (0.0, 0.0);
            for ([by_y, by_w], wave) in motion[..=harmonics].iter().zip(waves.chunks_exact(2)) {
                let (c, s) = (wave[0], wave[1]);
                y += by_y.re * c - by_y.im * s;
                w += by_w.re * c - by_w.im * s;
            }
            let (actual_speed, actual_depth) = (speed + 60.0 * w, depth - 1000.0 * y);
            if !(actual_speed.is_finite() && actual_depth.is_finite()) {
                return Ok(None);
            }
            at.speeds = [at.speeds[0].min(actual_speed), at.speeds[1].max(actual_speed)];
            at.depths = [at.depths[0].min(actual_depth), at.depths[1].max(actual_depth)];
            if actual_depth <= 0.0 {
                at.free += 1.0 / samples as f64;
                continue;
            }
            let pull = model.pull(actual_speed, actual_depth)?;
            let values = [pull.force, pull.per_y, pull.per_zdot];
            for (sums, value) in self.sums.iter_mut().zip(values) {
                for (sum, wave) in sums.iter_mut().zip(waves) {
                    *sum += value * wave;
                }
            }
        }
        self.assemble(at, first, size)
    }

    fn assemble(&mut self, at: &Balanced, first: [C; 3], size: usize) -> Result<Option<f64>, ChatterError> {
        let (harmonics, samples) = (self.harmonics, self.samples as f64);
        let (stride, full) = (harmonics + 1, size + 1);
        let part = |sums: &[f64], n: usize| C::new(sums[2 * n], -sums[2 * n + 1]) / samples;
        for n in 0..=harmonics {
            let force = part(&self.sums[0], n);
            if n == 0 {
                self.rhs[0] = force.re;
            } else {
                self.rhs[4 * n - 2] = 2.0 * force.re;
                self.rhs[4 * n] = -2.0 * force.im;
            }
        }
        // The force's derivatives times a wave: sums and differences of harmonics.
        let times = |sums: &[f64], wave: C, n: usize, k: usize| {
            let difference = if k >= n {
                part(sums, k - n)
            } else {
                part(sums, n - k).conj()
            };
            (wave * difference + wave.conj() * part(sums, k + n)) * 0.5
        };
        for unknown in 0..=size {
            // All harmonics depend on w and D, one on each other unknown.
            let range = match unknown {
                0 => 0..1,
                1 | 2 => 0..harmonics + 1,
                _ if unknown == size => 1..2,
                _ => unknown.div_ceil(2)..unknown.div_ceil(2) + 1,
            };
            for k in 0..=harmonics {
                let mut value = C::ZERO;
                for n in range.clone() {
                    let [y, w] = self.by[unknown * stride + n];
                    value += times(&self.sums[1], y, n, k) + times(&self.sums[2], w, n, k);
                }
                let (cosine, sine) = if k == 0 {
                    (value.re, 0.0)
                } else {
                    (2.0 * value.re, -2.0 * value.im)
                };
                let row = row(k);
                self.matrix[row * full + unknown] = cosine;
                if k > 0 {
                    self.matrix[(row + 1) * full + unknown] = sine;
                }
            }
        }
        // Minus the force's own harmonics.
        for (k, unknown) in (0..size).filter(|k| *k == 0 || *k > 2).map(|k| (k, k)) {
            self.matrix[k * full + unknown] -= 1.0;
            self.rhs[2 * k] -= at.unknowns[unknown];
        }
        let parts = |value: C| [value.re, -value.im];
        let amplitude = first[0] / at.amplitude();
        for (k, part) in [1, 2].into_iter().zip(0..2) {
            self.rhs[2 * k] -= parts(first[0])[part];
            self.matrix[k * full + size] -= parts(amplitude)[part];
            self.matrix[k * full + 1] -= parts(first[1])[part];
            self.matrix[k * full + 2] -= parts(first[2])[part];
        }
        let residual = (0..size).map(|k| self.rhs[2 * k].abs()).fold(0.0, f64::max);
        Ok(residual.is_finite().then_some(residual))
    }

    /// Harmonics of V1 and V2, `V_n = a_n - i b_n`, of a solution.
    pub(crate) fn deflections(&self, model: &Model<'_>, driver: usize, at: &Balanced) -> [Vec<C>; 2] {
        if model.has_radial_law() {
            return match &self.pair {
                Some(pair) => pair.deflections(model, driver, at),
                None => PairBalance::new(self.harmonics).deflections(model, driver, at),
            };
        }
        let (omega, extra) = (at.unknowns[1], at.unknowns[2]);
        let first = Self::first_force(model, driver, at.amplitude(), omega, extra);
        let of = |i: usize| {
            let axis = &model.axes()[i];
            let harmonic = |n: usize| {
                let force = match n {
                    0 => C::new(at.unknowns[0], 0.0),
                    1 => first[0],
                    _ => C::new(at.unknowns[2 * n - 1], -at.unknowns[2 * n]),
                };
                let turn = n as f64 * omega;
                let stiffness = C::new(
                    axis.stiffness_n_m - axis.mass_kg * turn * turn,
                    turn * (axis.damping_ns_m + extra * axis.mass_kg),
                );
                force * model.direction()[i] / stiffness
            };
            (0..=self.harmonics).map(harmonic).collect()
        };
        [of(0), of(1)]
    }
}

/// Row of the cosine of harmonic `n`; the next is that of the sine (the mean has no sine).
fn row(n: usize) -> usize {
    if n == 0 { 0 } else { 2 * n - 1 }
}

#[cfg(test)]
mod tests {
    use evolvent_cutting::{LawDefinition, ToolAngles};

    use super::*;
    use crate::model::{CuttingTool, PrincipalAxis};

    /// The residual at `at`: the first right-hand side of `linearise`.
    fn residual(balance: &mut Balance, model: &Model<'_>, at: &mut Balanced) -> Vec<f64> {
        balance.linearise(model, 1, at).unwrap().unwrap();
        balance.rhs.iter().step_by(2).take(7).copied().collect()
    }

    #[test]
    fn the_jacobian_is_the_derivative_of_the_residual() {
        let geometry = ToolAngles {
            rake_deg: 10.0,
            lead_deg: 60.0,
        };
        let law = LawDefinition::built_in("40X-R1").unwrap().law(geometry).unwrap();
        let tool = CuttingTool {
            axes: [
                PrincipalAxis::with_ratio(6.0, 3.0e7, 0.03),
                PrincipalAxis::with_ratio(6.0, 1.5e7, 0.04),
            ],
            beta_deg: 35.0,
            speed_m_min: 90.0,
            depth_mm: 4.0,
            feed_mm_rev: 0.49,
            radial_ratio: 0.4,
            floor_m_min: 2.0,
        };
        let model = Model::new(tool, &law).unwrap();
        let mut balance = Balance::new(3);
        let size = 7;
        // No unknown is zero, so that every harmonic acts on every other, with a phase.
        let mut at = Balanced {
            unknowns: vec![4000.0, 1600.0, 20.0, 90.0, -130.0, -40.0, 60.0, 2e-5],
            tangent: vec![0.0; size + 1],
            steps: 0,
            speeds: [0.0; 2],
            depths: [0.0; 2],
            free: 0.0,
        };
        residual(&mut balance, &model, &mut at);
        let matrix = balance.matrix.clone();
        for unknown in 0..=size {
            let (here, step) = (at.unknowns[unknown], 1e-4 * at.unknowns[unknown].abs());
            at.unknowns[unknown] = here + step;
            let above = residual(&mut balance, &model, &mut at);
            at.unknowns[unknown] = here - step;
            let below = residual(&mut balance, &model, &mut at);
            at.unknowns[unknown] = here;
            let column = |row: usize| matrix[row * (size + 1) + unknown];
            let largest = (0..size).map(|row| column(row).abs()).fold(0.0, f64::max);
            for row in 0..size {
                let measured = (above[row] - below[row]) / (2.0 * step);
                assert!(
                    (column(row) - measured).abs() <= 1e-5 * largest,
                    "row {row}, unknown {unknown}: {} for {measured}",
                    column(row)
                );
            }
        }
    }
}

//! Harmonic balance with two force laws: one along the cutting speed, one across it.
//!
//! With a radial force proportional to the tangential one, one scalar drives both axes ([`crate::balance`]).
//! With a separate law, the forces `F_1`, `F_2` on both axes are unknown: `V_i,n = F_i,n / (C_i - m_i n^2 w^2
//! + i n w (G_i + D m_i))`, except for the driver's first harmonic, which is its amplitude `A`. This leaves 4
//! N + 3 unknowns for 4 N + 2 equations: the forces of the motion must have these harmonics. Everything else
//! is as in [`crate::balance`].

use nalgebra::Complex;

use crate::balance::Balanced;
use crate::error::ChatterError;
use crate::model::Model;

type C = Complex<f64>;

/// Working memory for a number of harmonics.
#[derive(Clone, Debug)]
pub(crate) struct PairBalance {
    harmonics: usize,
    /// Derivatives of the harmonics of y and z' by each unknown: `[unknown][n]`.
    by: Vec<[C; 2]>,
    /// For both axes: sums over the samples of the force, and of its derivatives by y and z', times the
    /// waves.
    sums: [[Vec<f64>; 3]; 2],
}

/// Row, or unknown of the forces on one axis, of the cosine of harmonic `n`; the next is that of the sine.
fn row(n: usize) -> usize {
    if n == 0 { 0 } else { 2 * n - 1 }
}

impl PairBalance {
    pub(crate) fn new(harmonics: usize) -> Self {
        let size = Self::equations(harmonics);
        let waves = 2 * (2 * harmonics + 1);
        let sums = || [const { Vec::new() }; 3].map(|_: Vec<f64>| vec![0.0; waves]);
        Self {
            harmonics,
            by: vec![[C::ZERO; 2]; (size + 1) * (harmonics + 1)],
            sums: [sums(), sums()],
        }
    }

    /// Number of equations of the balance; there is one more unknown.
    pub(crate) fn equations(harmonics: usize) -> usize {
        2 * (2 * harmonics + 1)
    }

    /// `C_i - m_i n^2 w^2 + i n w (G_i + D m_i)` and its derivatives by `w` and `D`.
    fn stiffness(model: &Model<'_>, i: usize, n: usize, omega: f64, extra: f64) -> [C; 3] {
        let axis = &model.axes()[i];
        let n = n as f64;
        let damping = axis.damping_ns_m + extra * axis.mass_kg;
        [
            C::new(
                axis.stiffness_n_m - axis.mass_kg * n * n * omega * omega,
                n * omega * damping,
            ),
            C::new(-2.0 * axis.mass_kg * n * n * omega, n * damping),
            C::new(0.0, n * omega * axis.mass_kg),
        ]
    }

    /// Force on axis `i`, harmonic `n`.
    fn force(&self, model: &Model<'_>, driver: usize, unknowns: &[f64], i: usize, n: usize) -> C {
        let first = if i == driver { 0 } else { 2 * self.harmonics + 1 };
        match n {
            0 => C::new(unknowns[first], 0.0),
            1 if i == driver => {
                let amplitude = unknowns.last().copied().unwrap_or(f64::NAN);
                Self::stiffness(model, i, 1, unknowns[1], unknowns[2])[0] * amplitude
            }
            _ => C::new(unknowns[first + row(n)], -unknowns[first + row(n) + 1]),
        }
    }

    /// Harmonics of V1 and V2.
    pub(crate) fn deflections(&self, model: &Model<'_>, driver: usize, at: &Balanced) -> [Vec<C>; 2] {
        [0, 1].map(|i| {
            (0..=self.harmonics)
                .map(|n| {
                    let stiffness = Self::stiffness(model, i, n, at.omega(), at.extra())[0];
                    self.force(model, driver, &at.unknowns, i, n) / stiffness
                })
                .collect()
        })
    }

    /// Fills the matrix except for its last row, and the residual as first right-hand side; returns the
    /// largest residual.
    pub(crate) fn linearise(
        &mut self,
        model: &Model<'_>,
        driver: usize,
        at: &mut Balanced,
        waves: &[f64],
        matrix: &mut [f64],
        rhs: &mut [f64],
    ) -> Result<Option<f64>, ChatterError> {
        let harmonics = self.harmonics;
        let (size, stride, count) = (Self::equations(harmonics), harmonics + 1, 2 * (2 * harmonics + 1));
        let samples = waves.len() / count;
        let (cos, sin) = model.machine_axes(1.0, 0.0);
        let (omega, extra) = (at.unknowns[1], at.unknowns[2]);
        self.by.fill([C::ZERO; 2]);
        let mut motion = [[C::ZERO; 2]; 65];
        for i in 0..2 {
            // y and z of a deflection of this axis.
            let (to_y, to_z) = if i == 0 { (cos, sin) } else { (-sin, cos) };
            let first = if i == driver { 0 } else { 2 * harmonics + 1 };
            for n in 0..=harmonics {
                let turn = C::new(0.0, n as f64 * omega);
                let both = |v: C| [v * to_y, turn * v * to_z];
                let [stiffness, by_omega, by_extra] = Self::stiffness(model, i, n, omega, extra);
                let inverse = stiffness.inv();
                let deflection = self.force(model, driver, &at.unknowns, i, n) * inverse;
                let is_amplitude = i == driver && n == 1;
                let mut add = |unknown: usize, value: [C; 2]| {
                    let by = &mut self.by[unknown * stride + n];
                    *by = [by[0] + value[0], by[1] + value[1]];
                };
                let here = both(deflection);
                motion[n] = [motion[n][0] + here[0], motion[n][1] + here[1]];
                // The velocity is also proportional to w; the driver's first harmonic is given.
                add(1, [C::ZERO, C::new(0.0, n as f64) * deflection * to_z]);
                if is_amplitude {
                    add(size, both(C::new(1.0, 0.0)));
                    continue;
                }
                add(1, both(-deflection * inverse * by_omega));
                add(2, both(-deflection * inverse * by_extra));
                add(first + row(n), both(inverse));
                if n > 0 {
                    add(first + row(n) + 1, both(inverse * C::new(0.0, -1.0)));
                }
            }
        }
        for sum in self.sums.iter_mut().flatten() {
            sum.fill(0.0);
        }
        (at.speeds, at.depths, at.free) = (
            [f64::INFINITY, f64::NEG_INFINITY],
            [f64::INFINITY, f64::NEG_INFINITY],
            0.0,
        );
        let tool = model.tool();
        for waves in waves.chunks_exact(count) {
            let (mut y, mut w) = (0.0, 0.0);
            for n in 0..=harmonics {
                let (c, s) = (waves[2 * n], waves[2 * n + 1]);
                y += motion[n][0].re * c - motion[n][0].im * s;
                w += motion[n][1].re * c - motion[n][1].im * s;
            }
            let (speed, depth) = (tool.speed_m_min + 60.0 * w, tool.depth_mm - 1000.0 * y);
            if !(speed.is_finite() && depth.is_finite()) {
                return Ok(None);
            }
            at.speeds = [at.speeds[0].min(speed), at.speeds[1].max(speed)];
            at.depths = [at.depths[0].min(depth), at.depths[1].max(depth)];
            if depth <= 0.0 {
                at.free += 1.0 / samples as f64;
                continue;
            }
            for (sums, pull) in self.sums.iter_mut().zip(model.pulls(speed, depth)?) {
                for (sums, value) in sums.iter_mut().zip([pull.force, pull.per_y, pull.per_zdot]) {
                    for (sum, wave) in sums.iter_mut().zip(waves) {
                        *sum += value * wave;
                    }
                }
            }
        }
        self.assemble(model, driver, at, samples as f64, matrix, rhs);
        let residual = (0..size).map(|k| rhs[2 * k].abs()).fold(0.0, f64::max);
        Ok(residual.is_finite().then_some(residual))
    }

    fn assemble(
        &self,
        model: &Model<'_>,
        driver: usize,
        at: &Balanced,
        samples: f64,
        matrix: &mut [f64],
        rhs: &mut [f64],
    ) {
        let harmonics = self.harmonics;
        let (size, stride) = (Self::equations(harmonics), harmonics + 1);
        let full = size + 1;
        matrix[..size * full].fill(0.0);
        rhs.fill(0.0);
        let part = |sums: &[f64], n: usize| C::new(sums[2 * n], -sums[2 * n + 1]) / samples;
        let times = |sums: &[f64], wave: C, n: usize, k: usize| {
            let difference = if k >= n {
                part(sums, k - n)
            } else {
                part(sums, n - k).conj()
            };
            (wave * difference + wave.conj() * part(sums, k + n)) * 0.5
        };
        for i in 0..2 {
            let first = if i == driver { 0 } else { 2 * harmonics + 1 };
            for k in 0..=harmonics {
                let at_row = first + row(k);
                let factor = if k == 0 { 1.0 } else { 2.0 };
                let own = self.force(model, driver, &at.unknowns, i, k);
                let miss = part(&self.sums[i][0], k) * factor - own;
                rhs[2 * at_row] = miss.re;
                if k > 0 {
                    rhs[2 * at_row + 2] = -miss.im;
                }
                for unknown in 0..full {
                    let mut value = C::ZERO;
                    for n in 0..=harmonics {
                        let [y, w] = self.by[unknown * stride + n];
                        if y != C::ZERO || w != C::ZERO {
                            value += times(&self.sums[i][1], y, n, k) + times(&self.sums[i][2], w, n, k);
                        }
                    }
                    // Minus the change of the force's own harmonic.
                    let mut value = value * factor;
                    if i == driver && k == 1 {
                        let [stiffness, by_omega, by_extra] =
                            Self::stiffness(model, i, 1, at.omega(), at.extra());
                        value -= match unknown {
                            1 => by_omega * at.amplitude(),
                            2 => by_extra * at.amplitude(),
                            _ if unknown == size => stiffness,
                            _ => C::ZERO,
                        };
                    } else if unknown == at_row {
                        value -= C::new(1.0, 0.0);
                    } else if k > 0 && unknown == at_row + 1 {
                        value -= C::new(0.0, -1.0);
                    }
                    matrix[at_row * full + unknown] = value.re;
                    if k > 0 {
                        matrix[(at_row + 1) * full + unknown] = -value.im;
                    }
                }
            }
        }
    }
}

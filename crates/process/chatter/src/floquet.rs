//! Stability of a cycle: its Floquet multipliers, by integrating the equations of motion in time.
//!
//! Newton's method on the motion over one period, with the variational equations, finds unstable cycles as
//! well as stable ones. Its matrix is the monodromy matrix, whose eigenvalues are the Floquet multipliers. It
//! shares only the equations of motion and the starting point with harmonic balance.

use nalgebra::{Complex, Matrix4, Matrix5, SVector, Schur, Vector5};

use crate::cycle::Cycle;
use crate::error::ChatterError;
use crate::integrate::{Accuracy, Integrator};
use crate::model::{Model, State};
use crate::scan::MAX_FREE_PART;

/// Samples over a period for the harmonics: aliases are beyond the 100th.
const SAMPLES: usize = 256;
/// Number of harmonics of a motion in time.
const HARMONICS: usize = 9;
/// Relative closure of a coarse motion from which it is closed accurately.
const COARSE_CLOSURE: f64 = 1e-5;
/// Maximum number of consecutive steps of Newton's method that do not halve the closure. Tuned: with 2 cycles
/// are lost, 5 finds no more.
const MAX_STALLED: u32 = 3;

/// A cycle by integration in time.
#[derive(Clone, Debug, PartialEq)]
pub struct Verified {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Amplitudes of the fundamentals of V1 and V2, m.
    pub amplitude_m: [f64; 2],
    /// Means of V1 and V2, m.
    pub mean_m: [f64; 2],
    /// Half of the distance between the extremes of V1 and V2, m.
    pub half_peak_to_peak_m: [f64; 2],
    /// Floquet multipliers without the one that is 1, largest first.
    pub multipliers: [Complex<f64>; 3],
    /// Error of the multiplier that must be 1.
    pub trivial_error: f64,
    /// Distance of start and end of the period relative to the amplitude: the error of the integration.
    pub closure: f64,
    /// A state of the cycle.
    pub state: State,
    /// Lowest and highest cutting speed, m/min.
    pub speed_m_min: [f64; 2],
    /// Lowest and highest depth of cut, mm.
    pub depth_mm: [f64; 2],
    /// Fraction of the period out of contact.
    pub free_part: f64,
    /// Harmonics of V1 and V2 from 0 (the mean) to 9, m, as in [`Cycle::harmonics_m`].
    pub harmonics_m: [Vec<Complex<f64>>; 2],
    /// Deviation of the given cycle's driving amplitude and frequency from this, relative.
    pub amplitude_error: f64,
    /// See `amplitude_error`.
    pub frequency_error: f64,
}

impl Verified {
    /// Whether disturbances die out: all multipliers within the unit circle.
    #[must_use]
    pub fn stable(&self) -> bool {
        self.multipliers.iter().all(|value| value.norm() < 1.0)
    }

    /// Whether the speed stays above the floor and the tool is in contact for at least half of the period.
    #[must_use]
    pub fn within_model(&self, model: &Model<'_>) -> bool {
        self.speed_m_min[0] > model.tool().floor_m_min && self.free_part <= MAX_FREE_PART
    }

    /// Whether both are the same cycle: amplitudes and frequencies agree to 1e-4, far above the accuracy of
    /// either.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        let size = self.amplitude_m[0].max(self.amplitude_m[1]);
        (self.frequency_hz / other.frequency_hz - 1.0).abs() < 1e-4
            && (0..2).all(|i| (self.amplitude_m[i] - other.amplitude_m[i]).abs() < 1e-4 * size)
    }

    /// The motion as a cycle.
    #[must_use]
    pub fn cycle(&self) -> Cycle {
        Cycle {
            frequency_hz: self.frequency_hz,
            harmonics_m: self.harmonics_m.clone(),
            driver: usize::from(self.amplitude_m[1] >= self.amplitude_m[0]),
            extra_slope: f64::NAN,
            speed_m_min: self.speed_m_min,
            depth_mm: self.depth_mm,
            free_part: self.free_part,
        }
    }

    /// The same with its deviations from a prediction.
    fn against(self, cycle: &Cycle) -> Self {
        Self {
            amplitude_error: cycle.amplitude_m(cycle.driver) / self.amplitude_m[cycle.driver] - 1.0,
            frequency_error: cycle.frequency_hz / self.frequency_hz - 1.0,
            ..self
        }
    }
}

/// State and monodromy matrix in one.
type Wide = SVector<f64, 20>;

/// Integrates a cycle and corrects it until it closes to `tolerance` of its amplitude (1e-9 is easily
/// reached).
///
/// # Errors
/// No cycle nearby, or a motion out of the model.
pub fn verify(model: &Model<'_>, cycle: &Cycle, tolerance: f64) -> Result<Verified, ChatterError> {
    let size = cycle.amplitude_m(0).max(cycle.amplitude_m(1));
    let closed = shoot(model, cycle.state(0.0), 1.0 / cycle.frequency_hz, size, tolerance)?;
    let Some(closed) = closed else {
        return Err(ChatterError::NoCycle {
            amplitude_mm: 1000.0 * cycle.amplitude_m(cycle.driver),
            frequency_hz: cycle.frequency_hz,
        });
    };
    Ok(report(model, &closed)?.against(cycle))
}

/// A motion that closes.
#[derive(Clone, Debug)]
pub(crate) struct Closed {
    pub(crate) state: State,
    pub(crate) period: f64,
    /// Distance of start and end relative to the size.
    closure: f64,
    monodromy: Matrix4<f64>,
    accuracy: Accuracy,
}

/// Newton's method from a state and a period to a motion that closes to `tolerance` of `size`, m; `None` if
/// 20 steps do not reach one.
///
/// # Errors
/// A motion out of the model.
pub(crate) fn shoot(
    model: &Model<'_>,
    state: State,
    first_period: f64,
    size: f64,
    tolerance: f64,
) -> Result<Option<Closed>, ChatterError> {
    let accuracy = Accuracy::of_cycles(size, first_period);
    newton(model, state, first_period, size, tolerance, accuracy, |_, _| true)
}

/// As [`shoot`] to 1e-8, for a motion that may not be near a cycle. It first closes the motion coarsely, and
/// gives up if a step leads to a state that is not `near`, or if the motion does not get nearer to closing.
///
/// Near a fold that is just missed Newton's method does not converge; near a root, even a double one, each
/// step leaves less than half of the distance.
///
/// # Errors
/// As [`shoot`].
pub(crate) fn shoot_near(
    model: &Model<'_>,
    state: State,
    first_period: f64,
    size: f64,
    near: impl Fn(&State) -> bool,
) -> Result<Option<Closed>, ChatterError> {
    let accuracy = Accuracy {
        relative: 1e-6,
        absolute: 1e-8 * size,
        longest_step_s: first_period / 16.0,
    };
    let promising = || {
        let (mut min, mut stalled) = (f64::INFINITY, 0);
        let near = &near;
        move |state: &State, closure: f64| {
            stalled = if closure < 0.5 * min { 0 } else { stalled + 1 };
            min = min.min(closure);
            stalled < MAX_STALLED && near(state)
        }
    };
    let coarse = newton(
        model,
        state,
        first_period,
        size,
        COARSE_CLOSURE,
        accuracy,
        promising(),
    )?;
    let Some(coarse) = coarse else { return Ok(None) };
    let fine = Accuracy::of_cycles(size, coarse.period);
    let closed = newton(model, coarse.state, coarse.period, size, 1e-8, fine, promising())?;
    Ok(closed.filter(|closed| near(&closed.state)))
}

/// Newton's method to a motion that closes, as long as its states and their closures are `promising`.
fn newton(
    model: &Model<'_>,
    mut state: State,
    first_period: f64,
    size: f64,
    tolerance: f64,
    accuracy: Accuracy,
    mut promising: impl FnMut(&State, f64) -> bool,
) -> Result<Option<Closed>, ChatterError> {
    let mut period = first_period;
    let omega = std::f64::consts::TAU / first_period;
    let weighted = |state: &State| {
        let scale = [1.0, 1.0, omega, omega];
        (0..4).map(|i| (state[i] / scale[i]).abs()).fold(0.0, f64::max) / size
    };
    for _ in 0..20 {
        let (end, monodromy) = around(model, &state, period, accuracy, size, omega)?;
        let miss = end - state;
        let closure = weighted(&miss);
        if !closure.is_finite() {
            return Ok(None);
        }
        // One more step after closing does not get below rounding errors.
        if closure <= tolerance {
            return Ok(Some(Closed {
                state,
                period,
                closure,
                monodromy,
                accuracy,
            }));
        }
        if !promising(&state, closure) {
            return Ok(None);
        }
        let (rate, at_end) = (model.derivative(&state)?, model.derivative(&end)?);
        let mut matrix = Matrix5::zeros();
        let mut rhs = Vector5::zeros();
        // Velocities in units of omega, so that pivots are comparable.
        let unit = [1.0, 1.0, omega, omega];
        for i in 0..4 {
            for k in 0..4 {
                matrix[(i, k)] = (monodromy[(i, k)] - if i == k { 1.0 } else { 0.0 }) * unit[k] / unit[i];
            }
            matrix[(i, 4)] = at_end[i] / unit[i] / omega;
            // The correction has no component along the motion.
            matrix[(4, i)] = rate[i] / unit[i] / omega;
            rhs[i] = -miss[i] / unit[i];
        }
        let Some(step) = matrix.lu().solve(&rhs) else {
            return Ok(None);
        };
        for i in 0..4 {
            state[i] += step[i] * unit[i];
        }
        period += step[4] / omega;
        if !(0.5..2.0).contains(&(period / first_period)) {
            return Ok(None);
        }
    }
    Ok(None)
}

fn around(
    model: &Model<'_>,
    state: &State,
    period: f64,
    accuracy: Accuracy,
    size: f64,
    omega: f64,
) -> Result<(State, Matrix4<f64>), ChatterError> {
    let mut wide = Wide::zeros();
    // The variations are scaled to the size of the motion, so that one accuracy serves all.
    let unit = [1.0, 1.0, omega, omega];
    let scale = size;
    for i in 0..4 {
        wide[i] = state[i];
        wide[4 + 5 * i] = scale * unit[i];
    }
    let mut rate = |wide: &Wide| {
        let state = State::new(wide[0], wide[1], wide[2], wide[3]);
        let (rate, jacobian) = model.derivative_and_jacobian(&state)?;
        let mut result = Wide::zeros();
        for i in 0..4 {
            result[i] = rate[i];
            for k in 0..4 {
                let sum: f64 = (0..4).map(|j| jacobian[(i, j)] * wide[4 + 4 * k + j]).sum();
                result[4 + 4 * k + i] = sum;
            }
        }
        Ok(result)
    };
    let event = |wide: &Wide| model.cut_at(&State::new(wide[0], wide[1], wide[2], wide[3])).1;
    let end = Integrator::<20>::new(accuracy).run(wide, period, &mut rate, &event)?;
    let mut monodromy = Matrix4::zeros();
    for k in 0..4 {
        for i in 0..4 {
            monodromy[(i, k)] = end[4 + 4 * k + i] / (scale * unit[k]);
        }
    }
    Ok((State::new(end[0], end[1], end[2], end[3]), monodromy))
}

/// Properties of a motion that closes; its deviations from a prediction are zero.
pub(crate) fn report(model: &Model<'_>, closed: &Closed) -> Result<Verified, ChatterError> {
    let mut state = closed.state;
    let mut integrator = Integrator::<4>::new(closed.accuracy);
    let mut harmonics = [const { [Complex::ZERO; HARMONICS + 1] }; 2];
    let mut seen = [const { Vec::new() }; 4];
    for sample in 0..SAMPLES {
        let (speed, depth) = model.cut_at(&state);
        for (seen, value) in seen.iter_mut().zip([state[0], state[1], speed, depth]) {
            seen.push(value);
        }
        for (n, (first, second)) in (0..=HARMONICS).map(|n| (n, (state[0], state[1]))) {
            let angle = std::f64::consts::TAU * ((n * sample) % SAMPLES) as f64 / SAMPLES as f64;
            let factor = if n == 0 { 1.0 } else { 2.0 } / SAMPLES as f64;
            let wave = Complex::new(libm::cos(angle), -libm::sin(angle)) * factor;
            harmonics[0][n] += wave * first;
            harmonics[1][n] += wave * second;
        }
        let event = |state: &State| model.cut_at(state).1;
        let mut rate = |state: &State| model.derivative(state);
        state = integrator.run(state, closed.period / SAMPLES as f64, &mut rate, &event)?;
    }
    let (multipliers, trivial_error) = multipliers(&closed.monodromy);
    let free = seen[3].iter().filter(|depth| **depth <= 0.0).count() as f64 / SAMPLES as f64;
    let extremes = seen.map(|values| extremes(&values));
    let half = |i: usize| 0.5 * (extremes[i][1] - extremes[i][0]);
    Ok(Verified {
        frequency_hz: 1.0 / closed.period,
        amplitude_m: [harmonics[0][1].norm(), harmonics[1][1].norm()],
        mean_m: [harmonics[0][0].re, harmonics[1][0].re],
        half_peak_to_peak_m: [half(0), half(1)],
        multipliers,
        trivial_error,
        closure: closed.closure,
        state: closed.state,
        speed_m_min: extremes[2],
        depth_mm: extremes[3],
        free_part: free,
        harmonics_m: harmonics.map(|harmonics| harmonics.to_vec()),
        amplitude_error: 0.0,
        frequency_error: 0.0,
    })
}

/// Floquet multipliers without the one of a shift in time, largest first, and the distance of that one from
/// 1.
fn multipliers(monodromy: &Matrix4<f64>) -> ([Complex<f64>; 3], f64) {
    let eigenvalues = Schur::try_new(*monodromy, 1e-15, 1000).map(|schur| schur.complex_eigenvalues());
    let mut multipliers: Vec<Complex<f64>> = eigenvalues
        .map(|values| values.iter().copied().collect())
        .unwrap_or_default();
    let one = Complex::new(1.0, 0.0);
    multipliers.sort_by(|a, b| (a - one).norm().total_cmp(&(b - one).norm()));
    let trivial_error = multipliers.first().map_or(f64::NAN, |value| (value - one).norm());
    let mut others: Vec<_> = multipliers.into_iter().skip(1).collect();
    others.sort_by(|a, b| b.norm().total_cmp(&a.norm()));
    others.resize(3, Complex::new(f64::NAN, 0.0));
    ([others[0], others[1], others[2]], trivial_error)
}

/// Floquet multipliers of an uncorrected cycle, without the one nearest to 1, largest first: by the classical
/// Runge-Kutta method over one period, in 64 steps. They are as accurate as the cycle; those of [`verify`]
/// are better.
///
/// # Errors
/// The motion is outside the force law.
pub(crate) fn quick_multipliers(model: &Model<'_>, cycle: &Cycle) -> Result<[Complex<f64>; 3], ChatterError> {
    const STEPS: u32 = 64;
    let h = 1.0 / (cycle.frequency_hz * f64::from(STEPS));
    let mut monodromy = Matrix4::identity();
    let jacobian = |k: u32| -> Result<Matrix4<f64>, ChatterError> {
        let state = cycle.state(f64::from(k) / f64::from(2 * STEPS));
        Ok(model.derivative_and_jacobian(&state)?.1)
    };
    let mut first = jacobian(0)?;
    for step in 0..STEPS {
        let (middle, last) = (jacobian(2 * step + 1)?, jacobian(2 * step + 2)?);
        let k1 = first * monodromy;
        let k2 = middle * (monodromy + k1 * (0.5 * h));
        let k3 = middle * (monodromy + k2 * (0.5 * h));
        let k4 = last * (monodromy + k3 * h);
        monodromy += (k1 + (k2 + k3) * 2.0 + k4) * (h / 6.0);
        first = last;
    }
    Ok(multipliers(&monodromy).0)
}

/// Minimum and maximum of a periodic function from its samples, by the parabola through three neighbours.
fn extremes(values: &[f64]) -> [f64; 2] {
    let mut result = [f64::INFINITY, f64::NEG_INFINITY];
    for k in 0..values.len() {
        let at = |k: usize| values.get(k % values.len()).copied().unwrap_or(f64::NAN);
        let (a, b, c) = (at(k + values.len() - 1), at(k), at(k + 1));
        let (slope, bend) = (0.5 * (c - a), a - 2.0 * b + c);
        let peak = if bend == 0.0 || slope.abs() > bend.abs() {
            b
        } else {
            b - 0.5 * slope * slope / bend
        };
        if (b >= a && b >= c) || (b <= a && b <= c) {
            result = [result[0].min(peak), result[1].max(peak)];
        }
    }
    result
}

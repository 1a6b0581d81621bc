//! A limit cycle of self-oscillation.

use nalgebra::Complex;

use crate::model::{Model, State};

/// A periodic motion of the tool, as its harmonics.
#[derive(Clone, Debug, PartialEq)]
pub struct Cycle {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Harmonics of V1 and V2 from 0 (the mean) on, m: `V(t) = Re sum V_n exp(i n w t)`.
    pub harmonics_m: [Vec<Complex<f64>>; 2],
    /// Coordinate (0 for V1, 1 for V2) whose amplitude was scanned.
    pub driver: usize,
    /// Derivative by the amplitude of the extra damping that would balance the motion, 1/s per m: negative if
    /// disturbances of the amplitude alone die out. NaN for a cycle that was found in time.
    pub extra_slope: f64,
    /// Lowest and highest cutting speed, m/min.
    pub speed_m_min: [f64; 2],
    /// Lowest and highest depth of cut, mm; negative out of contact.
    pub depth_mm: [f64; 2],
    /// Fraction of the period out of contact.
    pub free_part: f64,
}

impl Cycle {
    /// Amplitude of the fundamental of V1 (0) or V2 (1), m.
    #[must_use]
    pub fn amplitude_m(&self, coordinate: usize) -> f64 {
        self.harmonic(coordinate, 1).norm()
    }

    /// Mean of V1 (0) or V2 (1), m.
    #[must_use]
    pub fn mean_m(&self, coordinate: usize) -> f64 {
        self.harmonic(coordinate, 0).re
    }

    /// Phase lead of V2 relative to V1, rad, from -pi to pi.
    #[must_use]
    pub fn phase_rad(&self) -> f64 {
        let turn = self.harmonic(1, 1) * self.harmonic(0, 1).conj();
        libm::atan2(turn.im, turn.re)
    }

    /// Whether disturbances of the amplitude alone die out. The other mode may still grow: only the
    /// multipliers of [`crate::Verified`] decide whether the cycle is stable.
    #[must_use]
    pub fn stable_by_slope(&self) -> bool {
        self.extra_slope < 0.0
    }

    fn harmonic(&self, coordinate: usize, n: usize) -> Complex<f64> {
        let all = self.harmonics_m.get(coordinate);
        all.and_then(|all| all.get(n)).copied().unwrap_or(Complex::ZERO)
    }

    /// The state at a fraction of the period from 0 to 1.
    #[must_use]
    pub fn state(&self, part: f64) -> State {
        let omega = std::f64::consts::TAU * self.frequency_hz;
        let mut state = State::zeros();
        for (i, harmonics) in self.harmonics_m.iter().enumerate() {
            for (n, harmonic) in harmonics.iter().enumerate() {
                let angle = std::f64::consts::TAU * n as f64 * part;
                let wave = Complex::new(libm::cos(angle), libm::sin(angle)) * harmonic;
                state[i] += wave.re;
                state[i + 2] -= n as f64 * omega * wave.im;
            }
        }
        state
    }

    /// Amplitude of the cutting speed's fundamental, m/min.
    #[must_use]
    pub fn speed_amplitude_m_min(&self, model: &Model<'_>) -> f64 {
        let (c, s) = model.machine_axes(1.0, 0.0);
        let z = self.harmonic(0, 1) * s + self.harmonic(1, 1) * c;
        60.0 * std::f64::consts::TAU * self.frequency_hz * z.norm()
    }
}

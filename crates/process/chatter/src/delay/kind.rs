//! The kind of a stability limit, and the frequency of the vibration.

use nalgebra::Complex;

use super::{MillingDelay, mean_factors};
use crate::error::{ChatterError, number};

/// The kind of instability, by the largest multiplier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChatterKind {
    /// A pair of complex multipliers (N. I. Neimark, R. J. Sacker): vibration at its own frequency.
    Hopf,
    /// A multiplier near -1 (period doubling): every second tooth cuts alike.
    Flip,
    /// A multiplier near 1: no oscillation from tooth to tooth.
    Fold,
}

impl ChatterKind {
    /// Its name in reports.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Hopf => "hopf",
            Self::Flip => "flip",
            Self::Fold => "fold",
        }
    }
}

/// The behaviour of a cut at the limit of its stability, or beyond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chatter {
    /// How stability is lost.
    pub kind: ChatterKind,
    /// Frequency of the chatter, Hz. The multiplier permits frequencies a whole number of tooth frequencies
    /// apart; this is the one that comes nearest to closing the loop of the mean force. Exact for turning.
    pub frequency_hz: f64,
    /// The largest multiplier.
    pub multiplier: Complex<f64>,
}

impl MillingDelay {
    /// Kind and frequency of the chatter at a depth in m, by [`MillingDelay::multiplier`].
    ///
    /// # Errors
    /// A depth out of range; a multiplier that is small or unresolved.
    pub fn chatter(&self, depth_m: f64) -> Result<Chatter, ChatterError> {
        number("depth in m", depth_m, 0.0, 10.0)?;
        let multiplier = self.multiplier(depth_m)?.unwrap_or(Complex::ZERO);
        number("largest multiplier", multiplier.norm(), 0.3, 1e9)?;
        let kind = if multiplier.im.abs() > 1e-6 * multiplier.norm() {
            ChatterKind::Hopf
        } else if multiplier.re < 0.0 {
            ChatterKind::Flip
        } else {
            ChatterKind::Fold
        };
        let part = libm::atan2(multiplier.im.abs(), multiplier.re) / std::f64::consts::TAU;
        let fastest = self.modes.iter().map(|(mode, ..)| mode.frequency_hz);
        let max = 3.0 * fastest.fold(0.0, f64::max) * self.period_s;
        // Distance of a frequency from closing the loop of the mean force: 1 + b h G (1 - 1 / mu) is singular
        // there.
        let mean = mean_factors(self, 0.0, self.period_s);
        let miss = |frequency: f64, delayed: Complex<f64>| -> f64 {
            let mut response = [Complex::ZERO; 2];
            for (mode, direction, gain) in &self.modes {
                response[*direction] += mode.response(frequency) * *gain;
            }
            let part = |row: usize, column: usize| {
                response[row] * (depth_m * mean[row][column]) * (Complex::new(1.0, 0.0) - delayed)
            };
            let one = Complex::new(1.0, 0.0);
            ((one + part(0, 0)) * (one + part(1, 1)) - part(0, 1) * part(1, 0)).norm()
        };
        let turned = multiplier.conj() / multiplier.norm_sqr();
        let turned = if multiplier.im < 0.0 {
            turned.conj()
        } else {
            turned
        };
        // Each multiplier of a pair has its own frequencies, a whole number of teeth apart.
        let waves = (0..=max.min(1e6) as u32).flat_map(|k| {
            let k = f64::from(k);
            [(k + part, turned), (k + 1.0 - part, turned.conj())]
        });
        let frequency_hz = waves
            .map(|(waves, delayed)| (waves / self.period_s, delayed))
            .min_by(|a, b| miss(a.0, a.1).total_cmp(&miss(b.0, b.1)))
            .map_or(f64::NAN, |(frequency, _)| frequency);
        Ok(Chatter {
            kind,
            frequency_hz,
            multiplier,
        })
    }
}

//! The cost function: an estimate of the time that the spline's derivatives cost.
//!
//! Where jerk limits the motion, a path takes about the integral of `(|q'''| / J)^(1/3)`; where acceleration
//! does, that of `(|q''| / A)^(1/2)`. Weights from the last solution make both quadratic (iteratively
//! reweighted least squares), with each axis relative to its own limits.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes};

use crate::basis::second_derivatives;
use crate::newton::Term;
use crate::zone::BlendZone;

/// Derivatives below this fraction of what the maximum speed permits are negligible.
const MIN_FRACTION: f64 = 0.3;
/// Number of intervals on each side over which weights are averaged.
const AVERAGED_INTERVALS: usize = 3;

/// Reciprocal limits of the axes; zero for an absent axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scales {
    pub(crate) jerk: Axes,
    pub(crate) acceleration: Axes,
    pub(crate) velocity: Axes,
}

impl Scales {
    pub(crate) fn new(limits: &Limits) -> Self {
        let inverse = |values: &Axes| {
            Axes::from_fn(|i, _| {
                let value = values[i];
                if limits.present[i] && value > 0.0 && value.is_finite() {
                    1.0 / value
                } else {
                    0.0
                }
            })
        };
        Self {
            jerk: inverse(&limits.jerk),
            acceleration: inverse(&limits.acceleration),
            velocity: inverse(&limits.velocity),
        }
    }
}

/// Working memory, kept between solutions.
#[derive(Debug, Default)]
pub(crate) struct Weights {
    pub(crate) terms: Vec<Term>,
    /// Estimated time of each interval, from the first.
    pub(crate) times: Vec<f64>,
    third: Vec<f64>,
    second: Vec<f64>,
}

impl Weights {
    /// Terms and times of the intervals `from..to` for the present control points.
    pub(crate) fn update(
        &mut self,
        zone: &BlendZone,
        from: usize,
        to: usize,
        scales: &Scales,
        active: &[bool; AXES],
    ) {
        self.terms.clear();
        self.times.clear();
        self.third.clear();
        self.second.clear();
        let scaled = |v: &Axes, scale: &Axes| -> f64 {
            (0..AXES)
                .filter(|&i| active[i])
                .map(|i| v[i] * scale[i])
                .map(|x| x * x)
                .sum::<f64>()
                .sqrt()
        };
        let slowest = (0..AXES)
            .filter(|&i| active[i])
            .map(|i| scales.velocity[i])
            .fold(0.0, f64::max)
            .max(1e-9);
        let (floor3, floor2) = (
            MIN_FRACTION * slowest * slowest * slowest,
            MIN_FRACTION * slowest * slowest,
        );
        for i in from..to {
            let half = 0.5 * (zone.knot(i + 1) - zone.knot(i));
            let jet = zone.jet(i);
            self.third.push(scaled(&jet.third, &scales.jerk));
            self.second
                .push(scaled(&(jet.second + jet.third * half), &scales.acceleration));
        }
        let count = to - from;
        for k in 0..count {
            let near = k.saturating_sub(AVERAGED_INTERVALS)..(k + AVERAGED_INTERVALS + 1).min(count);
            let g3 = self.third[near.clone()].iter().copied().fold(floor3, f64::max);
            let g2 = self.second[near].iter().copied().fold(floor2, f64::max);
            let i = from + k;
            let width = zone.knot(i + 1) - zone.knot(i);
            let (c3, c2) = (libm::cbrt(g3), g2.sqrt());
            self.times.push(width * (c3 + c2));
            let basis = &zone.bases[i];
            // The derivatives of the squares equal those of the powers: g^(1/3) / 6 g^2 and g^(1/2) / 4 g^2.
            let (w3, w2) = (width * c3 / (6.0 * g3 * g3), width * c2 / (4.0 * g2 * g2));
            self.terms.push(Term {
                interval: i,
                weights: basis.map(|function| function[3]),
                factors: scales.jerk.map(|s| w3 * s * s),
            });
            self.terms.push(Term {
                interval: i,
                weights: second_derivatives(basis, 0.5 * width),
                factors: scales.acceleration.map(|s| w2 * s * s),
            });
        }
    }
}

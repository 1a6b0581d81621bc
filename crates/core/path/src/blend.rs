//! A quintic polynomial between two curves.

use crate::FeedMetric;
use crate::curve::ParamCurve;
use crate::error::{MAX_COORDINATE, check_coordinates};
use crate::jet::xyz;
use crate::polynomial::{self, Quintic};
use crate::quadrature::{integrate, invert};
use crate::{AXES, Axes, AxisLetter, CurveError, Jet};

/// Relative accuracy of a blend's arc length.
const ACCURACY: f64 = 1e-12;

/// Minimum domain in mm. Below it the third derivative at ordinary coordinates overflows.
const MIN_DOMAIN: f64 = 1e-9;

/// A polynomial of degree five in the regular parameter, on all nine axes.
///
/// It matches position and the first two derivatives by the regular parameter at both ends. Arc length is
/// integrated numerically, to 1e-12 of the length where the speed does not vanish inside the blend, otherwise
/// to about 1e-8.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blend {
    /// Coefficients of the powers of `u / domain`.
    coefficients: [Axes; 6],
    end: Axes,
    domain: f64,
    length: f64,
    metric: FeedMetric,
}

impl Blend {
    /// Creates the blend from `left` to `right` over `domain` by quintic Hermite interpolation: it matches
    /// position, first and second derivative by the regular parameter at both ends.
    ///
    /// # Errors
    /// [`CurveError::Domain`]; [`CurveError::Coordinate`] or [`CurveError::Derivative`] for values that are
    /// not finite or out of range; [`CurveError::ZeroLength`] if no axis moves.
    pub fn hermite(left: &Jet, right: &Jet, domain: f64) -> Result<Self, CurveError> {
        if !(MIN_DOMAIN..=MAX_COORDINATE).contains(&domain) {
            return Err(CurveError::Domain { domain });
        }
        check_coordinates(&left.position)?;
        check_coordinates(&right.position)?;
        for jet in [left, right] {
            for (order, derivative, scale) in [(1, &jet.first, domain), (2, &jet.second, domain * domain)] {
                for axis in AxisLetter::ALL {
                    let value = derivative[axis.index()];
                    if !((value * scale).abs() <= 1e3 * MAX_COORDINATE) {
                        return Err(CurveError::Derivative {
                            axis: axis.letter(),
                            order,
                            value,
                        });
                    }
                }
            }
        }
        let delta = right.position - left.position;
        let (v0, v1) = (left.first * domain, right.first * domain);
        let (a0, a1) = (left.second * (domain * domain), right.second * (domain * domain));
        let coefficients = [
            left.position,
            v0,
            a0 * 0.5,
            delta * 10.0 - v0 * 6.0 - v1 * 4.0 - a0 * 1.5 + a1 * 0.5,
            v0 * 8.0 + v1 * 7.0 - delta * 15.0 + a0 * 1.5 - a1,
            delta * 6.0 - v0 * 3.0 - v1 * 3.0 - a0 * 0.5 + a1 * 0.5,
        ];
        let moving = coefficients[1..]
            .iter()
            .fold(Axes::zeros(), |sum, c| sum + c.abs());
        let metric = FeedMetric::of(&moving).ok_or(CurveError::ZeroLength)?;
        let mut blend = Self {
            coefficients,
            end: right.position,
            domain,
            length: 0.0,
            metric,
        };
        blend.length = integrate(&|x| blend.speed(x), 0.0, 1.0, ACCURACY, 12);
        if blend.length > 0.0 && blend.length.is_finite() {
            Ok(blend)
        } else {
            Err(CurveError::ZeroLength)
        }
    }

    /// Path length per unit of `x`, the fraction of the domain.
    fn speed(&self, x: f64) -> f64 {
        self.metric.norm(&self.derivatives(x).0)
    }

    fn point(&self, x: f64) -> Axes {
        let c = &self.coefficients;
        c[0] + (c[1] + (c[2] + (c[3] + (c[4] + c[5] * x) * x) * x) * x) * x
    }

    /// First to third derivative by the fraction of the domain.
    fn derivatives(&self, x: f64) -> (Axes, Axes, Axes) {
        let c = &self.coefficients;
        (
            c[1] + (c[2] * 2.0 + (c[3] * 3.0 + (c[4] * 4.0 + c[5] * (5.0 * x)) * x) * x) * x,
            c[2] * 2.0 + (c[3] * 6.0 + (c[4] * 12.0 + c[5] * (20.0 * x)) * x) * x,
            c[3] * 6.0 + (c[4] * 24.0 + c[5] * (60.0 * x)) * x,
        )
    }

    fn polynomial(&self, axis: usize) -> Quintic {
        self.coefficients.map(|c| c[axis])
    }

    fn fraction(&self, u: f64) -> f64 {
        (u.max(0.0) / self.domain).min(1.0)
    }
}

impl ParamCurve for Blend {
    fn length(&self) -> f64 {
        self.length
    }

    fn domain(&self) -> f64 {
        self.domain
    }

    fn start(&self) -> Axes {
        self.coefficients[0]
    }

    fn end(&self) -> Axes {
        self.end
    }

    fn position(&self, u: f64) -> Axes {
        let x = self.fraction(u);
        if x >= 1.0 { self.end } else { self.point(x) }
    }

    fn jet(&self, u: f64) -> Jet {
        let x = self.fraction(u);
        let (d1, d2, d3) = self.derivatives(x);
        let h = self.domain;
        Jet {
            position: if x >= 1.0 { self.end } else { self.point(x) },
            first: d1 / h,
            second: d2 / h / h,
            third: d3 / h / h / h,
        }
    }

    fn arc_length(&self, u: f64) -> f64 {
        let x = self.fraction(u);
        if x >= 1.0 {
            self.length
        } else {
            integrate(&|y| self.speed(y), 0.0, x, ACCURACY, 12)
        }
    }

    fn parameter(&self, s: f64) -> f64 {
        let s = s.max(0.0).min(self.length);
        if s >= self.length {
            return self.domain;
        }
        let rate = |u: f64| self.speed(u / self.domain) / self.domain;
        invert(
            &|u| self.arc_length(u),
            &rate,
            s,
            self.domain,
            s / self.length * self.domain,
        )
    }

    fn bounds(&self, u0: f64, u1: f64) -> (Axes, Axes) {
        let (x0, x1) = (self.fraction(u0.min(u1)), self.fraction(u0.max(u1)));
        let (a, b) = (self.position(u0), self.position(u1));
        let (mut low, mut high) = (a.inf(&b), a.sup(&b));
        for axis in 0..AXES {
            let range = polynomial::range(&self.polynomial(axis), x0, x1);
            low[axis] = low[axis].min(range.low);
            high[axis] = high[axis].max(range.high);
        }
        (low, high)
    }

    fn derivative_bounds(&self, u0: f64, u1: f64) -> (Axes, Axes, Axes) {
        let (x0, x1) = (self.fraction(u0.min(u1)), self.fraction(u0.max(u1)));
        let mut bounds = [Axes::zeros(); 3];
        for axis in 0..AXES {
            let mut curve = self.polynomial(axis);
            for bound in &mut bounds {
                curve = polynomial::derivative(&curve).map(|c| c / self.domain);
                bound[axis] = polynomial::range(&curve, x0, x1).magnitude();
            }
        }
        (bounds[0], bounds[1], bounds[2])
    }

    fn curvature_bound(&self, u0: f64, u1: f64) -> f64 {
        const PIECES: u32 = 4;
        let (x0, x1) = (self.fraction(u0.min(u1)), self.fraction(u0.max(u1)));
        let at = |piece: u32| x0 + (x1 - x0) * f64::from(piece) / f64::from(PIECES);
        let axes = [0, 1, 2].map(|axis| self.polynomial(axis));
        if axes.iter().all(|axis| axis[1..].iter().all(|&c| c == 0.0)) {
            return 0.0;
        }
        (0..PIECES)
            .map(|piece| {
                let middle = xyz(&self.derivatives(0.5 * (at(piece) + at(piece + 1))).0);
                polynomial::curvature_bound(&axes, middle, at(piece), at(piece + 1))
            })
            .fold(0.0, f64::max)
    }

    fn reversed(&self) -> Self {
        let (left, right) = (self.jet(self.domain).reversed(), self.jet(0.0).reversed());
        // Built from the data of a valid blend, so it cannot fail.
        let reversed = Self::hermite(&left, &right, self.domain).unwrap_or(*self);
        Self {
            length: self.length,
            ..reversed
        }
    }
}

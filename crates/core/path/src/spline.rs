//! One cubic polynomial piece of a spline.

use crate::FeedMetric;
use crate::curve::ParamCurve;
use crate::error::{MAX_COORDINATE, check_coordinates};
use crate::jet::xyz;
use crate::polynomial::{self, Quintic};
use crate::quadrature::{integrate, invert};
use crate::{AXES, Axes, AxisLetter, CurveError, Jet};

/// Relative accuracy of the arc length where the speed does not vanish.
const ACCURACY: f64 = 1e-9;
/// Maximum number of bisections of the arc-length integral: bounds the cost where the speed vanishes.
const HALVINGS: u32 = 5;
/// Minimum domain: below it, rounding of the parameter of a long path exceeds the domain.
const MIN_DOMAIN: f64 = 1e-12;

/// A cubic polynomial in the regular parameter on all nine axes: one piece of a cubic spline.
///
/// Position and derivatives are exact; the third derivative is constant. The first derivative may vanish
/// inside (a path that reverses smoothly).
///
/// *Arc length is approximate*: Gauss-Legendre quadrature to about 1e-9 of the length, about 1e-4 where the
/// speed vanishes inside, because several hundred splines are constructed per millisecond. Functions of the
/// regular parameter are not affected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spline {
    /// The jet at the start; evaluation divides the higher derivatives by their factorials.
    jet: Jet,
    end: Axes,
    domain: f64,
    length: f64,
    metric: FeedMetric,
}

impl Spline {
    /// Creates the cubic from position and derivatives by the regular parameter at its start.
    ///
    /// `end` is its end point up to rounding, kept bit for bit so that the next piece can start there. It
    /// must be within 1e-9 of the polynomial's end, relative to 1 mm plus the coordinate.
    ///
    /// # Errors
    /// [`CurveError::Domain`]; [`CurveError::Coordinate`] or [`CurveError::Derivative`] for values that are
    /// not finite or out of range, or if `end` is not the end of the polynomial; [`CurveError::ZeroLength`]
    /// if no axis moves.
    pub fn new(start: &Jet, end: Axes, domain: f64) -> Result<Self, CurveError> {
        if !(MIN_DOMAIN..=MAX_COORDINATE).contains(&domain) {
            return Err(CurveError::Domain { domain });
        }
        check_coordinates(&start.position)?;
        check_coordinates(&end)?;
        for (order, derivative, scale) in [
            (1, &start.first, domain),
            (2, &start.second, domain * domain),
            (3, &start.third, domain * domain * domain),
        ] {
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
        let moving = start.first.abs() * domain
            + start.second.abs() * (domain * domain)
            + start.third.abs() * (domain * domain * domain);
        let metric = FeedMetric::of(&moving).ok_or(CurveError::ZeroLength)?;
        let mut spline = Self {
            jet: *start,
            end,
            domain,
            length: 0.0,
            metric,
        };
        let off = spline.point(domain) - end;
        for axis in AxisLetter::ALL {
            let i = axis.index();
            if !(off[i].abs() <= 1e-9 * (1.0 + end[i].abs())) {
                return Err(CurveError::Coordinate {
                    axis: axis.letter(),
                    value: end[i],
                });
            }
        }
        spline.length = integrate(&|u| spline.speed(u), 0.0, domain, ACCURACY, HALVINGS);
        if spline.length > 0.0 && spline.length.is_finite() {
            Ok(spline)
        } else {
            Err(CurveError::ZeroLength)
        }
    }

    /// Path length per unit of the parameter.
    fn speed(&self, u: f64) -> f64 {
        self.metric.norm(&self.first(u))
    }

    fn point(&self, u: f64) -> Axes {
        let Jet {
            position,
            first,
            second,
            third,
        } = &self.jet;
        position + (first + (second * 0.5 + third * (u / 6.0)) * u) * u
    }

    fn first(&self, u: f64) -> Axes {
        self.jet.first + (self.jet.second + self.jet.third * (0.5 * u)) * u
    }

    fn clamp(&self, u: f64) -> f64 {
        u.max(0.0).min(self.domain)
    }

    fn polynomial(&self, axis: usize) -> Quintic {
        let jet = &self.jet;
        [
            jet.position[axis],
            jet.first[axis],
            0.5 * jet.second[axis],
            jet.third[axis] / 6.0,
            0.0,
            0.0,
        ]
    }
}

impl ParamCurve for Spline {
    fn length(&self) -> f64 {
        self.length
    }

    fn domain(&self) -> f64 {
        self.domain
    }

    fn start(&self) -> Axes {
        self.jet.position
    }

    fn end(&self) -> Axes {
        self.end
    }

    fn position(&self, u: f64) -> Axes {
        let u = self.clamp(u);
        if u >= self.domain { self.end } else { self.point(u) }
    }

    fn jet(&self, u: f64) -> Jet {
        let u = self.clamp(u);
        Jet {
            position: if u >= self.domain { self.end } else { self.point(u) },
            first: self.first(u),
            second: self.jet.second + self.jet.third * u,
            third: self.jet.third,
        }
    }

    fn arc_length(&self, u: f64) -> f64 {
        let u = self.clamp(u);
        if u >= self.domain {
            self.length
        } else {
            integrate(&|x| self.speed(x), 0.0, u, ACCURACY, HALVINGS)
        }
    }

    fn parameter(&self, s: f64) -> f64 {
        let s = s.max(0.0).min(self.length);
        if s >= self.length {
            return self.domain;
        }
        let guess = s / self.length * self.domain;
        invert(&|u| self.arc_length(u), &|u| self.speed(u), s, self.domain, guess)
    }

    fn bounds(&self, u0: f64, u1: f64) -> (Axes, Axes) {
        let (u0, u1) = (self.clamp(u0.min(u1)), self.clamp(u0.max(u1)));
        let (a, b) = (self.position(u0), self.position(u1));
        let (mut low, mut high) = (a.inf(&b), a.sup(&b));
        for axis in 0..AXES {
            let curve = self.polynomial(axis);
            for root in quadratic_roots(3.0 * curve[3], 2.0 * curve[2], curve[1]) {
                if root > u0 && root < u1 {
                    let value = polynomial::evaluate(&curve, root);
                    low[axis] = low[axis].min(value);
                    high[axis] = high[axis].max(value);
                }
            }
        }
        (low, high)
    }

    fn derivative_bounds(&self, u0: f64, u1: f64) -> (Axes, Axes, Axes) {
        let (u0, u1) = (self.clamp(u0.min(u1)), self.clamp(u0.max(u1)));
        let (a, b) = (self.jet(u0), self.jet(u1));
        let mut first = a.first.abs().sup(&b.first.abs());
        for axis in 0..AXES {
            // The first derivative is extremal where the second vanishes.
            let turn = -self.jet.second[axis] / self.jet.third[axis];
            if turn > u0 && turn < u1 {
                first[axis] = first[axis].max(self.first(turn)[axis].abs());
            }
        }
        (first, a.second.abs().sup(&b.second.abs()), self.jet.third.abs())
    }

    fn curvature_bound(&self, u0: f64, u1: f64) -> f64 {
        const PIECES: u32 = 4;
        let (u0, u1) = (self.clamp(u0.min(u1)), self.clamp(u0.max(u1)));
        let at = |piece: u32| u0 + (u1 - u0) * f64::from(piece) / f64::from(PIECES);
        let axes = [0, 1, 2].map(|axis| self.polynomial(axis));
        if axes.iter().all(|axis| axis[1..].iter().all(|&c| c == 0.0)) {
            return 0.0;
        }
        (0..PIECES)
            .map(|piece| {
                let middle = xyz(&self.first(0.5 * (at(piece) + at(piece + 1))));
                polynomial::curvature_bound(&axes, middle, at(piece), at(piece + 1))
            })
            .fold(0.0, f64::max)
    }

    fn reversed(&self) -> Self {
        let back = self.jet(self.domain).reversed();
        Self {
            jet: back,
            end: self.jet.position,
            ..*self
        }
    }
}

/// Real roots of `a x^2 + b x + c`, NaN where there are none, computed without cancellation.
fn quadratic_roots(a: f64, b: f64, c: f64) -> [f64; 2] {
    let q = -0.5 * (b + (b * b - 4.0 * a * c).sqrt().copysign(b));
    [q / a, c / q]
}

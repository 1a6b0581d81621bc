//! Roll angle and arc length of an involute by the regular parameter, regular at the base circle.

use crate::involute::RollBounds;
use crate::plane::Interval;
use crate::quadrature::invert;

/// Below this roll angle at the inner end, rad, the regular parameter is not arc length. Tuned: the
/// derivatives by arc length grow with 1 / phi^3; any value below the 1 rad at which the parameters agree
/// again is valid.
const ARC_LENGTH_FROM_RAD: f64 = 0.5;

/// Roll angle and arc length along an involute, counted outwards from its inner end.
///
/// phi = sqrt(phi_in^2 + 2 s / r) has infinite derivatives by arc length s at phi = 0. An involute that comes
/// close to the base circle therefore uses, in a first section, a parameter U counted from the base circle,
///
///   s = u1 (3/2 x^2 - x^3 + x^4 / 4),   x = U / u1 in 0..1,   so that   ds/dU = 1 - (1 - x)^3,
///
/// which joins s = U - u1 / 4 with three equal derivatives. phi = x sqrt(kappa (3/2 - x + x^2 / 4)) is
/// analytic in it. u1 is chosen such that phi is 1 rad at the end of the section, or the section ends with
/// the curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Roll {
    base_radius: f64,
    phi_in: f64,
    phi_out: f64,
    /// Roll angle from the inner to the outer end.
    roll_span: f64,
    length: f64,
    domain: f64,
    /// In-plane fraction of the path length: the cosine of the helix angle.
    fraction: f64,
    near_base: Option<NearBase>,
}

/// The section in which the regular parameter is not arc length.
#[derive(Clone, Copy, Debug, PartialEq)]
struct NearBase {
    /// Parameter length of the complete section from the base circle, u1.
    full: f64,
    /// x at the inner end.
    x_in: f64,
    /// Parameter length and arc length of the section from the inner end.
    u: f64,
    s: f64,
    /// phi^2 = kappa x^2 (3/2 - x + x^2/4).
    kappa: f64,
}

/// Roll angle and arc length with their derivatives at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RollState {
    /// Roll angle and its derivatives by the regular parameter.
    pub(crate) phi: f64,
    d1: f64,
    d2: f64,
    /// Roll angle minus that of the inner end.
    pub(crate) turn: f64,
    /// Arc length from the inner end and its derivatives.
    pub(crate) s: [f64; 4],
}

impl RollState {
    /// Coefficients of tangent and normal in the second and third derivative of the in-plane point. Its first
    /// derivative is `fraction` s' t; t' = phi' n and n' = -phi' t.
    pub(crate) fn weights(&self, fraction: f64) -> [f64; 4] {
        let [k1, k2, k3] = [fraction * self.s[1], fraction * self.s[2], fraction * self.s[3]];
        let (d1, d2) = (self.d1, self.d2);
        [k2, k1 * d1, k3 - k1 * d1 * d1, 2.0 * k2 * d1 + k1 * d2]
    }
}

impl NearBase {
    /// Arc length and derivatives at `u` from the inner end: the exact Taylor series of the quartic.
    fn arc_length(&self, u: f64) -> [f64; 4] {
        let (x, h) = (self.x_in, self.full);
        let rest = 1.0 - x;
        // Expanded in x because 1 - (1-x)^3 cancels near the base circle.
        let c1 = x * (3.0 - 3.0 * x + x * x);
        let c2 = 1.5 * rest * rest / h;
        let c3 = -rest / (h * h);
        let c4 = 0.25 / (h * h * h);
        [
            u * (c1 + u * (c2 + u * (c3 + u * c4))),
            c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * 4.0 * c4)),
            2.0 * c2 + u * (6.0 * c3 + u * 12.0 * c4),
            6.0 * c3 + u * 24.0 * c4,
        ]
    }

    /// phi and its derivatives by u, at x.
    fn phi(&self, x: f64) -> [f64; 3] {
        let p = 1.5 - x + 0.25 * x * x;
        let p1 = 0.5 * x - 1.0;
        let h = (self.kappa * p).sqrt();
        let h1 = 0.5 * self.kappa * p1 / h;
        let h2 = (0.25 * self.kappa - h1 * h1) / h;
        let d = 1.0 / self.full;
        [x * h, (h + x * h1) * d, (2.0 * h1 + x * h2) * d * d]
    }
}

impl Roll {
    /// The roll from the angle `phi_in` over the in-plane length `planar_length`, with the travel `rise`
    /// normal to the plane.
    pub(crate) fn new(base_radius: f64, phi_in: f64, planar_length: f64, rise: f64) -> Self {
        let length = libm::hypot(planar_length, rise);
        let fraction = planar_length / length;
        let mut roll = Self {
            base_radius,
            phi_in,
            phi_out: phi_in,
            roll_span: 0.0,
            length,
            domain: length,
            fraction,
            near_base: None,
        };
        (roll.phi_out, roll.roll_span) = roll.roll_at_arc_length(length);
        if phi_in < ARC_LENGTH_FROM_RAD {
            // Arc lengths from the base circle: at the inner end, and at the end of the section.
            let before = 0.5 * base_radius * phi_in * phi_in / fraction;
            let stretch = (0.5 * base_radius / fraction).min(before + length);
            let full = stretch * 4.0 / 3.0;
            let quartic = |x: f64| x * x * (1.5 - x + 0.25 * x * x);
            let slope = |x: f64| x * (3.0 - 3.0 * x + x * x);
            let target = before / full;
            let x_in = if target > 0.0 {
                invert(&quartic, &slope, target, 1.0, (target / 1.5).sqrt())
            } else {
                0.0
            };
            let kappa = 2.0 * full * fraction / base_radius;
            let u = full * (1.0 - x_in);
            let mut near_base = NearBase {
                full,
                x_in,
                u,
                s: 0.0,
                kappa,
            };
            near_base.s = near_base.arc_length(u)[0];
            roll.domain = if length > near_base.s {
                u + (length - near_base.s)
            } else {
                invert(
                    &|u| near_base.arc_length(u)[0],
                    &|u| near_base.arc_length(u)[1],
                    length,
                    u,
                    u,
                )
            };
            roll.near_base = Some(near_base);
        }
        roll
    }

    pub(crate) fn base_radius(&self) -> f64 {
        self.base_radius
    }

    pub(crate) fn phi_in(&self) -> f64 {
        self.phi_in
    }

    pub(crate) fn phi_out(&self) -> f64 {
        self.phi_out
    }

    pub(crate) fn roll_span(&self) -> f64 {
        self.roll_span
    }

    pub(crate) fn length(&self) -> f64 {
        self.length
    }

    pub(crate) fn domain(&self) -> f64 {
        self.domain
    }

    pub(crate) fn planar_fraction(&self) -> f64 {
        self.fraction
    }

    /// Roll angle at an arc length from the inner end, and its difference to that of the inner end.
    pub(crate) fn roll_at_arc_length(&self, s: f64) -> (f64, f64) {
        let square = 2.0 * s * self.fraction / self.base_radius;
        let phi = (self.phi_in * self.phi_in + square).sqrt();
        let turn = if square > 0.0 {
            square / (phi + self.phi_in)
        } else {
            0.0
        };
        (phi, turn)
    }

    pub(crate) fn arc_length_at_turn(&self, turn: f64) -> f64 {
        0.5 * self.base_radius * turn * (turn + 2.0 * self.phi_in) / self.fraction
    }

    /// The section near the base circle if `u` is inside it.
    fn near_base_at(&self, u: f64) -> Option<&NearBase> {
        self.near_base.as_ref().filter(|near_base| u < near_base.u)
    }

    pub(crate) fn arc_length(&self, u: f64) -> f64 {
        if u >= self.domain {
            return self.length;
        }
        match (self.near_base_at(u), &self.near_base) {
            (Some(near_base), _) => near_base.arc_length(u)[0],
            (None, Some(near_base)) => near_base.s + (u - near_base.u),
            (None, None) => u,
        }
    }

    pub(crate) fn parameter(&self, s: f64) -> f64 {
        if s >= self.length {
            return self.domain;
        }
        match &self.near_base {
            Some(near_base) if s < near_base.s => {
                let guess = (s / near_base.s).sqrt() * near_base.u;
                invert(
                    &|u| near_base.arc_length(u)[0],
                    &|u| near_base.arc_length(u)[1],
                    s,
                    near_base.u,
                    guess,
                )
            }
            Some(near_base) => near_base.u + (s - near_base.s),
            None => s,
        }
    }

    pub(crate) fn at(&self, u: f64) -> RollState {
        let r = self.base_radius;
        if let Some(near_base) = self.near_base_at(u) {
            let s = near_base.arc_length(u);
            let turn = self.roll_at_arc_length(s[0]).1;
            let [phi, d1, d2] = near_base.phi(near_base.x_in + u / near_base.full);
            return RollState { phi, d1, d2, turn, s };
        }
        let s = self.arc_length(u);
        let (phi, turn) = self.roll_at_arc_length(s);
        let d1 = self.fraction / (r * phi);
        let d2 = -d1 * d1 / phi;
        RollState {
            phi,
            d1,
            d2,
            turn,
            s: [s, 1.0, 0.0, 0.0],
        }
    }

    /// Bounds over `from..=to`.
    pub(crate) fn bounds(&self, from: f64, to: f64) -> RollBounds {
        let span = |a: f64, b: f64| {
            let (a, b) = (self.at(a), self.at(b));
            // phi' falls and phi'' rises towards zero: in x over the section (a test checks it), in s after
            // it.
            let (d1, d2) = (Interval::new(a.d1, b.d1), Interval::new(a.d2, b.d2));
            let s = [1, 2, 3].map(|order| Interval::new(a.s[order], b.s[order]));
            // The tangent's weight is the in-plane part of arc length, k s = integral of r phi dphi; the rest
            // follows from t' = phi' n, n' = -phi' t.
            let [k1, k2, k3] = s.map(|range| range.scaled(self.fraction));
            RollBounds {
                t2: k2,
                n2: k1 * d1,
                t3: k3 + (k1 * d1 * d1).scaled(-1.0),
                n3: (k2 * d1).scaled(2.0) + k1 * d2,
                s,
            }
        };
        match &self.near_base {
            Some(near_base) if from < near_base.u && to > near_base.u => {
                let (a, b) = (span(from, below(near_base.u)), span(near_base.u, to));
                RollBounds {
                    s: std::array::from_fn(|i| a.s[i].hull(b.s[i])),
                    t2: a.t2.hull(b.t2),
                    n2: a.n2.hull(b.n2),
                    t3: a.t3.hull(b.t3),
                    n3: a.n3.hull(b.n3),
                }
            }
            _ => span(from, to),
        }
    }
}

/// The next smaller number.
fn below(x: f64) -> f64 {
    x.next_down()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roll_derivatives_are_monotone_near_base() {
        // The bounds take the ends of a range as the extrema of phi' and phi''. Both depend on kappa only by
        // a factor, so one kappa is enough.
        let near_base = NearBase {
            full: 1.0,
            x_in: 0.0,
            u: 1.0,
            s: 0.75,
            kappa: 4.0 / 3.0,
        };
        let mut last = near_base.phi(0.0);
        assert_eq!(last[0], 0.0);
        for i in 1..=10_000 {
            let now = near_base.phi(f64::from(i) / 10_000.0);
            assert!(now[0] > last[0] && now[1] < last[1] && now[2] > last[2] && now[2] < 0.0);
            last = now;
        }
        assert!((last[0] - 1.0).abs() <= 1e-15, "1 rad at the end of the stretch");
    }

    #[test]
    fn three_derivatives_match_at_end_of_near_base() {
        for phi_in in [0.0, 0.1, 0.49] {
            let roll = Roll::new(2.0, phi_in, 50.0, 3.0);
            let near_base = roll.near_base.unwrap();
            let (a, b) = (roll.at(near_base.u.next_down()), roll.at(near_base.u));
            for (a, b) in [(a.phi, b.phi), (a.d1, b.d1), (a.d2, b.d2), (a.turn, b.turn)] {
                assert!((a - b).abs() <= 1e-13, "{a} {b}");
            }
            for order in 0..3 {
                assert!((a.s[order] - b.s[order]).abs() <= 1e-13);
            }
        }
    }
}

//! The rolling of an involute's thread: roll angle and arc length by the regular parameter.

use crate::involute::RollBounds;
use crate::plane::Interval;
use crate::quadrature::invert;

/// Below this roll angle at the inner end the regular parameter is not arc length.
const REGULAR_FROM_RAD: f64 = 0.5;

/// Roll angle and arc length along an involute, outwards from its inner end.
///
/// phi = sqrt(phi_in^2 + 2 s / r) has infinite derivatives by arc length s at phi = 0. A curve that comes close
/// to the base circle therefore runs over its first stretch by a parameter U counted from the base circle,
///
///   s = u1 (3/2 x^2 - x^3 + x^4 / 4),   x = U / u1 in 0..1,   so that   ds/dU = 1 - (1 - x)^3,
///
/// which goes over into s = U - u1 / 4 with three equal derivatives. phi = x sqrt(kappa (3/2 - x + x^2 / 4)) is
/// analytic in it. u1 is chosen such that phi is 1 rad at its end, or at the curve's end if that is nearer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Roll {
    base_radius: f64,
    phi_in: f64,
    phi_out: f64,
    /// Roll angle from the inner to the outer end.
    last_turn: f64,
    length: f64,
    domain: f64,
    /// In-plane share of the path length: the cosine of the helix angle.
    share: f64,
    zone: Option<Zone>,
}

/// The stretch where the regular parameter is not arc length.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Zone {
    /// Length of the whole stretch from the base circle, u1.
    full: f64,
    /// x at the inner end.
    x_in: f64,
    /// The stretch's remaining parameter and arc length from the inner end.
    u: f64,
    s: f64,
    /// phi^2 = kappa x^2 (3/2 - x + x^2/4).
    kappa: f64,
}

/// What an involute is made of at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RollState {
    /// Roll angle and its derivatives by the regular parameter.
    pub(crate) phi: f64,
    d1: f64,
    d2: f64,
    /// Roll angle less that of the inner end.
    pub(crate) turn: f64,
    /// Arc length from the inner end and its derivatives.
    pub(crate) s: [f64; 4],
}

impl RollState {
    /// Coefficients of tangent and normal in the second and the third derivative of the in-plane point, whose
    /// first is `share` s' t, by t' = phi' n and n' = -phi' t.
    pub(crate) fn weights(&self, share: f64) -> [f64; 4] {
        let [k1, k2, k3] = [share * self.s[1], share * self.s[2], share * self.s[3]];
        let (d1, d2) = (self.d1, self.d2);
        [k2, k1 * d1, k3 - k1 * d1 * d1, 2.0 * k2 * d1 + k1 * d2]
    }
}

impl Zone {
    /// Arc length and derivatives at `u` from the inner end: the exact Taylor series of the quartic there.
    fn arc_length(&self, u: f64) -> [f64; 4] {
        let (x, h) = (self.x_in, self.full);
        let rest = 1.0 - x;
        // Written out in x because 1 - (1-x)^3 loses digits near the base circle.
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

    /// phi and its derivatives by u at the fraction x.
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
    /// Rolls `planar_length` beyond the roll angle `phi_in` on a base circle, with `climb` across the plane.
    pub(crate) fn new(base_radius: f64, phi_in: f64, planar_length: f64, climb: f64) -> Self {
        let length = libm::hypot(planar_length, climb);
        let share = planar_length / length;
        let mut roll = Self {
            base_radius,
            phi_in,
            phi_out: phi_in,
            last_turn: 0.0,
            length,
            domain: length,
            share,
            zone: None,
        };
        (roll.phi_out, roll.last_turn) = roll.roll_at_arc_length(length);
        if phi_in < REGULAR_FROM_RAD {
            // Arc lengths from the base circle: at the inner end, and where the stretch ends.
            let before = 0.5 * base_radius * phi_in * phi_in / share;
            let stretch = (0.5 * base_radius / share).min(before + length);
            let full = stretch * 4.0 / 3.0;
            let quartic = |x: f64| x * x * (1.5 - x + 0.25 * x * x);
            let slope = |x: f64| x * (3.0 - 3.0 * x + x * x);
            let target = before / full;
            let x_in = if target > 0.0 {
                invert(&quartic, &slope, target, 1.0, (target / 1.5).sqrt())
            } else {
                0.0
            };
            let kappa = 2.0 * full * share / base_radius;
            let u = full * (1.0 - x_in);
            let mut zone = Zone {
                full,
                x_in,
                u,
                s: 0.0,
                kappa,
            };
            zone.s = zone.arc_length(u)[0];
            roll.domain = if length > zone.s {
                u + (length - zone.s)
            } else {
                invert(
                    &|u| zone.arc_length(u)[0],
                    &|u| zone.arc_length(u)[1],
                    length,
                    u,
                    u,
                )
            };
            roll.zone = Some(zone);
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

    pub(crate) fn last_turn(&self) -> f64 {
        self.last_turn
    }

    pub(crate) fn length(&self) -> f64 {
        self.length
    }

    pub(crate) fn domain(&self) -> f64 {
        self.domain
    }

    pub(crate) fn planar_share(&self) -> f64 {
        self.share
    }

    /// Roll angle at an arc length from the inner end, and its difference to the inner end's.
    pub(crate) fn roll_at_arc_length(&self, s: f64) -> (f64, f64) {
        let square = 2.0 * s * self.share / self.base_radius;
        let phi = (self.phi_in * self.phi_in + square).sqrt();
        let turn = if square > 0.0 {
            square / (phi + self.phi_in)
        } else {
            0.0
        };
        (phi, turn)
    }

    pub(crate) fn arc_length_at_turn(&self, turn: f64) -> f64 {
        0.5 * self.base_radius * turn * (turn + 2.0 * self.phi_in) / self.share
    }

    /// The part of the stretch that `u` lies in.
    fn zone_at(&self, u: f64) -> Option<&Zone> {
        self.zone.as_ref().filter(|zone| u < zone.u)
    }

    pub(crate) fn arc_length(&self, u: f64) -> f64 {
        if u >= self.domain {
            return self.length;
        }
        match (self.zone_at(u), &self.zone) {
            (Some(zone), _) => zone.arc_length(u)[0],
            (None, Some(zone)) => zone.s + (u - zone.u),
            (None, None) => u,
        }
    }

    pub(crate) fn parameter(&self, s: f64) -> f64 {
        if s >= self.length {
            return self.domain;
        }
        match &self.zone {
            Some(zone) if s < zone.s => {
                let guess = (s / zone.s).sqrt() * zone.u;
                invert(
                    &|u| zone.arc_length(u)[0],
                    &|u| zone.arc_length(u)[1],
                    s,
                    zone.u,
                    guess,
                )
            }
            Some(zone) => zone.u + (s - zone.s),
            None => s,
        }
    }

    pub(crate) fn at(&self, u: f64) -> RollState {
        let r = self.base_radius;
        if let Some(zone) = self.zone_at(u) {
            let s = zone.arc_length(u);
            let turn = self.roll_at_arc_length(s[0]).1;
            let [phi, d1, d2] = zone.phi(zone.x_in + u / zone.full);
            return RollState { phi, d1, d2, turn, s };
        }
        let s = self.arc_length(u);
        let (phi, turn) = self.roll_at_arc_length(s);
        let d1 = self.share / (r * phi);
        let d2 = -d1 * d1 / phi;
        RollState {
            phi,
            d1,
            d2,
            turn,
            s: [s, 1.0, 0.0, 0.0],
        }
    }

    /// Safe ranges over `from..=to`.
    pub(crate) fn bounds(&self, from: f64, to: f64) -> RollBounds {
        let span = |a: f64, b: f64| {
            let (a, b) = (self.at(a), self.at(b));
            // phi' falls and phi'' rises towards zero: over the stretch in x (a test checks it), beyond in s.
            let (d1, d2) = (Interval::new(a.d1, b.d1), Interval::new(a.d2, b.d2));
            let s = [1, 2, 3].map(|order| Interval::new(a.s[order], b.s[order]));
            // The in-plane share of arc length, k s = integral of r phi dphi, is the tangent's weight, and
            // t' = phi' n, n' = -phi' t do the rest.
            let [k1, k2, k3] = s.map(|range| range.scaled(self.share));
            RollBounds {
                t2: k2,
                n2: k1 * d1,
                t3: k3 + (k1 * d1 * d1).scaled(-1.0),
                n3: (k2 * d1).scaled(2.0) + k1 * d2,
                s,
            }
        };
        match &self.zone {
            Some(zone) if from < zone.u && to > zone.u => {
                let (a, b) = (span(from, below(zone.u)), span(zone.u, to));
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
    fn roll_angle_and_its_derivatives_are_monotone_over_the_stretch() {
        // Safe bounds take the ends of a range for the extremes of phi' and phi''. Both depend on kappa by a factor
        // only, so one kappa stands for all.
        let zone = Zone {
            full: 1.0,
            x_in: 0.0,
            u: 1.0,
            s: 0.75,
            kappa: 4.0 / 3.0,
        };
        let mut last = zone.phi(0.0);
        assert_eq!(last[0], 0.0);
        for i in 1..=10_000 {
            let now = zone.phi(f64::from(i) / 10_000.0);
            assert!(now[0] > last[0] && now[1] < last[1] && now[2] > last[2] && now[2] < 0.0);
            last = now;
        }
        assert!((last[0] - 1.0).abs() <= 1e-15, "1 rad at the end of the stretch");
    }

    #[test]
    fn three_derivatives_go_over_into_those_by_arc_length() {
        for phi_in in [0.0, 0.1, 0.49] {
            let roll = Roll::new(2.0, phi_in, 50.0, 3.0);
            let zone = roll.zone.unwrap();
            let (a, b) = (roll.at(zone.u.next_down()), roll.at(zone.u));
            for (a, b) in [(a.phi, b.phi), (a.d1, b.d1), (a.d2, b.d2), (a.turn, b.turn)] {
                assert!((a - b).abs() <= 1e-13, "{a} {b}");
            }
            for order in 0..3 {
                assert!((a.s[order] - b.s[order]).abs() <= 1e-13);
            }
        }
    }
}

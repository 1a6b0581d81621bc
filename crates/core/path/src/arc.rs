//! Circular arc and helix in any plane.

use std::f64::consts::TAU;

use crate::curve::ParamCurve;
use crate::error::{MAX_ARC_TURNS, MIN_RADIUS_MM, check_centre, check_coordinates};
use crate::plane::{
    Planar, axis_crossings, cos_sin_ranges, cross, dot, mix, norm, perp, sin_cos_versin, sub,
};
use crate::quadrature::{integrate, invert};
use crate::{Axes, CurveError, Jet, Plane, Sense};

/// An arc about a centre in a plane, of any number of turns; the other seven axes are linear in the angle (a
/// helix, if the plane's normal axis moves).
///
/// The angle is proportional to the regular parameter. If the radii at start and end differ, the radius too
/// runs linearly from one to the other, so that both ends are met; arc length then differs from the regular
/// parameter a little, and is integrated (to 1e-13 of the length). With equal radii both are the same.
///
/// Points are computed from the start by sine and versine of the swept angle, never from the centre, so that
/// a flat arc about a centre 100 km away is as exact as any other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arc {
    plane: Plane,
    start: Axes,
    end: Axes,
    /// Unit vector from the centre to the start.
    radial: Planar,
    radius: f64,
    /// Radius at the end less radius at the start.
    drift: f64,
    /// Swept angle, positive counter-clockwise.
    sweep: f64,
    length: f64,
}

impl Arc {
    /// The arc from `start` to `end` about `centre` (in-plane coordinates in mm), with `turns` full turns
    /// more than needed (RS274/NGC's P word less one). A full circle if both ends are the same in the plane.
    ///
    /// Radii at start and end may differ; whether they may differ that much is for the caller to judge.
    ///
    /// # Errors
    /// [`CurveError::Coordinate`], [`CurveError::Centre`], [`CurveError::Radius`], [`CurveError::Sense`] (for
    /// [`Sense::Straight`]), [`CurveError::Turns`].
    pub fn new(
        plane: Plane,
        start: Axes,
        end: Axes,
        centre: [f64; 2],
        sense: Sense,
        turns: u32,
    ) -> Result<Self, CurveError> {
        check_coordinates(&start)?;
        check_coordinates(&end)?;
        check_centre(centre)?;
        if sense == Sense::Straight {
            return Err(CurveError::Sense);
        }
        if turns > MAX_ARC_TURNS {
            return Err(CurveError::Turns { turns });
        }
        let from = sub(plane.project(&start), centre);
        let to = sub(plane.project(&end), centre);
        let chord = sub(plane.project(&end), plane.project(&start));
        let (radius, end_radius) = (norm(from), norm(to));
        if !(radius >= MIN_RADIUS_MM && end_radius >= MIN_RADIUS_MM) {
            return Err(CurveError::Radius {
                start_radius_mm: radius,
                end_radius_mm: end_radius,
            });
        }
        // By the chord, because the difference of the radii loses what it is about on flat arcs.
        let drift = (dot(from, chord) + dot(to, chord)) / (radius + end_radius);
        // A chord of a few roundings has no direction: that is a full circle.
        let rounding = 4.0 * f64::EPSILON * (radius + norm(centre));
        let angle = if norm(chord) <= rounding {
            TAU
        } else {
            let turned = sense.sign() * libm::atan2(cross(from, chord), dot(from, from) + dot(from, chord));
            if turned > 0.0 { turned } else { turned + TAU }
        };
        let sweep = sense.sign() * (angle + TAU * f64::from(turns));
        let mut arc = Self {
            plane,
            start,
            end,
            radial: [from[0] / radius, from[1] / radius],
            radius,
            drift,
            sweep,
            length: 1.0,
        };
        arc.length = arc.length_to(1.0);
        Ok(arc)
    }

    /// The plane.
    #[must_use]
    pub fn plane(&self) -> Plane {
        self.plane
    }

    /// Radius at the start in mm.
    #[must_use]
    pub fn radius_mm(&self) -> f64 {
        self.radius
    }

    /// Swept angle in rad, positive counter-clockwise.
    #[must_use]
    pub fn sweep_rad(&self) -> f64 {
        self.sweep
    }

    /// The centre's in-plane coordinates in mm.
    #[must_use]
    pub fn centre_mm(&self) -> [f64; 2] {
        mix(self.plane.project(&self.start), 1.0, self.radial, -self.radius)
    }

    /// The part from one arc length to another, which is greater, in mm. Both ends of the arc stay as they are, bit for bit.
    #[must_use]
    pub(crate) fn part(&self, from: f64, to: f64) -> Self {
        let (u0, u1) = (self.parameter(from), self.parameter(to));
        let (x0, x1) = (u0 / self.length, u1 / self.length);
        let mut part = Self {
            plane: self.plane,
            start: self.position(u0),
            end: self.position(u1),
            radial: self.planar(x0).1,
            radius: self.radius + self.drift * x0,
            drift: self.drift * (x1 - x0),
            sweep: self.sweep * (x1 - x0),
            length: 1.0,
        };
        part.length = part.length_to(1.0);
        part
    }

    fn climb(&self) -> f64 {
        let normal = self.plane.axes().2;
        self.end[normal] - self.start[normal]
    }

    /// Path length per fraction `x` of the domain.
    fn speed(&self, x: f64) -> f64 {
        let around = (self.radius + self.drift * x) * self.sweep;
        let climb = self.climb();
        (self.drift * self.drift + around * around + climb * climb).sqrt()
    }

    fn length_to(&self, x: f64) -> f64 {
        if self.drift == 0.0 {
            self.speed(0.0) * x
        } else {
            integrate(&|y| self.speed(y), 0.0, x, 1e-13, 12)
        }
    }

    /// In-plane displacement from the start, and the radial unit vector, at fraction `x` of the sweep.
    fn planar(&self, x: f64) -> (Planar, Planar) {
        let (sin, cos, versin) = sin_cos_versin(self.sweep * x);
        let across = perp(self.radial);
        let radial = mix(self.radial, cos, across, sin);
        let turned = mix(self.radial, -versin * self.radius, across, sin * self.radius);
        (mix(turned, 1.0, radial, self.drift * x), radial)
    }

    fn place(&self, x: f64, displacement: Planar) -> Axes {
        let (first, second, _) = self.plane.axes();
        let mut position = self.start + (self.end - self.start) * x;
        position[first] = self.start[first] + displacement[0];
        position[second] = self.start[second] + displacement[1];
        position
    }

    fn clamp(&self, u: f64) -> f64 {
        u.max(0.0).min(self.length)
    }
}

impl ParamCurve for Arc {
    fn length(&self) -> f64 {
        self.length
    }

    fn domain(&self) -> f64 {
        self.length
    }

    fn start(&self) -> Axes {
        self.start
    }

    fn end(&self) -> Axes {
        self.end
    }

    fn position(&self, u: f64) -> Axes {
        let u = self.clamp(u);
        if u >= self.length {
            return self.end;
        }
        let x = u / self.length;
        self.place(x, self.planar(x).0)
    }

    fn jet(&self, u: f64) -> Jet {
        let u = self.clamp(u);
        let x = u / self.length;
        let (displacement, radial) = self.planar(x);
        let position = if u >= self.length {
            self.end
        } else {
            self.place(x, displacement)
        };
        let across = perp(radial);
        let (first, second, _) = self.plane.axes();
        // rho(u) e(u) with e turning at rate w and rho growing at rate g.
        let w = self.sweep / self.length;
        let g = self.drift / self.length;
        let rho = self.radius + self.drift * x;
        let d1 = mix(radial, g, across, rho * w);
        let d2 = mix(across, 2.0 * g * w, radial, -rho * w * w);
        let d3 = mix(radial, -3.0 * g * w * w, across, -rho * w * w * w);
        let mut jet = Jet {
            first: (self.end - self.start) / self.length,
            ..Jet::at_rest(position)
        };
        for (axis, i) in [(first, 0), (second, 1)] {
            jet.first[axis] = d1[i];
            jet.second[axis] = d2[i];
            jet.third[axis] = d3[i];
        }
        jet
    }

    fn arc_length(&self, u: f64) -> f64 {
        let u = self.clamp(u);
        if self.drift == 0.0 || u >= self.length {
            u
        } else {
            self.length_to(u / self.length)
        }
    }

    fn parameter(&self, s: f64) -> f64 {
        let s = self.clamp(s);
        if self.drift == 0.0 || s >= self.length {
            return s;
        }
        let rate = |u: f64| self.speed(u / self.length) / self.length;
        invert(&|u| self.arc_length(u), &rate, s, self.length, s)
    }

    fn at(&self, s: f64) -> Jet {
        let jet = self.jet(self.parameter(s));
        if self.drift == 0.0 {
            jet
        } else {
            jet.by_arc_length()
        }
    }

    fn sense(&self) -> Sense {
        Sense::of(self.sweep)
    }

    fn bounds(&self, u0: f64, u1: f64) -> (Axes, Axes) {
        let (u0, u1) = (self.clamp(u0.min(u1)), self.clamp(u0.max(u1)));
        let (a, b) = (self.position(u0), self.position(u1));
        let (mut low, mut high) = (a.inf(&b), a.sup(&b));
        let sweep = self.sweep.abs();
        let (from, to) = (u0 / self.length * sweep, u1 / self.length * sweep);
        let angle = libm::atan2(self.radial[1], self.radial[0]);
        let (first, second, _) = self.plane.axes();
        for crossing in axis_crossings(angle, self.sweep.signum(), from, to) {
            // Where the radius grows, the extreme lies a little behind the axis.
            let shift = libm::atan(self.drift / (sweep * self.radius + self.drift * crossing));
            for turned in [crossing, (crossing + shift).max(from).min(to)] {
                let x = turned / sweep;
                let point = self.place(x, self.planar(x).0);
                for axis in [first, second] {
                    low[axis] = low[axis].min(point[axis]);
                    high[axis] = high[axis].max(point[axis]);
                }
            }
        }
        (low, high)
    }

    fn derivative_bounds(&self, u0: f64, u1: f64) -> (Axes, Axes, Axes) {
        let (x0, x1) = (
            self.clamp(u0.min(u1)) / self.length,
            self.clamp(u0.max(u1)) / self.length,
        );
        let start = libm::atan2(self.radial[1], self.radial[0]);
        let (cos, sin) = cos_sin_ranges(start + self.sweep * x0, start + self.sweep * x1);
        let (cos, sin) = (cos.magnitude(), sin.magnitude());
        let w = self.sweep.abs() / self.length;
        let g = self.drift.abs() / self.length;
        let rho = (self.radius + self.drift * x0).max(self.radius + self.drift * x1);
        let mut d1 = ((self.end - self.start) / self.length).abs();
        let (mut d2, mut d3) = (Axes::zeros(), Axes::zeros());
        let (first, second, _) = self.plane.axes();
        for (axis, radial, across) in [(first, cos, sin), (second, sin, cos)] {
            d1[axis] = g * radial + rho * w * across;
            d2[axis] = 2.0 * g * w * across + rho * w * w * radial;
            d3[axis] = 3.0 * g * w * w * radial + rho * w * w * w * across;
        }
        (d1, d2, d3)
    }

    fn curvature_bound(&self, u0: f64, u1: f64) -> f64 {
        let (x0, x1) = (self.clamp(u0) / self.length, self.clamp(u1) / self.length);
        let (r0, r1) = (self.radius + self.drift * x0, self.radius + self.drift * x1);
        let w = self.sweep / self.length;
        // |q''| / |q'|^2, the first at its largest, the second at its smallest.
        let bend = libm::hypot(2.0 * self.drift / self.length, r0.max(r1) * w) * w.abs();
        let slow = self.speed(if r0 <= r1 { x0 } else { x1 }) / self.length;
        bend / (slow * slow)
    }

    fn reversed(&self) -> Self {
        let (_, radial) = self.planar(1.0);
        let size = norm(radial);
        Self {
            start: self.end,
            end: self.start,
            radial: [radial[0] / size, radial[1] / size],
            radius: self.radius + self.drift,
            drift: -self.drift,
            sweep: -self.sweep,
            ..*self
        }
    }
}

//! Circular arc and helix in any plane.

use std::f64::consts::TAU;

use crate::curve::ParamCurve;
use crate::error::{MAX_ARC_TURNS, MIN_RADIUS_MM, check_centre, check_coordinates};
use crate::plane::{
    Planar, axis_crossings, cos_sin_ranges, cross, dot, mix, norm, perp, sin_cos_versin, sub,
};
use crate::quadrature::{integrate, invert};
use crate::{Axes, CurveError, Jet, Plane, Sense};

/// A circular arc of any number of turns in a plane. The seven axes outside the plane are linear in the swept
/// angle, so motion of the normal axis makes a helix.
///
/// The swept angle is proportional to the regular parameter. If the radii at start and end differ, the radius
/// varies linearly with the angle so that both ends are met; arc length then differs slightly from the
/// regular parameter and is integrated to 1e-13 of the length. With equal radii both are identical.
///
/// Points are computed from the start point by the sine and versine of the swept angle, not from the centre.
/// A flat arc about a centre 100 km away is therefore as accurate as any other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arc {
    plane: Plane,
    start: Axes,
    end: Axes,
    /// Unit vector from the centre to the start.
    radial: Planar,
    radius: f64,
    /// Radius at the end minus radius at the start.
    radius_change: f64,
    /// Swept angle, positive counter-clockwise.
    sweep: f64,
    length: f64,
}

impl Arc {
    /// Creates the arc from `start` to `end` about `centre`, in-plane coordinates in mm. `turns` counts the
    /// full turns beyond the first partial one (RS274/NGC's P word minus one). Equal end points in the plane
    /// make a full circle.
    ///
    /// The radii at start and end may differ. Whether the difference is acceptable is the caller's decision.
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
        // From the chord: on flat arcs the difference of the two radii would cancel.
        let radius_change = (dot(from, chord) + dot(to, chord)) / (radius + end_radius);
        // A chord within rounding has no direction and means a full circle.
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
            radius_change,
            sweep,
            length: 1.0,
        };
        arc.length = arc.length_to(1.0);
        Ok(arc)
    }

    /// The plane of the arc.
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

    /// The part between two arc lengths in mm, `from < to`. A part that reaches an end of the arc keeps that
    /// end bit for bit.
    #[must_use]
    pub(crate) fn part(&self, from: f64, to: f64) -> Self {
        let (u0, u1) = (self.parameter(from), self.parameter(to));
        let (x0, x1) = (u0 / self.length, u1 / self.length);
        let mut part = Self {
            plane: self.plane,
            start: self.position(u0),
            end: self.position(u1),
            radial: self.planar(x0).1,
            radius: self.radius + self.radius_change * x0,
            radius_change: self.radius_change * (x1 - x0),
            sweep: self.sweep * (x1 - x0),
            length: 1.0,
        };
        part.length = part.length_to(1.0);
        part
    }

    fn rise(&self) -> f64 {
        let normal = self.plane.axes().2;
        self.end[normal] - self.start[normal]
    }

    /// Path length per unit of `x`, the fraction of the domain.
    fn speed(&self, x: f64) -> f64 {
        let around = (self.radius + self.radius_change * x) * self.sweep;
        let rise = self.rise();
        (self.radius_change * self.radius_change + around * around + rise * rise).sqrt()
    }

    fn length_to(&self, x: f64) -> f64 {
        if self.radius_change == 0.0 {
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
        (mix(turned, 1.0, radial, self.radius_change * x), radial)
    }

    fn point_at(&self, x: f64, displacement: Planar) -> Axes {
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
        self.point_at(x, self.planar(x).0)
    }

    fn jet(&self, u: f64) -> Jet {
        let u = self.clamp(u);
        let x = u / self.length;
        let (displacement, radial) = self.planar(x);
        let position = if u >= self.length {
            self.end
        } else {
            self.point_at(x, displacement)
        };
        let across = perp(radial);
        let (first, second, _) = self.plane.axes();
        // rho(u) e(u), where e rotates at rate w and rho grows at rate g.
        let w = self.sweep / self.length;
        let g = self.radius_change / self.length;
        let rho = self.radius + self.radius_change * x;
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
        if self.radius_change == 0.0 || u >= self.length {
            u
        } else {
            self.length_to(u / self.length)
        }
    }

    fn parameter(&self, s: f64) -> f64 {
        let s = self.clamp(s);
        if self.radius_change == 0.0 || s >= self.length {
            return s;
        }
        let rate = |u: f64| self.speed(u / self.length) / self.length;
        invert(&|u| self.arc_length(u), &rate, s, self.length, s)
    }

    fn at(&self, s: f64) -> Jet {
        let jet = self.jet(self.parameter(s));
        if self.radius_change == 0.0 {
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
            // Where the radius grows, the extreme is slightly past the axis.
            let shift =
                libm::atan(self.radius_change / (sweep * self.radius + self.radius_change * crossing));
            for turned in [crossing, (crossing + shift).max(from).min(to)] {
                let x = turned / sweep;
                let point = self.point_at(x, self.planar(x).0);
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
        let g = self.radius_change.abs() / self.length;
        let rho = (self.radius + self.radius_change * x0).max(self.radius + self.radius_change * x1);
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
        let (r0, r1) = (
            self.radius + self.radius_change * x0,
            self.radius + self.radius_change * x1,
        );
        let w = self.sweep / self.length;
        // |q''| / |q'|^2: maximum of the numerator, minimum of the denominator.
        let bend = libm::hypot(2.0 * self.radius_change / self.length, r0.max(r1) * w) * w.abs();
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
            radius: self.radius + self.radius_change,
            radius_change: -self.radius_change,
            sweep: -self.sweep,
            ..*self
        }
    }
}

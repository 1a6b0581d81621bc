//! The involute of a circle in any plane.

mod near_base;

use std::f64::consts::{PI, TAU};

use near_base::Roll;

use crate::curve::ParamCurve;
use crate::involute_error::{InvoluteError, check_input, check_radii};
use crate::plane::{
    Interval, Planar, axis_crossings, cos_sin_ranges, cross, dot, mix, norm, perp, sin_cos_versin, sub,
};
use crate::{Axes, Jet, Plane, Sense};

/// Maximum number of turns of one involute block (Fanuc's G02.2 has the same limit).
pub const MAX_INVOLUTE_TURNS: f64 = 100.0;

/// The involute of a circle: the curve traced by the end of a taut string that unwinds from the base circle.
///
/// With base radius r and roll angle phi: radius of curvature r phi, arc length from the base circle r phi^2
/// / 2, distance from the centre r sqrt(1 + phi^2) (Sorokin, But and Kombarov 2013, equations (2), (3)). An
/// outward involute unwinds, an inward one winds up. The sense is the sense of rotation of the tangent. The
/// plane's normal axis and all other axes are linear in arc length (a helical involute).
///
/// If the end point is off the curve within the tolerance, it is met by an in-plane offset that grows
/// linearly with arc length and is nowhere larger than at the end. (Growth with the roll angle would rotate
/// the tangent at the base circle, where arc length grows with the square of the angle.) `length` and the
/// parameters refer to the curve without offset.
///
/// Close to the base circle the regular parameter differs from arc length, see `Roll` in
/// `involute/near_base.rs`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Involute {
    plane: Plane,
    /// The end nearer to the base circle. Everything is computed from there, in either direction of travel.
    inner: Axes,
    outer: Axes,
    /// Whether the path runs from `outer` to `inner`.
    inward: bool,
    /// Sense of rotation of the outward tangent: +1 counter-clockwise, -1 clockwise.
    handedness: f64,
    /// Direction of the outward tangent at `inner`.
    tangent: Planar,
    /// In-plane offset of the outer end point from the involute.
    end_offset: Planar,
    roll: Roll,
}

/// Properties of both ends, for the comparison of the programmed end with the involute.
struct Ends {
    /// Roll angle at the inner end.
    phi_in: f64,
    /// Height of the outer end above the inner one.
    rise: f64,
    /// The outer end from the centre, and the tangent length there.
    far: Planar,
    far_tangent_length: f64,
    chord: Planar,
    /// Distances of the inner and the outer end from the centre.
    radii: [f64; 2],
    /// Distance of the programmed end from the centre.
    end_radius_mm: f64,
    /// Size of the coordinates, which bounds their rounding.
    coordinate_size: f64,
}

impl Involute {
    /// Creates the involute of the circle of radius `base_radius_mm` about `centre` (in-plane coordinates in
    /// mm) from `start` to `end`. The radii of the two points determine the direction, outwards or inwards,
    /// and the number of turns.
    ///
    /// `tolerance_mm` is the permitted distance of the end from the involute through the start, and of either
    /// end to the inside of the base circle. The parameters follow G02.2/G03.2 of the Fanuc 30i operator's
    /// manual: I, J to the centre, R the base radius; G03.2 is [`Sense::CounterClockwise`].
    ///
    /// # Errors
    /// One variant of [`InvoluteError`] for each cause.
    pub fn new(
        plane: Plane,
        start: Axes,
        end: Axes,
        centre: [f64; 2],
        base_radius_mm: f64,
        sense: Sense,
        tolerance_mm: f64,
    ) -> Result<Self, InvoluteError> {
        check_input(&start, &end, centre, base_radius_mm, sense, tolerance_mm)?;
        let r = base_radius_mm;
        let from = sub(plane.project(&start), centre);
        let to = sub(plane.project(&end), centre);
        let (start_radius_mm, end_radius_mm) = (norm(from), norm(to));
        check_radii(centre, r, [start_radius_mm, end_radius_mm], tolerance_mm)?;
        let inward = end_radius_mm < start_radius_mm;
        let (inner, outer, near, far) = if inward {
            (end, start, to, from)
        } else {
            (start, end, from, to)
        };
        let (near_radius, far_radius) = if inward {
            (end_radius_mm, start_radius_mm)
        } else {
            (start_radius_mm, end_radius_mm)
        };
        let handedness = if inward { -sense.sign() } else { sense.sign() };
        // The tangent from each end to the base circle has the length r phi; on or inside the circle it is 0.
        let tangent_length = |radius: f64| ((radius - r).max(0.0) * (radius + r)).sqrt();
        let (near_tangent_length, far_tangent_length) =
            (tangent_length(near_radius), tangent_length(far_radius));
        let chord = sub(plane.project(&outer), plane.project(&inner));
        // far^2 - near^2 = r^2 (phi_1^2 - phi_0^2), from the chord so that short curves do not cancel.
        let squares = if near_radius > r {
            dot(mix(near, 1.0, far, 1.0), chord)
        } else {
            far_tangent_length * far_tangent_length
        };
        let planar_length = squares / (2.0 * r);
        let equal = InvoluteError::EqualRadii {
            start_radius_mm,
            end_radius_mm,
        };
        if !(planar_length > f64::EPSILON * far_radius) {
            return Err(equal);
        }
        let turns = (far_tangent_length - near_tangent_length) / (r * TAU);
        // A computed value of 100 turns may be larger by rounding.
        if turns > MAX_INVOLUTE_TURNS * (1.0 + 1e-9) {
            return Err(InvoluteError::Turns { turns });
        }

        let normal = plane.axes().2;
        let rise = outer[normal] - inner[normal];
        let phi_in = near_tangent_length / r;
        let tangent = tangent_at(near, r, near_tangent_length, handedness);
        let roll = Roll::new(r, phi_in, planar_length, rise);
        let mut involute = Self {
            plane,
            inner,
            outer,
            inward,
            handedness,
            tangent,
            end_offset: [0.0, 0.0],
            roll,
        };

        let ends = Ends {
            phi_in,
            rise,
            far,
            far_tangent_length,
            chord,
            radii: [near_radius, far_radius],
            end_radius_mm,
            coordinate_size: far_radius + norm(centre),
        };
        involute.meet_end(r, &ends, planar_length, tolerance_mm, &equal)?;
        Ok(involute)
    }

    /// Rotates the curve onto its programmed end if that is near enough, and keeps the remaining distance as
    /// an offset of the end.
    fn meet_end(
        &mut self,
        r: f64,
        ends: &Ends,
        mut planar_length: f64,
        tolerance_mm: f64,
        equal: &InvoluteError,
    ) -> Result<(), InvoluteError> {
        let Ends {
            phi_in,
            rise,
            far,
            far_tangent_length,
            chord,
            radii: [near_radius, far_radius],
            end_radius_mm,
            ..
        } = *ends;
        let (roll, handedness) = (self.roll, self.handedness);
        // Involutes of one circle are parallel curves: rotated by an angle, they are base radius times angle
        // apart everywhere. The foot of the end point is where the tangent equals the end's own tangent. Many
        // turns out this is far more accurate than the radius, where a micrometre of radius means phi
        // micrometres of path.
        let expected = tangent_at(far, r, far_tangent_length, handedness);
        let (_, reached, _) = self.rolled(roll.roll_span());
        let angle = libm::atan2(cross(reached, expected), dot(reached, expected));
        let turn = roll.roll_span() + handedness * angle;
        if angle.abs() > 8.0 * f64::EPSILON * (1.0 + roll.roll_span()) && turn > 0.0 {
            planar_length = 0.5 * r * turn * (turn + 2.0 * phi_in);
            self.roll = Roll::new(r, phi_in, planar_length, rise);
        }
        self.end_offset = sub(chord, self.rolled(self.roll.roll_span()).0);

        let distance_mm = r * angle.abs();
        let rounding = 64.0 * f64::EPSILON * ends.coordinate_size * (1.0 + roll.roll_span());
        // Whatever the tolerance, an offset that is not small compared to the path is an error of the
        // program.
        let tolerance_mm = tolerance_mm.min(0.1 * planar_length);
        if !(distance_mm <= tolerance_mm + rounding && norm(self.end_offset) <= 0.2 * planar_length) {
            if (far_radius - near_radius) <= tolerance_mm {
                return Err(*equal);
            }
            // Roll angle at which the involute through the start crosses the direction of the end.
            let (phi, angle) = if self.inward {
                (phi_in, -angle)
            } else {
                (far_tangent_length / r, angle)
            };
            let polar = phi - libm::atan(phi) + handedness * angle;
            let polar = if polar < 0.0 { polar + TAU } else { polar };
            let involute_radius_mm = r * libm::hypot(1.0, roll_of_polar(polar));
            return Err(InvoluteError::OffInvolute {
                distance_mm,
                tolerance_mm,
                end_radius_mm,
                involute_radius_mm,
            });
        }
        Ok(())
    }

    /// The plane of the involute.
    #[must_use]
    pub fn plane(&self) -> Plane {
        self.plane
    }

    /// Radius of the base circle in mm.
    #[must_use]
    pub fn base_radius_mm(&self) -> f64 {
        self.roll.base_radius()
    }

    /// Roll angles at start and end in rad; 0 is on the base circle.
    #[must_use]
    pub fn roll_angles_rad(&self) -> (f64, f64) {
        let (inner, outer) = (self.roll.phi_in(), self.roll.phi_out());
        if self.inward {
            (outer, inner)
        } else {
            (inner, outer)
        }
    }

    /// The regular parameter at a roll angle in rad, clamped to the range of the curve.
    #[must_use]
    pub fn parameter_at_roll(&self, phi: f64) -> f64 {
        let turn = (phi - self.roll.phi_in()).max(0.0).min(self.roll.roll_span());
        let outwards = self.roll.parameter(self.roll.arc_length_at_turn(turn));
        if self.inward {
            self.roll.domain() - outwards
        } else {
            outwards
        }
    }

    /// Roll angle in rad at the regular parameter `u`.
    #[must_use]
    pub fn roll_angle_rad(&self, u: f64) -> f64 {
        self.roll.phi_in() + self.roll.at(self.outwards(u)).turn
    }

    /// Whether the path approaches the base circle.
    #[must_use]
    pub fn is_inward(&self) -> bool {
        self.inward
    }

    /// In-plane coordinates in mm of the base circle's centre.
    #[must_use]
    pub fn centre_mm(&self) -> [f64; 2] {
        // From the inner point along the tangent to the base circle: p - c = r t - r phi n.
        let r = self.roll.base_radius();
        let normal = mix(perp(self.tangent), self.handedness, [0.0, 0.0], 0.0);
        let arm = mix(self.tangent, r, normal, -r * self.roll.phi_in());
        sub(self.plane.project(&self.inner), arm)
    }

    /// In-plane displacement from the inner end, unit tangent and unit normal (the derivative of the tangent
    /// by the roll angle) at the roll angle `turn` past the inner end.
    fn rolled(&self, turn: f64) -> (Planar, Planar, Planar) {
        let (r, phi) = (self.roll.base_radius(), self.roll.phi_in());
        let (sin, cos, versin) = sin_cos_versin(turn);
        let normal = [
            self.handedness * -self.tangent[1],
            self.handedness * self.tangent[0],
        ];
        // Integral of r (phi + w) (cos w t + sin w n) over w in 0..turn, in a form that does not cancel near
        // zero.
        let along = phi * sin + (turn * sin - versin);
        let across = phi * versin + sin_less_angle_cos(turn, sin, cos);
        (
            mix(self.tangent, r * along, normal, r * across),
            mix(self.tangent, cos, normal, sin),
            mix(normal, cos, self.tangent, -sin),
        )
    }

    /// Position at the roll angle `turn` past the inner end; `fraction` is the fraction of the arc length
    /// there.
    fn point_at_roll(&self, turn: f64, fraction: f64) -> Axes {
        self.displaced(self.rolled(turn).0, fraction)
    }

    /// Position from the in-plane displacement of the curve without offset; `fraction` as above.
    fn displaced(&self, displacement: Planar, fraction: f64) -> Axes {
        let (first, second, _) = self.plane.axes();
        let displacement = mix(displacement, 1.0, self.end_offset, fraction);
        let mut position = self.inner + (self.outer - self.inner) * fraction;
        position[first] = self.inner[first] + displacement[0];
        position[second] = self.inner[second] + displacement[1];
        position
    }

    /// The regular parameter counted from the inner end.
    fn outwards(&self, u: f64) -> f64 {
        let u = u.max(0.0).min(self.roll.domain());
        if self.inward { self.roll.domain() - u } else { u }
    }

    /// Derivatives by arc length of the parts that are linear in it.
    fn slope(&self) -> Axes {
        let (first, second, _) = self.plane.axes();
        let mut slope = self.outer - self.inner;
        slope[first] = self.end_offset[0];
        slope[second] = self.end_offset[1];
        slope / self.roll.length()
    }

    fn point(&self, outwards: f64) -> Axes {
        if outwards <= 0.0 {
            self.inner
        } else if outwards >= self.roll.domain() {
            self.outer
        } else {
            let state = self.roll.at(outwards);
            self.point_at_roll(state.turn, state.s[0] / self.roll.length())
        }
    }

    fn outward_jet(&self, outwards: f64) -> Jet {
        let state = self.roll.at(outwards);
        let (displacement, tangent, normal) = self.rolled(state.turn);
        let position = if outwards <= 0.0 {
            self.inner
        } else if outwards >= self.roll.domain() {
            self.outer
        } else {
            self.displaced(displacement, state.s[0] / self.roll.length())
        };
        let [t2, n2, t3, n3] = state.weights(self.roll.planar_fraction());
        let planar = [
            mix(tangent, state.s[1] * self.roll.planar_fraction(), normal, 0.0),
            mix(tangent, t2, normal, n2),
            mix(tangent, t3, normal, n3),
        ];
        let slope = self.slope();
        let mut jet = Jet {
            position,
            first: slope * state.s[1],
            second: slope * state.s[2],
            third: slope * state.s[3],
        };
        let (first, second, _) = self.plane.axes();
        for (axis, i) in [(first, 0), (second, 1)] {
            jet.first[axis] += planar[0][i];
            jet.second[axis] += planar[1][i];
            jet.third[axis] += planar[2][i];
        }
        jet
    }

    fn outward_range(&self, u0: f64, u1: f64) -> (f64, f64) {
        let (a, b) = (self.outwards(u0), self.outwards(u1));
        (a.min(b), a.max(b))
    }
}

impl ParamCurve for Involute {
    fn length(&self) -> f64 {
        self.roll.length()
    }

    fn domain(&self) -> f64 {
        self.roll.domain()
    }

    fn start(&self) -> Axes {
        if self.inward { self.outer } else { self.inner }
    }

    fn end(&self) -> Axes {
        if self.inward { self.inner } else { self.outer }
    }

    fn position(&self, u: f64) -> Axes {
        self.point(self.outwards(u))
    }

    fn jet(&self, u: f64) -> Jet {
        let jet = self.outward_jet(self.outwards(u));
        if self.inward { jet.reversed() } else { jet }
    }

    fn arc_length(&self, u: f64) -> f64 {
        let s = self.roll.arc_length(self.outwards(u));
        if self.inward { self.roll.length() - s } else { s }
    }

    fn parameter(&self, s: f64) -> f64 {
        let s = s.max(0.0).min(self.roll.length());
        let outwards = self
            .roll
            .parameter(if self.inward { self.roll.length() - s } else { s });
        if self.inward {
            self.roll.domain() - outwards
        } else {
            outwards
        }
    }

    /// By arc length, in closed form. At the base circle the second and third derivative are infinite along
    /// the normal, in the axes in which the normal has a component.
    fn at(&self, s: f64) -> Jet {
        let s = s.max(0.0).min(self.roll.length());
        let s = if self.inward { self.roll.length() - s } else { s };
        let (r, k) = (self.roll.base_radius(), self.roll.planar_fraction());
        let (phi, turn) = self.roll.roll_at_arc_length(s);
        let (_, tangent, normal) = self.rolled(turn);
        let bend = k * k / (r * phi);
        let t3 = -k * bend * bend / (k * k);
        let n3 = t3 / phi;
        let mut jet = Jet {
            first: self.slope(),
            ..Jet::at_rest(self.point(self.roll.parameter(s)))
        };
        let (first, second, _) = self.plane.axes();
        for (axis, i) in [(first, 0), (second, 1)] {
            jet.first[axis] += tangent[i] * k;
            // 0 times infinity is NaN: an absent component stays 0.
            if normal[i] != 0.0 {
                jet.second[axis] = normal[i] * bend;
                jet.third[axis] = if n3.is_finite() {
                    tangent[i] * t3 + normal[i] * n3
                } else {
                    normal[i] * n3
                };
            } else {
                jet.third[axis] = tangent[i] * t3;
            }
        }
        if self.inward { jet.reversed() } else { jet }
    }

    fn sense(&self) -> Sense {
        Sense::of(if self.inward {
            -self.handedness
        } else {
            self.handedness
        })
    }

    fn bounds(&self, u0: f64, u1: f64) -> (Axes, Axes) {
        let (from, to) = self.outward_range(u0, u1);
        let (a, b) = (self.point(from), self.point(to));
        let (mut low, mut high) = (a.inf(&b), a.sup(&b));
        let angle = libm::atan2(self.tangent[1], self.tangent[0]);
        let (from, to) = (self.roll.at(from).turn, self.roll.at(to).turn);
        let (first, second, _) = self.plane.axes();
        // Extrema are where the tangent is parallel to the other axis. They grow outwards, so the last ones
        // count.
        for turn in axis_crossings(angle, self.handedness, from, to) {
            let fraction = self.roll.arc_length_at_turn(turn) / self.roll.length();
            let point = self.point_at_roll(turn, fraction);
            for axis in [first, second] {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        (low, high)
    }

    fn derivative_bounds(&self, u0: f64, u1: f64) -> (Axes, Axes, Axes) {
        let (from, to) = self.outward_range(u0, u1);
        let angle = libm::atan2(self.tangent[1], self.tangent[0]);
        let turns = [from, to].map(|u| angle + self.handedness * self.roll.at(u).turn);
        let (cos, sin) = cos_sin_ranges(turns[0], turns[1]);
        let bounds = self.roll.bounds(from, to);
        let slope = self.slope();
        let linear = |order: usize, axis: usize| bounds.s[order - 1].scaled(slope[axis]);
        let mut out = [1, 2, 3].map(|order| slope.map(|rate| bounds.s[order - 1].scaled(rate).magnitude()));
        let (first, second, _) = self.plane.axes();
        // Tangent (cos, sin), normal (-sin, cos) times the handedness.
        let tangent_normal = [
            (first, cos, sin.scaled(-self.handedness)),
            (second, sin, cos.scaled(self.handedness)),
        ];
        let k = self.roll.planar_fraction();
        for (axis, t, n) in tangent_normal {
            out[0][axis] = (bounds.s[0].scaled(k) * t + linear(1, axis)).magnitude();
            out[1][axis] = (bounds.t2 * t + bounds.n2 * n + linear(2, axis)).magnitude();
            out[2][axis] = (bounds.t3 * t + bounds.n3 * n + linear(3, axis)).magnitude();
        }
        (out[0], out[1], out[2])
    }

    fn curvature_bound(&self, u0: f64, u1: f64) -> f64 {
        let phi = self.roll.at(self.outward_range(u0, u1).0).phi;
        let k = self.roll.planar_fraction();
        // The end offset changes the speed by at most its fraction of the length, and the curvature by its
        // square.
        let change = norm(self.end_offset) / self.roll.length();
        k * k / (self.roll.base_radius() * phi * (1.0 - change) * (1.0 - change))
    }

    fn reversed(&self) -> Self {
        Self {
            inward: !self.inward,
            ..*self
        }
    }
}

/// Outward unit tangent at the point `arm` relative to the centre; `tangent_length` is r phi: arm = r t - r
/// phi n.
fn tangent_at(arm: Planar, r: f64, tangent_length: f64, handedness: f64) -> Planar {
    let tangent = mix(arm, r, perp(arm), handedness * tangent_length);
    let size = norm(tangent);
    [tangent[0] / size, tangent[1] / size]
}

/// sin x - x cos x, approximately x^3 / 3 near zero.
pub(crate) fn sin_less_angle_cos(x: f64, sin: f64, cos: f64) -> f64 {
    if x.abs() > 1.0 {
        return sin - x * cos;
    }
    // Taylor series: sum of (-1)^(k+1) 2k / (2k+1)! x^(2k+1) in Horner form, with x^3 / 3 factored out.
    const SERIES: [f64; 8] = [
        1.0,
        -1.0 / 10.0,
        1.0 / 280.0,
        -1.0 / 15_120.0,
        1.0 / 1_330_560.0,
        -1.0 / 172_972_800.0,
        1.0 / 31_135_104_000.0,
        -1.0 / 7_410_154_752_000.0,
    ];
    let y = x * x;
    let sum = SERIES.iter().rev().fold(0.0, |sum, term| sum * y + term);
    x * y / 3.0 * sum
}

/// The roll angle with the given polar angle phi - atan phi, by Newton's method on a convex function.
fn roll_of_polar(polar: f64) -> f64 {
    // Starts above both asymptotes (3 p)^(1/3) and p + pi/2, so the iteration decreases monotonically.
    let mut phi = (libm::cbrt(3.0 * polar) * 1.2).max(polar + 0.5 * PI).max(1e-9);
    for _ in 0..60 {
        let next = phi - (phi - libm::atan(phi) - polar) * (1.0 + phi * phi) / (phi * phi);
        if !(next < phi && next > 0.0) {
            break;
        }
        phi = next;
    }
    phi
}

/// Bounds of the coefficients of tangent and normal in the in-plane derivatives, and of the derivatives of
/// arc length.
pub(crate) struct RollBounds {
    /// First to third derivative of arc length by the regular parameter.
    pub(crate) s: [Interval; 3],
    pub(crate) t2: Interval,
    pub(crate) n2: Interval,
    pub(crate) t3: Interval,
    pub(crate) n3: Interval,
}

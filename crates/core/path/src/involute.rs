//! Involute of a circle in any plane.

use std::f64::consts::{PI, TAU};

use thiserror::Error;

use crate::curve::ParamCurve;
use crate::error::{MAX_COORDINATE, MIN_RADIUS_MM, bad_coordinate};
use crate::plane::{
    Interval, Planar, axis_crossings, cos_sin_ranges, cross, dot, mix, norm, perp, sin_cos_versin, sub,
};
use crate::roll::Roll;
use crate::{Axes, Jet, Plane, Sense};

/// Most turns of one involute block (Fanuc's G02.2 has the same limit).
pub const MAX_INVOLUTE_TURNS: f64 = 100.0;

/// Why an involute cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum InvoluteError {
    /// A coordinate is NaN, infinite or absurdly large.
    #[error("coordinate {axis} is {value}: give a number between -{MAX_COORDINATE:e} and {MAX_COORDINATE:e}")]
    Coordinate {
        /// The axis' letter.
        axis: char,
        /// What was given, in mm or degrees.
        value: f64,
    },
    /// The base circle is not usable.
    #[error(
        "the base circle has its centre at ({first}, {second}) mm and radius {base_radius_mm} mm: give two finite coordinates and a radius of at least {MIN_RADIUS_MM:e} mm"
    )]
    BaseCircle {
        /// Centre along the plane's first axis in mm.
        first: f64,
        /// Centre along the plane's second axis in mm.
        second: f64,
        /// Radius in mm.
        base_radius_mm: f64,
    },
    /// An involute needs a sense.
    #[error("an involute turns either clockwise or counter-clockwise: name one of them")]
    Sense,
    /// The tolerance is negative or not a number.
    #[error("the end point tolerance is {tolerance_mm} mm: give a number that is not negative")]
    Tolerance {
        /// What was given in mm.
        tolerance_mm: f64,
    },
    /// The start lies inside the base circle, where there is no involute.
    #[error(
        "the start lies {radius_mm} mm from the base circle's centre, inside the base circle of radius {base_radius_mm} mm: move the start outwards or make the base circle smaller"
    )]
    StartInside {
        /// Distance from the base circle's centre in mm.
        radius_mm: f64,
        /// The base circle's radius in mm.
        base_radius_mm: f64,
    },
    /// The end lies inside the base circle, where there is no involute.
    #[error(
        "the end lies {radius_mm} mm from the base circle's centre, inside the base circle of radius {base_radius_mm} mm: move the end outwards or make the base circle smaller"
    )]
    EndInside {
        /// Distance from the base circle's centre in mm.
        radius_mm: f64,
        /// The base circle's radius in mm.
        base_radius_mm: f64,
    },
    /// Start and end lie equally far from the base circle's centre.
    #[error(
        "start and end lie {start_radius_mm} mm and {end_radius_mm} mm from the base circle's centre, and an involute changes that distance: for a circle use G2 or G3"
    )]
    EqualRadii {
        /// Distance of the start in mm.
        start_radius_mm: f64,
        /// Distance of the end in mm.
        end_radius_mm: f64,
    },
    /// More turns than one block may have.
    #[error("the involute makes {turns} turns, at most {MAX_INVOLUTE_TURNS} are possible: split it")]
    Turns {
        /// Turns from start to end.
        turns: f64,
    },
    /// The end point is not on the involute through the start.
    #[error(
        "the end point lies {distance_mm} mm off the involute through the start, more than the tolerance of {tolerance_mm} mm: it is {end_radius_mm} mm from the base circle's centre, and in its direction the involute is at {involute_radius_mm} mm"
    )]
    OffInvolute {
        /// Distance of the end point from the involute in mm.
        distance_mm: f64,
        /// The tolerance in mm.
        tolerance_mm: f64,
        /// Distance of the end point from the base circle's centre in mm.
        end_radius_mm: f64,
        /// Distance of the involute's point in the same direction, nearest to that radius, in mm.
        involute_radius_mm: f64,
    },
}

/// The involute of a circle: the curve that the end of a taut thread draws as it unwinds from the base circle.
///
/// With base radius r and roll angle phi: radius of curvature r phi, arc length from the base circle
/// r phi^2 / 2, distance from the centre r sqrt(1 + phi^2) (Sorokin, But and Kombarov 2013, equations (2), (3)).
/// Outwards the thread unwinds, inwards it winds up; the sense is that in which the direction of motion
/// turns. The axis normal to the plane and all others are linear in arc length (a helical involute).
///
/// An end point that is off the curve, within the tolerance, is met by a displacement that grows evenly with
/// arc length, nowhere larger than at the end (by roll angle it would turn the tangent at the base circle, where
/// arc length grows with the angle's square). `length` and the parameters count the undisturbed curve then.
///
/// Where the curve comes close to its base circle the regular parameter is not arc length, see `Roll`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Involute {
    plane: Plane,
    /// The end nearer to the base circle; all is computed from there, whichever way the path runs.
    inner: Axes,
    outer: Axes,
    /// Whether the path runs from `outer` to `inner`.
    inward: bool,
    /// Sense of turning on the way out, +1 counter-clockwise.
    handed: f64,
    /// Direction of the outward tangent at `inner`.
    tangent: Planar,
    /// In-plane displacement that makes the outer end exact.
    gap: Planar,
    roll: Roll,
}

impl Involute {
    /// The involute of the circle of radius `base_radius_mm` about `centre` (in-plane coordinates in mm) from
    /// `start` to `end`; outwards or inwards, and with as many turns, as the two points' radii demand.
    ///
    /// `tolerance_mm` is how far the end may lie off the involute through the start, and either end inside the
    /// base circle. Words of G02.2/G03.2 after the Fanuc 30i operator's manual: I, J to the centre, R the base
    /// radius; G03.2 is [`Sense::CounterClockwise`].
    ///
    /// # Errors
    /// One variant of [`InvoluteError`] for each thing that can be wrong.
    pub fn new(
        plane: Plane,
        start: Axes,
        end: Axes,
        centre: [f64; 2],
        base_radius_mm: f64,
        sense: Sense,
        tolerance_mm: f64,
    ) -> Result<Self, InvoluteError> {
        for point in [&start, &end] {
            if let Some((axis, value)) = bad_coordinate(point) {
                return Err(InvoluteError::Coordinate { axis, value });
            }
        }
        let r = base_radius_mm;
        let [first, second] = centre;
        let usable = first.abs() <= MAX_COORDINATE && second.abs() <= MAX_COORDINATE;
        if !(usable && (MIN_RADIUS_MM..=MAX_COORDINATE).contains(&r)) {
            return Err(InvoluteError::BaseCircle {
                first,
                second,
                base_radius_mm,
            });
        }
        if sense == Sense::Straight {
            return Err(InvoluteError::Sense);
        }
        if !(tolerance_mm >= 0.0) {
            return Err(InvoluteError::Tolerance { tolerance_mm });
        }
        let from = sub(plane.project(&start), centre);
        let to = sub(plane.project(&end), centre);
        let (start_radius_mm, end_radius_mm) = (norm(from), norm(to));
        // A point that was meant to be on the base circle may have been rounded to its inside.
        let slack = (tolerance_mm + 8.0 * f64::EPSILON * (r + norm(centre))).min(0.1 * r);
        if !(start_radius_mm >= r - slack) {
            return Err(InvoluteError::StartInside {
                radius_mm: start_radius_mm,
                base_radius_mm,
            });
        }
        if !(end_radius_mm >= r - slack) {
            return Err(InvoluteError::EndInside {
                radius_mm: end_radius_mm,
                base_radius_mm,
            });
        }
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
        let handed = if inward { -sense.sign() } else { sense.sign() };
        // The free thread's length at both ends is r phi; on or within the base circle it is nothing.
        let thread = |radius: f64| ((radius - r).max(0.0) * (radius + r)).sqrt();
        let (near_thread, far_thread) = (thread(near_radius), thread(far_radius));
        let chord = sub(plane.project(&outer), plane.project(&inner));
        // far^2 - near^2 = r^2 (phi_1^2 - phi_0^2), from the chord so that short curves keep their digits.
        let squares = if near_radius > r {
            dot(mix(near, 1.0, far, 1.0), chord)
        } else {
            far_thread * far_thread
        };
        let planar_length = squares / (2.0 * r);
        let equal = InvoluteError::EqualRadii {
            start_radius_mm,
            end_radius_mm,
        };
        if !(planar_length > f64::EPSILON * far_radius) {
            return Err(equal);
        }
        let turns = (far_thread - near_thread) / (r * TAU);
        // A hundred turns, as computed, may be a rounding more.
        if turns > MAX_INVOLUTE_TURNS * (1.0 + 1e-9) {
            return Err(InvoluteError::Turns { turns });
        }

        let normal = plane.axes().2;
        let climb = outer[normal] - inner[normal];
        let phi_in = near_thread / r;
        let tangent = tangent_at(near, r, near_thread, handed);
        let roll = Roll::new(r, phi_in, planar_length, climb);
        let mut involute = Self {
            plane,
            inner,
            outer,
            inward,
            handed,
            tangent,
            gap: [0.0, 0.0],
            roll,
        };

        // Involutes of one circle are parallel curves: turned by an angle they are base radius times angle apart,
        // everywhere. The foot of the end point is where the tangent is the end's own: many turns out that is far
        // better known than the radius tells, where a micrometre of radius is phi micrometres of path.
        let meant = tangent_at(far, r, far_thread, handed);
        let (_, met, _) = involute.rolled(roll.last_turn());
        let angle = libm::atan2(cross(met, meant), dot(met, meant));
        let turn = roll.last_turn() + handed * angle;
        let mut planar_length = planar_length;
        if angle.abs() > 8.0 * f64::EPSILON * (1.0 + roll.last_turn()) && turn > 0.0 {
            planar_length = 0.5 * r * turn * (turn + 2.0 * phi_in);
            involute.roll = Roll::new(r, phi_in, planar_length, climb);
        }
        involute.gap = sub(chord, involute.rolled(involute.roll.last_turn()).0);

        let distance_mm = r * angle.abs();
        let rounding = 64.0 * f64::EPSILON * (far_radius + norm(centre)) * (1.0 + roll.last_turn());
        // Whatever the tolerance, a displacement that is no longer small against the path is not a displacement.
        let tolerance_mm = tolerance_mm.min(0.1 * planar_length);
        if !(distance_mm <= tolerance_mm + rounding && norm(involute.gap) <= 0.2 * planar_length) {
            if (far_radius - near_radius) <= tolerance_mm {
                return Err(equal);
            }
            // Roll angle of the involute through the start where it crosses the end's direction.
            let (phi, angle) = if inward {
                (phi_in, -angle)
            } else {
                (far_thread / r, angle)
            };
            let polar = phi - libm::atan(phi) + handed * angle;
            let polar = if polar < 0.0 { polar + TAU } else { polar };
            let involute_radius_mm = r * libm::hypot(1.0, roll_of_polar(polar));
            return Err(InvoluteError::OffInvolute {
                distance_mm,
                tolerance_mm,
                end_radius_mm,
                involute_radius_mm,
            });
        }
        Ok(involute)
    }

    /// The plane.
    #[must_use]
    pub fn plane(&self) -> Plane {
        self.plane
    }

    /// Radius of the base circle in mm.
    #[must_use]
    pub fn base_radius_mm(&self) -> f64 {
        self.roll.base_radius()
    }

    /// Roll angles at start and end in rad; zero is the base circle.
    #[must_use]
    pub fn roll_angles_rad(&self) -> (f64, f64) {
        let (inner, outer) = (self.roll.phi_in(), self.roll.phi_out());
        if self.inward {
            (outer, inner)
        } else {
            (inner, outer)
        }
    }

    /// The regular parameter at a roll angle in rad, which is taken as the nearer end's where it lies beyond.
    #[must_use]
    pub fn parameter_at_roll(&self, phi: f64) -> f64 {
        let turn = (phi - self.roll.phi_in()).max(0.0).min(self.roll.last_turn());
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

    /// Whether the path runs towards the base circle.
    #[must_use]
    pub fn is_inward(&self) -> bool {
        self.inward
    }

    /// The base circle's centre, in-plane coordinates in mm.
    #[must_use]
    pub fn centre_mm(&self) -> [f64; 2] {
        // From the inner point back along the thread's foot: p - c = r t - r phi n.
        let r = self.roll.base_radius();
        let normal = mix(perp(self.tangent), self.handed, [0.0, 0.0], 0.0);
        let arm = mix(self.tangent, r, normal, -r * self.roll.phi_in());
        sub(self.plane.project(&self.inner), arm)
    }

    /// In-plane displacement from the inner end, tangent and normal (the tangent's derivative by the roll
    /// angle) after rolling by `turn` beyond the inner end's roll angle.
    fn rolled(&self, turn: f64) -> (Planar, Planar, Planar) {
        let (r, phi) = (self.roll.base_radius(), self.roll.phi_in());
        let (sin, cos, versin) = sin_cos_versin(turn);
        let normal = [self.handed * -self.tangent[1], self.handed * self.tangent[0]];
        // Integral of r (phi + w) (cos w t + sin w n) over w in 0..turn; every term keeps its digits near zero.
        let along = phi * sin + (turn * sin - versin);
        let across = phi * versin + sin_less_angle_cos(turn, sin, cos);
        (
            mix(self.tangent, r * along, normal, r * across),
            mix(self.tangent, cos, normal, sin),
            mix(normal, cos, self.tangent, -sin),
        )
    }

    /// Position at `outwards`, the regular parameter from the inner end, with the roll there.
    fn place(&self, turn: f64, share: f64) -> Axes {
        self.displaced(self.rolled(turn).0, share)
    }

    /// The point at an in-plane displacement of the undisturbed curve from the inner end.
    fn displaced(&self, displacement: Planar, share: f64) -> Axes {
        let (first, second, _) = self.plane.axes();
        let displacement = mix(displacement, 1.0, self.gap, share);
        let mut position = self.inner + (self.outer - self.inner) * share;
        position[first] = self.inner[first] + displacement[0];
        position[second] = self.inner[second] + displacement[1];
        position
    }

    /// The regular parameter from the inner end.
    fn outwards(&self, u: f64) -> f64 {
        let u = u.max(0.0).min(self.roll.domain());
        if self.inward { self.roll.domain() - u } else { u }
    }

    /// Rates of change per unit of arc length of what is linear in it.
    fn slope(&self) -> Axes {
        let (first, second, _) = self.plane.axes();
        let mut slope = self.outer - self.inner;
        slope[first] = self.gap[0];
        slope[second] = self.gap[1];
        slope / self.roll.length()
    }

    fn point(&self, outwards: f64) -> Axes {
        if outwards <= 0.0 {
            self.inner
        } else if outwards >= self.roll.domain() {
            self.outer
        } else {
            let state = self.roll.at(outwards);
            self.place(state.turn, state.s[0] / self.roll.length())
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
        let [t2, n2, t3, n3] = state.weights(self.roll.planar_share());
        let planar = [
            mix(tangent, state.s[1] * self.roll.planar_share(), normal, 0.0),
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

    /// By arc length: closed form. At the base circle the second and third derivative are infinite along the
    /// normal, where the normal has a component.
    fn at(&self, s: f64) -> Jet {
        let s = s.max(0.0).min(self.roll.length());
        let s = if self.inward { self.roll.length() - s } else { s };
        let (r, k) = (self.roll.base_radius(), self.roll.planar_share());
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
            // Zero times infinity is no number: a component that is not there stays zero.
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
        Sense::of(if self.inward { -self.handed } else { self.handed })
    }

    fn bounds(&self, u0: f64, u1: f64) -> (Axes, Axes) {
        let (from, to) = self.outward_range(u0, u1);
        let (a, b) = (self.point(from), self.point(to));
        let (mut low, mut high) = (a.inf(&b), a.sup(&b));
        let angle = libm::atan2(self.tangent[1], self.tangent[0]);
        let (from, to) = (self.roll.at(from).turn, self.roll.at(to).turn);
        let (first, second, _) = self.plane.axes();
        // Extremes lie where the tangent is along the other axis; they grow outwards, so the last count.
        for turn in axis_crossings(angle, self.handed, from, to) {
            let share = self.roll.arc_length_at_turn(turn) / self.roll.length();
            let point = self.place(turn, share);
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
        let turns = [from, to].map(|u| angle + self.handed * self.roll.at(u).turn);
        let (cos, sin) = cos_sin_ranges(turns[0], turns[1]);
        let bounds = self.roll.bounds(from, to);
        let slope = self.slope();
        let linear = |order: usize, axis: usize| bounds.s[order - 1].scaled(slope[axis]);
        let mut out = [1, 2, 3].map(|order| slope.map(|rate| bounds.s[order - 1].scaled(rate).magnitude()));
        let (first, second, _) = self.plane.axes();
        // Tangent (cos, sin), normal (-sin, cos) times the handedness.
        let tangent_normal = [
            (first, cos, sin.scaled(-self.handed)),
            (second, sin, cos.scaled(self.handed)),
        ];
        let k = self.roll.planar_share();
        for (axis, t, n) in tangent_normal {
            out[0][axis] = (bounds.s[0].scaled(k) * t + linear(1, axis)).magnitude();
            out[1][axis] = (bounds.t2 * t + bounds.n2 * n + linear(2, axis)).magnitude();
            out[2][axis] = (bounds.t3 * t + bounds.n3 * n + linear(3, axis)).magnitude();
        }
        (out[0], out[1], out[2])
    }

    fn curvature_bound(&self, u0: f64, u1: f64) -> f64 {
        let phi = self.roll.at(self.outward_range(u0, u1).0).phi;
        let k = self.roll.planar_share();
        // The displacement of the end changes the speed by its share of the length, and curvature by its square.
        let change = norm(self.gap) / self.roll.length();
        k * k / (self.roll.base_radius() * phi * (1.0 - change) * (1.0 - change))
    }

    fn reversed(&self) -> Self {
        Self {
            inward: !self.inward,
            ..*self
        }
    }
}

/// Outward tangent at the point `arm` from the centre with `thread` unwound: arm = r t - thread n.
fn tangent_at(arm: Planar, r: f64, thread: f64, handed: f64) -> Planar {
    let tangent = mix(arm, r, perp(arm), handed * thread);
    let size = norm(tangent);
    [tangent[0] / size, tangent[1] / size]
}

/// sin x - x cos x, which is x^3 / 3 near zero.
pub(crate) fn sin_less_angle_cos(x: f64, sin: f64, cos: f64) -> f64 {
    if x.abs() > 1.0 {
        return sin - x * cos;
    }
    // Sum of (-1)^(k+1) 2k / (2k+1)! x^(2k+1), by Horner, with x^3 / 3 taken out.
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

/// The roll angle whose polar angle phi - atan phi is given, by Newton's method on a convex function.
fn roll_of_polar(polar: f64) -> f64 {
    // Above both asymptotes (3 p)^(1/3) and p + pi/2 the iteration falls monotonically.
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

/// Safe ranges of the coefficients of tangent and normal in the in-plane derivatives, and of arc length's.
pub(crate) struct RollBounds {
    /// First to third derivative of arc length by the regular parameter.
    pub(crate) s: [Interval; 3],
    pub(crate) t2: Interval,
    pub(crate) n2: Interval,
    pub(crate) t3: Interval,
    pub(crate) n3: Interval,
}

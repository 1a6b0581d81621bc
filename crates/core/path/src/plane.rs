//! The working plane, the sense of rotation, and planar vectors.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use crate::Axes;

/// The plane of an arc or involute (RS274/NGC: G17, G18, G19).
///
/// First axis, second axis and normal form a right-handed system: counter-clockwise is seen from the positive
/// normal axis in every plane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Plane {
    /// G17: X and Y, normal Z.
    #[default]
    Xy,
    /// G18: Z and X, normal Y.
    Zx,
    /// G19: Y and Z, normal X.
    Yz,
}

impl Plane {
    /// Indices into [`Axes`] of the first, second and normal axis.
    #[must_use]
    pub const fn axes(self) -> (usize, usize, usize) {
        match self {
            Self::Xy => (0, 1, 2),
            Self::Zx => (2, 0, 1),
            Self::Yz => (1, 2, 0),
        }
    }

    /// The in-plane coordinates, first axis first.
    #[must_use]
    pub fn project(self, axes: &Axes) -> [f64; 2] {
        let (first, second, _) = self.axes();
        [axes[first], axes[second]]
    }
}

/// The sense of rotation of a curve in its plane, seen from the plane's positive normal axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Sense {
    /// No rotation.
    Straight,
    /// Turns right: G2, G2.2.
    Clockwise,
    /// Turns left: G3, G3.2.
    CounterClockwise,
}

impl Sense {
    /// +1 counter-clockwise, -1 clockwise, 0 straight.
    #[must_use]
    pub const fn sign(self) -> f64 {
        match self {
            Self::Straight => 0.0,
            Self::Clockwise => -1.0,
            Self::CounterClockwise => 1.0,
        }
    }

    /// The sense of the curve traversed in the opposite direction.
    #[must_use]
    pub const fn reversed(self) -> Self {
        match self {
            Self::Straight => Self::Straight,
            Self::Clockwise => Self::CounterClockwise,
            Self::CounterClockwise => Self::Clockwise,
        }
    }

    pub(crate) fn of(turning: f64) -> Self {
        if turning > 0.0 {
            Self::CounterClockwise
        } else if turning < 0.0 {
            Self::Clockwise
        } else {
            Self::Straight
        }
    }
}

pub(crate) type Planar = [f64; 2];

pub(crate) fn sub(a: Planar, b: Planar) -> Planar {
    [a[0] - b[0], a[1] - b[1]]
}

pub(crate) fn dot(a: Planar, b: Planar) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

pub(crate) fn cross(a: Planar, b: Planar) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// Rotated by +90 degrees.
pub(crate) fn perp(a: Planar) -> Planar {
    [-a[1], a[0]]
}

/// `a * x + b * y`.
pub(crate) fn mix(a: Planar, x: f64, b: Planar, y: f64) -> Planar {
    [a[0] * x + b[0] * y, a[1] * x + b[1] * y]
}

pub(crate) fn norm(a: Planar) -> f64 {
    libm::hypot(a[0], a[1])
}

/// Sine, cosine and versine (1 - cosine) of an angle, all to full relative accuracy near zero.
pub(crate) fn sin_cos_versin(angle: f64) -> (f64, f64, f64) {
    let (half_sin, half_cos) = libm::sincos(0.5 * angle);
    let versin = 2.0 * half_sin * half_sin;
    (2.0 * half_sin * half_cos, 1.0 - versin, versin)
}

/// The rotation angles in `from..=to` at which a direction that starts at `angle` and rotates with `sense`
/// (+1, -1) is parallel to a coordinate axis: the first and the last for each of the four half axes. Missing
/// ones are replaced by `from` or `to`.
pub(crate) fn axis_crossings(angle: f64, sense: f64, from: f64, to: f64) -> [f64; 8] {
    let mut crossings = [from; 8];
    for (quarter, pair) in crossings.chunks_exact_mut(2).enumerate() {
        let offset = sense * (quarter as f64 * FRAC_PI_2 - angle);
        pair[0] = (from + (offset - from).rem_euclid(TAU)).min(to);
        pair[1] = (to - (to - offset).rem_euclid(TAU)).max(from);
    }
    crossings
}

/// Ranges of cosine and sine over the angles between `a` and `b`, in either order.
pub(crate) fn cos_sin_ranges(a: f64, b: f64) -> (Interval, Interval) {
    let (low, high) = if a <= b { (a, b) } else { (b, a) };
    if high - low >= TAU {
        return (Interval::new(-1.0, 1.0), Interval::new(-1.0, 1.0));
    }
    let range = |shift: f64, x: f64, y: f64| {
        // Extrema are at the ends, unless the extremal angle itself is inside.
        let holds = |extreme: f64| (extreme - low).rem_euclid(TAU) <= high - low;
        let upper = if holds(shift) { 1.0 } else { x.max(y) };
        let lower = if holds(shift + PI) { -1.0 } else { x.min(y) };
        Interval::new(lower, upper)
    };
    let (sin_low, cos_low) = libm::sincos(low);
    let (sin_high, cos_high) = libm::sincos(high);
    (range(0.0, cos_low, cos_high), range(FRAC_PI_2, sin_low, sin_high))
}

/// A closed interval, for guaranteed bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Interval {
    pub(crate) low: f64,
    pub(crate) high: f64,
}

impl Interval {
    pub(crate) fn new(a: f64, b: f64) -> Self {
        Self {
            low: a.min(b),
            high: a.max(b),
        }
    }

    pub(crate) fn magnitude(self) -> f64 {
        self.low.abs().max(self.high.abs())
    }

    pub(crate) fn hull(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }

    pub(crate) fn scaled(self, factor: f64) -> Self {
        Self::new(self.low * factor, self.high * factor)
    }
}

impl std::ops::Add for Interval {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            low: self.low + other.low,
            high: self.high + other.high,
        }
    }
}

impl std::ops::Mul for Interval {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let products = [
            self.low * other.low,
            self.low * other.high,
            self.high * other.low,
            self.high * other.high,
        ];
        Self {
            low: products.into_iter().fold(f64::INFINITY, f64::min),
            high: products.into_iter().fold(f64::NEG_INFINITY, f64::max),
        }
    }
}

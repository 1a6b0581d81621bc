//! The trait of all curves, and the enum over them.

use nalgebra::Vector3;

use crate::{Arc, Axes, Blend, Involute, Jet, Line, Sense, Spline};

/// The operations common to all curves.
///
/// A curve has two parameters: the *regular parameter* `u` in `0..=domain()`, by which every derivative is
/// finite, and the *arc length* `s` in `0..=length()`. They are identical on lines and on arcs of constant
/// radius; they differ near an involute's base circle, on arcs with two radii, on blends and on splines.
/// Parameters outside the range are clamped to it; NaN is treated as the start.
///
/// Lengths are measured in the feed metric of RS274/NGC: mm of XYZ; if XYZ does not move, mm of UVW; if UVW
/// does not move either, degrees of ABC.
///
/// *Real-time safe* means: no allocation, no lock, bounded time, so the cycle may call it.
pub trait ParamCurve {
    /// Path length. Real-time safe.
    fn length(&self) -> f64;

    /// Length of the range of the regular parameter. Real-time safe.
    fn domain(&self) -> f64;

    /// The start point, bit for bit as given. Real-time safe.
    fn start(&self) -> Axes;

    /// The end point, bit for bit as given. Real-time safe.
    fn end(&self) -> Axes;

    /// Position at the regular parameter `u`. Real-time safe, no loop.
    fn position(&self, u: f64) -> Axes;

    /// Position and derivatives by the regular parameter, always finite. Real-time safe, no loop.
    fn jet(&self, u: f64) -> Jet;

    /// Arc length from the start to the regular parameter `u`. Not real-time safe: may integrate numerically.
    fn arc_length(&self, u: f64) -> f64;

    /// The regular parameter at the arc length `s`, the inverse of [`arc_length`](Self::arc_length). Not
    /// real-time safe.
    fn parameter(&self, s: f64) -> f64;

    /// Position and derivatives by arc length. They are infinite at an involute's base-circle point and where
    /// the speed of a blend vanishes. Not real-time safe.
    fn at(&self, s: f64) -> Jet {
        self.jet(self.parameter(s)).by_arc_length()
    }

    /// Unit tangent of the XYZ curve at arc length `s`; zero where XYZ does not move. Not real-time safe.
    fn tangent(&self, s: f64) -> Vector3<f64> {
        self.at(s).tangent()
    }

    /// Curvature of the XYZ curve at arc length `s` in 1/mm, not negative. Not real-time safe.
    fn curvature(&self, s: f64) -> f64 {
        self.at(s).curvature()
    }

    /// Derivative of the XYZ curvature by arc length in 1/mm^2. Not real-time safe.
    fn curvature_derivative(&self, s: f64) -> f64 {
        self.at(s).curvature_derivative()
    }

    /// The sense of rotation of the curve in its plane: from the first tangent to the last, in the coordinate
    /// plane closest to both. Real-time safe.
    fn sense(&self) -> Sense {
        let turning = self.jet(0.0).tangent().cross(&self.jet(self.domain()).tangent());
        Sense::of(turning[turning.iamax()])
    }

    /// Minimum and maximum position of every axis between two regular parameters, for travel checks. Exact to
    /// rounding. Not real-time safe.
    fn bounds(&self, u0: f64, u1: f64) -> (Axes, Axes);

    /// Upper bounds of |q'|, |q''| and |q'''| by the regular parameter for every axis, between two
    /// parameters. Always valid, and tight where the derivatives vary little over the range. Not real-time
    /// safe.
    fn derivative_bounds(&self, u0: f64, u1: f64) -> (Axes, Axes, Axes);

    /// Upper bound of the XYZ curvature in 1/mm between two regular parameters; infinite if the range
    /// contains an involute's base-circle point. Not real-time safe.
    fn curvature_bound(&self, u0: f64, u1: f64) -> f64;

    /// The same curve traversed in the opposite direction.
    #[must_use]
    fn reversed(&self) -> Self
    where
        Self: Sized;
}

/// A curve of a path: a small value without heap memory, so wait-free queues can carry it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Curve {
    /// A straight line.
    Line(Line),
    /// An arc or helix.
    Arc(Arc),
    /// The involute of a circle.
    Involute(Involute),
    /// A polynomial blend.
    Blend(Blend),
    /// A cubic piece of a spline.
    Spline(Spline),
}

macro_rules! each {
    ($curve:expr, $inner:ident => $body:expr) => {
        match $curve {
            Curve::Line($inner) => $body,
            Curve::Arc($inner) => $body,
            Curve::Involute($inner) => $body,
            Curve::Blend($inner) => $body,
            Curve::Spline($inner) => $body,
        }
    };
}

/// The functions of [`ParamCurve`], without importing the trait.
impl Curve {
    /// The part of a line or an arc between two arc lengths, `from < to`. With `from = 0` or `to = length()`
    /// that end is kept bit for bit. `None` for other curves, and for a part without length. Not real-time
    /// safe.
    #[must_use]
    pub fn part(&self, from: f64, to: f64) -> Option<Self> {
        if !(to > from) {
            return None;
        }
        match self {
            Self::Line(line) => Line::new(line.position(from), line.position(to))
                .ok()
                .map(Self::Line),
            Self::Arc(arc) => Some(Self::Arc(arc.part(from, to))),
            Self::Involute(_) | Self::Blend(_) | Self::Spline(_) => None,
        }
    }

    /// See [`ParamCurve::length`].
    #[must_use]
    pub fn length(&self) -> f64 {
        each!(self, c => c.length())
    }

    /// See [`ParamCurve::domain`].
    #[must_use]
    pub fn domain(&self) -> f64 {
        each!(self, c => c.domain())
    }

    /// See [`ParamCurve::start`].
    #[must_use]
    pub fn start(&self) -> Axes {
        each!(self, c => c.start())
    }

    /// See [`ParamCurve::end`].
    #[must_use]
    pub fn end(&self) -> Axes {
        each!(self, c => c.end())
    }

    /// See [`ParamCurve::position`].
    #[must_use]
    pub fn position(&self, u: f64) -> Axes {
        each!(self, c => c.position(u))
    }

    /// See [`ParamCurve::jet`].
    #[must_use]
    pub fn jet(&self, u: f64) -> Jet {
        each!(self, c => c.jet(u))
    }

    /// See [`ParamCurve::arc_length`].
    #[must_use]
    pub fn arc_length(&self, u: f64) -> f64 {
        each!(self, c => c.arc_length(u))
    }

    /// See [`ParamCurve::parameter`].
    #[must_use]
    pub fn parameter(&self, s: f64) -> f64 {
        each!(self, c => c.parameter(s))
    }

    /// See [`ParamCurve::at`].
    #[must_use]
    pub fn at(&self, s: f64) -> Jet {
        each!(self, c => c.at(s))
    }

    /// See [`ParamCurve::tangent`].
    #[must_use]
    pub fn tangent(&self, s: f64) -> Vector3<f64> {
        each!(self, c => c.tangent(s))
    }

    /// See [`ParamCurve::curvature`].
    #[must_use]
    pub fn curvature(&self, s: f64) -> f64 {
        each!(self, c => c.curvature(s))
    }

    /// See [`ParamCurve::curvature_derivative`].
    #[must_use]
    pub fn curvature_derivative(&self, s: f64) -> f64 {
        each!(self, c => c.curvature_derivative(s))
    }

    /// See [`ParamCurve::sense`].
    #[must_use]
    pub fn sense(&self) -> Sense {
        each!(self, c => c.sense())
    }

    /// See [`ParamCurve::bounds`].
    #[must_use]
    pub fn bounds(&self, u0: f64, u1: f64) -> (Axes, Axes) {
        each!(self, c => c.bounds(u0, u1))
    }

    /// See [`ParamCurve::derivative_bounds`].
    #[must_use]
    pub fn derivative_bounds(&self, u0: f64, u1: f64) -> (Axes, Axes, Axes) {
        each!(self, c => c.derivative_bounds(u0, u1))
    }

    /// See [`ParamCurve::curvature_bound`].
    #[must_use]
    pub fn curvature_bound(&self, u0: f64, u1: f64) -> f64 {
        each!(self, c => c.curvature_bound(u0, u1))
    }

    /// See [`ParamCurve::reversed`].
    #[must_use]
    pub fn reversed(&self) -> Self {
        match self {
            Self::Line(c) => Self::Line(c.reversed()),
            Self::Arc(c) => Self::Arc(c.reversed()),
            Self::Involute(c) => Self::Involute(c.reversed()),
            Self::Blend(c) => Self::Blend(c.reversed()),
            Self::Spline(c) => Self::Spline(c.reversed()),
        }
    }
}

impl From<Line> for Curve {
    fn from(line: Line) -> Self {
        Self::Line(line)
    }
}

impl From<Arc> for Curve {
    fn from(arc: Arc) -> Self {
        Self::Arc(arc)
    }
}

impl From<Involute> for Curve {
    fn from(involute: Involute) -> Self {
        Self::Involute(involute)
    }
}

impl From<Blend> for Curve {
    fn from(blend: Blend) -> Self {
        Self::Blend(blend)
    }
}

impl From<Spline> for Curve {
    fn from(spline: Spline) -> Self {
        Self::Spline(spline)
    }
}

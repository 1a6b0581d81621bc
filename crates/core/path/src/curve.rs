//! What every curve can do, and the enumeration of all curves.

use nalgebra::Vector3;

use crate::{Arc, Axes, Blend, Involute, Jet, Line, Sense, Spline};

/// What every curve of a path can do.
///
/// Two parameters: the *regular parameter* `u` in `0..=domain()`, by which every derivative is finite, and the
/// *arc length* `s` in `0..=length()`. They are the same on lines and exact arcs; they differ near an
/// involute's base circle, on arcs whose two radii differ, on blends and on splines. Values outside the range are taken
/// as the nearest end, NaN as the start.
///
/// Lengths are in the feed metric: mm of XYZ; where XYZ stands still mm of UVW; where that stands still too,
/// degrees of ABC (RS274/NGC's feed rule).
pub trait ParamCurve {
    /// Path length. Cycle: yes.
    fn length(&self) -> f64;

    /// Length of the regular parameter's range. Cycle: yes.
    fn domain(&self) -> f64;

    /// The first point, bit for bit as given. Cycle: yes.
    fn start(&self) -> Axes;

    /// The last point, bit for bit as given. Cycle: yes.
    fn end(&self) -> Axes;

    /// Position at the regular parameter `u`. Cycle: yes, no allocation, no loop.
    fn position(&self, u: f64) -> Axes;

    /// Position and derivatives by the regular parameter, always finite. Cycle: yes, no allocation, no loop.
    fn jet(&self, u: f64) -> Jet;

    /// Arc length from the start to the regular parameter `u`. Cycle: no (may integrate numerically).
    fn arc_length(&self, u: f64) -> f64;

    /// The regular parameter at the arc length `s`: the inverse of [`arc_length`](Self::arc_length). Cycle: no.
    fn parameter(&self, s: f64) -> f64;

    /// Position and derivatives by arc length. Holds infinities only at an involute's base-circle point and
    /// where a blend stands still. Cycle: no.
    fn at(&self, s: f64) -> Jet;

    /// Unit tangent of the XYZ curve at arc length `s`; zero where XYZ does not move. Cycle: no.
    fn tangent(&self, s: f64) -> Vector3<f64> {
        self.at(s).tangent()
    }

    /// Curvature of the XYZ curve at arc length `s` in 1/mm, never negative. Cycle: no.
    fn curvature(&self, s: f64) -> f64 {
        self.at(s).curvature()
    }

    /// Derivative of the XYZ curvature by arc length in 1/mm^2. Cycle: no.
    fn curvature_derivative(&self, s: f64) -> f64 {
        self.at(s).curvature_derivative()
    }

    /// The sense in which the curve turns in its plane. Cycle: yes.
    fn sense(&self) -> Sense;

    /// Smallest and largest position of every axis between two regular parameters, for checks of travel.
    /// Exact to rounding. Cycle: no.
    fn bounds(&self, u0: f64, u1: f64) -> (Axes, Axes);

    /// Upper bounds of |q'|, |q''| and |q'''| by the regular parameter, of every axis, between two
    /// parameters. Always safe; tight where the derivatives vary little over the range. Cycle: no.
    fn derivative_bounds(&self, u0: f64, u1: f64) -> (Axes, Axes, Axes);

    /// Upper bound of the XYZ curvature in 1/mm between two regular parameters; infinite if the range holds
    /// an involute's base-circle point. Cycle: no.
    fn curvature_bound(&self, u0: f64, u1: f64) -> f64;

    /// The same points run the other way.
    #[must_use]
    fn reversed(&self) -> Self
    where
        Self: Sized;
}

/// A curve of a path: a small value without heap, fit for wait-free queues that must not allocate.
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

/// [`ParamCurve`]'s functions, without the need to import the trait.
impl Curve {
    /// The part of a line or an arc from one arc length to another, which is greater: 0 and the length leave an end as it is,
    /// bit for bit. `None` for the other curves, and for a part without length. Cycle: no.
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

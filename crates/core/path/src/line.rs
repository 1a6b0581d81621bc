//! A straight line in nine axes.

use crate::FeedMetric;
use crate::curve::ParamCurve;
use crate::error::check_coordinates;
use crate::{Axes, CurveError, Jet, Sense};

/// A straight line: all nine axes linear in path length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    start: Axes,
    end: Axes,
    /// Change of each axis per unit of path length.
    slope: Axes,
    length: f64,
}

impl Line {
    /// Creates the line between two points.
    ///
    /// # Errors
    /// [`CurveError::Coordinate`] if a coordinate is out of range, [`CurveError::ZeroLength`] if no axis
    /// moves.
    pub fn new(start: Axes, end: Axes) -> Result<Self, CurveError> {
        check_coordinates(&start)?;
        check_coordinates(&end)?;
        let delta = end - start;
        let length = FeedMetric::of(&delta).ok_or(CurveError::ZeroLength)?.norm(&delta);
        let slope = delta / length;
        if slope.iter().all(|component| component.is_finite()) {
            Ok(Self {
                start,
                end,
                slope,
                length,
            })
        } else {
            Err(CurveError::ZeroLength)
        }
    }
}

impl ParamCurve for Line {
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
        let u = u.max(0.0);
        // From the start with a slope: a stationary axis keeps its value bit for bit.
        if u >= self.length {
            self.end
        } else {
            self.start + self.slope * u
        }
    }

    fn jet(&self, u: f64) -> Jet {
        Jet {
            first: self.slope,
            ..Jet::at_rest(self.position(u))
        }
    }

    fn arc_length(&self, u: f64) -> f64 {
        u.max(0.0).min(self.length)
    }

    fn parameter(&self, s: f64) -> f64 {
        s.max(0.0).min(self.length)
    }

    fn at(&self, s: f64) -> Jet {
        self.jet(s)
    }

    fn sense(&self) -> Sense {
        Sense::Straight
    }

    fn bounds(&self, u0: f64, u1: f64) -> (Axes, Axes) {
        let (a, b) = (self.position(u0), self.position(u1));
        (a.inf(&b), a.sup(&b))
    }

    fn derivative_bounds(&self, _u0: f64, _u1: f64) -> (Axes, Axes, Axes) {
        (self.slope.abs(), Axes::zeros(), Axes::zeros())
    }

    fn curvature_bound(&self, _u0: f64, _u1: f64) -> f64 {
        0.0
    }

    fn reversed(&self) -> Self {
        Self {
            start: self.end,
            end: self.start,
            slope: -self.slope,
            length: self.length,
        }
    }
}

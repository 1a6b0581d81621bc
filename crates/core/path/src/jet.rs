//! Position and its first three derivatives.

use nalgebra::Vector3;

use crate::Axes;
use crate::FeedMetric;

/// Position of all axes and the first three derivatives by the path parameter.
///
/// All functions are real-time safe: no allocation, no loop of data-dependent length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jet {
    /// Position.
    pub position: Axes,
    /// First derivative: the tangent where the parameter is arc length.
    pub first: Axes,
    /// Second derivative: curvature times normal where the parameter is arc length.
    pub second: Axes,
    /// Third derivative.
    pub third: Axes,
}

impl Jet {
    /// A stationary point: all derivatives are zero.
    #[must_use]
    pub fn at_rest(position: Axes) -> Self {
        Self {
            position,
            first: Axes::zeros(),
            second: Axes::zeros(),
            third: Axes::zeros(),
        }
    }

    /// The same point with the parameter reversed: odd derivatives change sign.
    #[must_use]
    pub fn reversed(&self) -> Self {
        Self {
            position: self.position,
            first: -self.first,
            second: self.second,
            third: -self.third,
        }
    }

    /// Changes the parameter by the chain rule. `d1`, `d2`, `d3` are the derivatives of the present parameter
    /// by the new one.
    ///
    /// ```
    /// use evolvent_path::{Axes, Jet};
    ///
    /// // x = u along X with u = t^3 at t = 2: x is 8, its derivatives by time are 12, 12 and 6.
    /// let mut jet = Jet::at_rest(Axes::repeat(8.0));
    /// jet.first[0] = 1.0;
    /// let by_time = jet.compose(12.0, 12.0, 6.0);
    /// assert_eq!((by_time.first[0], by_time.second[0], by_time.third[0]), (12.0, 12.0, 6.0));
    /// ```
    #[must_use]
    pub fn compose(&self, d1: f64, d2: f64, d3: f64) -> Self {
        Self {
            position: self.position,
            first: self.first * d1,
            second: self.second * (d1 * d1) + self.first * d2,
            third: self.third * (d1 * d1 * d1) + self.second * (3.0 * d1 * d2) + self.first * d3,
        }
    }

    /// The jet by arc length in the feed metric (XYZ where XYZ moves, else UVW, else ABC).
    ///
    /// A jet whose first derivative is zero has no direction and is returned unchanged.
    ///
    /// ```
    /// use evolvent_path::{Axes, Jet};
    ///
    /// // A circle of 5 mm by its angle. By arc length the tangent is a unit vector and the curvature is 1/5.
    /// let mut circle = Jet::at_rest(Axes::zeros());
    /// (circle.first[1], circle.second[0], circle.third[1]) = (5.0, -5.0, -5.0);
    /// let by_length = circle.by_arc_length();
    /// assert!((by_length.first[1] - 1.0).abs() < 1e-15 && (by_length.second[0] + 0.2).abs() < 1e-15);
    /// ```
    #[must_use]
    pub fn by_arc_length(&self) -> Self {
        let Some(metric) = FeedMetric::of(&self.first) else {
            return *self;
        };
        // With sigma the arc length: sigma' = |q'|, and the derivatives of the inverse function follow.
        let s1 = metric.norm(&self.first);
        let s2 = metric.dot(&self.first, &self.second) / s1;
        let s3 =
            (metric.dot(&self.second, &self.second) + metric.dot(&self.first, &self.third) - s2 * s2) / s1;
        let d1 = 1.0 / s1;
        let d2 = -s2 * d1 * d1 * d1;
        let d3 = (3.0 * s2 * s2 - s1 * s3) * d1 * d1 * d1 * d1 * d1;
        self.compose(d1, d2, d3)
    }

    /// Unit tangent of the XYZ curve; zero where XYZ does not move.
    #[must_use]
    pub fn tangent(&self) -> Vector3<f64> {
        let first = xyz(&self.first);
        let norm = first.norm();
        if norm > 0.0 {
            first / norm
        } else {
            Vector3::zeros()
        }
    }

    /// Curvature of the XYZ curve in 1/mm, not negative, from derivatives by any regular parameter. Zero
    /// where XYZ does not move, infinite where the second derivative is infinite.
    #[must_use]
    pub fn curvature(&self) -> f64 {
        let (first, second) = (xyz(&self.first), xyz(&self.second));
        let speed = first.norm();
        if speed == 0.0 {
            return 0.0;
        }
        if second.iter().any(|component| component.is_infinite()) {
            return f64::INFINITY;
        }
        // |q' x q''| / |q'|^3, with the tangent normalised first to avoid overflow.
        (first / speed).cross(&second).norm() / (speed * speed)
    }

    /// Derivative of the XYZ curvature by XYZ arc length in 1/mm^2, from derivatives by any regular
    /// parameter. Zero where the curvature is zero (its magnitude is not differentiable there), minus
    /// infinity where the curvature is infinite (an involute that leaves its base circle).
    #[must_use]
    pub fn curvature_derivative(&self) -> f64 {
        let (first, second, third) = (xyz(&self.first), xyz(&self.second), xyz(&self.third));
        let speed = first.norm();
        let curvature = self.curvature();
        if speed == 0.0 || curvature == 0.0 {
            return 0.0;
        }
        if curvature.is_infinite() {
            return f64::NEG_INFINITY;
        }
        let tangent = first / speed;
        let along = tangent.cross(&second) / (speed * speed);
        let change = tangent.cross(&third) / (speed * speed);
        let by_parameter = along.dot(&change) / curvature - 3.0 * curvature * tangent.dot(&second) / speed;
        by_parameter / speed
    }

    /// Whether every component is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        [&self.position, &self.first, &self.second, &self.third]
            .into_iter()
            .all(|vector| vector.iter().all(|value| value.is_finite()))
    }
}

/// The components of X, Y and Z.
pub(crate) fn xyz(axes: &Axes) -> Vector3<f64> {
    Vector3::new(axes[0], axes[1], axes[2])
}

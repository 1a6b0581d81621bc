//! Position and its first three derivatives.

use crate::Axes;

/// Position of all axes and its first three derivatives by the path parameter.
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

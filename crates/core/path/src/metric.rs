//! The feed metric: which axes the path length is measured in.

use crate::Axes;

/// The group of axes whose motion the feed word refers to.
///
/// RS274/NGC (NISTIR 6556, section 2.1.2.5): the length of the XYZ motion; where XYZ stands still that of UVW
/// (EMC's extension); where that stands still too, ABC in degrees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Metric {
    /// Millimetres of X, Y and Z.
    Xyz,
    /// Millimetres of U, V and W.
    Uvw,
    /// Degrees of A, B and C.
    Abc,
}

impl Metric {
    /// The metric of a displacement or derivative; `None` if nothing moves.
    pub(crate) fn of(delta: &Axes) -> Option<Self> {
        [Self::Xyz, Self::Uvw, Self::Abc]
            .into_iter()
            .find(|metric| metric.norm(delta) > 0.0)
    }

    /// Index of the group's first axis.
    const fn offset(self) -> usize {
        match self {
            Self::Xyz => 0,
            Self::Abc => 3,
            Self::Uvw => 6,
        }
    }

    pub(crate) fn dot(self, a: &Axes, b: &Axes) -> f64 {
        let i = self.offset();
        a[i] * b[i] + a[i + 1] * b[i + 1] + a[i + 2] * b[i + 2]
    }

    pub(crate) fn norm(self, a: &Axes) -> f64 {
        self.dot(a, a).sqrt()
    }
}

/// Speed in the feed metric per unit of parameter speed, where the derivative by the parameter is `first`: mm of XYZ
/// where XYZ moves, else mm of UVW, else degrees of ABC. Zero where nothing moves. The cycle may call it.
#[must_use]
pub fn feed_rate(first: &Axes) -> f64 {
    Metric::of(first).map_or(0.0, |metric| metric.norm(first))
}

//! The feed metric: the axes to which the feed word and the path length refer.

use crate::{AXES, Axes};

/// The group of axes to which the feed word refers.
///
/// RS274/NGC (NISTIR 6556, section 2.1.2.5): the length of the XYZ motion; if XYZ does not move, that of UVW
/// (EMC's extension); if UVW does not move either, ABC in degrees.
///
/// ```
/// use evolvent_path::{Axes, AxisLetter, FeedMetric};
///
/// let mut delta = Axes::zeros();
/// delta[AxisLetter::C.index()] = 90.0;
/// assert_eq!(FeedMetric::of(&delta), Some(FeedMetric::Abc));
/// delta[AxisLetter::X.index()] = 3.0;
/// delta[AxisLetter::Y.index()] = 4.0;
/// let metric = FeedMetric::of(&delta);
/// assert_eq!(metric.map(|metric| metric.norm(&delta)), Some(5.0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeedMetric {
    /// Millimetres of X, Y and Z.
    Xyz,
    /// Millimetres of U, V and W.
    Uvw,
    /// Degrees of A, B and C.
    Abc,
}

impl FeedMetric {
    /// All groups; the first one that moves applies.
    const BY_PRECEDENCE: [Self; 3] = [Self::Xyz, Self::Uvw, Self::Abc];

    /// The metric of a displacement or derivative; `None` if no axis moves. Real-time safe.
    #[must_use]
    pub fn of(delta: &Axes) -> Option<Self> {
        Self::BY_PRECEDENCE
            .into_iter()
            .find(|metric| metric.norm(delta) > 0.0)
    }

    /// The metric of a motion of these axes; `None` if there are none. Real-time safe.
    #[must_use]
    pub fn of_active(active: &[bool; AXES]) -> Option<Self> {
        Self::BY_PRECEDENCE
            .into_iter()
            .find(|metric| (0..AXES).any(|axis| active[axis] && metric.contains(axis)))
    }

    /// Index of the first axis of the group, which consists of this axis and the next two.
    #[must_use]
    pub const fn first_axis(self) -> usize {
        match self {
            Self::Xyz => 0,
            Self::Abc => 3,
            Self::Uvw => 6,
        }
    }

    /// Whether the axis with this index belongs to the group.
    #[must_use]
    pub const fn contains(self, axis: usize) -> bool {
        axis / 3 == self.first_axis() / 3
    }

    /// Scalar product over the group. Real-time safe.
    #[must_use]
    pub fn dot(self, a: &Axes, b: &Axes) -> f64 {
        let i = self.first_axis();
        a[i] * b[i] + a[i + 1] * b[i + 1] + a[i + 2] * b[i + 2]
    }

    /// Length over the group, mm or degrees. Real-time safe.
    #[must_use]
    pub fn norm(self, a: &Axes) -> f64 {
        self.dot(a, a).sqrt()
    }
}

/// A feed and the axes to which it refers.
///
/// A smoothed path deviates from its blocks: if only a rotary axis is programmed, X may still move by the
/// remainder of the previous block. The feed refers to the axes of the block in this case too.
///
/// ```
/// use evolvent_path::{Axes, AxisLetter, Feed, FeedMetric};
///
/// let mut first = Axes::zeros();
/// first[AxisLetter::X.index()] = 1e-6;
/// first[AxisLetter::A.index()] = 1.0;
/// let feed = Feed { mm_s: 5.0, metric: Some(FeedMetric::Abc) };
/// assert_eq!(feed.parameter_speed(&first), 5.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feed {
    /// Speed in the metric, mm/s or degrees/s; infinite for rapids.
    pub mm_s: f64,
    /// The metric of the block; without one, the metric of the motion itself.
    pub metric: Option<FeedMetric>,
}

impl Feed {
    /// Speed of the parameter per s at a first derivative by it. Real-time safe.
    #[must_use]
    pub fn parameter_speed(&self, first: &Axes) -> f64 {
        let rate = self
            .metric
            .map_or_else(|| feed_rate(first), |metric| metric.norm(first));
        self.mm_s / rate
    }
}

impl From<f64> for Feed {
    fn from(mm_s: f64) -> Self {
        Self { mm_s, metric: None }
    }
}

/// Speed in the feed metric per unit of parameter speed, from the first derivative by the parameter: mm of
/// XYZ where XYZ moves, else mm of UVW, else degrees of ABC. Zero if no axis moves. Real-time safe.
#[must_use]
pub fn feed_rate(first: &Axes) -> f64 {
    FeedMetric::of(first).map_or(0.0, |metric| metric.norm(first))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn xyz_takes_precedence_over_uvw_over_abc() {
        let expected = |mask: usize| match mask {
            _ if mask & 0b000_000_111 != 0 => Some(FeedMetric::Xyz),
            _ if mask & 0b111_000_000 != 0 => Some(FeedMetric::Uvw),
            _ if mask & 0b000_111_000 != 0 => Some(FeedMetric::Abc),
            _ => None,
        };
        for mask in 0..1_usize << AXES {
            let active: [bool; AXES] = std::array::from_fn(|axis| mask >> axis & 1 == 1);
            let delta = Axes::from_fn(|axis, _| if active[axis] { -0.5 } else { 0.0 });
            assert_eq!(FeedMetric::of_active(&active), expected(mask), "{mask:b}");
            assert_eq!(FeedMetric::of(&delta), expected(mask), "{mask:b}");
        }
    }

    #[test]
    fn a_group_is_three_consecutive_axes() {
        for metric in FeedMetric::BY_PRECEDENCE {
            let first = metric.first_axis();
            for axis in 0..AXES {
                assert_eq!(
                    metric.contains(axis),
                    (first..first + 3).contains(&axis),
                    "{metric:?} {axis}"
                );
                let unit = Axes::from_fn(|i, _| f64::from(u8::from(i == axis)));
                assert_eq!(
                    metric.norm(&unit) > 0.0,
                    metric.contains(axis),
                    "{metric:?} {axis}"
                );
            }
        }
    }
}

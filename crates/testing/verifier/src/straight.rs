//! A straight block.

use evolvent_path::{Axes, Curve};

use crate::measure::distance;

/// From start to end, all axes in proportion.
#[derive(Clone, Debug)]
pub(crate) struct Straight {
    start: Axes,
    along: Axes,
    length: f64,
}

impl Straight {
    pub(crate) fn of(curve: &Curve) -> Self {
        let (start, end) = (curve.start(), curve.end());
        Self {
            start,
            along: end - start,
            length: distance(&start, &end),
        }
    }

    pub(crate) fn length(&self) -> f64 {
        self.length
    }

    pub(crate) fn point(&self, u: f64) -> Axes {
        self.start + self.along * (u / self.length)
    }

    pub(crate) fn tangent(&self) -> Axes {
        self.along / self.length
    }

    /// Parameter of the point nearest to `point`, in all axes together.
    pub(crate) fn nearest(&self, point: &Axes) -> f64 {
        let square = self.along.dot(&self.along);
        (point - self.start).dot(&self.along) / square * self.length
    }
}

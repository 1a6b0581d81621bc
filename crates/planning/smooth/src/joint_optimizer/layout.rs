//! Position of the unknowns of a window in its matrix.

use evolvent_path::{AXES, FeedMetric};

use super::Window;
use super::cell::STATIONS;
use crate::newton::order;

pub(super) const NONE: usize = usize::MAX;

/// The columns of a problem with `D` axes: per interval the coefficients of the law, then its control point.
pub(super) struct Layout<const D: usize> {
    pub(super) axes: [usize; D],
    pub(super) columns: [usize; AXES],
    /// The axes of the feed metric.
    pub(super) metric: [bool; D],
    pub(super) from: usize,
    pub(super) intervals: usize,
    pub(super) free: (usize, usize),
}

impl<const D: usize> Layout<D> {
    pub(super) const GROUP: usize = D + STATIONS;
    pub(super) const BAND: usize = 4 * Self::GROUP;
    /// Columns before the first interval: its first control points and coefficients of the law.
    const PREFIX: usize = 3 * D + 2;

    pub(super) fn new(window: &Window<'_>) -> Self {
        let (mut axes, mut columns) = ([0; D], [NONE; AXES]);
        for (d, axis) in order(window.active).take(D).enumerate() {
            axes[d] = axis;
            // Padding axes are not part of the problem.
            if window.active[axis] {
                columns[axis] = d;
            }
        }
        let metric = FeedMetric::of_active(window.active).unwrap_or(FeedMetric::Xyz);
        Self {
            axes,
            columns,
            metric: axes.map(|axis| metric.contains(axis) && window.active[axis]),
            from: window.from,
            intervals: window.to - window.from,
            free: window.free,
        }
    }

    pub(super) fn size(&self) -> usize {
        Self::PREFIX + self.intervals * Self::GROUP
    }

    /// Column of a coefficient of the law.
    pub(super) fn alpha(&self, j: usize) -> usize {
        if j < 2 {
            3 * D + j
        } else {
            Self::PREFIX + (j - 2) / STATIONS * Self::GROUP + (j - 2) % STATIONS
        }
    }

    /// First column of a control point; `NONE` if it is fixed.
    pub(super) fn point(&self, j: usize) -> usize {
        if j < self.free.0 || j >= self.free.1 {
            NONE
        } else if j < self.from + 3 {
            (j - self.from) * D
        } else {
            Self::PREFIX + (j - 3 - self.from) * Self::GROUP + STATIONS
        }
    }
}

//! The known path as intervals between stations.

use std::collections::VecDeque;

use evolvent_path::{Axes, Curve, Feed};

use crate::cell::{Cell, PathSegment};
use crate::limits::PathLimits;

/// Minimum length of a segment in parameter units: shorter ones are below the rounding of a position.
const MIN_LENGTH: f64 = 1e-12;

/// A position on the known path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPosition {
    /// Absolute index of the interval.
    pub interval: u64,
    /// Parameter from the start of the interval.
    pub x: f64,
}

/// The known path: segments of curves, divided into intervals that are short where the limits change rapidly.
///
/// Indices of segments and intervals are absolute: they count from [`Grid::new`] and are never reused.
#[derive(Clone, Debug)]
pub struct Grid {
    limits: PathLimits,
    segments: VecDeque<PathSegment>,
    first_segment: u64,
    cells: VecDeque<Cell>,
    first_cell: u64,
}

impl Grid {
    /// An empty path for axes with these limits.
    #[must_use]
    pub fn new(limits: &PathLimits) -> Self {
        Self {
            limits: limits.clone(),
            segments: VecDeque::with_capacity(1024),
            first_segment: 0,
            cells: VecDeque::with_capacity(4096),
            first_cell: 0,
        }
    }

    /// Appends a segment: `curve` over `from..from + length` of its regular parameter, at `feed`.
    ///
    /// A segment shorter than rounding, or of a NaN length, has no interval. A feed that is not a positive
    /// number is raised to 1e-6. Not real-time safe.
    pub fn push(&mut self, curve: &Curve, from: f64, length: f64, feed: impl Into<Feed>) {
        let index = self.first_segment + self.segments.len() as u64;
        let feed = feed.into();
        let feed = Feed {
            mm_s: feed.mm_s.max(1e-6),
            ..feed
        };
        let segment = PathSegment {
            curve: *curve,
            from,
            feed,
        };
        if from.is_finite() && length.is_finite() && length > MIN_LENGTH {
            for (x, width) in segment.intervals(length) {
                self.cells
                    .push_back(Cell::new(&segment, index, x, width, &self.limits));
            }
        }
        self.segments.push_back(segment);
    }

    /// Limits the speed of the parameter at the present end of the path, per s, at any feed factor.
    pub fn cap(&mut self, speed_u_s: f64) {
        if let Some(cell) = self.cells.back_mut() {
            cell.joint = cell.joint.min(speed_u_s.max(1e-6));
        }
    }

    /// The end of the path: the absolute index of the next interval.
    #[must_use]
    pub fn end(&self) -> u64 {
        self.first_cell + self.cells.len() as u64
    }

    /// The first interval that is still known.
    #[must_use]
    pub fn first(&self) -> u64 {
        self.first_cell
    }

    /// The segment of an interval, and the offset of the interval's start from the segment's.
    #[must_use]
    pub fn segment_of(&self, interval: u64) -> Option<(u64, f64)> {
        self.cell(interval).map(|cell| (cell.segment, cell.from))
    }

    /// Length of an interval in parameter units.
    #[must_use]
    pub fn interval_length(&self, interval: u64) -> Option<f64> {
        self.cell(interval).map(|cell| cell.length)
    }

    /// Positions of all axes at an offset from the start of a segment.
    #[must_use]
    pub fn position(&self, segment: u64, offset: f64) -> Option<Axes> {
        let segment = self.segment(segment)?;
        Some(segment.curve.position(segment.from + offset))
    }

    /// Drops everything before `interval`.
    pub fn release(&mut self, interval: u64) {
        while self.first_cell < interval && !self.cells.is_empty() {
            self.cells.pop_front();
            self.first_cell += 1;
        }
        if let Some(cell) = self.cells.front() {
            let needed = cell.segment;
            while self.first_segment < needed {
                self.segments.pop_front();
                self.first_segment += 1;
            }
        }
    }

    pub(crate) fn cell(&self, interval: u64) -> Option<&Cell> {
        let index = interval.checked_sub(self.first_cell)?;
        self.cells.get(usize::try_from(index).ok()?)
    }

    pub(crate) fn segment(&self, index: u64) -> Option<&PathSegment> {
        let index = index.checked_sub(self.first_segment)?;
        self.segments.get(usize::try_from(index).ok()?)
    }

    pub(crate) fn limits(&self) -> &PathLimits {
        &self.limits
    }
}

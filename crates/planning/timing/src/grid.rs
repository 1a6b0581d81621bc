//! The known path as intervals between stations.

use std::collections::VecDeque;

use evolvent_path::{Axes, Curve};

use crate::cell::{Cell, Stretch};
use crate::limits::PathLimits;

/// Below this length in parameter units a stretch is passed over: it is less than the rounding of a position.
const SHORTEST: f64 = 1e-12;

/// A place on the known path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Absolute index of the interval.
    pub interval: u64,
    /// Parameter since the interval's start.
    pub x: f64,
}

/// The known path: stretches of curves, cut into intervals that are short where the limits change quickly.
///
/// Indices of stretches and of intervals are absolute: they count from [`Grid::new`] and are never reused.
#[derive(Clone, Debug)]
pub struct Grid {
    limits: PathLimits,
    stretches: VecDeque<Stretch>,
    first_stretch: u64,
    cells: VecDeque<Cell>,
    first_cell: u64,
}

impl Grid {
    /// An empty path for axes with these limits.
    #[must_use]
    pub fn new(limits: &PathLimits) -> Self {
        Self {
            limits: limits.clone(),
            stretches: VecDeque::with_capacity(1024),
            first_stretch: 0,
            cells: VecDeque::with_capacity(4096),
            first_cell: 0,
        }
    }

    /// Adds a stretch: `curve` over `from..from + length` of its regular parameter, at `feed` in the feed metric
    /// per second (infinite for rapids).
    ///
    /// A stretch that is shorter than rounding, or not a number, counts as a stretch without an interval. A feed
    /// that is not a positive number is taken as a crawl. Cycle: no.
    pub fn push(&mut self, curve: &Curve, from: f64, length: f64, feed: f64) {
        let index = self.first_stretch + self.stretches.len() as u64;
        let feed = feed.max(1e-6);
        let stretch = Stretch {
            curve: *curve,
            from,
            feed,
        };
        if from.is_finite() && length.is_finite() && length > SHORTEST {
            for (x, width) in stretch.cuts(length) {
                self.cells
                    .push_back(Cell::new(&stretch, index, x, width, &self.limits));
            }
        }
        self.stretches.push_back(stretch);
    }

    /// Bounds the speed of the parameter at the present end of the path, per s, whatever the feed factor.
    pub fn cap(&mut self, speed: f64) {
        if let Some(cell) = self.cells.back_mut() {
            cell.joint = cell.joint.min(speed.max(1e-6));
        }
    }

    /// Intervals so far: the absolute index that the next one will have.
    #[must_use]
    pub fn end(&self) -> u64 {
        self.first_cell + self.cells.len() as u64
    }

    /// The first interval that is still known.
    #[must_use]
    pub fn first(&self) -> u64 {
        self.first_cell
    }

    /// The stretch an interval lies in, and the offset of the interval's start from the stretch's.
    #[must_use]
    pub fn stretch_of(&self, interval: u64) -> Option<(u64, f64)> {
        self.cell(interval).map(|cell| (cell.stretch, cell.from))
    }

    /// Length of an interval in parameter units.
    #[must_use]
    pub fn interval_length(&self, interval: u64) -> Option<f64> {
        self.cell(interval).map(|cell| cell.length)
    }

    /// Positions of all axes at an offset from a stretch's start.
    #[must_use]
    pub fn position(&self, stretch: u64, offset: f64) -> Option<Axes> {
        let stretch = self.stretch(stretch)?;
        Some(stretch.curve.position(stretch.from + offset))
    }

    /// Forgets everything before `interval`.
    pub fn release(&mut self, interval: u64) {
        while self.first_cell < interval && !self.cells.is_empty() {
            self.cells.pop_front();
            self.first_cell += 1;
        }
        if let Some(cell) = self.cells.front() {
            let needed = cell.stretch;
            while self.first_stretch < needed {
                self.stretches.pop_front();
                self.first_stretch += 1;
            }
        }
    }

    pub(crate) fn cell(&self, interval: u64) -> Option<&Cell> {
        let index = interval.checked_sub(self.first_cell)?;
        self.cells.get(usize::try_from(index).ok()?)
    }

    pub(crate) fn stretch(&self, index: u64) -> Option<&Stretch> {
        let index = index.checked_sub(self.first_stretch)?;
        self.stretches.get(usize::try_from(index).ok()?)
    }

    pub(crate) fn limits(&self) -> &PathLimits {
        &self.limits
    }
}

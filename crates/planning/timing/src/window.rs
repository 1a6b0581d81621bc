//! The stations of one window with their constraints, packed for the solver.

use evolvent_path::AXES;
use wide::f64x2;

use crate::cell::{Cell, Point};
use crate::grid::Grid;
use crate::limits::PathLimits;
use crate::stub::Stub;

/// Fraction of the acceleration limit used for planning; the rest is for excesses between the stations.
const ACCELERATION_MARGIN: f64 = 0.9997;
/// The same for jerk.
const JERK_MARGIN: f64 = 0.997;
/// The same for speed.
const SPEED_MARGIN: f64 = 0.9999;
/// Exceeds every real speed.
pub(crate) const UNLIMITED: f64 = 1e9;

/// A part of a grid interval between two stations of the window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Span {
    /// Absolute index of the grid interval.
    pub(crate) interval: u64,
    /// Offset from the start of the interval.
    pub(crate) x: f64,
    pub(crate) length: f64,
}

/// Stations `0..=n` and the intervals between them; at an end at rest there is a stub in addition.
#[derive(Clone, Debug, Default)]
pub(crate) struct Window {
    /// All spans, including stubs.
    pub(crate) spans: Vec<Span>,
    pub(crate) cells: Vec<Cell>,
    /// Whether the first span is a stub; the last one always is.
    pub(crate) from_rest: bool,
    /// The axes that move, and their number.
    pub(crate) active: [usize; AXES],
    pub(crate) count: usize,
    pub(crate) inverse_a: [f64; AXES],
    pub(crate) inverse_j: [f64; AXES],
    /// Lengths of the `n` intervals.
    pub(crate) d: Vec<f64>,
    /// Per pair of neighbouring intervals and moving axis: point (start, middle, end) and derivative (first,
    /// second, third), one number for each of the two intervals. With an odd number of intervals the last one
    /// fills both places.
    pub(crate) rows: Vec<f64x2>,
    /// Caps of `u'^2` at the stations and in the middle of the intervals.
    pub(crate) cap: Vec<f64>,
    pub(crate) middle_cap: Vec<f64>,
    /// 1 for intervals with constraints in the middle, 0 where second and third derivatives vanish.
    pub(crate) curved: Vec<f64>,
    /// 1 where the derivatives step at the end, so that both sides have acceleration constraints; otherwise
    /// 0.
    pub(crate) joints: Vec<f64>,
    /// Factors on the acceleration and jerk constraints of each interval, below 1 where a start needs a
    /// margin.
    pub(crate) relaxation: Vec<(f64, f64)>,
    /// Whether caps were raised for a start above them.
    pub(crate) lifted: bool,
    pub(crate) start: Stub,
    pub(crate) end: Stub,
}

impl Window {
    pub(crate) fn with_capacity(stations: usize) -> Self {
        Self {
            spans: Vec::with_capacity(stations + 2),
            cells: Vec::with_capacity(stations + 2),
            d: Vec::with_capacity(stations),
            rows: Vec::with_capacity((stations / 2 + 1) * 9 * AXES),
            cap: Vec::with_capacity(stations + 1),
            middle_cap: Vec::with_capacity(stations),
            curved: Vec::with_capacity(stations),
            joints: Vec::with_capacity(stations),
            relaxation: Vec::with_capacity(stations),
            ..Self::default()
        }
    }

    /// Number of intervals between stations.
    pub(crate) fn n(&self) -> usize {
        self.d.len()
    }

    /// The cap of the middle Bernstein coefficient of `u'^2` on interval `k`.
    pub(crate) fn control_cap(&self, k: usize) -> f64 {
        self.middle_cap[k].max(self.cap[k]).max(self.cap[k + 1])
    }

    /// Index of the span of interval `k`.
    pub(crate) fn span_index(&self, k: usize) -> usize {
        k + usize::from(self.from_rest)
    }

    /// Fills `cells` for `spans`. False if the grid does not contain a span.
    pub(crate) fn fetch(&mut self, grid: &Grid) -> bool {
        self.cells.clear();
        for span in &self.spans {
            let Some(cell) = grid.cell(span.interval) else {
                return false;
            };
            if span.x == 0.0 && span.length == cell.length {
                self.cells.push(*cell);
                continue;
            }
            let Some(segment) = grid.segment(cell.segment) else {
                return false;
            };
            let ends = span.x + span.length >= cell.length * (1.0 - 1e-12);
            let mut part = Cell::new(
                segment,
                cell.segment,
                cell.from + span.x,
                span.length,
                grid.limits(),
            );
            part.joint = if ends { cell.joint } else { f64::INFINITY };
            self.cells.push(part);
        }
        true
    }

    /// Packs the constraints of all spans; the last stub may use `end_jerk_fraction` of the jerk limit.
    pub(crate) fn pack(&mut self, limits: &PathLimits, factor: f64, end_jerk_fraction: f64) {
        let axes = limits.axes();
        self.count = 0;
        for i in 0..AXES {
            let moves = self.cells.iter().any(|cell| {
                cell.points
                    .iter()
                    .any(|p| p.first[i] != 0.0 || p.second[i] != 0.0 || p.third[i] != 0.0)
            });
            if axes.present[i] && moves {
                self.active[self.count] = i;
                self.inverse_a[self.count] = 1.0 / (ACCELERATION_MARGIN * axes.acceleration[i]);
                self.inverse_j[self.count] = 1.0 / (JERK_MARGIN * axes.jerk[i]);
                self.count += 1;
            }
        }
        let lead = usize::from(self.from_rest);
        let last = self.cells.len() - 1;
        self.d.clear();
        self.rows.clear();
        self.cap.clear();
        self.middle_cap.clear();
        self.curved.clear();
        self.joints.clear();
        for k in lead..last {
            let cell = &self.cells[k];
            self.d.push(cell.length);
            if (k - lead).is_multiple_of(2) {
                let other = if k + 1 < last { &self.cells[k + 1] } else { cell };
                for axis in &self.active[..self.count] {
                    for (one, two) in cell.points.iter().zip(&other.points) {
                        self.rows.extend([
                            f64x2::new([one.first[*axis], two.first[*axis]]),
                            f64x2::new([one.second[*axis], two.second[*axis]]),
                            f64x2::new([one.third[*axis], two.third[*axis]]),
                        ]);
                    }
                }
            }
            self.middle_cap.push(square(cell.points[1].cap(factor)));
            let next = &self.cells[k + 1];
            let straight = cell
                .points
                .iter()
                .all(|p| p.second == p.third && p.third.amax() == 0.0);
            let joint = next.segment != cell.segment;
            self.curved.push(if straight { 0.0 } else { 1.0 });
            self.joints.push(if joint { 1.0 } else { 0.0 });
        }
        for k in lead..=last {
            let mut speed = self.cells[k].points[0].cap(factor);
            if k > 0 {
                let before = &self.cells[k - 1];
                speed = speed.min(before.points[2].cap(factor)).min(before.joint);
            }
            self.cap.push(square(speed));
        }
        self.lifted = false;
        self.relaxation.clear();
        self.relaxation.resize(self.d.len(), (1.0, 1.0));
        self.start = if self.from_rest {
            Stub::new(&self.cells[0], limits, factor, JERK_MARGIN, false)
        } else {
            Stub::default()
        };
        self.end = Stub::new(
            &self.cells[last],
            limits,
            factor,
            JERK_MARGIN * end_jerk_fraction,
            true,
        );
    }

    /// The maximum `u'^2` at which interval `k` may be passed at constant speed.
    pub(crate) fn steady(&self, k: usize, limits: &PathLimits) -> f64 {
        let cell = &self.cells[self.span_index(k)];
        let mut max = self.middle_cap[k].min(self.cap[k]).min(self.cap[k + 1]);
        for point in &cell.points {
            max = max.min(steady(point, limits));
        }
        max
    }
}

/// The maximum `u'^2` of a constant parameter speed at a point, by acceleration and jerk of the axes.
pub(crate) fn steady(point: &Point, limits: &PathLimits) -> f64 {
    let axes = limits.axes();
    let mut max = UNLIMITED * UNLIMITED;
    for i in 0..AXES {
        if axes.present[i] {
            let speed = libm::cbrt(axes.jerk[i] / point.third[i].abs());
            max = max
                .min(axes.acceleration[i] / point.second[i].abs())
                .min(speed * speed);
        }
    }
    max
}

fn square(speed: f64) -> f64 {
    let speed = SPEED_MARGIN * speed.min(UNLIMITED);
    speed * speed
}

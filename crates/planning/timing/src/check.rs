//! Checks a plan between its stations.

use evolvent_path::AXES;

use crate::barrier::Iterate;
use crate::cell::Point;
use crate::grid::Grid;
use crate::limits::PathLimits;
use crate::piece::Ratios;
use crate::window::Window;

/// Fractions of an interval at which the limits are checked, between the constraints at its start, middle and
/// end.
const CHECK_FRACTIONS: [f64; 4] = [0.15, 0.35, 0.65, 0.85];
/// Additional ones for intervals of at least [`EXTRA_CHECK_MIN_S`], on which the path changes much: the
/// minimum of the speed that a curve permits may be between the others.
const EXTRA_CHECK_FRACTIONS: [f64; 8] = [0.05, 0.25, 0.45, 0.5, 0.55, 0.75, 0.92, 0.97];
const EXTRA_CHECK_MIN_S: f64 = 0.005;
/// The fractions, with start and end, at which accelerations are interpolated to find their peaks.
const TRACK: [f64; 6] = [0.0, 0.15, 0.35, 0.65, 0.85, 1.0];
/// Ratios above which the constraint weight of an interval is raised: of velocity and acceleration, and of
/// jerk.
const TARGET_RATIO: (f64, f64) = (1.0005, 1.005);
/// Ratios accepted when no steps are left to reduce them, below what the guard of the cycle tolerates.
const MAX_RATIO: (f64, f64) = (1.0008, 1.012);
/// Ratio of acceleration from which its peak between the fractions is computed.
const PEAK_SEARCH_RATIO: f64 = 0.98;
/// Factor by which a constraint weight is raised.
pub(crate) const WEIGHT_FACTOR: f64 = 5.0;

impl Ratios {
    /// The ratios of a state at a point of the path; the feed counts as a velocity.
    pub(crate) fn at(point: &Point, state: (f64, f64, f64), limits: &PathLimits, factor: f64) -> Self {
        let (a, b, c) = state;
        let axes = limits.axes();
        let speed = a.max(0.0).sqrt();
        let mut out = Self {
            velocity: speed / point.cap(factor),
            ..Self::default()
        };
        for i in 0..AXES {
            if axes.present[i] {
                let (d1, d2, d3) = (point.first[i], point.second[i], point.third[i]);
                out.acceleration = out
                    .acceleration
                    .max((d2 * a + d1 * b).abs() / axes.acceleration[i]);
                out.jerk = out
                    .jerk
                    .max((speed * (d3 * a + 3.0 * d2 * b + d1 * c)).abs() / axes.jerk[i]);
            }
        }
        out
    }

    pub(crate) fn include(&mut self, other: &Self) {
        self.velocity = self.velocity.max(other.velocity);
        self.acceleration = self.acceleration.max(other.acceleration);
        self.jerk = self.jerk.max(other.jerk);
    }
}

/// The acceleration of each axis at [`TRACK`], relative to its limit.
struct Track([[f64; TRACK.len()]; AXES]);

impl Track {
    fn new() -> Self {
        Self([[0.0; TRACK.len()]; AXES])
    }

    fn set(&mut self, k: usize, point: &Point, (a, b): (f64, f64), limits: &PathLimits) {
        let axes = limits.axes();
        for i in (0..AXES).filter(|&i| axes.present[i]) {
            self.0[i][k] = (point.second[i] * a + point.first[i] * b) / axes.acceleration[i];
        }
    }

    /// The maximum between the samples, by the parabola through each three of them.
    fn peak(&self) -> f64 {
        let mut max = 0.0_f64;
        for y in &self.0 {
            for (x, y) in TRACK.windows(3).zip(y.windows(3)) {
                let first = (y[1] - y[0]) / (x[1] - x[0]);
                let second = ((y[2] - y[1]) / (x[2] - x[1]) - first) / (x[2] - x[0]);
                let top = 0.5 * (x[0] + x[1]) - 0.5 * first / second;
                if x[0] < top && top < x[2] {
                    let height = y[0] + (top - x[0]) * (first + second * (top - x[1]));
                    max = max.max(height.abs());
                }
            }
        }
        max
    }
}

/// Result of a check between stations.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Checked {
    /// The maximum ratios.
    pub(crate) worst: Ratios,
    /// Whether some constraint weights were raised.
    pub(crate) weights_raised: bool,
    /// Whether some ratios exceed what may be executed.
    pub(crate) violated: bool,
}

/// The maximum ratios between stations; raises the constraint weights where they are too large.
pub(crate) fn check(
    window: &Window,
    grid: &Grid,
    factor: f64,
    x: &Iterate,
    constraint_weight: &mut [f64],
) -> Checked {
    let limits = grid.limits();
    let mut out = Checked::default();
    for k in 0..window.n() {
        let cell = &window.cells[window.span_index(k)];
        let (d, a, b, c) = (window.d[k], x.a[k], x.b[k], x.c[k]);
        let mut here = Ratios::default();
        // The state at a moving start is fixed.
        let begin = if k == 0 && !window.from_rest { a } else { 0.0 };
        let cap = window.control_cap(k).max(begin);
        // The speed has a maximum inside if its slope changes sign.
        let peak = if b > 0.0 && b + c * d < 0.0 {
            a - b * b / c
        } else {
            a
        };
        let mut fast = peak > cap * TARGET_RATIO.0;
        let mut track = Track::new();
        for (i, fraction) in CHECK_FRACTIONS.into_iter().enumerate() {
            let at = fraction * d;
            let state = (a + at * (2.0 * b + at * c), b + at * c, c);
            fast |= state.0 > cap * TARGET_RATIO.0 * TARGET_RATIO.0;
            if window.curved[k] == 0.0 {
                here.include(&Ratios::at(&cell.points[1], state, limits, factor));
            } else if let Some(segment) = grid.segment(cell.segment) {
                let point = Point::of(segment, cell.from + at, limits);
                here.include(&Ratios::at(&point, state, limits, factor));
                track.set(i + 1, &point, (state.0, state.1), limits);
            }
        }
        if window.curved[k] != 0.0
            && d > EXTRA_CHECK_MIN_S * a.max(x.a[k + 1]).max(0.0).sqrt()
            && let Some(segment) = grid.segment(cell.segment)
        {
            for fraction in EXTRA_CHECK_FRACTIONS {
                let at = fraction * d;
                let state = (a + at * (2.0 * b + at * c), b + at * c, c);
                let point = Point::of(segment, cell.from + at, limits);
                here.include(&Ratios::at(&point, state, limits, factor));
            }
        }
        if window.curved[k] != 0.0 && here.acceleration > PEAK_SEARCH_RATIO {
            track.set(0, &cell.points[0], (a, b), limits);
            track.set(5, &cell.points[2], (x.a[k + 1], x.b[k + 1]), limits);
            here.acceleration = here.acceleration.max(track.peak());
        }
        // While it still decelerates to the caps of the path, the motion may be above them.
        let path_cap = (cell.points.iter().map(|point| point.cap(factor))).fold(0.0, f64::max);
        let lifted = window.lifted && cap > path_cap * path_cap;
        let fast = fast || (here.velocity > TARGET_RATIO.0 && !lifted);
        if fast || here.acceleration > TARGET_RATIO.0 || here.jerk > TARGET_RATIO.1 {
            constraint_weight[k] *= WEIGHT_FACTOR;
            out.weights_raised = true;
        }
        let speed = if lifted { 0.0 } else { here.velocity };
        // NaN counts as violated.
        out.violated |= !(speed.max(here.acceleration) <= MAX_RATIO.0 && here.jerk <= MAX_RATIO.1);
        out.worst.include(&here);
    }
    out
}

//! The first and last section of a motion from rest to rest.

use evolvent_path::AXES;

use crate::cell::{Cell, Point};
use crate::limits::PathLimits;

/// Constant jerk `j` over the length `x` from rest, or to rest, where `c = u'''/u'` is unbounded.
///
/// With `x = j t^3/6` the motion at the far end has `v = j t^2/2`, `b = j t`, so `v b = 3 j x` and
/// `v^2 = 3/2 x b`: a line in the plane of `(a, b)` along which the solver may choose. An axis has the jerk
/// `j (q' + 9 q'' x + 9/2 q''' x^2)`, the acceleration `j^(2/3) ((6 x)^(1/3) q' + (6 x)^(4/3)/4 q'')` and the
/// velocity `j^(1/3) (6 x)^(2/3)/2 q'`. A motion to rest is the same reversed in time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Stub {
    /// Length; zero if there is none.
    pub(crate) length: f64,
    /// Maximum `b` at the far end.
    pub(crate) max_b: f64,
}

impl Stub {
    /// The stub over a whole interval, at its end if `reverse`, with a fraction of the jerk limits.
    pub(crate) fn new(cell: &Cell, limits: &PathLimits, factor: f64, fraction: f64, reverse: bool) -> Self {
        let mut jerk = f64::INFINITY;
        for (k, point) in cell.points.iter().enumerate() {
            let part = 0.5 * k as f64;
            let x = cell.length * if reverse { 1.0 - part } else { part };
            jerk = jerk.min(max_jerk(point, x, limits, factor, fraction, reverse));
        }
        let root = libm::cbrt(jerk);
        Self {
            length: cell.length,
            max_b: root * root * libm::cbrt(6.0 * cell.length),
        }
    }
}

/// The maximum constant jerk from rest at which a point at distance `x` keeps all limits.
pub(crate) fn max_jerk(
    point: &Point,
    x: f64,
    limits: &PathLimits,
    factor: f64,
    fraction: f64,
    reverse: bool,
) -> f64 {
    let axes = limits.axes();
    // A gentle stub leaves a margin in acceleration too, for a motion that continues from inside it.
    let push = if fraction < 0.5 { 0.8 } else { 1.0 };
    let sign = if reverse { -1.0 } else { 1.0 };
    let root = libm::cbrt(6.0 * x);
    let mut max: f64 = 1e30;
    for i in 0..AXES {
        if axes.present[i] {
            let (d1, d2, d3) = (point.first[i], sign * point.second[i], point.third[i]);
            max = max.min(fraction * axes.jerk[i] / (d1 + x * (9.0 * d2 + 4.5 * x * d3)).abs());
            let bound = push * axes.acceleration[i] / (root * (d1 + 1.5 * x * d2)).abs();
            max = max.min(0.99 * bound * bound.sqrt());
        }
    }
    if x > 0.0 {
        // v = j^(1/3) (6 x)^(2/3) / 2
        let bound = 0.99 * 2.0 * point.cap(factor) / (root * root);
        max = max.min(bound * bound * bound);
    }
    max
}

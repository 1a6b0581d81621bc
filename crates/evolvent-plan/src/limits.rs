//! From the limits of the axes to limits along the path.
//!
//! With the path parameter `u`, `v = u'`, `b = u''`, `c = u'''`, axis `i` sees
//!
//! ```text
//! velocity      q'_i v
//! acceleration  q''_i v^2 + q'_i b
//! jerk          q'''_i v^3 + 3 q''_i v b + q'_i c
//! ```
//!
//! so constants for `v`, `b` and `c` follow once it is settled how much of the acceleration and of the jerk the
//! curvature may use. Speed is what a path is slow for, so curvature gets most; what is left must suffice to
//! speed up, slow down and hold anywhere.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, Curve};

use crate::ScalarLimits;

/// Share of the acceleration limit that curvature may use.
const ACCELERATION_SHARE: f64 = 0.8;
/// Share of the jerk limit that curvature and its derivative may use.
const JERK_SHARE: f64 = 0.7;
/// Share of what jerk is left that the product of speed, acceleration and curvature may use.
const CROSS_SHARE: f64 = 0.5;
/// Third differences of doubles are noisy at high rates: plan a little below the limit.
const JERK_MARGIN: f64 = 0.99;
/// Largest turn of the tangent over which one set of derivative bounds is taken, rad.
const CELL_ANGLE: f64 = 0.3;
/// Most cells of one stretch. More than a turn only repeats the same directions.
const MOST_CELLS: f64 = 24.0;
/// Above every meaningful speed, so that a path that moves no limited axis has finite limits.
const UNLIMITED: f64 = 1e9;

/// Upper bounds of the derivatives of every axis over a stretch of path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DerivativeBounds {
    /// First derivatives.
    pub first: Axes,
    /// Second derivatives.
    pub second: Axes,
    /// Third derivatives.
    pub third: Axes,
}

/// Everything that limits speed along a path but the feed word.
#[derive(Clone, Debug)]
pub struct PathLimits {
    axes: Limits,
    rate_hz: f64,
    chord_error_mm: f64,
}

impl PathLimits {
    /// For the axes' limits, the control rate, and the chord error permitted at that rate in mm.
    #[must_use]
    pub fn new(axes: Limits, rate_hz: f64, chord_error_mm: f64) -> Self {
        Self {
            axes,
            rate_hz,
            chord_error_mm,
        }
    }

    /// The axes' limits.
    #[must_use]
    pub fn axes(&self) -> &Limits {
        &self.axes
    }

    /// The highest parameter speed on a stretch with these bounds.
    #[must_use]
    pub fn speed(&self, bounds: &DerivativeBounds) -> f64 {
        let mut speed = UNLIMITED;
        for i in 0..AXES {
            if self.axes.present[i] {
                let (d1, d2, d3) = (bounds.first[i], bounds.second[i], bounds.third[i]);
                speed = speed
                    .min(self.axes.velocity[i] / d1)
                    .min((ACCELERATION_SHARE * self.axes.acceleration[i] / d2).sqrt())
                    .min(libm::cbrt(JERK_SHARE * JERK_MARGIN * self.axes.jerk[i] / d3));
            }
        }
        speed.min(self.chord_speed(bounds))
    }

    /// Equation (4) of Kombarov and Sorokin turned round: `v <= 2 f sqrt(e (2 R - e))`. The largest second
    /// derivative stands for `1/R`, which is exact where the parameter is arc length and otherwise bounds the
    /// distance from the chord as well (`|q''| (v/f)^2 / 8`). Below `R = e` the root would fall again, although
    /// a chord cannot miss by more than the radius: the value at `R = e` goes on as `sqrt(R)`.
    fn chord_speed(&self, bounds: &DerivativeBounds) -> f64 {
        let bend = xyz(&bounds.second);
        if bend <= 0.0 {
            return UNLIMITED;
        }
        let (e, radius) = (self.chord_error_mm, 1.0 / bend);
        2.0 * self.rate_hz * (e * (2.0 * radius - e).max(radius)).sqrt()
    }

    /// Limits of acceleration and jerk along the parameter on a stretch that is never faster than `speed`.
    #[must_use]
    pub fn tangential(&self, bounds: &DerivativeBounds, speed: f64) -> (f64, f64) {
        let (mut acceleration, mut jerk) = (UNLIMITED, UNLIMITED * 1e3);
        let mut left = [0.0; AXES];
        for i in 0..AXES {
            if self.axes.present[i] {
                let (d1, d2, d3) = (bounds.first[i], bounds.second[i], bounds.third[i]);
                left[i] = (JERK_MARGIN * self.axes.jerk[i] - d3 * speed * speed * speed).max(0.0);
                if d1 > 0.0 {
                    acceleration = acceleration.min((self.axes.acceleration[i] - d2 * speed * speed) / d1);
                }
                if d2 * speed > 0.0 {
                    acceleration = acceleration.min(CROSS_SHARE * left[i] / (3.0 * d2 * speed));
                }
            }
        }
        for i in 0..AXES {
            if self.axes.present[i] && bounds.first[i] > 0.0 {
                let cross = 3.0 * bounds.second[i] * speed * acceleration;
                jerk = jerk.min((left[i] - cross) / bounds.first[i]);
            }
        }
        (acceleration, jerk)
    }

    /// Scalar limits that hold on every one of `cells` up to `velocity`, which every cell allows.
    #[must_use]
    pub fn over(&self, cells: &[DerivativeBounds], velocity: f64) -> ScalarLimits {
        let velocity = velocity.min(UNLIMITED);
        let (acceleration, jerk) = cells
            .iter()
            .map(|cell| self.tangential(cell, velocity))
            .fold((UNLIMITED, UNLIMITED * 1e3), |least, one| {
                (least.0.min(one.0), least.1.min(one.1))
            });
        ScalarLimits {
            velocity,
            acceleration,
            jerk,
        }
    }
}

/// Appends the derivative bounds of `curve` over `from..to`, in cells short enough for the direction of the
/// tangent to be the same within [`CELL_ANGLE`].
pub(crate) fn append_cells(curve: &Curve, from: f64, to: f64, cells: &mut Vec<DerivativeBounds>) {
    let whole = curve.derivative_bounds(from, to);
    let angle = xyz(&whole.1) * (to - from);
    let count = (angle / CELL_ANGLE).ceil().clamp(1.0, MOST_CELLS);
    if count <= 1.0 {
        let (first, second, third) = whole;
        cells.push(DerivativeBounds { first, second, third });
        return;
    }
    let width = (to - from) / count;
    let mut at = from;
    for k in 1..=count as u32 {
        let next = if f64::from(k) >= count {
            to
        } else {
            from + width * f64::from(k)
        };
        let (first, second, third) = curve.derivative_bounds(at, next);
        cells.push(DerivativeBounds { first, second, third });
        at = next;
    }
}

fn xyz(v: &Axes) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

//! Converts the limits of the axes to limits along the path.
//!
//! With the path parameter `u`, `v = u'`, `b = u''`, `c = u'''`, axis `i` sees
//!
//! ```text
//! velocity      q'_i v
//! acceleration  q''_i v^2 + q'_i b
//! jerk          q'''_i v^3 + 3 q''_i v b + q'_i c
//! ```
//!
//! so constants for `v`, `b` and `c` follow from a decision on the fraction of acceleration and jerk that the
//! curvature may use. Curvature gets most of it, because that determines the speed; the remainder must
//! suffice to accelerate, decelerate and hold anywhere.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, Curve};

use crate::ScalarLimits;

/// Fraction of the acceleration limit for the curvature. Tuned: see the classic planner in
/// docs/benchmarks.md.
const ACCELERATION_FRACTION: f64 = 0.8;
/// Fraction of the jerk limit for the curvature and its derivative.
const JERK_FRACTION: f64 = 0.7;
/// Fraction of the remaining jerk for the product of speed, acceleration and curvature.
const CROSS_FRACTION: f64 = 0.5;
/// Margin for the third differences of doubles, which are noisy at high rates.
const JERK_MARGIN: f64 = 0.99;
/// Maximum rotation of the tangent over one set of derivative bounds, rad.
const CELL_ANGLE: f64 = 0.3;
/// Maximum number of cells of one segment. More than one revolution repeats the same directions.
const MAX_CELLS: f64 = 24.0;
/// Exceeds every real speed, so that a path without limited axes has finite limits.
const UNLIMITED: f64 = 1e9;

/// Upper bounds of the derivatives of every axis over a part of the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DerivativeBounds {
    /// First derivatives.
    pub first: Axes,
    /// Second derivatives.
    pub second: Axes,
    /// Third derivatives.
    pub third: Axes,
}

/// All limits of the speed along a path except the feed word.
#[derive(Clone, Debug)]
pub struct PathLimits {
    axes: Limits,
    rate_hz: f64,
    chord_error_mm: f64,
}

impl PathLimits {
    /// From the axis limits, the control rate, and the chord error in mm permitted at that rate.
    #[must_use]
    pub fn new(axes: Limits, rate_hz: f64, chord_error_mm: f64) -> Self {
        Self {
            axes,
            rate_hz,
            chord_error_mm,
        }
    }

    /// The same with a fraction of the permitted chord error. [`chord_speed`](Self::chord_speed) assumes
    /// constant curvature, but at a low rate the curvature changes within one period.
    #[must_use]
    pub fn with_chord_fraction(&self, fraction: f64) -> Self {
        Self {
            chord_error_mm: fraction * self.chord_error_mm,
            ..self.clone()
        }
    }

    /// The axis limits.
    #[must_use]
    pub fn axes(&self) -> &Limits {
        &self.axes
    }

    /// The maximum parameter speed over a part of the path with these bounds.
    #[must_use]
    pub fn speed(&self, bounds: &DerivativeBounds) -> f64 {
        let mut speed = UNLIMITED;
        for i in 0..AXES {
            if self.axes.present[i] {
                let (d1, d2, d3) = (bounds.first[i], bounds.second[i], bounds.third[i]);
                speed = speed
                    .min(self.axes.velocity[i] / d1)
                    .min((ACCELERATION_FRACTION * self.axes.acceleration[i] / d2).sqrt())
                    .min(libm::cbrt(JERK_FRACTION * JERK_MARGIN * self.axes.jerk[i] / d3));
            }
        }
        speed.min(self.chord_speed(&bounds.second))
    }

    /// The maximum parameter speed at which the chord of one period deviates from the path by at most the
    /// permitted error, for the second derivatives `second`.
    ///
    /// Equation (4) of Kombarov and Sorokin solved for the speed: `v <= 2 f sqrt(e (2 R - e))`. The largest
    /// second derivative replaces `1/R`. That is exact if the parameter is arc length, and otherwise also an
    /// upper bound of the distance from the chord (`|q''| (v/f)^2 / 8`). Below `R = e` the root would
    /// decrease again, although a chord cannot deviate by more than the radius; there the value at `R = e` is
    /// continued as `sqrt(R)`.
    ///
    /// ```
    /// use evolvent_machine::Limits;
    /// use evolvent_path::{AXES, Axes};
    /// use evolvent_timing::PathLimits;
    ///
    /// # let axes = Limits {
    /// #     present: [true; AXES],
    /// #     velocity: Axes::repeat(500.0),
    /// #     acceleration: Axes::repeat(5000.0),
    /// #     jerk: Axes::repeat(1e5),
    /// #     travel_min: Axes::repeat(-1e3),
    /// #     travel_max: Axes::repeat(1e3),
    /// #     home: Axes::zeros(),
    /// # };
    /// // A circle of 10 mm radius at 1 kHz, to a micrometre: the sagitta of the chord of one period.
    /// let mut second = Axes::zeros();
    /// second[1] = 1.0 / 10.0;
    /// let speed = PathLimits::new(axes, 1000.0, 0.001).chord_speed(&second);
    /// let half_angle = speed / 1000.0 / 10.0 / 2.0;
    /// assert!((10.0 * (1.0 - f64::cos(half_angle)) - 0.001).abs() < 1e-7);
    /// ```
    #[must_use]
    pub fn chord_speed(&self, second: &Axes) -> f64 {
        let bend = xyz(second);
        if bend <= 0.0 {
            return UNLIMITED;
        }
        let (e, radius) = (self.chord_error_mm, 1.0 / bend);
        2.0 * self.rate_hz * (e * (2.0 * radius - e).max(radius)).sqrt()
    }

    /// Limits of acceleration and jerk along the parameter where the speed is at most `speed_u_s`.
    #[must_use]
    pub fn tangential(&self, bounds: &DerivativeBounds, speed_u_s: f64) -> (f64, f64) {
        let (mut acceleration, mut jerk) = (UNLIMITED, UNLIMITED * 1e3);
        let mut left = [0.0; AXES];
        for i in 0..AXES {
            if self.axes.present[i] {
                let (d1, d2, d3) = (bounds.first[i], bounds.second[i], bounds.third[i]);
                left[i] = (JERK_MARGIN * self.axes.jerk[i] - d3 * speed_u_s * speed_u_s * speed_u_s).max(0.0);
                if d1 > 0.0 {
                    acceleration =
                        acceleration.min((self.axes.acceleration[i] - d2 * speed_u_s * speed_u_s) / d1);
                }
                if d2 * speed_u_s > 0.0 {
                    acceleration = acceleration.min(CROSS_FRACTION * left[i] / (3.0 * d2 * speed_u_s));
                }
            }
        }
        for i in 0..AXES {
            if self.axes.present[i] && bounds.first[i] > 0.0 {
                let cross = 3.0 * bounds.second[i] * speed_u_s * acceleration;
                jerk = jerk.min((left[i] - cross) / bounds.first[i]);
            }
        }
        (acceleration, jerk)
    }

    /// Scalar limits that hold on each of `cells` up to `speed_u_s`, which every cell permits.
    #[must_use]
    pub fn over(&self, cells: &[DerivativeBounds], speed_u_s: f64) -> ScalarLimits {
        let velocity = speed_u_s.min(UNLIMITED);
        let (acceleration, jerk) = cells
            .iter()
            .map(|cell| self.tangential(cell, velocity))
            .fold((UNLIMITED, UNLIMITED * 1e3), |min, one| {
                (min.0.min(one.0), min.1.min(one.1))
            });
        ScalarLimits {
            velocity,
            acceleration,
            jerk,
        }
    }
}

/// Appends the derivative bounds of `curve` over `from..to`, in cells over which the tangent rotates by at
/// most 0.3 rad.
pub fn append_cells(curve: &Curve, from: f64, to: f64, cells: &mut Vec<DerivativeBounds>) {
    let whole = curve.derivative_bounds(from, to);
    let angle = xyz(&whole.1) * (to - from);
    let count = (angle / CELL_ANGLE).ceil().clamp(1.0, MAX_CELLS);
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

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use evolvent_path::{Arc, Plane, Sense};

    use super::*;
    use evolvent_random::Random;

    fn axes(velocity: f64, acceleration: f64, jerk: f64) -> Limits {
        Limits {
            present: [true; AXES],
            velocity: Axes::repeat(velocity),
            acceleration: Axes::repeat(acceleration),
            jerk: Axes::repeat(jerk),
            travel_min: Axes::repeat(-1e4),
            travel_max: Axes::repeat(1e4),
            home: Axes::zeros(),
        }
    }

    #[test]
    fn scalar_limits_imply_the_axis_limits() {
        let seed = 0x11_0001;
        println!("seed {seed:#x}");
        let mut random = Random::from_state(seed);
        for case in 0..3000 {
            let mut limits = axes(1.0, 1.0, 1.0);
            let mut bounds = DerivativeBounds {
                first: Axes::zeros(),
                second: Axes::zeros(),
                third: Axes::zeros(),
            };
            for i in 0..AXES {
                limits.present[i] = random.unit() < 0.8;
                limits.velocity[i] = random.log(0.1, 1e4);
                limits.acceleration[i] = random.log(1.0, 1e5);
                limits.jerk[i] = random.log(10.0, 1e7);
                bounds.first[i] = if random.unit() < 0.2 { 0.0 } else { random.unit() };
                bounds.second[i] = if random.unit() < 0.3 {
                    0.0
                } else {
                    random.log(1e-4, 10.0)
                };
                bounds.third[i] = if random.unit() < 0.3 {
                    0.0
                } else {
                    random.log(1e-6, 100.0)
                };
            }
            let path = PathLimits::new(limits, 1000.0, 1e-3);
            let speed = path.speed(&bounds);
            let (acceleration, jerk) = path.tangential(&bounds, speed);
            // Enough remains to accelerate and decelerate.
            assert!(
                speed > 0.0 && acceleration > 0.0 && jerk > 0.0,
                "case {case}: {speed} {acceleration} {jerk}"
            );
            for _ in 0..20 {
                let sign = |unit: f64| (2.0 * unit - 1.0).clamp(-1.0, 1.0);
                let corner = random.unit() < 0.5;
                let pick = |unit: f64| if corner { sign(unit).signum() } else { sign(unit) };
                let v = speed * pick(random.unit()).abs();
                let (b, c) = (acceleration * pick(random.unit()), jerk * pick(random.unit()));
                for i in (0..AXES).filter(|&i| limits.present[i]) {
                    // Any derivatives within the bounds, of any sign.
                    let d1 = bounds.first[i] * pick(random.unit());
                    let d2 = bounds.second[i] * pick(random.unit());
                    let d3 = bounds.third[i] * pick(random.unit());
                    let within = |value: f64, limit: f64| value.abs() <= limit * (1.0 + 1e-9);
                    assert!(
                        within(d1 * v, limits.velocity[i]),
                        "case {case}, axis {i}: velocity"
                    );
                    assert!(
                        within(d2 * v * v + d1 * b, limits.acceleration[i]),
                        "case {case}, axis {i}: acceleration"
                    );
                    assert!(
                        within(d3 * v * v * v + 3.0 * d2 * v * b + d1 * c, 0.99 * limits.jerk[i]),
                        "case {case}, axis {i}: jerk"
                    );
                }
            }
        }
    }

    #[test]
    fn a_straight_axis_uses_its_full_limits() {
        let mut bounds = DerivativeBounds {
            first: Axes::zeros(),
            second: Axes::zeros(),
            third: Axes::zeros(),
        };
        bounds.first[0] = 0.5;
        let path = PathLimits::new(axes(100.0, 2000.0, 50_000.0), 1000.0, 1e-3);
        let one = path.over(&[bounds], path.speed(&bounds));
        assert!((one.velocity - 200.0).abs() < 1e-9, "{one:?}");
        assert!((one.acceleration - 4000.0).abs() < 1e-9, "{one:?}");
        assert!((one.jerk - 0.99 * 100_000.0).abs() < 1e-6, "{one:?}");
        // Over several cells the lowest limit applies.
        let mut other = bounds;
        other.first[1] = 1.0;
        let both = path.over(&[bounds, other, bounds], 100.0);
        assert!((both.acceleration - 2000.0).abs() < 1e-9 && (both.jerk - 49_500.0).abs() < 1e-6);
    }

    #[test]
    fn the_chord_of_one_period_has_the_permitted_error() {
        // Geometry, not the formula: chord c on radius R deviates by R - sqrt(R^2 - c^2 / 4).
        for radius in [0.02, 1.0, 250.0] {
            for (rate, error) in [(1000.0, 1e-3), (35_000.0, 1e-5)] {
                let path = PathLimits::new(axes(1e12, 1e15, 1e18), rate, error);
                let mut bounds = DerivativeBounds {
                    first: Axes::zeros(),
                    second: Axes::zeros(),
                    third: Axes::zeros(),
                };
                bounds.second[0] = 1.0 / radius;
                let half = 0.5 * path.speed(&bounds) / rate;
                let miss = half * half / (radius + (radius * radius - half * half).sqrt());
                assert!(
                    (miss / error - 1.0).abs() < 1e-9,
                    "R {radius}: {miss} for {error}"
                );
            }
        }
    }

    #[test]
    fn a_circle_within_the_chord_error_is_not_slowed_down() {
        let path = PathLimits::new(axes(1e12, 1e15, 1e18), 1000.0, 1e-3);
        let speed = |radius: f64| {
            let mut bounds = DerivativeBounds {
                first: Axes::zeros(),
                second: Axes::zeros(),
                third: Axes::zeros(),
            };
            bounds.second[1] = 1.0 / radius;
            path.speed(&bounds)
        };
        // 2 f sqrt(e R) with R below e: at most the diameter per period, increasing with R.
        assert!((speed(2.5e-4) - 2000.0 * (1e-3_f64 * 2.5e-4).sqrt()).abs() < 1e-9);
        assert!(speed(2.5e-4) < speed(5e-4) && speed(5e-4) < speed(1e-3) && speed(1e-3) < speed(2e-3));
    }

    #[test]
    fn cells_bound_the_curve_without_gaps() {
        let mut end = Axes::zeros();
        (end[0], end[1]) = (-5.0, 5.0);
        let arc = Arc::new(
            Plane::Xy,
            Axes::zeros(),
            end,
            [-5.0, 0.0],
            Sense::CounterClockwise,
            0,
        );
        let curve = Curve::Arc(arc.expect("arc"));
        let mut cells = Vec::new();
        for (from, to) in [
            (0.0, curve.domain()),
            (0.4 * curve.domain(), 0.9 * curve.domain()),
        ] {
            cells.clear();
            append_cells(&curve, from, to, &mut cells);
            // Cells of 0.3 rad; the curvature bound may exceed the curvature by sqrt(2).
            let min = ((to - from) / 5.0 / 0.3).ceil() as usize;
            assert!((min..=min + min / 2).contains(&cells.len()), "{}", cells.len());
            let width = (to - from) / cells.len() as f64;
            for (k, cell) in cells.iter().enumerate() {
                let at = |step: f64| curve.jet(from + width * (k as f64 + step));
                for step in 0..=10 {
                    let jet = at(f64::from(step) / 10.0);
                    for i in 0..3 {
                        assert!(jet.first[i].abs() <= cell.first[i] + 1e-12, "cell {k} axis {i}");
                        assert!(jet.second[i].abs() <= cell.second[i] + 1e-12, "cell {k} axis {i}");
                        assert!(jet.third[i].abs() <= cell.third[i] + 1e-12, "cell {k} axis {i}");
                    }
                }
                // The bound is tight: the direction at the ends of the cell reaches it.
                let ends = at(0.0).first[0].abs().max(at(1.0).first[0].abs());
                assert!((cell.first[0] - ends).abs() < 1e-9, "cell {k}");
            }
        }
        // Many turns need at most the maximum number of cells, a line one.
        let helix = Arc::new(
            Plane::Xy,
            Axes::zeros(),
            Axes::zeros(),
            [-5.0, 0.0],
            Sense::Clockwise,
            50,
        );
        let helix = Curve::Arc(helix.expect("arc"));
        cells.clear();
        append_cells(&helix, 0.0, helix.domain(), &mut cells);
        assert_eq!(cells.len(), 24);
    }
}

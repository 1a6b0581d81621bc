//! The joint between two moves, blended within the tolerance.
//!
//! A blend replaces the last length `h` of one curve and the first length `h` of the next by a quintic in the
//! same path parameter that equals both in position, first and second derivative. So curvature is continuous
//! and jerk bounded for any pair of curves, tangent or not, and the parameter continues as the programmed
//! length. For two lines with tangents `t1`, `t2` it is `P - h t1 + ...` with the second derivative along
//! `t2 - t1` only, and its middle is `3/16 h |t2 - t1|` from the corner; a reversal becomes a stop and a
//! return.

use evolvent_path::{Axes, Blend, Curve, Jet, ParamCurve};

/// Number of samples along a blend at which its distance from the programmed path is measured.
const SAMPLES: u32 = 24;
/// Fraction of the tolerance that is used, because the distance between samples may be larger.
const TOLERANCE_FRACTION: f64 = 0.98;
/// Maximum rotation of a curve's tangent (rad) over the length that one blend replaces.
const MAX_TANGENT_ROTATION: f64 = 0.5;
/// Maximum number of reductions of the length.
const MAX_REDUCTIONS: usize = 60;
/// Minimum length in parameter units; a shorter blend is not better than a stop.
const MIN_LENGTH: f64 = 1e-7;

/// A blend within the tolerance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rounding {
    /// The polynomial.
    pub blend: Blend,
    /// Parameter length taken from the end of the left and the start of the right curve.
    pub trim: f64,
    /// Maximum distance from the programmed path at equal parameters, mm (or degrees of a rotary axis).
    pub deviation: f64,
}

/// The blend between the end of `left` and the start of `right` within `tolerance_mm` of both that takes at
/// most `max_length` from each; `None` if none longer than 100 nm exists.
///
/// Distances are measured between points of equal parameter, so the blend misses the corner itself by at most
/// the tolerance too. XYZ and UVW count in mm, a rotary axis by its angle in degrees. Not real-time safe.
#[must_use]
pub fn round_corner(left: &Curve, right: &Curve, tolerance_mm: f64, max_length: f64) -> Option<Rounding> {
    let goal = TOLERANCE_FRACTION * tolerance_mm;
    let bend = |jet: &Jet| xyz(&jet.second);
    let (end, start) = (left.jet(left.domain()), right.jet(0.0));
    let turn = distance(&(start.first - end.first)).max(1e-12);
    let sharpest = bend(&end).max(bend(&start)).max(1e-300);
    // Curvature adds to the deviation with h^2, which the measurement covers.
    let mut h = max_length
        .min(16.0 / 3.0 * goal / turn)
        .min(MAX_TANGENT_ROTATION / sharpest);
    for _ in 0..MAX_REDUCTIONS {
        if h.is_nan() || h < MIN_LENGTH {
            return None;
        }
        let from = left.domain() - h;
        let blend = Blend::hermite(&left.jet(from), &right.jet(h), 2.0 * h).ok()?;
        let deviation = deviation(left, right, &blend, from, h);
        if deviation <= goal {
            return Some(Rounding {
                blend,
                trim: h,
                deviation,
            });
        }
        let ratio = goal / deviation;
        h *= (if ratio.is_finite() {
            0.98 * ratio.sqrt()
        } else {
            0.5
        })
        .clamp(0.3, 0.95);
    }
    None
}

fn deviation(left: &Curve, right: &Curve, blend: &Blend, from: f64, h: f64) -> f64 {
    let mut max: f64 = 0.0;
    for k in 1..SAMPLES {
        let u = 2.0 * h * f64::from(k) / f64::from(SAMPLES);
        let programmed = if u < h {
            left.position(from + u)
        } else {
            right.position(u - h)
        };
        let off = distance(&(blend.position(u) - programmed));
        if off.is_nan() {
            return f64::NAN;
        }
        max = max.max(off);
    }
    max
}

/// The maximum of the XYZ distance, the UVW distance and each rotary angle.
fn distance(d: &Axes) -> f64 {
    let uvw = (d[6] * d[6] + d[7] * d[7] + d[8] * d[8]).sqrt();
    xyz(d).max(uvw).max(d[3].abs()).max(d[4].abs()).max(d[5].abs())
}

fn xyz(d: &Axes) -> f64 {
    (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use evolvent_path::{Arc, Line, Plane, Sense};

    use super::*;

    fn point(x: f64, y: f64) -> Axes {
        let mut point = Axes::zeros();
        (point[0], point[1]) = (x, y);
        point
    }

    fn corner(turn: f64, length: f64) -> (Curve, Curve) {
        let end = point(10.0 + length * turn.cos(), length * turn.sin());
        let left = Line::new(point(10.0 - length, 0.0), point(10.0, 0.0)).expect("line");
        let right = Line::new(point(10.0, 0.0), end).expect("line");
        (Curve::Line(left), Curve::Line(right))
    }

    #[test]
    fn a_blend_of_two_lines_has_the_predicted_deviation() {
        for turn in [0.01, 0.3, 1.0, 2.0, 3.0, std::f64::consts::PI] {
            for tolerance in [1e-4, 0.01, 0.5] {
                let (left, right) = corner(turn, 1000.0);
                let rounding = round_corner(&left, &right, tolerance, 500.0).expect("room");
                let h = rounding.trim;
                let middle = distance(&(rounding.blend.position(h) - point(10.0, 0.0)));
                // |t2 - t1| = 2 sin(turn / 2)
                let expected = 3.0 / 16.0 * h * 2.0 * (turn / 2.0).sin();
                assert!(
                    (middle - expected).abs() < 1e-9 * h + 1e-12,
                    "{turn}: {middle} {expected}"
                );
                assert!((rounding.deviation - expected).abs() < 1e-9 * h + 1e-12);
                // The tolerance is used up to its margin and one reduction step, if the length permits.
                let used = middle / tolerance;
                assert!(
                    used <= 0.98 + 1e-9 && (used > 0.93 || h >= 499.0),
                    "{turn}: {used}"
                );
            }
        }
    }

    #[test]
    fn a_blend_takes_at_most_the_maximum_length() {
        let (left, right) = corner(1.0, 1000.0);
        let rounding = round_corner(&left, &right, 1.0, 0.25).expect("room");
        assert!((rounding.trim - 0.25).abs() < 1e-15);
        assert!(round_corner(&left, &right, 1.0, 0.9e-7).is_none());
        assert!(round_corner(&left, &right, 1.0, 1.1e-7).is_some());
        assert!(round_corner(&left, &right, f64::NAN, f64::NAN).is_none());
    }

    #[test]
    fn blends_are_smooth_and_within_tolerance() {
        // A line, then a quarter circle that bends away at some angle; and the reverse.
        for degrees in [0.0_f64, 5.0, 60.0, 150.0] {
            for (radius, tolerance) in [(0.5, 0.01), (20.0, 0.1), (3.0, 0.5)] {
                let angle = degrees.to_radians();
                let heading = |a: f64| point(a.cos(), a.sin());
                let corner = point(10.0, 0.0);
                let centre = corner + heading(angle + std::f64::consts::FRAC_PI_2) * radius;
                let end = centre + heading(angle) * radius;
                let line = Curve::Line(Line::new(point(-10.0, 0.0), corner).expect("line"));
                let arc = Arc::new(
                    Plane::Xy,
                    corner,
                    end,
                    [centre[0], centre[1]],
                    Sense::CounterClockwise,
                    0,
                );
                let arc = Curve::Arc(arc.expect("arc"));
                for (left, right) in [(line, arc), (arc.reversed(), line.reversed())] {
                    let rounding = round_corner(&left, &right, tolerance, 5.0).expect("room");
                    let (h, blend) = (rounding.trim, rounding.blend);
                    let pairs = [
                        (blend.jet(0.0), left.jet(left.domain() - h)),
                        (blend.jet(2.0 * h), right.jet(h)),
                    ];
                    for (blend, curve) in pairs {
                        assert!((blend.position - curve.position).amax() < 1e-12);
                        assert!((blend.first - curve.first).amax() < 1e-11);
                        assert!((blend.second - curve.second).amax() < 1e-9 / h);
                    }
                    // The distance from the programmed point of equal parameter stays within it, on a finer
                    // sampling.
                    for k in 0..=1000 {
                        let u = 2.0 * h * f64::from(k) / 1000.0;
                        let programmed = if u < h {
                            left.position(left.domain() - h + u)
                        } else {
                            right.position(u - h)
                        };
                        let off = distance(&(blend.position(u) - programmed));
                        assert!(
                            off <= tolerance,
                            "{degrees} {radius}: {off} of {tolerance} at {k}"
                        );
                    }
                    // At most half a radian of the arc is replaced.
                    assert!(h <= 0.5 * radius * (1.0 + 1e-12), "{h} of radius {radius}");
                }
            }
        }
    }

    #[test]
    fn rotary_and_secondary_axes_count_as_distances() {
        for (axis, expected) in [(0, 2.0), (3, 2.0), (4, 2.0), (5, 2.0), (6, 2.0), (8, 2.0)] {
            let mut off = Axes::zeros();
            off[axis] = -2.0;
            assert!((distance(&off) - expected).abs() < 1e-15, "axis {axis}");
        }
        let off = Axes::from([2.0, 3.0, 6.0, 1.0, 1.0, 1.0, 1.0, 4.0, 8.0]);
        // sqrt(1 + 16 + 64) = 9 exceeds sqrt(4 + 9 + 36) = 7.
        assert!((distance(&off) - 9.0).abs() < 1e-15);
    }
}

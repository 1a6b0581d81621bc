//! The joint between two moves: blended within the tolerance, or taken as the exact path allows.
//!
//! A blend replaces the last stretch `h` of one curve and the first stretch `h` of the next by a quintic in the
//! same path parameter, equal to both in position, first and second derivative. So curvature is continuous and
//! jerk bounded for every pair of curves, tangent or not, and the parameter goes on as the programmed length.
//! For two lines with tangents `t1`, `t2` it is `P - h t1 + ...` with second derivative along `t2 - t1` only, and
//! its middle lies `3/16 h |t2 - t1|` from the corner; a reversal becomes a plain stop and return.

use evolvent_path::{AXES, Axes, Blend, Curve, Jet, ParamCurve};

/// Samples along a blend at which its distance from the programmed path is measured.
const SAMPLES: u32 = 24;
/// What the distance between samples can add: the tolerance is used to this share.
const TOLERANCE_SHARE: f64 = 0.98;
/// Largest stretch of a curve, in turns of its tangent (rad), that one blend may replace.
const MOST_TURN: f64 = 0.5;
/// Shrinking steps of the stretch.
const SHRINKS: usize = 60;
/// Below this stretch, in parameter units, a blend is no better than a stop.
const SHORTEST: f64 = 1e-7;

/// A blend that fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rounding {
    /// The polynomial.
    pub blend: Blend,
    /// Parameter length taken from the end of the left and the start of the right curve.
    pub stretch: f64,
    /// Largest distance from the programmed path, mm (or degrees of a rotary axis), at equal parameters.
    pub deviation: f64,
}

/// The blend between the end of `left` and the start of `right` that stays within `tolerance` of both, taking
/// at most `room` from each; `None` if none longer than a hundred nanometres does.
///
/// Distances are measured between points of equal parameter, so the corner itself is missed by no more than the
/// tolerance either. XYZ and UVW count in mm; a rotary axis counts with its angle in degrees.
#[must_use]
pub fn round_corner(left: &Curve, right: &Curve, tolerance: f64, room: f64) -> Option<Rounding> {
    let goal = TOLERANCE_SHARE * tolerance;
    let bend = |jet: &Jet| xyz(&jet.second);
    let (end, start) = (left.jet(left.domain()), right.jet(0.0));
    let turn = distance(&(start.first - end.first)).max(1e-12);
    let sharpest = bend(&end).max(bend(&start)).max(1e-300);
    // Curvature adds to the deviation with h^2 and is handled by measuring.
    let mut h = room.min(16.0 / 3.0 * goal / turn).min(MOST_TURN / sharpest);
    for _ in 0..SHRINKS {
        if h.is_nan() || h < SHORTEST {
            return None;
        }
        let from = left.domain() - h;
        let blend = Blend::hermite(&left.jet(from), &right.jet(h), 2.0 * h).ok()?;
        let deviation = deviation(left, right, &blend, from, h);
        if deviation <= goal {
            return Some(Rounding {
                blend,
                stretch: h,
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
    let mut most: f64 = 0.0;
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
        most = most.max(off);
    }
    most
}

/// How fast a joint may be taken where the path is to be kept exactly: the step of velocity must be one that
/// the jerk limit undoes within `joint_time` (`J t^2 / 2`), and the step of acceleration `J t`. The same at
/// every control rate.
#[must_use]
pub fn exact_joint_speed(
    left: &Jet,
    right: &Jet,
    jerk: &Axes,
    present: &[bool; AXES],
    joint_time: f64,
) -> f64 {
    let mut speed = f64::INFINITY;
    for i in 0..AXES {
        if present[i] {
            let (dq, ddq) = (
                (right.first[i] - left.first[i]).abs(),
                (right.second[i] - left.second[i]).abs(),
            );
            speed = speed
                .min(0.5 * jerk[i] * joint_time * joint_time / dq)
                .min((jerk[i] * joint_time / ddq).sqrt());
        }
    }
    if speed.is_nan() { 0.0 } else { speed }
}

/// The largest of the XYZ distance, the UVW distance and each rotary angle.
fn distance(d: &Axes) -> f64 {
    let uvw = (d[6] * d[6] + d[7] * d[7] + d[8] * d[8]).sqrt();
    xyz(d).max(uvw).max(d[3].abs()).max(d[4].abs()).max(d[5].abs())
}

fn xyz(d: &Axes) -> f64 {
    (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
}

//! The joint rule: how two curves meet, and at what speed an exact path may pass.

use crate::{AXES, Axes, Jet, feed_rate};

/// Tangent steps up to this are rounding: at 1 m/s and 35 kHz the resulting jerk is below 1 % of any limit.
const SMOOTH_TANGENT: f64 = 1e-10;
/// Steps of the second derivative up to this are rounding, 1/mm.
const SMOOTH_CURVATURE: f64 = 1e-7;
/// Minimum speed of a joint in parameter units per s; a slower joint is a stop.
const MIN_JOINT_SPEED: f64 = 0.01;
/// Tangent steps above this are corners, where an exact path stops. Smaller steps are tangent joints that
/// programs with few decimals cannot write exactly.
const CORNER: f64 = 0.01;
/// Minimum speed in the feed metric per unit of `u` at which a curve counts as regular at the joint.
const REGULAR_SPEED: f64 = 0.5;

/// The limits that bound the speed of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// The axes of the machine; the others bound no speed.
    pub present: [bool; AXES],
    /// Maximum jerk of every axis, mm/s3 or deg/s3.
    pub jerk: Axes,
    /// Time within which the jerk limit must compensate the steps of velocity and acceleration, s.
    pub joint_time_s: f64,
}

/// How two curves meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointKind {
    /// Tangent and second derivative are continuous: the joint does not bound the speed.
    Smooth,
    /// Tangent or second derivative has a step that an exact path passes at a bounded speed.
    Step {
        /// Maximum parameter speed, units of `u` per s; infinite where no axis of the machine has a step.
        max_speed: f64,
    },
    /// An exact path stops here: the tangent has a large step, a curve is singular, or a derivative is not
    /// finite.
    Corner,
}

impl JointKind {
    /// Maximum parameter speed of an exact path, units of `u` per s: infinite at a smooth joint, 0 at a
    /// corner. Real-time safe.
    #[must_use]
    pub const fn max_speed(self) -> f64 {
        match self {
            Self::Smooth => f64::INFINITY,
            Self::Step { max_speed } => max_speed,
            Self::Corner => 0.0,
        }
    }
}

/// Classifies the joint between `end`, the last jet of one curve, and `start`, the first jet of the next,
/// both by the regular parameter. Real-time safe.
///
/// At the maximum speed the step of velocity is at most `J t^2 / 2` and the step of acceleration at most
/// `J t` on every axis, with the jerk limit `J` and the joint time `t`. The speed does not depend on the
/// control rate (`docs/adr/0009`). A derivative that is not finite makes a corner.
///
/// ```
/// use evolvent_path::{AXES, Axes, AxisLetter, JointKind, JointLimits, Jet, classify_joint};
///
/// let mut present = [false; AXES];
/// (present[AxisLetter::X.index()], present[AxisLetter::Y.index()]) = (true, true);
/// let limits = JointLimits { present, jerk: Axes::repeat(200_000.0), joint_time_s: 0.001 };
///
/// // A line along X meets an arc of 40 mm radius with equal tangents: acceleration steps by v^2 / R.
/// let mut line = Jet::at_rest(Axes::zeros());
/// line.first[0] = 1.0;
/// let mut arc = line;
/// arc.second[1] = 1.0 / 40.0;
/// let JointKind::Step { max_speed } = classify_joint(&line, &arc, &limits) else { panic!() };
/// assert!((max_speed - (200_000.0_f64 * 0.001 * 40.0).sqrt()).abs() < 1e-9);
///
/// // A right angle is a corner.
/// let mut upward = Jet::at_rest(Axes::zeros());
/// upward.first[1] = 1.0;
/// assert_eq!(classify_joint(&line, &upward, &limits), JointKind::Corner);
/// ```
#[must_use]
pub fn classify_joint(end: &Jet, start: &Jet, limits: &JointLimits) -> JointKind {
    // `amax` ignores NaN, so non-finite jets are excluded first.
    if !(end.is_finite() && start.is_finite()) {
        return JointKind::Corner;
    }
    let regular = feed_rate(&end.first) > REGULAR_SPEED && feed_rate(&start.first) > REGULAR_SPEED;
    let tangent_step = (start.first - end.first).amax();
    let curvature_step = (start.second - end.second).amax();
    if regular && tangent_step <= SMOOTH_TANGENT && curvature_step <= SMOOTH_CURVATURE {
        return JointKind::Smooth;
    }
    let max_speed = step_speed(end, start, limits);
    if regular && tangent_step <= CORNER && max_speed >= MIN_JOINT_SPEED {
        JointKind::Step { max_speed }
    } else {
        JointKind::Corner
    }
}

/// The speed at which the jerk limit compensates the steps of velocity and acceleration within the joint
/// time.
fn step_speed(end: &Jet, start: &Jet, limits: &JointLimits) -> f64 {
    let time = limits.joint_time_s;
    (0..AXES)
        .filter(|&i| limits.present[i])
        .fold(f64::INFINITY, |speed, i| {
            let tangent_step = (start.first[i] - end.first[i]).abs();
            let curvature_step = (start.second[i] - end.second[i]).abs();
            speed
                .min(0.5 * limits.jerk[i] * time * time / tangent_step)
                .min((limits.jerk[i] * time / curvature_step).sqrt())
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    const JERK: f64 = 50_000.0;
    const TIME: f64 = 0.002;

    fn limits() -> JointLimits {
        let mut present = [false; AXES];
        (present[0], present[1]) = (true, true);
        JointLimits {
            present,
            jerk: Axes::repeat(JERK),
            joint_time_s: TIME,
        }
    }

    /// A jet in XY whose tangent has this angle.
    fn toward(angle: f64) -> Jet {
        let mut jet = Jet::at_rest(Axes::zeros());
        (jet.first[0], jet.first[1]) = (angle.cos(), angle.sin());
        jet
    }

    #[test]
    fn a_step_is_passed_as_fast_as_the_jerk_limit_permits() {
        // The step of Y's velocity is v sin(0.001), which J t^2 / 2 compensates.
        let speed = classify_joint(&toward(0.0), &toward(0.001), &limits()).max_speed();
        let expected = 0.5 * JERK * TIME * TIME / 0.001_f64.sin();
        assert!((speed - expected).abs() < 1e-9 * expected, "{speed} {expected}");
        // A step of curvature 1/R is a step of acceleration v^2 / R, which J t compensates.
        let mut curved = toward(0.0);
        curved.second[1] = 1.0 / 40.0;
        let speed = classify_joint(&toward(0.0), &curved, &limits()).max_speed();
        let expected = (JERK * TIME * 40.0_f64).sqrt();
        assert!((speed - expected).abs() < 1e-9 * expected, "{speed} {expected}");
    }

    #[test]
    fn an_absent_axis_bounds_no_speed() {
        let mut curved = toward(0.0);
        curved.second[1] = 1.0 / 40.0;
        let mut limits = limits();
        limits.present[1] = false;
        let kind = classify_joint(&toward(0.0), &curved, &limits);
        assert_eq!(
            kind,
            JointKind::Step {
                max_speed: f64::INFINITY
            }
        );
    }

    #[test]
    fn only_steps_within_rounding_are_smooth() {
        for (angle, smooth) in [(0.0, true), (0.9e-10, true), (1.1e-10, false)] {
            let kind = classify_joint(&toward(0.0), &toward(angle), &limits());
            assert_eq!(kind == JointKind::Smooth, smooth, "{angle}: {kind:?}");
        }
        for (curvature, smooth) in [(0.9e-7, true), (1.1e-7, false)] {
            let mut curved = toward(0.0);
            curved.second[1] = curvature;
            let kind = classify_joint(&toward(0.0), &curved, &limits());
            assert_eq!(kind == JointKind::Smooth, smooth, "{curvature}: {kind:?}");
        }
        assert_eq!(JointKind::Smooth.max_speed(), f64::INFINITY);
    }

    #[test]
    fn a_large_step_of_the_tangent_is_a_corner() {
        for (angle, corner) in [(0.0099, false), (0.0101, true), (3.0, true)] {
            // A jerk limit that would permit any speed.
            let limits = JointLimits {
                jerk: Axes::repeat(1e12),
                ..limits()
            };
            let kind = classify_joint(&toward(0.0), &toward(angle), &limits);
            assert_eq!(kind == JointKind::Corner, corner, "{angle}: {kind:?}");
        }
        assert_eq!(JointKind::Corner.max_speed(), 0.0);
    }

    #[test]
    fn a_joint_below_the_minimum_speed_is_a_corner() {
        // J t^2 / 2 / 0.005 = 0.0101 or 0.0099 mm/s.
        for (speed, corner) in [(0.0101, false), (0.0099, true)] {
            let jerk = Axes::repeat(speed * 0.005_f64.sin() * 2.0 / (TIME * TIME));
            let kind = classify_joint(&toward(0.0), &toward(0.005), &JointLimits { jerk, ..limits() });
            assert_eq!(kind == JointKind::Corner, corner, "{speed}: {kind:?}");
        }
    }

    #[test]
    fn a_singular_curve_is_a_corner_on_either_side() {
        let slow = Jet {
            first: toward(0.0).first * 0.4,
            ..toward(0.0)
        };
        for (end, start) in [(slow, toward(0.0)), (toward(0.0), slow), (slow, slow)] {
            assert_eq!(classify_joint(&end, &start, &limits()), JointKind::Corner);
        }
    }

    #[test]
    fn a_derivative_that_is_not_finite_is_a_corner() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for axis in [0, 1, 8] {
                let (mut first, mut second) = (toward(0.0), toward(0.0));
                (first.first[axis], second.second[axis]) = (bad, bad);
                for jet in [first, second] {
                    assert_eq!(classify_joint(&jet, &toward(0.0), &limits()), JointKind::Corner);
                    assert_eq!(classify_joint(&toward(0.0), &jet, &limits()), JointKind::Corner);
                }
            }
        }
    }
}

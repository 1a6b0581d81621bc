//! Joints that are kept as they are programmed.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Jet, feed_rate};

/// A step of the tangent below this is rounding: at 1 m/s and 35 kHz its jerk is below a hundredth of any limit.
const SMOOTH_TANGENT: f64 = 1e-10;
/// A step of the second derivative, 1/mm, below this likewise.
const SMOOTH_CURVATURE: f64 = 1e-7;
/// A joint slower than this, parameter units per s, is a stop.
const SLOWEST_JOINT: f64 = 0.01;
/// A step of the tangent above this is a corner, where an exact path stops; below, it is how programs with few
/// decimals write a tangent joint.
const CORNER: f64 = 0.01;
/// Between this and a unit of parameter speed a curve can be joined; below, it starts from a singular point.
const REGULAR_SPEED: f64 = 0.5;

/// How two curves meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum JointKind {
    /// Tangent and second derivative go on: nothing to do.
    Smooth,
    /// A step that can be passed at this parameter speed; 0 is a stop.
    Step {
        /// Bound of the parameter speed.
        speed: f64,
    },
}

/// Judges the joint between the end of one curve and the start of the next, if the path is kept.
///
/// The step of velocity must be one that the jerk limit undoes within the joint time (`J t^2 / 2`), the step of
/// acceleration likewise (`J t`): the same at every control rate. A corner is a stop.
pub(crate) fn judge(end: &Jet, start: &Jet, limits: &Limits, joint_time: f64) -> JointKind {
    let regular = feed_rate(&end.first) > REGULAR_SPEED && feed_rate(&start.first) > REGULAR_SPEED;
    let turn = (start.first - end.first).amax();
    if regular && turn <= SMOOTH_TANGENT && (start.second - end.second).amax() <= SMOOTH_CURVATURE {
        return JointKind::Smooth;
    }
    let mut speed = f64::INFINITY;
    for i in (0..AXES).filter(|&i| limits.present[i]) {
        let (dq, ddq) = (
            (start.first[i] - end.first[i]).abs(),
            (start.second[i] - end.second[i]).abs(),
        );
        speed = speed
            .min(0.5 * limits.jerk[i] * joint_time * joint_time / dq)
            .min((limits.jerk[i] * joint_time / ddq).sqrt());
    }
    if !regular || !(turn <= CORNER) || !(speed >= SLOWEST_JOINT) {
        speed = 0.0;
    }
    JointKind::Step { speed }
}

/// Which axes the feed speaks of where these move.
pub(crate) fn metric_axes(active: &[bool; AXES]) -> [bool; AXES] {
    let first = [0, 6, 3]
        .into_iter()
        .find(|&i| active[i..i + 3].iter().any(|&a| a))
        .unwrap_or(0);
    std::array::from_fn(|i| (first..first + 3).contains(&i))
}

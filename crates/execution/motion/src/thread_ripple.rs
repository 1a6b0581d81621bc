//! The part of a spindle's uneven rotation that the axes of a thread follow.
//!
//! A spindle's speed varies within a turn. To follow a harmonic of amplitude `r` at angular frequency `w`, an
//! axis needs an acceleration of `r w^2` and a jerk of `r w^3`, which at high speed is more than it has. What
//! it has is least in the run-in and at corners, where the path itself needs most of it; in the straight parts
//! of a thread the path needs none.

use evolvent_machine::Limits;
use evolvent_path::AXES;
use evolvent_signals::{AngleJet, HARMONICS};

use crate::thread_cam::ThreadCam;

/// Fraction of acceleration and jerk that following one harmonic of the turn may use beside a corner.
const CORNER_FRACTION: f64 = 0.3;
/// Fraction that following all harmonics may use in a straight part. The rest is for corrections.
const STRAIGHT_FRACTION: f64 = 0.92;
/// Turns in which one changes to the other. The change itself needs a jerk of at most a third of what it adds.
const CHANGE_TURNS: f64 = 2.0;

/// Fractions of each harmonic that are followed, 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FollowedRipple {
    corners: [f64; HARMONICS],
    straights: [f64; HARMONICS],
}

impl FollowedRipple {
    /// The fractions that the axes can follow up to this speed, turns/s. `ripple` is that of the present
    /// speed `mean_turns_per_s`. Real-time safe.
    pub(crate) fn new(
        ripple: &[AngleJet; HARMONICS],
        mean_turns_per_s: f64,
        max_turns_per_s: f64,
        steepest: f64,
        limits: &Limits,
    ) -> Self {
        let mut followed = Self::default();
        // What the harmonics before it have left: the lower one gives more accuracy for the same jerk.
        let mut left = STRAIGHT_FRACTION;
        for (order, ripple) in ripple.iter().enumerate() {
            let rate = |turns_per_s: f64| std::f64::consts::TAU * (order + 1) as f64 * turns_per_s;
            let amplitude = steepest * libm::hypot(ripple[0], ripple[1] / rate(mean_turns_per_s.abs()));
            let need = |turns_per_s: f64| {
                let acceleration = amplitude * rate(turns_per_s).powi(2);
                let jerk = acceleration * rate(turns_per_s);
                (0..AXES)
                    .filter(|&axis| limits.present[axis])
                    .map(|axis| (acceleration / limits.acceleration[axis]).max(jerk / limits.jerk[axis]))
                    .fold(0.0, f64::max)
            };
            followed.corners[order] = fraction(CORNER_FRACTION, need(mean_turns_per_s.abs()));
            let need = need(max_turns_per_s);
            followed.straights[order] = fraction(left, need);
            left -= followed.straights[order] * need;
        }
        followed
    }

    /// Adds the followed part to the mean angle. Returns it and its third derivative. `turns` is the mean angle
    /// since the start of the thread, in the direction of rotation. Real-time safe.
    pub(crate) fn add(
        &self,
        mean: &AngleJet,
        ripple: &[AngleJet; HARMONICS],
        turns: f64,
        direction: f64,
        cam: &ThreadCam,
    ) -> (AngleJet, f64) {
        let (mut angle, mut third) = (*mean, 0.0);
        let by_turns = cam.straightness(turns, CHANGE_TURNS);
        // By time; the mean speed changes slowly.
        let speed = direction * mean[1];
        let straightness = [
            by_turns[0],
            by_turns[1] * speed,
            by_turns[2] * speed * speed,
            by_turns[3] * speed * speed * speed,
        ];
        for order in 0..HARMONICS {
            let (corner, straight) = (self.corners[order], self.straights[order]);
            let mut weight = straightness.map(|value| (straight - corner) * value);
            weight[0] += corner;
            let rate = std::f64::consts::TAU * (order + 1) as f64 * mean[1];
            let [value, first, second] = ripple[order];
            let part = product(&weight, &[value, first, second, -rate * rate * first]);
            for (sum, part) in angle.iter_mut().zip(part) {
                *sum += part;
            }
            third += part[3];
        }
        (angle, third)
    }
}

/// The fraction of a need that can be met.
fn fraction(available: f64, need: f64) -> f64 {
    // A ripple of zero needs nothing.
    if need > available {
        available.max(0.0) / need
    } else {
        1.0
    }
}

/// The derivatives of a product.
pub(crate) fn product(a: &[f64; 4], b: &[f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0],
        a[1] * b[0] + a[0] * b[1],
        a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2],
        a[3] * b[0] + 3.0 * a[2] * b[1] + 3.0 * a[1] * b[2] + a[0] * b[3],
    ]
}

//! The part of a spindle's uneven rotation that the axes of a thread follow.
//!
//! A spindle's speed varies within a turn. To follow a harmonic of amplitude `r` at angular frequency `w`, an
//! axis needs an acceleration of `r w^2` and a jerk of `r w^3`, which at high speed is more than the axis has.
//! The margin is smallest in the run-in and at corners, where the path itself needs acceleration and jerk; in
//! the straight parts of a thread the path needs none. What exceeds the margin is not followed.

use evolvent_machine::Limits;
use evolvent_path::AXES;
use evolvent_signals::{AngleJet, HARMONICS};

use crate::thread_cam::{ThreadCam, product};

/// Fraction of acceleration and jerk that following one harmonic may use in the rounding of a corner, where
/// the path uses up to 0.8 and 0.6.
const CORNER_FRACTION: f64 = 0.3;
/// Fraction that following all harmonics may use in a straight part. The rest is for corrections. Tuned: 0.85
/// leaves 2.5 um of 2 % once per turn at 3000 rpm (`tests/synchronised`), 0.92 leaves 2.3.
const STRAIGHT_FRACTION: f64 = 0.92;
/// Turns over which the fraction changes. With the change itself a harmonic needs at most 0.98 of the jerk.
const CHANGE_TURNS: f64 = 2.0;

/// The harmonics of a spindle as far as the axes of one thread can follow them. The fractions depend on the
/// present speed and amplitudes, which change slowly; their own derivatives are neglected.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FollowedRipple {
    /// Fraction of the acceleration of an axis that 1 turn/s2 needs, the maximum of all axes.
    per_acceleration: f64,
    /// The same of jerk, for 1 turn/s3.
    per_jerk: f64,
}

impl FollowedRipple {
    /// For a thread of this maximum distance per turn, mm. Real-time safe.
    pub(crate) fn new(steepest_mm_per_turn: f64, limits: &Limits) -> Self {
        let per = |limit: &evolvent_path::Axes| {
            (0..AXES)
                .filter(|&axis| limits.present[axis])
                .map(|axis| steepest_mm_per_turn / limit[axis])
                .fold(0.0, f64::max)
        };
        Self {
            per_acceleration: per(&limits.acceleration),
            per_jerk: per(&limits.jerk),
        }
    }

    /// Adds the followed part to the mean angle. Returns it and its third derivative. `turns` is the mean angle
    /// since the start of the thread, in the direction of rotation, which `direction` gives. Real-time safe.
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
        // By time. The mean speed changes slowly.
        let speed = direction * mean[1];
        let straightness = [
            by_turns[0],
            by_turns[1] * speed,
            by_turns[2] * speed * speed,
            by_turns[3] * speed * speed * speed,
        ];
        // Fraction that the lower harmonics leave: for the same jerk they give more accuracy.
        let mut left = STRAIGHT_FRACTION;
        for (order, ripple) in ripple.iter().enumerate() {
            let rate = std::f64::consts::TAU * (order + 1) as f64 * mean[1];
            let need = self.need(ripple, rate.abs());
            let (corner, straight) = (fraction(CORNER_FRACTION, need), fraction(left, need));
            left -= straight * need;
            let mut weight = straightness.map(|value| (straight - corner) * value);
            weight[0] += corner;
            let [value, first, second] = *ripple;
            let part = product(&weight, &[value, first, second, -rate * rate * first]);
            for (sum, part) in angle.iter_mut().zip(part) {
                *sum += part;
            }
            third += part[3];
        }
        (angle, third)
    }

    /// Fraction of acceleration and jerk, whichever is larger, that following a whole harmonic needs. `rate` is
    /// its angular frequency, rad/s.
    fn need(&self, ripple: &AngleJet, rate: f64) -> f64 {
        if rate == 0.0 {
            return 0.0;
        }
        let amplitude = libm::hypot(ripple[0], ripple[1] / rate);
        amplitude * rate * rate * self.per_acceleration.max(rate * self.per_jerk)
    }
}

/// The fraction of a need that can be met.
fn fraction(available: f64, need: f64) -> f64 {
    let available = available.max(0.0);
    if need > available { available / need } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use evolvent_path::Axes;

    use super::*;
    use crate::thread_cam::ThreadLeg;

    const RATE: f64 = std::f64::consts::TAU * 50.0;

    fn limits(jerk: f64) -> Limits {
        Limits {
            present: [true; AXES],
            velocity: Axes::repeat(300.0),
            acceleration: Axes::repeat(4000.0),
            jerk: Axes::repeat(jerk),
            travel_min: Axes::repeat(-500.0),
            travel_max: Axes::repeat(500.0),
            home: Axes::zeros(),
        }
    }

    fn cam() -> ThreadCam {
        let mut end = Axes::zeros();
        end[2] = -60.0;
        let leg = ThreadLeg {
            end,
            turns: 40.0,
            line: 1,
        };
        let mut cam = ThreadCam::new(Axes::zeros(), [leg].into(), false, 0.001);
        cam.shape(50.0, &limits(100_000.0), 1e-3).expect("a thread");
        cam
    }

    /// The first harmonic of an amplitude of 1 in 1000 turns at its maximum.
    const RIPPLE: [AngleJet; HARMONICS] = [[1e-3, 0.0, -1e-3 * RATE * RATE], [0.0; 3], [0.0; 3]];

    fn followed_at(turns: f64, jerk: f64, ripple: &[AngleJet; HARMONICS]) -> f64 {
        let followed = FollowedRipple::new(1.5, &limits(jerk));
        let (angle, third) = followed.add(&[turns, 50.0, 0.0], ripple, turns, 1.0, &cam());
        assert!(angle.iter().all(|value| value.is_finite()) && third.is_finite());
        (angle[0] - turns) / 1e-3
    }

    #[test]
    fn a_weak_ripple_is_followed_whole_and_a_strong_one_by_its_jerk() {
        let need = 1.5e-3 * RATE.powi(3);
        let whole = followed_at(20.0, 2.0 * need / 0.3, &RIPPLE);
        assert!((whole - 1.0).abs() < 1e-9, "{whole}");
        let straight = followed_at(20.0, need / 2.0, &RIPPLE);
        assert!((straight - 0.46).abs() < 1e-9, "{straight}");
        let corner = followed_at(0.0, need / 2.0, &RIPPLE);
        assert!((corner - 0.15).abs() < 1e-9, "{corner}");
    }

    #[test]
    fn a_faster_spindle_is_followed_with_the_same_jerk() {
        let followed = FollowedRipple::new(1.5, &limits(10_000.0));
        for factor in [1.0, 1.05, 1.2, 1.5] {
            let rate = RATE * factor;
            let ripple = [[0.0, 1e-3 * rate, 0.0], [0.0; 3], [0.0; 3]];
            let (_, third) = followed.add(&[20.0, 50.0 * factor, 0.0], &ripple, 20.0, 1.0, &cam());
            let jerk = 1.5 * third.abs() / 10_000.0;
            assert!((jerk - STRAIGHT_FRACTION).abs() < 1e-9, "{factor}: {jerk}");
        }
    }

    #[test]
    fn harmonics_share_the_fraction_and_zeros_are_no_trouble() {
        let strong = [[1e-3, 0.0, 0.0], [1e-3, 0.0, 0.0], [0.0, 0.0, 0.0]];
        // The first uses all of it, the second has nothing, and the third needs nothing.
        let alone = followed_at(20.0, 1e4, &[strong[0], [0.0; 3], [0.0; 3]]);
        assert!((followed_at(20.0, 1e4, &strong) - alone).abs() < 1e-12);
        let at_rest = FollowedRipple::new(1.5, &limits(1e4));
        let (angle, third) = at_rest.add(&[3.0, 0.0, 0.0], &strong, 3.0, -1.0, &cam());
        assert!(angle.iter().all(|value| value.is_finite()) && third.is_finite());
    }
}

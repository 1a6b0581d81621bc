//! The distance of an axis from its setpoint when following begins, which decays to zero.

use evolvent_wire::AXES;

use crate::brake::BrakeState;
use crate::follower_settings::FollowerSettings;

/// Maximum fraction of the velocity, acceleration and jerk of an axis that the decay uses, in addition to
/// those of the setpoints. Setpoints within the limits of the axis thus give targets within 1.05 of the
/// limits, which is less than [`crate::Follower`] tolerates in setpoints.
const FRACTION: f64 = 0.05;

/// Maximum derivatives of `1 - 10 u^3 + 15 u^4 - 6 u^5`: at u = 1/2, at `(3 - sqrt 3) / 6`, and at 0.
const DISTANCE_PEAKS: [f64; 3] = [1.875, 5.773_502_691_896_258, 60.0];
/// Maximum second and third derivative of `u - 6 u^3 + 8 u^4 - 3 u^5`: at `(8 - sqrt 19) / 15`, and at 0. Its
/// first is at most 1.
const VELOCITY_PEAKS: [f64; 2] = [3.940_233_952_969_67, 36.0];

/// Offset added to the setpoints of one axis. It initially keeps the axis at rest at its position, then
/// decays, and is zero after `duration_s`. Position, velocity and acceleration are continuous.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct StartOffset {
    distance: f64,
    velocity: f64,
    duration_s: f64,
}

impl StartOffset {
    /// Starts at a distance and a velocity, and stays within a fraction of the velocity, acceleration and
    /// jerk of the axis.
    fn new(distance: f64, velocity: f64, limits: [f64; 3]) -> Self {
        let [max_v, max_a, max_j] = limits.map(|limit| FRACTION * limit);
        let [v, a, j] = DISTANCE_PEAKS.map(|peak| peak * distance.abs());
        let from_distance_s = (v / max_v).max(libm::sqrt(a / max_a)).max(libm::cbrt(j / max_j));
        let [a, j] = VELOCITY_PEAKS.map(|peak| peak * velocity.abs());
        let from_velocity_s = (a / max_a).max(libm::sqrt(j / max_j));
        Self {
            distance,
            velocity,
            // Each part uses at most its fraction of the total time as a fraction of the acceleration and
            // jerk, so that the sum of both keeps the limits.
            duration_s: from_distance_s + from_velocity_s,
        }
    }

    /// The offset at this time after following has begun.
    fn at(&self, time_s: f64) -> BrakeState {
        if time_s >= self.duration_s {
            return BrakeState::default();
        }
        let u = (time_s / self.duration_s).max(0.0);
        // In units of the duration: d and w are the distance and the velocity.
        let (d, w) = (self.distance, self.velocity * self.duration_s);
        let (c3, c4, c5) = (-10.0 * d - 6.0 * w, 15.0 * d + 8.0 * w, -6.0 * d - 3.0 * w);
        let per_s = 1.0 / self.duration_s;
        BrakeState {
            position: d + u * (w + u * u * (c3 + u * (c4 + u * c5))),
            velocity: (w + u * u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5))) * per_s,
            acceleration: u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5)) * per_s * per_s,
        }
    }
}

/// The offsets of all axes since following began; zero by default.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StartOffsets {
    since_ns: u64,
    axes: [StartOffset; AXES],
}

impl StartOffsets {
    /// Begins following now, with the axes at rest at their held positions, at setpoints in these states.
    pub(crate) fn new(
        now_ns: u64,
        settings: &FollowerSettings,
        hold: &[f64; AXES],
        setpoints: &[BrakeState; AXES],
    ) -> Self {
        let mut axes = [StartOffset::default(); AXES];
        for axis in settings.axes.axes() {
            let setpoint = &setpoints[axis];
            let distance = hold[axis] - setpoint.position;
            axes[axis] = StartOffset::new(distance, -setpoint.velocity, settings.limits(axis));
        }
        Self {
            since_ns: now_ns,
            axes,
        }
    }

    /// The offset added to the setpoint of an axis at this time.
    pub(crate) fn at(&self, time_ns: u64, axis: usize) -> BrakeState {
        self.axes[axis].at(time_ns.saturating_sub(self.since_ns) as f64 * 1e-9)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decay_is_continuous_and_within_its_limit_fraction() {
        let limits = [500.0, 5_000.0, 200_000.0];
        for (distance, velocity) in [(0.5, 0.0), (-0.3, 0.5), (0.05, -0.5), (0.0, 0.5), (1e-9, 0.0)] {
            let offset = StartOffset::new(distance, velocity, limits);
            let begin = offset.at(0.0);
            assert_eq!((begin.position, begin.acceleration), (distance, 0.0));
            assert!((begin.velocity - velocity).abs() < 1e-12);
            assert_eq!(offset.at(offset.duration_s), BrakeState::default());
            let mut peaks = [0.0_f64; 3];
            let n = 20_000;
            let step_s = offset.duration_s / f64::from(n);
            for i in 0..n {
                let [a, b] = [i, i + 1].map(|i| offset.at(step_s * f64::from(i)));
                let differences = [
                    (b.position - a.position, a.velocity, b.velocity),
                    (b.velocity - a.velocity, a.acceleration, b.acceleration),
                ];
                for (difference, from, to) in differences {
                    // By the trapezoidal rule, whose error depends on the third derivative.
                    let off = difference / step_s - 0.5 * (from + to);
                    assert!(off.abs() < 1e-6 * limits[1], "{off}");
                }
                let jerk = (b.acceleration - a.acceleration) / step_s;
                for (peak, value) in peaks.iter_mut().zip([a.velocity, a.acceleration, jerk]) {
                    *peak = peak.max(value.abs());
                }
            }
            let ratios: Vec<f64> = (0..3).map(|i| peaks[i] / limits[i]).collect();
            assert!(
                ratios.iter().all(|ratio| *ratio <= 1.001 * FRACTION),
                "{ratios:?}"
            );
            // And no slower than that without a velocity.
            let max = ratios.iter().fold(0.0_f64, |max, ratio| max.max(*ratio));
            assert!(velocity != 0.0 || max > 0.99 * FRACTION, "{ratios:?}");
        }
    }
}

//! The final correction of a pass: it removes the remaining error of the follower without a step.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, Jet};

use crate::quick_stop::QuickStop;
use crate::thread_follower::ThreadFollower;

/// Minimum duration, s.
const LANDING_S: f64 = 0.03;
/// Minimum number of setpoints.
const LANDING_STEPS: f64 = 12.0;

/// Quintic polynomials from a state nearly at rest to rest. Where they would pass the end of the travel, every
/// axis stops first: from rest they are monotone.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Landing {
    /// The stop, until it is over.
    stop: Option<QuickStop>,
    end: Axes,
    coefficients: [[f64; 3]; AXES],
    duration: f64,
    time: f64,
}

impl Landing {
    /// A correction from the state of the last setpoint. Real-time safe.
    pub(crate) fn new(
        from: &Jet,
        end: Axes,
        limits: &Limits,
        follower: &ThreadFollower,
        period_s: f64,
    ) -> Self {
        let landing = Self::polynomials(from, end, limits, period_s);
        if landing.is_within(follower) {
            landing
        } else {
            Self {
                stop: Some(QuickStop::new(limits, from.position, from)),
                ..landing
            }
        }
    }

    fn polynomials(from: &Jet, end: Axes, limits: &Limits, period_s: f64) -> Self {
        let mut duration = LANDING_S.max(LANDING_STEPS * period_s);
        for axis in 0..AXES {
            let (e, v) = ((from.position[axis] - end[axis]).abs(), from.first[axis].abs());
            let (limit_a, limit_j) = (limits.acceleration[axis], limits.jerk[axis]);
            if limits.present[axis] {
                // A third of each limit for each of distance, speed and acceleration: the extremes of the
                // polynomial are 60, 36 and 9 for jerk, and 5.8, 4 and 1 for acceleration.
                duration = duration
                    .max(libm::cbrt(180.0 * e / limit_j))
                    .max((108.0 * v / limit_j).sqrt())
                    .max(27.0 * from.second[axis].abs() / limit_j)
                    .max((18.0 * e / limit_a).sqrt())
                    .max(12.0 * v / limit_a);
            }
        }
        let mut coefficients = [[0.0; 3]; AXES];
        for (axis, of) in coefficients.iter_mut().enumerate() {
            // As a function of the remaining time tau: e = c3 tau^3 + c4 tau^4 + c5 tau^5 is at rest at tau =
            // 0.
            let (t, e) = (duration, from.position[axis] - end[axis]);
            let (v, a) = (from.first[axis], from.second[axis]);
            *of = [
                (10.0 * e + 4.0 * v * t + 0.5 * a * t * t) / (t * t * t),
                (-15.0 * e - 7.0 * v * t - a * t * t) / (t * t * t * t),
                (6.0 * e + 3.0 * v * t + 0.5 * a * t * t) / (t * t * t * t * t),
            ];
        }
        Self {
            stop: None,
            end,
            coefficients,
            duration,
            time: 0.0,
        }
    }

    /// Whether no axis passes the ends of its travel, by a bound: tau^3 at its maximum, and the rest of the
    /// polynomial at its extremes.
    fn is_within(&self, follower: &ThreadFollower) -> bool {
        let t = self.duration;
        self.coefficients.iter().enumerate().all(|(axis, [c3, c4, c5])| {
            let at = |tau: f64| c3 + tau * (c4 + tau * c5);
            let vertex = -0.5 * c4 / c5;
            let middle = if (0.0..=t).contains(&vertex) {
                at(vertex)
            } else {
                at(0.0)
            };
            let [least, most] = [at(0.0).min(at(t)).min(middle), at(0.0).max(at(t)).max(middle)];
            let (low, high) = follower.range(axis);
            self.end[axis] + t * t * t * most.max(0.0) <= high
                && self.end[axis] + t * t * t * least.min(0.0) >= low
        })
    }

    pub(crate) fn is_over(&self) -> bool {
        self.stop.is_none() && self.time >= self.duration
    }

    /// Position and derivatives one period later. Real-time safe.
    pub(crate) fn advance(&mut self, limits: &Limits, period_s: f64) -> Jet {
        if let Some(stop) = &mut self.stop {
            let jet = stop.advance(period_s);
            if stop.is_over() {
                *self = Self::polynomials(&jet, self.end, limits, period_s);
            }
            return jet;
        }
        self.time += period_s;
        let mut jet = Jet::at_rest(self.end);
        if self.is_over() {
            return jet;
        }
        let t = self.duration - self.time;
        for (axis, [c3, c4, c5]) in self.coefficients.iter().enumerate() {
            jet.position[axis] += t * t * t * (c3 + t * (c4 + t * c5));
            jet.first[axis] = -t * t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5));
            jet.second[axis] = t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5));
            jet.third[axis] = -(6.0 * c3 + t * (24.0 * c4 + t * 60.0 * c5));
        }
        jet
    }
}

//! Motions that reach the limits of an axis, for tests.

use std::collections::VecDeque;

use evolvent_compensation::AxisLimits;
use evolvent_random::Random;

/// Oscillation at the limits: steps of the target velocity through two moving averages, so that jerk is
/// constant within each cycle, and velocity, acceleration and jerk reach but do not exceed their limits.
pub(crate) struct Profile {
    velocity: f64,
    period_s: f64,
    n: [usize; 2],
    wanted: VecDeque<f64>,
    reverse_chance: f64,
    range: f64,
    /// Position, velocity, acceleration, jerk.
    pub(crate) at: [f64; 4],
}

impl Profile {
    pub(crate) fn new(limits: &AxisLimits, period_s: f64, reverse_chance: f64, range: f64) -> Self {
        let AxisLimits {
            velocity,
            acceleration,
            jerk,
        } = *limits;
        let n1 = (2.0 * velocity / acceleration / period_s).ceil() as usize;
        let n2 = (2.0 * acceleration / jerk / period_s).ceil() as usize;
        Self {
            velocity,
            period_s,
            n: [n1, n2],
            wanted: vec![0.0; n1 + n2 + 1].into(),
            reverse_chance,
            range,
            at: [0.0; 4],
        }
    }

    pub(crate) fn step(&mut self, random: &mut Random) -> [f64; 4] {
        let mut wanted = *self.wanted.front().unwrap();
        if random.between(0.0, 1.0) < self.reverse_chance {
            wanted = [-1.0, 0.0, 1.0][random.below(3)];
        }
        if self.at[0].abs() > self.range {
            wanted = -self.at[0].signum();
        }
        self.wanted.push_front(wanted);
        self.wanted.pop_back();
        let [n1, n2] = self.n;
        let steps = self.wanted[0] - self.wanted[n1] - self.wanted[n2] + self.wanted[n1 + n2];
        let t = self.period_s;
        let jerk = self.velocity * steps / (n1 as f64 * n2 as f64 * t * t);
        let [x, v, a, _] = self.at;
        self.at = [
            x + v * t + a * t * t / 2.0 + jerk * t * t * t / 6.0,
            v + a * t + jerk * t * t / 2.0,
            a + jerk * t,
            jerk,
        ];
        self.at
    }
}

//! A motion of one axis within limits, with random changes of velocity.

use evolvent_random::Random;

/// A motion of one axis with random changes of velocity.
pub(crate) struct RandomMotion {
    limits: [f64; 3],
    /// Acceleration changes in steps, as at a joint of exact-path mode.
    has_steps: bool,
    state: [f64; 3],
    wanted: f64,
}

impl RandomMotion {
    /// Starts at rest at a position. `has_steps`: acceleration changes in steps.
    pub(crate) fn from_rest(position: f64, limits: [f64; 3], has_steps: bool) -> Self {
        Self {
            limits,
            has_steps,
            state: [position, 0.0, 0.0],
            wanted: 0.0,
        }
    }

    /// Position, velocity and acceleration.
    pub(crate) fn state(&self) -> [f64; 3] {
        self.state
    }

    /// One period of `t` seconds.
    pub(crate) fn advance(&mut self, random: &mut Random, t: f64) {
        let [max_v, max_a, max_j] = self.limits;
        if random.below(40) == 0 {
            self.wanted = random.between(-0.9, 0.9) * max_v * random.below(4).min(1) as f64;
        }
        let [p, v, a] = self.state;
        let left = self.wanted - v;
        // The acceleration that leaves time to reduce it to zero, and at most the one that reaches the
        // velocity in one period.
        let aim = max_a.min((max_j * left.abs()).sqrt()).min(left.abs() / t) * left.signum();
        let j = if self.has_steps {
            self.state[2] = aim;
            0.0
        } else {
            ((aim - a) / t).clamp(-max_j, max_j)
        };
        let a = self.state[2];
        self.state = [
            p + t * (v + t * (0.5 * a + t * j / 6.0)),
            v + t * (a + 0.5 * t * j),
            (a + t * j).clamp(-max_a, max_a),
        ];
    }
}

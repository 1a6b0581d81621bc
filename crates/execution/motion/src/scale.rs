//! The rate at which a plan is driven.

use evolvent_planner::ScalarState;

/// The rate of plan time and its time derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scale {
    /// Plan time per real time.
    pub(crate) rate: f64,
    /// First derivative, 1/s.
    pub(crate) first: f64,
    /// Second derivative, 1/s2.
    pub(crate) second: f64,
}

impl Scale {
    /// Converts state and jerk of the path parameter from plan time to real time. Real-time safe.
    pub(crate) fn apply(&self, now: ScalarState, jerk: f64) -> (ScalarState, f64) {
        let (s, s1, s2) = (self.rate, self.first, self.second);
        let state = ScalarState {
            x: now.x,
            v: s * now.v,
            a: s * s * now.a + s1 * now.v,
        };
        (state, s * s * s * jerk + 3.0 * s * s1 * now.a + s2 * now.v)
    }
}

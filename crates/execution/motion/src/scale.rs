//! A plan driven at another rate of time.

use evolvent_planner::ScalarState;

/// The rate at which plan time passes, and its derivatives by time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scale {
    /// Plan time per time.
    pub(crate) rate: f64,
    /// First derivative, 1/s.
    pub(crate) first: f64,
    /// Second derivative, 1/s2.
    pub(crate) second: f64,
}

impl Scale {
    /// State and jerk of the path parameter by time, of those by plan time. Real-time safe.
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

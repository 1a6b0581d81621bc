//! A change of speed under constant acceleration and jerk limits.
//!
//! A *change* takes the state `(v, a)` to `(target, 0)` in at most three phases of constant jerk. With
//! `a = 0` at both ends a change by `dv` takes `T = 2 sqrt(dv/J)` for `dv <= A^2/J`, else `A/J + dv/A`, and
//! covers `(v0 + v1)/2 T`. Closed form, no allocation: everything is real-time safe.

/// Iterations of a bisection: enough for 52 bits from any bracket that occurs.
pub(crate) const BISECTIONS: usize = 60;

/// Maximum error by rounding of a speed after a change from a far higher one, as a fraction of the latter.
pub(crate) const SPEED_ROUNDING: f64 = 1e-11;
/// Fraction of the jerk limit that may be added to compensate rounding. Plans leave a larger margin.
pub(crate) const SPARE_JERK: f64 = 1e-4;

/// Limits of the motion along one parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScalarLimits {
    /// Maximum speed, parameter units per s.
    pub velocity: f64,
    /// Maximum magnitude of the second derivative, per s2.
    pub acceleration: f64,
    /// Maximum magnitude of the third derivative, per s3.
    pub jerk: f64,
}

/// Position, speed and acceleration along the parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScalarState {
    /// Parameter since the start of the run.
    pub x: f64,
    /// First derivative by time, per s.
    pub v: f64,
    /// Second derivative by time, per s2.
    pub a: f64,
}

impl ScalarState {
    /// The state after `t` seconds of constant jerk. Real-time safe.
    ///
    /// ```
    /// use evolvent_timing::ScalarState;
    ///
    /// let end = ScalarState { x: 1.0, v: 2.0, a: 4.0 }.after(0.5, 12.0);
    /// assert_eq!(end, ScalarState { x: 2.75, v: 5.5, a: 10.0 });
    /// ```
    #[must_use]
    pub fn after(self, t: f64, jerk: f64) -> Self {
        Self {
            x: self.x + t * (self.v + t * (self.a * 0.5 + t * jerk / 6.0)),
            v: self.v + t * (self.a + t * jerk * 0.5),
            a: self.a + t * jerk,
        }
    }

    /// Speed after the acceleration is brought to zero at once, with jerk limit `jerk`. Below 0 a stop would
    /// run backwards. Real-time safe.
    #[must_use]
    pub fn relaxed_speed(self, jerk: f64) -> f64 {
        self.v + self.a * self.a.abs() / (2.0 * jerk)
    }

    /// Distance of the fastest stop. Real-time safe.
    #[must_use]
    pub fn stopping_distance(self, limits: &ScalarLimits) -> f64 {
        Change::new(self, 0.0, limits).distance
    }
}

/// At most three phases of constant jerk that end with zero acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Change {
    pub(crate) time: [f64; 3],
    pub(crate) jerk: f64,
    pub(crate) distance: f64,
}

impl Change {
    pub(crate) fn new(from: ScalarState, target: f64, limits: &ScalarLimits) -> Self {
        let (a_max, j_max) = (limits.acceleration, limits.jerk);
        let sign = if target >= from.relaxed_speed(j_max) {
            1.0
        } else {
            -1.0
        };
        // The present acceleration would overshoot the target slightly. Returning to it would take far
        // longer, and a stop would have to run backwards.
        let exact = from.a * from.a / (2.0 * (target - from.v).abs());
        if sign * from.a < 0.0 && from.a * (target - from.v) > 0.0 && exact <= j_max * (1.0 + SPARE_JERK) {
            let (time, jerk) = (from.a.abs() / exact, sign * exact);
            return Self {
                time: [time, 0.0, 0.0],
                jerk,
                distance: from.after(time, jerk).x - from.x,
            };
        }
        let (a, dv) = (sign * from.a, sign * (target - from.v));
        let peak = (j_max * dv + 0.5 * a * a).max(0.0).sqrt();
        let time = if peak <= a_max {
            [((peak - a) / j_max).max(0.0), 0.0, peak / j_max]
        } else {
            let level = (dv - (a_max * a_max - 0.5 * a * a) / j_max) / a_max;
            [((a_max - a) / j_max).max(0.0), level.max(0.0), a_max / j_max]
        };
        let jerk = sign * j_max;
        let end = from
            .after(time[0], jerk)
            .after(time[1], 0.0)
            .after(time[2], -jerk);
        Self {
            time,
            jerk,
            distance: end.x - from.x,
        }
    }
}

/// The value nearest to `bad` that still satisfies `fits`, between `good` (which does) and `bad` (which does
/// not).
pub(crate) fn bisect(good: f64, bad: f64, fits: impl Fn(f64) -> bool) -> f64 {
    let (mut good, mut bad) = (good, bad);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (good + bad);
        if middle == good || middle == bad {
            break;
        }
        if fits(middle) {
            good = middle;
        } else {
            bad = middle;
        }
    }
    good
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: ScalarLimits = ScalarLimits {
        velocity: 200.0,
        acceleration: 2000.0,
        jerk: 50_000.0,
    };

    #[test]
    fn stopping_is_shorter_than_slowing_to_one_third() {
        // The hump of the braking distance: v0 sqrt(v0/J) against 4/3 v0 sqrt(2/3 v0/J), jerk only.
        let from = ScalarState {
            x: 0.0,
            v: 30.0,
            a: 0.0,
        };
        let stop = Change::new(from, 0.0, &LIMITS).distance;
        let third = Change::new(from, 10.0, &LIMITS).distance;
        assert!((third / stop - 4.0 / 3.0 * (2.0_f64 / 3.0).sqrt()).abs() < 1e-12);
    }
}

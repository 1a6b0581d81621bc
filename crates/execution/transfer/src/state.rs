//! Position and motion of all axes at one instant.

use evolvent_path::Axes;

/// Position, velocity and acceleration of all nine axes: mm and s, degrees for rotary axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxesState {
    /// Position.
    pub position: Axes,
    /// Velocity per s.
    pub velocity: Axes,
    /// Acceleration per s2.
    pub acceleration: Axes,
}

impl AxesState {
    /// All axes at rest at `position`.
    #[must_use]
    pub fn at_rest(position: Axes) -> Self {
        Self {
            position,
            velocity: Axes::zeros(),
            acceleration: Axes::zeros(),
        }
    }

    /// Whether nothing moves, to the last bit.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.velocity == Axes::zeros() && self.acceleration == Axes::zeros()
    }
}

/// One instant of a transfer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransferPoint {
    /// Position, mm or degrees.
    pub position: Axes,
    /// Velocity per s.
    pub velocity: Axes,
    /// Acceleration per s2.
    pub acceleration: Axes,
    /// Jerk per s3.
    pub jerk: Axes,
}

/// One axis at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct AxisState {
    pub p: f64,
    pub v: f64,
    pub a: f64,
}

impl AxisState {
    pub(crate) fn of(state: &AxesState, axis: usize) -> Self {
        Self {
            p: state.position[axis],
            v: state.velocity[axis],
            a: state.acceleration[axis],
        }
    }

    /// The state after `t` seconds of constant jerk.
    pub(crate) fn after(self, t: f64, jerk: f64) -> Self {
        Self {
            p: self.p + t * (self.v + t * (self.a * 0.5 + t * jerk / 6.0)),
            v: self.v + t * (self.a + t * jerk * 0.5),
            a: self.a + t * jerk,
        }
    }

    /// The speed that remains when acceleration is brought to zero at once with jerk `limit`.
    pub(crate) fn relaxed_speed(self, limit: f64) -> f64 {
        self.v + self.a * self.a.abs() / (2.0 * limit)
    }

    pub(crate) fn is_at_rest(self) -> bool {
        self.v == 0.0 && self.a == 0.0
    }
}

/// Limits of one axis, all above zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AxisLimits {
    pub v: f64,
    pub a: f64,
    pub j: f64,
}

/// One axis of a move.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxisTask {
    pub limits: AxisLimits,
    pub from: AxisState,
    pub to: AxisState,
}

impl AxisTask {
    /// The limits times `fraction`, but at least what the states themselves need: a state at its limit must not
    /// be rejected for its last digit.
    pub(crate) fn usable(&self, fraction: f64) -> AxisLimits {
        let j = self.limits.j * fraction;
        let arriving = AxisState {
            a: -self.to.a,
            ..self.to
        };
        let widest =
            |limit: f64, values: &[f64]| values.iter().fold(limit, |max, value| max.max(value.abs()));
        AxisLimits {
            v: widest(
                self.limits.v * fraction,
                &[
                    self.from.v,
                    self.to.v,
                    self.from.relaxed_speed(j),
                    arriving.relaxed_speed(j),
                ],
            ),
            a: widest(self.limits.a * fraction, &[self.from.a, self.to.a]),
            j,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) use evolvent_random::Random;

    fn within(random: &mut Random, limit: f64) -> f64 {
        limit * (2.0 * random.unit() - 1.0)
    }

    /// Limits over several decades and two states within them.
    pub(crate) fn task(random: &mut Random) -> AxisTask {
        let limits = AxisLimits {
            v: random.log(1.0, 1e3),
            a: random.log(10.0, 1e5),
            j: random.log(100.0, 1e7),
        };
        let mut state = || {
            let a = within(random, limits.a.min((limits.v * limits.j).sqrt()));
            AxisState {
                p: within(random, 300.0),
                v: within(random, limits.v - a * a / (2.0 * limits.j)),
                a,
            }
        };
        let (from, to) = (state(), state());
        AxisTask { limits, from, to }
    }

    #[test]
    fn limits_are_never_less_than_a_state_needs() {
        let mut random = Random::from_state(0x57_0001);
        for _ in 0..1000 {
            let mut task = task(&mut random);
            task.from = AxisState {
                p: 0.0,
                v: task.limits.v,
                a: 0.0,
            };
            let usable = task.usable(0.999);
            assert_eq!(usable.v, task.limits.v);
            assert_eq!(usable.j, 0.999 * task.limits.j);
        }
    }
}

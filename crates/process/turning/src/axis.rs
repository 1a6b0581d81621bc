//! One axis in jerk-limited motion to a target that may change at any moment.

use evolvent_timing::{Outcome, Profile, ScalarLimits, ScalarState};

/// Fraction of the jerk limit that is planned: third differences of positions are noisy.
const JERK_FRACTION: f64 = 0.99;
/// A distance that no cut reaches, mm.
const FAR_MM: f64 = 1e6;

/// Position and derivatives of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisPoint {
    /// mm.
    pub position: f64,
    /// mm/s.
    pub velocity: f64,
    /// mm/s2.
    pub acceleration: f64,
    /// mm/s3.
    pub jerk: f64,
}

/// An axis that moves to its target within velocity, acceleration and jerk limits.
///
/// A target behind the axis, or too near to stop at, is reached by stopping first. Each change costs a closed
/// form or a bisection of fixed length, without allocation: real-time safe.
///
/// ```
/// use evolvent_turning::{AxisDrive, ScalarLimits};
/// let limits = ScalarLimits { velocity: 200.0, acceleration: 2000.0, jerk: 50_000.0 };
/// let mut axis = AxisDrive::new(0.0, &limits);
/// axis.aim(5.0, 50.0);
/// let mut periods = 0;
/// while !axis.has_arrived() {
///     assert!(axis.advance(0.001).velocity <= 50.0);
///     periods += 1;
/// }
/// assert!(axis.point().position == 5.0 && periods < 200);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct AxisDrive {
    limits: ScalarLimits,
    /// Start of the profile; `sign` is its direction.
    origin: f64,
    sign: f64,
    profile: Profile,
    time: f64,
    target: f64,
    speed: f64,
    /// The profile only brakes, because the target needs another profile after it.
    turns_back: bool,
    /// Last point from a leading drive; `None` while the axis moves by itself.
    led: Option<AxisPoint>,
}

impl AxisDrive {
    /// Creates an axis at rest at a position. `limits` are those of the axis.
    #[must_use]
    pub fn new(position: f64, limits: &ScalarLimits) -> Self {
        Self {
            limits: ScalarLimits {
                jerk: limits.jerk * JERK_FRACTION,
                ..*limits
            },
            origin: position,
            sign: 1.0,
            profile: Profile::at_rest(0.0),
            time: 0.0,
            target: position,
            speed: 0.0,
            turns_back: false,
            led: None,
        }
    }

    /// Follows another drive, which moves forwards and passes each of its points, until the next target or
    /// stop.
    pub(crate) fn lead(&mut self, to: AxisPoint) {
        self.led = Some(to);
        (self.sign, self.target, self.speed) = (1.0, to.position, f64::NAN);
    }

    /// Moves to `target` at `speed_mm_s` at most; a speed of 0 stops before it.
    pub fn aim(&mut self, target: f64, speed_mm_s: f64) {
        let speed_mm_s = if speed_mm_s > 0.0 {
            speed_mm_s.min(self.limits.velocity)
        } else {
            0.0
        };
        if target.is_nan() || (target == self.target && speed_mm_s == self.speed) {
            return;
        }
        let now = self.point();
        (self.target, self.speed, self.led) = (target, speed_mm_s, None);
        self.solve(now);
    }

    /// Stops as soon as the limits allow.
    pub fn stop(&mut self) {
        self.aim(self.target, 0.0);
    }

    fn solve(&mut self, now: AxisPoint) {
        let moving = now.velocity != 0.0 || now.acceleration != 0.0;
        let distance = self.target - now.position;
        if !moving {
            self.sign = if distance < 0.0 { -1.0 } else { 1.0 };
        }
        let from = ScalarState {
            x: 0.0,
            v: (self.sign * now.velocity).max(0.0),
            a: self.sign * now.acceleration,
        };
        (self.origin, self.time, self.turns_back) = (now.position, 0.0, false);
        let distance = self.sign * distance;
        let limits = ScalarLimits {
            velocity: self.speed,
            ..self.limits
        };
        if self.speed <= 0.0 || distance <= 0.0 {
            self.turns_back = distance != 0.0;
            self.profile = if moving {
                Profile::brake(from, FAR_MM, 0.0, &self.limits)
            } else {
                Profile::at_rest(0.0)
            };
            return;
        }
        let profile = Profile::solve(from, distance, 0.0, 0.0, &limits);
        if profile.outcome() == Outcome::Overruns {
            self.turns_back = true;
            self.profile = Profile::brake(from, FAR_MM, 0.0, &self.limits);
        } else {
            self.profile = profile;
        }
    }

    /// Advances by a period and returns the new point.
    pub fn advance(&mut self, period_s: f64) -> AxisPoint {
        self.time += period_s;
        if let Some(point) = self.led {
            return point;
        }
        if self.time >= self.profile.duration() && self.turns_back && self.speed > 0.0 {
            // Only the rest of this period is lost.
            let point = self.point();
            self.origin = point.position;
            self.profile = Profile::at_rest(0.0);
            self.time = 0.0;
            self.solve(point);
            return point;
        }
        self.point()
    }

    /// The present point.
    #[must_use]
    pub fn point(&self) -> AxisPoint {
        if let Some(point) = self.led {
            return point;
        }
        if self.time >= self.profile.duration() {
            let end = if self.turns_back || self.speed <= 0.0 {
                self.origin + self.sign * self.profile.end().x
            } else {
                self.target
            };
            return AxisPoint {
                position: end,
                ..AxisPoint::default()
            };
        }
        let (state, jerk) = self.profile.at(self.time);
        AxisPoint {
            position: self.origin + self.sign * state.x,
            velocity: self.sign * state.v,
            acceleration: self.sign * state.a,
            jerk: self.sign * jerk,
        }
    }

    /// Whether the axis is at rest at its target.
    #[must_use]
    pub fn has_arrived(&self) -> bool {
        self.led.is_none() && self.time >= self.profile.duration() && self.point().position == self.target
    }

    /// Whether the axis is at rest.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        match self.led {
            Some(point) => point.velocity == 0.0 && point.acceleration == 0.0,
            None => self.time >= self.profile.duration() && !(self.turns_back && self.speed > 0.0),
        }
    }

    /// The target.
    #[must_use]
    pub fn target(&self) -> f64 {
        self.target
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: ScalarLimits = ScalarLimits {
        velocity: 200.0,
        acceleration: 3000.0,
        jerk: 100_000.0,
    };

    #[test]
    fn arbitrary_targets_keep_the_limits() {
        let seed = 0x5eed_0101_u64;
        println!("seed {seed:#x}");
        let mut random = evolvent_random::Random::from_state(seed);
        let mut unit = || random.unit();
        for period in [0.001, 0.000_25] {
            let mut axis = AxisDrive::new(3.0, &LIMITS);
            let mut past = [3.0; 4];
            let mut arrivals = 0;
            for _ in 0..200_000 {
                if unit() < 0.01 {
                    let target = 40.0 * unit() - 20.0;
                    let speed = if unit() < 0.2 { 0.0 } else { 250.0 * unit().powi(3) };
                    axis.aim(target, speed);
                } else if unit() < 0.05 {
                    axis.aim(axis.target(), 5.0 * unit());
                }
                past.rotate_right(1);
                past[0] = axis.advance(period).position;
                arrivals += u32::from(axis.has_arrived());
                let v = (past[0] - past[1]) / period;
                let a = (past[0] - 2.0 * past[1] + past[2]) / period.powi(2);
                let j = (past[0] - 3.0 * past[1] + 3.0 * past[2] - past[3]) / period.powi(3);
                assert!(v.abs() <= 200.0 * 1.000_001, "{v}");
                assert!(a.abs() <= 3000.0 * 1.001, "{a}");
                assert!(j.abs() <= 100_000.0 * 1.02, "{j}");
            }
            assert!(arrivals > 1000, "{arrivals}");
        }
    }

    #[test]
    fn the_target_is_reached_bit_for_bit() {
        let mut axis = AxisDrive::new(0.1, &LIMITS);
        axis.aim(17.3, 50.0);
        for _ in 0..50 {
            axis.advance(0.001);
        }
        axis.aim(-4.7, 80.0);
        assert!(!axis.has_arrived());
        for _ in 0..2000 {
            axis.advance(0.001);
        }
        assert!(axis.has_arrived() && axis.is_at_rest());
        assert_eq!(axis.point().position, -4.7);
    }
}

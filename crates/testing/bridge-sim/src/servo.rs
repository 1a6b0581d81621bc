//! The position loop of a drive with its axis: a system of second order.

/// Settings of a position loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoSettings {
    /// Undamped natural frequency, Hz.
    pub natural_frequency_hz: f64,
    /// Damping ratio: 1 is critical.
    pub damping: f64,
    /// Fraction of the target's velocity that is fed forward, 0 to 1. At constant velocity the axis lags by
    /// `2 damping (1 - feed_forward) / (2 pi f)` seconds.
    pub feed_forward: f64,
    /// Maximum acceleration of motor and axis, mm/s2 or degrees/s2.
    pub strongest: f64,
}

impl Default for ServoSettings {
    /// 40 Hz, nearly critical damping, most of the velocity fed forward.
    fn default() -> Self {
        Self {
            natural_frequency_hz: 40.0,
            damping: 0.9,
            feed_forward: 0.9,
            strongest: f64::INFINITY,
        }
    }
}

/// `x'' = w^2 (target - x) + 2 zeta w (feed_forward target' - x')`, limited to the maximum acceleration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Servo {
    /// Position.
    pub position: f64,
    /// Velocity.
    pub velocity: f64,
    /// Acceleration.
    pub acceleration: f64,
}

impl Servo {
    /// An axis at rest.
    #[must_use]
    pub const fn at(position: f64) -> Self {
        Self {
            position,
            velocity: 0.0,
            acceleration: 0.0,
        }
    }

    /// Simulates one period in which the target moves from `from` to `to` at constant velocity. Fourth-order
    /// Runge-Kutta in steps of less than a tenth of a radian of the natural frequency.
    pub fn step(&mut self, settings: &ServoSettings, from: f64, to: f64, period_s: f64) {
        let w = core::f64::consts::TAU * settings.natural_frequency_hz;
        let steps = (10.0 * w * period_s).ceil().clamp(1.0, 1000.0);
        let h = period_s / steps;
        let target_velocity = (to - from) / period_s;
        let law = |time_s: f64, position: f64, velocity: f64| {
            let target = from + target_velocity * time_s;
            let wanted = w * w * (target - position)
                + 2.0 * settings.damping * w * (settings.feed_forward * target_velocity - velocity);
            wanted.clamp(-settings.strongest, settings.strongest)
        };
        let mut time_s = 0.0;
        for _ in 0..steps as usize {
            let (x, v) = (self.position, self.velocity);
            let a1 = law(time_s, x, v);
            let (x2, v2) = (x + 0.5 * h * v, v + 0.5 * h * a1);
            let a2 = law(time_s + 0.5 * h, x2, v2);
            let (x3, v3) = (x + 0.5 * h * v2, v + 0.5 * h * a2);
            let a3 = law(time_s + 0.5 * h, x3, v3);
            let (x4, v4) = (x + h * v3, v + h * a3);
            let a4 = law(time_s + h, x4, v4);
            self.position = x + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4);
            self.velocity = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4);
            time_s += h;
        }
        self.acceleration = law(period_s, self.position, self.velocity);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 1e-3;

    /// The overshoot of a step is `exp(-pi zeta / sqrt(1 - zeta^2))`, at `pi / (w sqrt(1 - zeta^2))`.
    #[test]
    fn step_overshoot_and_its_time_match_theory() {
        for (frequency, damping) in [(20.0, 0.4), (40.0, 0.6), (80.0, 0.3)] {
            let settings = ServoSettings {
                natural_frequency_hz: frequency,
                damping,
                ..ServoSettings::default()
            };
            let mut servo = Servo::at(0.0);
            let (mut peak, mut peak_s) = (0.0, 0.0);
            let period_s = 1e-5;
            for i in 1..20_000 {
                servo.step(&settings, 1.0, 1.0, period_s);
                if servo.position > peak {
                    (peak, peak_s) = (servo.position, f64::from(i) * period_s);
                }
            }
            let root = (1.0 - damping * damping).sqrt();
            let overshoot = (-core::f64::consts::PI * damping / root).exp();
            assert!((peak - 1.0 - overshoot).abs() < 1e-5, "{peak} {overshoot}");
            assert!((peak_s - 0.5 / (frequency * root)).abs() < 3.0 * period_s);
        }
    }

    #[test]
    fn constant_velocity_lags_by_missing_feedforward() {
        for feed_forward in [0.0, 0.9, 1.0] {
            let settings = ServoSettings {
                feed_forward,
                ..ServoSettings::default()
            };
            let (mut servo, mut target) = (Servo::at(0.0), 0.0);
            for _ in 0..2000 {
                let next = target + 0.2;
                servo.step(&settings, target, next, PERIOD_S);
                target = next;
            }
            let w = core::f64::consts::TAU * settings.natural_frequency_hz;
            let trail = 200.0 * 2.0 * settings.damping * (1.0 - feed_forward) / w;
            assert!((target - servo.position - trail).abs() < 1e-6, "{feed_forward}");
        }
    }

    #[test]
    fn it_never_does_more_than_the_motor_can() {
        let settings = ServoSettings {
            strongest: 100.0,
            ..ServoSettings::default()
        };
        let mut servo = Servo::at(0.0);
        for _ in 0..100 {
            let before = servo.velocity;
            servo.step(&settings, 50.0, 50.0, PERIOD_S);
            assert!((servo.velocity - before).abs() <= 100.0 * PERIOD_S * (1.0 + 1e-9));
        }
    }
}

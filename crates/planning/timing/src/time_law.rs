//! The path parameter as a function of time over one piece.

use crate::change::ScalarState;

/// Maximum `|c t^2|` for the power series; beyond it `libm` is used.
const SERIES_RANGE: f64 = 1.0;
/// Growth of the speed from which the closed form is the initial guess of the duration.
const CLOSED_FORM_GROWTH: f64 = 4.0;
/// Maximum iterations of the inverse functions. Newton's method takes 2 to 5; bisections may interleave.
const MAX_ITERATIONS: usize = 60;

/// The path parameter as a function of time; `x` is counted from the start of the piece.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TimeLaw {
    /// `u'' = b + c x`: the acceleration is linear in the parameter, so the jerk is `c u'`. With `v` at the
    /// start, `x(t) = v sinh(w t)/w + b (cosh(w t) - 1)/w^2`, `w^2 = c` (sine and cosine if `c` is negative).
    LinearAcceleration {
        /// Speed at the start.
        v: f64,
        /// Acceleration at the start.
        b: f64,
        /// Change of acceleration per unit of the parameter.
        c: f64,
    },
    /// Constant jerk, for the ends of a motion, where `c = u'''/u'` would be infinite.
    ConstantJerk {
        /// Speed at the start.
        v: f64,
        /// Acceleration at the start.
        a: f64,
        /// Jerk.
        j: f64,
    },
}

impl TimeLaw {
    /// The same law executed `rate` times as fast, over the same length. Real-time safe.
    ///
    /// ```
    /// use evolvent_timing::TimeLaw;
    ///
    /// let law = TimeLaw::LinearAcceleration { v: 10.0, b: 4.0, c: -3.0 };
    /// let (at_full, _) = law.at(0.2);
    /// let (at_half, _) = law.slowed_down(0.5).at(0.4);
    /// assert!((at_full.x - at_half.x).abs() < 1e-12 && (at_full.v - 2.0 * at_half.v).abs() < 1e-12);
    /// ```
    #[must_use]
    pub fn slowed_down(self, rate: f64) -> Self {
        let square = rate * rate;
        match self {
            Self::ConstantJerk { v, a, j } => Self::ConstantJerk {
                v: rate * v,
                a: square * a,
                j: square * rate * j,
            },
            Self::LinearAcceleration { v, b, c } => Self::LinearAcceleration {
                v: rate * v,
                b: square * b,
                c: square * c,
            },
        }
    }

    /// State and jerk `t` seconds after the start of the piece. Real-time safe: closed form, no allocation.
    #[must_use]
    pub fn at(&self, t: f64) -> (ScalarState, f64) {
        match *self {
            Self::LinearAcceleration { v, b, c } => {
                let (sine, versine) = waves(c, t);
                let x = v * sine + b * versine;
                let speed = (v + (c * v * versine + b * sine)).max(0.0);
                let state = ScalarState {
                    x,
                    v: speed,
                    a: b + c * x,
                };
                (state, c * speed)
            }
            Self::ConstantJerk { v, a, j } => {
                let state = ScalarState { x: 0.0, v, a }.after(t, j);
                (
                    ScalarState {
                        v: state.v.max(0.0),
                        ..state
                    },
                    j,
                )
            }
        }
    }

    /// The time in `0..=duration_s` at which position `x` is reached, for a law that does not run backwards.
    /// Real-time safe: bounded iterations, no allocation.
    #[must_use]
    pub fn time_to(&self, x: f64, duration_s: f64) -> f64 {
        if x.is_nan() || x <= 0.0 {
            return 0.0;
        }
        let (mut low, mut high) = (0.0, duration_s);
        let end = self.at(duration_s).0;
        if x >= end.x {
            return duration_s;
        }
        let mut t = duration_s * x / end.x;
        for _ in 0..MAX_ITERATIONS {
            let now = self.at(t).0;
            let miss = now.x - x;
            if miss > 0.0 {
                high = t;
            } else {
                low = t;
            }
            let newton = t - miss / now.v;
            if (newton - t).abs() <= f64::EPSILON * duration_s {
                return t;
            }
            let next = if newton > low && newton < high {
                newton
            } else {
                0.5 * (low + high)
            };
            t = next;
        }
        t
    }

    /// The duration over `length`, for a law that runs forwards throughout. If rounding stops it just before
    /// the end, the time of its maximum.
    pub(crate) fn duration(&self, length: f64) -> f64 {
        let mut t = match *self {
            Self::LinearAcceleration { v, b, c } => {
                let end = (v * v + length * (2.0 * b + c * length)).max(0.0).sqrt();
                let middle = (v * v + length * (b + 0.25 * c * length)).max(0.0).sqrt();
                if end > CLOSED_FORM_GROWTH * v && c > 0.0 {
                    // Newton's method alone takes one iteration per unit of w t here, w^2 = c. The length
                    // divided by the sum of the speeds at both ends is tanh(w t/2)/w.
                    let w = c.sqrt();
                    2.0 * libm::atanh((w * length / (v + end)).min(1.0 - f64::EPSILON)) / w
                } else {
                    length / ((v + 4.0 * middle + end) / 6.0).max(v).max(1e-300)
                }
            }
            Self::ConstantJerk { v, a, j } => {
                if v == 0.0 && a == 0.0 {
                    return libm::cbrt(6.0 * length / j);
                }
                length / v.max(1e-300)
            }
        };
        let (mut low, mut high) = (0.0, f64::INFINITY);
        for _ in 0..MAX_ITERATIONS {
            let now = self.at(t).0;
            let miss = now.x - length;
            if miss > 0.0 {
                high = t;
            } else {
                low = t;
            }
            let newton = t - miss / now.v;
            if (newton - t).abs() <= 2.0 * f64::EPSILON * t {
                return t;
            }
            let next = if newton > low && newton < high {
                newton
            } else if high.is_finite() {
                0.5 * (low + high)
            } else {
                2.0 * t
            };
            t = next;
        }
        t
    }
}

/// `sinh(w t)/w` and `(cosh(w t) - 1)/w^2` for `w^2 = c` of either sign.
fn waves(c: f64, t: f64) -> (f64, f64) {
    let z = c * t * t;
    if z.abs() <= SERIES_RANGE {
        let sine = horner(z, &SINE);
        let versine = horner(z, &VERSINE);
        (t * sine, t * t * versine)
    } else if z > 0.0 {
        let w = c.sqrt();
        // cosh - 1 = 2 sinh(half)^2 without cancellation.
        let half = libm::sinh(0.5 * w * t);
        (libm::sinh(w * t) / w, 2.0 * half * half / c)
    } else {
        let w = (-c).sqrt();
        let half = libm::sin(0.5 * w * t);
        (libm::sin(w * t) / w, -2.0 * half * half / c)
    }
}

fn horner(z: f64, coefficients: &[f64]) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * z + c)
}

/// 1/(2k+1)!
const SINE: [f64; 9] = inverse_factorials(1);
/// 1/(2k+2)!
const VERSINE: [f64; 9] = inverse_factorials(2);

const fn inverse_factorials(first: u32) -> [f64; 9] {
    let mut out = [0.0; 9];
    let (mut product, mut n, mut k) = (1.0, 1, 0);
    while k < 9 {
        while n <= first + 2 * k as u32 {
            product *= n as f64;
            n += 1;
        }
        out[k] = 1.0 / product;
        k += 1;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use evolvent_random::Random;

    #[test]
    fn durations_are_accurate_for_large_speed_growth() {
        // From a speed v without acceleration x = v sinh(w t)/w, so w t = asinh(w x/v).
        for growth in [1e-9, 1e-3, 1.0, 1e3, 1e6] {
            for c in [1e-3, 1.0, 3428.0, 1e6_f64] {
                let (v, w) = (0.03, c.sqrt());
                let length = growth * v / w;
                let expected = libm::asinh(growth) / w;
                let found = TimeLaw::LinearAcceleration { v, b: 0.0, c }.duration(length);
                assert!(
                    (found / expected - 1.0).abs() < 1e-9,
                    "{growth} {c}: {found} {expected}"
                );
            }
        }
    }

    #[test]
    fn linear_acceleration_solves_its_equation() {
        let seed = 0x1a_0001;
        println!("seed {seed:#x}");
        let mut random = Random::from_state(seed);
        for case in 0..500 {
            let (v, b) = (random.log(1e-3, 300.0), 2000.0 * (random.unit() - 0.5));
            let t = random.log(1e-5, 0.1);
            // z of either sign, from tiny to beyond the range of the series.
            let c = random.log(1e-6, 6.0) / (t * t) * (random.unit() - 0.5).signum();
            let law = TimeLaw::LinearAcceleration { v, b, c };
            // Fourth-order Runge-Kutta in 2000 steps, independent of any closed form.
            let (mut x, mut speed) = (0.0, v);
            let h = t / 2000.0;
            for _ in 0..2000 {
                let f = |x: f64| b + c * x;
                let (k1, l1) = (speed, f(x));
                let (k2, l2) = (speed + 0.5 * h * l1, f(x + 0.5 * h * k1));
                let (k3, l3) = (speed + 0.5 * h * l2, f(x + 0.5 * h * k2));
                let (k4, l4) = (speed + h * l3, f(x + h * k3));
                x += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
                speed += h / 6.0 * (l1 + 2.0 * l2 + 2.0 * l3 + l4);
            }
            if speed < 0.0 {
                continue;
            }
            let (state, jerk) = law.at(t);
            let size = v * t + b.abs() * t * t;
            assert!(
                (state.x - x).abs() <= 1e-10 * size,
                "case {case}: {} {x}",
                state.x
            );
            assert!((state.v - speed).abs() <= 1e-9 * size / t, "case {case}");
            assert!(
                (state.a - (b + c * x)).abs() <= 1e-8 * (b.abs() + c.abs() * size),
                "case {case}"
            );
            assert!(
                (jerk - c * speed).abs() <= 1e-8 * c.abs() * size / t,
                "case {case}"
            );
        }
    }

    #[test]
    fn time_to_and_duration_invert_every_law() {
        let seed = 0x1a_0002;
        println!("seed {seed:#x}");
        let mut random = Random::from_state(seed);
        for case in 0..3000 {
            let v = random.log(1e-3, 300.0);
            let length = random.log(1e-6, 10.0);
            // Any law that keeps at least 1 % of its speed throughout.
            let b = v * v / length * (random.unit() - 0.4);
            let c = v * v / (length * length) * (random.unit() - 0.2);
            let law = TimeLaw::LinearAcceleration { v, b, c };
            if (0..=100).any(|k| {
                let x = length * f64::from(k) / 100.0;
                v * v + x * (2.0 * b + c * x) < 1e-4 * v * v
            }) {
                continue;
            }
            let duration = law.duration(length);
            assert!(
                (law.at(duration).0.x - length).abs() <= 1e-13 * length,
                "case {case}"
            );
            for _ in 0..10 {
                let t = duration * random.unit();
                let x = law.at(t).0.x;
                assert!(
                    (law.time_to(x, duration) - t).abs() <= 1e-9 * duration,
                    "case {case}"
                );
            }
        }
        // From rest, where the speed is zero: x = j t^3 / 6.
        let law = TimeLaw::ConstantJerk {
            v: 0.0,
            a: 0.0,
            j: 6.0,
        };
        let duration = law.duration(8.0);
        assert!((duration - 2.0).abs() < 1e-14);
        assert!((law.time_to(1.0, duration) - 1.0).abs() < 1e-13);
        assert!((law.time_to(1e-12, duration) - 1e-4).abs() < 1e-13);
        // And to rest.
        let law = TimeLaw::ConstantJerk {
            v: 12.0,
            a: -12.0,
            j: 6.0,
        };
        assert!((law.time_to(7.0, 2.0) - 1.0).abs() < 1e-13);
        assert!((law.at(2.0).0.v).abs() < 1e-13);
    }
}

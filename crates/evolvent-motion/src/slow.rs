//! Slowing down to rest without a planner.
//!
//! Path time `tau` is slowed against time: `tau' = s` from 1 to 0. A plan scaled by a constant `s` keeps every limit
//! with room to spare, acceleration as `s^2` and jerk as `s^3`; so `1 - s` may grow about as fast as it is large.
//! It starts as `d0 (cosh(k t) - 1)`, too little to be seen where the plan is at its limits, and is taken to rest by
//! a polynomial once half of the speed is gone. Slower than a new plan, but it needs nobody.

use evolvent_machine::Limits;
use evolvent_path::AXES;
use evolvent_plan::ScalarState;

/// Share of speed with which the growth starts: what it takes beyond a limit stays below half a thousandth.
const START: f64 = 0.002;
/// Share of speed at which the polynomial takes over.
const HALF: f64 = 0.5;

/// The scale of path time and its derivatives by time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scale {
    /// Path time per time.
    pub(crate) rate: f64,
    /// First derivative, 1/s.
    pub(crate) first: f64,
    /// Second derivative, 1/s2.
    pub(crate) second: f64,
}

impl Scale {
    /// State and jerk of the path parameter by time, of those by path time. Real-time safe.
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

/// The slowing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Slow {
    growth: f64,
    half_time: f64,
    time: f64,
}

impl Slow {
    /// As fast as the axes allow whatever the plan does. Real-time safe.
    pub(crate) fn new(limits: &Limits) -> Self {
        let mut growth = f64::INFINITY;
        for i in 0..AXES {
            if limits.present[i] {
                let (v, a, j) = (limits.velocity[i], limits.acceleration[i], limits.jerk[i]);
                growth = growth.min(0.4 * j / a).min(0.8 * (j / v).sqrt()).min(a / v);
            }
        }
        let growth = if growth.is_finite() { growth } else { 1.0 };
        let half_time = libm::acosh(1.0 + HALF / START) / growth;
        Self {
            growth,
            half_time,
            time: 0.0,
        }
    }

    fn duration(&self) -> f64 {
        self.half_time + 2.0 / self.growth
    }

    /// Whether path time stands still.
    pub(crate) fn is_over(&self) -> bool {
        self.time >= self.duration()
    }

    /// Advances by `period`; returns how far path time advances. Real-time safe.
    pub(crate) fn advance(&mut self, period: f64) -> f64 {
        let before = self.path_time(self.time);
        self.time = (self.time + period).min(self.duration());
        self.path_time(self.time) - before
    }

    fn path_time(&self, t: f64) -> f64 {
        let k = self.growth;
        let part = t.min(self.half_time);
        let first = part - START * (libm::sinh(k * part) / k - part);
        let (s, span) = (((t - part) * k * 0.5).min(1.0), 2.0 / k);
        first + span * s * (0.5 - s * (0.5 + s * (1.0 / 3.0 - s * (1.0 - s * (0.7 - s / 6.0)))))
    }

    /// The scale now. Real-time safe.
    pub(crate) fn scale(&self) -> Scale {
        let (k, t) = (self.growth, self.time);
        if t < self.half_time {
            let (sinh, cosh) = (libm::sinh(k * t), libm::cosh(k * t));
            return Scale {
                rate: 1.0 - START * (cosh - 1.0),
                first: -START * k * sinh,
                second: -START * k * k * cosh,
            };
        }
        // Meets the growth with rate 1/2, first -k/2 and second -k^2/2, all but for START, and ends at rest.
        let s = (0.5 * k * (t - self.half_time)).min(1.0);
        Scale {
            rate: 0.5 - s * (1.0 + s * (1.0 - s * (4.0 - s * (3.5 - s)))),
            first: 0.5 * k * -(1.0 + s * (2.0 - s * (12.0 - s * (14.0 - 5.0 * s)))),
            second: 0.25 * k * k * -(2.0 - s * (24.0 - s * (42.0 - 20.0 * s))),
        }
    }
}

#[cfg(test)]
mod tests {
    use evolvent_path::Axes;

    use super::*;

    fn slow() -> Slow {
        Slow::new(&Limits {
            present: [true; AXES],
            velocity: Axes::repeat(200.0),
            acceleration: Axes::repeat(2000.0),
            jerk: Axes::repeat(50_000.0),
            travel_min: Axes::repeat(-1e4),
            travel_max: Axes::repeat(1e4),
            home: Axes::zeros(),
        })
    }

    #[test]
    fn path_time_slows_to_rest_and_its_derivatives_are_those_of_its_values() {
        let mut slow = slow();
        let (dt, mut tau) = (1e-4, vec![0.0]);
        let mut rates = Vec::new();
        while !slow.is_over() {
            let step = slow.advance(dt);
            assert!(step >= -1e-15, "backwards by {step}");
            tau.push(tau[tau.len() - 1] + step);
            rates.push(slow.scale());
        }
        for k in 1..rates.len() - 1 {
            let measured = (tau[k + 2] - tau[k]) / (2.0 * dt);
            assert!(
                (measured - rates[k].rate).abs() < 1e-6,
                "{k}: {measured} {:?}",
                rates[k]
            );
            let measured = (rates[k + 1].rate - rates[k - 1].rate) / (2.0 * dt);
            assert!(
                (measured - rates[k].first).abs() < 1e-3 * 10.0,
                "{k}: {measured} {:?}",
                rates[k]
            );
        }
        let last = rates[rates.len() - 1];
        assert!(last.rate.abs() < 1e-12 && last.first.abs() < 1e-9 && last.second.abs() < 1e-6);
    }

    #[test]
    fn whatever_the_plan_does_the_limits_are_kept_to_what_the_guard_lets_pass() {
        let mut slow = slow();
        let (v, a, j) = (200.0, 2000.0, 50_000.0);
        while !slow.is_over() {
            slow.advance(1e-4);
            let Scale { rate, first, second } = slow.scale();
            // The worst plan: everything at its limit, with the worst sign.
            let acceleration = rate * rate * a + first.abs() * v;
            let jerk = rate * rate * rate * j + 3.0 * rate * first.abs() * a + second.abs() * v;
            assert!(acceleration <= 1.0008 * a, "{acceleration} at {rate}");
            assert!(jerk <= 1.015 * j, "{jerk} at {rate}");
        }
    }
}

//! Slowing down at once, while the planner is asked for a plan that brakes; and down to rest where it gives none.
//!
//! Path time `tau` is slowed against time by `tau' = s`: `s'' = -g` from `s = 1` for a while, then `s'' = g` until `s' = 0`,
//! and there it stays: a plan scaled by a constant below 1 keeps every limit. With the plan's derivatives by path time
//! `q', q'', q'''` an axis sees
//!
//! ```text
//!   acceleration  q'' s^2 + q' s'
//!   jerk          q''' s^3 + 3 q'' s s' + q' s''
//! ```
//!
//! so `g` is as large as the room that the plan leaves on the stretch ahead: on a long line at constant speed braking begins
//! with the axis's own jerk, and where the plan is at its limits already there is none. To rest it is `g = 1/h^2` for `h`
//! seconds each, and `h` is as short as the plan allows; `s` begins at what an earlier slowing has left.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Jet};

use crate::slow::Scale;

/// Share of a limit that may be used; between two samples of the plan is a little more.
const SHARE: f64 = 0.97;
/// Largest loss of speed, as a share.
const MOST_LOSS: f64 = 0.5;
/// Least loss of speed that is worth it.
const LEAST_LOSS: f64 = 1e-3;
/// Least scale, its square and its cube.
const LEAST: [f64; 3] = [0.5, 0.25, 0.125];

/// Samples of the plan, evenly over the way to rest.
const REST_SAMPLES: f64 = 16.0;
/// Rounding that `g` may lose against `1/h^2`.
const REST_ROUNDING: f64 = 1e-9;

/// The slowing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ease {
    strength: f64,
    half: f64,
    time: f64,
    /// The scale with which it begins.
    base: f64,
    to_rest: bool,
}

/// The room that a plan leaves, gathered sample by sample. Real-time safe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Room {
    strength: f64,
    half: f64,
    base: f64,
    to_rest: bool,
}

impl Room {
    /// For slowing that grows for `half` seconds and fades away for as long.
    pub(crate) fn new(half: f64) -> Self {
        Self {
            strength: MOST_LOSS / (half * half),
            half,
            base: 1.0,
            to_rest: false,
        }
    }

    /// For slowing from the scale `base` to rest, in twice `half` seconds.
    pub(crate) fn to_rest(half: f64, base: f64) -> Self {
        Self {
            strength: 1.0 / (half * half),
            half,
            base,
            to_rest: true,
        }
    }

    /// Path time in which the plan has to be known.
    pub(crate) fn span(&self) -> f64 {
        if self.to_rest {
            self.base * self.half
        } else {
            2.0 * self.half
        }
    }

    /// In how many parts a stretch of the plan, this long in path time, is looked at: one sample more.
    pub(crate) fn parts(&self, stretch: f64) -> u32 {
        if self.to_rest {
            ((REST_SAMPLES * stretch / self.span()).ceil() as u32).clamp(2, REST_SAMPLES as u32)
        } else {
            2
        }
    }

    /// Takes in the plan's derivatives by path time, `ahead` seconds from now.
    pub(crate) fn include(&mut self, limits: &Limits, plan: &Jet, ahead: f64) {
        // While slowing grows less path than time passes, but no less than nine tenths of it; to rest five sixths.
        let (share, least, fades_from) = if self.to_rest {
            (Ease::REST_SHARE, [0.0; 3], 0.8)
        } else {
            (SHARE, LEAST, 0.9)
        };
        let passed = ahead / self.base;
        let (grows, fades) = (passed <= self.half, passed >= fades_from * self.half);
        for i in 0..AXES {
            if !limits.present[i] {
                continue;
            }
            let base = self.base;
            let (v, a, j) = (
                plan.first[i] * base,
                plan.second[i] * (base * base),
                plan.third[i] * (base * base * base),
            );
            let (most_a, most_j) = (share * limits.acceleration[i], share * limits.jerk[i]);
            for part in [least[1], 1.0] {
                self.bound(part * a, -v * self.half, most_a);
            }
            for sign in [(grows, -1.0), (fades, 1.0)]
                .into_iter()
                .filter(|(counts, _)| *counts)
                .map(|(_, sign)| sign)
            {
                for part in [least[2], 1.0] {
                    for turn in [0.0, -3.0 * a * self.half] {
                        self.bound(part * j, sign * v + turn, most_j);
                    }
                }
            }
        }
    }

    /// Keeps `|base + strength slope| <= most`.
    fn bound(&mut self, base: f64, slope: f64, most: f64) {
        if slope != 0.0 {
            let room = (most - base * slope.signum()) / slope.abs();
            self.strength = self.strength.min(room.max(0.0));
        }
    }

    /// The slowing that fits; none where that is next to nothing.
    pub(crate) fn ease(&self) -> Option<Ease> {
        let loss = self.strength * self.half * self.half;
        (loss >= LEAST_LOSS).then_some(Ease {
            strength: self.strength,
            half: self.half,
            time: 0.0,
            base: 1.0,
            to_rest: false,
        })
    }

    /// Half of the way's duration, s.
    pub(crate) fn half(&self) -> f64 {
        self.half
    }

    /// The way to rest, if the plan leaves room for it; else by how much longer it has to be at the least.
    pub(crate) fn rest(&self) -> Result<Ease, f64> {
        let needed = 1.0 / (self.half * self.half);
        if self.strength < needed * (1.0 - REST_ROUNDING) {
            return Err((needed / self.strength).sqrt());
        }
        Ok(Ease {
            strength: needed,
            half: self.half,
            time: 0.0,
            base: self.base,
            to_rest: true,
        })
    }
}

impl Ease {
    /// Share of a limit that may be used on the way to rest, which is longer and so has fewer samples for its length.
    pub(crate) const REST_SHARE: f64 = 0.9;

    /// Whether it leads to rest.
    pub(crate) fn comes_to_rest(&self) -> bool {
        self.to_rest
    }

    /// Whether path time stands still for good.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.to_rest && self.is_over()
    }

    fn is_over(&self) -> bool {
        self.time >= 2.0 * self.half
    }

    /// The scale that it has left, once that stays; none before, and none where that is rest.
    pub(crate) fn rate_behind(&self) -> Option<f64> {
        (self.is_over() && !self.to_rest).then(|| self.scale(0.0).rate)
    }

    /// Advances by `period`; returns how far path time advances. Real-time safe.
    pub(crate) fn advance(&mut self, period: f64) -> f64 {
        let ahead = self.ahead(period);
        self.time += period;
        ahead
    }

    /// How far path time will have advanced in so many seconds.
    pub(crate) fn ahead(&self, seconds: f64) -> f64 {
        self.base * (self.path_time(self.time + seconds) - self.path_time(self.time))
    }

    fn path_time(&self, t: f64) -> f64 {
        let (g, h) = (self.strength, self.half);
        if t <= h {
            return t - g * t * t * t / 6.0;
        }
        // From the middle on the mirror image of the way there, seen from its end.
        let end = h - g * h * h * h / 6.0;
        let u = (t - h).min(h);
        let rate = 1.0 - 0.5 * g * h * h;
        let fading = u * (rate - 0.5 * g * h * u + g * u * u / 6.0);
        end + fading + (t - h - u) * (1.0 - g * h * h)
    }

    /// The scale in so many seconds. Real-time safe.
    pub(crate) fn scale(&self, seconds: f64) -> Scale {
        let (g, h, t) = (self.strength, self.half, self.time + seconds);
        let base = self.base;
        if t < h {
            return Scale {
                rate: base * (1.0 - 0.5 * g * t * t),
                first: base * -g * t,
                second: base * -g,
            };
        }
        let left = (2.0 * h - t).max(0.0);
        Scale {
            rate: base * (1.0 - g * h * h + 0.5 * g * left * left),
            first: base * -g * left,
            second: if left > 0.0 { base * g } else { 0.0 },
        }
    }
}

#[cfg(test)]
mod tests {
    use evolvent_path::Axes;

    use super::*;

    const V: f64 = 200.0;
    const A: f64 = 2000.0;
    const J: f64 = 50_000.0;

    fn limits() -> Limits {
        Limits {
            present: [true; AXES],
            velocity: Axes::repeat(V),
            acceleration: Axes::repeat(A),
            jerk: Axes::repeat(J),
            travel_min: Axes::repeat(-1e4),
            travel_max: Axes::repeat(1e4),
            home: Axes::zeros(),
        }
    }

    fn plan(first: f64, second: f64, third: f64) -> Jet {
        Jet {
            position: Axes::zeros(),
            first: Axes::repeat(first),
            second: Axes::repeat(second),
            third: Axes::repeat(third),
        }
    }

    #[test]
    fn path_time_and_its_derivatives_belong_together() {
        let mut room = Room::new(0.011);
        room.include(&limits(), &plan(100.0, 0.0, 0.0), 0.0);
        let mut ease = room.ease().unwrap();
        let dt = 1e-5;
        let mut before = ease.scale(0.0);
        for k in 0..2500 {
            let middle = ease.scale(0.5 * dt);
            let way = ease.advance(dt);
            assert!((way - dt * middle.rate).abs() < 1e-12, "{k}: {way}");
            let now = ease.scale(0.0);
            assert!(now.rate <= before.rate + 1e-15 && now.rate >= 0.5, "{k}");
            assert!(
                (now.rate - before.rate - dt * middle.first).abs() < 1e-9,
                "{k}: {now:?}"
            );
            before = now;
        }
        assert_eq!((before.first, before.second), (0.0, 0.0));
    }

    #[test]
    fn on_a_line_at_constant_speed_it_brakes_with_nearly_all_of_the_axis_s_jerk() {
        let mut room = Room::new(0.011);
        for k in 0..=20 {
            room.include(&limits(), &plan(100.0, 0.0, 0.0), 0.0011 * f64::from(k));
        }
        let ease = room.ease().unwrap();
        assert!((100.0 * ease.strength - SHARE * J).abs() < 1e-6, "{ease:?}");
    }

    #[test]
    fn a_plan_that_brakes_with_all_it_has_is_left_alone_and_one_that_speeds_up_is_not() {
        for (second, third, eases) in [(-A, 0.0, false), (0.0, -J, false), (A, 0.0, true)] {
            let mut room = Room::new(0.011);
            room.include(&limits(), &plan(100.0, second, third), 0.005);
            assert_eq!(room.ease().is_some(), eases, "{second} {third}");
        }
    }

    #[test]
    fn whatever_the_plan_does_the_limits_are_kept() {
        // Plans at their limits, with every sign.
        for k in 0..27 {
            let sign = |n: i32| f64::from(k / n % 3 - 1);
            let jet = plan(V * sign(1), A * sign(3), J * sign(9));
            for at in [0.0, 0.2, 0.5, 0.95, 1.0, 1.3, 2.0] {
                let mut room = Room::new(0.011);
                room.include(&limits(), &jet, 0.011 * at);
                let Some(mut ease) = room.ease() else { continue };
                let mut tau = 0.0;
                for _ in 0..2300 {
                    let Scale { rate, first, second } = ease.scale(0.0);
                    // The sample stands for the plan about its place.
                    if (tau - 0.011 * at).abs() < 1e-4 {
                        let acceleration = jet.second[0] * rate * rate + jet.first[0] * first;
                        let jerk = jet.third[0] * rate.powi(3)
                            + 3.0 * jet.second[0] * rate * first
                            + jet.first[0] * second;
                        assert!(acceleration.abs() <= A + 1e-9, "{k} {at}: {acceleration}");
                        assert!(jerk.abs() <= J + 1e-9, "{k} {at}: {jerk}");
                    }
                    tau += ease.advance(1e-5);
                }
            }
        }
    }
}

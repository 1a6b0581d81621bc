//! Time-optimal motion along one parameter under constant speed, acceleration and jerk limits.
//!
//! Everything is in closed form or a bisection of fixed length, allocates nothing and is real-time safe. The
//! parameter `x` is the path parameter of one run; `v`, `a`, `j` are its time derivatives.
//!
//! The solver relies on two facts:
//! - The distance of a [`Change`] grows with the *initial* speed, so a speed permitted at a boundary stays
//!   permitted when it is reduced.
//! - Braking distance is *not* monotone in the final speed: from 100 it takes longer to reach 33 (with zero
//!   acceleration) than to stop. As a function of the final speed it has one maximum, so a bisection between
//!   a final speed that fits and one that does not finds the only crossing.

use crate::change::{Change, SPARE_JERK, SPEED_ROUNDING, ScalarLimits, ScalarState, bisect};

/// Maximum number of phases of a [`Profile`]: a change, a cruise, a change.
const MAX_PHASES: usize = 7;
/// Index of the cruise phase.
const CRUISE: usize = 3;

/// Result of [`Profile::solve`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Reaches the end of the run within all limits.
    Exits,
    /// Stops within the run.
    Rests,
    /// Cannot end at or below the permitted exit speed: the state was not permitted in this run. The profile
    /// brakes as hard as the limits permit.
    Overruns,
}

/// Phases of constant jerk from a state to the end of a run, or to a stop within it.
///
/// Jerk may exceed its limit by 1e-4 to compensate rounding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile {
    start: ScalarState,
    phases: [(f64, f64); MAX_PHASES],
    /// Speed of the cruise phase: the rounding residue of the acceleration before it must not accumulate over
    /// minutes.
    cruise: f64,
    duration: f64,
    exit_speed: f64,
    outcome: Outcome,
}

impl Profile {
    /// A profile that rests at `x`.
    #[must_use]
    pub fn at_rest(x: f64) -> Self {
        Self {
            start: ScalarState { x, v: 0.0, a: 0.0 },
            phases: [(0.0, 0.0); MAX_PHASES],
            cruise: 0.0,
            duration: 0.0,
            exit_speed: 0.0,
            outcome: Outcome::Rests,
        }
    }

    /// The fastest profile from `from` to `length` that exits with zero acceleration at `desired` or less.
    ///
    /// `limits.velocity` may be below the present speed (after a reduced override): the speed then falls to
    /// it if the run is long enough. Otherwise the exit may be faster than `desired`, but not than `allowed`.
    /// Real-time safe.
    ///
    /// ```
    /// use evolvent_timing::{Outcome, Profile, ScalarLimits, ScalarState};
    ///
    /// // 10 mm from rest to rest, with a cruise: 2 v/a + (10 - v v/a)/v without jerk limit, plus a/j.
    /// let limits = ScalarLimits { velocity: 100.0, acceleration: 2000.0, jerk: 200_000.0 };
    /// let profile = Profile::solve(ScalarState::default(), 10.0, 0.0, 0.0, &limits);
    /// assert_eq!(profile.outcome(), Outcome::Exits);
    /// assert!((profile.duration() - (10.0 / 100.0 + 100.0 / 2000.0 + 2000.0 / 200_000.0)).abs() < 1e-6);
    /// assert!((profile.end().x - 10.0).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn solve(from: ScalarState, length: f64, desired: f64, allowed: f64, limits: &ScalarLimits) -> Self {
        let remaining = length - from.x;
        let cap = limits.velocity;
        let exit = desired.min(cap);
        let change = |target: f64| Change::new(from, target, limits);
        let settle = |speed: f64| {
            Change::new(
                ScalarState {
                    x: 0.0,
                    v: speed,
                    a: 0.0,
                },
                exit,
                limits,
            )
            .distance
        };
        let relaxed = from.relaxed_speed(limits.jerk);

        if change(cap).distance + settle(cap) <= remaining {
            return Self::two_changes(from, remaining, cap, exit, limits);
        }
        if relaxed < cap {
            let low = relaxed.max(exit);
            if change(low).distance + settle(low) <= remaining {
                let peak = bisect(low, cap, |v| change(v).distance + settle(v) <= remaining);
                return Self::two_changes(from, remaining, peak, exit, limits);
            }
        }
        if exit > relaxed && change(relaxed.max(0.0)).distance <= remaining {
            let speed = bisect(relaxed.max(0.0), exit, |v| change(v).distance <= remaining);
            return Self::one_change(from, remaining, speed, limits, Outcome::Exits);
        }
        if change(exit).distance <= remaining {
            // Already braking: interpolate between continued braking and immediate release, to use the length
            // exactly.
            let high = relaxed.min(cap).max(exit);
            let middle = bisect(exit, high, |v| change(v).distance + settle(v) <= remaining);
            return Self::two_changes(from, remaining, middle, exit, limits);
        }
        if let Some(released) = Self::release(from, remaining, exit, limits) {
            return released;
        }
        // Too short to decelerate to `exit`: below the maximum of the distance there may be lower speeds,
        // above it higher ones.
        if change(0.0).distance <= remaining {
            let speed = bisect(0.0, exit, |v| change(v).distance <= remaining);
            return Self::one_change(from, remaining, speed, limits, Outcome::Exits);
        }
        let high = allowed.min(relaxed);
        if high > exit && change(high).distance <= remaining {
            let speed = bisect(high, exit, |v| change(v).distance <= remaining);
            return Self::one_change(from, remaining, speed, limits, Outcome::Exits);
        }
        Self::last_resort(from, remaining, allowed, limits)
    }

    /// Brakes as hard as the limits permit: to a stop within the run if it is long enough, otherwise to the
    /// lowest speed at its end. Real-time safe.
    #[must_use]
    pub fn brake(from: ScalarState, length: f64, allowed: f64, limits: &ScalarLimits) -> Self {
        let remaining = length - from.x;
        let change = |target: f64| Change::new(from, target, limits);
        if change(0.0).distance <= remaining {
            return Self::one_change(from, f64::NAN, 0.0, limits, Outcome::Rests);
        }
        let high = allowed.min(from.relaxed_speed(limits.jerk));
        if change(high).distance <= remaining {
            let speed = bisect(high, 0.0, |v| change(v).distance <= remaining);
            return Self::one_change(from, remaining, speed, limits, Outcome::Exits);
        }
        Self::last_resort(from, remaining, allowed, limits)
    }

    /// Brings the acceleration to zero as fast as the jerk limit permits, and ends there. Real-time safe.
    #[must_use]
    pub fn level_off(from: ScalarState, limits: &ScalarLimits) -> Self {
        Self::change(from, from.relaxed_speed(limits.jerk).max(0.0), limits)
    }

    /// The position from which on the speed is at most `speed_u_s`: negative infinity if it always is,
    /// infinity if the speed is higher at the end. Real-time safe.
    #[must_use]
    pub fn falls_below(&self, speed_u_s: f64) -> f64 {
        if self.exit_speed > speed_u_s {
            return f64::INFINITY;
        }
        let mut position = if self.start.v > speed_u_s {
            f64::INFINITY
        } else {
            f64::NEG_INFINITY
        };
        for (state, time, jerk) in self.phase_states() {
            let above = state.v - speed_u_s;
            // The later root, at which the speed falls through `speed_u_s`; NaN if there is none.
            let at = if jerk == 0.0 {
                -above / state.a
            } else {
                (-state.a - (state.a * state.a - 2.0 * jerk * above).sqrt()) / jerk
            };
            if (0.0..=time).contains(&at) && state.a + jerk * at <= 0.0 {
                position = state.after(at, jerk).x;
            }
        }
        position
    }

    /// The fastest change to a speed, with zero acceleration at its end.
    pub(crate) fn change(from: ScalarState, speed: f64, limits: &ScalarLimits) -> Self {
        Self::one_change(from, f64::NAN, speed, limits, Outcome::Exits)
    }

    /// Completes a change that is finished except for rounding. The duration of a change is the root of the
    /// remaining speed difference, so an error in the last digit of the speed costs a distance far above
    /// rounding. Bringing the acceleration to zero at once ends above `target` by that last digit instead.
    fn release(from: ScalarState, remaining: f64, target: f64, limits: &ScalarLimits) -> Option<Self> {
        let relaxed = from.relaxed_speed(limits.jerk);
        let fits = |v: f64| Change::new(from, v, limits).distance <= remaining;
        let over = (target..=target + SPEED_ROUNDING * from.v).contains(&relaxed);
        (over && fits(relaxed)).then(|| {
            let speed = bisect(relaxed, target, fits);
            Self::one_change(from, remaining, speed, limits, Outcome::Exits)
        })
    }

    /// Brakes to `allowed`, or releases at once below it, although neither quite fits: by rounding if the
    /// state came from a profile that ends there, otherwise because the state was not permitted.
    ///
    /// Slightly more jerk compensates rounding. Passing the end would be worse: where the path stops, an
    /// excess of 1 nm is a step of acceleration.
    fn last_resort(from: ScalarState, remaining: f64, allowed: f64, limits: &ScalarLimits) -> Self {
        if let Some(released) = Self::release(from, remaining, allowed, limits) {
            return released;
        }
        let with = |fraction: f64| {
            let jerk = limits.jerk * (1.0 + fraction);
            (
                ScalarLimits { jerk, ..*limits },
                allowed.min(from.relaxed_speed(jerk)).max(0.0),
            )
        };
        let overshoot = |fraction: f64| {
            let (limits, target) = with(fraction);
            Change::new(from, target, &limits).distance - remaining
        };
        let (fraction, outcome) = if overshoot(SPARE_JERK) <= 0.0 {
            (
                bisect(SPARE_JERK, 0.0, |fraction| overshoot(fraction) <= 0.0),
                Outcome::Exits,
            )
        } else if overshoot(0.0) <= Self::rounding(from.v, remaining, limits) {
            (0.0, Outcome::Exits)
        } else {
            (0.0, Outcome::Overruns)
        };
        let (limits, target) = with(fraction);
        Self::one_change(from, remaining, target, &limits, outcome)
    }

    /// Error of the end of a change by rounding: `dv = target - v` is known to `eps v`, hence the time
    /// `sqrt(dv/J)` to `sqrt(eps v/J)`.
    fn rounding(v: f64, length: f64, limits: &ScalarLimits) -> f64 {
        16.0 * v.abs() * (f64::EPSILON * v.abs() / limits.jerk).sqrt() + 1e-12 * length.abs()
    }

    fn one_change(
        from: ScalarState,
        remaining: f64,
        target: f64,
        limits: &ScalarLimits,
        outcome: Outcome,
    ) -> Self {
        let change = Change::new(from, target, limits);
        let mut phases = [(0.0, 0.0); MAX_PHASES];
        phases[0] = (change.time[0], change.jerk);
        phases[1] = (change.time[1], 0.0);
        phases[2] = (change.time[2], -change.jerk);
        // The remaining length is passed at the final speed.
        if outcome == Outcome::Exits && target > 0.0 {
            phases[3] = ((remaining - change.distance).max(0.0) / target, 0.0);
        }
        Self::from_phases(from, phases, target, target, outcome)
    }

    fn two_changes(from: ScalarState, remaining: f64, cruise: f64, exit: f64, limits: &ScalarLimits) -> Self {
        let first = Change::new(from, cruise, limits);
        let second = Change::new(
            ScalarState {
                x: 0.0,
                v: cruise,
                a: 0.0,
            },
            exit,
            limits,
        );
        let rest = remaining - first.distance - second.distance;
        let phases = [
            (first.time[0], first.jerk),
            (first.time[1], 0.0),
            (first.time[2], -first.jerk),
            (if cruise > 0.0 { rest.max(0.0) / cruise } else { 0.0 }, 0.0),
            (second.time[0], second.jerk),
            (second.time[1], 0.0),
            (second.time[2], -second.jerk),
        ];
        let outcome = if limits.velocity > 0.0 {
            Outcome::Exits
        } else {
            Outcome::Rests
        };
        Self::from_phases(from, phases, cruise, exit, outcome)
    }

    fn from_phases(
        start: ScalarState,
        phases: [(f64, f64); MAX_PHASES],
        cruise: f64,
        exit_speed: f64,
        outcome: Outcome,
    ) -> Self {
        let duration = phases.iter().map(|piece| piece.0).sum();
        Self {
            start,
            phases,
            cruise,
            duration,
            exit_speed,
            outcome,
        }
    }

    /// Duration in s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Speed at the end, where the acceleration is zero.
    #[must_use]
    pub fn exit_speed(&self) -> f64 {
        self.exit_speed
    }

    /// How the profile ends.
    #[must_use]
    pub fn outcome(&self) -> Outcome {
        self.outcome
    }

    /// State and jerk `t` seconds after the start; at rest or at constant speed after the end. Real-time
    /// safe.
    #[must_use]
    pub fn at(&self, t: f64) -> (ScalarState, f64) {
        let (mut state, mut left) = (self.start, t);
        for (i, &(time, jerk)) in self.phases.iter().enumerate() {
            if i == CRUISE {
                (state.v, state.a) = (self.cruise, 0.0);
            }
            if left < time && t < self.duration {
                return (state.after(left, jerk), jerk);
            }
            state = state.after(time, jerk);
            left -= time;
        }
        let end = ScalarState {
            x: state.x,
            v: self.exit_speed,
            a: 0.0,
        };
        (end.after((t - self.duration).max(0.0), 0.0), 0.0)
    }

    /// The phases of non-zero duration: state at the start, duration, jerk.
    pub(crate) fn phase_states(&self) -> impl Iterator<Item = (ScalarState, f64, f64)> + '_ {
        let mut state = self.start;
        self.phases
            .iter()
            .enumerate()
            .filter_map(move |(i, &(time, jerk))| {
                if i == CRUISE {
                    (state.v, state.a) = (self.cruise, 0.0);
                }
                let start = state;
                state = state.after(time, jerk);
                (time > 0.0).then_some((start, time, jerk))
            })
    }

    /// The state at the end.
    #[must_use]
    pub fn end(&self) -> ScalarState {
        self.at(self.duration).0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reachable_speed;
    use evolvent_random::Random;

    const LIMITS: ScalarLimits = ScalarLimits {
        velocity: 200.0,
        acceleration: 2000.0,
        jerk: 50_000.0,
    };

    /// Samples the profile and differentiates it, independently of its phases.
    fn assert_within(profile: &Profile, length: f64, from: ScalarState, limits: &ScalarLimits, what: &str) {
        let speed_cap = limits.velocity.max(from.relaxed_speed(limits.jerk)).max(from.v);
        let n = 400;
        let mut before = profile.at(0.0).0;
        for i in 1..=n {
            let dt = profile.duration() / f64::from(n);
            let (now, jerk) = profile.at(dt * f64::from(i));
            assert!(
                now.v <= speed_cap * (1.0 + 1e-9) + 1e-12,
                "{what}: speed {} > {speed_cap}",
                now.v
            );
            assert!(
                now.v >= -1e-9 * speed_cap - 1e-12,
                "{what}: runs backwards, {}",
                now.v
            );
            assert!(
                now.a.abs() <= limits.acceleration.max(from.a.abs()) * (1.0 + 1e-9),
                "{what}: a {}",
                now.a
            );
            assert!(
                jerk.abs() <= limits.jerk * (1.0 + 1.01 * SPARE_JERK),
                "{what}: j {jerk}"
            );
            let trapezoid = 0.5 * (before.a + now.a) * dt;
            let slack = limits.jerk * dt * dt + 1e-9 * speed_cap;
            assert!(
                (now.v - before.v - trapezoid).abs() <= slack,
                "{what}: v does not integrate a"
            );
            before = now;
        }
        let end = profile.end();
        let slack = Profile::rounding(from.v, length, limits);
        assert!(
            end.x <= length + slack,
            "{what}: passes the end, {} > {length}",
            end.x
        );
    }

    #[test]
    fn rest_to_rest_takes_the_closed_form_time() {
        // Long: V/A + A/J + L/V. Short, jerk only: four equal phases, T = 4 cbrt(L / (2 J)).
        let long = Profile::solve(ScalarState::default(), 1000.0, 0.0, 0.0, &LIMITS);
        let expected = 200.0 / 2000.0 + 2000.0 / 50_000.0 + 1000.0 / 200.0;
        assert!((long.duration() - expected).abs() < 1e-9, "{}", long.duration());
        let short = Profile::solve(ScalarState::default(), 0.1, 0.0, 0.0, &LIMITS);
        let expected = 4.0 * (0.1_f64 / 100_000.0).cbrt();
        assert!((short.duration() - expected).abs() < 1e-9, "{}", short.duration());
    }

    #[test]
    fn profiles_keep_limits_and_reach_the_end() {
        let seed = 0x5eed_0001;
        println!("seed {seed:#x}");
        let mut random = Random::from_state(seed);
        for case in 0..20_000 {
            let limits = ScalarLimits {
                velocity: random.log(0.1, 1000.0),
                acceleration: random.log(10.0, 1e5),
                jerk: random.log(1e2, 1e7),
            };
            let length = random.log(1e-4, 1e3);
            // An entry with a = 0 that the backward pass permits, then an instant during the profile.
            let exit_cap = limits.velocity * random.unit();
            let entry = reachable_speed(exit_cap, length, &limits).min(limits.velocity) * random.unit();
            let from = ScalarState {
                x: 0.0,
                v: entry,
                a: 0.0,
            };
            let profile = Profile::solve(from, length, exit_cap, exit_cap, &limits);
            let what = format!("case {case}, {limits:?}, length {length}, entry {entry}, exit {exit_cap}");
            assert_eq!(profile.outcome(), Outcome::Exits, "{what}");
            assert_within(&profile, length, from, &limits, &what);
            assert!(profile.exit_speed() <= exit_cap * (1.0 + 1e-12), "{what}");
            let miss = (profile.end().x - length).abs();
            assert!(miss <= 1e-12 * length + 1e-15, "{what}: misses the end by {miss}");

            let moment = profile.at(profile.duration() * random.unit()).0;
            let held = Profile::brake(moment, length, exit_cap, &limits);
            assert_ne!(held.outcome(), Outcome::Overruns, "{what}, hold at {moment:?}");
            assert_within(&held, length, moment, &limits, &what);
            assert!(
                held.exit_speed() <= profile.exit_speed() * (1.0 + 1e-9) + 1e-9,
                "{what}: hold is faster"
            );

            let slower = ScalarLimits {
                velocity: limits.velocity * random.unit(),
                ..limits
            };
            let lowered = Profile::solve(moment, length, exit_cap * random.unit(), exit_cap, &slower);
            assert_ne!(
                lowered.outcome(),
                Outcome::Overruns,
                "{what}, lowered at {moment:?}"
            );
            assert_within(&lowered, length, moment, &limits, &what);
            let resumed = Profile::solve(
                held.at(held.duration() * 0.7).0,
                length,
                exit_cap,
                exit_cap,
                &limits,
            );
            assert_ne!(resumed.outcome(), Outcome::Overruns, "{what}, resumed");
            let miss = (resumed.end().x - length).abs();
            let slack = Profile::rounding(limits.velocity, length, &limits);
            assert!(miss <= slack, "{what}: resumed, misses the end by {miss}");
        }
    }

    #[test]
    fn a_solved_profile_is_the_fastest_of_its_family() {
        // Independent optimum for a = 0 at both ends: the best peak speed by exhaustive search.
        let seed = 0x5eed_0002;
        println!("seed {seed:#x}");
        let mut random = Random::from_state(seed);
        for _ in 0..300 {
            let length = random.log(0.01, 300.0);
            let entry = 150.0 * random.unit();
            let exit = 150.0 * random.unit();
            let time = |v0: f64, v1: f64| {
                let dv: f64 = (v1 - v0).abs();
                let t = if dv <= 80.0 {
                    2.0 * (dv / 50_000.0).sqrt()
                } else {
                    0.04 + dv / 2000.0
                };
                (t, 0.5 * (v0 + v1) * t)
            };
            if time(entry, exit).1 > length {
                continue;
            }
            let best = (1..=20_000)
                .map(|k| f64::from(k) * 0.01)
                .filter(|v| *v >= entry.max(exit))
                .filter_map(|v| {
                    let (t1, d1) = time(entry, v);
                    let (t2, d2) = time(v, exit);
                    (d1 + d2 <= length).then(|| t1 + t2 + (length - d1 - d2) / v)
                })
                .fold(f64::INFINITY, f64::min);
            let from = ScalarState {
                x: 0.0,
                v: entry,
                a: 0.0,
            };
            let solved = Profile::solve(from, length, exit, exit, &LIMITS).duration();
            assert!(
                solved <= best * (1.0 + 1e-9),
                "{entry} -> {exit} over {length}: {solved} > {best}"
            );
        }
    }

    #[test]
    fn a_profile_is_below_a_speed_from_where_it_says_on() {
        let seed = 0x5eed_0005;
        println!("seed {seed:#x}");
        let mut random = Random::from_state(seed);
        for case in 0..5000 {
            let limits = ScalarLimits {
                velocity: random.log(1.0, 1000.0),
                acceleration: random.log(10.0, 1e5),
                jerk: random.log(1e2, 1e7),
            };
            let plan = Profile::solve(ScalarState::default(), random.log(0.01, 300.0), 0.0, 0.0, &limits);
            let moment = plan.at(plan.duration() * random.unit()).0;
            let profile = if case % 2 == 0 {
                Profile::brake(moment, f64::INFINITY, 0.0, &limits)
            } else {
                Profile::level_off(moment, &limits)
            };
            let end = profile.end();
            if case % 2 == 1 {
                let relaxed = moment.relaxed_speed(limits.jerk);
                assert!(
                    (end.v - relaxed).abs() <= 1e-9 * limits.velocity,
                    "{case}: {end:?}"
                );
            }
            let peak = moment.v.max(moment.relaxed_speed(limits.jerk));
            let speed = peak * 1.1 * random.unit();
            let from = profile.falls_below(speed);
            let slack = 1e-6 * peak;
            for part in 0..=400 {
                let now = profile.at(profile.duration() * f64::from(part) / 400.0).0;
                assert!(
                    now.x < from || now.v <= speed + slack,
                    "{case}: {now:?}, {speed} from {from}"
                );
            }
            // And the speed is higher before.
            if from.is_finite() && from > 0.0 {
                let fast = (0..=4000).map(|part| profile.at(profile.duration() * f64::from(part) / 4000.0).0);
                let last = fast
                    .filter(|now| now.v > speed)
                    .map(|now| now.x)
                    .fold(0.0, f64::max);
                assert!(
                    last >= from - 0.002 * (end.x - moment.x) - 1e-9,
                    "{case}: {last}, {from}"
                );
            }
        }
    }

    #[test]
    fn repeated_changes_pass_the_end_by_rounding_only() {
        let seed = 0x5eed_0004;
        println!("seed {seed:#x}");
        let mut random = Random::from_state(seed);
        let (mut beyond, mut worst) = (0, 0.0);
        for case in 0..20_000 {
            let limits = ScalarLimits {
                velocity: random.log(0.1, 1000.0),
                acceleration: random.log(10.0, 1e5),
                jerk: random.log(1e2, 1e7),
            };
            let length = random.log(1e-4, 1e3);
            let allowed = limits.velocity * if random.unit() < 0.3 { 0.0 } else { random.unit() };
            let entry = reachable_speed(allowed, length, &limits).min(limits.velocity);
            let from = ScalarState {
                x: 0.0,
                v: entry,
                a: 0.0,
            };
            let mut profile = Profile::solve(from, length, allowed, allowed, &limits);
            for _ in 0..20 {
                // Half of the instants are just before or after the end of a phase, where rounding is
                // magnified.
                let border = profile.phases[..(random.unit() * 7.0) as usize]
                    .iter()
                    .map(|piece| piece.0)
                    .sum::<f64>();
                let time = if random.unit() < 0.5 {
                    profile.duration() * random.unit()
                } else {
                    border * (1.0 + random.log(1e-16, 1e-3) * (random.unit() - 0.5).signum())
                };
                let moment = profile.at(time.min(profile.duration())).0;
                if moment.x >= length {
                    break;
                }
                let fraction = if random.unit() < 0.3 { 1.0 } else { random.unit() };
                let slower = ScalarLimits {
                    velocity: limits.velocity * fraction,
                    ..limits
                };
                profile = if random.unit() < 0.3 {
                    Profile::brake(moment, length, allowed, &limits)
                } else {
                    Profile::solve(moment, length, allowed * fraction, allowed, &slower)
                };
                let (end, what) = (profile.end(), format!("case {case} {moment:?} {limits:?}"));
                let over = end.x - length;
                // After a change that is finished up to its last digits, part of this margin is used.
                let slack = Profile::rounding(moment.v, 0.0, &limits);
                worst = f64::max(worst, (over - 2e-14 * length) / slack);
                beyond += u32::from(over > 1e-3 * slack + 2e-14 * length);
                let faster = profile.exit_speed() - allowed;
                assert!(
                    faster <= 1.01 * SPEED_ROUNDING * entry.max(allowed),
                    "{what}: {faster} above {allowed}"
                );
            }
        }
        assert!(worst <= 2.0, "{worst} times what rounding explains");
        assert!(beyond <= 4000, "{beyond} of up to 400 000 changes end beyond");
    }
}

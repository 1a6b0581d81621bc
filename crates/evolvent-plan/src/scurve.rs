//! Time-optimal motion along one parameter under constant speed, acceleration and jerk limits.
//!
//! Everything here is closed form or a bisection of fixed length, allocates nothing, and may be called by the
//! real-time cycle. Parameter `x` is the path parameter of one run; `v`, `a`, `j` are its time derivatives.
//!
//! A *change* takes the state `(v, a)` to `(target, 0)` with at most three pieces of constant jerk. With
//! `a = 0` at both ends a change by `dv` takes `T = 2 sqrt(dv/J)` where `dv <= A^2/J`, else `A/J + dv/A`, and
//! covers `(v0 + v1)/2 T`.
//!
//! Two facts carry the solver:
//! - the distance of a change grows with the *initial* speed, so a speed that is allowed at a boundary stays
//!   allowed when it is lowered;
//! - for braking it is *not* monotone in the final speed: from 100 it takes longer to reach 33 (with zero
//!   acceleration) than to stop. As a function of the final speed it has one hump, so a bisection between a
//!   final speed that fits and one that does not finds the only crossing.

/// Iterations of a bisection: enough for 52 bits from any bracket that occurs.
const BISECTIONS: usize = 60;

/// What rounding can add to a speed that came down from a far higher one, as a share of it.
const SPEED_ROUNDING: f64 = 1e-11;
/// Share of the jerk that may be added to make up for rounding; limits are planned with a greater margin.
const SPARE_JERK: f64 = 1e-4;

/// Most pieces of a [`Profile`]: a change, a cruise, a change.
const PIECES: usize = 7;
/// Which of them is the cruise.
const CRUISE: usize = 3;

/// Limits of the motion along one parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScalarLimits {
    /// Highest speed, parameter units per s.
    pub velocity: f64,
    /// Highest magnitude of the second derivative, per s2.
    pub acceleration: f64,
    /// Highest magnitude of the third derivative, per s3.
    pub jerk: f64,
}

/// Place, speed and acceleration along the parameter.
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
    /// The state after `t` seconds of constant jerk.
    #[must_use]
    pub fn after(self, t: f64, jerk: f64) -> Self {
        Self {
            x: self.x + t * (self.v + t * (self.a * 0.5 + t * jerk / 6.0)),
            v: self.v + t * (self.a + t * jerk * 0.5),
            a: self.a + t * jerk,
        }
    }

    /// Speed that remains when acceleration is brought to zero at once with jerk limit `jerk`.
    fn relaxed_speed(self, jerk: f64) -> f64 {
        self.v + self.a * self.a.abs() / (2.0 * jerk)
    }
}

/// Up to three pieces of constant jerk that end with zero acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Change {
    time: [f64; 3],
    jerk: f64,
    distance: f64,
}

impl Change {
    fn new(from: ScalarState, target: f64, limits: &ScalarLimits) -> Self {
        let (a_max, j_max) = (limits.acceleration, limits.jerk);
        let sign = if target >= from.relaxed_speed(j_max) {
            1.0
        } else {
            -1.0
        };
        // Acceleration that would carry a little beyond the target: to come back to it would take far longer,
        // and at the end of braking to rest it would mean going backwards.
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

/// What [`Profile::solve`] could do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Reaches the end of the run within all limits.
    Exits,
    /// Comes to rest within the run.
    Rests,
    /// Cannot end at or below the allowed exit speed: the state was not allowed in this run. The profile
    /// brakes as hard as the limits permit.
    Overruns,
}

/// Pieces of constant jerk from a state to the end of a run, or to rest within it.
///
/// Jerk may exceed its limit by a ten-thousandth, to make up for rounding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile {
    start: ScalarState,
    pieces: [(f64, f64); PIECES],
    /// Speed on the fourth piece; what rounding left of the acceleration before it must not act for minutes.
    cruise: f64,
    duration: f64,
    exit_speed: f64,
    outcome: Outcome,
}

impl Profile {
    /// A profile that stands still at `x` for ever.
    #[must_use]
    pub fn at_rest(x: f64) -> Self {
        Self {
            start: ScalarState { x, v: 0.0, a: 0.0 },
            pieces: [(0.0, 0.0); PIECES],
            cruise: 0.0,
            duration: 0.0,
            exit_speed: 0.0,
            outcome: Outcome::Rests,
        }
    }

    /// The fastest profile from `from` to `length` that exits with zero acceleration at no more than
    /// `wanted`.
    ///
    /// `limits.velocity` may lie below the present speed (an override was lowered): the speed then falls to
    /// it where the run is long enough. Where it is not, the exit may be faster than `wanted`, but never than
    /// `allowed`. Real-time safe.
    #[must_use]
    pub fn solve(from: ScalarState, length: f64, wanted: f64, allowed: f64, limits: &ScalarLimits) -> Self {
        let room = length - from.x;
        let cap = limits.velocity;
        let exit = wanted.min(cap);
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

        if change(cap).distance + settle(cap) <= room {
            return Self::two_changes(from, room, cap, exit, limits);
        }
        if relaxed < cap {
            let low = relaxed.max(exit);
            if change(low).distance + settle(low) <= room {
                let peak = bisect(low, cap, |v| change(v).distance + settle(v) <= room);
                return Self::two_changes(from, room, peak, exit, limits);
            }
        }
        if exit > relaxed && change(relaxed.max(0.0)).distance <= room {
            let speed = bisect(relaxed.max(0.0), exit, |v| change(v).distance <= room);
            return Self::one_change(from, room, speed, limits, Outcome::Exits);
        }
        if change(exit).distance <= room {
            // Braking already: between braking on and letting go first, what uses up the room exactly.
            let high = relaxed.min(cap).max(exit);
            let middle = bisect(exit, high, |v| change(v).distance + settle(v) <= room);
            return Self::two_changes(from, room, middle, exit, limits);
        }
        if let Some(released) = Self::release(from, room, exit, limits) {
            return released;
        }
        // Too short to come down to `exit`: the hump leaves lower speeds, the override leaves higher ones.
        if change(0.0).distance <= room {
            let speed = bisect(0.0, exit, |v| change(v).distance <= room);
            return Self::one_change(from, room, speed, limits, Outcome::Exits);
        }
        let high = allowed.min(relaxed);
        if high > exit && change(high).distance <= room {
            let speed = bisect(high, exit, |v| change(v).distance <= room);
            return Self::one_change(from, room, speed, limits, Outcome::Exits);
        }
        Self::last_resort(from, room, allowed, limits)
    }

    /// Brakes as hard as the limits permit: to rest within the run where it is long enough, otherwise to the
    /// lowest speed at its end. Real-time safe.
    #[must_use]
    pub fn brake(from: ScalarState, length: f64, allowed: f64, limits: &ScalarLimits) -> Self {
        let room = length - from.x;
        let change = |target: f64| Change::new(from, target, limits);
        if change(0.0).distance <= room {
            return Self::one_change(from, f64::NAN, 0.0, limits, Outcome::Rests);
        }
        let high = allowed.min(from.relaxed_speed(limits.jerk));
        if change(high).distance <= room {
            let speed = bisect(high, 0.0, |v| change(v).distance <= room);
            return Self::one_change(from, room, speed, limits, Outcome::Exits);
        }
        Self::last_resort(from, room, allowed, limits)
    }

    /// Ends a change that is over but for rounding. The time that a change takes is the root of what is left of
    /// it, so a speed that is wrong in its last digit only asks for a distance far above rounding. Bringing the
    /// acceleration to zero at once instead ends that last digit above `target`.
    fn release(from: ScalarState, room: f64, target: f64, limits: &ScalarLimits) -> Option<Self> {
        let relaxed = from.relaxed_speed(limits.jerk);
        let fits = |v: f64| Change::new(from, v, limits).distance <= room;
        let over = (target..=target + SPEED_ROUNDING * from.v).contains(&relaxed);
        (over && fits(relaxed)).then(|| {
            let speed = bisect(relaxed, target, fits);
            Self::one_change(from, room, speed, limits, Outcome::Exits)
        })
    }

    /// Brakes to `allowed`, or lets go at once below it, although neither quite fits: by rounding where the state
    /// came from a profile that ends there, else because the state was not allowed.
    ///
    /// A little more jerk makes up for rounding. Passing the end instead would be seen: where the path comes to
    /// rest, a nanometre too much is a step of acceleration.
    fn last_resort(from: ScalarState, room: f64, allowed: f64, limits: &ScalarLimits) -> Self {
        if let Some(released) = Self::release(from, room, allowed, limits) {
            return released;
        }
        let with = |share: f64| {
            let jerk = limits.jerk * (1.0 + share);
            (
                ScalarLimits { jerk, ..*limits },
                allowed.min(from.relaxed_speed(jerk)).max(0.0),
            )
        };
        let overshoot = |share: f64| {
            let (limits, target) = with(share);
            Change::new(from, target, &limits).distance - room
        };
        let (share, outcome) = if overshoot(SPARE_JERK) <= 0.0 {
            (
                bisect(SPARE_JERK, 0.0, |share| overshoot(share) <= 0.0),
                Outcome::Exits,
            )
        } else if overshoot(0.0) <= Self::rounding(from.v, room, limits) {
            (0.0, Outcome::Exits)
        } else {
            (0.0, Outcome::Overruns)
        };
        let (limits, target) = with(share);
        Self::one_change(from, room, target, &limits, outcome)
    }

    /// By how much rounding can move the end of a change: `dv = target - v` is known to `eps v`, so the time
    /// `sqrt(dv/J)` to `sqrt(eps v/J)`.
    fn rounding(v: f64, length: f64, limits: &ScalarLimits) -> f64 {
        16.0 * v.abs() * (f64::EPSILON * v.abs() / limits.jerk).sqrt() + 1e-12 * length.abs()
    }

    fn one_change(
        from: ScalarState,
        room: f64,
        target: f64,
        limits: &ScalarLimits,
        outcome: Outcome,
    ) -> Self {
        let change = Change::new(from, target, limits);
        let mut pieces = [(0.0, 0.0); PIECES];
        pieces[0] = (change.time[0], change.jerk);
        pieces[1] = (change.time[1], 0.0);
        pieces[2] = (change.time[2], -change.jerk);
        // What is left over is cruised at the speed reached.
        if outcome == Outcome::Exits && target > 0.0 {
            pieces[3] = ((room - change.distance).max(0.0) / target, 0.0);
        }
        Self::from_pieces(from, pieces, target, target, outcome)
    }

    fn two_changes(from: ScalarState, room: f64, cruise: f64, exit: f64, limits: &ScalarLimits) -> Self {
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
        let rest = room - first.distance - second.distance;
        let pieces = [
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
        Self::from_pieces(from, pieces, cruise, exit, outcome)
    }

    fn from_pieces(
        start: ScalarState,
        pieces: [(f64, f64); PIECES],
        cruise: f64,
        exit_speed: f64,
        outcome: Outcome,
    ) -> Self {
        let duration = pieces.iter().map(|piece| piece.0).sum();
        Self {
            start,
            pieces,
            cruise,
            duration,
            exit_speed,
            outcome,
        }
    }

    /// Seconds from start to end.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Speed at the end, where acceleration is zero.
    #[must_use]
    pub fn exit_speed(&self) -> f64 {
        self.exit_speed
    }

    /// How the profile ends.
    #[must_use]
    pub fn outcome(&self) -> Outcome {
        self.outcome
    }

    /// State and jerk `t` seconds after the start; at rest or at constant speed beyond the end. Real-time safe.
    #[must_use]
    pub fn at(&self, t: f64) -> (ScalarState, f64) {
        let (mut state, mut left) = (self.start, t);
        for (i, &(time, jerk)) in self.pieces.iter().enumerate() {
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

    /// The state at the end.
    #[must_use]
    pub fn end(&self) -> ScalarState {
        self.at(self.duration).0
    }
}

/// The value nearest to `bad` that still satisfies `fits`, between `good` (which does) and `bad` (which does
/// not).
fn bisect(good: f64, bad: f64, fits: impl Fn(f64) -> bool) -> f64 {
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

/// The highest speed from which a run of `length` can be left at `exit` with zero acceleration at both ends
/// (or, mirrored in time, reached from `exit`). The caller bounds it by the speed limits.
///
/// Closed form for the acceleration-limited case, a convex cubic by Newton's method otherwise; the result is
/// rounded down by 1e-12 of the gain and by several roundings of the speed, so that the solver of the cycle finds
/// it allowed even where rounding has made it enter a little faster.
#[must_use]
pub fn reachable_speed(exit: f64, length: f64, limits: &ScalarLimits) -> f64 {
    let (a, j) = (limits.acceleration, limits.jerk);
    // y^2 = dv:  (2 exit + y^2) y = length sqrt(J), convex and growing for y > 0.
    let goal = length * j.sqrt();
    let mut y = libm::cbrt(goal);
    for _ in 0..BISECTIONS {
        let next = y - (y * (y * y + 2.0 * exit) - goal) / (3.0 * y * y + 2.0 * exit);
        if next.is_nan() || next >= y {
            break;
        }
        y = next;
    }
    let mut dv = y * y;
    if dv > a * a / j {
        // dv^2/(2A) + dv (exit/A + A/(2J)) + exit A/J - length = 0
        let half_b = exit + a * a / (2.0 * j);
        let c = 2.0 * a * (length - exit * a / j);
        dv = c / (half_b + (half_b * half_b + c).max(0.0).sqrt());
    }
    let gain = dv * (1.0 - 1e-12) - 2.0 * SPEED_ROUNDING * (exit + dv);
    exit + gain.max(0.0)
}

/// The highest speed from which a run of `length` can be left at `exit`, and at every other speed up to
/// `highest`: it never falls when `exit` grows.
///
/// [`reachable_speed`] does. It takes longest to come down to `e = v/3`, or to `A^2/(2 J)` where that is less:
/// there `(v + e)/2 T` has its one maximum. With jerk alone that is `L^2 J = 32/27 v^3`.
#[must_use]
pub fn lasting_speed(exit: f64, highest: f64, length: f64, limits: &ScalarLimits) -> f64 {
    let (a, j) = (limits.acceleration, limits.jerk);
    let farthest = (libm::cbrt(27.0 / 32.0 * length * length * j) / 3.0).min(0.5 * a * a / j);
    reachable_speed(exit.max(farthest.min(highest)), length, limits)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: ScalarLimits = ScalarLimits {
        velocity: 200.0,
        acceleration: 2000.0,
        jerk: 50_000.0,
    };

    /// xorshift64*: the seed is printed by every test that uses it.
    struct Random(u64);
    impl Random {
        fn unit(&mut self) -> f64 {
            self.0 ^= self.0 >> 12;
            self.0 ^= self.0 << 25;
            self.0 ^= self.0 >> 27;
            (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1_u64 << 53) as f64
        }
        fn log(&mut self, low: f64, high: f64) -> f64 {
            low * (high / low).powf(self.unit())
        }
    }

    /// Independent of the pieces: samples the profile and differentiates it.
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
    fn rest_to_rest_takes_the_textbook_time() {
        // Long: V/A + A/J + L/V. Short, jerk only: four equal pieces, T = 4 cbrt(L / (2 J)).
        let long = Profile::solve(ScalarState::default(), 1000.0, 0.0, 0.0, &LIMITS);
        let expected = 200.0 / 2000.0 + 2000.0 / 50_000.0 + 1000.0 / 200.0;
        assert!((long.duration() - expected).abs() < 1e-9, "{}", long.duration());
        let short = Profile::solve(ScalarState::default(), 0.1, 0.0, 0.0, &LIMITS);
        let expected = 4.0 * (0.1_f64 / 100_000.0).cbrt();
        assert!((short.duration() - expected).abs() < 1e-9, "{}", short.duration());
    }

    #[test]
    fn profiles_keep_limits_and_land_from_any_allowed_state() {
        let seed = 0x5eed_0001;
        println!("seed {seed:#x}");
        let mut random = Random(seed);
        for case in 0..20_000 {
            let limits = ScalarLimits {
                velocity: random.log(0.1, 1000.0),
                acceleration: random.log(10.0, 1e5),
                jerk: random.log(1e2, 1e7),
            };
            let length = random.log(1e-4, 1e3);
            // An entry with a = 0 that the backward pass allows, then a moment on the way.
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
    fn a_solved_profile_is_not_slower_than_any_sampled_one_of_its_family() {
        // Independent optimum for a = 0 at both ends: the best peak speed by brute force.
        let seed = 0x5eed_0002;
        println!("seed {seed:#x}");
        let mut random = Random(seed);
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
    fn reachable_speed_is_the_highest_from_which_the_exit_is_met() {
        let seed = 0x5eed_0003;
        println!("seed {seed:#x}");
        let mut random = Random(seed);
        for _ in 0..20_000 {
            let exit = if random.unit() < 0.2 {
                0.0
            } else {
                random.log(1e-3, 500.0)
            };
            let length = random.log(1e-6, 1e3);
            let speed = reachable_speed(exit, length, &LIMITS);
            let distance = |v: f64| {
                let dv: f64 = v - exit;
                let t = if dv <= 80.0 {
                    2.0 * (dv / 50_000.0).sqrt()
                } else {
                    0.04 + dv / 2000.0
                };
                0.5 * (v + exit) * t
            };
            let gain = speed - exit;
            if gain < 1e-5 * exit {
                continue; // the difference of two doubles says nothing here
            }
            assert!(
                distance(speed) <= length * (1.0 + 1e-7),
                "{exit} {length} {speed}"
            );
            assert!(
                distance(exit + 1.00001 * gain) > length,
                "{exit} {length} {speed}"
            );
        }
    }

    #[test]
    fn no_history_of_changes_passes_the_end_by_more_than_rounding() {
        let seed = 0x5eed_0004;
        println!("seed {seed:#x}");
        let mut random = Random(seed);
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
                // Half of the moments just before or after a piece ends, where roundings are magnified.
                let border = profile.pieces[..(random.unit() * 7.0) as usize]
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
                let share = if random.unit() < 0.3 { 1.0 } else { random.unit() };
                let slower = ScalarLimits {
                    velocity: limits.velocity * share,
                    ..limits
                };
                profile = if random.unit() < 0.3 {
                    Profile::brake(moment, length, allowed, &limits)
                } else {
                    Profile::solve(moment, length, allowed * share, allowed, &slower)
                };
                let (end, what) = (profile.end(), format!("case {case} {moment:?} {limits:?}"));
                let over = end.x - length;
                // Where a change is over but for its last digits some of this is left, not all of it.
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

    #[test]
    fn a_lasting_speed_meets_every_exit_and_is_the_highest_that_does() {
        let seed = 0x5eed_0005;
        println!("seed {seed:#x}");
        let mut random = Random(seed);
        for case in 0..2000 {
            let length = random.log(1e-4, 1e2);
            let exit = if random.unit() < 0.5 {
                0.0
            } else {
                random.log(0.01, 200.0)
            };
            let highest = exit
                + if random.unit() < 0.2 {
                    0.0
                } else {
                    random.log(0.01, 300.0)
                };
            let speed = lasting_speed(exit, highest, length, &LIMITS);
            let least = (0..=4000)
                .map(|k| exit + (highest - exit) * (f64::from(k) / 4000.0).powi(4))
                .map(|exit| reachable_speed(exit, length, &LIMITS))
                .fold(f64::INFINITY, f64::min);
            assert!(
                speed <= least * (1.0 + 1e-9),
                "case {case}: {speed} above {least}"
            );
            assert!(
                speed >= least * (1.0 - 1e-4),
                "case {case}: {speed} below {least}"
            );
        }
    }

    #[test]
    fn stopping_is_shorter_than_slowing_to_a_third() {
        // The hump: v0 sqrt(v0/J) against 4/3 v0 sqrt(2/3 v0/J), jerk only.
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

//! The entry speeds from which a boundary condition can be met.

use crate::change::{BISECTIONS, SPEED_ROUNDING, ScalarLimits};

/// The maximum entry speed of a run of `length` that can be left at `exit`, with zero acceleration at both
/// ends (or, mirrored in time, the maximum exit speed after `exit`). The caller applies the speed limits.
///
/// Closed form where the acceleration limit is reached, otherwise Newton's method on a convex cubic. The
/// result is rounded down by 1e-12 of the gain and several roundings of the speed, so that the cycle's solver
/// accepts it even if rounding has raised the entry speed slightly.
///
/// ```
/// use evolvent_timing::{ScalarLimits, reachable_speed};
///
/// let limits = ScalarLimits { velocity: 100.0, acceleration: 1000.0, jerk: 10_000.0 };
/// // From rest to 10 mm/s, limited by jerk alone: 2 sqrt(10/10000) s at 5 mm/s on average, 0.316 mm.
/// let length = 10.0 * (10.0_f64 / 10_000.0).sqrt();
/// assert!((reachable_speed(0.0, length, &limits) - 10.0).abs() < 1e-8);
/// ```
#[must_use]
pub fn reachable_speed(exit: f64, length: f64, limits: &ScalarLimits) -> f64 {
    let (a, j) = (limits.acceleration, limits.jerk);
    // y^2 = dv:  (2 exit + y^2) y = length sqrt(J), convex and increasing for y > 0.
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

/// The maximum entry speed from which a run of `length` can be left at `exit` and at every speed from there
/// to `highest`. It never decreases when `exit` increases.
///
/// [`reachable_speed`] can decrease: the braking distance has its maximum at the exit speed `e = v/3`, or at
/// `A^2/(2 J)` if that is smaller; there `(v + e)/2 T` is largest. With jerk alone that is
/// `L^2 J = 32/27 v^3`.
#[must_use]
pub fn monotone_reachable_speed(exit: f64, highest: f64, length: f64, limits: &ScalarLimits) -> f64 {
    let (a, j) = (limits.acceleration, limits.jerk);
    let farthest = (libm::cbrt(27.0 / 32.0 * length * length * j) / 3.0).min(0.5 * a * a / j);
    reachable_speed(exit.max(farthest.min(highest)), length, limits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use evolvent_random::Random;

    const LIMITS: ScalarLimits = ScalarLimits {
        velocity: 200.0,
        acceleration: 2000.0,
        jerk: 50_000.0,
    };

    #[test]
    fn reachable_speed_is_the_maximum_entry_speed() {
        let seed = 0x5eed_0003;
        println!("seed {seed:#x}");
        let mut random = Random::from_state(seed);
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
    fn monotone_reachable_speed_is_maximal_for_all_exits() {
        let seed = 0x5eed_0005;
        println!("seed {seed:#x}");
        let mut random = Random::from_state(seed);
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
            let speed = monotone_reachable_speed(exit, highest, length, &LIMITS);
            let min = (0..=4000)
                .map(|k| exit + (highest - exit) * (f64::from(k) / 4000.0).powi(4))
                .map(|exit| reachable_speed(exit, length, &LIMITS))
                .fold(f64::INFINITY, f64::min);
            assert!(speed <= min * (1.0 + 1e-9), "case {case}: {speed} above {min}");
            assert!(speed >= min * (1.0 - 1e-4), "case {case}: {speed} below {min}");
        }
    }
}

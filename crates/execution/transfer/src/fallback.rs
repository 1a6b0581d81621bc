//! The move that replaces ruckig's if ruckig fails: stop, go, speed up.
//!
//! Every axis stops as fast as it can. Then all axes move in a straight line, rest to rest, to positions from
//! which they reach their targets by speeding up. Each of the three parts is closed form, so this cannot fail
//! numerically. The move is slower than the fastest one and never exceeds a limit of velocity, acceleration
//! or jerk.

use crate::landing::Steps;
use crate::state::{AxisLimits, AxisState, AxisTask};

/// Steps of all axes, with the same total time.
pub(crate) fn stop_and_go(tasks: &[AxisTask]) -> Vec<Steps> {
    let tasks: Vec<AxisTask> = tasks
        .iter()
        .map(|task| AxisTask {
            limits: task.usable(1.0),
            ..*task
        })
        .collect();
    let stops: Vec<[(f64, f64); 3]> = tasks.iter().map(|task| stop(task.from, &task.limits)).collect();
    // Backwards in time velocity and jerk change their signs.
    let starts: Vec<[(f64, f64); 3]> = tasks
        .iter()
        .map(|task| {
            let back = stop(reversed(task.to), &task.limits);
            [2, 1, 0].map(|k| (back[k].0, -back[k].1))
        })
        .collect();
    let lasting = |steps: &[(f64, f64)]| steps.iter().map(|step| step.0).sum::<f64>();
    let stopped_s = stops.iter().map(|steps| lasting(steps)).fold(0.0, f64::max);
    let starting_s = starts.iter().map(|steps| lasting(steps)).fold(0.0, f64::max);

    let distances: Vec<f64> = tasks
        .iter()
        .map(|task| {
            let rest = run(task.from, &stop(task.from, &task.limits));
            let leave = run(reversed(task.to), &stop(reversed(task.to), &task.limits));
            leave.p - rest.p
        })
        .collect();
    let mut line = AxisLimits {
        v: f64::INFINITY,
        a: f64::INFINITY,
        j: f64::INFINITY,
    };
    for (task, distance) in tasks.iter().zip(&distances) {
        if *distance != 0.0 {
            line.v = line.v.min(task.limits.v / distance.abs());
            line.a = line.a.min(task.limits.a / distance.abs());
            line.j = line.j.min(task.limits.j / distance.abs());
        }
    }
    let go = if line.v.is_finite() && line.a.is_finite() && line.j.is_finite() {
        rest_to_rest(1.0, &line)
    } else {
        [(0.0, 0.0); 7]
    };

    let mut result = Vec::with_capacity(tasks.len());
    for ((stop, start), distance) in stops.iter().zip(&starts).zip(&distances) {
        let mut steps = Steps::with_capacity(16);
        steps.extend(stop);
        steps.push((stopped_s - lasting(stop), 0.0));
        steps.extend(go.iter().map(|step| (step.0, step.1 * distance)));
        steps.push((starting_s - lasting(start), 0.0));
        steps.extend(start);
        steps.retain(|step| step.0 > 0.0);
        result.push(steps);
    }
    result
}

fn reversed(state: AxisState) -> AxisState {
    AxisState { v: -state.v, ..state }
}

fn run(state: AxisState, steps: &[(f64, f64)]) -> AxisState {
    steps.iter().fold(state, |state, &(t, jerk)| state.after(t, jerk))
}

/// The fastest stop, at whatever position: at most three pieces.
pub(crate) fn stop(from: AxisState, limits: &AxisLimits) -> [(f64, f64); 3] {
    let sign = if from.relaxed_speed(limits.j) > 0.0 {
        -1.0
    } else {
        1.0
    };
    let (a, dv) = (sign * from.a, -sign * from.v);
    let peak = (limits.j * dv + 0.5 * a * a).max(0.0).sqrt();
    let jerk = sign * limits.j;
    if peak <= limits.a {
        return [
            (((peak - a) / limits.j).max(0.0), jerk),
            (0.0, 0.0),
            (peak / limits.j, -jerk),
        ];
    }
    let level = (dv - (limits.a * limits.a - 0.5 * a * a) / limits.j) / limits.a;
    [
        (((limits.a - a) / limits.j).max(0.0), jerk),
        (level.max(0.0), 0.0),
        (limits.a / limits.j, -jerk),
    ]
}

/// The fastest move over `distance`, not negative, from rest to rest: seven pieces, symmetric in time.
///
/// The duration of jerk is the minimum that the acceleration limit, the velocity limit and the distance
/// permit; then the duration of constant acceleration, then of constant speed.
pub(crate) fn rest_to_rest(distance: f64, limits: &AxisLimits) -> [(f64, f64); 7] {
    let (v, a, j) = (limits.v, limits.a, limits.j);
    let by_acceleration = a / j;
    let ramp = by_acceleration
        .min((v / j).sqrt())
        .min(libm::cbrt(distance / (2.0 * j)));
    let level = if ramp < by_acceleration {
        0.0
    } else {
        // Without cruise the distance is a (level + ramp) (level + 2 ramp).
        let by_distance = 0.5 * ((ramp * ramp + 4.0 * distance / a).sqrt() - 3.0 * ramp);
        by_distance.min(v / a - ramp).max(0.0)
    };
    let speed = j * ramp * (ramp + level);
    let cruise = if speed > 0.0 {
        (distance / speed - level - 2.0 * ramp).max(0.0)
    } else {
        0.0
    };
    [
        (ramp, j),
        (level, 0.0),
        (ramp, -j),
        (cruise, 0.0),
        (ramp, -j),
        (level, 0.0),
        (ramp, j),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::tests::{Random, task};

    fn lasting(steps: &[(f64, f64)]) -> f64 {
        steps.iter().map(|step| step.0).sum()
    }

    #[test]
    fn a_stop_ends_at_rest_in_the_least_time() {
        let mut random = Random::from_state(0xfa_0001);
        for case in 0..2000 {
            let task = task(&mut random);
            let steps = stop(task.from, &task.limits);
            let end = run(task.from, &steps);
            assert!(
                end.v.abs() < 1e-9 * task.limits.v && end.a.abs() < 1e-9 * task.limits.a,
                "case {case}: {end:?}"
            );
            // Jerk is at its limit, or acceleration is: neither can be faster (bang-bang).
            let top = run(task.from, &steps[..1]);
            let full = (top.a.abs() - task.limits.a).abs() < 1e-9 * task.limits.a;
            assert!(steps[1].0 == 0.0 || full, "case {case}");
            assert!(steps.iter().all(|step| step.0 >= 0.0), "case {case}");
        }
    }

    #[test]
    fn rest_to_rest_covers_its_distance_symmetrically() {
        let mut random = Random::from_state(0xfa_0002);
        for case in 0..2000 {
            let AxisTask { limits, .. } = task(&mut random);
            let distance = random.log(1e-6, 1e4);
            let steps = rest_to_rest(distance, &limits);
            let rest = AxisState::default();
            let (half, end) = (run(rest, &steps[..3]), run(rest, &steps));
            assert!((end.p - distance).abs() < 1e-9 * distance, "case {case}: {end:?}");
            assert!(
                end.v.abs() < 1e-9 * half.v && half.v <= limits.v * (1.0 + 1e-12),
                "case {case}"
            );
            let full = run(rest, &steps[..1]).a;
            assert!(full <= limits.a * (1.0 + 1e-12), "case {case}");
            // Wherever there is a piece of constant acceleration or speed, one more limit is reached.
            assert!(
                steps[1].0 == 0.0 || (full / limits.a - 1.0).abs() < 1e-9,
                "case {case}"
            );
            let cruise = steps[3].0 > 1e-9 * lasting(&steps);
            assert!(!cruise || (half.v / limits.v - 1.0).abs() < 1e-9, "case {case}");
        }
    }

    #[test]
    fn stop_and_go_leads_to_every_target_at_one_time() {
        let mut random = Random::from_state(0xfa_0003);
        for case in 0..500 {
            let tasks: Vec<AxisTask> = (0..4).map(|_| task(&mut random)).collect();
            let all = stop_and_go(&tasks);
            for (steps, task) in all.iter().zip(&tasks) {
                let end = run(task.from, steps);
                let duration = lasting(steps);
                assert!(
                    (duration - lasting(&all[0])).abs() < 1e-9 * duration,
                    "case {case}"
                );
                // Rounding over the total time only.
                let fuzz = 1e-10 * (1.0 + duration);
                assert!(
                    (end.p - task.to.p).abs() < fuzz * (1.0 + task.limits.v * duration)
                        && (end.v - task.to.v).abs() < fuzz * (1.0 + task.limits.a * duration)
                        && (end.a - task.to.a).abs() < fuzz * (1.0 + task.limits.j * duration),
                    "case {case}: {end:?} for {:?}",
                    task.to
                );
            }
        }
    }
}

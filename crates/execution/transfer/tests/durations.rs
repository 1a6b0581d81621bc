//! Durations of transfers, compared with independent computations.

#![expect(clippy::panic, reason = "a test may fail")]

use evolvent_path::Axes;
use evolvent_transfer::{AxesState, Sync, Transfer};
use rsruckig::prelude::{
    IgnoreErrorHandler, InputParameter, Ruckig, RuckigResult, Synchronization, Trajectory,
};

use crate::common::{campaign, limits, state};

/// One axis: limits, and position, velocity and acceleration at both ends.
#[derive(Clone, Copy, Debug)]
struct Question {
    v: f64,
    a: f64,
    j: f64,
    from: [f64; 3],
    to: [f64; 3],
}

/// A change of speed from `(v0, a0)` to `(v1, 0)`: time and distance. At most three pieces, of jerk `j`, 0,
/// `-j`.
fn change(v0: f64, a0: f64, v1: f64, a_max: f64, j: f64) -> (f64, f64) {
    let up = v1 >= v0 + a0 * a0.abs() / (2.0 * j);
    let s = if up { 1.0 } else { -1.0 };
    let (a, dv) = (s * a0, s * (v1 - v0));
    let peak = (j * dv + a * a / 2.0).max(0.0).sqrt().min(a_max);
    let (t1, t3) = ((peak - a).max(0.0) / j, peak / j);
    let gained = (peak * peak - a * a) / (2.0 * j) + peak * peak / (2.0 * j);
    let t2 = if peak > 0.0 {
        ((dv - gained) / peak).max(0.0)
    } else {
        0.0
    };
    let (mut x, mut v, mut acc) = (0.0, v0, a0);
    for (t, jerk) in [(t1, s * j), (t2, 0.0), (t3, -s * j)] {
        x += t * (v + t * (acc / 2.0 + t * jerk / 6.0));
        v += t * (acc + t * jerk / 2.0);
        acc += t * jerk;
    }
    (t1 + t2 + t3, x)
}

impl Question {
    /// The minimum time of all motions that change to one speed, hold it, and change to the target, found by
    /// scanning that speed. Motions whose acceleration is zero nowhere in between are not included, so it is
    /// an upper bound.
    fn scanned(&self) -> f64 {
        let through = |speed: f64| {
            let first = change(self.from[1], self.from[2], speed, self.a, self.j);
            // Backwards in time velocity changes its sign: from the mirrored target to the same speed.
            let second = change(-self.to[1], self.to[2], -speed, self.a, self.j);
            let missing = self.to[0] - self.from[0] - first.1 + second.1;
            (first.0 + second.0, missing)
        };
        let mut min = f64::INFINITY;
        for speed in [self.v, -self.v] {
            let (time, missing) = through(speed);
            if missing / speed >= 0.0 {
                min = min.min(time + missing / speed);
            }
        }
        let steps = 4000;
        let at = |k: i32| self.v * f64::from(k) / f64::from(steps);
        let mut before = through(at(-steps)).1;
        for k in 1 - steps..=steps {
            let now = through(at(k)).1;
            if before * now <= 0.0 {
                let (mut low, mut high) = (at(k - 1), at(k));
                for _ in 0..60 {
                    let middle = 0.5 * (low + high);
                    if through(middle).1 * before > 0.0 {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                min = min.min(through(high).0);
            }
            before = now;
        }
        min
    }
}

fn questions(seed: u64, cases: usize, rest: f64, mut solve_case: impl FnMut(usize, Question, f64)) {
    let (mut random, cases) = campaign(seed, cases);
    for case in 0..cases {
        let limits = limits(&mut random, 1);
        let from = state(&mut random, &limits, &Axes::zeros(), rest);
        let to = state(&mut random, &limits, &from.position, rest);
        let transfer = match Transfer::solve(&limits, &from, &to, Sync::Time) {
            Ok(transfer) => transfer,
            Err(error) => panic!("case {case}: {error}"),
        };
        let question = Question {
            v: limits.velocity[0],
            a: limits.acceleration[0],
            j: limits.jerk[0],
            from: [from.position[0], from.velocity[0], from.acceleration[0]],
            to: [to.position[0], to.velocity[0], to.acceleration[0]],
        };
        solve_case(case, question, transfer.duration_s());
    }
}

#[test]
fn no_motion_over_one_speed_is_faster() {
    let (mut equal, mut all) = (0, 0);
    questions(0xd0_0001, 1000, 0.3, |case, question, duration| {
        let scanned = question.scanned();
        assert!(
            duration <= scanned * (1.0 + 1e-5) + 1e-9,
            "case {case}: {duration} s, {scanned} s is possible: {question:?}"
        );
        all += 1;
        equal += usize::from(duration >= scanned * (1.0 - 1e-5));
    });
    // The acceleration of the others is zero nowhere in between: short moves between fast states.
    println!("{equal} of {all} as long as the best over one speed");
    assert!(10 * equal >= 8 * all, "{equal} of {all}");
}

#[test]
fn rest_to_rest_takes_the_textbook_time() {
    questions(0xd0_0002, 1000, 1.0, |case, question, duration| {
        let (d, v, a, j) = (
            (question.to[0] - question.from[0]).abs(),
            question.v,
            question.a,
            question.j,
        );
        // Biagiotti and Melchiorri, Trajectory Planning for Automatic Machines and Robots, section 3.4.
        let to_speed = |v: f64| {
            if v * j < a * a {
                2.0 * (v / j).sqrt()
            } else {
                a / j + v / a
            }
        };
        let wanted = if d <= 0.0 {
            0.0
        } else if d >= v * to_speed(v) {
            to_speed(v) + d / v
        } else if d >= 2.0 * a * a * a / (j * j) {
            a / j + (a * a / (j * j) + 4.0 * d / a).sqrt()
        } else {
            (32.0 * d / j).cbrt()
        };
        assert!(
            (duration - wanted).abs() <= 1e-6 * wanted,
            "case {case}: {duration} s for {wanted} s"
        );
    });
}

/// The result of the Rust port of the solver; `None` if it fails.
fn ported(limits: &evolvent_machine::Limits, from: &AxesState, to: &AxesState) -> Option<f64> {
    let mut input = InputParameter::<3>::new(None);
    input.synchronization = Synchronization::Time;
    // In metres: the tolerances of the port are absolute.
    let unit = 1e-3;
    for i in 0..3 {
        input.current_position[i] = unit * from.position[i];
        input.current_velocity[i] = unit * from.velocity[i];
        input.current_acceleration[i] = unit * from.acceleration[i];
        input.target_position[i] = unit * to.position[i];
        input.target_velocity[i] = unit * to.velocity[i];
        input.target_acceleration[i] = unit * to.acceleration[i];
        input.max_velocity[i] = unit * limits.velocity[i];
        input.max_acceleration[i] = unit * limits.acceleration[i];
        input.max_jerk[i] = unit * limits.jerk[i];
    }
    let mut trajectory = Trajectory::<3>::new(None);
    let result = Ruckig::<3, IgnoreErrorHandler>::new(None, 0.001).calculate(&input, &mut trajectory);
    matches!(result, Ok(RuckigResult::Working | RuckigResult::Finished)).then(|| trajectory.get_duration())
}

#[test]
fn durations_of_three_axes_match_the_port_of_ruckig() {
    let (mut random, cases) = campaign(0xd0_0003, 1500);
    let (mut compared, mut other) = (0, 0);
    for case in 0..cases {
        let limits = limits(&mut random, 3);
        let from = state(&mut random, &limits, &Axes::zeros(), 0.3);
        let to = state(&mut random, &limits, &from.position, 0.3);
        let Ok(transfer) = Transfer::solve(&limits, &from, &to, Sync::Time) else {
            panic!("case {case}");
        };
        let Some(wanted) = ported(&limits, &from, &to) else {
            continue;
        };
        compared += 1;
        let duration = transfer.duration_s();
        // Never slower, except for rounding; a faster transfer would mean that the port misses a shorter one.
        if (duration - wanted).abs() > 1e-5 * wanted + 1e-7 {
            other += 1;
            println!("case {case}: {duration} s, the port {wanted} s");
        }
    }
    println!("{compared} of {cases} compared, {other} differ");
    assert!(
        50 * compared >= 49 * cases && 200 * other <= compared,
        "{compared} of {cases}, {other} differ"
    );
}

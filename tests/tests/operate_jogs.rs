//! Jogs of a served machine, over the real bus and in real time.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::process::Stdio;
use std::time::{Duration, Instant};

use evolvent_bus::ControlRequest;
use evolvent_runtime::MonotonicClock;
use evolvent_tests::job_result::{DONE, STOPPED};
use evolvent_tests::{Operator, Scene, command, evolvent, unless_disturbed};

const X_ONLY: u32 = 1;
/// Number of attempts at a jog that a slow host may end early.
const TRIALS: usize = 20;
/// Number of consecutive stops in time that show that the dead-man switch works.
const IN_A_ROW: u32 = 5;
const PATIENCE: Duration = Duration::from_secs(120);

#[test]
fn a_jog_of_a_killed_client_stops_within_100_ms() {
    unless_disturbed(|| {
        let scene = Scene::new("op-jog");
        let mut operator = scene.operator();
        operator.brings_up();
        // A busy host can make a stop late, and the kill early: several consecutive ones have to be in time.
        let (mut late, mut in_time) = (Vec::new(), 0);
        for _ in 0..TRIALS {
            let Some(begins_ms) = stop_behind_a_kill(&scene, &mut operator) else {
                continue;
            };
            println!("the stop begins {begins_ms:.1} ms after the kill");
            let cycles_ms = 5.0 * operator.now().period_ns as f64 * 1e-6;
            if begins_ms > 100.0 + cycles_ms {
                in_time = 0;
                late.push(begins_ms);
                continue;
            }
            in_time += 1;
            if in_time == IN_A_ROW {
                drop(operator);
                scene.end();
                return;
            }
        }
        panic!("of {TRIALS} jogs no {IN_A_ROW} in a row stopped in time, but after {late:?} ms");
    });
}

/// ms from the death of a jog's client to the first setpoint that brakes. `None` if the jog had ended before:
/// its client was suspended for longer than the dead-man timeout.
fn stop_behind_a_kill(scene: &Scene, operator: &mut Operator) -> Option<f64> {
    let mut jogger = evolvent()
        .args([
            "ctl",
            "--bus-prefix",
            &scene.domain.prefix,
            "jog",
            "X+",
            "--speed",
            "1200",
        ])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary to start");
    let begin = Instant::now();
    loop {
        let status = operator.waits("a status", |_| true);
        if status.activity == 3 && status.velocity[0] > 19.0 {
            break;
        }
        if jogger.try_wait().expect("a process").is_some() {
            operator.waits("rest", |status| status.activity == 0);
            return None;
        }
        assert!(begin.elapsed() < PATIENCE, "no jog");
        std::thread::sleep(Duration::from_millis(2));
    }
    // Longer than the dead-man timeout: the jog is renewed.
    std::thread::sleep(Duration::from_millis(400));
    while operator.setpoints.receive().expect("setpoints").is_some() {}
    let killed_ns = MonotonicClock::now_ns();
    let _gone = jogger.kill();
    jogger.wait().expect("a process that ends");
    let mut top: f64 = 0.0;
    let slower = operator.follows(
        |setpoint| top = top.max(setpoint.velocity[0]),
        |setpoint| setpoint.state != 1,
    );
    let status = operator.waits("rest", |status| status.activity == 0);
    assert_eq!((status.job_result, status.velocity[0]), (STOPPED, 0.0));
    if slower.state != 4 || slower.due_time_ns < killed_ns || top == 0.0 {
        return None;
    }
    assert!((top - 20.0).abs() < 0.01, "{top}");
    Some((slower.due_time_ns - killed_ns) as f64 * 1e-6)
}

#[test]
fn increments_end_on_target_and_jogs_at_soft_limits() {
    unless_disturbed(|| {
        let scene = Scene::new("op-increment");
        let mut operator = scene.operator();
        operator.brings_up();
        let mut jog = ControlRequest {
            axes_mask: X_ONLY,
            index: 1,
            amount: 100.0,
            ..command("JOG")
        };
        jog.values[0] = 12.5;
        let job = operator.does(&jog).job;
        let status = operator.sees_end(job);
        assert_eq!((status.job_result, status.position_machine[0]), (DONE, 12.5));
        jog.values[0] = 500.0;
        let answer = operator.request(&jog);
        assert_eq!((answer.verdict, answer.alarm), (1, 919));
        assert!(answer.text().contains("112.5"), "{}", answer.text());
        // Continuous, renewed until it is at the end of the travel.
        let mut jog = ControlRequest {
            axes_mask: X_ONLY,
            amount: 400.0,
            ..command("JOG")
        };
        jog.values[0] = -1.0;
        let begin = Instant::now();
        let mut result = STOPPED;
        // Stopped: the host was slower than the dead-man timeout. It continues from there.
        while result == STOPPED && begin.elapsed() < PATIENCE {
            let job = operator.does(&jog).job;
            result = 0;
            while result == 0 {
                operator.says("JOG_KEEP");
                std::thread::sleep(Duration::from_millis(10));
                let status = operator.waits("a status", |status| status.job == job);
                result = status.job_result;
            }
            operator.waits("rest", |status| status.activity == 0);
        }
        let status = operator.now();
        assert_eq!((status.job_result, status.position_machine[0]), (DONE, -400.0));
        drop(operator);
        scene.end();
    });
}

/// A jog that were accepted while STOP brakes the previous one would end with it and not move.
#[test]
fn no_jog_is_accepted_while_stop_brakes() {
    unless_disturbed(|| {
        let scene = Scene::new("op-stop-jog");
        let mut operator = scene.operator();
        operator.brings_up();
        let mut jog = ControlRequest {
            axes_mask: X_ONLY,
            index: 1,
            amount: 50.0,
            ..command("JOG")
        };
        jog.values[0] = -100.0;
        let job = operator.does(&jog).job;
        operator.waits("full speed", |status| status.velocity[0] < -49.0);
        operator.says("STOP");
        let answer = operator.request(&jog);
        let is_rejected = (answer.verdict, answer.alarm) == (1, 914);
        assert!(is_rejected || answer.job != job, "{}", answer.text());
        assert_eq!(operator.sees_end(job).job_result, STOPPED);
        drop(operator);
        scene.end();
    });
}

/// Formerly a jog without distance ran to the end of the travel at full speed once it had lost its dead-man
/// switch.
#[test]
fn an_increment_during_a_jog_counts_from_its_stop() {
    unless_disturbed(|| {
        let scene = Scene::new("op-add");
        let mut operator = scene.operator();
        operator.brings_up();
        // Another axis, and the same axis in the other direction.
        for (axis, distance) in [(1, 1.0), (0, -1.0)] {
            let before = operator.now().position_machine;
            let mut jog = ControlRequest {
                axes_mask: X_ONLY,
                amount: 10.0,
                ..command("JOG")
            };
            jog.values[0] = 1.0;
            let job = operator.does(&jog).job;
            operator.waits("motion", |status| {
                status.velocity[0] > 9.0 || status.job_result != 0
            });
            let mut increment = ControlRequest {
                axes_mask: 1 << axis,
                index: 1,
                amount: 1.0,
                ..command("JOG")
            };
            increment.values[axis] = distance;
            while operator.setpoints.receive().expect("setpoints").is_some() {}
            let answer = operator.request(&increment);
            // The host was slower than the dead-man timeout.
            if answer.verdict != 0 || answer.job != job {
                operator.waits("rest", |status| status.activity == 0);
                continue;
            }
            let mut top = [0.0_f64; 3];
            operator.follows(
                |setpoint| {
                    for (top, speed) in top.iter_mut().zip(setpoint.velocity) {
                        *top = top.max(speed.abs());
                    }
                },
                |setpoint| setpoint.state != 1,
            );
            let end = operator.sees_end(job);
            assert!(top[0] < 10.01 && top[1] < 1.01 && top[2] == 0.0, "{top:?}");
            let went = end.position_machine[0] - before[0];
            assert!(went < 10.0, "{went} mm");
            if end.job_result == DONE && axis == 1 {
                assert_eq!(end.position_machine[1], 1.0);
            }
        }
        drop(operator);
        scene.end();
    });
}

#[test]
fn a_jog_reverses_in_motion_without_a_dwell() {
    unless_disturbed(|| {
        let scene = Scene::new("op-turn");
        let mut operator = scene.operator();
        operator.brings_up();
        assert!(
            (0..TRIALS).any(|_| turns_round(&mut operator)),
            "no jog lived until it was turned"
        );
        drop(operator);
        scene.end();
    });
}

/// Whether the jog was reversed before the dead-man switch stopped it.
fn turns_round(operator: &mut Operator) -> bool {
    let jog = |direction: f64, speed: f64| {
        let mut jog = command("JOG");
        (jog.axes_mask, jog.amount, jog.values[0]) = (X_ONLY, speed, direction);
        jog
    };
    let job = operator.does(&jog(1.0, 50.0)).job;
    loop {
        operator.says("JOG_KEEP");
        let status = operator.waits("a status", |_| true);
        if status.job == job && status.job_result != 0 {
            return false;
        }
        if status.job == job && status.velocity[0] > 49.0 {
            break;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    while operator.setpoints.receive().expect("setpoints").is_some() {}
    let answer = operator.request(&jog(-1.0, 30.0));
    let (mut still, mut last, mut turned) = (0, f64::NAN, false);
    if answer.verdict == 0 && answer.job == job {
        let end = operator.follows(
            |setpoint| {
                still += u32::from(setpoint.velocity[0] == 0.0);
                if last.is_finite() {
                    let step = (setpoint.velocity[0] - last).abs();
                    let max_step = 5000.0 * 1.001 * setpoint.period_ns as f64 * 1e-9;
                    assert!(step <= max_step, "{step}");
                }
                last = setpoint.velocity[0];
            },
            |setpoint| setpoint.state != 1 || setpoint.velocity[0] < -29.9,
        );
        turned = end.state == 1;
    }
    operator.says("JOG_STOP");
    operator.waits("rest", |status| status.activity == 0);
    assert!(!turned || still <= 1, "{still} cycles at rest");
    turned
}

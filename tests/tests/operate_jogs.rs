//! Jogs of a machine that is served, over the real bus and in real time.

use std::process::Stdio;
use std::time::{Duration, Instant};

use evolvent_bus::ControlRequest;
use evolvent_tests::{Scene, command, evolvent};

const DONE: u32 = 1;
const STOPPED: u32 = 2;
const X_ONLY: u32 = 1;

#[test]
fn a_jog_whose_client_is_killed_stops_within_a_tenth_of_a_second() {
    let scene = Scene::new("op-jog");
    let mut operator = scene.operator();
    operator.brings_up();
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
    operator.waits("a jog", |status| {
        status.activity == 3 && status.velocity[0] > 19.0
    });
    // Longer than the dead-man's patience: it is kept going.
    std::thread::sleep(Duration::from_millis(400));
    while operator.setpoints.receive().expect("setpoints").is_some() {}
    jogger.kill().expect("killed");
    let killed = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    let killed_ns = killed.tv_sec.cast_unsigned() * 1_000_000_000 + killed.tv_nsec.cast_unsigned();
    jogger.wait().expect("a process that ends");
    let mut top: f64 = 0.0;
    let slower = operator.follows(
        |setpoint| top = top.max(setpoint.velocity[0]),
        |setpoint| setpoint.state == 4,
    );
    let begins_ms = (slower.due_time_ns - killed_ns) as f64 * 1e-6;
    println!("the stop begins {begins_ms:.1} ms after the kill");
    assert!((top - 20.0).abs() < 0.01, "{top}");
    assert!(
        begins_ms <= 100.0 + 5.0 * slower.period_ns as f64 * 1e-6,
        "{begins_ms} ms"
    );
    let status = operator.waits("rest", |status| status.activity == 0);
    assert_eq!((status.job_result, status.velocity[0]), (STOPPED, 0.0));
    drop(operator);
    scene.end();
}

#[test]
fn an_increment_ends_where_it_should_and_a_jog_ends_at_the_soft_limit() {
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
    let answer = operator.ask(&jog);
    assert_eq!((answer.verdict, answer.alarm), (1, 919));
    assert!(answer.text().contains("112.5"), "{}", answer.text());
    // Continuous, with the dead-man kept until it is at the end of the travel.
    let mut jog = ControlRequest {
        axes_mask: X_ONLY,
        amount: 400.0,
        ..command("JOG")
    };
    jog.values[0] = -1.0;
    let job = operator.does(&jog).job;
    let begin = Instant::now();
    let mut result = 0;
    while result == 0 && begin.elapsed() < Duration::from_secs(20) {
        operator.says("JOG_KEEP");
        std::thread::sleep(Duration::from_millis(20));
        let status = operator.waits("a status", |status| status.job == job);
        result = status.job_result;
    }
    let status = operator.now();
    assert_eq!((status.job_result, status.position_machine[0]), (DONE, -400.0));
    drop(operator);
    scene.end();
}

#[test]
fn a_jog_turns_round_in_motion_without_standing_longer_than_a_cycle() {
    let scene = Scene::new("op-turn");
    let mut operator = scene.operator();
    operator.brings_up();
    let jog = |direction: f64, speed: f64| {
        let mut jog = command("JOG");
        (jog.axes_mask, jog.amount, jog.values[0]) = (X_ONLY, speed, direction);
        jog
    };
    let job = operator.does(&jog(1.0, 50.0)).job;
    operator.waits("a jog", |status| status.velocity[0] > 49.0);
    while operator.setpoints.receive().expect("setpoints").is_some() {}
    assert_eq!(operator.does(&jog(-1.0, 30.0)).job, job, "it is the same job");
    let (mut still, mut last) = (0, f64::NAN);
    operator.follows(
        |setpoint| {
            assert_eq!(setpoint.state, 1, "it never stops in between");
            still += u32::from(setpoint.velocity[0] == 0.0);
            if last.is_finite() {
                let step = (setpoint.velocity[0] - last).abs();
                assert!(
                    step <= 5000.0 * 1.001 * setpoint.period_ns as f64 * 1e-9,
                    "{step}"
                );
            }
            last = setpoint.velocity[0];
        },
        |setpoint| setpoint.velocity[0] < -29.9,
    );
    assert!(still <= 1, "{still} cycles at rest");
    operator.says("JOG_STOP");
    assert_eq!(operator.sees_end(job).job_result, STOPPED);
    drop(operator);
    scene.end();
}

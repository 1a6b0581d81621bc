//! `evolvent ctl` as an operator uses it: interrupted, with many clients, after a mistake, during a program.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::process::Stdio;
use std::time::{Duration, Instant};

use evolvent_bus::{ClientConfig, ControlClient};
use evolvent_tests::job_result::STOPPED;
use evolvent_tests::{Finished, Operator, Scene, evolvent, speed, unless_disturbed, wait};
use rustix::process::{Pid, Signal, kill_process};

/// `evolvent ctl` for the machine of a scene.
fn ctl(scene: &Scene, words: &[&str]) -> std::process::Command {
    let mut command = evolvent();
    command
        .args([
            "ctl",
            "--machine-name",
            scene.name(),
            "--bus-prefix",
            &scene.domain.prefix,
        ])
        .args(["--patience", "60"])
        .args(words)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

fn done(scene: &Scene, words: &[&str]) -> Finished {
    wait(ctl(scene, words).spawn().expect("the binary to start"))
}

fn up(scene: &Scene) -> Operator {
    let operator = scene.operator();
    done(scene, &["up"]).expect_code(&[0]);
    operator
}

#[test]
fn a_signal_to_ctl_stops_the_axes_that_it_moves() {
    unless_disturbed(|| {
        let scene = Scene::new("ctl-signal");
        let mut operator = up(&scene);
        for (words, signal) in [
            (["mdi", "G1 X300 F1200", "", ""], Signal::INT),
            (["mdi", "G1 X-300 F1200", "", ""], Signal::TERM),
            (["mdi", "G1 X300 F1200", "", ""], Signal::QUIT),
            (["jog", "Y+", "--distance", "250"], Signal::INT),
            (["jog", "Y-", "--distance", "250"], Signal::HUP),
        ] {
            let words: Vec<&str> = words.into_iter().filter(|word| !word.is_empty()).collect();
            let child = ctl(&scene, &words).spawn().expect("the binary to start");
            let pid = Pid::from_raw(child.id().cast_signed()).expect("a process");
            let moving = operator.waits("motion", |status| status.velocity.iter().any(|v| v.abs() > 5.0));
            // `timeout` sends one signal to the process and one to its group: that is one request.
            kill_process(pid, signal).expect("a living process");
            std::thread::sleep(Duration::from_millis(2));
            // It may have ended by now.
            let _gone = kill_process(pid, signal);
            let end = operator.sees_end(moving.job);
            assert_eq!((end.job_result, end.velocity), (STOPPED, [0.0; 9]), "{words:?}");
            let distances = (0..2).map(|i| (end.position_machine[i] - moving.position_machine[i]).abs());
            assert!(
                distances.fold(0.0, f64::max) < 100.0,
                "{words:?}: went on to {:?}",
                end.position_machine
            );
            let finished = wait(child).expect_code(&[1]);
            assert!(
                finished.err.contains("interrupted"),
                "{words:?}: {}",
                finished.err
            );
        }
        drop(operator);
        scene.end();
    });
}

/// A client that waits for the end of a motion must not take a stop for it.
#[test]
fn a_job_that_somebody_else_stops_is_not_done() {
    unless_disturbed(|| {
        let scene = Scene::new("ctl-stopped");
        let mut operator = up(&scene);
        let program = scene.workshop.write("long.ngc", "G21 G90 G1 X300 F1200\nM2\n");
        done(&scene, &["load", &program.display().to_string()]).expect_code(&[0]);
        for (words, stops, text) in [
            (vec!["mdi", "G1 X300 F1200"], "stop", "stopped before the end"),
            (
                vec!["jog", "Y+", "--distance", "250"],
                "jog-stop",
                "stopped before the end",
            ),
            (vec!["start", "--wait"], "stop", "stopped before the end"),
            (
                vec!["--json", "mdi", "G1 X300 F1200"],
                "estop",
                "was stopped by ESTOP",
            ),
            (vec!["mdi", "G1 X300 F1200"], "estop", "was stopped by ESTOP"),
        ] {
            done(&scene, &["up"]).expect_code(&[0]);
            let child = ctl(&scene, &words).spawn().expect("the binary to start");
            operator.waits("motion", |status| status.velocity.iter().any(|v| v.abs() > 5.0));
            done(&scene, &[stops]).expect_code(&[0]);
            let finished = wait(child).expect_code(&[1]);
            let printed = format!("{}{}", finished.out, finished.err);
            assert!(
                printed.contains(text) && !printed.contains("(0)"),
                "{words:?}: {printed}"
            );
            operator.waits("rest", |status| status.activity == 0);
        }
        drop(operator);
        scene.end();
    });
}

#[test]
fn a_program_stop_in_a_block_of_mdi_does_not_keep_ctl() {
    unless_disturbed(|| {
        let scene = Scene::new("ctl-m0");
        let mut operator = up(&scene);
        let begin = Instant::now();
        let finished = done(&scene, &["mdi", "M0"]).expect_code(&[1]);
        assert!(begin.elapsed() < Duration::from_secs(60));
        assert!(
            finished.err.contains("program stop") && finished.err.contains("ctl resume"),
            "{}",
            finished.err
        );
        done(&scene, &["resume"]).expect_code(&[0]);
        operator.waits("the end", |status| status.activity == 0);
        drop(operator);
        scene.end();
    });
}

#[test]
fn an_emergency_stop_gets_through_a_crowd_of_screens() {
    unless_disturbed(|| {
        let scene = Scene::new("ctl-crowd");
        let mut operator = up(&scene);
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", "G1 X300 F1200").job;
        operator.waits("motion", |status| speed_of(&status.velocity) > 5.0);
        // The maximum number of screens, readers and command clients.
        let bus = scene.domain.client(scene.name());
        let screens: Vec<_> = std::iter::from_fn(|| bus.status().ok()).take(100).collect();
        let readers: Vec<_> = std::iter::from_fn(|| bus.setpoints().ok()).take(100).collect();
        let config = ClientConfig {
            prefix: Some(scene.domain.prefix.clone()),
            wait: Duration::from_secs(5),
            ..ClientConfig::new(scene.name())
        };
        let clients: Vec<_> = std::iter::from_fn(|| ControlClient::open(&config).ok())
            .take(100)
            .collect();
        assert!(screens.len() >= 30 && readers.len() >= 6 && clients.len() >= 30);
        done(&scene, &["status"]).expect_code(&[0]);
        done(&scene, &["estop"]).expect_code(&[0]);
        let end = operator.sees_end(job);
        assert_eq!(end.machine_state, 0);
        drop((screens, readers, clients, bus));
        drop(operator);
        scene.end();
    });
}

fn speed_of(velocity: &[f64; 9]) -> f64 {
    speed(&evolvent_bus::Setpoint {
        velocity: *velocity,
        ..evolvent_bus::Setpoint::default()
    })
}

#[test]
fn start_runs_the_named_program_never_an_older_one() {
    unless_disturbed(|| {
        let scene = Scene::new("ctl-start");
        let mut operator = up(&scene);
        let path = |name: &str, text: &str| scene.workshop.write(name, text).display().to_string();
        let good = path("good.ngc", "G21 G90\nG0 X1\nG0 X0\nM2\n");
        let bad = path("bad.ngc", "G21 G90\nG0 X1 Q7 !\nM2\n");
        done(&scene, &["load", &good]).expect_code(&[0]);
        let started = done(&scene, &["start", "--wait"]).expect_code(&[0]);
        assert!(started.out.contains(&good), "{}", started.out);
        // Neither a program with errors nor a missing one leaves the old one to be started unnoticed.
        for wrong in [bad.as_str(), "/nowhere/at-all.ngc"] {
            done(&scene, &["load", wrong]).expect_code(&[1]);
            let before = operator.now();
            let refused = done(&scene, &["start", "--wait"]).expect_code(&[1]);
            assert!(
                refused.err.contains("927") && refused.err.contains(&good),
                "{}",
                refused.err
            );
            assert_eq!(operator.now().job, before.job, "nothing was started");
            done(&scene, &["start", wrong]).expect_code(&[1]);
            let confirmed = done(&scene, &["start", &good, "--wait"]).expect_code(&[0]);
            assert!(confirmed.out.contains(&good), "{}", confirmed.out);
        }
        drop(operator);
        scene.end();
    });
}

/// A start inside cutter compensation.
#[test]
fn a_start_at_a_line_that_is_not_possible_fails() {
    unless_disturbed(|| {
        let scene = Scene::new("ctl-no-way");
        let operator = up(&scene);
        let text = "G21 G90 F3000\nG41.1 D2\nG1 X10\nG1 X20\nG1 X30\nG40\nG1 X0\nM2\n";
        let program = scene.workshop.write("part.ngc", text).display().to_string();
        done(&scene, &["load", &program]).expect_code(&[0]);
        let failed = done(&scene, &["start", "--line", "5"]).expect_code(&[1]);
        let all = format!("{}{}", failed.out, failed.err);
        assert!(
            all.contains("compensation") && !all.contains("ctl resume"),
            "{all}"
        );
        let failed = done(&scene, &["--json", "start", "--line", "5"]).expect_code(&[1]);
        let answer: serde_json::Value = serde_json::from_str(&failed.out).expect("JSON");
        assert!(answer["failure"].is_string(), "{answer}");
        drop(operator);
        scene.end();
    });
}

#[test]
fn the_way_to_a_line_is_shown_before_anything_moves() {
    unless_disturbed(|| {
        let scene = Scene::new("ctl-line");
        let mut operator = up(&scene);
        let text = "G21 G90\nG0 X10 Y20 Z-5\nG1 X20 F1000\nG1 X30\nG1 X40\nM2\n";
        let program = scene.workshop.write("part.ngc", text).display().to_string();
        done(&scene, &["load", &program]).expect_code(&[0]);
        let before = operator.now().position_machine;
        let shown = done(&scene, &["start", "--line", "5"]).expect_code(&[0]);
        for part in [
            program.as_str(),
            "line 5",
            "X to 30.000",
            "Y to 20.000",
            "Z to -5.000",
            "ctl resume",
        ] {
            assert!(shown.out.contains(part), "{part}: {}", shown.out);
        }
        std::thread::sleep(Duration::from_millis(300));
        let held = operator.now();
        assert_eq!(
            (held.position_machine, held.activity),
            (before, 1),
            "waits where it stood"
        );
        done(&scene, &["resume"]).expect_code(&[0]);
        let end = operator.sees_end(held.job);
        assert_eq!((end.job_result, end.position_machine[0]), (1, 40.0));
        drop(operator);
        scene.end();
    });
}

#[test]
fn too_few_file_descriptors_are_reported_as_such() {
    let scene = Scene::new("ctl-files");
    drop(scene.operator());
    let words = [
        "ctl",
        "--machine-name",
        scene.name(),
        "--bus-prefix",
        &scene.domain.prefix,
        "status",
    ];
    // Inherited descriptors are closed first: with them, ten may not be enough to load the executable.
    let close = "for file in /proc/$$/fd/*; do n=${file##*/}; (( n > 2 )) && eval \"exec $n>&-\"; done";
    let mut shell = std::process::Command::new("bash");
    shell
        .arg("-c")
        .arg(format!("{close}; ulimit -n 10; exec \"$0\" \"$@\""))
        .arg(evolvent().get_program())
        .args(words);
    let finished: Finished = shell.output().expect("a shell").into();
    let finished = finished.expect_code(&[1]);
    assert!(
        finished.err.contains("may have 10") && finished.err.contains("ulimit -n"),
        "{}",
        finished.err
    );
    scene.end();
}

/// Values below 0 come first: an accepted NaN would jog until the end of the travel.
#[test]
fn a_jog_for_an_invalid_duration_is_rejected() {
    unless_disturbed(|| {
        let scene = Scene::new("ctl-seconds");
        let mut operator = up(&scene);
        let before = operator.waits("a status", |_| true);
        for seconds in ["--seconds=-1", "--seconds=nan", "--seconds=inf"] {
            let finished = done(&scene, &["jog", "X+", seconds]).expect_code(&[2]);
            assert!(finished.err.contains("out of range"), "{}", finished.err);
        }
        let after = operator.waits("a status", |_| true);
        assert_eq!(
            (after.job, after.position_machine),
            (before.job, before.position_machine)
        );
        drop(operator);
        scene.end();
    });
}

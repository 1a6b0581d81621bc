//! The terminal screen of a running machine, on a pseudo-terminal.

#![allow(clippy::expect_used, reason = "a test may fail")]

use std::process::{Command, Stdio};

use evolvent_tests::{Scene, evolvent, python, unless_disturbed};
use serde_json::Value;

/// The output for the machine of the scene on a terminal of this size, ended by `end`.
fn capture(scene: &Scene, rows: usize, columns: usize, end: &str) -> Option<Value> {
    let mut watcher: Command = python("watch_screen.py")?;
    let output = watcher
        .args([&rows.to_string(), &columns.to_string(), end])
        .arg(evolvent().get_program())
        .args(["top", scene.name(), "--bus-prefix", &scene.domain.prefix])
        .stderr(Stdio::inherit())
        .output()
        .expect("Python to start");
    Some(serde_json::from_slice(&output.stdout).expect("JSON"))
}

fn lines(capture: &Value) -> Vec<&str> {
    let rows = capture["rows"].as_array().expect("rows");
    rows.iter().map(|row| row.as_str().expect("text")).collect()
}

#[test]
fn top_fits_the_terminal_and_restores_it() {
    unless_disturbed(|| {
        let scene = Scene::new("on-screen");
        let mut operator = scene.operator();
        operator.brings_up();
        for (rows, columns, end) in [(40, 120, "q"), (10, 30, "int")] {
            let Some(capture) = capture(&scene, rows, columns, end) else {
                return;
            };
            for what in ["second_screen", "first_screen", "modes_as_before"] {
                assert_eq!(capture[what], true, "{what}: {capture}");
            }
            assert_eq!(
                (&capture["code"], &capture["error"]),
                (&0.into(), &"".into()),
                "{capture}"
            );
            let lines = lines(&capture);
            assert!(lines[0].starts_with("on-screen  machine on"), "{lines:?}");
            assert!(lines.iter().any(|line| line.starts_with("X* ")), "{lines:?}");
            assert!(lines.len() <= rows + 1, "{lines:?}");
            assert!(
                lines.iter().all(|line| line.chars().count() <= columns),
                "{lines:?}"
            );
            // The whole line if there is space.
            let whole = lines.iter().any(|line| line.contains("q ends"));
            assert_eq!(whole, rows == 40, "{lines:?}");
        }
        drop(operator);
        scene.end();
    });
}

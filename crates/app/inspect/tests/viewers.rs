//! Common viewers open a trace, and the shipped layouts use names that it contains.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::common::{PROGRAM, record};
use evolvent_runtime::Clock;
use evolvent_trace::TraceFile;

fn tools() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tools")
}

/// Names of the fields of a message in the schema's text.
fn fields(message: &str) -> BTreeSet<String> {
    let proto = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../io/trace/proto/evolvent/v1/trace.proto");
    let text = std::fs::read_to_string(proto).expect("the schema");
    let body = text
        .split(&format!("message {message} {{"))
        .nth(1)
        .and_then(|rest| rest.split("\n}").next())
        .expect("the message");
    body.lines()
        .filter_map(|line| {
            line.split(" = ")
                .next()?
                .split_whitespace()
                .last()
                .map(str::to_owned)
        })
        .collect()
}

/// For a list: its length on this machine.
fn elements(field: &str, axes: usize) -> Option<usize> {
    let per_axis = [
        "position",
        "velocity",
        "acceleration",
        "jerk",
        "following_error",
        "drive_position",
    ];
    per_axis.contains(&field).then_some(axes)
}

/// Whether a name such as `/cycle.velocity[0]` (or with `/` between) exists in this trace.
fn is_there(file: &TraceFile, name: &str) -> bool {
    let info = file.info();
    let mut parts = name[1..].splitn(2, ['.', '/']);
    let topic = format!("/{}", parts.next().unwrap_or_default());
    let Some(channel) = info.channels.iter().find(|channel| channel.topic == topic) else {
        return false;
    };
    let Some(field) = parts.next() else { return true };
    let (field, index) = match field.split_once('[') {
        None => (field, None),
        Some((field, index)) => match index.strip_suffix(']').map(str::parse::<usize>) {
            Some(Ok(index)) => (field, Some(index)),
            _ => return false,
        },
    };
    let axes = info.run.as_ref().map_or(0, |run| run.axes.len());
    let is_element = match (elements(field, axes), index) {
        (Some(count), Some(index)) => index < count,
        (None, None) => true,
        _ => false,
    };
    let message = channel.message.strip_prefix("evolvent.v1.");
    is_element && message.is_some_and(|message| fields(message).contains(field))
}

#[test]
fn layouts_name_channels_and_fields_that_exist() {
    let folder = tempfile::tempdir().expect("a folder");
    // One name of odd, one of even length: messages and columns.
    for run in ["run", "runs"] {
        let (trace, _) = record(folder.path(), run, PROGRAM, Clock::Virtual, 1.0, |_| {});
        let file = TraceFile::open(&trace).expect("a trace");
        for wrong in [
            "/cycles.feed",
            "/cycle.feed",
            "/cycle.velocity",
            "/cycle.velocity[3]",
            "/cycle.line[0]",
            "/event.feed_mm_s",
        ] {
            assert!(!is_there(&file, wrong), "{wrong}");
        }
        for (layout, min) in [("foxglove.json", 16), ("plotjuggler.xml", 10)] {
            let text = std::fs::read_to_string(tools().join("viewers").join(layout)).expect("the layout");
            let names: Vec<&str> = text
                .split('"')
                .filter(|word| word.starts_with('/') && !word.contains('>'))
                .collect();
            assert!(names.len() >= min, "{layout}: {names:?}");
            for name in names {
                assert!(is_there(&file, name), "{layout}: {name}");
            }
        }
    }
}

#[test]
fn foxglove_layout_shows_every_configured_panel() {
    let text = std::fs::read_to_string(tools().join("viewers/foxglove.json")).expect("the layout");
    let layout: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let mut shown = BTreeSet::new();
    let mut open = vec![&layout["layout"]];
    while let Some(node) = open.pop() {
        match node.as_str() {
            Some(panel) => assert!(shown.insert(panel.to_owned()), "{panel} twice"),
            None => open.extend([&node["first"], &node["second"]]),
        }
    }
    let set_up = layout["configById"].as_object().expect("panels");
    assert_eq!(shown, set_up.keys().cloned().collect());
}

/// `rerun` from the Python environment of the other clients.
fn rerun() -> Option<(PathBuf, PathBuf)> {
    let python = std::env::var_os("EVOLVENT_PYTHON").map(PathBuf::from);
    let found = python.and_then(|python| {
        let rerun = python.with_file_name("rerun");
        rerun.is_file().then_some((python, rerun))
    });
    if found.is_none() {
        println!("not measured: no rerun beside EVOLVENT_PYTHON (run tools/test)");
    }
    found
}

#[test]
fn rerun_checks_converts_and_shows_a_trace() {
    let Some((python, rerun)) = rerun() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    // One name of odd, one of even length: messages and columns.
    for name in ["run", "runs"] {
        let (trace, _) = record(folder.path(), name, PROGRAM, Clock::Virtual, 1.0, |_| {});
        let run = |program: &Path, arguments: &[&Path]| {
            let output = Command::new(program)
                .args(arguments)
                .env("RERUN_ANALYTICS", "0")
                .output()
                .expect("the viewer's tool to start");
            let text = format!(
                "{}{}",
                String::from_utf8_lossy(&output.stdout),
                String::from_utf8_lossy(&output.stderr)
            );
            assert!(output.status.success(), "{text}");
            text
        };
        let checked = run(&rerun, &[Path::new("mcap"), Path::new("check"), &trace]);
        let row = |topic: &str| {
            checked
                .lines()
                .find(|line| line.contains(topic))
                .map(str::to_owned)
        };
        for topic in ["/cycle", "/event", "/block", "/timing", "/tool_path"] {
            let row = row(topic).unwrap_or_default();
            assert!(row.trim_start().starts_with("ok"), "{topic}: {checked}");
        }
        let recording = folder.path().join(format!("{name}.rrd"));
        run(
            &rerun,
            &[
                Path::new("mcap"),
                Path::new("convert"),
                &trace,
                Path::new("-o"),
                &recording,
            ],
        );
        assert!(recording.metadata().expect("a recording").len() > 10_000);
        let shown = folder.path().join(format!("{name}-shown.rrd"));
        let script = tools().join("viewers/rerun_view.py");
        let text = run(&python, &[&script, &trace, Path::new("--save"), &shown]);
        assert!(text.contains("cycles of 3 axes"), "{text}");
        assert!(shown.metadata().expect("a recording").len() > 10_000);
    }
}

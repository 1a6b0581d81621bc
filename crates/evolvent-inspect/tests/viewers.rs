//! The viewers that people know open a trace, and the layouts that ship name what is in it.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

mod common;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use common::{PROGRAM, record};
use evolvent_daemon::Clock;
use evolvent_trace::TraceFile;

fn tools() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools")
}

/// Names of fields of a message in the schema's text.
fn fields(message: &str) -> BTreeSet<String> {
    let proto = Path::new(env!("CARGO_MANIFEST_DIR")).join("../evolvent-trace/proto/evolvent/v1/trace.proto");
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

#[test]
fn layouts_name_channels_and_fields_that_exist() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let file = TraceFile::open(&trace).expect("a trace");
    let topics: BTreeSet<&str> = file
        .info()
        .channels
        .iter()
        .map(|channel| channel.topic.as_str())
        .collect();
    let known = fields("Cycle");
    let mut named = 0;
    for layout in ["foxglove.json", "plotjuggler.xml"] {
        let text = std::fs::read_to_string(tools().join("viewers").join(layout)).expect("the layout");
        for word in text
            .split('"')
            .filter(|word| word.starts_with('/') && !word.contains('>'))
        {
            named += 1;
            let mut parts = word[1..].splitn(2, ['.', '/']);
            let topic = format!("/{}", parts.next().expect("a topic"));
            assert!(topics.contains(topic.as_str()), "{layout}: {word}");
            if let Some(field) = parts.next() {
                let field = field.split('[').next().expect("a field");
                assert!(known.contains(field), "{layout}: {word}");
            }
        }
    }
    assert!(named > 20, "{named} names");
}

/// `rerun` of the same Python that has the other clients.
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
fn rerun_checks_and_converts_a_trace_without_complaint_and_shows_it() {
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

//! A foreign reader finds every cycle, and the same bits. Needs Python with `tests/python/requirements.txt`.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail as tests do"
)]

mod common;

use std::path::Path;
use std::process::Command;

use common::{cycle, record};

#[test]
fn python_finds_every_cycle_with_the_same_bits() {
    let Some(python) = std::env::var_os("EVOLVENT_PYTHON") else {
        println!("skipped: run tools/test");
        return;
    };
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    let dump = folder.path().join("dump");
    record(&path, 5000, "ZXC", 1000);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/python/read_trace.py");
    let output = Command::new(python)
        .arg(script)
        .arg(&path)
        .arg("--json")
        .arg("--dump")
        .arg(&dump)
        .output()
        .expect("Python");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success(),
        "{text}{}",
        String::from_utf8_lossy(&output.stderr)
    );
    for part in [
        "\"axes\": \"ZXC\"",
        "\"cycles\": 5000",
        "\"gaps\": 0",
        "\"inconsistent\": 0",
        "\"/event\": 49",
        "\"/block\": 49",
        "\"test-mill.toml\": 19",
        "\"state\": \"STATE_DONE\"",
    ] {
        assert!(text.contains(part), "{part} is not in {text}");
    }
    let mut wanted = Vec::new();
    for n in 0..5000_u64 {
        wanted.extend_from_slice(&n.to_le_bytes());
        for position in cycle(n, "ZXC").position {
            wanted.extend_from_slice(&position.to_le_bytes());
        }
    }
    assert!(std::fs::read(&dump).expect("dump") == wanted, "positions differ");
}

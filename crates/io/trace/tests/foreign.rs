//! A foreign reader finds every cycle, and the same bits. Needs Python with `tests/python/requirements.txt`.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail as tests do"
)]

use std::path::Path;
use std::process::Command;

use crate::common::{self, cycle, record};

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
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tests/python/read_trace.py");
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

const DUMP: &str = r"
import struct, sys
sys.path.insert(0, sys.argv[1])
import evolvent_trace
with open(sys.argv[3], 'wb') as out:
    for c in evolvent_trace.cycles(sys.argv[2]):
        out.write(struct.pack('<QQqI', c.sequence, c.due_time_ns, c.wake_lateness_ns, c.work_ns))
        out.write(struct.pack('<IIII', c.line, c.state, c.flags, c.inputs))
        lists = [c.position, c.velocity, c.acceleration, c.jerk, c.following_error, c.drive_position]
        flat = [value for values in lists for value in values]
        out.write(struct.pack('<3d', c.path_mm, c.feed_mm_s, c.override) + struct.pack('<%dd' % len(flat), *flat))
";

/// The decoder of columns in Python, written from the description of the format alone, against the Rust
/// writer.
#[test]
fn python_unpacks_columns_to_the_same_bits() {
    let Some(python) = std::env::var_os("EVOLVENT_PYTHON") else {
        println!("skipped: run tools/test");
        return;
    };
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    let mut run = common::info("ZXC");
    run.columns = true;
    let mut recorder = evolvent_trace::Recorder::create(&path, &run).expect("creating");
    common::record_into(&mut recorder, 4500, "ZXC", 1700);
    recorder
        .finish(&std::collections::BTreeMap::new())
        .expect("finishing");
    let dump = folder.path().join("cycles.dump");
    let tools = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../tools/python");
    let output = Command::new(python)
        .arg("-c")
        .arg(DUMP)
        .arg(tools)
        .args([&path, &dump])
        .output()
        .expect("Python");
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}");
    let mut wanted = Vec::new();
    for n in 0..4500_u64 {
        let cycle = cycle(n, "ZXC");
        wanted.extend_from_slice(&cycle.sequence.to_le_bytes());
        wanted.extend_from_slice(&cycle.due_time_ns.to_le_bytes());
        wanted.extend_from_slice(&cycle.wake_lateness_ns.to_le_bytes());
        for number in [
            cycle.work_ns,
            cycle.line,
            u32::from(cycle.state),
            cycle.flags,
            cycle.inputs,
        ] {
            wanted.extend_from_slice(&number.to_le_bytes());
        }
        let plain = [cycle.path_mm, cycle.feed_mm_s, cycle.override_];
        // Z, X, C: the order of the machine file.
        let lists = [
            cycle.position,
            cycle.velocity,
            cycle.acceleration,
            cycle.jerk,
            cycle.following_error,
            cycle.drive_position,
        ];
        let by_axis = lists.iter().flat_map(|list| [2, 0, 5].map(|axis| list[axis]));
        for value in plain.into_iter().chain(by_axis) {
            // The bits of a NaN do not matter.
            let value = if value.is_nan() { f64::NAN } else { value };
            wanted.extend_from_slice(&value.to_le_bytes());
        }
    }
    assert!(
        std::fs::read(&dump).expect("the dump") == wanted,
        "numbers differ"
    );
}

//! Traces of version 0.1, recorded with a container writer of this project, are read and recovered.

#![allow(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::{Path, PathBuf};

use crate::common;
use evolvent_trace::{ReadError, TraceFile, configuration_hash, recover};

/// The traces of `G0 X1`, `G1 X3 Y2 F6000` on the bench machine, and hashes of number, due time and position
/// of all cycles, of `/cycle` by the MCAP reader for Python.
const TRACES: [(&str, &str); 2] = [
    ("messages-0.1.mcap", "3259cbfa17154de5"),
    ("columns-0.1.mcap", "dbf4cc3686bb39d7"),
];

fn path_of(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data")
        .join(name)
}

/// Number of cycles, and their hash.
fn cycles_of(path: &Path) -> Result<(usize, String), ReadError> {
    let mut bytes = Vec::new();
    let mut count = 0;
    for cycle in TraceFile::open(path)?.cycles() {
        let cycle = cycle?;
        bytes.extend_from_slice(&cycle.sequence.to_le_bytes());
        bytes.extend_from_slice(&cycle.due_time_ns.to_le_bytes());
        for position in &cycle.position[..3] {
            bytes.extend_from_slice(&position.to_le_bytes());
        }
        count += 1;
    }
    Ok((count, configuration_hash(&[&bytes])))
}

#[test]
fn traces_of_version_0_1_are_read() {
    for (name, hash) in TRACES {
        let path = path_of(name);
        assert_eq!(cycles_of(&path).expect(name), (159, hash.to_owned()), "{name}");
        let mut trace = TraceFile::open(&path).expect(name);
        assert_eq!((trace.events().count(), trace.blocks().count()), (2, 2), "{name}");
        let program = trace.attachment("part.ngc").expect(name);
        assert_eq!(
            program.as_deref(),
            Some(&b"G21 G90 G94\nG0 X1\nG1 X3 Y2 F6000\nM2\n"[..])
        );
        let info = trace.info();
        assert_eq!(
            (info.chunks, info.summary_number("cycles")),
            (2, Some(159.0)),
            "{name}"
        );
        let run = info.run.as_ref().expect(name);
        assert_eq!(
            (run.machine_name.as_str(), run.period_ns),
            ("bench-3axis", 1_000_000)
        );
    }
}

#[test]
fn traces_of_version_0_1_are_recovered() {
    let folder = common::folder();
    let out = folder.path().join("out.mcap");
    for (name, hash) in TRACES {
        let whole = recover(&path_of(name), Some(&out)).expect(name);
        assert!(whole.was_complete && !whole.lost_data(), "{name}");
        assert_eq!(cycles_of(&out).expect(name), (159, hash.to_owned()), "{name}");
        // Without its end the second chunk is still complete.
        let bytes = std::fs::read(path_of(name)).expect(name);
        let torn = folder.path().join("torn.mcap");
        std::fs::write(&torn, &bytes[..bytes.len() - 20_000]).expect("writing");
        let recovered = recover(&torn, Some(&out)).expect(name);
        assert!(!recovered.was_complete, "{name}");
        assert_eq!(cycles_of(&out).expect(name), (159, hash.to_owned()), "{name}");
    }
}

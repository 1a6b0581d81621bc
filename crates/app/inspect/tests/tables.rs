//! Tables contain the data of the trace.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

use std::process::Command;

use crate::common::{PROGRAM, cycles, record};
use evolvent_inspect::{ExportChannel, ExportFormat, Selection, export};
use evolvent_runtime::Clock;
use evolvent_trace::TraceFile;

#[test]
fn csv_bears_units_and_reads_back_to_the_same_bits() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let all = cycles(&trace);
    let output = folder.path().join("run.csv");
    let mut file = TraceFile::open(&trace).expect("a trace");
    let done = export(
        &mut file,
        ExportChannel::Cycles,
        &Selection::default(),
        ExportFormat::Csv,
        &output,
    )
    .expect("a table");
    let text = std::fs::read_to_string(&output).expect("the table");
    assert_eq!((done.rows, done.bytes), (all.len() as u64, text.len() as u64));
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let at = |name: &str| names.iter().position(|found| *found == name).expect(name);
    let columns = [
        at("X_position_mm"),
        at("Y_velocity_mm_s"),
        at("Z_acceleration_mm_s2"),
        at("X_jerk_mm_s3"),
        at("feed_mm_s"),
    ];
    for (line, cycle) in lines.zip(&all) {
        let fields: Vec<&str> = line.split(',').collect();
        assert_eq!(fields.len(), names.len());
        let wanted = [
            cycle.position[0],
            cycle.velocity[1],
            cycle.acceleration[2],
            cycle.jerk[0],
            cycle.feed_mm_s,
        ];
        for (column, wanted) in columns.iter().zip(wanted) {
            let found: f64 = fields[*column].parse().expect("a number");
            assert_eq!(found.to_bits(), wanted.to_bits(), "{} in {line}", names[*column]);
        }
        assert_eq!(fields[at("sequence")], cycle.sequence.to_string());
        assert_eq!(fields[at("load")], "", "no sensor, no number");
    }
}

#[test]
fn a_selection_by_time_and_by_line_takes_just_that() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let all = cycles(&trace);
    let output = folder.path().join("part.csv");
    let mut file = TraceFile::open(&trace).expect("a trace");
    let selection = Selection {
        time_s: 0.25..=0.5,
        lines: 5..=6,
    };
    let done = export(
        &mut file,
        ExportChannel::Cycles,
        &selection,
        ExportFormat::Csv,
        &output,
    )
    .expect("a table");
    let wanted = all
        .iter()
        .filter(|cycle| (250..=500).contains(&cycle.sequence) && (5..=6).contains(&cycle.line))
        .count();
    assert!(wanted > 0);
    assert_eq!(done.rows, wanted as u64);
    for (channel, name) in [
        (ExportChannel::Events, "events"),
        (ExportChannel::Blocks, "blocks"),
    ] {
        let output = folder.path().join(format!("{name}.csv"));
        let done = export(
            &mut file,
            channel,
            &Selection::default(),
            ExportFormat::Csv,
            &output,
        )
        .expect("a table");
        assert!(done.rows > 0, "{name}");
        let text = std::fs::read_to_string(&output).expect("the table");
        assert!(text.starts_with(if name == "events" {
            "sequence,time_s,kind"
        } else {
            "start_sequence,end_time_s"
        }));
    }
    // A path that cannot be written leaves no file behind.
    let nowhere = folder.path().join("none/part.csv");
    assert!(
        export(
            &mut file,
            ExportChannel::Cycles,
            &selection,
            ExportFormat::Csv,
            &nowhere
        )
        .is_err()
    );
    assert!(!nowhere.exists());
}

const READ_BACK: &str = r#"
import sys, csv, struct
import pyarrow.parquet as pq
table = pq.read_table(sys.argv[1])
rows = list(csv.reader(open(sys.argv[2], newline="")))
assert table.column_names == rows[0], (table.column_names, rows[0])
assert table.num_rows == len(rows) - 1, (table.num_rows, len(rows))
bits = lambda value: struct.pack("<d", value)
for n, name in enumerate(table.column_names):
    for found, text in zip(table.column(n).to_pylist(), (row[n] for row in rows[1:])):
        if isinstance(found, float):
            assert (text == "" and found != found) or bits(found) == bits(float(text)), (name, found, text)
        else:
            assert str(found) == text, (name, found, text)
meta = pq.read_metadata(sys.argv[1])
for group in range(meta.num_row_groups):
    for column in range(meta.num_columns):
        assert meta.row_group(group).column(column).compression == "ZSTD"
assert all(not field.nullable and str(field.type) in ("int64", "double", "string") for field in table.schema), table.schema
assert b"evolvent.period_ns" in pq.read_metadata(sys.argv[1]).metadata
print(table.num_rows, "rows")
"#;

/// An independent reader finds the same values in Parquet and CSV.
#[test]
fn parquet_equals_csv_for_an_independent_reader() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let mut file = TraceFile::open(&trace).expect("a trace");
    let Some(python) = std::env::var_os("EVOLVENT_PYTHON") else {
        println!("not measured: run tools/test");
        return;
    };
    for (channel, name) in [
        (ExportChannel::Cycles, "cycles"),
        (ExportChannel::Events, "events"),
        (ExportChannel::Blocks, "blocks"),
    ] {
        let [parquet, csv] = ["parquet", "csv"].map(|kind| folder.path().join(format!("{name}.{kind}")));
        let all = Selection::default();
        export(&mut file, channel, &all, ExportFormat::Parquet, &parquet).expect("a table");
        export(&mut file, channel, &all, ExportFormat::Csv, &csv).expect("a table");
        let checked = Command::new(&python)
            .arg("-c")
            .arg(READ_BACK)
            .args([&parquet, &csv])
            .output()
            .expect("Python");
        let text = String::from_utf8_lossy(&checked.stderr);
        if text.contains("No module named 'pyarrow'") {
            println!("not measured: this Python has no pyarrow");
            return;
        }
        assert!(checked.status.success(), "{name}: {text}");
    }
}

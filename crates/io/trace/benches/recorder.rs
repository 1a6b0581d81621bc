//! Speed of recording, and bytes per cycle: `cargo bench -p evolvent-trace --bench recorder`.
//!
//! The tool moves along a circle with changing accelerations: full mantissas in every number, as in a real
//! trace, which is the hard case for the compressor.

#![expect(clippy::print_stdout, reason = "a benchmark reports")]

use std::hint::black_box;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use evolvent_path::AxisLetter;
use evolvent_trace::{CycleRecord, ReadError, Recorder, RunInfo, TraceFile, TraceSink, recover};

const BATCH: usize = 100_000;
const PERIOD_NS: u64 = 28_571;

/// Counts and discards bytes, to measure the recorder and not the disk.
#[derive(Debug, Default)]
struct Void;

impl TraceSink for Void {
    fn append(&mut self, bytes: &[u8], _reserve: u64) -> std::io::Result<()> {
        black_box(bytes);
        Ok(())
    }

    fn truncate(&mut self, _length: u64) -> std::io::Result<()> {
        Ok(())
    }

    fn sync(&mut self) -> std::io::Result<()> {
        Ok(())
    }

    fn end(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn cycles(axes: usize) -> Vec<CycleRecord> {
    let step = PERIOD_NS as f64 * 1e-9;
    (0..BATCH)
        .map(|n| {
            let mut record = CycleRecord {
                sequence: n as u64,
                due_time_ns: 1_700_000_000_000_000_000 + n as u64 * PERIOD_NS,
                wake_lateness_ns: 18_000 + (n as i64 * 7919) % 9000,
                work_ns: 350 + (n as u32 * 31) % 200,
                path_mm: n as f64 * step * 50.0,
                feed_mm_s: 50.0,
                line: (n / 3000) as u32 + 1,
                state: 1,
                ..CycleRecord::default()
            };
            for axis in 0..axes {
                let pulsation = 5.0 + axis as f64;
                let (sine, cosine) = (n as f64 * step * pulsation).sin_cos();
                record.position[axis] = 10.0 * cosine;
                record.velocity[axis] = -10.0 * pulsation * sine;
                record.acceleration[axis] = -10.0 * pulsation.powi(2) * cosine;
                record.jerk[axis] = 10.0 * pulsation.powi(3) * sine;
            }
            record
        })
        .collect()
}

fn info(axes: usize, columns: bool) -> RunInfo {
    RunInfo {
        axes: AxisLetter::ALL[..axes].to_vec(),
        period_ns: PERIOD_NS,
        start_time_ns: 1_700_000_000_000_000_000,
        columns,
        ..RunInfo::default()
    }
}

fn record_all(
    axes: usize,
    columns: bool,
    cycles: &[CycleRecord],
    flush_each: usize,
) -> Result<u64, evolvent_trace::RecordError> {
    let mut recorder = Recorder::with_sink(Box::new(Void), Path::new("void"), &info(axes, columns))?;
    for (n, cycle) in cycles.iter().enumerate() {
        recorder.cycle(black_box(cycle))?;
        if (n + 1) % flush_each == 0 {
            recorder.flush()?;
        }
    }
    recorder.flush()?;
    Ok(recorder.bytes())
}

/// The same bytes through the reference implementation, with the same compression and chunks.
fn reference(axes: usize, cycles: &[CycleRecord]) -> mcap::McapResult<u64> {
    let mut writer = mcap::WriteOptions::new()
        .compression(Some(mcap::Compression::Zstd))
        .compression_level(1)
        .compression_threads(0)
        .chunk_size(Some(512 * 1024))
        .create(std::io::Cursor::new(Vec::with_capacity(64 << 20)))?;
    let channel_id = writer.add_channel(0, "/cycle", "protobuf", &Default::default())?;
    // About the size of a cycle, with its numbers; encoding costs nothing here.
    let mut data = vec![0_u8; 70 + axes * 32];
    for cycle in cycles {
        let values = [cycle.position, cycle.velocity, cycle.acceleration, cycle.jerk];
        for (at, value) in values.iter().flat_map(|values| &values[..axes]).enumerate() {
            data[70 + at * 8..78 + at * 8].copy_from_slice(&value.to_le_bytes());
        }
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: cycle.sequence as u32,
            log_time: cycle.due_time_ns,
            publish_time: cycle.due_time_ns,
        };
        writer.write_to_known_channel(&header, &data)?;
    }
    writer.finish()?;
    Ok(writer.into_inner().into_inner().len() as u64)
}

fn recorder(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("cycles");
    group
        .sample_size(10)
        .throughput(Throughput::Elements(BATCH as u64));
    for axes in [3, 9] {
        let records = cycles(axes);
        // 35 kHz, flushed each 250 ms.
        for (name, columns) in [("recorder, messages", false), ("recorder, columns", true)] {
            if let Ok(bytes) = record_all(axes, columns, &records, 8750) {
                println!(
                    "{name}, {axes} axes: {:.1} bytes a cycle",
                    bytes as f64 / BATCH as f64
                );
            }
            group.bench_with_input(BenchmarkId::new(name, axes), &axes, |bench, &axes| {
                bench.iter(|| record_all(axes, columns, &records, 8750));
            });
        }
        group.bench_with_input(BenchmarkId::new("mcap crate", axes), &axes, |bench, &axes| {
            bench.iter(|| reference(axes, &records));
        });
    }
    group.finish();
    // The longest call: closing a full chunk.
    let records = cycles(9);
    if let Ok(mut recorder) = Recorder::with_sink(Box::new(Void), Path::new("void"), &info(9, true)) {
        let mut longest = 0.0_f64;
        for record in &records {
            let start = Instant::now();
            let _ = black_box(recorder.cycle(record));
            longest = longest.max(start.elapsed().as_secs_f64());
        }
        println!("longest call of 9 axes: {:.2} ms", longest * 1e3);
    }
}

/// Records a file with a flush each `flush_each` cycles.
fn record_file(path: &Path, columns: bool, cycles: &[CycleRecord], flush_each: usize) -> bool {
    let record = || {
        let mut recorder = Recorder::create(path, &info(9, columns))?;
        for (n, cycle) in cycles.iter().enumerate() {
            recorder.cycle(cycle)?;
            if (n + 1) % flush_each == 0 {
                recorder.flush()?;
            }
        }
        recorder.finish(&Default::default())
    };
    record().is_ok()
}

fn read_all(path: &Path) -> Result<u64, ReadError> {
    let mut count = 0;
    TraceFile::open(path)?.each_cycle(0, u64::MAX, |record| {
        count += u64::from(black_box(record).line > 0);
        Ok::<_, ReadError>(ControlFlow::Continue(()))
    })?;
    Ok(count)
}

fn reader(criterion: &mut Criterion) {
    let Ok(folder) = tempfile::tempdir() else { return };
    let records = cycles(9);
    let mut group = criterion.benchmark_group("files");
    group
        .sample_size(10)
        .throughput(Throughput::Elements(BATCH as u64));
    for (name, columns) in [("messages", false), ("columns", true)] {
        let path = folder.path().join(format!("{name}.mcap"));
        let recovered = folder.path().join(format!("{name}.recovered.mcap"));
        if !record_file(&path, columns, &records, 8750) {
            return;
        }
        group.bench_function(format!("read {name}"), |bench| bench.iter(|| read_all(&path)));
        group.bench_function(format!("recover {name}"), |bench| {
            bench.iter(|| recover(&path, Some(&recovered)));
        });
    }
    let path = folder.path().join("many.mcap");
    if record_file(&path, true, &records, 16) {
        group.bench_function("open a trace of 6250 chunks", |bench| {
            bench.iter(|| TraceFile::open(&path).map(|trace| trace.info().chunks));
        });
    }
    group.finish();
}

criterion_group!(benches, recorder, reader);
criterion_main!(benches);

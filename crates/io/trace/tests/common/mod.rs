//! A synthetic run by formula: the expected data are computed again, not stored.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]
#![allow(
    dead_code,
    unreachable_pub,
    reason = "not every helper has a user at all times"
)]

use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex};

use evolvent_path::AxisLetter;
use evolvent_trace::{
    BlockKind, BlockRecord, CycleRecord, EventKind, EventRecord, LogLevel, ProgramSource, Recorder, RunInfo,
    TraceSink, configuration_hash,
};

pub const START_NS: u64 = 1_700_000_000_000_000_123;
pub const PERIOD_NS: u64 = 1_000_003;
pub const PROGRAM: &[u8] = b"G0 X0 Y0\nG1 X10 F600\nM2\n";

/// A folder for a test, in memory if possible: hundreds of synchronisations with a disk take long.
pub fn folder() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() {
        tempfile::tempdir_in(memory)
    } else {
        tempfile::tempdir()
    }
    .expect("folder")
}

thread_local! {
    static COLUMNS: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// Runs a test in both layouts of cycles: one message per cycle, and columns.
pub fn in_both_layouts(test: impl Fn()) {
    for columns in [false, true] {
        println!("columns: {columns}");
        COLUMNS.set(columns);
        test();
    }
}

pub fn info(axes: &str) -> RunInfo {
    let machine_file = "name = \"test-mill\"\n".to_owned();
    RunInfo {
        program_name: "part.ngc".into(),
        program: ProgramSource::Bytes(PROGRAM.to_vec()),
        machine_name: "test-mill".into(),
        machine_file_name: "test-mill.toml".into(),
        configuration_hash: configuration_hash(&[machine_file.as_bytes()]),
        machine_file,
        tool_table: Some(("tools.tbl".into(), b"T1 P1 D6\n".to_vec())),
        axes: axes.chars().filter_map(AxisLetter::from_letter).collect(),
        period_ns: PERIOD_NS,
        start_time_ns: START_NS,
        versions: [("evolvent".to_owned(), "0.1.0".to_owned())].into(),
        clock: "virtual".into(),
        real_time: "none".into(),
        columns: COLUMNS.get(),
        ..RunInfo::default()
    }
}

/// Cycle `n` of the synthetic run; axes that are not in `axes` are zero, as a reader returns them.
pub fn cycle(n: u64, axes: &str) -> CycleRecord {
    let phase = n as f64 * 1e-3;
    let of = |scale: f64| {
        std::array::from_fn(|axis| {
            if axes.contains(AxisLetter::ALL[axis].letter()) {
                scale * libm_like_sine(phase + axis as f64) / 3.0
            } else {
                0.0
            }
        })
    };
    CycleRecord {
        sequence: n,
        due_time_ns: START_NS + n * PERIOD_NS,
        wake_lateness_ns: (n % 50) as i64 * 1000 - 5000,
        work_ns: 300 + (n % 7) as u32 * 50,
        path_mm: phase * 10.0,
        feed_mm_s: 10.0,
        position: of(100.0),
        velocity: of(10.0),
        acceleration: of(500.0),
        // Jerk is recorded as singles.
        jerk: of(20_000.0).map(|value| f64::from(value as f32)),
        line: (n / 100) as u32 + 1,
        state: (n % 10) as u8,
        flags: u32::from(n.is_multiple_of(97)),
        override_: 1.0 + (n / 1000) as f64 / 10.0,
        load: if n.is_multiple_of(2) { f64::NAN } else { n as f64 },
        inputs: (n % 300 / 250) as u32,
        following_error: if n < 1000 {
            [f64::NAN; 9]
        } else {
            std::array::from_fn(|axis| {
                let is_there = axes.contains(AxisLetter::ALL[axis].letter());
                if is_there {
                    libm_like_sine(phase) * 1e-3
                } else {
                    f64::NAN
                }
            })
        },
        drive_position: if n < 500 {
            [f64::NAN; 9]
        } else {
            std::array::from_fn(|axis| {
                let is_there = axes.contains(AxisLetter::ALL[axis].letter());
                if is_there {
                    of(100.0)[axis] + 0.01
                } else {
                    f64::NAN
                }
            })
        },
    }
}

/// Smooth, with full mantissas, and identical on every machine.
fn libm_like_sine(x: f64) -> f64 {
    let x = x % 2.0 - 1.0;
    x * (1.0 - x * x) * 2.598
}

pub fn event(n: u64) -> EventRecord {
    EventRecord {
        time_ns: START_NS + n * PERIOD_NS,
        sequence: n,
        kind: EventKind::ALL[n as usize / 100 % EventKind::ALL.len()],
        code: n as u32,
        text: format!("event at {n} \u{b5}"),
        value: n.is_multiple_of(200).then_some(n as f64 / 3.0),
    }
}

pub fn block(n: u64) -> BlockRecord {
    BlockRecord {
        time_ns: START_NS + n * PERIOD_NS,
        line: (n / 100) as u32,
        text: format!("G1 X{n} F600"),
        kind: BlockKind::ALL[(n / 100 % 7) as usize],
        length_mm: n as f64 / 7.0,
        planned_duration_s: 0.1,
        true_duration_s: 0.125,
        start_sequence: n - 100,
    }
}

/// Records cycles `0..cycles` with an event and a block every hundred cycles, and a flush every `flush_each`.
pub fn record_into(recorder: &mut Recorder, cycles: u64, axes: &str, flush_each: u64) {
    recorder.log(START_NS, LogLevel::Info, "started").expect("log");
    for n in 0..cycles {
        recorder.cycle(&cycle(n, axes)).expect("cycle");
        if n > 0 && n % 100 == 0 {
            recorder.event(&event(n)).expect("event");
            recorder.block(&block(n)).expect("block");
        }
        if n % flush_each == flush_each - 1 {
            recorder.flush().expect("flush");
        }
    }
}

pub fn record(path: &Path, cycles: u64, axes: &str, flush_each: u64) {
    let mut recorder = Recorder::create(path, &info(axes)).expect("creating");
    record_into(&mut recorder, cycles, axes, flush_each);
    let summary = [("path_length_mm".to_owned(), "12.5".to_owned())].into();
    assert_eq!(recorder.finish(&summary).expect("finishing"), path);
}

/// Equal bit for bit; NaN equals NaN.
pub fn assert_same(found: &CycleRecord, wanted: &CycleRecord) {
    let bits = |record: &CycleRecord| {
        let mut bits: Vec<u64> = [record.position, record.velocity, record.acceleration, record.jerk]
            .as_flattened()
            .iter()
            .chain(&[record.path_mm, record.feed_mm_s, record.override_])
            .map(|value| value.to_bits())
            .collect();
        bits.push(if record.load.is_nan() {
            u64::MAX
        } else {
            record.load.to_bits()
        });
        let whole = (
            record.sequence,
            record.due_time_ns,
            record.wake_lateness_ns,
            record.work_ns,
            record.line,
            record.state,
            record.flags,
            record.inputs,
            record
                .following_error
                .map(|error| if error.is_nan() { u64::MAX } else { error.to_bits() }),
            record
                .drive_position
                .map(|value| if value.is_nan() { u64::MAX } else { value.to_bits() }),
        );
        (bits, whole)
    };
    assert_eq!(bits(found), bits(wanted), "{found:?} is not {wanted:?}");
}

/// Behaviour of a full disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Manners {
    /// Fails in advance, as a file system that allocates does.
    Foresees,
    /// Writes what fits, then fails; the file can be truncated.
    Truncates,
    /// Writes what fits, then always fails.
    Stubborn,
    /// Fails once, half way through what exceeds its size, and then has capacity again.
    Hiccups,
}

/// A disk in memory with a limited size. The bytes can be read after the recorder is dropped.
#[derive(Clone)]
pub struct SmallDisk {
    pub bytes: Arc<Mutex<Vec<u8>>>,
    pub capacity: usize,
    pub failures: Arc<Mutex<u64>>,
    pub manners: Manners,
}

impl SmallDisk {
    pub fn new(capacity: usize, manners: Manners) -> Self {
        Self {
            bytes: Arc::default(),
            capacity,
            failures: Arc::default(),
            manners,
        }
    }

    pub fn content(&self) -> Vec<u8> {
        self.bytes.lock().expect("lock").clone()
    }
}

impl TraceSink for SmallDisk {
    fn append(&mut self, data: &[u8], reserve: u64) -> io::Result<()> {
        let mut bytes = self.bytes.lock().expect("lock");
        let capacity = self.capacity - bytes.len().min(self.capacity);
        let needed = data.len()
            + if self.manners == Manners::Foresees {
                reserve as usize
            } else {
                0
            };
        let healed = self.manners == Manners::Hiccups && *self.failures.lock().expect("lock") > 0;
        if needed > capacity && !healed {
            *self.failures.lock().expect("lock") += 1;
            if self.manners != Manners::Foresees {
                bytes.extend_from_slice(&data[..capacity]);
            }
            if self.manners == Manners::Hiccups {
                return Err(io::Error::other("the cable came loose"));
            }
            return Err(io::ErrorKind::StorageFull.into());
        }
        bytes.extend_from_slice(data);
        Ok(())
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        if self.manners == Manners::Stubborn {
            return Err(io::ErrorKind::Unsupported.into());
        }
        self.bytes.lock().expect("lock").truncate(length as usize);
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }

    fn end(&mut self) -> io::Result<()> {
        Ok(())
    }
}

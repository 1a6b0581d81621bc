//! Traces: every cycle of a run in one MCAP file that can be read for years, and by other programs.
//!
//! The input is the cycles, events and blocks of a run, with its program and machine; the output is a file
//! from which the run can be recomputed, and which Foxglove, Rerun and MCAP readers in any language open.
//!
//! ```
//! use evolvent_path::AxisLetter;
//! use evolvent_trace::{CycleRecord, Recorder, RunInfo, TraceFile};
//!
//! # let folder = tempfile::tempdir()?;
//! # let path = folder.path().join("part.mcap");
//! let run = RunInfo { axes: vec![AxisLetter::X], period_ns: 1_000_000, ..RunInfo::default() };
//! let mut recorder = Recorder::create(&path, &run)?;
//! for n in 0..1000 {
//!     let mut cycle = CycleRecord { sequence: n, due_time_ns: n * run.period_ns, ..CycleRecord::default() };
//!     cycle.position[0] = 0.01 * n as f64;
//!     recorder.cycle(&cycle)?;
//! }
//! recorder.finish(&Default::default())?;
//!
//! let last = TraceFile::open(&path)?.cycles().last().ok_or("no cycles")??;
//! assert_eq!((last.sequence, last.position[0]), (999, 9.99));
//! # Ok::<_, Box<dyn std::error::Error>>(())
//! ```
//!
//! # The model
//!
//! A trace is a sequence of chunks. A *chunk* is up to half a megabyte of *messages*, compressed, with a
//! checksum and the times it covers. Each message is on a *channel*: `/cycle`, `/event`, `/block` and so on.
//! The messages are protobuf, and the file carries their description. Whole chunks are appended and nothing
//! is written twice, so the file is valid up to its last complete chunk at every moment, whatever happens to
//! the program or the power. Until its end it is `NAME.mcap.part`; then it gets an index, and its name.
//!
//! - [`Recorder`] writes: `/cycle`, one message per cycle; or `/cycles`, every cycle in columns, a tenth of
//!   the size, with `/cycle` at most 2000 times per second for viewers; `/event`, `/block`, `/timing`, the
//!   tool's pose and path.
//! - [`RunInfo`] describes the run: the program, the machine file, period, versions.
//! - [`TraceFile`] reads the contents of a file, in the same time for any size, and its messages in order.
//! - [`recover`] makes a complete file of a torn or damaged one and reports the losses; [`recover_leftovers`]
//!   does so for all part files in a folder, at start-up.
//!
//! The `mcap` crate encodes and decodes the records of the container; its fields are described in
//! `docs/trace-format.md`.
//!
//! # What is guaranteed
//!
//! - At most the messages since the last [`Recorder::flush`] are lost. A full disk leaves a readable, indexed
//!   file.
//! - Every checksum is verified before a message is returned: damage is an error with path and offset, never
//!   a wrong value.
//! - A recorder's memory does not grow with its trace.
//! - Nothing in this crate may be called from the real-time cycle, except [`Histogram`], which counts without
//!   allocation. The cycle passes [`CycleRecord`]s by value.
//!
//! Lengths are in mm, times in the unit of their name. Times of the clock are Unix time in ns, or times of
//! the path if the clock is virtual. The reasons are in `docs/adr/0017-cycles-in-columns.md`,
//! `docs/adr/0026-mcap-crate.md`.

mod batch;
mod bits;
mod checked_map;
mod chunk;
mod column;
mod container;
mod decode;
mod encode;
mod histogram;
mod messages;
mod phase;
mod read_error;
mod reader;
mod record;
mod record_error;
mod recorder;
mod recover;
mod recover_error;
mod run_info;
mod scan;
mod scene;
mod schema;
mod scratch;
mod sink;
mod statistics;
mod summary;
mod trace_info;
mod whole;

pub use histogram::Histogram;
pub use messages::Messages;
pub use phase::{PhaseFigures, PhaseRecord, PhaseTally};
pub use read_error::ReadError;
pub use reader::{TraceFile, TraceMessage};
pub use record::{
    BlockKind, BlockRecord, CycleRecord, EventKind, EventRecord, LogLevel, TimingRecord, inputs,
};
pub use record_error::{RecordError, Remains};
pub use recorder::{Recorder, part_path};
pub use recover::{Recovered, recover, recover_leftovers};
pub use recover_error::RecoverError;
pub use run_info::{CONTINUES_AT, ProgramSource, RunInfo, configuration_hash};
pub use sink::{FileSink, TraceSink};
pub use statistics::RunStatistics;
pub use trace_info::{ChannelInfo, TraceInfo};

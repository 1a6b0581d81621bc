//! Traces: every cycle of a run in one MCAP file that is readable for years and by others.
//!
//! A trace is a file of chunks. A chunk is up to half a megabyte of messages, compressed, with a checksum and the span
//! of time that it covers; whole chunks are appended and nothing is written twice, so whatever happens to the
//! program or the power, the file is right up to its last complete chunk. While it is written it is called
//! `NAME.mcap.part`; at the end it gets an index and its name.
//!
//! - [`Recorder`] writes: `/cycle`, a message a cycle; or, where room matters, `/cycles`, every cycle in columns, and `/cycle` for
//!   viewers at most 2000 times a second; `/event`, `/block`, `/timing`, the tool's pose and path. The messages are protobuf; each file carries their description, so that foreign readers need nothing else.
//! - [`RunInfo`] is what makes a trace replayable alone: the program, the machine file, period, versions.
//! - [`TraceFile`] reads: what a file holds, at once and whatever its size, and the messages one after another.
//! - [`recover`] makes a complete file of a torn one and says what was lost; [`recover_leftovers`] does so for all
//!   part files in a folder, at start-up.
//!
//! Nothing here may be called from the real-time cycle, but [`CycleRecord`] is made to be handed over by it, and
//! [`Histogram`] counts without allocation. Lengths are in mm, times in the unit that the name bears; times of the
//! clock are Unix time in ns, times of the path where the clock is virtual.

mod batch;
mod bits;
mod checked_map;
mod chunk;
mod chunk_table;
mod column;
mod encode;
mod format;
mod histogram;
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
mod trace_info;
mod varint;
mod writer;

pub use histogram::Histogram;
pub use read_error::ReadError;
pub use reader::{Messages, TraceFile, TraceMessage};
pub use record::{
    BlockKind, BlockRecord, CycleRecord, EventKind, EventRecord, LogLevel, TimingRecord, inputs,
};
pub use record_error::{RecordError, Remains};
pub use recorder::{Recorder, part_path};
pub use recover::{Recovered, recover, recover_leftovers};
pub use recover_error::RecoverError;
pub use run_info::{ProgramSource, RunInfo, configuration_hash};
pub use sink::{FileSink, TraceSink};
pub use statistics::RunStatistics;
pub use trace_info::{ChannelInfo, TraceInfo};

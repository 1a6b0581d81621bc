//! Records a run.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read, Seek as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use evolvent_config::is_stream;

use crate::batch::Batch;
use crate::checked_map::with_checksum;
use crate::container::{Container, MessageHeader};
use crate::encode::put_cycle;
use crate::phase::PhaseRecord;
use crate::record::{BlockRecord, CycleRecord, EventRecord, LogLevel, TimingRecord};
use crate::record_error::{RecordError, Remains, write_error};
use crate::run_info::{ProgramSource, RunInfo};
use crate::scene::{self, Scene};
use crate::schema::{self, Channel, evolvent, foxglove, timestamp};
use crate::sink::{FileSink, TraceSink};
use crate::statistics::{RunStatistics, Tally};

/// A text longer than this is truncated; no line of a program and no message is that long.
const TEXT_BYTES: usize = 64 * 1024;
/// Maximum size of a program or tool table given in memory, and of the machine file.
const ATTACHMENT_BYTES: usize = u32::MAX as usize;

/// `/cycle` has at most about two messages in this time; above 2 kHz it omits cycles.
const VIEW_SPAN_NS: u64 = 1_000_000;

/// The name of a trace while it is written: `NAME.mcap.part`.
#[must_use]
pub fn part_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".part");
    PathBuf::from(name)
}

/// The folder that a file is in.
pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// Makes a rename survive a loss of power.
pub(crate) fn sync_folder_of(path: &Path) -> io::Result<()> {
    let folder = folder_of(path);
    // Not every system can open a folder as a file; there the rename is as safe as the system makes it.
    File::open(folder).map_or(Ok(()), |folder| folder.sync_all())
}

/// Writes the trace of one run.
///
/// For the recorder thread: every call may wait for the disk, so the cycle must not call any. A call adds its
/// message to the open chunk in memory. A full chunk is compressed and written, as is the open one by
/// [`Self::flush`], which the caller calls every 250 ms, so that at most this time is lost. After a failed
/// write the recorder truncates the file to its last complete chunk, closes and renames it if possible, and
/// returns the same error from then on.
///
/// From the cycles it also derives `/timing` every second, the tool's pose twenty times per second, and the
/// path.
#[derive(Debug)]
pub struct Recorder {
    container: Container,
    /// The present message, encoded.
    message: Vec<u8>,
    path: PathBuf,
    /// The part file, until it is renamed. `None` with a sink of the caller's.
    part: Option<PathBuf>,
    axes: Vec<u8>,
    /// The batch of cycles that are written in columns.
    batch: Option<Batch>,
    /// `/cycle` has every cycle whose number is a multiple of this.
    every: u64,
    tally: Tally,
    scene: Scene,
    last_time_ns: u64,
    failure: Option<RecordError>,
    finished: bool,
}

impl Recorder {
    /// Creates `PATH.part` and its folder, and writes the description of the run. A device or a pipe is
    /// written directly.
    ///
    /// # Errors
    /// [`RecordError`]: an invalid description, a left-over part file, no permission, a full disk.
    pub fn create(path: &Path, info: &RunInfo) -> Result<Self, RecordError> {
        if path.is_dir() || path.as_os_str().as_encoded_bytes().ends_with(b"/") {
            return Err(RecordError::Folder {
                path: path.to_owned(),
            });
        }
        let part = part_path(path);
        let create = |source| RecordError::Create {
            path: part.clone(),
            source: Arc::new(source),
        };
        check(info)?;
        if is_stream(path) {
            // A device or a pipe: a rename would put a file in its place.
            let sink = File::options()
                .write(true)
                .open(path)
                .and_then(FileSink::new)
                .map_err(|source| RecordError::Create {
                    path: path.to_owned(),
                    source: Arc::new(source),
                })?;
            return Self::start(Box::new(sink), path.to_owned(), None, info);
        }
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(create)?;
        }
        let file = match File::options().write(true).create_new(true).open(&part) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                return Err(RecordError::LeftOver { part });
            }
            result => result.map_err(create)?,
        };
        // The lock keeps a start-up that recovers left-over files from using this file. On file systems
        // without locks only the name decides.
        let _ = file.try_lock();
        let sink = FileSink::new(file).map_err(create)?;
        Self::start(Box::new(sink), path.to_owned(), Some(part), info)
    }

    /// Records into any sink. `name` is used in errors only.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn with_sink(sink: Box<dyn TraceSink>, name: &Path, info: &RunInfo) -> Result<Self, RecordError> {
        check(info)?;
        Self::start(sink, name.to_owned(), None, info)
    }

    fn start(
        sink: Box<dyn TraceSink>,
        path: PathBuf,
        part: Option<PathBuf>,
        info: &RunInfo,
    ) -> Result<Self, RecordError> {
        let opened = Container::new(
            sink,
            part.as_deref().map(folder_of),
            schema::PROFILE,
            schema::LIBRARY,
        );
        let container = match opened {
            Ok(container) => container,
            Err(source) => {
                let path = part.unwrap_or(path);
                return Err(write_error(path, 0, Remains::NeedsRecovery, Arc::new(source)));
            }
        };
        let axes: Vec<u8> = info.axes.iter().map(|axis| axis.index() as u8).collect();
        let mut recorder = Self {
            container,
            message: Vec::new(),
            path,
            part,
            batch: info.columns.then(|| Batch::new(axes.clone(), info.period_ns)),
            axes,
            every: if info.columns {
                (VIEW_SPAN_NS / info.period_ns).max(1)
            } else {
                1
            },
            tally: Tally::beginning_at(info.first_sequence()),
            scene: Scene::default(),
            last_time_ns: info.start_time_ns,
            failure: None,
            finished: false,
        };
        recorder.describe(info)?;
        Ok(recorder)
    }

    /// Writes metadata, schemas and attachments first, so that a torn file has them.
    fn describe(&mut self, info: &RunInfo) -> Result<(), RecordError> {
        let letters: String = info.axes.iter().map(|axis| axis.letter()).collect();
        let run = with_checksum(info.to_metadata());
        let result = self.container.metadata(schema::RUN, &run).and_then(|()| {
            schema::declare_channels(&mut self.container, &letters, self.every, self.batch.is_some());
            // Some readers fail at a chunk without a message.
            let text = format!("{} on {}", info.program_name, info.machine_name);
            let line = log_line(info.start_time_ns, LogLevel::Info, &text);
            self.put(Channel::Log, info.start_time_ns, 0, &line);
            self.container.close_chunk()
        });
        self.settle(result)?;
        let time_ns = info.start_time_ns;
        self.attach(
            &info.machine_file_name,
            "application/toml",
            time_ns,
            info.machine_file.as_bytes(),
        )?;
        if let Some((name, content)) = &info.tool_table {
            self.attach(name, "text/plain", time_ns, content)?;
        }
        if let Some((name, content)) = &info.parameters {
            self.attach(name, "text/plain", time_ns, content)?;
        }
        for (name, content) in &info.tables {
            self.attach(name, "text/plain", time_ns, content)?;
        }
        match &info.program {
            ProgramSource::None => {}
            ProgramSource::Bytes(bytes) => self.attach(&info.program_name, "text/x-gcode", time_ns, bytes)?,
            ProgramSource::File(path) => self.attach_file(&info.program_name, path, time_ns)?,
        }
        let result = self.container.sync();
        self.settle(result)
    }

    fn attach(&mut self, name: &str, media_type: &str, time_ns: u64, data: &[u8]) -> Result<(), RecordError> {
        if name.is_empty() && data.is_empty() {
            return Ok(());
        }
        let result = self
            .container
            .attach(name, media_type, time_ns, data.len() as u64, &mut &data[..]);
        self.settle(result)
    }

    /// Attaches a text during the run, such as the program of a job. The open chunk is closed first.
    ///
    /// # Errors
    /// As [`Self::cycle`].
    pub fn attach_text(&mut self, name: &str, time_ns: u64, text: &[u8]) -> Result<(), RecordError> {
        self.check_failure()?;
        self.attach(name, "text/plain", time_ns, text)
    }

    /// Attaches a program during the run, from an open file; `path` names it in errors.
    ///
    /// # Errors
    /// As [`Self::cycle`], and [`RecordError::Attach`] if reading fails.
    pub fn attach_program(
        &mut self,
        name: &str,
        time_ns: u64,
        path: &Path,
        file: &File,
    ) -> Result<(), RecordError> {
        self.check_failure()?;
        self.attach_open(name, path, file, time_ns)
    }

    fn attach_file(&mut self, name: &str, path: &Path, time_ns: u64) -> Result<(), RecordError> {
        let attach = |source| RecordError::Attach {
            path: path.to_owned(),
            source: Arc::new(source),
        };
        let file = File::open(path).map_err(attach)?;
        self.attach_open(name, path, &file, time_ns)
    }

    fn attach_open(
        &mut self,
        name: &str,
        path: &Path,
        mut file: &File,
        time_ns: u64,
    ) -> Result<(), RecordError> {
        let attach = |source| RecordError::Attach {
            path: path.to_owned(),
            source: Arc::new(source),
        };
        file.rewind().map_err(attach)?;
        let size = file.metadata().map_err(attach)?.len();
        // A failed read is an error of the program's file, not of the disk: it is distinguished from failed
        // writes.
        let mut source = Watched {
            inner: &mut file,
            failure: None,
        };
        let result = self
            .container
            .attach(name, "text/x-gcode", time_ns, size, &mut source);
        match source.failure {
            Some(failure) => {
                let error = attach(failure);
                self.failure = Some(error.clone());
                Err(error)
            }
            None => self.settle(result),
        }
    }

    /// Records a cycle.
    ///
    /// # Errors
    /// [`RecordError::DiskFull`] or [`RecordError::Write`]; the same again from then on.
    pub fn cycle(&mut self, record: &CycleRecord) -> Result<(), RecordError> {
        self.check_failure()?;
        let time_ns = record.due_time_ns;
        if self
            .batch
            .as_ref()
            .is_some_and(|batch| batch.must_go_before(record))
        {
            self.put_batch();
        }
        let shown = match &mut self.batch {
            None => *record,
            Some(batch) => {
                batch.push(record);
                for_view(record)
            }
        };
        if record.sequence.is_multiple_of(self.every) {
            self.message.clear();
            put_cycle(&mut self.message, &shown, &self.axes);
            self.put_encoded(Channel::Cycle, time_ns, record.sequence);
        }
        self.last_time_ns = time_ns;
        if let Some(second) = self.tally.cycle(record) {
            self.put_timing(&second);
        }
        if let Some(pose) = self.scene.pose(record) {
            self.put(Channel::ToolPose, time_ns, record.sequence, &pose);
        }
        if let Some(path) = self.scene.path(record) {
            self.put(Channel::ToolPath, time_ns, record.sequence, &path);
        }
        self.close_full_chunk()
    }

    /// Counts what the phase lock did in the cycle that was recorded last: for `/timing` and the summary.
    pub fn phase(&mut self, record: &PhaseRecord) {
        self.tally.phase(record);
    }

    /// Records an event.
    ///
    /// # Errors
    /// As [`Self::cycle`].
    pub fn event(&mut self, record: &EventRecord) -> Result<(), RecordError> {
        self.check_failure()?;
        self.tally.event(record.kind);
        let event = evolvent::Event {
            timestamp: Some(timestamp(record.time_ns)),
            sequence: record.sequence,
            kind: record.kind as i32,
            code: record.code,
            text: cut(&record.text),
            value: record.value,
        };
        self.put(Channel::Event, record.time_ns, record.sequence, &event);
        self.close_full_chunk()
    }

    /// Records an executed block.
    ///
    /// # Errors
    /// As [`Self::cycle`].
    pub fn block(&mut self, record: &BlockRecord) -> Result<(), RecordError> {
        self.check_failure()?;
        let block = evolvent::Block {
            timestamp: Some(timestamp(record.time_ns)),
            line: record.line,
            text: cut(&record.text),
            kind: record.kind as i32,
            length_mm: record.length_mm,
            planned_duration_s: record.planned_duration_s,
            true_duration_s: record.true_duration_s,
            start_sequence: record.start_sequence,
        };
        self.put(Channel::Block, record.time_ns, record.start_sequence, &block);
        self.close_full_chunk()
    }

    /// Records times measured elsewhere. Those of the cycles need no call: the recorder writes them every
    /// second.
    ///
    /// # Errors
    /// As [`Self::cycle`].
    pub fn timing(&mut self, record: &TimingRecord) -> Result<(), RecordError> {
        self.check_failure()?;
        self.put_timing(record);
        self.close_full_chunk()
    }

    /// Records the tool's position, in mm, in addition to those that the recorder takes from the cycles.
    ///
    /// # Errors
    /// As [`Self::cycle`].
    pub fn pose(&mut self, time_ns: u64, position_mm: [f64; 3]) -> Result<(), RecordError> {
        self.check_failure()?;
        self.put(Channel::ToolPose, time_ns, 0, &scene::pose(time_ns, position_mm));
        self.close_full_chunk()
    }

    /// Records a line of text for the operator.
    ///
    /// # Errors
    /// As [`Self::cycle`].
    pub fn log(&mut self, time_ns: u64, level: LogLevel, text: &str) -> Result<(), RecordError> {
        self.check_failure()?;
        let log = log_line(time_ns, level, text);
        self.put(Channel::Log, time_ns, 0, &log);
        self.close_full_chunk()
    }

    /// Writes the open chunk and starts a synchronisation with the disk, without waiting for it. Call it
    /// every 250 ms.
    ///
    /// # Errors
    /// As [`Self::cycle`], or the failure of an earlier synchronisation.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.check_failure()?;
        self.put_batch();
        let result = self.container.close_chunk().and_then(|()| self.container.sync());
        self.settle(result)
    }

    /// Statistics of the recording so far.
    #[must_use]
    pub fn statistics(&self) -> &RunStatistics {
        self.tally.run()
    }

    /// Bytes written so far.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.container.position()
    }

    /// Ends the trace: writes the summary with the caller's additions, waits for the disk, and gives the file
    /// its final name, which is returned.
    ///
    /// # Errors
    /// As [`Self::cycle`], or [`RecordError::Rename`].
    pub fn finish(mut self, summary: &BTreeMap<String, String>) -> Result<PathBuf, RecordError> {
        self.check_failure()?;
        self.end_streams();
        let result = self.write_end(summary);
        self.settle(result)?;
        self.finished = true;
        self.rename()?;
        Ok(self.path.clone())
    }

    /// Writes the last second and the last part of the path.
    fn end_streams(&mut self) {
        self.put_batch();
        if let Some(second) = self.tally.end_second() {
            self.put_timing(&second);
        }
        if let Some(path) = self.scene.stretch(self.last_time_ns) {
            self.put(Channel::ToolPath, self.last_time_ns, 0, &path);
        }
    }

    fn write_end(&mut self, summary: &BTreeMap<String, String>) -> io::Result<()> {
        let mut map = self.tally.run().to_metadata();
        for (key, value) in summary {
            map.entry(key.clone()).or_insert_with(|| cut(value));
        }
        self.container.metadata(schema::SUMMARY, &with_checksum(map))?;
        self.container.finish()
    }

    fn rename(&mut self) -> Result<(), RecordError> {
        let Some(part) = self.part.take() else {
            return Ok(());
        };
        fs::rename(&part, &self.path)
            .and_then(|()| sync_folder_of(&self.path))
            .map_err(|source| RecordError::Rename {
                from: part,
                to: self.path.clone(),
                source: Arc::new(source),
            })
    }

    fn put(&mut self, channel: Channel, time_ns: u64, sequence: u64, message: &impl prost::Message) {
        self.message.clear();
        self.message.reserve(message.encoded_len());
        message.encode_raw(&mut self.message);
        self.put_encoded(channel, time_ns, sequence);
    }

    fn put_encoded(&mut self, channel: Channel, time_ns: u64, sequence: u64) {
        let header = MessageHeader {
            channel_id: channel.id(),
            sequence: sequence as u32,
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.container.message(&header, &self.message);
    }

    /// Writes the gathered cycles.
    fn put_batch(&mut self) {
        if let Some(batch) = self.batch.as_mut().and_then(Batch::take) {
            self.put(Channel::Cycles, batch.due_time_ns, batch.start_sequence, &batch);
        }
    }

    fn put_timing(&mut self, record: &TimingRecord) {
        let timing = evolvent::Timing {
            timestamp: Some(timestamp(record.time_ns)),
            start_sequence: record.start_sequence,
            cycles: record.cycles,
            late_cycles: record.late_cycles,
            lateness: Some(record.lateness.message()),
            work: Some(record.work.message()),
            phase: record.phase.message(),
        };
        self.put(Channel::Timing, record.time_ns, record.start_sequence, &timing);
    }

    fn close_full_chunk(&mut self) -> Result<(), RecordError> {
        if !self.container.chunk_is_full() {
            return Ok(());
        }
        // A chunk is self-contained: the cycles of its `/cycle` are also in its `/cycles`.
        self.put_batch();
        let result = self.container.close_chunk();
        self.settle(result)
    }

    fn check_failure(&self) -> Result<(), RecordError> {
        match &self.failure {
            None => Ok(()),
            Some(error) => Err(error.clone()),
        }
    }

    /// Handles a failed write: saves as much as possible and keeps the error.
    fn settle(&mut self, result: io::Result<()>) -> Result<(), RecordError> {
        let Err(source) = result else { return Ok(()) };
        // No summary of the run: it would include cycles that are not in the file.
        let note = BTreeMap::from([("failure".to_owned(), source.to_string())]);
        let closed = self
            .container
            .cut_back()
            .and_then(|()| self.container.metadata(schema::RECOVERY, &with_checksum(note)))
            .and_then(|()| self.container.finish())
            .is_ok();
        let bytes = self.container.position();
        let remains = if closed && self.rename().is_ok() {
            Remains::Complete
        } else {
            // An incomplete ending disturbs a recovery, but cannot always be cut off.
            let _ = self.container.cut_back();
            Remains::NeedsRecovery
        };
        let path = self.part.clone().unwrap_or_else(|| self.path.clone());
        let error = write_error(path, bytes, remains, Arc::new(source));
        self.failure = Some(error.clone());
        Err(error)
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if !self.finished && self.failure.is_none() {
            // A failure cannot be reported any more. The part file stays and is recovered at the next start.
            self.put_batch();
            let _ = self.container.close_chunk().and_then(|()| self.container.sync());
        }
    }
}

/// A cycle for viewers: derivatives of the position are rounded to 24 bits, which halves its size.
fn for_view(record: &CycleRecord) -> CycleRecord {
    let round = |value: f64| f64::from(value as f32);
    CycleRecord {
        feed_mm_s: round(record.feed_mm_s),
        velocity: record.velocity.map(round),
        acceleration: record.acceleration.map(round),
        jerk: record.jerk.map(round),
        ..*record
    }
}

fn check(info: &RunInfo) -> Result<(), RecordError> {
    let invalid = |reason: String| Err(RecordError::Invalid { reason });
    if info.axes.is_empty() {
        return invalid("it has no axes".to_owned());
    }
    for (at, axis) in info.axes.iter().enumerate() {
        if info.axes[..at].contains(axis) {
            return invalid(format!("axis {} is named twice", axis.letter()));
        }
    }
    if info.period_ns == 0 {
        return invalid("its control period is 0 ns".to_owned());
    }
    let program = match &info.program {
        ProgramSource::Bytes(bytes) => bytes.len(),
        ProgramSource::None | ProgramSource::File(_) => 0,
    };
    let parameters = info.parameters.as_ref().map_or(0, |(_, content)| content.len());
    let tools = info.tool_table.as_ref().map_or(0, |(_, content)| content.len());
    let tables = info
        .tables
        .iter()
        .map(|(_, content)| content.len())
        .max()
        .unwrap_or(0);
    for (name, size) in [
        ("program", program),
        ("machine file", info.machine_file.len()),
        ("tool table", tools),
        ("file of parameters", parameters),
        ("largest table", tables),
    ] {
        if size > ATTACHMENT_BYTES {
            return invalid(format!(
                "its {name} has {size} bytes, more than {ATTACHMENT_BYTES}"
            ));
        }
    }
    let longest = info
        .to_metadata()
        .iter()
        .map(|(key, value)| key.len().max(value.len()))
        .max()
        .unwrap_or(0);
    if longest > TEXT_BYTES {
        return invalid(format!(
            "one of its texts has {longest} bytes, more than {TEXT_BYTES}"
        ));
    }
    Ok(())
}

/// A line of text for the operator.
pub(crate) fn log_line(time_ns: u64, level: LogLevel, text: &str) -> foxglove::Log {
    foxglove::Log {
        timestamp: Some(timestamp(time_ns)),
        level: level as i32,
        message: cut(text),
        name: "evolvent".to_owned(),
    }
}

/// A text of at most [`TEXT_BYTES`].
fn cut(text: &str) -> String {
    let mut end = text.len().min(TEXT_BYTES);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text[..end].to_owned()
}

/// Passes reads on and stores their failure.
struct Watched<'a> {
    inner: &'a mut dyn Read,
    failure: Option<io::Error>,
}

impl Read for Watched<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self.inner.read(buffer) {
            // The size was determined before: an early end means that the file became shorter meanwhile.
            Ok(0) if !buffer.is_empty() => {
                self.failure = Some(io::ErrorKind::UnexpectedEof.into());
                Ok(0)
            }
            Err(error) if error.kind() != io::ErrorKind::Interrupted => {
                let again = io::Error::from(error.kind());
                self.failure = Some(error);
                Err(again)
            }
            result => result,
        }
    }
}

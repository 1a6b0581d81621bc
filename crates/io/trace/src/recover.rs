//! Makes complete traces of torn ones.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use evolvent_config::is_stream;
use mcap::MAGIC;
use mcap::records::{Record, op};
use prost::Message as _;

use crate::batch;
use crate::checked_map::{with_checksum, without_checksum};
use crate::chunk::{self, ChunkRecords, Damaged, MAX_CHUNK_BYTES, RECORD_HEAD};
use crate::container::{Container, MessageHeader};
use crate::decode;
use crate::reader::{FOOTER_LENGTH, attachment_head, open_file};
use crate::record::{CycleRecord, EventKind, LogLevel};
use crate::recorder::{folder_of, log_line, sync_folder_of};
use crate::recover_error::RecoverError;
use crate::run_info::RunInfo;
use crate::scan::{SEARCH_BYTES, Scan};
use crate::schema::{self, Channel, evolvent};
use crate::sink::FileSink;
use crate::statistics::RunStatistics;
use crate::trace_info::ChannelInfo;

/// Maximum size of an attachment's header; a larger one is invalid.
const MAX_ATTACHMENT_HEAD: u64 = 64 * 1024;

/// Axes to use if the description of the run, and with it the machine's axes, is lost: all.
const ALL_AXES: [usize; 9] = [0, 1, 2, 3, 4, 5, 6, 7, 8];

/// Result of a recovery.
#[derive(Clone, Debug, PartialEq)]
pub struct Recovered {
    /// The torn file.
    pub source: PathBuf,
    /// The complete file made of it.
    pub path: PathBuf,
    /// Whether the file was complete.
    pub was_complete: bool,
    /// The messages saved, by channel.
    pub channels: Vec<ChannelInfo>,
    /// Statistics of the saved cycles: last number, gaps, late ones.
    pub statistics: RunStatistics,
    /// Chunks saved.
    pub chunks: u64,
    /// Attachments saved.
    pub attachments: u64,
    /// Number of damaged places before the end that were left out.
    pub damaged_places: u64,
    /// Whether the description of the run (the metadata `evolvent.run`) was saved.
    pub has_run: bool,
    /// Bytes that could not be used.
    pub bytes_dropped: u64,
}

impl Recovered {
    /// Whether anything was lost that the file once held.
    #[must_use]
    pub fn lost_data(&self) -> bool {
        self.bytes_dropped > 0 || self.damaged_places > 0
    }
}

/// Makes a complete, indexed trace from a truncated or damaged `source`. It is written to `output`, or next
/// to `source`: `NAME.mcap` for `NAME.mcap.part`, otherwise `NAME.recovered.mcap`. Every chunk and attachment
/// that matches its checksum is kept. The result appears under its name only when it is complete and on disk;
/// `source` is kept.
///
/// ```
/// # use evolvent_path::AxisLetter;
/// # use evolvent_trace::{CycleRecord, Recorder, RunInfo, TraceFile, part_path, recover};
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("part.mcap");
/// # let run = RunInfo { axes: vec![AxisLetter::X], period_ns: 1_000_000, ..RunInfo::default() };
/// let mut recorder = Recorder::create(&path, &run)?;
/// recorder.cycle(&CycleRecord::default())?;
/// // Without `finish`, as after an error elsewhere: the part file has no index.
/// drop(recorder);
///
/// let recovered = recover(&part_path(&path), None)?;
/// assert_eq!((&recovered.path, recovered.statistics.cycles), (&path, 1));
/// assert!(!recovered.was_complete && !recovered.lost_data());
/// assert_eq!(TraceFile::open(&path)?.cycles().count(), 1);
/// # Ok::<_, Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`RecoverError`]. `source` is untouched in any case, unless `output` names it.
pub fn recover(source: &Path, output: Option<&Path>) -> Result<Recovered, RecoverError> {
    let read = |error| RecoverError::Read {
        path: source.to_owned(),
        source: error,
    };
    let file = open_file(source).map_err(read)?;
    if let Err(TryLockError::WouldBlock) = file.try_lock_shared() {
        return Err(RecoverError::InUse {
            path: source.to_owned(),
        });
    }
    let output = output.map_or_else(|| default_output(source), Path::to_owned);
    let is_stream = is_stream(&output);
    let mut temporary = output.as_os_str().to_owned();
    if !is_stream {
        temporary.push(".recovering");
    }
    let temporary = PathBuf::from(temporary);
    let write = |error| RecoverError::Write {
        path: output.clone(),
        source: error,
    };

    let length = file.metadata().map_err(read)?.len();
    let mut scan = Scan { file, length };
    if length < MAGIC.len() as u64 || scan.read(0, MAGIC.len()).map_err(read)? != MAGIC {
        return Err(RecoverError::NotATrace {
            path: source.to_owned(),
            bytes: length,
        });
    }
    let result = File::create(&temporary)
        .and_then(FileSink::new)
        .and_then(|sink| {
            let folder = Some(folder_of(&output));
            Container::new(Box::new(sink), folder, schema::PROFILE, schema::LIBRARY)
        })
        .map_err(write)
        .and_then(|container| {
            let mut rescue = Rescue::new(container);
            match rescue.run(&mut scan) {
                Err(Trouble::Read(error)) => return Err(read(error)),
                Err(Trouble::Write(error)) => return Err(write(error)),
                Ok(()) => {}
            }
            let recovered = rescue.finish(source, &output, length).map_err(write)?;
            if !is_stream {
                fs::rename(&temporary, &output)
                    .and_then(|()| sync_folder_of(&output))
                    .map_err(write)?;
            }
            Ok(recovered)
        });
    if result.is_err() && !is_stream {
        // It may not even exist.
        let _ = fs::remove_file(&temporary);
    }
    result
}

/// Recovers every `*.mcap.part` in a folder that no running recorder holds; to be called at start-up. A part
/// file that was only truncated is removed once it is recovered; one that is damaged before its end is kept
/// as `*.mcap.damaged`. A missing folder counts as empty.
///
/// # Errors
/// If the folder cannot be read. The result of each file is in the list.
pub fn recover_leftovers(folder: &Path) -> io::Result<Vec<(PathBuf, Result<Recovered, RecoverError>)>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut parts = Vec::new();
    for entry in entries {
        let path = entry?.path();
        if path
            .file_name()
            .is_some_and(|name| name.to_string_lossy().ends_with(".mcap.part"))
        {
            parts.push(path);
        }
    }
    parts.sort();
    let mut results = Vec::new();
    for part in parts {
        let result = recover(&part, None).and_then(|recovered| {
            let away = if recovered.damaged_places == 0 {
                fs::remove_file(&part)
            } else {
                fs::rename(&part, part.with_extension("damaged"))
            };
            away.map_err(|source| RecoverError::Write {
                path: part.clone(),
                source,
            })?;
            Ok(recovered)
        });
        if !matches!(result, Err(RecoverError::InUse { .. })) {
            results.push((part, result));
        }
    }
    Ok(results)
}

/// A free name next to the torn file.
fn default_output(source: &Path) -> PathBuf {
    let name = source
        .file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default();
    if let Some(plain) = name.strip_suffix(".part") {
        let plain = source.with_file_name(plain);
        if !plain.exists() {
            return plain;
        }
    }
    let stem = name
        .trim_end_matches(".part")
        .trim_end_matches(".mcap")
        .to_owned();
    (1..)
        .map(|number| match number {
            1 => source.with_file_name(format!("{stem}.recovered.mcap")),
            _ => source.with_file_name(format!("{stem}.recovered-{number}.mcap")),
        })
        .find(|path| !path.exists())
        .unwrap_or_else(|| source.with_extension("recovered"))
}

enum Trouble {
    Read(io::Error),
    Write(io::Error),
}

/// Result of a record.
enum Fate {
    Kept,
    Damaged,
    End,
}

/// State of a recovery.
struct Rescue {
    container: Container,
    statistics: RunStatistics,
    /// Number of saved messages by channel.
    counts: BTreeMap<u16, u64>,
    axes: Option<Vec<usize>>,
    letters: String,
    has_run: bool,
    old_summary: BTreeMap<String, String>,
    chunks: u64,
    attachments: u64,
    damaged_places: u64,
    bytes_dropped: u64,
    reached_end: bool,
    /// Whether no chunk with declarations has been found yet.
    declared_none: bool,
}

impl Rescue {
    fn new(container: Container) -> Self {
        Self {
            container,
            statistics: RunStatistics::default(),
            counts: BTreeMap::new(),
            axes: None,
            letters: String::new(),
            has_run: false,
            old_summary: BTreeMap::new(),
            chunks: 0,
            attachments: 0,
            damaged_places: 0,
            bytes_dropped: 0,
            reached_end: false,
            declared_none: true,
        }
    }

    /// Reads the file, keeps complete records, and searches for the next chunk after a damaged one.
    fn run(&mut self, scan: &mut Scan) -> Result<(), Trouble> {
        let mut offset = MAGIC.len() as u64;
        while offset < scan.length {
            let head = scan.head(offset).map_err(Trouble::Read)?;
            let fate = match head {
                Some((opcode, length)) => self.record(scan, offset, opcode, length)?,
                None => Fate::Damaged,
            };
            let after = head.map_or(offset, |(_, length)| offset + RECORD_HEAD as u64 + length);
            match fate {
                Fate::Kept => offset = after,
                Fate::End => {
                    self.reached_end = true;
                    let whole = self.ends_well(scan, after).map_err(Trouble::Read)?;
                    if !whole {
                        // After the data is only the index, which is written again.
                        self.reached_end = false;
                    }
                    return Ok(());
                }
                Fate::Damaged => {
                    // If a record can follow, only this one is lost; otherwise search for the next chunk.
                    let follows = after > offset && scan.head(after).map_err(Trouble::Read)?.is_some();
                    let next = if follows {
                        Some(after)
                    } else {
                        scan.next_chunk(offset + 1).map_err(Trouble::Read)?
                    };
                    let next_or_end = next.unwrap_or(scan.length);
                    self.bytes_dropped += next_or_end - offset;
                    // A tail is only torn; data between complete records are damaged.
                    self.damaged_places += u64::from(next.is_some());
                    offset = next_or_end;
                }
            }
        }
        Ok(())
    }

    /// Whether summary and footer after the data are complete.
    fn ends_well(&self, scan: &mut Scan, summary: u64) -> io::Result<bool> {
        let tail = (FOOTER_LENGTH + MAGIC.len()) as u64;
        if scan.length < summary + tail || scan.length - summary > MAX_CHUNK_BYTES {
            return Ok(false);
        }
        let bytes = scan.read(summary, (scan.length - summary) as usize)?;
        let (guarded, rest) = bytes.split_at(bytes.len() - MAGIC.len() - 4);
        let (crc, magic) = rest.split_at(4);
        Ok(magic == MAGIC && crc == crc32fast::hash(guarded).to_le_bytes())
    }

    fn record(&mut self, scan: &mut Scan, offset: u64, opcode: u8, length: u64) -> Result<Fate, Trouble> {
        let content_at = offset + RECORD_HEAD as u64;
        match opcode {
            op::DATA_END => Ok(if length == 4 { Fate::End } else { Fate::Damaged }),
            op::ATTACHMENT => self.attachment(scan, content_at, length),
            op::CHUNK if length <= MAX_CHUNK_BYTES => {
                let size = RECORD_HEAD + length as usize;
                self.chunk(&scan.read(offset, size).map_err(Trouble::Read)?)
            }
            op::METADATA if length <= MAX_CHUNK_BYTES => {
                self.metadata(&scan.read(content_at, length as usize).map_err(Trouble::Read)?)
            }
            // The index of the previous chunk is written again; the header has no needed data.
            op::MESSAGE_INDEX | op::HEADER => Ok(Fate::Kept),
            // The recorder puts no other records outside chunks.
            _ => Ok(Fate::Damaged),
        }
    }

    fn metadata(&mut self, content: &[u8]) -> Result<Fate, Trouble> {
        let Some(Record::Metadata(record)) = chunk::parse(op::METADATA, content) else {
            return Ok(Fate::Damaged);
        };
        let Some(map) = without_checksum(record.metadata) else {
            return Ok(Fate::Damaged);
        };
        let name = record.name.as_str();
        if name == schema::SUMMARY {
            // Its counts are computed again; the rest is kept.
            self.old_summary = map;
            return Ok(Fate::Kept);
        }
        if name == schema::RUN
            && let Some(run) = RunInfo::from_metadata(&map)
        {
            self.statistics.begin_at(run.first_sequence());
            self.letters = run.axes.iter().map(|axis| axis.letter()).collect();
            self.axes = Some(run.axes.iter().map(|axis| axis.index()).collect());
            self.has_run = true;
        }
        self.container
            .metadata(name, &with_checksum(map))
            .map_err(Trouble::Write)?;
        Ok(Fate::Kept)
    }

    fn attachment(&mut self, scan: &mut Scan, content_at: u64, length: u64) -> Result<Fate, Trouble> {
        let head_length = length.min(MAX_ATTACHMENT_HEAD);
        let head = scan
            .read(content_at, head_length as usize)
            .map_err(Trouble::Read)?;
        let Some((header, size, rest)) = attachment_head(&head) else {
            return Ok(Fate::Damaged);
        };
        let data_at = head_length - rest.len() as u64;
        if data_at.checked_add(size).and_then(|sum| sum.checked_add(4)) != Some(length) {
            return Ok(Fate::Damaged);
        }
        // Once for the checksum, once to copy: it may be larger than memory.
        let mut crc = crc32fast::Hasher::new();
        let mut left = length - 4;
        scan.file
            .seek(SeekFrom::Start(content_at))
            .map_err(Trouble::Read)?;
        let mut piece = vec![0; SEARCH_BYTES];
        while left > 0 {
            let now = piece.len().min(usize::try_from(left).unwrap_or(SEARCH_BYTES));
            scan.file.read_exact(&mut piece[..now]).map_err(Trouble::Read)?;
            crc.update(&piece[..now]);
            left -= now as u64;
        }
        let mut saved = [0; 4];
        scan.file.read_exact(&mut saved).map_err(Trouble::Read)?;
        if u32::from_le_bytes(saved) != crc.finalize() {
            return Ok(Fate::Damaged);
        }
        scan.file
            .seek(SeekFrom::Start(content_at + data_at))
            .map_err(Trouble::Read)?;
        self.container
            .attach(
                &header.name,
                &header.media_type,
                header.log_time,
                size,
                &mut scan.file,
            )
            .map_err(Trouble::Write)?;
        self.attachments += 1;
        Ok(Fate::Kept)
    }

    fn chunk(&mut self, record: &[u8]) -> Result<Fate, Trouble> {
        let Ok(records) = self.whole_records(record) else {
            return Ok(Fate::Damaged);
        };
        let is_message = |record: &&(u8, Vec<u8>)| record.0 == op::MESSAGE;
        let messages = || {
            records
                .iter()
                .filter(is_message)
                .filter_map(|(_, content)| chunk::message(content))
        };
        if self.declared_none && records.iter().all(|record| is_message(&record)) {
            self.declare_again(messages().map(|(header, _)| header.log_time).min());
        }
        self.declared_none = false;
        for (opcode, content) in &records {
            match chunk::parse(*opcode, content) {
                Some(Record::Schema { header, data }) => {
                    self.container
                        .schema(header.id, &header.name, &header.encoding, &data);
                }
                Some(Record::Channel(channel)) => self.container.channel(channel),
                _ => {}
            }
        }
        let has_batches = messages().any(|(header, _)| header.channel_id == Channel::Cycles.id());
        for (header, data) in messages() {
            self.count(&header, data, has_batches);
            self.container.message(&header, data);
        }
        self.container.close_chunk().map_err(Trouble::Write)?;
        self.chunks += 1;
        Ok(Fate::Kept)
    }

    /// Opcodes and contents of a chunk's records, if each can be written again.
    fn whole_records(&self, record: &[u8]) -> Result<Vec<(u8, Vec<u8>)>, Damaged> {
        let mut chunk = ChunkRecords::new(record)?;
        let mut records = Vec::new();
        let (mut schemas, mut channels) = (Vec::new(), Vec::new());
        while let Some((opcode, content)) = chunk.next()? {
            let is_known = match chunk::parse(opcode, content).ok_or(Damaged)? {
                Record::Schema { header, .. } => {
                    schemas.push(header.id);
                    header.id != 0
                }
                Record::Channel(channel) => {
                    channels.push(channel.id);
                    let id = channel.schema_id;
                    id == 0 || schemas.contains(&id) || self.container.has_schema(id)
                }
                Record::Message { header, .. } => {
                    let id = header.channel_id;
                    // Channel numbers never change, so if all declarations are lost, ours apply.
                    let is_ours = self.declared_none && Channel::ALL.iter().any(|channel| channel.id() == id);
                    channels.contains(&id) || self.container.has_channel(id) || is_ours
                }
                _ => continue,
            };
            if !is_known {
                return Err(Damaged);
            }
            records.push((opcode, content.to_vec()));
        }
        Ok(records)
    }

    /// Writes the descriptions of the channels again if their chunk is lost, and notes it.
    fn declare_again(&mut self, time_ns: Option<u64>) {
        schema::declare_channels(&mut self.container, &self.letters, 1, true);
        let time_ns = time_ns.unwrap_or(0);
        let text = "the descriptions of the channels were lost and are written again by the recovery";
        let header = MessageHeader {
            channel_id: Channel::Log.id(),
            sequence: 0,
            log_time: time_ns,
            publish_time: time_ns,
        };
        let line = log_line(time_ns, LogLevel::Warning, text).encode_to_vec();
        self.container.message(&header, &line);
        *self.counts.entry(Channel::Log.id()).or_default() += 1;
    }

    /// Adds a message to the statistics.
    fn count(&mut self, header: &MessageHeader, data: &[u8], has_batches: bool) {
        *self.counts.entry(header.channel_id).or_default() += 1;
        match self
            .container
            .topic(header.channel_id)
            .and_then(Channel::of_topic)
        {
            Some(Channel::Cycles) => {
                let axes = self.axes.as_deref().unwrap_or(&ALL_AXES);
                let batch = evolvent::Cycles::decode(data).ok();
                let cycles = batch.and_then(|batch| batch::cycles(&batch, axes));
                for cycle in cycles.unwrap_or_default() {
                    self.statistics.cycle(&cycle);
                }
            }
            Some(Channel::Cycle) if !has_batches => {
                if let Some(cycle) = self.cycle(data) {
                    self.statistics.cycle(&cycle);
                }
            }
            Some(Channel::Event) => {
                if let Ok(event) = evolvent::Event::decode(data) {
                    let alarm = EventKind::Alarm;
                    self.statistics
                        .event((event.kind == alarm as i32).then_some(alarm));
                }
            }
            _ => {}
        }
    }

    /// Decodes a cycle for the statistics; without the axes if the description of the run is lost.
    fn cycle(&self, data: &[u8]) -> Option<CycleRecord> {
        let message = evolvent::Cycle::decode(data).ok()?;
        let record = CycleRecord {
            sequence: message.sequence,
            wake_lateness_ns: message.wake_lateness_ns,
            work_ns: message.work_ns,
            flags: message.flags,
            ..CycleRecord::default()
        };
        match &self.axes {
            Some(axes) => decode::cycle(&message, axes),
            None => Some(record),
        }
    }

    fn finish(mut self, source: &Path, output: &Path, length: u64) -> io::Result<Recovered> {
        let was_complete = self.reached_end && self.damaged_places == 0 && self.bytes_dropped == 0;
        let mut summary = self.statistics.to_metadata();
        for (key, value) in std::mem::take(&mut self.old_summary) {
            summary.entry(key).or_insert(value);
        }
        self.container
            .metadata(schema::SUMMARY, &with_checksum(summary))?;
        let note = BTreeMap::from([
            ("source_bytes".to_owned(), length.to_string()),
            ("was_complete".to_owned(), was_complete.to_string()),
            ("damaged_places".to_owned(), self.damaged_places.to_string()),
            ("bytes_dropped".to_owned(), self.bytes_dropped.to_string()),
        ]);
        self.container.metadata(schema::RECOVERY, &with_checksum(note))?;
        self.container.finish()?;
        let channels = self
            .container
            .channels()
            .map(|(id, topic, message)| ChannelInfo {
                topic: topic.to_owned(),
                message: message.to_owned(),
                messages: self.counts.get(&id).copied().unwrap_or(0),
            })
            .collect();
        Ok(Recovered {
            source: source.to_owned(),
            path: output.to_owned(),
            was_complete,
            channels,
            statistics: self.statistics,
            chunks: self.chunks,
            attachments: self.attachments,
            damaged_places: self.damaged_places,
            has_run: self.has_run,
            bytes_dropped: self.bytes_dropped,
        })
    }
}

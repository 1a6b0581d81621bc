//! Makes complete traces of torn ones.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use prost::Message as _;

use crate::batch;
use crate::checked_map::{with_checksum, without_checksum};
use crate::chunk::{self, Inner, MAX_CHUNK_BYTES};
use crate::format::{ChunkHead, FOOTER_LENGTH, Fields, MAGIC, RECORD_HEAD, op};
use crate::record::{CycleRecord, EventKind, LogLevel};
use crate::recorder::{log_line, sync_folder_of};
use crate::recover_error::RecoverError;
use crate::run_info::RunInfo;
use crate::scan::{SEARCH_BYTES, Scan};
use crate::schema::{self, Channel, evolvent};
use crate::sink::FileSink;
use crate::statistics::RunStatistics;
use crate::trace_info::ChannelInfo;
use crate::writer::{ChunkContent, CompressedChunk, Writer};

/// Longer names are no names of attachments.
const MAX_ATTACHMENT_HEAD: u64 = 64 * 1024;

/// Where what was run is lost, and with it the machine's axes, every number of an axis has room.
const ALL_AXES: [usize; 9] = [0, 1, 2, 3, 4, 5, 6, 7, 8];

/// What came of a recovery.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recovered {
    /// The torn file.
    pub source: PathBuf,
    /// The complete file made of it.
    pub path: PathBuf,
    /// Whether the torn file was not torn at all.
    pub was_complete: bool,
    /// The messages saved, by channel.
    pub channels: Vec<ChannelInfo>,
    /// What the cycles saved add up to: last number, gaps, late ones.
    pub statistics: RunStatistics,
    /// Chunks saved.
    pub chunks: u64,
    /// Attachments saved.
    pub attachments: u64,
    /// Places before the end where something was damaged and left out.
    pub damaged_places: u64,
    /// Whether what was run (the metadata `evolvent.run`) was saved.
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

/// Makes a complete, indexed trace of `source`, cut off anywhere or damaged, at `output`, or beside it: `NAME.mcap` for
/// `NAME.mcap.part`, else `NAME.recovered.mcap`. Every chunk and attachment that fits its checksum is kept. The
/// result appears under its name only when it is complete and on disk; `source` stays.
///
/// # Errors
/// [`RecoverError`]. `source` is untouched in any case, unless `output` names it.
pub fn recover(source: &Path, output: Option<&Path>) -> Result<Recovered, RecoverError> {
    let read = |error| RecoverError::Read {
        path: source.to_owned(),
        source: error,
    };
    let file = File::open(source).map_err(read)?;
    if let Err(TryLockError::WouldBlock) = file.try_lock_shared() {
        return Err(RecoverError::InUse {
            path: source.to_owned(),
        });
    }
    let output = output.map_or_else(|| default_output(source), Path::to_owned);
    let mut temporary = output.as_os_str().to_owned();
    temporary.push(".recovering");
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
        .and_then(|sink| Writer::new(Box::new(sink), schema::PROFILE, schema::LIBRARY))
        .map_err(write)
        .and_then(|writer| {
            let mut rescue = Rescue::new(writer);
            match rescue.run(&mut scan) {
                Err(Trouble::Read(error)) => return Err(read(error)),
                Err(Trouble::Write(error)) => return Err(write(error)),
                Ok(()) => {}
            }
            let recovered = rescue.finish(source, &output, length).map_err(write)?;
            fs::rename(&temporary, &output)
                .and_then(|()| sync_folder_of(&output))
                .map_err(write)?;
            Ok(recovered)
        });
    if result.is_err() {
        // It may not even exist.
        let _ = fs::remove_file(&temporary);
    }
    result
}

/// Recovers every `*.mcap.part` in a folder that no running recorder holds; to be called at start-up. A part file whose
/// rest was merely cut off is removed once it is recovered; one that is damaged before its end is kept as
/// `*.mcap.damaged`. A folder that does not exist holds nothing.
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

/// A name beside the torn file that is not taken.
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

/// How a record fared.
enum Fate {
    Kept,
    Damaged,
    End,
}

/// The recovery under way.
struct Rescue {
    writer: Writer,
    statistics: RunStatistics,
    topics: BTreeMap<u16, (String, String)>,
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
    declared: bool,
}

impl Rescue {
    fn new(writer: Writer) -> Self {
        Self {
            writer,
            statistics: RunStatistics::default(),
            topics: BTreeMap::new(),
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
            declared: false,
        }
    }

    /// Goes through the file, keeps what is whole, and searches on where something is not.
    fn run(&mut self, scan: &mut Scan) -> Result<(), Trouble> {
        let mut offset = MAGIC.len() as u64;
        while offset < scan.length {
            let head = scan.head(offset).map_err(Trouble::Read)?;
            let fate = match head {
                Some((opcode, length)) => self.record(scan, offset, opcode, length)?,
                None => Fate::Damaged,
            };
            let behind = head.map_or(offset, |(_, length)| offset + RECORD_HEAD as u64 + length);
            match fate {
                Fate::Kept => offset = behind,
                Fate::End => {
                    self.reached_end = true;
                    let whole = self.ends_well(scan, behind).map_err(Trouble::Read)?;
                    if !whole {
                        // Behind the data is only the index, which is made anew.
                        self.reached_end = false;
                    }
                    return Ok(());
                }
                Fate::Damaged => {
                    // If a record can follow, only this one is lost; else look for the next chunk.
                    let follows = behind > offset && scan.head(behind).map_err(Trouble::Read)?.is_some();
                    let next = if follows {
                        Some(behind)
                    } else {
                        scan.next_chunk(offset + 1).map_err(Trouble::Read)?
                    };
                    let next_or_end = next.unwrap_or(scan.length);
                    self.bytes_dropped += next_or_end - offset;
                    // A tail is merely torn; what lies between whole records is damaged.
                    self.damaged_places += u64::from(next.is_some());
                    offset = next_or_end;
                }
            }
        }
        Ok(())
    }

    /// Whether summary and footer behind the data are whole.
    fn ends_well(&self, scan: &mut Scan, summary: u64) -> io::Result<bool> {
        let tail = (FOOTER_LENGTH + MAGIC.len()) as u64;
        if scan.length < summary + tail || scan.length - summary > MAX_CHUNK_BYTES {
            return Ok(false);
        }
        let bytes = scan.read(summary, (scan.length - summary) as usize)?;
        let (guarded, rest) = bytes.split_at(bytes.len() - MAGIC.len() - 4);
        Ok(rest[4..] == MAGIC && Fields(rest).u32() == Some(crc32fast::hash(guarded)))
    }

    fn record(&mut self, scan: &mut Scan, offset: u64, opcode: u8, length: u64) -> Result<Fate, Trouble> {
        let content_at = offset + RECORD_HEAD as u64;
        let load = |scan: &mut Scan| {
            let length = usize::try_from(length).map_err(|_| io::ErrorKind::OutOfMemory)?;
            scan.read(content_at, length)
        };
        match opcode {
            op::DATA_END => Ok(if length == 4 { Fate::End } else { Fate::Damaged }),
            op::ATTACHMENT => self.attachment(scan, content_at, length),
            op::CHUNK if length <= MAX_CHUNK_BYTES => {
                let content = load(scan).map_err(Trouble::Read)?;
                self.chunk(&content)
            }
            op::METADATA if length <= MAX_CHUNK_BYTES => {
                let content = load(scan).map_err(Trouble::Read)?;
                self.metadata(&content)
            }
            // The index of the chunk before is made anew; the header says nothing that matters.
            op::MESSAGE_INDEX | op::HEADER => Ok(Fate::Kept),
            // The recorder puts no other records outside chunks.
            _ => Ok(Fate::Damaged),
        }
    }

    fn metadata(&mut self, content: &[u8]) -> Result<Fate, Trouble> {
        let mut fields = Fields(content);
        let Some((name, map)) = fields
            .string()
            .and_then(|name| Some((name, fields.string_map()?)))
        else {
            return Ok(Fate::Damaged);
        };
        let Some(map) = without_checksum(map) else {
            return Ok(Fate::Damaged);
        };
        if name == schema::SUMMARY {
            // Its counts are made anew; the rest is kept.
            self.old_summary = map;
            return Ok(Fate::Kept);
        }
        if name == schema::RUN
            && let Some(run) = RunInfo::from_metadata(&map)
        {
            self.letters = run.axes.iter().map(|axis| axis.letter()).collect();
            self.axes = Some(run.axes.iter().map(|axis| axis.index()).collect());
            self.has_run = true;
        }
        self.writer
            .metadata(name, &with_checksum(map))
            .map_err(Trouble::Write)?;
        Ok(Fate::Kept)
    }

    fn attachment(&mut self, scan: &mut Scan, content_at: u64, length: u64) -> Result<Fate, Trouble> {
        let head_length = length.min(MAX_ATTACHMENT_HEAD);
        let head = scan
            .read(content_at, head_length as usize)
            .map_err(Trouble::Read)?;
        let mut fields = Fields(&head);
        let parsed = (|| {
            let time_ns = fields.u64()?;
            fields.u64()?;
            Some((
                time_ns,
                fields.string()?.to_owned(),
                fields.string()?.to_owned(),
                fields.u64()?,
            ))
        })();
        let Some((time_ns, name, media_type, size)) = parsed else {
            return Ok(Fate::Damaged);
        };
        let data_at = head_length - fields.0.len() as u64;
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
        self.writer
            .attach(&name, &media_type, time_ns, size, &mut scan.file)
            .map_err(Trouble::Write)?;
        self.attachments += 1;
        Ok(Fate::Kept)
    }

    fn chunk(&mut self, content: &[u8]) -> Result<Fate, Trouble> {
        let Some(head) = ChunkHead::parse(content) else {
            return Ok(Fate::Damaged);
        };
        let mut bytes = Vec::new();
        if chunk::unpack(&head, &mut bytes).is_none() {
            return Ok(Fate::Damaged);
        }
        let mut index = ChunkContent::default();
        let mut at = 0;
        let mut declares = false;
        while at < bytes.len() {
            let Some((record, next)) = chunk::record_at(&bytes, at) else {
                return Ok(Fate::Damaged);
            };
            if let Some(Inner::Message(message)) = record {
                index.note(message.channel, message.log_time_ns, at);
            }
            declares |= matches!(record, Some(Inner::Declaration(..)));
            at = next;
        }
        if !declares && !self.declared {
            // The chunk with the schemas is lost. Numbers of channels never change, so ours fit.
            schema::declare_channels(&mut self.writer, &self.letters, 1, true);
            let time_ns = index.start_time_ns().unwrap_or(0);
            let text = "the descriptions of the channels were lost and are written anew by the recovery";
            let line = log_line(time_ns, LogLevel::Warning, text).encode_to_vec();
            self.writer
                .message(Channel::Log.id(), 0, time_ns, |out| out.extend_from_slice(&line));
            *self.counts.entry(Channel::Log.id()).or_default() += 1;
            self.writer.close_chunk().map_err(Trouble::Write)?;
            for channel in Channel::ALL {
                let names = (channel.topic().to_owned(), channel.message_name().to_owned());
                self.topics.insert(channel.id(), names);
            }
        }
        self.declared = true;
        self.count(&bytes);
        let chunk = CompressedChunk {
            compression: head.compression,
            uncompressed_size: head.uncompressed_size,
            uncompressed_crc: head.uncompressed_crc,
            data: head.data,
        };
        self.writer.write_chunk(&chunk, &index).map_err(Trouble::Write)?;
        self.chunks += 1;
        Ok(Fate::Kept)
    }

    /// Takes in what a whole chunk declares and adds up.
    fn count(&mut self, bytes: &[u8]) {
        let mut schemas = BTreeMap::new();
        let has_batches = Self::has_batches(bytes);
        let mut at = 0;
        while let Some((record, next)) = chunk::record_at(bytes, at) {
            at = next;
            match record {
                Some(Inner::Declaration(opcode, id, content)) => {
                    self.writer.adopt(opcode, id, content);
                    let mut fields = Fields(content);
                    if opcode == op::SCHEMA {
                        let name = fields.u16().and_then(|_| fields.string());
                        schemas.insert(id, name.unwrap_or_default().to_owned());
                    } else if let Some((schema, topic)) =
                        fields.u16().and_then(|_| Some((fields.u16()?, fields.string()?)))
                    {
                        let message = schemas.get(&schema).cloned().unwrap_or_default();
                        self.topics.insert(id, (topic.to_owned(), message));
                    }
                }
                Some(Inner::Message(message)) => {
                    *self.counts.entry(message.channel).or_default() += 1;
                    let topic = self.topics.get(&message.channel).map_or("", |(topic, _)| topic);
                    if topic == Channel::Cycles.topic() {
                        let axes = self.axes.as_deref().unwrap_or(&ALL_AXES);
                        let batch = evolvent::Cycles::decode(message.data).ok();
                        let cycles = batch.and_then(|batch| batch::cycles(&batch, axes));
                        for cycle in cycles.unwrap_or_default() {
                            self.statistics.cycle(&cycle);
                        }
                    } else if topic == Channel::Cycle.topic() {
                        if has_batches {
                            continue;
                        }
                        if let Some(cycle) = self.cycle(message.data) {
                            self.statistics.cycle(&cycle);
                        }
                    } else if topic == Channel::Event.topic()
                        && let Ok(event) = evolvent::Event::decode(message.data)
                    {
                        let alarm = EventKind::Alarm;
                        self.statistics
                            .event((event.kind == alarm as i32).then_some(alarm));
                    }
                }
                None => {}
            }
        }
    }

    /// Whether a chunk holds its cycles in batches, and those in `/cycle` besides.
    fn has_batches(bytes: &[u8]) -> bool {
        let mut at = 0;
        while let Some((record, next)) = chunk::record_at(bytes, at) {
            at = next;
            if let Some(Inner::Message(message)) = record
                && message.channel == Channel::Cycles.id()
            {
                return true;
            }
        }
        false
    }

    /// What the statistics need of a cycle; without the axes if what was run is lost.
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
            Some(axes) => chunk::cycle(&message, axes),
            None => Some(record),
        }
    }

    fn finish(mut self, source: &Path, output: &Path, length: u64) -> io::Result<Recovered> {
        let was_complete = self.reached_end && self.damaged_places == 0 && self.bytes_dropped == 0;
        let mut summary = self.statistics.to_metadata();
        for (key, value) in std::mem::take(&mut self.old_summary) {
            summary.entry(key).or_insert(value);
        }
        self.writer.metadata(schema::SUMMARY, &with_checksum(summary))?;
        let note = BTreeMap::from([
            ("source_bytes".to_owned(), length.to_string()),
            ("was_complete".to_owned(), was_complete.to_string()),
            ("damaged_places".to_owned(), self.damaged_places.to_string()),
            ("bytes_dropped".to_owned(), self.bytes_dropped.to_string()),
        ]);
        self.writer.metadata(schema::RECOVERY, &with_checksum(note))?;
        self.writer.finish()?;
        let channels = self
            .topics
            .into_iter()
            .map(|(id, (topic, message))| ChannelInfo {
                topic,
                message,
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

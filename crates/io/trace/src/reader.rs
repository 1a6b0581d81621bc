//! Reads finished traces.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::{self, Cursor, Read as _, Seek as _, SeekFrom};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use binrw::BinReaderExt as _;
use evolvent_config::open_regular;
use mcap::MAGIC;
use mcap::records::{AttachmentHeader, AttachmentIndex, ChunkIndex, Record, op};

use crate::checked_map::without_checksum;
use crate::chunk::{RECORD_HEAD, parse, split_record, whole_record};
use crate::decode::Decoder;
use crate::messages::Messages;
use crate::read_error::ReadError;
use crate::record::{BlockRecord, CycleRecord, EventRecord};
use crate::run_info::RunInfo;
use crate::schema::{self, Channel};
use crate::trace_info::{ChannelInfo, TraceInfo};

/// Opcode, length and content of a footer.
pub(crate) const FOOTER_LENGTH: usize = RECORD_HEAD + 8 + 8 + 4;
/// The largest summary that is read; a trace of a week at 1 kHz has 0.5 GB.
const MAX_SUMMARY_BYTES: u64 = 1 << 30;

/// A message, by its channel.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "nearly all messages of a trace are cycles"
)]
pub enum TraceMessage {
    /// From `/cycle`.
    Cycle(CycleRecord),
    /// From `/event`.
    Event(EventRecord),
    /// From `/block`.
    Block(BlockRecord),
    /// From any other channel, unchanged.
    Other {
        /// The channel's topic.
        topic: String,
        /// Its time, Unix time in ns.
        log_time_ns: u64,
        /// The low 32 bits of its cycle.
        sequence: u32,
        /// The protobuf message.
        data: Vec<u8>,
    },
}

/// A finished trace. Opening reads the summary at its end only, so it takes the same time for any size.
///
/// ```
/// # use evolvent_trace::{CycleRecord, Recorder, RunInfo, TraceFile, TraceMessage};
/// # use evolvent_path::AxisLetter;
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("run.mcap");
/// # let run = RunInfo { axes: vec![AxisLetter::X], period_ns: 1_000_000, ..RunInfo::default() };
/// # let mut recorder = Recorder::create(&path, &run)?;
/// # for sequence in 0..3 {
/// #     recorder.cycle(&CycleRecord { sequence, due_time_ns: sequence * 1_000_000, ..CycleRecord::default() })?;
/// # }
/// # recorder.finish(&Default::default())?;
/// let mut trace = TraceFile::open(&path)?;
/// assert_eq!(trace.info().summary_number("cycles"), Some(3.0));
/// for message in trace.messages() {
///     if let TraceMessage::Cycle(cycle) = message? {
///         println!("{} at x = {} mm", cycle.sequence, cycle.position[0]);
///     }
/// }
/// # Ok::<_, Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct TraceFile {
    pub(crate) source: Source,
    info: TraceInfo,
    decoder: Decoder,
    pub(crate) chunks: Vec<ChunkIndex>,
    pub(crate) attachments: Vec<AttachmentIndex>,
    /// Position of the summary.
    pub(crate) summary_start: u64,
}

/// A file and its name for errors.
#[derive(Debug)]
pub(crate) struct Source {
    file: File,
    path: PathBuf,
    pub(crate) length: u64,
}

/// Opens a file without waiting: a normal open of a pipe would wait for a writer.
pub(crate) fn open_file(path: &Path) -> io::Result<File> {
    if std::fs::metadata(path)?.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    open_regular(path)
}

impl Source {
    fn open(path: &Path) -> Result<Self, ReadError> {
        let opened = open_file(path).and_then(|file| {
            let length = file.metadata()?.len();
            Ok((file, length))
        });
        let path = path.to_owned();
        match opened {
            Ok((file, length)) => Ok(Self { file, path, length }),
            Err(source) => Err(ReadError::Io { path, source }),
        }
    }

    pub(crate) fn damaged(&self, offset: u64, what: &'static str) -> ReadError {
        ReadError::Damaged {
            path: self.path.clone(),
            offset,
            what,
        }
    }

    /// The error of a trace without a description of the run.
    pub(crate) fn no_run(&self) -> ReadError {
        ReadError::NoRun {
            path: self.path.clone(),
        }
    }

    /// Reads `length` bytes; `what` names them in the error of a file that is too short.
    pub(crate) fn read(
        &mut self,
        offset: u64,
        length: u64,
        what: &'static str,
    ) -> Result<Vec<u8>, ReadError> {
        if offset.checked_add(length).is_none_or(|end| end > self.length) {
            return Err(self.damaged(offset, what));
        }
        read_at(&mut self.file, offset, length).map_err(|source| ReadError::Io {
            path: self.path.clone(),
            source,
        })
    }
}

/// Reads `length` bytes from `offset` on.
pub(crate) fn read_at(file: &mut File, offset: u64, length: u64) -> io::Result<Vec<u8>> {
    let length = usize::try_from(length).map_err(|_| io::Error::from(io::ErrorKind::OutOfMemory))?;
    let mut bytes = vec![0; length];
    file.seek(SeekFrom::Start(offset))?;
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

impl TraceFile {
    /// Opens a finished trace.
    ///
    /// # Errors
    /// [`ReadError`]; for a file without end, [`ReadError::Unfinished`]: recover it.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let mut source = Source::open(path)?;
        let (start, bytes) = summary(&mut source)?;
        let mut parts = Parts::default();
        let mut rest = bytes.as_slice();
        while !rest.is_empty() {
            let damaged = || source.damaged(start, "its summary");
            let (opcode, content, next) = split_record(rest).ok_or_else(damaged)?;
            parts.add(parse(opcode, content).ok_or_else(damaged)?);
            rest = next;
        }
        parts.assemble(source, start)
    }

    /// The contents of the trace.
    #[must_use]
    pub fn info(&self) -> &TraceInfo {
        &self.info
    }

    /// The content of an attachment, checked; `None` if there is none of this name.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read or is damaged.
    pub fn attachment(&mut self, name: &str) -> Result<Option<Vec<u8>>, ReadError> {
        let Some(index) = self.attachments.iter().find(|index| index.name == name) else {
            return Ok(None);
        };
        let what = "an attachment";
        let bytes = self.source.read(index.offset, index.length, what)?;
        match attachment_data(&bytes) {
            Some(data) => Ok(Some(data.to_vec())),
            None => Err(self.source.damaged(index.offset, what)),
        }
    }

    /// All messages in the order of writing. Cycles come in batches, so an event may precede its cycle. Each
    /// cycle is returned once, complete, although viewers find it in two channels.
    pub fn messages(&mut self) -> Messages<'_> {
        self.messages_of(None)
    }

    fn messages_of(&mut self, only: Option<Channel>) -> Messages<'_> {
        let period_ns = self.info.run.as_ref().map_or(0, |run| run.period_ns);
        Messages::new(&mut self.source, &self.chunks, &self.decoder, only, period_ns)
    }

    fn cycle_messages(&mut self, first_ns: u64, last_ns: u64) -> Messages<'_> {
        let channel = if self.decoder.batches {
            Channel::Cycles
        } else {
            Channel::Cycle
        };
        self.messages_of(Some(channel)).between(first_ns, last_ns)
    }

    /// The cycles in order.
    pub fn cycles(&mut self) -> impl Iterator<Item = Result<CycleRecord, ReadError>> {
        self.cycles_between(0, u64::MAX)
    }

    /// The cycles that were due from the first time to the last, both included, Unix time in ns. Chunks
    /// without such cycles are not read.
    pub fn cycles_between(
        &mut self,
        first_ns: u64,
        last_ns: u64,
    ) -> impl Iterator<Item = Result<CycleRecord, ReadError>> {
        self.cycle_messages(first_ns, last_ns)
            .filter_map(move |message| match message {
                Ok(TraceMessage::Cycle(record)) => {
                    let is_within = (first_ns..=last_ns).contains(&record.due_time_ns);
                    is_within.then_some(Ok(record))
                }
                Ok(_) => None,
                Err(error) => Some(Err(error)),
            })
    }

    /// Passes every cycle that was due from the first time to the last, both included, to `see`, in order and
    /// without a copy: faster than [`Self::cycles_between`]. Ends early if `see` requests it.
    ///
    /// # Errors
    /// [`ReadError`], after the intact part has been passed; and the errors of `see`.
    pub fn each_cycle<E: From<ReadError>>(
        &mut self,
        first_ns: u64,
        last_ns: u64,
        mut see: impl FnMut(&CycleRecord) -> Result<ControlFlow<()>, E>,
    ) -> Result<(), E> {
        let mut messages = self.cycle_messages(first_ns, last_ns);
        let mut cycles = Vec::new();
        while messages.next_cycles(&mut cycles)? {
            for record in &cycles {
                if (first_ns..=last_ns).contains(&record.due_time_ns) && see(record)?.is_break() {
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    /// The events in order.
    pub fn events(&mut self) -> impl Iterator<Item = Result<EventRecord, ReadError>> {
        self.messages_of(Some(Channel::Event))
            .filter_map(|message| match message {
                Ok(TraceMessage::Event(record)) => Some(Ok(record)),
                Ok(_) => None,
                Err(error) => Some(Err(error)),
            })
    }

    /// The blocks in order.
    pub fn blocks(&mut self) -> impl Iterator<Item = Result<BlockRecord, ReadError>> {
        self.messages_of(Some(Channel::Block))
            .filter_map(|message| match message {
                Ok(TraceMessage::Block(record)) => Some(Ok(record)),
                Ok(_) => None,
                Err(error) => Some(Err(error)),
            })
    }
}

/// The records of the summary section, verified by its checksum, and their position.
fn summary(source: &mut Source) -> Result<(u64, Vec<u8>), ReadError> {
    let magic = MAGIC.len() as u64;
    if source.length < magic || source.read(0, magic, "its first bytes")? != MAGIC {
        return Err(ReadError::NotATrace {
            path: source.path.clone(),
            bytes: source.length,
        });
    }
    let unfinished = ReadError::Unfinished {
        path: source.path.clone(),
        is_being_written: matches!(source.file.try_lock_shared(), Err(TryLockError::WouldBlock)),
    };
    let tail = FOOTER_LENGTH as u64 + magic;
    if source.length < magic + tail {
        return Err(unfinished);
    }
    let footer_at = source.length - tail;
    let footer = source.read(footer_at, tail, "its footer")?;
    let (footer, end) = footer.split_at(FOOTER_LENGTH);
    if end != MAGIC || footer[0] != op::FOOTER {
        return Err(unfinished);
    }
    let Ok(Record::Footer(fields)) = mcap::parse_record(op::FOOTER, &footer[RECORD_HEAD..]) else {
        return Err(source.damaged(footer_at, "its footer"));
    };
    let start = fields.summary_start;
    if start == 0 || start > footer_at || footer_at - start > MAX_SUMMARY_BYTES {
        return Err(source.damaged(footer_at, "the position of its summary"));
    }
    let bytes = source.read(start, footer_at - start, "its summary")?;
    let mut check = crc32fast::Hasher::new();
    check.update(&bytes);
    check.update(&footer[..FOOTER_LENGTH - 4]);
    if check.finalize() != fields.summary_crc {
        return Err(source.damaged(start, "its summary does not match its checksum"));
    }
    Ok((start, bytes))
}

/// The contents of the summary section.
#[derive(Debug, Default)]
struct Parts {
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, mcap::records::Channel>,
    statistics: mcap::records::Statistics,
    chunks: Vec<ChunkIndex>,
    attachments: Vec<AttachmentIndex>,
    metadata: Vec<mcap::records::MetadataIndex>,
}

impl Parts {
    fn add(&mut self, record: Record<'_>) {
        match record {
            Record::Schema { header, .. } => drop(self.schemas.insert(header.id, header.name)),
            Record::Channel(channel) => drop(self.channels.insert(channel.id, channel)),
            Record::Statistics(statistics) => self.statistics = statistics,
            Record::ChunkIndex(index) => self.chunks.push(index),
            Record::AttachmentIndex(index) => self.attachments.push(index),
            Record::MetadataIndex(index) => self.metadata.push(index),
            _ => {}
        }
    }

    /// The metadata that this crate writes, by name.
    fn maps(&self, source: &mut Source) -> Result<BTreeMap<String, BTreeMap<String, String>>, ReadError> {
        let mut maps = BTreeMap::new();
        for index in &self.metadata {
            if ![schema::RUN, schema::SUMMARY, schema::RECOVERY].contains(&index.name.as_str()) {
                continue;
            }
            let what = "a metadata record";
            let bytes = source.read(index.offset, index.length, what)?;
            let map = match whole_record(&bytes).and_then(|(opcode, content)| parse(opcode, content)) {
                Some(Record::Metadata(record)) if record.name == index.name => {
                    without_checksum(record.metadata)
                }
                _ => None,
            };
            let map = map.ok_or_else(|| source.damaged(index.offset, what))?;
            maps.insert(index.name.clone(), map);
        }
        Ok(maps)
    }

    fn assemble(self, mut source: Source, summary_start: u64) -> Result<TraceFile, ReadError> {
        let mut maps = self.maps(&mut source)?;
        let run = match maps.remove(schema::RUN) {
            None => None,
            Some(map) => Some(
                RunInfo::from_metadata(&map)
                    .ok_or_else(|| source.damaged(0, "the content of its metadata"))?,
            ),
        };
        let count = |id: u16| {
            self.statistics
                .channel_message_counts
                .get(&id)
                .copied()
                .unwrap_or(0)
        };
        let channels: Vec<_> = self
            .channels
            .values()
            .map(|channel| ChannelInfo {
                topic: channel.topic.clone(),
                message: self.schemas.get(&channel.schema_id).cloned().unwrap_or_default(),
                messages: count(channel.id),
            })
            .collect();
        let info = TraceInfo {
            path: source.path.clone(),
            bytes: source.length,
            start_time_ns: self.statistics.message_start_time,
            end_time_ns: self.statistics.message_end_time,
            channels,
            chunks: self.chunks.len() as u64,
            uncompressed_bytes: self
                .chunks
                .iter()
                .fold(0, |sum, chunk| sum.saturating_add(chunk.uncompressed_size)),
            attachments: self
                .attachments
                .iter()
                .map(|index| (index.name.clone(), index.data_size))
                .collect(),
            summary: maps.remove(schema::SUMMARY).unwrap_or_default(),
            recovery: maps.remove(schema::RECOVERY).unwrap_or_default(),
            run,
        };
        let decoder = Decoder {
            axes: info
                .run
                .as_ref()
                .map(|run| run.axes.iter().map(|axis| axis.index()).collect()),
            topics: self
                .channels
                .into_iter()
                .map(|(id, channel)| (id, channel.topic))
                .collect(),
            batches: info.messages(Channel::Cycles.topic()) > 0,
        };
        Ok(TraceFile {
            source,
            info,
            decoder,
            chunks: self.chunks,
            attachments: self.attachments,
            summary_start,
        })
    }
}

/// The data of an attachment record, if it matches its checksum.
pub(crate) fn attachment_data(record: &[u8]) -> Option<&[u8]> {
    let (op::ATTACHMENT, content) = whole_record(record)? else {
        return None;
    };
    let (guarded, crc) = content.split_last_chunk::<4>()?;
    if u32::from_le_bytes(*crc) != crc32fast::hash(guarded) {
        return None;
    }
    let (_, size, data) = attachment_head(guarded)?;
    (size == data.len() as u64).then_some(data)
}

/// Header, size of the data, and remaining bytes of an attachment record's content.
pub(crate) fn attachment_head(content: &[u8]) -> Option<(AttachmentHeader, u64, &[u8])> {
    let mut fields = Cursor::new(content);
    let header = fields.read_le().ok()?;
    let size = fields.read_le().ok()?;
    Some((
        header,
        size,
        content.get(usize::try_from(fields.position()).ok()?..)?,
    ))
}

//! Reads finished traces.

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use prost::Message as _;

use crate::batch::{self, MAX_CYCLES};
use crate::checked_map::without_checksum;
use crate::chunk::{self, Inner, MAX_CHUNK_BYTES, RawMessage};
use crate::format::{AttachmentIndex, ChunkHead, ChunkIndex, FOOTER_LENGTH, Fields, MAGIC, RECORD_HEAD, op};
use crate::read_error::ReadError;
use crate::record::{BlockRecord, CycleRecord, EventRecord};
use crate::run_info::RunInfo;
use crate::schema::{self, Channel, evolvent};
use crate::trace_info::{ChannelInfo, Summary, TraceInfo};

/// The largest summary that is read; a trace of a week at 1 kHz has 0.5 GB.
const MAX_SUMMARY_BYTES: u64 = 1 << 30;

/// A message, as its channel has it.
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
    /// From any other channel, as it was written.
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
#[derive(Debug)]
pub struct TraceFile {
    file: File,
    info: TraceInfo,
    topics: BTreeMap<u16, String>,
    chunks: Vec<ChunkIndex>,
    attachments: Vec<AttachmentIndex>,
}

struct Source {
    file: File,
    path: PathBuf,
    length: u64,
}

impl Source {
    fn io(&self, source: io::Error) -> ReadError {
        ReadError::Io {
            path: self.path.clone(),
            source,
        }
    }

    fn damaged(&self, offset: u64, what: &'static str) -> ReadError {
        ReadError::Damaged {
            path: self.path.clone(),
            offset,
            what,
        }
    }

    fn read(&mut self, offset: u64, length: u64, what: &'static str) -> Result<Vec<u8>, ReadError> {
        if offset.checked_add(length).is_none_or(|end| end > self.length) {
            return Err(self.damaged(offset, what));
        }
        read_at(&mut self.file, offset, length).map_err(|error| self.io(error))
    }
}

fn read_at(file: &mut File, offset: u64, length: u64) -> io::Result<Vec<u8>> {
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
        let io = |source| ReadError::Io {
            path: path.to_owned(),
            source,
        };
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut source = Source {
            file,
            path: path.to_owned(),
            length,
        };
        let magic = MAGIC.len() as u64;
        if length < magic || source.read(0, magic, "its first bytes")? != MAGIC {
            return Err(ReadError::NotATrace {
                path: path.to_owned(),
                bytes: length,
            });
        }
        let tail = FOOTER_LENGTH as u64 + magic;
        if length < magic + tail {
            return Err(ReadError::Unfinished {
                path: path.to_owned(),
            });
        }
        let footer_at = length - tail;
        let footer = source.read(footer_at, tail, "its footer")?;
        if footer[FOOTER_LENGTH..] != MAGIC || footer[0] != op::FOOTER {
            return Err(ReadError::Unfinished {
                path: path.to_owned(),
            });
        }
        let mut fields = Fields(&footer[RECORD_HEAD..]);
        let (Some(start), Some(_), Some(crc)) = (fields.u64(), fields.u64(), fields.u32()) else {
            return Err(source.damaged(footer_at, "its footer"));
        };
        if start == 0 || start > footer_at || footer_at - start > MAX_SUMMARY_BYTES {
            return Err(source.damaged(footer_at, "the place of its summary"));
        }
        let mut summary = source.read(start, footer_at - start, "its summary")?;
        let mut check = crc32fast::Hasher::new();
        check.update(&summary);
        check.update(&footer[..FOOTER_LENGTH - 4]);
        if check.finalize() != crc {
            return Err(source.damaged(start, "its summary does not match its checksum"));
        }
        let parsed = Summary::parse(&summary).ok_or_else(|| source.damaged(start, "its summary"))?;
        summary.clear();
        Self::assemble(source, parsed)
    }

    fn assemble(mut source: Source, summary: Summary) -> Result<Self, ReadError> {
        let mut maps = BTreeMap::new();
        for index in &summary.metadata {
            if ![schema::RUN, schema::SUMMARY, schema::RECOVERY].contains(&index.name.as_str()) {
                continue;
            }
            let bytes = source.read(index.offset, index.length, "a metadata record")?;
            let map = match Fields(&bytes).record() {
                Some((op::METADATA, content)) => {
                    let mut fields = Fields(content);
                    fields
                        .string()
                        .and_then(|_| fields.string_map())
                        .and_then(without_checksum)
                }
                _ => None,
            };
            let map = map.ok_or_else(|| source.damaged(index.offset, "a metadata record"))?;
            maps.insert(index.name.clone(), map);
        }
        let run = match maps.remove(schema::RUN) {
            None => None,
            Some(map) => {
                Some(RunInfo::from_metadata(&map).ok_or_else(|| source.damaged(0, "what its metadata say"))?)
            }
        };
        let channels = summary
            .channels
            .iter()
            .map(|(id, (schema, topic))| ChannelInfo {
                topic: topic.clone(),
                message: summary.schemas.get(schema).cloned().unwrap_or_default(),
                messages: summary.counts.get(id).copied().unwrap_or(0),
            })
            .collect();
        let info = TraceInfo {
            path: source.path,
            bytes: source.length,
            run,
            start_time_ns: summary.start_time_ns,
            end_time_ns: summary.end_time_ns,
            channels,
            chunks: summary.chunks.len() as u64,
            uncompressed_bytes: summary
                .chunks
                .iter()
                .fold(0, |sum, chunk| sum.saturating_add(chunk.uncompressed_size)),
            attachments: summary
                .attachments
                .iter()
                .map(|index| (index.name.clone(), index.data_size))
                .collect(),
            summary: maps.remove(schema::SUMMARY).unwrap_or_default(),
            recovery: maps.remove(schema::RECOVERY).unwrap_or_default(),
        };
        Ok(Self {
            file: source.file,
            info,
            topics: summary
                .channels
                .into_iter()
                .map(|(id, (_, topic))| (id, topic))
                .collect(),
            chunks: summary.chunks,
            attachments: summary.attachments,
        })
    }

    /// What the trace holds.
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
        let (offset, length) = (index.offset, index.length);
        let damaged = || ReadError::Damaged {
            path: self.info.path.clone(),
            offset,
            what: "an attachment",
        };
        if offset.checked_add(length).is_none_or(|end| end > self.info.bytes) {
            return Err(damaged());
        }
        let bytes = read_at(&mut self.file, offset, length).map_err(|source| ReadError::Io {
            path: self.info.path.clone(),
            source,
        })?;
        attachment_data(&bytes)
            .map(|data| Some(data.to_vec()))
            .ok_or_else(damaged)
    }

    /// All messages in the order in which they were written; cycles come in batches, so an event may come before its
    /// cycle. Each cycle comes once, whole, though viewers find it in two channels.
    pub fn messages(&mut self) -> Messages<'_> {
        self.messages_of(None)
    }

    /// The channel that holds every cycle.
    fn cycle_channel(&self) -> Channel {
        if self.info.messages(Channel::Cycles.topic()) > 0 {
            Channel::Cycles
        } else {
            Channel::Cycle
        }
    }

    fn messages_of(&mut self, only: Option<Channel>) -> Messages<'_> {
        let axes = self
            .info
            .run
            .as_ref()
            .map(|run| run.axes.iter().map(|axis| axis.index()).collect::<Vec<_>>());
        let only = only.map(|channel| {
            let topic = channel.topic();
            self.topics
                .iter()
                .find(|(_, name)| *name == topic)
                .map_or(u16::MAX, |(&id, _)| id)
        });
        let batches = self.cycle_channel() == Channel::Cycles;
        Messages {
            trace: self,
            axes,
            only,
            next_chunk: 0,
            offset: 0,
            at: 0,
            chunk: Vec::new(),
            ready: VecDeque::new(),
            batches,
            span_ns: (0, u64::MAX),
            failed: false,
        }
    }

    /// The cycles in order.
    pub fn cycles(&mut self) -> impl Iterator<Item = Result<CycleRecord, ReadError>> {
        self.cycles_between(0, u64::MAX)
    }

    /// The cycles that were due from the first time to the last, both included, Unix time in ns. Chunks that hold none
    /// are not read.
    pub fn cycles_between(
        &mut self,
        first_ns: u64,
        last_ns: u64,
    ) -> impl Iterator<Item = Result<CycleRecord, ReadError>> {
        let mut messages = self.messages_of(Some(self.cycle_channel()));
        messages.span_ns = (first_ns, last_ns);
        messages.filter_map(move |message| match message {
            Ok(TraceMessage::Cycle(record)) => {
                let is_within = (first_ns..=last_ns).contains(&record.due_time_ns);
                is_within.then_some(Ok(record))
            }
            Ok(_) => None,
            Err(error) => Some(Err(error)),
        })
    }

    /// Shows every cycle that was due from the first time to the last, both included, to `see`, in order, where it lies: faster
    /// than [`Self::cycles_between`], which copies each several times. Ends early where `see` says so.
    ///
    /// # Errors
    /// [`ReadError`]; what is whole has been seen by then. And what `see` fails with.
    pub fn each_cycle<E: From<ReadError>>(
        &mut self,
        first_ns: u64,
        last_ns: u64,
        mut see: impl FnMut(&CycleRecord) -> Result<ControlFlow<()>, E>,
    ) -> Result<(), E> {
        let mut messages = self.messages_of(Some(self.cycle_channel()));
        messages.span_ns = (first_ns, last_ns);
        let mut lot = Vec::new();
        while messages.take_lot(&mut lot)? {
            for record in &lot {
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

/// The data of an attachment record, if it fits its checksum.
pub(crate) fn attachment_data(record: &[u8]) -> Option<&[u8]> {
    let (op::ATTACHMENT, content) = Fields(record).record()? else {
        return None;
    };
    let (guarded, crc) = content.split_at_checked(content.len().checked_sub(4)?)?;
    if Fields(crc).u32()? != crc32fast::hash(guarded) {
        return None;
    }
    let mut fields = Fields(guarded);
    fields.u64()?;
    fields.u64()?;
    fields.string()?;
    fields.string()?;
    let length = usize::try_from(fields.u64()?).ok()?;
    (fields.0.len() == length).then_some(fields.0)
}

/// Goes through the messages of a trace, chunk by chunk. Ends after an error.
#[derive(Debug)]
pub struct Messages<'a> {
    trace: &'a mut TraceFile,
    axes: Option<Vec<usize>>,
    only: Option<u16>,
    next_chunk: usize,
    /// Of the chunk at hand in the file, for errors.
    offset: u64,
    /// Of the next record in the chunk.
    at: usize,
    chunk: Vec<u8>,
    /// Cycles unpacked of a batch.
    ready: VecDeque<CycleRecord>,
    /// Whether the cycles are in batches, and `/cycle` is for viewers only.
    batches: bool,
    /// Chunks outside it need not be read.
    span_ns: (u64, u64),
    failed: bool,
}

/// What a message holds.
#[expect(
    clippy::large_enum_variant,
    reason = "it lives for the moment of being looked at"
)]
enum Decoded {
    One(TraceMessage),
    Batch(VecDeque<CycleRecord>),
}

impl Messages<'_> {
    fn damaged(&self, what: &'static str) -> ReadError {
        ReadError::Damaged {
            path: self.trace.info.path.clone(),
            offset: self.offset,
            what,
        }
    }

    /// How far the cycles of a batch reach beyond the time of its message.
    fn longest_ns(&self) -> u64 {
        let period_ns = self.trace.info.run.as_ref().map_or(0, |run| run.period_ns);
        period_ns.saturating_mul(MAX_CYCLES as u64)
    }

    /// Unpacks the next chunk that matters; `false` at the end.
    fn load(&mut self) -> Result<bool, ReadError> {
        loop {
            let Some(index) = self.trace.chunks.get(self.next_chunk) else {
                return Ok(false);
            };
            self.next_chunk += 1;
            if self
                .only
                .is_some_and(|channel| !index.message_index_offsets.contains_key(&channel))
            {
                continue;
            }
            if index.start_time > self.span_ns.1
                || index.end_time.saturating_add(self.longest_ns()) < self.span_ns.0
            {
                continue;
            }
            let (offset, length) = (index.offset, index.length);
            self.offset = offset;
            if offset
                .checked_add(length)
                .is_none_or(|end| end > self.trace.info.bytes)
                || length > MAX_CHUNK_BYTES
            {
                return Err(self.damaged("a chunk's place"));
            }
            let bytes = read_at(&mut self.trace.file, offset, length).map_err(|source| ReadError::Io {
                path: self.trace.info.path.clone(),
                source,
            })?;
            let head = match Fields(&bytes).record() {
                Some((op::CHUNK, content)) => ChunkHead::parse(content),
                _ => None,
            };
            let mut chunk = std::mem::take(&mut self.chunk);
            let unpacked = head.and_then(|head| chunk::unpack(&head, &mut chunk));
            self.chunk = chunk;
            self.at = 0;
            return unpacked
                .map(|()| true)
                .ok_or_else(|| self.damaged("a chunk does not match its checksum"));
        }
    }

    fn axes(&self) -> Result<&[usize], ReadError> {
        self.axes.as_deref().ok_or_else(|| ReadError::NoRun {
            path: self.trace.info.path.clone(),
        })
    }

    fn decode(&self, message: RawMessage<'_>) -> Result<Decoded, ReadError> {
        let topic = self.trace.topics.get(&message.channel).map_or("", String::as_str);
        let bad = || self.damaged("a message");
        let decoded = if topic == Channel::Cycles.topic() {
            let axes = self.axes()?;
            let message = evolvent::Cycles::decode(message.data).map_err(|_| bad())?;
            let cycles = batch::cycles(&message, axes).ok_or_else(bad)?;
            return Ok(Decoded::Batch(cycles.into()));
        } else if topic == Channel::Cycle.topic() {
            if self.batches {
                return Ok(Decoded::Batch(VecDeque::new()));
            }
            let axes = self.axes()?;
            let cycle = evolvent::Cycle::decode(message.data).map_err(|_| bad())?;
            chunk::cycle(&cycle, axes).map(TraceMessage::Cycle)
        } else if topic == Channel::Event.topic() {
            let event = evolvent::Event::decode(message.data).map_err(|_| bad())?;
            chunk::event(event).map(TraceMessage::Event)
        } else if topic == Channel::Block.topic() {
            let block = evolvent::Block::decode(message.data).map_err(|_| bad())?;
            chunk::block(block).map(TraceMessage::Block)
        } else {
            Some(TraceMessage::Other {
                topic: topic.to_owned(),
                log_time_ns: message.log_time_ns,
                sequence: message.sequence,
                data: message.data.to_vec(),
            })
        };
        decoded.map(Decoded::One).ok_or_else(bad)
    }

    /// The cycles of the next message that has any; `false` at the end.
    fn take_lot(&mut self, lot: &mut Vec<CycleRecord>) -> Result<bool, ReadError> {
        lot.clear();
        loop {
            while self.at >= self.chunk.len() {
                if !self.load()? {
                    return Ok(false);
                }
            }
            let Some((record, next)) = chunk::record_at(&self.chunk, self.at) else {
                return Err(self.damaged("a record in a chunk"));
            };
            self.at = next;
            let Some(Inner::Message(message)) = record else {
                continue;
            };
            if self.only.is_some_and(|channel| channel != message.channel) {
                continue;
            }
            match self.decode(message)? {
                Decoded::One(TraceMessage::Cycle(record)) => lot.push(record),
                Decoded::One(_) => continue,
                Decoded::Batch(cycles) => *lot = cycles.into(),
            }
            if !lot.is_empty() {
                return Ok(true);
            }
        }
    }

    fn step(&mut self) -> Result<Option<TraceMessage>, ReadError> {
        loop {
            if let Some(record) = self.ready.pop_front() {
                return Ok(Some(TraceMessage::Cycle(record)));
            }
            while self.at >= self.chunk.len() {
                if !self.load()? {
                    return Ok(None);
                }
            }
            let Some((record, next)) = chunk::record_at(&self.chunk, self.at) else {
                return Err(self.damaged("a record in a chunk"));
            };
            if let Some(Inner::Message(message)) = record
                && self.only.is_none_or(|channel| channel == message.channel)
            {
                let decoded = self.decode(message);
                self.at = next;
                match decoded? {
                    Decoded::One(message) => return Ok(Some(message)),
                    Decoded::Batch(cycles) => self.ready = cycles,
                }
                continue;
            }
            self.at = next;
        }
    }
}

impl Iterator for Messages<'_> {
    type Item = Result<TraceMessage, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let result = self.step();
        self.failed = result.is_err();
        result.transpose()
    }
}

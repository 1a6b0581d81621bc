//! Writes the MCAP container, append-only, with the `mcap` crate.
//!
//! The crate's writer encodes into memory, where nothing can fail. What it has encoded, a whole chunk,
//! attachment or metadata record, is then appended to the sink. Its own summary is discarded, because it
//! cannot be written after a failed append and holds every chunk of the file in memory; [`Summary`] writes it
//! instead.

use std::collections::BTreeMap;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use mcap::records::{AttachmentHeader, Metadata};
use mcap::{Compression, McapError, WriteOptions};

use crate::sink::TraceSink;
use crate::summary::Summary;

pub(crate) use mcap::records::MessageHeader;

/// A chunk is closed when it has this size before compression. Large enough for the compressor to find
/// its matches, small enough that closing takes about a millisecond.
pub(crate) const CHUNK_BYTES: usize = 512 * 1024;
/// Level 1 is the fastest that still halves the noise of doubles.
const ZSTD_LEVEL: u32 = 1;
/// Opcode, length and header of a message.
const MESSAGE_OVERHEAD_BYTES: usize = 9 + 22;
/// A writer of the crate is replaced after this many chunks, about a minute at four per second: it keeps an
/// index of each, about 350 bytes.
const SECTION_CHUNKS: u32 = 256;
/// Attachments are copied in pieces of this size.
const PIECE_BYTES: usize = 256 * 1024;

/// Bytes that the crate has encoded and the sink has not.
#[derive(Debug, Default)]
struct Encoded {
    bytes: Vec<u8>,
    /// Position in the file of the first of them.
    start: u64,
    /// Whether to drop what is encoded: the head and the summary of each section.
    discards: bool,
}

/// The destination of the crate's writers. They own their stream, so it is shared.
#[derive(Clone, Debug, Default)]
struct Memory(Arc<Mutex<Encoded>>);

impl Memory {
    fn lock(&self) -> MutexGuard<'_, Encoded> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn discard(&self, discards: bool) {
        self.lock().discards = discards;
    }

    /// Position in the file of the next encoded byte.
    fn position(&self) -> u64 {
        let encoded = self.lock();
        encoded.start + encoded.bytes.len() as u64
    }

    fn restart_at(&self, position: u64) {
        let mut encoded = self.lock();
        encoded.bytes.clear();
        encoded.start = position;
    }
}

impl Write for Memory {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut encoded = self.lock();
        if !encoded.discards {
            encoded.bytes.extend_from_slice(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Reports positions in the file, not in the section, so that the crate's indexes are those of the file.
impl Seek for Memory {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match to {
            SeekFrom::Current(0) => Ok(self.position()),
            _ => Err(io::ErrorKind::Unsupported.into()),
        }
    }
}

type Section = mcap::Writer<Memory>;

/// Writes a file from its magic to its footer.
pub(crate) struct Container {
    sink: Box<dyn TraceSink>,
    options: WriteOptions,
    memory: Memory,
    /// End of the last complete record in the sink.
    position: u64,
    /// Checksum of everything in the sink, and of everything up to `position`.
    checksum: crc32fast::Hasher,
    checksum_at_position: crc32fast::Hasher,
    section: Option<Section>,
    section_chunks: u32,
    /// Of the open chunk: bytes before compression, messages by channel, times.
    open_bytes: usize,
    open_counts: BTreeMap<u16, u64>,
    open_times: Option<(u64, u64)>,
    summary: Summary,
    /// An error of the crate that the next close of a chunk reports.
    deferred: Option<io::Error>,
    /// Whether the capacity reserved for the end may be used.
    ending: bool,
}

impl std::fmt::Debug for Container {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Container")
            .field("position", &self.position)
            .finish_non_exhaustive()
    }
}

impl Container {
    /// Writes magic and header. The summary's data about chunks and attachments are stored in `folder`
    /// meanwhile, or in memory if there is none.
    ///
    /// # Errors
    /// The sink cannot take them.
    pub(crate) fn new(
        sink: Box<dyn TraceSink>,
        folder: Option<&Path>,
        profile: &str,
        library: &str,
    ) -> io::Result<Self> {
        let options = WriteOptions::new()
            .profile(profile)
            .library(library)
            .compression(Some(Compression::Zstd))
            .compression_level(ZSTD_LEVEL)
            .compression_threads(0)
            .chunk_size(None)
            // Chunks are written as a whole.
            .disable_seeking(true)
            // The crate would compute that of one section; this type computes that of the file.
            .calculate_data_section_crc(false);
        let mut container = Self {
            sink,
            options,
            memory: Memory::default(),
            position: 0,
            checksum: crc32fast::Hasher::new(),
            checksum_at_position: crc32fast::Hasher::new(),
            section: None,
            section_chunks: 0,
            open_bytes: 0,
            open_counts: BTreeMap::new(),
            open_times: None,
            summary: Summary::new(folder),
            deferred: None,
            ending: false,
        };
        let head = container.options.clone().create(container.memory.clone());
        // Its end is discarded, its head is the file's.
        container.close_section(head.map_err(io_error)?)?;
        container.append_encoded()?;
        container.complete_record();
        Ok(container)
    }

    /// Bytes written so far.
    pub(crate) fn position(&self) -> u64 {
        self.position
    }

    /// Whether it is time to close the chunk.
    pub(crate) fn chunk_is_full(&self) -> bool {
        self.open_bytes >= CHUNK_BYTES
    }

    /// Declares a schema; the first with a number applies.
    pub(crate) fn schema(&mut self, id: u16, name: &str, encoding: &str, data: &[u8]) {
        if self.summary.add_schema(id, name, encoding, data)
            && let Some(section) = &mut self.section
        {
            let added = section.add_schema_with_id(id, name, encoding, data);
            self.defer(added.map(drop).map_err(io_error));
        }
    }

    /// Whether messages can be on this channel.
    pub(crate) fn has_channel(&self, id: u16) -> bool {
        self.summary.channels().contains_key(&id)
    }

    /// The topic of a channel.
    pub(crate) fn topic(&self, id: u16) -> Option<&str> {
        Some(&self.summary.channels().get(&id)?.topic)
    }

    /// Number, topic and schema's name of each channel.
    pub(crate) fn channels(&self) -> impl Iterator<Item = (u16, &str, &str)> {
        self.summary.channels().iter().map(|(&id, channel)| {
            let schema = self.summary.schemas().get(&channel.schema_id);
            (
                id,
                channel.topic.as_str(),
                schema.map_or("", |schema| &schema.name),
            )
        })
    }

    /// Whether channels can be of this schema.
    pub(crate) fn has_schema(&self, id: u16) -> bool {
        self.summary.schemas().contains_key(&id)
    }

    /// Declares a channel; the first with a number applies.
    pub(crate) fn channel(&mut self, channel: mcap::records::Channel) {
        if let (Some(channel), Some(section)) = (self.summary.add_channel(channel), &mut self.section) {
            let added = add_channel(section, channel);
            self.defer(added);
        }
    }

    /// Adds a message to the open chunk, in memory: [`Self::close_chunk`] writes it.
    pub(crate) fn message(&mut self, header: &MessageHeader, data: &[u8]) {
        let written = self.open_section().and_then(|()| match &mut self.section {
            Some(section) => section.write_to_known_channel(header, data).map_err(io_error),
            None => Ok(()),
        });
        self.defer(written);
        self.open_bytes += MESSAGE_OVERHEAD_BYTES + data.len();
        *self.open_counts.entry(header.channel_id).or_default() += 1;
        let (start, end) = self.open_times.unwrap_or((header.log_time, header.log_time));
        self.open_times = Some((start.min(header.log_time), end.max(header.log_time)));
    }

    /// Opens the section that takes messages, with every schema and channel declared.
    fn open_section(&mut self) -> io::Result<()> {
        if self.section.is_some() {
            return Ok(());
        }
        let mut section = self.new_section()?;
        for (&id, schema) in self.summary.schemas() {
            let added = section.add_schema_with_id(id, &schema.name, &schema.encoding, &schema.data);
            added.map_err(io_error)?;
        }
        for channel in self.summary.channels().values() {
            add_channel(&mut section, channel)?;
        }
        self.section = Some(section);
        Ok(())
    }

    /// A writer of the crate whose magic and header are discarded.
    fn new_section(&self) -> io::Result<Section> {
        self.memory.discard(true);
        let section = self.options.clone().create(self.memory.clone());
        self.memory.discard(false);
        section.map_err(io_error)
    }

    /// Ends a writer of the crate, discards its output and returns its indexes.
    fn close_section(&self, mut section: Section) -> io::Result<mcap::Summary> {
        self.memory.discard(true);
        let summary = section.finish();
        drop(section);
        self.memory.discard(false);
        summary.map_err(io_error)
    }

    fn defer(&mut self, result: io::Result<()>) {
        if let Err(error) = result {
            self.deferred.get_or_insert(error);
        }
    }

    /// Maximum size of summary and footer.
    fn reserve_for_end(&self) -> u64 {
        if self.ending {
            0
        } else {
            self.summary.size(u64::from(self.section_chunks) + 1)
        }
    }

    /// Appends what is encoded to the sink.
    fn append_encoded(&mut self) -> io::Result<()> {
        let reserve = self.reserve_for_end();
        let mut encoded = self.memory.lock();
        let result = self.sink.append(&encoded.bytes, reserve);
        self.checksum.update(&encoded.bytes);
        encoded.start += encoded.bytes.len() as u64;
        encoded.bytes.clear();
        result
    }

    /// What has been appended ends with a complete record.
    fn complete_record(&mut self) {
        self.position = self.memory.position();
        self.checksum_at_position = self.checksum.clone();
    }

    /// Compresses and writes the messages of the open chunk, if there are any.
    ///
    /// # Errors
    /// The sink cannot take them; [`Self::cut_back`] has to follow.
    pub(crate) fn close_chunk(&mut self) -> io::Result<()> {
        if let Some(error) = self.deferred.take() {
            return Err(error);
        }
        let Some(section) = self.section.as_mut().filter(|_| self.open_bytes > 0) else {
            return Ok(());
        };
        section.flush().map_err(io_error)?;
        self.append_encoded()?;
        self.complete_record();
        // Only now: the summary describes what is in the file.
        self.summary.count_messages(&self.open_counts, self.open_times);
        self.forget_chunk();
        self.section_chunks += 1;
        if self.section_chunks >= SECTION_CHUNKS {
            self.end_section()?;
        }
        Ok(())
    }

    fn forget_chunk(&mut self) {
        self.open_bytes = 0;
        self.open_counts.clear();
        self.open_times = None;
    }

    /// Moves the indexes of the section's chunks, as far as they are in the file, to the summary.
    fn end_section(&mut self) -> io::Result<()> {
        let Some(section) = self.section.take() else {
            return Ok(());
        };
        self.section_chunks = 0;
        let indexes = self.close_section(section)?;
        for index in &indexes.chunk_indexes {
            if index.chunk_start_offset < self.position {
                self.summary.add_chunk(index);
            }
        }
        Ok(())
    }

    /// Attaches `size` bytes from `data`, piece by piece. The open chunk is closed first.
    ///
    /// # Errors
    /// Those of `data` and of the sink; [`Self::cut_back`] has to follow.
    pub(crate) fn attach(
        &mut self,
        name: &str,
        media_type: &str,
        time_ns: u64,
        size: u64,
        data: &mut dyn Read,
    ) -> io::Result<()> {
        let header = AttachmentHeader {
            log_time: time_ns,
            create_time: time_ns,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
        };
        let indexes = self.in_section(|container, section| {
            section.start_attachment(size, header).map_err(io_error)?;
            let mut piece = vec![0; PIECE_BYTES.min(usize::try_from(size).unwrap_or(PIECE_BYTES))];
            let mut left = size;
            while left > 0 {
                let now = piece.len().min(usize::try_from(left).unwrap_or(PIECE_BYTES));
                data.read_exact(&mut piece[..now])?;
                section.put_attachment_bytes(&piece[..now]).map_err(io_error)?;
                container.append_encoded()?;
                left -= now as u64;
            }
            section.finish_attachment().map_err(io_error)
        })?;
        for index in &indexes.attachment_indexes {
            self.summary.add_attachment(index);
        }
        Ok(())
    }

    /// Writes a metadata record. The open chunk is closed first.
    ///
    /// # Errors
    /// The sink cannot take it; [`Self::cut_back`] has to follow.
    pub(crate) fn metadata(&mut self, name: &str, map: &BTreeMap<String, String>) -> io::Result<()> {
        let metadata = Metadata {
            name: name.to_owned(),
            metadata: map.clone(),
        };
        let indexes = self.in_section(|_, section| section.write_metadata(&metadata).map_err(io_error))?;
        for index in &indexes.metadata_indexes {
            self.summary.add_metadata(index);
        }
        Ok(())
    }

    /// Writes outside chunks, with a writer of its own: one that fails loses its indexes.
    fn in_section(
        &mut self,
        write: impl FnOnce(&mut Self, &mut Section) -> io::Result<()>,
    ) -> io::Result<mcap::Summary> {
        self.close_chunk()?;
        let mut section = self.new_section()?;
        let written = write(self, &mut section).and_then(|()| self.append_encoded());
        let indexes = self.close_section(section);
        written?;
        self.complete_record();
        indexes
    }

    /// Starts to make the written data survive a loss of power.
    ///
    /// # Errors
    /// Those of the sink.
    pub(crate) fn sync(&mut self) -> io::Result<()> {
        self.sink.sync()
    }

    /// After a failed write: truncates its incomplete output, and drops the open chunk. Only metadata and the
    /// end can follow.
    ///
    /// # Errors
    /// The sink cannot be truncated, or the indexes of the chunks are lost: the file needs a recovery.
    pub(crate) fn cut_back(&mut self) -> io::Result<()> {
        self.ending = true;
        let ended = self.end_section();
        self.forget_chunk();
        self.deferred = None;
        self.memory.restart_at(self.position);
        self.checksum = self.checksum_at_position.clone();
        self.sink.truncate(self.position)?;
        ended
    }

    /// Closes the open chunk, writes summary and footer, and waits until all is on disk.
    ///
    /// # Errors
    /// Those of the sink; [`Self::cut_back`] has to follow.
    pub(crate) fn finish(&mut self) -> io::Result<()> {
        self.close_chunk()?;
        self.end_section()?;
        // The capacity was reserved for this.
        self.ending = true;
        let (sink, mut length) = (&mut self.sink, 0);
        let data_crc = self.checksum_at_position.clone().finalize();
        self.summary.write(self.position, data_crc, &mut |bytes| {
            length += bytes.len() as u64;
            sink.append(bytes, 0)
        })?;
        self.position += length;
        self.memory.restart_at(self.position);
        self.sink.end()
    }
}

fn add_channel(section: &mut Section, channel: &mcap::records::Channel) -> io::Result<()> {
    let mcap::records::Channel {
        id,
        schema_id,
        topic,
        message_encoding,
        metadata,
    } = channel;
    let added = section.add_channel_with_id(*id, *schema_id, topic, message_encoding, metadata);
    added.map(drop).map_err(io_error)
}

/// The cause if it is one of the operating system, otherwise the crate's message.
fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

//! Writes the MCAP container, append-only.
//!
//! Why not the writer of the `mcap` crate: it patches the head of each chunk after the fact, so that a torn file
//! ends in a chunk of unknown length; it cannot close a file after a failed write, where this one cuts off
//! the broken record and still writes the index; and it asserts where this crate must not panic. The speed is
//! no reason, though this one is a little faster (`benches/recorder.rs`). The tests read everything back with it.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::Path;

use crate::chunk_table::{ChunkPlace, ChunkTable};
use crate::format::{
    AttachmentIndex, MAGIC, MetadataIndex, RECORD_HEAD, ZSTD, begin_record, end_record, op, put_string,
    put_string_map, put_u16, put_u16_map, put_u32, put_u64,
};
use crate::scratch::Scratch;
use crate::sink::TraceSink;

/// A chunk is closed when it has this size before compression. Large enough for the compressor to find
/// its matches, small enough that closing takes about a millisecond.
pub(crate) const CHUNK_BYTES: usize = 512 * 1024;
/// Level 1 is the fastest that still halves the noise of doubles.
const ZSTD_LEVEL: i32 = 1;
/// More than the index of a chunk takes in the summary.
const CHUNK_INDEX_BYTES: u64 = 256;
/// More than everything else in the summary takes, but for schemas and channels.
const SUMMARY_BYTES: u64 = 8 * 1024;
/// Up to here the compressor's first level has its largest tables.
const MIDDLE_CHUNK_BYTES: usize = 128 * 1024;
/// What the message indexes behind a chunk take as a rule, at the most.
const INDEX_BYTES: usize = 64 * 1024;
/// Attachments are copied in pieces of this size.
const PIECE_BYTES: usize = 256 * 1024;

/// What lies in a chunk, channel by channel.
#[derive(Debug, Default)]
pub(crate) struct ChunkContent {
    bounds: Option<(u64, u64)>,
    /// By channel number: time and place in the uncompressed chunk of each message.
    messages: Vec<Vec<(u64, u64)>>,
}

impl ChunkContent {
    /// Notes a message of `channel` whose record begins at `offset` of the uncompressed chunk.
    pub(crate) fn note(&mut self, channel: u16, time_ns: u64, offset: usize) {
        let channel = usize::from(channel);
        if channel >= self.messages.len() {
            self.messages.resize_with(channel + 1, Vec::new);
        }
        self.messages[channel].push((time_ns, offset as u64));
        self.bounds = Some(match self.bounds {
            None => (time_ns, time_ns),
            Some((start, end)) => (start.min(time_ns), end.max(time_ns)),
        });
    }

    /// The time of the earliest message.
    pub(crate) fn start_time_ns(&self) -> Option<u64> {
        self.bounds.map(|bounds| bounds.0)
    }

    /// Channels that have messages, and how many.
    fn counts(&self) -> Vec<(u16, u64)> {
        (self.messages.iter().enumerate())
            .filter(|(_, list)| !list.is_empty())
            .map(|(channel, list)| (channel as u16, list.len() as u64))
            .collect()
    }

    fn clear(&mut self) {
        self.bounds = None;
        self.messages.iter_mut().for_each(Vec::clear);
    }
}

/// A chunk as it stands in the file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CompressedChunk<'a> {
    pub(crate) compression: &'a str,
    pub(crate) uncompressed_size: u64,
    pub(crate) uncompressed_crc: u32,
    pub(crate) data: &'a [u8],
}

/// Writes a file from its magic to its footer.
pub(crate) struct Writer {
    sink: Box<dyn TraceSink>,
    /// End of the last complete record in the sink.
    position: u64,
    schemas: BTreeMap<u16, Vec<u8>>,
    channels: BTreeMap<u16, Vec<u8>>,
    chunk: Vec<u8>,
    content: ChunkContent,
    compressor: zstd::bulk::Compressor<'static>,
    compressed: Vec<u8>,
    out: Vec<u8>,
    chunks: ChunkTable,
    /// Records of the summary, as they will stand there.
    attachment_indexes: Scratch,
    attachments: u32,
    metadata_indexes: Vec<MetadataIndex>,
    message_counts: BTreeMap<u16, u64>,
    bounds: Option<(u64, u64)>,
    /// From here on the room that was set aside for the end may be used.
    ending: bool,
}

impl std::fmt::Debug for Writer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Writer")
            .field("position", &self.position)
            .finish_non_exhaustive()
    }
}

impl Writer {
    /// Writes magic and header.
    pub(crate) fn new(sink: Box<dyn TraceSink>, profile: &str, library: &str) -> io::Result<Self> {
        let mut writer = Self {
            sink,
            position: 0,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            chunk: Vec::with_capacity(CHUNK_BYTES + CHUNK_BYTES / 4),
            content: ChunkContent::default(),
            compressor: zstd::bulk::Compressor::new(ZSTD_LEVEL)?,
            compressed: Vec::new(),
            out: Vec::new(),
            chunks: ChunkTable::default(),
            attachment_indexes: Scratch::default(),
            attachments: 0,
            metadata_indexes: Vec::new(),
            message_counts: BTreeMap::new(),
            bounds: None,
            ending: false,
        };
        writer.out.extend_from_slice(&MAGIC);
        let at = begin_record(&mut writer.out, op::HEADER);
        put_string(&mut writer.out, profile);
        put_string(&mut writer.out, library);
        end_record(&mut writer.out, at);
        writer.append_out()?;
        Ok(writer)
    }

    /// Keeps what is needed again at the end on disk, in this folder, and takes all memory that chunks will need: from then on
    /// no more is taken, however long the trace gets. To be called before anything else.
    pub(crate) fn keep_in(&mut self, folder: &Path) -> io::Result<()> {
        self.chunks = ChunkTable::kept_in(Scratch::in_folder(folder.to_owned()));
        self.attachment_indexes = Scratch::in_folder(folder.to_owned());
        let largest = vec![0; self.chunk.capacity()];
        self.compressed
            .reserve(zstd::zstd_safe::compress_bound(largest.len()));
        // Its tables are largest for chunks of a middle size.
        for size in [largest.len(), MIDDLE_CHUNK_BYTES] {
            self.compressed.clear();
            self.compressor
                .compress_to_buffer(&largest[..size], &mut self.compressed)?;
        }
        self.out.reserve(self.compressed.capacity() + INDEX_BYTES);
        Ok(())
    }

    /// Bytes written so far.
    pub(crate) fn position(&self) -> u64 {
        self.position
    }

    /// What summary and footer will take, at most.
    fn room_for_end(&self) -> u64 {
        if self.ending {
            return 0;
        }
        let declared = self
            .schemas
            .values()
            .chain(self.channels.values())
            .map(Vec::len)
            .sum::<usize>() as u64;
        let attached = self.attachment_indexes.len();
        SUMMARY_BYTES + declared + attached + CHUNK_INDEX_BYTES * (self.chunks.len() + 1)
    }

    /// Appends `out` as a whole and empties it.
    fn append_out(&mut self) -> io::Result<()> {
        let result = self.sink.append(&self.out, self.room_for_end());
        if result.is_ok() {
            self.position += self.out.len() as u64;
        }
        self.out.clear();
        result
    }

    /// Adds a schema to the open chunk, where the chunk's checksum guards it.
    pub(crate) fn schema(&mut self, id: u16, name: &str, descriptors: &[u8]) {
        let mut record = Vec::new();
        let at = begin_record(&mut record, op::SCHEMA);
        put_u16(&mut record, id);
        put_string(&mut record, name);
        put_string(&mut record, "protobuf");
        put_u32(&mut record, descriptors.len() as u32);
        record.extend_from_slice(descriptors);
        end_record(&mut record, at);
        self.chunk.extend_from_slice(&record);
        self.schemas.insert(id, record);
    }

    /// Adds a channel to the open chunk.
    pub(crate) fn channel(&mut self, id: u16, schema: u16, topic: &str, metadata: &BTreeMap<String, String>) {
        let mut record = Vec::new();
        let at = begin_record(&mut record, op::CHANNEL);
        put_u16(&mut record, id);
        put_u16(&mut record, schema);
        put_string(&mut record, topic);
        put_string(&mut record, "protobuf");
        put_string_map(&mut record, metadata);
        end_record(&mut record, at);
        self.chunk.extend_from_slice(&record);
        self.channels.insert(id, record);
    }

    /// Takes over a schema or channel found in a recovered file; it is repeated in the summary.
    pub(crate) fn adopt(&mut self, opcode: u8, id: u16, content: &[u8]) {
        let mut record = Vec::with_capacity(RECORD_HEAD + content.len());
        let at = begin_record(&mut record, opcode);
        record.extend_from_slice(content);
        end_record(&mut record, at);
        if opcode == op::SCHEMA {
            self.schemas.entry(id).or_insert(record);
        } else {
            self.channels.entry(id).or_insert(record);
        }
    }

    /// Adds a message whose payload `encode` appends to the buffer it is given. Touches memory only: the
    /// chunk is written by [`Self::close_chunk`], when [`Self::chunk_is_full`] says so or at a flush.
    pub(crate) fn message(
        &mut self,
        channel: u16,
        sequence: u32,
        time_ns: u64,
        encode: impl FnOnce(&mut Vec<u8>),
    ) {
        let offset = self.chunk.len();
        let at = begin_record(&mut self.chunk, op::MESSAGE);
        put_u16(&mut self.chunk, channel);
        put_u32(&mut self.chunk, sequence);
        put_u64(&mut self.chunk, time_ns);
        put_u64(&mut self.chunk, time_ns);
        encode(&mut self.chunk);
        end_record(&mut self.chunk, at);
        self.content.note(channel, time_ns, offset);
    }

    /// Whether it is time to close the chunk.
    pub(crate) fn chunk_is_full(&self) -> bool {
        self.chunk.len() >= CHUNK_BYTES
    }

    /// Compresses and writes what has gathered, if anything has.
    pub(crate) fn close_chunk(&mut self) -> io::Result<()> {
        if self.chunk.is_empty() {
            return Ok(());
        }
        self.compressed.clear();
        self.compressed
            .reserve(zstd::zstd_safe::compress_bound(self.chunk.len()));
        let chunk = std::mem::take(&mut self.chunk);
        let mut compressed = std::mem::take(&mut self.compressed);
        let mut content = std::mem::take(&mut self.content);
        let result = match self.compressor.compress_to_buffer(&chunk, &mut compressed) {
            Ok(_) => self.write_chunk(
                &CompressedChunk {
                    compression: ZSTD,
                    uncompressed_size: chunk.len() as u64,
                    uncompressed_crc: crc32fast::hash(&chunk),
                    data: &compressed,
                },
                &content,
            ),
            Err(error) => Err(error),
        };
        content.clear();
        (self.chunk, self.compressed, self.content) = (chunk, compressed, content);
        self.chunk.clear();
        result
    }

    /// Writes a chunk with its message indexes.
    pub(crate) fn write_chunk(
        &mut self,
        chunk: &CompressedChunk<'_>,
        content: &ChunkContent,
    ) -> io::Result<()> {
        let (start_time, end_time) = content.bounds.unwrap_or((0, 0));
        let offset = self.position;
        let out = &mut self.out;
        let at = begin_record(out, op::CHUNK);
        put_u64(out, start_time);
        put_u64(out, end_time);
        put_u64(out, chunk.uncompressed_size);
        put_u32(out, chunk.uncompressed_crc);
        put_string(out, chunk.compression);
        put_u64(out, chunk.data.len() as u64);
        out.extend_from_slice(chunk.data);
        end_record(out, at);
        for (channel, messages) in content.messages.iter().enumerate() {
            if messages.is_empty() {
                continue;
            }
            let at = begin_record(out, op::MESSAGE_INDEX);
            put_u16(out, channel as u16);
            put_u32(out, messages.len() as u32 * 16);
            for &(time_ns, place) in messages {
                put_u64(out, time_ns);
                put_u64(out, place);
            }
            end_record(out, at);
        }
        self.append_out()?;
        let messages = content.counts();
        self.chunks.push(&ChunkPlace {
            offset,
            start_time,
            end_time,
            compression: chunk.compression,
            compressed_size: chunk.data.len() as u64,
            uncompressed_size: chunk.uncompressed_size,
            messages: &messages,
        });
        // Counted only now: the summary speaks of what is in the file.
        for (channel, count) in messages {
            *self.message_counts.entry(channel).or_default() += count;
        }
        if let Some((start, end)) = content.bounds {
            let bounds = self.bounds.get_or_insert((start, end));
            *bounds = (bounds.0.min(start), bounds.1.max(end));
        }
        Ok(())
    }

    /// Attaches `size` bytes from `data`, piece by piece. The open chunk is closed first.
    pub(crate) fn attach(
        &mut self,
        name: &str,
        media_type: &str,
        time_ns: u64,
        size: u64,
        data: &mut dyn Read,
    ) -> io::Result<()> {
        self.close_chunk()?;
        let offset = self.position;
        let room = self.room_for_end();
        let out = &mut self.out;
        out.push(op::ATTACHMENT);
        let content_length = 8 + 8 + 4 + name.len() + 4 + media_type.len() + 8 + 4;
        put_u64(out, content_length as u64 + size);
        put_u64(out, time_ns);
        put_u64(out, time_ns);
        put_string(out, name);
        put_string(out, media_type);
        put_u64(out, size);
        let mut crc = crc32fast::Hasher::new();
        crc.update(&out[RECORD_HEAD..]);
        let mut length = out.len() as u64;
        let mut result = self.sink.append(out, room);
        out.clear();
        let mut left = size;
        let mut piece = vec![0; PIECE_BYTES.min(usize::try_from(size).unwrap_or(PIECE_BYTES))];
        while result.is_ok() && left > 0 {
            let now = piece.len().min(usize::try_from(left).unwrap_or(PIECE_BYTES));
            result = data
                .read_exact(&mut piece[..now])
                .and_then(|()| self.sink.append(&piece[..now], room));
            crc.update(&piece[..now]);
            left -= now as u64;
            length += now as u64;
        }
        result?;
        self.sink.append(&crc.finalize().to_le_bytes(), room)?;
        length += 4;
        self.position += length;
        let index = AttachmentIndex {
            offset,
            length,
            log_time: time_ns,
            create_time: time_ns,
            data_size: size,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
        };
        index.put(self.attachment_indexes.tail());
        self.attachment_indexes.settle();
        self.attachments += 1;
        Ok(())
    }

    /// Writes a metadata record. The open chunk is closed first.
    pub(crate) fn metadata(&mut self, name: &str, map: &BTreeMap<String, String>) -> io::Result<()> {
        self.close_chunk()?;
        let offset = self.position;
        let at = begin_record(&mut self.out, op::METADATA);
        put_string(&mut self.out, name);
        put_string_map(&mut self.out, map);
        end_record(&mut self.out, at);
        self.append_out()?;
        let length = self.position - offset;
        self.metadata_indexes.push(MetadataIndex {
            offset,
            length,
            name: name.to_owned(),
        });
        Ok(())
    }

    /// Makes what is written survive a loss of power, soon.
    pub(crate) fn sync(&mut self) -> io::Result<()> {
        self.sink.sync()
    }

    /// After a failed write: cuts off what it left half done, and drops the open chunk. All that can follow is
    /// the end.
    pub(crate) fn cut_back(&mut self) -> io::Result<()> {
        self.ending = true;
        self.chunk.clear();
        self.content.clear();
        self.out.clear();
        self.sink.truncate(self.position)
    }

    /// Closes the open chunk, writes summary and footer, and waits until all is on disk.
    pub(crate) fn finish(&mut self) -> io::Result<()> {
        self.close_chunk()?;
        let at = begin_record(&mut self.out, op::DATA_END);
        // 0: not computed. Every chunk and attachment has its own checksum.
        put_u32(&mut self.out, 0);
        end_record(&mut self.out, at);
        let attachment_indexes = self.attachment_indexes.read()?;
        let mut chunk_indexes = Vec::new();
        self.chunks.indexes(|index| index.put(&mut chunk_indexes))?;
        let before = self.out.len();
        let summary_start = self.position + before as u64;

        let mut groups = Vec::new();
        let out = &mut self.out;
        let mut group = |out: &mut Vec<u8>, opcode: u8, put: &dyn Fn(&mut Vec<u8>)| {
            let start = out.len();
            put(out);
            if out.len() > start {
                groups.push((
                    opcode,
                    summary_start + (start - before) as u64,
                    (out.len() - start) as u64,
                ));
            }
        };
        group(out, op::SCHEMA, &|out| {
            self.schemas
                .values()
                .for_each(|record| out.extend_from_slice(record));
        });
        group(out, op::CHANNEL, &|out| {
            self.channels
                .values()
                .for_each(|record| out.extend_from_slice(record));
        });
        group(out, op::STATISTICS, &|out| {
            let at = begin_record(out, op::STATISTICS);
            put_u64(out, self.message_counts.values().sum());
            put_u16(out, self.schemas.len() as u16);
            put_u32(out, self.channels.len() as u32);
            put_u32(out, self.attachments);
            put_u32(out, self.metadata_indexes.len() as u32);
            put_u32(out, self.chunks.len() as u32);
            put_u64(out, self.bounds.map_or(0, |bounds| bounds.0));
            put_u64(out, self.bounds.map_or(0, |bounds| bounds.1));
            put_u16_map(out, &self.message_counts);
            end_record(out, at);
        });
        group(out, op::CHUNK_INDEX, &|out| {
            out.extend_from_slice(&chunk_indexes);
        });
        group(out, op::ATTACHMENT_INDEX, &|out| {
            out.extend_from_slice(&attachment_indexes);
        });
        group(out, op::METADATA_INDEX, &|out| {
            self.metadata_indexes.iter().for_each(|index| index.put(out));
        });

        let offset_start = self.position + self.out.len() as u64;
        for (opcode, start, length) in groups {
            let at = begin_record(&mut self.out, op::SUMMARY_OFFSET);
            self.out.push(opcode);
            put_u64(&mut self.out, start);
            put_u64(&mut self.out, length);
            end_record(&mut self.out, at);
        }
        self.out.push(op::FOOTER);
        put_u64(&mut self.out, 8 + 8 + 4);
        put_u64(&mut self.out, summary_start);
        put_u64(&mut self.out, offset_start);
        let crc = crc32fast::hash(&self.out[before..]);
        put_u32(&mut self.out, crc);
        self.out.extend_from_slice(&MAGIC);
        // This is what the room was for.
        self.ending = true;
        self.append_out()?;
        self.sink.end()
    }
}

//! The end of a file: schemas, channels, counts, and the positions of chunks, attachments and metadata.
//!
//! The records are those of the `mcap` crate. It can only write them all at once, from memory, at the end of
//! a run without a failure; here they are stored encoded, on disk, until then.

use std::collections::BTreeMap;
use std::io::{self, Cursor};
use std::path::Path;

use binrw::{BinWrite, BinWriterExt as _};
use mcap::records::{
    AttachmentIndex, Channel, ChunkIndex, DataEnd, Footer, MetadataIndex, SchemaHeader, Statistics,
    SummaryOffset, op,
};
use mcap::{MAGIC, Schema};

use crate::scratch::Scratch;

/// Upper bound of the size of a chunk's index.
const CHUNK_INDEX_BYTES: u64 = 256;
/// Upper bound of the size of everything else than schemas, channels and indexes.
const REST_BYTES: u64 = 8 * 1024;
/// The footer's content: two positions and a checksum.
const FOOTER_BYTES: u64 = 8 + 8 + 4;

/// Data gathered while the file is written.
#[derive(Debug)]
pub(crate) struct Summary {
    schemas: BTreeMap<u16, Schema<'static>>,
    channels: BTreeMap<u16, Channel>,
    /// Bytes of schemas and channels.
    declared: u64,
    statistics: Statistics,
    chunks: Scratch,
    attachments: Scratch,
    metadata: Scratch,
}

impl Summary {
    /// Creates an empty summary, stored in `folder`, or in memory if there is none.
    pub(crate) fn new(folder: Option<&Path>) -> Self {
        let scratch = || folder.map_or_else(Scratch::default, |folder| Scratch::in_folder(folder.to_owned()));
        Self {
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            declared: 0,
            statistics: Statistics::default(),
            chunks: scratch(),
            attachments: scratch(),
            metadata: Scratch::default(),
        }
    }

    /// The schemas by number.
    pub(crate) fn schemas(&self) -> &BTreeMap<u16, Schema<'static>> {
        &self.schemas
    }

    /// The channels by number.
    pub(crate) fn channels(&self) -> &BTreeMap<u16, Channel> {
        &self.channels
    }

    /// Adds a schema, unless one with its number exists.
    pub(crate) fn add_schema(&mut self, id: u16, name: &str, encoding: &str, data: &[u8]) -> bool {
        if self.schemas.contains_key(&id) {
            return false;
        }
        let schema = Schema {
            id,
            name: name.to_owned(),
            encoding: encoding.to_owned(),
            data: data.to_owned().into(),
        };
        self.declared += schema_record(&schema).len() as u64;
        self.schemas.insert(id, schema);
        true
    }

    /// Adds a channel and returns it, unless one with its number exists.
    pub(crate) fn add_channel(&mut self, channel: Channel) -> Option<&Channel> {
        if self.channels.contains_key(&channel.id) {
            return None;
        }
        self.declared += record(op::CHANNEL, &channel).len() as u64;
        Some(self.channels.entry(channel.id).or_insert(channel))
    }

    /// Counts the messages of a chunk: their numbers by channel, first and last time.
    pub(crate) fn count_messages(&mut self, counts: &BTreeMap<u16, u64>, times: Option<(u64, u64)>) {
        let statistics = &mut self.statistics;
        if let Some((start, end)) = times {
            let is_first = statistics.message_count == 0;
            let old = (!is_first).then_some((statistics.message_start_time, statistics.message_end_time));
            let (old_start, old_end) = old.unwrap_or((start, end));
            statistics.message_start_time = start.min(old_start);
            statistics.message_end_time = end.max(old_end);
        }
        for (&channel, &count) in counts {
            statistics.message_count += count;
            *statistics.channel_message_counts.entry(channel).or_default() += count;
        }
    }

    /// Adds the position of a chunk.
    pub(crate) fn add_chunk(&mut self, index: &ChunkIndex) {
        self.statistics.chunk_count += 1;
        self.chunks.push(&record(op::CHUNK_INDEX, index));
    }

    /// Adds the position of an attachment.
    pub(crate) fn add_attachment(&mut self, index: &AttachmentIndex) {
        self.statistics.attachment_count += 1;
        self.attachments.push(&record(op::ATTACHMENT_INDEX, index));
    }

    /// Adds the position of a metadata record.
    pub(crate) fn add_metadata(&mut self, index: &MetadataIndex) {
        self.statistics.metadata_count += 1;
        self.metadata.push(&record(op::METADATA_INDEX, index));
    }

    /// Maximum number of bytes that [`Self::write`] will append, with this many more chunks.
    pub(crate) fn size(&self, more_chunks: u64) -> u64 {
        let indexes = self.chunks.len() + self.attachments.len() + self.metadata.len();
        REST_BYTES + self.declared + indexes + CHUNK_INDEX_BYTES * more_chunks
    }

    /// Appends everything that follows the data, up to the last magic. `position` is the file's length,
    /// `data_section_crc` the checksum of all of it.
    ///
    /// # Errors
    /// Those of `append`, and of reading the stored data.
    pub(crate) fn write(
        &mut self,
        position: u64,
        data_section_crc: u32,
        append: &mut dyn FnMut(&[u8]) -> io::Result<()>,
    ) -> io::Result<()> {
        let data_end = record(op::DATA_END, &DataEnd { data_section_crc });
        append(&data_end)?;
        self.statistics.schema_count = self.schemas.len() as u16;
        self.statistics.channel_count = self.channels.len() as u32;
        let start = position + data_end.len() as u64;
        let mut out = Checked {
            append,
            position: start,
            crc: crc32fast::Hasher::new(),
        };
        let mut offsets = Vec::new();
        let mut end_group = |group_opcode, group_start, end: u64| {
            if end > group_start {
                offsets.push(SummaryOffset {
                    group_opcode,
                    group_start,
                    group_length: end - group_start,
                });
            }
        };
        let schemas: Vec<u8> = self.schemas.values().flat_map(schema_record).collect();
        let channels: Vec<u8> = self
            .channels
            .values()
            .flat_map(|channel| record(op::CHANNEL, channel))
            .collect();
        let statistics = record(op::STATISTICS, &self.statistics);
        for (opcode, bytes) in [
            (op::SCHEMA, schemas),
            (op::CHANNEL, channels),
            (op::STATISTICS, statistics),
        ] {
            let group_start = out.position;
            out.put(&bytes)?;
            end_group(opcode, group_start, out.position);
        }
        for (opcode, stored) in [
            (op::CHUNK_INDEX, &self.chunks),
            (op::ATTACHMENT_INDEX, &self.attachments),
            (op::METADATA_INDEX, &self.metadata),
        ] {
            let group_start = out.position;
            stored.read(&mut |bytes| out.put(bytes))?;
            end_group(opcode, group_start, out.position);
        }
        let mut footer = Footer {
            summary_start: start,
            summary_offset_start: out.position,
            summary_crc: 0,
        };
        for offset in &offsets {
            out.put(&record(op::SUMMARY_OFFSET, offset))?;
        }
        // The checksum also covers the footer, up to itself.
        let unsealed = record(op::FOOTER, &footer);
        out.crc.update(&unsealed[..unsealed.len() - 4]);
        footer.summary_crc = out.crc.finalize();
        let mut end = record(op::FOOTER, &footer);
        debug_assert_eq!(end.len() as u64, 9 + FOOTER_BYTES);
        end.extend_from_slice(MAGIC);
        append(&end)
    }
}

/// Appends, and tracks position and checksum.
struct Checked<'a> {
    append: &'a mut dyn FnMut(&[u8]) -> io::Result<()>,
    position: u64,
    crc: crc32fast::Hasher,
}

impl Checked<'_> {
    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        (self.append)(bytes)?;
        self.crc.update(bytes);
        self.position += bytes.len() as u64;
        Ok(())
    }
}

/// The bytes of a record after its opcode and length.
pub(crate) fn content<T>(content: &T) -> Vec<u8>
where
    T: for<'a> BinWrite<Args<'a> = ()>,
{
    let mut bytes = Cursor::new(Vec::new());
    // Memory accepts everything.
    let _ = bytes.write_le(content);
    bytes.into_inner()
}

fn record<T>(opcode: u8, fields: &T) -> Vec<u8>
where
    T: for<'a> BinWrite<Args<'a> = ()>,
{
    with_head(opcode, &content(fields))
}

fn schema_record(schema: &Schema<'_>) -> Vec<u8> {
    let mut bytes = content(&SchemaHeader {
        id: schema.id,
        name: schema.name.clone(),
        encoding: schema.encoding.clone(),
    });
    bytes.extend_from_slice(&(schema.data.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&schema.data);
    with_head(op::SCHEMA, &bytes)
}

fn with_head(opcode: u8, content: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(9 + content.len());
    bytes.push(opcode);
    bytes.extend_from_slice(&(content.len() as u64).to_le_bytes());
    bytes.extend_from_slice(content);
    bytes
}

//! Checks every record of a finished trace.

use std::collections::BTreeMap;

use mcap::MAGIC;
use mcap::records::{ChunkHeader, ChunkIndex, MessageIndexEntry, Record, op};

use crate::chunk::{ChunkRecords, RECORD_HEAD, message, parse, whole_record};
use crate::read_error::ReadError;
use crate::reader::{FOOTER_LENGTH, TraceFile, attachment_data};
use crate::schema;

/// Log times and positions of the messages of a chunk, by channel.
type Entries = BTreeMap<u16, Vec<(u64, u64)>>;

impl TraceFile {
    /// Reads the whole file and compares every chunk, attachment and index with its checksum, or with the
    /// data that it duplicates. Readers check what they read; this also finds damage in the rest.
    ///
    /// In files without a checksum of the data section, as other tools and earlier versions write, the name
    /// of the writing library and changes of compressed data that decompress to the same are not found.
    ///
    /// # Errors
    /// [`ReadError::Damaged`] at the first damaged record.
    pub fn check_whole(&mut self) -> Result<(), ReadError> {
        let mut offset = MAGIC.len() as u64;
        let end = self.source.length - (FOOTER_LENGTH + MAGIC.len()) as u64;
        let chunks: BTreeMap<u64, ChunkIndex> = self
            .chunks
            .iter()
            .map(|chunk| (chunk.chunk_start_offset, chunk.clone()))
            .collect();
        let mut seen = [0_usize; 2];
        let mut entries = Entries::new();
        let mut is_first = true;
        let mut data = crc32fast::Hasher::new();
        data.update(MAGIC);
        while offset < end {
            let head = self.source.read(offset, RECORD_HEAD as u64, "a record")?;
            let length = head
                .get(1..)
                .and_then(|bytes| bytes.try_into().ok())
                .map_or(0, u64::from_le_bytes);
            let whole = (RECORD_HEAD as u64).saturating_add(length);
            let bytes = self.source.read(offset, whole, "a record")?;
            let damaged = |what| self.source.damaged(offset, what);
            let (opcode, content) = whole_record(&bytes).ok_or_else(|| damaged("a record"))?;
            if is_first != (opcode == op::HEADER) {
                return Err(damaged("its header"));
            }
            is_first = false;
            if opcode != op::MESSAGE_INDEX && entries.values().any(|left| !left.is_empty()) {
                return Err(damaged("the indexes of a chunk"));
            }
            match opcode {
                op::CHUNK => {
                    let index = chunks
                        .get(&offset)
                        .ok_or_else(|| damaged("a chunk that no index has"))?;
                    entries = chunk_entries(&bytes, content, index).ok_or_else(|| damaged("a chunk"))?;
                    // Other tools may omit them.
                    if index.message_index_length == 0 {
                        entries.clear();
                    }
                    seen[0] += 1;
                }
                op::MESSAGE_INDEX => {
                    let found = index_entries(content);
                    let is_same =
                        found.is_some_and(|(channel, found)| entries.remove(&channel) == Some(found));
                    if !is_same {
                        return Err(damaged("the index of a chunk"));
                    }
                }
                op::ATTACHMENT => {
                    let index = self.attachments.iter().find(|index| index.offset == offset);
                    if index.is_none_or(|index| index.length != whole) || attachment_data(&bytes).is_none() {
                        return Err(damaged("an attachment"));
                    }
                    seen[1] += 1;
                }
                op::DATA_END => {
                    // The rest has its own checksum, which was compared when the file was opened.
                    let is_end = match parse(opcode, content) {
                        Some(Record::DataEnd(record)) => {
                            // 0: not computed.
                            let crc = record.data_section_crc;
                            content.len() == 4 && (crc == 0 || crc == data.clone().finalize())
                        }
                        _ => false,
                    };
                    let is_complete = seen[0] == chunks.len() && seen[1] == self.attachments.len();
                    return if is_end && is_complete && offset + whole == self.summary_start {
                        Ok(())
                    } else {
                        Err(damaged("the end of its data"))
                    };
                }
                op::HEADER => {
                    let is_ours = matches!(parse(opcode, content), Some(Record::Header(header))
                        if header.profile == schema::PROFILE
                            && content.len() == 8 + header.profile.len() + header.library.len());
                    if !is_ours {
                        return Err(damaged("its header"));
                    }
                }
                // Metadata that are read were compared when the file was opened.
                op::METADATA | op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                    if parse(opcode, content).is_none() {
                        return Err(damaged("a record"));
                    }
                }
                _ => return Err(damaged("a record of an unknown kind")),
            }
            data.update(&bytes);
            offset += whole;
        }
        Err(self.source.damaged(end, "the end of its data"))
    }
}

/// The messages of a chunk, if all of it matches its checksum and its index.
fn chunk_entries(record: &[u8], content: &[u8], index: &ChunkIndex) -> Option<Entries> {
    let Some(Record::Chunk { header, .. }) = parse(op::CHUNK, content) else {
        return None;
    };
    let ChunkHeader {
        message_start_time,
        message_end_time,
        uncompressed_size,
        ref compression,
        compressed_size,
        ..
    } = header;
    let is_same = message_start_time == index.message_start_time
        && message_end_time == index.message_end_time
        && uncompressed_size == index.uncompressed_size
        && *compression == index.compression
        && compressed_size == index.compressed_size
        && record.len() as u64 == index.chunk_length;
    let mut records = ChunkRecords::new(record).ok()?;
    let (mut entries, mut position) = (Entries::new(), 0);
    while let Some((opcode, data)) = records.next().ok()? {
        if opcode == op::MESSAGE {
            let (header, _) = message(data)?;
            entries
                .entry(header.channel_id)
                .or_default()
                .push((header.log_time, position));
        }
        position += (RECORD_HEAD + data.len()) as u64;
    }
    entries.values_mut().for_each(|list| list.sort_unstable());
    is_same.then_some(entries)
}

/// The channel and the sorted entries of a message index.
fn index_entries(content: &[u8]) -> Option<(u16, Vec<(u64, u64)>)> {
    let Some(Record::MessageIndex(index)) = parse(op::MESSAGE_INDEX, content) else {
        return None;
    };
    let entry = |entry: &MessageIndexEntry| (entry.log_time, entry.offset);
    let mut entries: Vec<_> = index.records.iter().map(entry).collect();
    entries.sort_unstable();
    Some((index.channel_id, entries))
}

//! Where the chunks of a trace lie, until its summary is written: a machine that is served records for weeks, so each
//! chunk is kept as a few bytes and not as the record of up to 150 that the summary has of it.

use std::collections::BTreeMap;
use std::io;

use crate::format::{ChunkIndex, RECORD_HEAD, ZSTD};
use crate::scratch::Scratch;
use crate::varint::{folded, put_varint, take_varint, unfolded};

/// A chunk record but for its compression's name and its data.
const CHUNK_BYTES: u64 = (RECORD_HEAD + 8 + 8 + 8 + 4 + 4 + 8) as u64;
/// A message index without messages, and each of its messages.
const MESSAGE_INDEX_BYTES: u64 = (RECORD_HEAD + 2 + 4) as u64;
const INDEXED_MESSAGE_BYTES: u64 = 16;

/// What cannot be derived from the chunks before.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChunkPlace<'a> {
    pub(crate) offset: u64,
    pub(crate) start_time: u64,
    pub(crate) end_time: u64,
    pub(crate) compression: &'a str,
    pub(crate) compressed_size: u64,
    pub(crate) uncompressed_size: u64,
    /// Channels in the order of their message indexes behind the chunk, and their messages, 1 at least.
    pub(crate) messages: &'a [(u16, u64)],
}

/// Where the chunk before ended.
#[derive(Clone, Copy, Debug, Default)]
struct Before {
    offset: u64,
    time: u64,
}

/// Chunks in the order of the file, as numbers of 7 bits a byte: differences to the chunk before.
#[derive(Debug, Default)]
pub(crate) struct ChunkTable {
    bytes: Scratch,
    count: u64,
    before: Before,
}

impl ChunkTable {
    /// An empty one that is gathered there.
    pub(crate) fn kept_in(bytes: Scratch) -> Self {
        Self {
            bytes,
            ..Self::default()
        }
    }

    /// How many chunks there are.
    pub(crate) fn len(&self) -> u64 {
        self.count
    }

    /// Adds the chunk that lies behind all others.
    pub(crate) fn push(&mut self, place: &ChunkPlace<'_>) {
        let Before { offset, time } = self.before;
        self.put_difference(offset, place.offset);
        self.put_difference(time, place.start_time);
        self.put_difference(place.start_time, place.end_time);
        // As a rule there is but one compression.
        if place.compression == ZSTD {
            self.put(0);
        } else {
            self.put(1 + place.compression.len() as u64);
            self.bytes.tail().extend_from_slice(place.compression.as_bytes());
        }
        self.put(place.compressed_size);
        self.put(place.uncompressed_size);
        self.put(place.messages.len() as u64);
        for &(channel, count) in place.messages {
            self.put(u64::from(channel));
            self.put(count);
        }
        let length = CHUNK_BYTES + place.compression.len() as u64 + place.compressed_size;
        let indexes: u64 = place.messages.iter().map(|&(_, count)| index_bytes(count)).sum();
        self.before = Before {
            offset: place.offset + length + indexes,
            time: place.end_time,
        };
        self.count += 1;
        self.bytes.settle();
    }

    /// Hands over the chunks as the summary has them.
    ///
    /// # Errors
    /// What lies on disk cannot be read.
    pub(crate) fn indexes(&self, mut take: impl FnMut(ChunkIndex)) -> io::Result<()> {
        let bytes = self.bytes.read()?;
        let mut rest = bytes.as_slice();
        let mut before = Before::default();
        while let Some(index) = take_index(&mut rest, before) {
            before = Before {
                offset: index.offset + index.length + index.message_index_length,
                time: index.end_time,
            };
            take(index);
        }
        Ok(())
    }

    fn put(&mut self, value: u64) {
        put_varint(self.bytes.tail(), value);
    }

    /// Small numbers for small differences of either sign.
    fn put_difference(&mut self, from: u64, to: u64) {
        self.put(folded(to.wrapping_sub(from).cast_signed()));
    }
}

fn index_bytes(messages: u64) -> u64 {
    MESSAGE_INDEX_BYTES + INDEXED_MESSAGE_BYTES * messages
}

fn take_difference(rest: &mut &[u8], from: u64) -> Option<u64> {
    Some(from.wrapping_add_signed(unfolded(take_varint(rest)?)))
}

fn take_index(rest: &mut &[u8], before: Before) -> Option<ChunkIndex> {
    let offset = take_difference(rest, before.offset)?;
    let start_time = take_difference(rest, before.time)?;
    let end_time = take_difference(rest, start_time)?;
    let compression = match take_varint(rest)? {
        0 => ZSTD.to_owned(),
        more => {
            let (name, tail) = rest.split_at_checked(more as usize - 1)?;
            *rest = tail;
            String::from_utf8_lossy(name).into_owned()
        }
    };
    let compressed_size = take_varint(rest)?;
    let uncompressed_size = take_varint(rest)?;
    let length = CHUNK_BYTES + compression.len() as u64 + compressed_size;
    let mut message_index_offsets = BTreeMap::new();
    let mut message_index_length = 0;
    for _ in 0..take_varint(rest)? {
        let channel = take_varint(rest)? as u16;
        message_index_offsets.insert(channel, offset + length + message_index_length);
        message_index_length += index_bytes(take_varint(rest)?);
    }
    Some(ChunkIndex {
        start_time,
        end_time,
        offset,
        length,
        message_index_offsets,
        message_index_length,
        compression,
        compressed_size,
        uncompressed_size,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_come_back_as_they_were_wherever_and_whenever_the_chunks_are() {
        let far = [(0, 1), (7, 300), (u16::MAX, 1 << 40)];
        let places = [
            // Without messages, behind the header.
            (31, 0, 0, ZSTD, 0, 0, &far[..0]),
            // Later than it began, and earlier: a recovered file may hold both.
            (1000, u64::MAX, 0, "lz4", 77, 1 << 33, &far[..2]),
            (u64::MAX >> 1, 5, u64::MAX, "", 1 << 50, 1, &far[..]),
            (12, 5, 5, ZSTD, 127, 128, &far[1..]),
        ];
        let mut table = ChunkTable::default();
        for (offset, start_time, end_time, compression, compressed_size, uncompressed_size, messages) in
            places
        {
            table.push(&ChunkPlace {
                offset,
                start_time,
                end_time,
                compression,
                compressed_size,
                uncompressed_size,
                messages,
            });
        }
        let mut indexes = Vec::new();
        table.indexes(|index| indexes.push(index)).unwrap();
        assert_eq!((table.len(), indexes.len()), (4, 4));
        for (index, place) in indexes.iter().zip(places) {
            assert_eq!(
                (index.offset, index.start_time, index.end_time),
                (place.0, place.1, place.2)
            );
            assert_eq!(index.compression, place.3);
            assert_eq!(
                (index.compressed_size, index.uncompressed_size),
                (place.4, place.5)
            );
            // 53 bytes around the data, by the specification: head 9, times and size 24, checksum 4, name 4, size 8, and
            // the name itself.
            assert_eq!(index.length, 49 + place.3.len() as u64 + place.4);
            let mut at = index.offset + index.length;
            for &(channel, messages) in place.6 {
                assert_eq!(index.message_index_offsets[&channel], at);
                // Head 9, channel 2, length 4, and a time and a place for each message.
                at += 15 + 16 * messages;
            }
            assert_eq!(index.message_index_length, at - index.offset - index.length);
            assert_eq!(index.message_index_offsets.len(), place.6.len());
        }
    }

    /// A day at 1 kHz with a flush each 250 ms has 345 600 chunks.
    #[test]
    fn a_chunk_takes_few_bytes_however_long_the_trace_gets() {
        let mut table = ChunkTable::default();
        let (mut offset, mut time) = (1_000_000_000_000, 1_795_000_000_000_000_000);
        let messages = [(1, 250), (2, 1), (3, 4), (4, 1), (5, 5)];
        for _ in 0..10_000 {
            table.push(&ChunkPlace {
                offset,
                start_time: time,
                end_time: time + 249_000_000,
                compression: ZSTD,
                compressed_size: 20_000,
                uncompressed_size: 85_000,
                messages: &messages,
            });
            offset += 53 + 20_000 + 5 * 15 + 16 * 261;
            time += 250_000_000;
        }
        let bytes = table.bytes.len();
        assert!(bytes <= 30 * 10_000, "{bytes} bytes");
        let mut last = None;
        table.indexes(|index| last = Some(index.offset)).unwrap();
        assert_eq!(last, Some(offset - 24_304));
    }
}

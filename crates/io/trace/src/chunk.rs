//! The records of a chunk, with its checksum verified before the first is returned.

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

/// Opcode and length of a record.
pub(crate) const RECORD_HEAD: usize = 9;
/// A chunk that claims to be larger than this is damaged: the recorder's are a thousandth of it.
pub(crate) const MAX_CHUNK_BYTES: u64 = 256 * 1024 * 1024;
/// Size of a chunk record's content without the compression's name and the data.
const CHUNK_HEADER_BYTES: u64 = 8 + 8 + 8 + 4 + 4 + 8;

/// A chunk does not match its checksum, or its content is not a sequence of records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Damaged;

/// Iterates over the records of a chunk.
pub(crate) struct ChunkRecords {
    reader: LinearReader,
    /// Bytes before compression not read yet.
    left: u64,
}

impl std::fmt::Debug for ChunkRecords {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ChunkRecords")
            .field("left", &self.left)
            .finish_non_exhaustive()
    }
}

impl ChunkRecords {
    /// Takes a whole chunk record, opcode and length included.
    ///
    /// # Errors
    /// It is not a chunk record.
    pub(crate) fn new(record: &[u8]) -> Result<Self, Damaged> {
        let (opcode, content) = whole_record(record).ok_or(Damaged)?;
        let Some(Record::Chunk { header, data }) = parse(opcode, content) else {
            return Err(Damaged);
        };
        let length = CHUNK_HEADER_BYTES + header.compression.len() as u64 + data.len() as u64;
        let size = header.uncompressed_size;
        let is_sized = length == content.len() as u64
            && size <= MAX_CHUNK_BYTES
            && (!header.compression.is_empty() || size == data.len() as u64);
        // 0 is "not computed" in the format. This crate always computes it; one chunk in four thousand
        // million has 0.
        let is_checked = header.uncompressed_crc != 0 || size == 0;
        if !is_sized || !is_checked {
            return Err(Damaged);
        }
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MAX_CHUNK_BYTES as usize);
        let mut reader = LinearReader::new_with_options(options);
        reader.insert(record.len()).copy_from_slice(record);
        reader.notify_read(record.len());
        Ok(Self { reader, left: size })
    }

    /// The next record: opcode and content. `None` at the end.
    ///
    /// # Errors
    /// The chunk is damaged. Unless it was written damaged, the error precedes all records.
    pub(crate) fn next(&mut self) -> Result<Option<(u8, &[u8])>, Damaged> {
        match self.reader.next_event() {
            Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                let length = (RECORD_HEAD + data.len()) as u64;
                self.left = self.left.checked_sub(length).ok_or(Damaged)?;
                Ok(Some((opcode, data)))
            }
            Some(Err(_)) => Err(Damaged),
            // Nothing follows the chunk.
            Some(Ok(LinearReadEvent::ReadRequest(_))) | None => {
                if self.left == 0 {
                    Ok(None)
                } else {
                    Err(Damaged)
                }
            }
        }
    }
}

/// Opcode and content of the first record, and the remaining bytes.
pub(crate) fn split_record(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&[opcode, ref length @ ..], rest) = bytes.split_first_chunk::<RECORD_HEAD>()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
    let (content, rest) = rest.split_at_checked(length)?;
    Some((opcode, content, rest))
}

/// Opcode and content of a record that has exactly these bytes.
pub(crate) fn whole_record(bytes: &[u8]) -> Option<(u8, &[u8])> {
    let (opcode, content, rest) = split_record(bytes)?;
    rest.is_empty().then_some((opcode, content))
}

/// A record decoded by the crate. `None` for attachments too, on which the crate panics if they end within
/// their checksum.
pub(crate) fn parse(opcode: u8, content: &[u8]) -> Option<Record<'_>> {
    if opcode == op::ATTACHMENT {
        return None;
    }
    mcap::parse_record(opcode, content).ok()
}

/// Header and data of a message record's content.
pub(crate) fn message(content: &[u8]) -> Option<(mcap::records::MessageHeader, &[u8])> {
    match parse(op::MESSAGE, content) {
        Some(Record::Message {
            header,
            data: std::borrow::Cow::Borrowed(data),
        }) => Some((header, data)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chunk record without compression, of one message record that claims `claimed` bytes too many.
    fn chunk_of_message(claimed: u64) -> Vec<u8> {
        let mut records = vec![op::MESSAGE];
        records.extend_from_slice(&(22 + 3 + claimed).to_le_bytes());
        records.extend_from_slice(&[7; 22 + 3]);
        let mut content = vec![0; 16];
        content.extend_from_slice(&(records.len() as u64).to_le_bytes());
        content.extend_from_slice(&crc32fast::hash(&records).to_le_bytes());
        content.extend_from_slice(&[0; 4]);
        content.extend_from_slice(&(records.len() as u64).to_le_bytes());
        content.extend_from_slice(&records);
        let mut record = vec![op::CHUNK];
        record.extend_from_slice(&(content.len() as u64).to_le_bytes());
        record.extend_from_slice(&content);
        record
    }

    #[test]
    fn chunks_without_compression_are_read() {
        let mut chunk = ChunkRecords::new(&chunk_of_message(0)).unwrap();
        let (opcode, content) = chunk.next().unwrap().unwrap();
        assert_eq!((opcode, message(content).unwrap().1), (op::MESSAGE, &[7; 3][..]));
        assert_eq!(chunk.next(), Ok(None));
    }

    #[test]
    fn records_that_reach_beyond_their_chunk_are_damage() {
        for claimed in [1, 30, u64::MAX - 100] {
            let mut chunk = ChunkRecords::new(&chunk_of_message(claimed)).unwrap();
            assert_eq!(chunk.next(), Err(Damaged), "{claimed}");
        }
    }

    #[test]
    fn chunks_of_another_length_or_checksum_are_damage() {
        let good = chunk_of_message(0);
        for at in [1, 25, 37, good.len() - 1] {
            let mut bad = good.clone();
            bad[at] ^= 1;
            let read = ChunkRecords::new(&bad).and_then(|mut chunk| chunk.next().map(|_| ()));
            assert_eq!(read, Err(Damaged), "byte {at}");
        }
        // "Not computed" is not a checksum.
        let mut unchecked = good.clone();
        unchecked[33..37].fill(0);
        assert!(ChunkRecords::new(&unchecked).is_err());
        assert!(ChunkRecords::new(&good[..good.len() - 1]).is_err());
    }

    /// The `mcap` crate panics at the first of them.
    #[test]
    fn attachments_ending_in_their_checksum_are_damage() {
        for length in 0..40 {
            assert!(parse(op::ATTACHMENT, &vec![0; length]).is_none());
        }
    }
}

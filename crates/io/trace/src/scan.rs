//! Searches records in a file that may be truncated or damaged anywhere.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};

use mcap::records::op;

use crate::chunk::RECORD_HEAD;

/// The compression's name in a chunk record, with its length: the mark of a chunk.
const MARK: &[u8] = b"\x04\0\0\0zstd";
/// What is before the compression's name in a chunk record: head, two times, size, checksum.
const BEFORE_COMPRESSION: usize = RECORD_HEAD + 8 + 8 + 8 + 4;
/// The search for the next chunk reads this much at once.
pub(crate) const SEARCH_BYTES: usize = 1 << 20;

/// Reads a file at any position.
pub(crate) struct Scan {
    pub(crate) file: File,
    pub(crate) length: u64,
}

impl Scan {
    pub(crate) fn read(&mut self, offset: u64, length: usize) -> io::Result<Vec<u8>> {
        let mut bytes = vec![0; length];
        self.file.seek(SeekFrom::Start(offset))?;
        self.file.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    /// Opcode and content length of the record at `offset`, if one can be there.
    pub(crate) fn head(&mut self, offset: u64) -> io::Result<Option<(u8, u64)>> {
        if self.length.saturating_sub(offset) < RECORD_HEAD as u64 {
            return Ok(None);
        }
        let bytes = self.read(offset, RECORD_HEAD)?;
        let Some(&[opcode, ref length @ ..]) = bytes.first_chunk::<RECORD_HEAD>() else {
            return Ok(None);
        };
        let length = u64::from_le_bytes(*length);
        let rest = self.length - offset - RECORD_HEAD as u64;
        Ok(((op::HEADER..=op::DATA_END).contains(&opcode) && length <= rest).then_some((opcode, length)))
    }

    /// The next position from `offset` on at which a chunk may start, by the name of its compression.
    pub(crate) fn next_chunk(&mut self, offset: u64) -> io::Result<Option<u64>> {
        let mut from = offset + BEFORE_COMPRESSION as u64;
        while from + MARK.len() as u64 <= self.length {
            let size = usize::try_from(self.length - from)
                .unwrap_or(SEARCH_BYTES)
                .min(SEARCH_BYTES);
            let bytes = self.read(from, size)?;
            for at in (0..=bytes.len() - MARK.len()).filter(|&at| bytes[at..].starts_with(MARK)) {
                let start = from + at as u64 - BEFORE_COMPRESSION as u64;
                if matches!(self.head(start)?, Some((op::CHUNK, _))) {
                    return Ok(Some(start));
                }
            }
            // Overlap by a mark less one byte, in case it is across the border.
            from += (size - MARK.len() + 1) as u64;
        }
        Ok(None)
    }
}

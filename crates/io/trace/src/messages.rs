//! The messages of a trace, chunk by chunk.

use std::collections::VecDeque;

use mcap::records::{ChunkIndex, op};

use crate::batch::MAX_CYCLES;
use crate::chunk::{self, ChunkRecords, MAX_CHUNK_BYTES};
use crate::decode::{Decoded, Decoder, Undecoded};
use crate::read_error::ReadError;
use crate::reader::{Source, TraceMessage};
use crate::record::CycleRecord;
use crate::schema::Channel;

/// Iterates over the messages of a trace, chunk by chunk. Ends after an error.
#[derive(Debug)]
pub struct Messages<'a> {
    source: &'a mut Source,
    /// Those not read yet.
    chunks: std::slice::Iter<'a, ChunkIndex>,
    decoder: &'a Decoder,
    only: Option<u16>,
    /// Chunks outside need not be read.
    span_ns: (u64, u64),
    /// Maximum time by which the cycles of a batch extend beyond the time of its message.
    longest_ns: u64,
    /// The open chunk and its offset in the file, for errors.
    chunk: Option<ChunkRecords>,
    offset: u64,
    /// Unpacked cycles of a batch.
    ready: VecDeque<CycleRecord>,
    failed: bool,
}

impl<'a> Messages<'a> {
    /// Iterates over the messages of all channels, or of one.
    pub(crate) fn new(
        source: &'a mut Source,
        chunks: &'a [ChunkIndex],
        decoder: &'a Decoder,
        only: Option<Channel>,
        period_ns: u64,
    ) -> Self {
        Self {
            source,
            chunks: chunks.iter(),
            only: only.map(|channel| decoder.number_of(channel)),
            decoder,
            span_ns: (0, u64::MAX),
            longest_ns: period_ns.saturating_mul(MAX_CYCLES as u64),
            chunk: None,
            offset: 0,
            ready: VecDeque::new(),
            failed: false,
        }
    }

    /// Restricts the iteration to chunks that may contain cycles from the first time to the last.
    pub(crate) fn between(mut self, first_ns: u64, last_ns: u64) -> Self {
        self.span_ns = (first_ns, last_ns);
        self
    }

    fn matters(&self, index: &ChunkIndex) -> bool {
        self.only
            .is_none_or(|channel| index.message_index_offsets.contains_key(&channel))
            && index.message_start_time <= self.span_ns.1
            && index.message_end_time.saturating_add(self.longest_ns) >= self.span_ns.0
    }

    /// Opens the next relevant chunk. Returns `false` at the end.
    fn open_chunk(&mut self) -> Result<bool, ReadError> {
        let index = loop {
            match self.chunks.next() {
                Some(index) if self.matters(index) => break index,
                Some(_) => {}
                None => return Ok(false),
            }
        };
        self.offset = index.chunk_start_offset;
        if index.chunk_length > MAX_CHUNK_BYTES {
            return Err(self.source.damaged(self.offset, "the position of a chunk"));
        }
        let record = self
            .source
            .read(self.offset, index.chunk_length, "the position of a chunk")?;
        self.chunk = Some(ChunkRecords::new(&record).map_err(|_| self.damaged_chunk())?);
        Ok(true)
    }

    fn damaged_chunk(&self) -> ReadError {
        self.source
            .damaged(self.offset, "a chunk does not match its checksum")
    }

    /// Returns the next message of the requested channels, or `None` at the end.
    fn decode_next(&mut self) -> Result<Option<Decoded>, ReadError> {
        loop {
            let Some(chunk) = &mut self.chunk else {
                if self.open_chunk()? {
                    continue;
                }
                return Ok(None);
            };
            let content = match chunk.next() {
                Ok(Some((op::MESSAGE, content))) => content,
                Ok(Some(_)) => continue,
                Ok(None) => {
                    self.chunk = None;
                    continue;
                }
                Err(_) => return Err(self.damaged_chunk()),
            };
            let Some((header, data)) = chunk::message(content) else {
                return Err(self.source.damaged(self.offset, "a record in a chunk"));
            };
            if self.only.is_some_and(|channel| channel != header.channel_id) {
                continue;
            }
            return match self.decoder.decode(&header, data) {
                Ok(decoded) => Ok(Some(decoded)),
                Err(Undecoded::Damaged) => Err(self.source.damaged(self.offset, "a message")),
                Err(Undecoded::NoAxes) => Err(self.source.no_run()),
            };
        }
    }

    /// Adds the cycles of the next message that has any. Returns `false` at the end.
    pub(crate) fn next_cycles(&mut self, cycles: &mut Vec<CycleRecord>) -> Result<bool, ReadError> {
        cycles.clear();
        while let Some(decoded) = self.decode_next()? {
            match decoded {
                Decoded::One(TraceMessage::Cycle(record)) => cycles.push(record),
                Decoded::One(_) => {}
                Decoded::Batch(batch) => *cycles = batch.into(),
            }
            if !cycles.is_empty() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn step(&mut self) -> Result<Option<TraceMessage>, ReadError> {
        loop {
            if let Some(record) = self.ready.pop_front() {
                return Ok(Some(TraceMessage::Cycle(record)));
            }
            match self.decode_next()? {
                None => return Ok(None),
                Some(Decoded::One(message)) => return Ok(Some(message)),
                Some(Decoded::Batch(cycles)) => self.ready = cycles,
            }
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

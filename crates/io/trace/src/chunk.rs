//! A chunk read back: checked, unpacked, and its records and messages one after another.

use crate::format::{ChunkHead, Fields, ZSTD, op};
use crate::record::{BlockKind, BlockRecord, CycleRecord, EventKind, EventRecord};
use crate::schema::{evolvent, time_ns};

/// A chunk that claims to be larger than this is damaged: the recorder's are a thousandth of it.
pub(crate) const MAX_CHUNK_BYTES: u64 = 256 * 1024 * 1024;

/// Unpacks a chunk into `out` and holds it against its checksum. `None` if anything is wrong with it.
pub(crate) fn unpack(head: &ChunkHead<'_>, out: &mut Vec<u8>) -> Option<()> {
    out.clear();
    if head.uncompressed_size > MAX_CHUNK_BYTES {
        return None;
    }
    let size = usize::try_from(head.uncompressed_size).ok()?;
    match head.compression {
        "" => out.extend_from_slice(head.data),
        ZSTD => {
            out.reserve(size);
            zstd::bulk::Decompressor::new()
                .ok()?
                .decompress_to_buffer(head.data, out)
                .ok()?;
        }
        _ => return None,
    }
    // 0 is "not computed" in the format. This crate always computes it, so 0 is refused unless it is right.
    (out.len() == size && crc32fast::hash(out) == head.uncompressed_crc).then_some(())
}

/// A message as it lies in a chunk.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RawMessage<'a> {
    pub(crate) channel: u16,
    pub(crate) sequence: u32,
    pub(crate) log_time_ns: u64,
    pub(crate) data: &'a [u8],
}

/// A record within a chunk.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Inner<'a> {
    /// Schema or channel: opcode, number, content.
    Declaration(u8, u16, &'a [u8]),
    Message(RawMessage<'a>),
}

/// Reads the record at `offset` of an unpacked chunk: the record, if it is of a kind that matters, and where the
/// next one begins. `None` if there is no whole record.
pub(crate) fn record_at(chunk: &[u8], offset: usize) -> Option<(Option<Inner<'_>>, usize)> {
    let mut fields = Fields(chunk.get(offset..)?);
    let (opcode, content) = fields.record()?;
    let next = chunk.len() - fields.0.len();
    let mut fields = Fields(content);
    let record = match opcode {
        op::SCHEMA | op::CHANNEL => Some(Inner::Declaration(opcode, fields.u16()?, content)),
        op::MESSAGE => {
            let channel = fields.u16()?;
            let sequence = fields.u32()?;
            let log_time_ns = fields.u64()?;
            // The time of publication is the same.
            fields.u64()?;
            Some(Inner::Message(RawMessage {
                channel,
                sequence,
                log_time_ns,
                data: fields.0,
            }))
        }
        _ => None,
    };
    Some((record, next))
}

/// A cycle from its message; `axes` are the indices of the axes that it carries. `None` if it carries others.
pub(crate) fn cycle(message: &evolvent::Cycle, axes: &[usize]) -> Option<CycleRecord> {
    let spread = |values: &[f64]| {
        let mut nine = [0.0; 9];
        (values.len() == axes.len()).then(|| {
            for (&axis, &value) in axes.iter().zip(values) {
                nine[axis] = value;
            }
            nine
        })
    };
    Some(CycleRecord {
        sequence: message.sequence,
        due_time_ns: message.due_time_ns,
        wake_lateness_ns: message.wake_lateness_ns,
        work_ns: message.work_ns,
        path_mm: message.path_mm,
        feed_mm_s: message.feed_mm_s,
        position: spread(&message.position)?,
        velocity: spread(&message.velocity)?,
        acceleration: spread(&message.acceleration)?,
        jerk: spread(&message.jerk)?,
        line: message.line,
        state: u8::try_from(message.state).ok()?,
        flags: message.flags,
        override_: message.r#override,
        load: message.load.unwrap_or(f64::NAN),
        inputs: message.inputs,
        following_error: if message.following_error.is_empty() {
            [f64::NAN; 9]
        } else {
            let measured = spread(&message.following_error)?;
            let mut nine = [f64::NAN; 9];
            axes.iter().for_each(|&axis| nine[axis] = measured[axis]);
            nine
        },
    })
}

/// An event from its message. `None` if its time or kind makes no sense.
pub(crate) fn event(message: evolvent::Event) -> Option<EventRecord> {
    Some(EventRecord {
        time_ns: time_ns(message.timestamp.as_ref())?,
        sequence: message.sequence,
        kind: event_kind(message.kind)?,
        code: message.code,
        text: message.text,
        value: message.value,
    })
}

fn event_kind(number: i32) -> Option<EventKind> {
    let known = EventKind::ALL.into_iter().find(|kind| *kind as i32 == number);
    // Numbers are given in their order: one above all is of a later version.
    known.or((number > EventKind::ALL.len() as i32).then_some(EventKind::Later))
}

/// A block from its message. `None` if its time or kind makes no sense.
pub(crate) fn block(message: evolvent::Block) -> Option<BlockRecord> {
    Some(BlockRecord {
        time_ns: time_ns(message.timestamp.as_ref())?,
        line: message.line,
        text: message.text,
        kind: BlockKind::ALL
            .into_iter()
            .find(|kind| *kind as i32 == message.kind)?,
        length_mm: message.length_mm,
        planned_duration_s: message.planned_duration_s,
        true_duration_s: message.true_duration_s,
        start_sequence: message.start_sequence,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_of_a_later_version_are_read_and_nonsense_is_not() {
        assert_eq!(event_kind(2), Some(EventKind::Alarm));
        assert_eq!(event_kind(14), Some(EventKind::Switched));
        assert_eq!(event_kind(15), Some(EventKind::Later));
        assert_eq!(event_kind(i32::MAX), Some(EventKind::Later));
        assert_eq!(event_kind(0), None);
        assert_eq!(event_kind(-1), None);
    }
}

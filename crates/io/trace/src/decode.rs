//! Messages as records: decoding of a channel's protobuf.

use std::collections::BTreeMap;
use std::collections::VecDeque;

use prost::Message as _;

use crate::batch;
use crate::reader::TraceMessage;
use crate::record::{BlockKind, BlockRecord, CycleRecord, EventKind, EventRecord};
use crate::schema::{Channel, evolvent, time_ns};

/// The content of a message.
#[expect(
    clippy::large_enum_variant,
    reason = "it lives for the moment of being looked at"
)]
pub(crate) enum Decoded {
    One(TraceMessage),
    Batch(VecDeque<CycleRecord>),
}

/// Why a message is not decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Undecoded {
    /// It is not a message of its channel.
    Damaged,
    /// It needs the axes, which the trace does not have.
    NoAxes,
}

/// The channels and axes of a trace.
#[derive(Clone, Debug)]
pub(crate) struct Decoder {
    /// The axes in the cycles, in order. `None` if the description of the run is lost.
    pub(crate) axes: Option<Vec<usize>>,
    pub(crate) topics: BTreeMap<u16, String>,
    /// Whether the cycles are in batches, and `/cycle` is for viewers only.
    pub(crate) batches: bool,
}

impl Decoder {
    /// The number of a channel; if there is none, a number that no channel has.
    pub(crate) fn number_of(&self, channel: Channel) -> u16 {
        self.topics
            .iter()
            .find(|(_, topic)| *topic == channel.topic())
            .map_or(u16::MAX, |(&id, _)| id)
    }

    pub(crate) fn decode(
        &self,
        header: &mcap::records::MessageHeader,
        data: &[u8],
    ) -> Result<Decoded, Undecoded> {
        let topic = self.topics.get(&header.channel_id).map_or("", String::as_str);
        let axes = || self.axes.as_deref().ok_or(Undecoded::NoAxes);
        let damaged = |_| Undecoded::Damaged;
        let decoded = match Channel::of_topic(topic) {
            Some(Channel::Cycles) => {
                let message = evolvent::Cycles::decode(data).map_err(damaged)?;
                let cycles = batch::cycles(&message, axes()?).ok_or(Undecoded::Damaged)?;
                return Ok(Decoded::Batch(cycles.into()));
            }
            Some(Channel::Cycle) if self.batches => return Ok(Decoded::Batch(VecDeque::new())),
            Some(Channel::Cycle) => {
                let message = evolvent::Cycle::decode(data).map_err(damaged)?;
                cycle(&message, axes()?).map(TraceMessage::Cycle)
            }
            Some(Channel::Event) => {
                event(evolvent::Event::decode(data).map_err(damaged)?).map(TraceMessage::Event)
            }
            Some(Channel::Block) => {
                block(evolvent::Block::decode(data).map_err(damaged)?).map(TraceMessage::Block)
            }
            _ => Some(TraceMessage::Other {
                topic: topic.to_owned(),
                log_time_ns: header.log_time,
                sequence: header.sequence,
                data: data.to_vec(),
            }),
        };
        decoded.map(Decoded::One).ok_or(Undecoded::Damaged)
    }
}

/// A cycle from its message; `axes` are the indices of its axes. `None` if it has others.
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
    // NaN on every axis if it is omitted, and never a value for an axis that does not exist.
    let known = |values: &[f64]| {
        let mut nine = [f64::NAN; 9];
        if !values.is_empty() {
            let measured = spread(values)?;
            axes.iter().for_each(|&axis| nine[axis] = measured[axis]);
        }
        Some(nine)
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
        following_error: known(&message.following_error)?,
        drive_position: known(&message.drive_position)?,
    })
}

/// An event from its message. `None` if its time or kind is invalid.
fn event(message: evolvent::Event) -> Option<EventRecord> {
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
    // Numbers are assigned in order: a number above all known ones is of a later version.
    known.or((number > EventKind::ALL.len() as i32).then_some(EventKind::Later))
}

/// A block from its message. `None` if its time or kind is invalid.
fn block(message: evolvent::Block) -> Option<BlockRecord> {
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
    fn later_version_events_are_read_invalid_ones_are_not() {
        assert_eq!(event_kind(2), Some(EventKind::Alarm));
        assert_eq!(event_kind(14), Some(EventKind::Switched));
        assert_eq!(event_kind(16), Some(EventKind::Output));
        assert_eq!(event_kind(17), Some(EventKind::Later));
        assert_eq!(event_kind(i32::MAX), Some(EventKind::Later));
        assert_eq!(event_kind(0), None);
        assert_eq!(event_kind(-1), None);
    }
}

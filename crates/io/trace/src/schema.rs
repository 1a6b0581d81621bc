//! Channels, their numbers, schemas and messages.

use std::collections::BTreeMap;

use crate::container::Container;

/// Messages of `proto/evolvent/v1/trace.proto`.
#[allow(unreachable_pub, clippy::enum_variant_names, reason = "generated code")]
pub(crate) mod evolvent {
    include!("generated/evolvent.v1.rs");
}

/// Messages of `proto/foxglove/foxglove.proto`.
#[allow(unreachable_pub, clippy::enum_variant_names, reason = "generated code")]
pub(crate) mod foxglove {
    include!("generated/foxglove.rs");
}

const EVOLVENT: &[u8] = include_bytes!("generated/evolvent.v1.fds");
const FOXGLOVE: &[u8] = include_bytes!("generated/foxglove.fds");

/// Header of every file.
pub(crate) const PROFILE: &str = "evolvent.v1";
/// Header of every file.
pub(crate) const LIBRARY: &str = concat!("evolvent-trace/", env!("CARGO_PKG_VERSION"));
/// The metadata that describe the run.
pub(crate) const RUN: &str = "evolvent.run";
/// The metadata with the result of the run.
pub(crate) const SUMMARY: &str = "evolvent.summary";
/// The metadata with the result of a recovery.
pub(crate) const RECOVERY: &str = "evolvent.recovery";

/// A channel. Its number, which is also its schema's, never changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub(crate) enum Channel {
    Cycle = 1,
    Event = 2,
    Block = 3,
    Timing = 4,
    ToolPose = 5,
    ToolPath = 6,
    Log = 7,
    Cycles = 8,
}

impl Channel {
    pub(crate) const ALL: [Self; 8] = [
        Self::Cycle,
        Self::Event,
        Self::Block,
        Self::Timing,
        Self::ToolPose,
        Self::ToolPath,
        Self::Log,
        Self::Cycles,
    ];

    pub(crate) const fn id(self) -> u16 {
        self as u16
    }

    pub(crate) const fn topic(self) -> &'static str {
        match self {
            Self::Cycle => "/cycle",
            Self::Event => "/event",
            Self::Block => "/block",
            Self::Timing => "/timing",
            Self::ToolPose => "/tool_pose",
            Self::ToolPath => "/tool_path",
            Self::Log => "/log",
            Self::Cycles => "/cycles",
        }
    }

    pub(crate) fn of_topic(topic: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|channel| channel.topic() == topic)
    }

    pub(crate) const fn message_name(self) -> &'static str {
        match self {
            Self::Cycle => "evolvent.v1.Cycle",
            Self::Event => "evolvent.v1.Event",
            Self::Block => "evolvent.v1.Block",
            Self::Timing => "evolvent.v1.Timing",
            Self::ToolPose => "foxglove.PoseInFrame",
            Self::ToolPath => "foxglove.SceneUpdate",
            Self::Log => "foxglove.Log",
            Self::Cycles => "evolvent.v1.Cycles",
        }
    }

    const fn descriptors(self) -> &'static [u8] {
        match self {
            Self::Cycle | Self::Event | Self::Block | Self::Timing | Self::Cycles => EVOLVENT,
            Self::ToolPose | Self::ToolPath | Self::Log => FOXGLOVE,
        }
    }
}

/// The encoding of schemas and messages, in the format's registry.
const PROTOBUF: &str = "protobuf";

/// Declares all schemas and channels. `axes` are the letters of the axes in the cycles, `/cycle` has every
/// cycle whose number is a multiple of `every`; `columns`: `/cycles` exists.
pub(crate) fn declare_channels(container: &mut Container, axes: &str, every: u64, columns: bool) {
    for channel in Channel::ALL {
        if channel == Channel::Cycles && !columns {
            continue;
        }
        container.schema(
            channel.id(),
            channel.message_name(),
            PROTOBUF,
            channel.descriptors(),
        );
        let metadata = match channel {
            Channel::Cycle => BTreeMap::from([
                ("axes".to_owned(), axes.to_owned()),
                ("every".to_owned(), every.to_string()),
            ]),
            Channel::Cycles => BTreeMap::from([("axes".to_owned(), axes.to_owned())]),
            _ => BTreeMap::new(),
        };
        container.channel(mcap::records::Channel {
            id: channel.id(),
            schema_id: channel.id(),
            topic: channel.topic().to_owned(),
            message_encoding: PROTOBUF.to_owned(),
            metadata,
        });
    }
}

/// Unix time as a protobuf timestamp.
pub(crate) fn timestamp(time_ns: u64) -> prost_types::Timestamp {
    prost_types::Timestamp {
        seconds: (time_ns / 1_000_000_000) as i64,
        nanos: (time_ns % 1_000_000_000) as i32,
    }
}

/// Unix time from a protobuf timestamp; `None` before 1970 or out of range.
pub(crate) fn time_ns(timestamp: Option<&prost_types::Timestamp>) -> Option<u64> {
    let timestamp = timestamp?;
    u64::try_from(timestamp.seconds)
        .ok()?
        .checked_mul(1_000_000_000)?
        .checked_add(u64::try_from(timestamp.nanos).ok()?)
}

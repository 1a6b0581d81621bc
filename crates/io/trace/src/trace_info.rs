//! The contents of a trace, from its summary.

use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::run_info::RunInfo;

/// A channel and its contents.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChannelInfo {
    /// Its topic, such as `/cycle`.
    pub topic: String,
    /// The full name of its messages.
    pub message: String,
    /// Number of messages.
    pub messages: u64,
}

/// The contents of a trace.
#[derive(Clone, Debug, PartialEq)]
pub struct TraceInfo {
    /// The file.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// The run, without the attachments' content; `None` if it was lost or the file is another program's.
    pub run: Option<RunInfo>,
    /// Time of the first message, Unix time in ns.
    pub start_time_ns: u64,
    /// Time of the last message, Unix time in ns.
    pub end_time_ns: u64,
    /// The channels by number.
    pub channels: Vec<ChannelInfo>,
    /// Number of chunks.
    pub chunks: u64,
    /// Bytes of all chunks before compression.
    pub uncompressed_bytes: u64,
    /// Names and sizes of the attachments.
    pub attachments: Vec<(String, u64)>,
    /// Result of the run: `cycles`, `gaps`, `missing_cycles`, `late_cycles`, `alarms`, `wake_lateness_p99_ns`
    /// and so on, and the additions of the runtime. Empty if the run did not end normally.
    pub summary: BTreeMap<String, String>,
    /// Notes of a recovery, or of the recorder when its disk was full. Empty for a run that was recorded to
    /// its end.
    pub recovery: BTreeMap<String, String>,
}

impl TraceInfo {
    /// Time from the first to the last message, and at least from the cycle with which the trace begins to
    /// the last one, s: cycles that are missing at the beginning count.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        let messages_ns = self.end_time_ns.saturating_sub(self.start_time_ns);
        let last = self
            .summary
            .get("last_sequence")
            .and_then(|text| text.parse::<u64>().ok());
        let cycles_ns = match (&self.run, last) {
            (Some(run), Some(last)) => last
                .saturating_sub(run.first_sequence())
                .saturating_mul(run.period_ns),
            _ => 0,
        };
        messages_ns.max(cycles_ns) as f64 * 1e-9
    }

    /// Number of messages of a channel; 0 if there is no such channel.
    #[must_use]
    pub fn messages(&self, topic: &str) -> u64 {
        self.channels
            .iter()
            .filter(|channel| channel.topic == topic)
            .map(|channel| channel.messages)
            .sum()
    }

    /// Number of damaged places that a recovery found before the end; 0 if only the end was truncated.
    #[must_use]
    pub fn damaged_places(&self) -> u64 {
        let places = self.recovery.get("damaged_places");
        places.and_then(|text| text.parse().ok()).unwrap_or(0)
    }

    /// A number of the summary.
    #[must_use]
    pub fn summary_number(&self, key: &str) -> Option<f64> {
        self.summary.get(key)?.parse().ok()
    }
}

//! The server's log: commands, changes of control, alarms.

use std::collections::VecDeque;
use std::time::{SystemTime, UNIX_EPOCH};

use crate::messages::{LogEntry, LogKind};

/// Maximum number of entries.
const MAX_ENTRIES: usize = 500;

/// The newest entries.
#[derive(Debug, Default)]
pub(crate) struct EventLog {
    entries: VecDeque<LogEntry>,
    next: u64,
}

impl EventLog {
    /// All entries, the oldest first.
    pub(crate) fn entries(&self) -> Vec<LogEntry> {
        self.entries.iter().cloned().collect()
    }

    /// Adds an entry of now and returns it; the oldest is dropped where there are too many.
    pub(crate) fn add(
        &mut self,
        kind: LogKind,
        number: Option<u32>,
        text: String,
        cure: Option<String>,
    ) -> LogEntry {
        self.next += 1;
        let at = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |since| since.as_millis() as u64);
        let entry = LogEntry {
            id: self.next,
            at,
            kind,
            number,
            text,
            cure,
        };
        if self.entries.len() == MAX_ENTRIES {
            self.entries.pop_front();
        }
        self.entries.push_back(entry.clone());
        entry
    }
}

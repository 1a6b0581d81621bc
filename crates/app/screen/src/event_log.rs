//! The server's log: commands, changes of control, alarms.

use std::collections::VecDeque;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::messages::{LogEntry, LogFact, LogKind};

/// Maximum number of entries that are neither alarms nor warnings.
const MAX_ENTRIES: usize = 500;
/// Maximum number of alarms and warnings, which are counted separately from other entries.
const MAX_ALARMS: usize = 200;
/// A repeated entry is written again after this time.
const REPEAT: Duration = Duration::from_secs(60);
/// Number of entries searched for a repetition, such as alternating JOG and JOG_STOP of a pad.
const MAX_REPEATED: usize = 8;

/// The newest entries.
#[derive(Debug, Default)]
pub(crate) struct EventLog {
    entries: VecDeque<LogEntry>,
    alarms: VecDeque<LogEntry>,
    next: u64,
    /// Entries that may be repeated, with their times, since the last entry of another kind.
    repeated: VecDeque<(LogFact, Instant)>,
}

impl EventLog {
    /// All entries, in order of arrival.
    pub(crate) fn entries(&self) -> Vec<LogEntry> {
        let mut all: Vec<LogEntry> = self.entries.iter().chain(&self.alarms).cloned().collect();
        all.sort_by_key(|entry| entry.id);
        all
    }

    /// Adds an entry with the present time and returns it. If there are too many, the oldest of its kind is
    /// dropped.
    pub(crate) fn add(
        &mut self,
        kind: LogKind,
        number: Option<u32>,
        text: String,
        cure: Option<String>,
    ) -> LogEntry {
        self.repeated.clear();
        self.push(kind, number, text, None, cure)
    }

    /// The same for an entry of the server itself.
    pub(crate) fn add_fact(
        &mut self,
        kind: LogKind,
        number: Option<u32>,
        fact: LogFact,
        cure: Option<String>,
    ) -> LogEntry {
        self.repeated.clear();
        self.push(kind, number, fact.sentence(), Some(fact), cure)
    }

    /// Adds an entry that may occur many times in a row, such as jogs of a pad; `None` if it is one of the
    /// last entries already.
    pub(crate) fn add_repeated(&mut self, kind: LogKind, fact: LogFact) -> Option<LogEntry> {
        self.repeated.retain(|(_, written)| written.elapsed() < REPEAT);
        if self.repeated.iter().any(|(other, _)| *other == fact) {
            return None;
        }
        if self.repeated.len() == MAX_REPEATED {
            self.repeated.pop_front();
        }
        self.repeated.push_back((fact.clone(), Instant::now()));
        Some(self.push(kind, None, fact.sentence(), Some(fact), None))
    }

    fn push(
        &mut self,
        kind: LogKind,
        number: Option<u32>,
        text: String,
        fact: Option<LogFact>,
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
            fact,
            cure,
        };
        let (list, max_entries) = match kind {
            LogKind::Alarm | LogKind::Warning => (&mut self.alarms, MAX_ALARMS),
            LogKind::Command | LogKind::Message | LogKind::Link => (&mut self.entries, MAX_ENTRIES),
        };
        if list.len() == max_entries {
            list.pop_front();
        }
        list.push_back(entry.clone());
        entry
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accepted(command: &str) -> LogFact {
        LogFact::Accepted {
            command: command.to_owned(),
            page: 1,
        }
    }

    #[test]
    fn an_alarm_outlasts_an_hour_of_jogs_and_commands() {
        let mut log = EventLog::default();
        log.add(LogKind::Alarm, Some(410), "following error".to_owned(), None);
        let mut written = 0;
        for _ in 0..60_000 {
            written += log.add_repeated(LogKind::Command, accepted("JOG")).iter().len();
            written += log
                .add_repeated(LogKind::Command, accepted("JOG_STOP"))
                .iter()
                .len();
        }
        // Once each, and again after a minute on a slow host.
        assert!((2..20).contains(&written), "{written}");
        for i in 0..10_000 {
            log.add(LogKind::Command, None, format!("MDI {i}"), None);
        }
        let entries = log.entries();
        assert_eq!(entries.len(), MAX_ENTRIES + 1);
        assert_eq!(entries[0].number, Some(410));
        assert!(entries.is_sorted_by_key(|entry| entry.id));
    }

    #[test]
    fn a_jog_after_something_else_is_an_entry_again() {
        let mut log = EventLog::default();
        let jog = |log: &mut EventLog| log.add_repeated(LogKind::Command, accepted("JOG")).is_some();
        assert!(jog(&mut log));
        assert!(!jog(&mut log));
        log.add(LogKind::Command, None, "STOP by page 2".to_owned(), None);
        assert!(jog(&mut log));
    }
}

//! Totals of a run: gaps, late cycles, alarms, percentiles.

use std::collections::BTreeMap;

use crate::histogram::Histogram;
use crate::phase::{PhaseRecord, PhaseTally};
use crate::record::{CycleRecord, EventKind, TimingRecord};

/// Bit of `flags` in a cycle: the setpoint was published after its due time. The same on the bus.
pub(crate) const FLAG_LATE: u32 = 1;
/// A second of cycles goes into one `/timing` message.
const TIMING_SPAN_NS: u64 = 1_000_000_000;

/// Counts of a whole run, gathered while recording; goes into the metadata `evolvent.summary`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunStatistics {
    /// Cycles recorded.
    pub cycles: u64,
    /// The first cycle's number.
    pub first_sequence: Option<u64>,
    /// The last cycle's number.
    pub last_sequence: Option<u64>,
    /// Number of gaps: positions at which a number was not its predecessor plus one, or the first one not the
    /// number with which the trace begins.
    pub gaps: u64,
    /// Numbers missing in all gaps.
    pub missing_cycles: u64,
    /// Cycles whose setpoint was published after its due time.
    pub late_cycles: u64,
    /// Events that were alarms.
    pub alarms: u64,
    /// Lateness of the cycles' wake-ups.
    pub lateness: Histogram,
    /// Duration of their work.
    pub work: Histogram,
    /// Phase lock to the drives' clock, once it had settled.
    pub phase: PhaseTally,
    /// The number with which the trace begins; `None` if the description of the run is unknown.
    begins_at: Option<u64>,
}

impl RunStatistics {
    /// Cycles before the first one recorded are missing from this number on.
    pub(crate) fn begin_at(&mut self, sequence: u64) {
        self.begins_at = Some(sequence);
    }

    /// Counts a cycle without its times.
    fn count(&mut self, sequence: u64, flags: u32) {
        let next = match self.last_sequence {
            Some(last) => Some(last.wrapping_add(1)),
            None => self.begins_at,
        };
        if let Some(next) = next.filter(|next| *next != sequence) {
            self.gaps += 1;
            self.missing_cycles = self.missing_cycles.saturating_add(sequence.saturating_sub(next));
        }
        self.first_sequence.get_or_insert(sequence);
        self.last_sequence = Some(sequence);
        self.cycles += 1;
        self.late_cycles += u64::from(flags & FLAG_LATE != 0);
    }

    /// Counts a cycle with its times.
    pub(crate) fn cycle(&mut self, record: &CycleRecord) {
        self.count(record.sequence, record.flags);
        self.lateness.record(record.wake_lateness_ns);
        self.work.record(i64::from(record.work_ns));
    }

    /// Counts an event.
    pub(crate) fn event(&mut self, kind: Option<EventKind>) {
        self.alarms += u64::from(kind == Some(EventKind::Alarm));
    }

    /// Puts all numbers into a metadata map.
    pub(crate) fn to_metadata(&self) -> BTreeMap<String, String> {
        let mut map = BTreeMap::new();
        let mut put = |key: &str, value: i128| map.insert(key.to_owned(), value.to_string());
        put("cycles", self.cycles.into());
        if let (Some(first), Some(last)) = (self.first_sequence, self.last_sequence) {
            put("first_sequence", first.into());
            put("last_sequence", last.into());
        }
        put("gaps", self.gaps.into());
        put("missing_cycles", self.missing_cycles.into());
        put("late_cycles", self.late_cycles.into());
        put("alarms", self.alarms.into());
        for (name, histogram) in [("wake_lateness", &self.lateness), ("work", &self.work)] {
            put(&format!("{name}_min_ns"), histogram.min_ns().into());
            put(&format!("{name}_max_ns"), histogram.max_ns().into());
            for (key, percent) in PERCENTILES {
                put(
                    &format!("{name}_{key}_ns"),
                    histogram.percentile_ns(percent).into(),
                );
            }
        }
        if let Some(phase) = self.phase.figures() {
            map.extend(phase.named().map(|(key, text)| (key.to_owned(), text)));
        }
        map
    }
}

/// The stored percentiles, with their keys.
const PERCENTILES: [(&str, f64); 4] = [("p50", 50.0), ("p90", 90.0), ("p99", 99.0), ("p999", 99.9)];

/// Statistics of the whole run and of the current second.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    run: RunStatistics,
    second: TimingRecord,
}

impl Tally {
    /// Statistics of a trace that begins with this number.
    pub(crate) fn beginning_at(sequence: u64) -> Self {
        let mut tally = Self::default();
        tally.run.begin_at(sequence);
        tally
    }

    /// Counts a cycle; returns the previous second if this cycle starts a new one.
    pub(crate) fn cycle(&mut self, record: &CycleRecord) -> Option<TimingRecord> {
        let elapsed = record.due_time_ns.wrapping_sub(self.second.time_ns);
        let done = if self.second.cycles > 0 && elapsed >= TIMING_SPAN_NS {
            self.end_second()
        } else {
            None
        };
        if self.second.cycles == 0 {
            self.second.time_ns = record.due_time_ns;
            self.second.start_sequence = record.sequence;
        }
        self.second.cycles += 1;
        self.second.late_cycles += u64::from(record.flags & FLAG_LATE != 0);
        self.second.lateness.record(record.wake_lateness_ns);
        self.second.work.record(i64::from(record.work_ns));
        self.run.count(record.sequence, record.flags);
        done
    }

    /// Counts what the phase lock did in the cycle that was counted last.
    pub(crate) fn phase(&mut self, record: &PhaseRecord) {
        self.second.phase.record(record);
        if record.is_settled {
            self.run.phase.record(record);
        }
    }

    /// Counts an event.
    pub(crate) fn event(&mut self, kind: EventKind) {
        self.run.event(Some(kind));
    }

    /// Ends the current second, if it has cycles.
    pub(crate) fn end_second(&mut self) -> Option<TimingRecord> {
        if self.second.cycles == 0 {
            return None;
        }
        self.run.lateness.add(&self.second.lateness);
        self.run.work.add(&self.second.work);
        Some(std::mem::take(&mut self.second))
    }

    /// The run so far; times up to the last full second.
    pub(crate) fn run(&self) -> &RunStatistics {
        &self.run
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycle(sequence: u64, due_time_ns: u64) -> CycleRecord {
        CycleRecord {
            sequence,
            due_time_ns,
            wake_lateness_ns: 20_000,
            work_ns: 400,
            ..CycleRecord::default()
        }
    }

    #[test]
    fn gaps_are_counted_with_what_they_left_out() {
        let mut run = RunStatistics::default();
        for sequence in [7, 8, 9, 12, 13, 20] {
            run.cycle(&cycle(sequence, 0));
        }
        assert_eq!((run.cycles, run.gaps, run.missing_cycles), (6, 2, 2 + 6));
        assert_eq!((run.first_sequence, run.last_sequence), (Some(7), Some(20)));
    }

    #[test]
    fn cycles_before_the_first_one_are_a_gap() {
        for (begin, first, gaps, missing) in [(0, 0, 0, 0), (0, 7, 1, 7), (7, 7, 0, 0), (5, 7, 1, 2)] {
            let mut run = RunStatistics::default();
            run.begin_at(begin);
            run.cycle(&cycle(first, 0));
            run.cycle(&cycle(first + 1, 0));
            assert_eq!(
                (run.gaps, run.missing_cycles),
                (gaps, missing),
                "{begin}, {first}"
            );
            assert_eq!(run.first_sequence, Some(first));
        }
    }

    #[test]
    fn each_second_holds_its_own_cycles() {
        let mut tally = Tally::default();
        let mut seconds = Vec::new();
        for sequence in 0..2500 {
            seconds.extend(tally.cycle(&cycle(sequence, 5_000_000_000 + sequence * 1_000_000)));
        }
        seconds.extend(tally.end_second());
        let found: Vec<_> = seconds
            .iter()
            .map(|second| (second.start_sequence, second.cycles))
            .collect();
        assert_eq!(found, [(0, 1000), (1000, 1000), (2000, 500)]);
        assert_eq!(tally.run().lateness.count(), 2500);
    }
}

//! Selection of a part of a trace.

use std::ops::RangeInclusive;

use evolvent_trace::CycleRecord;

/// A channel of a trace that can be written as a table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExportChannel {
    /// Every cycle.
    #[default]
    Cycles,
    /// Events.
    Events,
    /// Executed blocks.
    Blocks,
}

/// A part of a run, by time and by program lines; both have to match.
#[derive(Clone, Debug, PartialEq)]
pub struct Selection {
    /// Seconds since the start of the run, both included.
    pub time_s: RangeInclusive<f64>,
    /// Lines of the program, both included.
    pub lines: RangeInclusive<u32>,
}

impl Default for Selection {
    /// Everything.
    fn default() -> Self {
        Self {
            time_s: f64::NEG_INFINITY..=f64::INFINITY,
            lines: 0..=u32::MAX,
        }
    }
}

impl Selection {
    /// The times in Unix ns, for a run with this start time.
    #[must_use]
    pub fn span_ns(&self, start_time_ns: u64) -> (u64, u64) {
        let at = |seconds: f64| {
            if seconds == f64::INFINITY {
                u64::MAX
            } else {
                // A negative time is before the start; half a nanosecond is negligible.
                start_time_ns.saturating_add((seconds.max(0.0) * 1e9).round() as u64)
            }
        };
        (at(*self.time_s.start()), at(*self.time_s.end()))
    }

    /// Whether a line is selected.
    #[must_use]
    pub fn has_line(&self, line: u32) -> bool {
        self.lines.contains(&line)
    }

    /// Whether a cycle is selected.
    #[must_use]
    pub fn has(&self, record: &CycleRecord, start_time_ns: u64) -> bool {
        let (first, last) = self.span_ns(start_time_ns);
        (first..=last).contains(&record.due_time_ns) && self.has_line(record.line)
    }
}

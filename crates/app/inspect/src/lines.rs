//! Time by program line, and the limits that were active.

use std::collections::BTreeMap;

use evolvent_analysis::{LimitClassifier, Limiting};
use evolvent_machine::Machine;
use evolvent_motion::{MotionState, Setpoint};
use evolvent_path::Axes;
use evolvent_trace::CycleRecord;

const STATE_RUNNING: u8 = 1;
const STATES_HELD: [u8; 2] = [2, 3];

/// One line of the program over the run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineTime {
    /// Time in it, s.
    pub time_s: f64,
    /// Time of it at a limit of the machine, s.
    pub limited_s: f64,
    /// Time of it held by the operator, s.
    pub held_s: f64,
    /// Path in it, mm.
    pub path_mm: f64,
    /// Maximum speed in it, mm/s.
    pub max_feed_mm_s: f64,
    /// Sum of the override over its cycles, for the mean.
    override_sum: f64,
    cycles: u64,
    /// The first cycle.
    pub start_sequence: u64,
    /// Time by active limit, s.
    pub by_limit: BTreeMap<Limiting, f64>,
}

impl LineTime {
    /// Mean speed, mm/s.
    #[must_use]
    pub fn mean_feed_mm_s(&self) -> f64 {
        if self.time_s > 0.0 {
            self.path_mm / self.time_s
        } else {
            0.0
        }
    }

    /// Mean feed override, 1 at 100 %.
    #[must_use]
    pub fn mean_override(&self) -> f64 {
        if self.cycles > 0 {
            self.override_sum / self.cycles as f64
        } else {
            1.0
        }
    }

    /// The limit that was active longest.
    #[must_use]
    pub fn main_limit(&self) -> Option<Limiting> {
        self.longest(|_| true)
    }

    /// The limit of the machine that was active longest; `None` if none was.
    #[must_use]
    pub fn main_machine_limit(&self) -> Option<Limiting> {
        self.longest(is_of_machine)
    }

    fn longest(&self, counts: impl Fn(Limiting) -> bool) -> Option<Limiting> {
        let limits = self.by_limit.iter().filter(|(limit, _)| counts(**limit));
        limits.max_by(|a, b| a.1.total_cmp(b.1)).map(|(limit, _)| *limit)
    }
}

/// Whether the limit is one of the machine, not of the program.
const fn is_of_machine(limit: Limiting) -> bool {
    matches!(limit, Limiting::Axis(..) | Limiting::ChordError | Limiting::Joint)
}

/// Sums up a run line by line.
#[derive(Clone, Debug)]
pub struct LineTimes {
    classifier: LimitClassifier,
    period_s: f64,
    last_path_mm: f64,
    lines: BTreeMap<u32, LineTime>,
    by_limit: BTreeMap<Limiting, f64>,
}

impl LineTimes {
    /// Nothing yet.
    #[must_use]
    pub fn new(machine: &Machine, period_ns: u64) -> Self {
        let period_s = period_ns as f64 * 1e-9;
        Self {
            classifier: LimitClassifier::new(machine, period_s),
            period_s,
            last_path_mm: 0.0,
            lines: BTreeMap::new(),
            by_limit: BTreeMap::new(),
        }
    }

    /// The path driven before the first cycle, mm, which belongs to no line.
    pub(crate) fn begin_at(&mut self, path_mm: f64) {
        self.last_path_mm = path_mm;
    }

    /// The active limit of this cycle. Traces have no feed words, so the feed is assumed if no other limit is
    /// reached.
    #[must_use]
    pub fn limit_of(&self, record: &CycleRecord) -> Limiting {
        let setpoint = Setpoint {
            sequence: record.sequence,
            position: Axes::from(record.position),
            velocity: Axes::from(record.velocity),
            acceleration: Axes::from(record.acceleration),
            jerk: Axes::from(record.jerk),
            path_mm: record.path_mm,
            feed_mm_s: record.feed_mm_s,
            feed_override: record.override_,
            line: record.line,
            block: 0,
            // Axes at rest in a dwell or a hold have no velocity either.
            state: MotionState::Running,
            flags: record.flags,
            actions: 0,
        };
        match self.classifier.classify(&setpoint, None) {
            Limiting::Nothing => Limiting::Feed,
            limit => limit,
        }
    }

    /// Evaluates the next cycle.
    pub fn cycle(&mut self, record: &CycleRecord) {
        let limit = self.limit_of(record);
        *self.by_limit.entry(limit).or_default() += self.period_s;
        let line = self.lines.entry(record.line).or_default();
        if line.cycles == 0 {
            line.start_sequence = record.sequence;
        }
        line.cycles += 1;
        line.time_s += self.period_s;
        if is_of_machine(limit) && record.state == STATE_RUNNING {
            line.limited_s += self.period_s;
        }
        if STATES_HELD.contains(&record.state) {
            line.held_s += self.period_s;
        }
        line.path_mm += (record.path_mm - self.last_path_mm).max(0.0);
        self.last_path_mm = record.path_mm;
        line.max_feed_mm_s = line.max_feed_mm_s.max(record.feed_mm_s);
        line.override_sum += record.override_;
        *line.by_limit.entry(limit).or_default() += self.period_s;
    }

    /// All lines in which time was spent.
    #[must_use]
    pub fn lines(&self) -> &BTreeMap<u32, LineTime> {
        &self.lines
    }

    /// Time of the whole run by active limit, s.
    #[must_use]
    pub fn by_limit(&self) -> &BTreeMap<Limiting, f64> {
        &self.by_limit
    }

    /// Lines by a measure, the largest first, at most `count`; those with 0 are omitted.
    #[must_use]
    pub fn top(&self, count: usize, measure: impl Fn(&LineTime) -> f64) -> Vec<(u32, &LineTime)> {
        let mut list: Vec<_> = self
            .lines
            .iter()
            .filter(|(_, time)| measure(time) > 0.0)
            .map(|(line, time)| (*line, time))
            .collect();
        list.sort_by(|a, b| measure(b.1).total_cmp(&measure(a.1)));
        list.truncate(count);
        list
    }
}

//! Time by program line, and what limited it.

use std::collections::BTreeMap;

use evolvent_machine::{Limits, Machine};
use evolvent_path::AxisLetter;
use evolvent_trace::CycleRecord;

/// Fraction of a limit above which it counts as active.
const REACHED: f64 = 0.97;
const STATE_RUNNING: u8 = 1;
const STATES_HELD: [u8; 2] = [2, 3];

/// The active limit of a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Limit {
    /// The feed word and override, or nothing that is recorded.
    Feed,
    /// An axis by its index: velocity (0), acceleration (1) or jerk (2).
    Axis(u8, u8),
    /// The axes are at rest: dwell, stop, hold.
    Standing,
}

impl Limit {
    /// In words.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Feed => "feed word".to_owned(),
            Self::Axis(axis, order) => {
                let letter = AxisLetter::ALL
                    .get(usize::from(axis))
                    .map_or('?', |axis| axis.letter());
                let order = ["velocity", "acceleration", "jerk"]
                    .get(usize::from(order))
                    .unwrap_or(&"?");
                format!("{letter} {order}")
            }
            Self::Standing => "standing still".to_owned(),
        }
    }
}

/// One line of the program over the run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineTime {
    /// Time in it, s.
    pub time_s: f64,
    /// Time of it in which an axis was at a limit, s.
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
    pub by_limit: BTreeMap<Limit, f64>,
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
    pub fn main_limit(&self) -> Option<Limit> {
        let longest = self.by_limit.iter().max_by(|a, b| a.1.total_cmp(b.1));
        longest.map(|(limit, _)| *limit)
    }

    /// The limit of an axis that was active longest; `None` if none was.
    #[must_use]
    pub fn main_axis_limit(&self) -> Option<Limit> {
        let axes = self
            .by_limit
            .iter()
            .filter(|(limit, _)| matches!(limit, Limit::Axis(..)));
        let longest = axes.max_by(|a, b| a.1.total_cmp(b.1));
        longest.map(|(limit, _)| *limit)
    }
}

/// Adds up a run line by line.
#[derive(Clone, Debug)]
pub struct LineTimes {
    limits: Limits,
    period_s: f64,
    last_path_mm: f64,
    lines: BTreeMap<u32, LineTime>,
    by_limit: BTreeMap<Limit, f64>,
}

impl LineTimes {
    /// Nothing yet.
    #[must_use]
    pub fn new(machine: &Machine, period_ns: u64) -> Self {
        Self {
            limits: machine.limits(),
            period_s: period_ns as f64 * 1e-9,
            last_path_mm: 0.0,
            lines: BTreeMap::new(),
            by_limit: BTreeMap::new(),
        }
    }

    /// Path travelled before the first cycle belongs to no line, mm.
    pub(crate) fn begin_at(&mut self, path_mm: f64) {
        self.last_path_mm = path_mm;
    }

    /// The active limit of this cycle.
    #[must_use]
    pub fn limit_of(&self, record: &CycleRecord) -> Limit {
        if record.feed_mm_s == 0.0 && record.velocity.iter().all(|&velocity| velocity == 0.0) {
            return Limit::Standing;
        }
        let mut worst = (REACHED, Limit::Feed);
        for axis in (0..9).filter(|&axis| self.limits.present[axis]) {
            let shares = [
                record.velocity[axis] / self.limits.velocity[axis],
                record.acceleration[axis] / self.limits.acceleration[axis],
                record.jerk[axis] / self.limits.jerk[axis],
            ];
            for (order, share) in shares.into_iter().enumerate() {
                if share.abs() >= worst.0 {
                    worst = (share.abs(), Limit::Axis(axis as u8, order as u8));
                }
            }
        }
        worst.1
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
        if matches!(limit, Limit::Axis(..)) && record.state == STATE_RUNNING {
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
    pub fn by_limit(&self) -> &BTreeMap<Limit, f64> {
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

//! Evaluation of the setpoints of one program line: speeds, duration, causes, and the positions where it is
//! slow.

use evolvent_machine::Machine;
use evolvent_motion::{Setpoint, flags};
use serde::Serialize;

use crate::limiting::{LimitClassifier, LimitRatios, Limiting, Order, bend};

/// The speed counts as risen again above this factor of the minimum.
const RISEN: f64 = 1.01;
/// Number of setpoints around the minimum that are searched for the nearest limit: at the change from
/// deceleration to acceleration, no value is at its limit for an instant.
const AROUND: usize = 4;
/// A minimum within this fraction of the line's length from an end belongs to the joint there. A minimum
/// within a rounded corner, half of which belongs to this line, always belongs to the nearer end.
const NEAR: f64 = 0.1;
/// Maximum number of minima stored per pass; further ones only repeat the pattern.
const VALLEYS: usize = 64;
/// A position slower than this fraction of the feed word is reported.
const SLOW: f64 = 0.97;

/// Position within the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Where {
    Start,
    Within,
    End,
}

/// A limit and its utilization.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Used {
    /// The limiting quantity.
    pub(crate) limit: String,
    /// Utilization, 1 at the limit.
    pub(crate) share: f64,
    /// The limit's value and unit.
    pub(crate) value: f64,
    pub(crate) unit: &'static str,
    #[serde(skip)]
    pub(crate) cause: Limiting,
}

/// A position where the line is slow.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct SlowPoint {
    #[serde(rename = "where")]
    pub(crate) at: Where,
    pub(crate) time_s: f64,
    /// Positions of the machine's axes in order.
    pub(crate) position: Vec<f64>,
    pub(crate) feed_mm_min: f64,
    /// Radius of curvature; `None` on straight paths and at rest.
    pub(crate) radius_mm: Option<f64>,
    /// The limits with the highest utilization around the position, in descending order.
    pub(crate) used: Vec<Used>,
}

/// The evaluation of a line.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct LineTiming {
    pub(crate) time_s: f64,
    pub(crate) share_of_program: f64,
    /// Number of passes of the line.
    pub(crate) passes: u64,
    pub(crate) least_feed_mm_min: f64,
    pub(crate) mean_feed_mm_min: f64,
    pub(crate) most_feed_mm_min: f64,
    /// Fraction of the line's duration limited by each cause, in descending order.
    pub(crate) limited_by: Vec<(String, f64)>,
    #[serde(skip)]
    pub(crate) causes: Vec<(Limiting, f64)>,
    pub(crate) places: Vec<SlowPoint>,
}

/// The part of a setpoint that is needed later.
#[derive(Clone, Copy, Debug)]
struct Glimpse {
    setpoint: Setpoint,
    ratios: LimitRatios,
    word: Option<f64>,
}

/// Evaluates one line while the program is planned.
pub(crate) struct Watch {
    line: u32,
    machine: Machine,
    classifier: LimitClassifier,
    period_s: f64,
    all: u64,
    count: u64,
    passes: u64,
    feed: (f64, f64, f64),
    causes: [u64; Limiting::COUNT],
    last_sequence: Option<u64>,
    /// The last setpoints of the line, oldest first.
    recent: Vec<Glimpse>,
    falling: bool,
    lowest: Option<Valley>,
    /// Path length at which the pass began, mm.
    began_mm: f64,
    /// Speed minima of the current pass.
    valleys: Vec<Valley>,
    /// The slowest minimum of each kind.
    found: Vec<Valley>,
}

/// A speed minimum with its surroundings.
#[derive(Clone, Debug)]
struct Valley {
    at: Where,
    slowest: Glimpse,
    around: LimitRatios,
    missing: usize,
}

impl Valley {
    fn new(at: Where, slowest: Glimpse, around: &[Glimpse]) -> Self {
        let mut valley = Self {
            at,
            slowest,
            around: slowest.ratios,
            missing: AROUND,
        };
        for glimpse in around {
            valley.add(&glimpse.ratios);
        }
        valley.missing = AROUND;
        valley
    }

    fn add(&mut self, ratios: &LimitRatios) {
        self.missing = self.missing.saturating_sub(1);
        self.around.feed_ratio = self.around.feed_ratio.max(ratios.feed_ratio);
        self.around.chord_ratio = self.around.chord_ratio.max(ratios.chord_ratio);
        for (mine, theirs) in self.around.axes.iter_mut().zip(&ratios.axes) {
            for (mine, theirs) in mine.iter_mut().zip(theirs) {
                *mine = mine.max(*theirs);
            }
        }
    }
}

impl Watch {
    pub(crate) fn new(line: u32, machine: &Machine, period_s: f64) -> Self {
        Self {
            line,
            machine: machine.clone(),
            classifier: LimitClassifier::new(machine, period_s),
            period_s,
            all: 0,
            count: 0,
            passes: 0,
            feed: (f64::INFINITY, 0.0, 0.0),
            causes: [0; Limiting::COUNT],
            last_sequence: None,
            recent: Vec::with_capacity(AROUND + 1),
            falling: false,
            lowest: None,
            began_mm: 0.0,
            valleys: Vec::new(),
            found: Vec::new(),
        }
    }

    /// Takes every setpoint of the run with the feed word of its block.
    pub(crate) fn see(&mut self, setpoint: &Setpoint, word: Option<f64>) {
        self.all += 1;
        if setpoint.line != self.line {
            if self.last_sequence.take().is_some() {
                self.leave();
            }
            return;
        }
        let ratios = self.classifier.ratios(setpoint, word);
        let cause = self.classifier.judge(setpoint, &ratios);
        let glimpse = Glimpse {
            setpoint: *setpoint,
            ratios,
            word,
        };
        self.causes[cause.index()] += 1;
        self.count += 1;
        let feed = setpoint.feed_mm_s;
        self.feed = (self.feed.0.min(feed), self.feed.1 + feed, self.feed.2.max(feed));
        for valley in self.valleys.iter_mut().chain(&mut self.lowest) {
            if valley.missing > 0 {
                valley.add(&ratios);
            }
        }
        if self.last_sequence.is_none() {
            self.passes += 1;
            self.began_mm = setpoint.path_mm;
            self.recent.clear();
            self.falling = true;
            self.lowest = Some(Valley::new(Where::Start, glimpse, &[]));
        } else if let Some(valley) = &mut self.lowest
            && feed <= valley.slowest.setpoint.feed_mm_s
        {
            *valley = Valley::new(Where::Within, glimpse, &self.recent);
            self.falling = true;
        } else if self.falling
            && self
                .lowest
                .as_ref()
                .is_some_and(|valley| feed > RISEN * valley.slowest.setpoint.feed_mm_s)
        {
            // The speed has risen again: the minimum is complete. The next one begins when the speed falls.
            self.keep_lowest();
            self.falling = false;
        }
        if !self.falling
            && let Some(before) = self.recent.last()
            && feed < before.setpoint.feed_mm_s
        {
            self.lowest = Some(Valley::new(Where::Within, glimpse, &self.recent));
            self.falling = true;
        }
        self.last_sequence = Some(setpoint.sequence);
        if self.recent.len() == AROUND {
            self.recent.remove(0);
        }
        self.recent.push(glimpse);
    }

    /// The line has ended: the positions of its minima are now known.
    fn leave(&mut self) {
        if self.falling {
            self.keep_lowest();
        }
        self.falling = false;
        self.lowest = None;
        let last = self.recent.last().map(|glimpse| glimpse.setpoint);
        let ended_mm = last.map_or(self.began_mm, |last| last.path_mm);
        for mut valley in std::mem::take(&mut self.valleys) {
            let setpoint = &valley.slowest.setpoint;
            let fraction = (setpoint.path_mm - self.began_mm) / (ended_mm - self.began_mm).max(1e-12);
            let near = if setpoint.flags & flags::BLEND == 0 {
                NEAR
            } else {
                0.5
            };
            if valley.at == Where::Within && fraction <= near {
                valley.at = Where::Start;
            } else if valley.at == Where::Within && fraction >= 1.0 - near {
                valley.at = Where::End;
            }
            self.take_in(valley);
        }
    }

    fn keep_lowest(&mut self) {
        if self.valleys.len() < VALLEYS {
            self.valleys.extend(self.lowest.take());
        }
    }

    /// Keeps the slowest position of each kind.
    fn take_in(&mut self, valley: Valley) {
        let speed = |valley: &Valley| valley.slowest.setpoint.feed_mm_s;
        if valley
            .slowest
            .word
            .is_some_and(|word| speed(&valley) >= SLOW * word * valley.slowest.setpoint.feed_override)
        {
            return;
        }
        match self.found.iter_mut().find(|known| known.at == valley.at) {
            Some(known) if speed(known) <= speed(&valley) => {}
            Some(known) => *known = valley,
            None => self.found.push(valley),
        }
    }

    /// Whether the line has no setpoints.
    pub(crate) fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The evaluation.
    pub(crate) fn finish(mut self) -> LineTiming {
        if self.last_sequence.take().is_some() {
            self.leave();
        }
        if self.count == 0 {
            return LineTiming::default();
        }
        let mut causes: Vec<(Limiting, f64)> = self
            .causes
            .iter()
            .enumerate()
            .filter(|(_, count)| **count > 0)
            .map(|(index, count)| (Limiting::of_index(index), *count as f64 / self.count as f64))
            .collect();
        causes.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut places: Vec<SlowPoint> = self.found.iter().map(|valley| self.slow_point(valley)).collect();
        places.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        LineTiming {
            time_s: self.count as f64 * self.period_s,
            share_of_program: self.count as f64 / self.all as f64,
            passes: self.passes,
            least_feed_mm_min: 60.0 * self.feed.0,
            mean_feed_mm_min: 60.0 * self.feed.1 / self.count as f64,
            most_feed_mm_min: 60.0 * self.feed.2,
            limited_by: causes
                .iter()
                .map(|(cause, fraction)| (cause.name(), *fraction))
                .collect(),
            causes,
            places,
        }
    }

    fn slow_point(&self, valley: &Valley) -> SlowPoint {
        let setpoint = &valley.slowest.setpoint;
        let (speed, curvature) = bend(setpoint);
        // Below a thousandth of the axes' speed, the curvature is a rounding error.
        let fastest = self
            .machine
            .axes
            .iter()
            .map(|axis| axis.max_velocity)
            .fold(0.0, f64::max);
        let radius = 1.0 / curvature;
        SlowPoint {
            at: valley.at,
            time_s: (setpoint.sequence + 1) as f64 * self.period_s,
            position: self
                .machine
                .axes
                .iter()
                .map(|axis| setpoint.position[axis.letter.index()])
                .collect(),
            feed_mm_min: 60.0 * setpoint.feed_mm_s,
            radius_mm: (speed > 1e-4 * fastest && radius.is_finite() && radius < 1e5).then_some(radius),
            used: self.used(&valley.around),
        }
    }

    /// Limits with a utilization of at least one half, in descending order.
    fn used(&self, ratios: &LimitRatios) -> Vec<Used> {
        let mut used = Vec::new();
        for axis in &self.machine.axes {
            let limits = [axis.max_velocity, axis.max_acceleration, axis.max_jerk];
            for (n, order) in Order::ALL.into_iter().enumerate() {
                let cause = Limiting::Axis(axis.letter, order);
                used.push(Used {
                    limit: cause.name(),
                    share: ratios.axes[axis.letter.index()][n],
                    value: limits[n],
                    unit: order.unit(axis.letter),
                    cause,
                });
            }
        }
        used.push(Used {
            limit: Limiting::ChordError.name(),
            // Relative to the permitted error; the planner aims at less.
            share: ratios.chord_ratio * ratios.chord_ratio * self.machine.path.planner.chord_fraction(),
            value: 1e3 * self.machine.path.chord_error_increments / self.machine.increments_per_mm,
            unit: "um",
            cause: Limiting::ChordError,
        });
        used.retain(|used| used.share >= 0.5);
        used.sort_by(|a, b| b.share.total_cmp(&a.share));
        used.truncate(4);
        used
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limiting::tests::{mill, moving};

    /// Feeds of the setpoints of line 5, between two others.
    fn seen(feeds: &[f64], word: f64) -> LineTiming {
        let mut watch = Watch::new(5, &mill(), 0.001);
        let mut sequence = 0;
        let mut see = |line: u32, feed: f64| {
            let mut setpoint = moving([feed, 0.0, 0.0], [0.0; 3], [0.0; 3]);
            setpoint.line = line;
            setpoint.sequence = sequence;
            setpoint.position[0] = sequence as f64;
            setpoint.path_mm = sequence as f64;
            watch.see(&setpoint, Some(word));
            sequence += 1;
        };
        see(4, 7.0);
        for &feed in feeds {
            see(5, feed);
        }
        see(6, 7.0);
        watch.finish()
    }

    #[test]
    fn speeds_and_time_are_those_of_the_line_alone() {
        let seen = seen(&[10.0, 20.0, 30.0], 30.0);
        assert_eq!(seen.time_s, 0.003);
        assert_eq!(seen.share_of_program, 0.6);
        assert!((seen.least_feed_mm_min - 600.0).abs() < 1e-9);
        assert!((seen.mean_feed_mm_min - 1200.0).abs() < 1e-9);
        assert!((seen.most_feed_mm_min - 1800.0).abs() < 1e-9);
        assert_eq!(seen.limited_by[0], ("none reached".to_owned(), 2.0 / 3.0));
    }

    #[test]
    fn slow_points_are_start_end_and_deepest_dip_between() {
        let feeds = [5.0, 50.0, 100.0, 60.0, 100.0, 40.0, 40.0, 90.0, 100.0, 30.0, 2.0];
        let seen = seen(&feeds, 100.0);
        let found: Vec<(Where, f64, f64)> = seen
            .places
            .iter()
            .map(|place| (place.at, place.position[0], (place.feed_mm_min / 60.0).round()))
            .collect();
        // Position is the index in the run, one later than in `feeds`.
        assert_eq!(
            found,
            [
                (Where::Start, 1.0, 5.0),
                (Where::Within, 7.0, 40.0),
                (Where::End, 11.0, 2.0)
            ]
        );
    }

    #[test]
    fn a_valley_in_a_rounded_corner_belongs_to_the_joint() {
        let at = |valley: u64, flags: u32| {
            let mut watch = Watch::new(5, &mill(), 0.001);
            for sequence in 0..100 {
                let feed = if sequence == valley { 40.0 } else { 100.0 };
                let mut setpoint = moving([feed, 0.0, 0.0], [0.0; 3], [0.0; 3]);
                (setpoint.line, setpoint.sequence, setpoint.path_mm) = (5, sequence, sequence as f64);
                setpoint.flags = flags;
                watch.see(&setpoint, Some(100.0));
            }
            watch
                .finish()
                .places
                .iter()
                .map(|place| place.at)
                .collect::<Vec<_>>()
        };
        assert_eq!(at(5, 0), [Where::Start]);
        assert_eq!(at(30, 0), [Where::Within]);
        assert_eq!(at(95, 0), [Where::End]);
        assert_eq!(at(30, flags::BLEND), [Where::Start]);
        assert_eq!(at(70, flags::BLEND), [Where::End]);
    }

    #[test]
    fn a_line_at_its_feed_has_no_slow_place() {
        assert!(seen(&[100.0; 20], 100.0).places.is_empty());
        assert!(seen(&[98.0, 97.5, 98.0, 99.0], 100.0).places.is_empty());
    }

    #[test]
    fn each_pass_of_a_line_counts() {
        let mut watch = Watch::new(5, &mill(), 0.001);
        for (sequence, line) in [5, 5, 6, 6, 5, 6, 5].into_iter().enumerate() {
            let mut setpoint = moving([10.0, 0.0, 0.0], [0.0; 3], [0.0; 3]);
            (setpoint.line, setpoint.sequence) = (line, sequence as u64);
            watch.see(&setpoint, None);
        }
        let seen = watch.finish();
        assert_eq!((seen.passes, seen.time_s), (3, 0.004));
    }
}

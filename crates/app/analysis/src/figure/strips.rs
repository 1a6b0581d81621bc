//! Time series in buckets of equal duration that keep the extremes of their setpoints.
//!
//! When all buckets are full, pairs of neighbours are merged: memory does not grow with the duration, and
//! every peak is kept.

use evolvent_machine::Machine;
use evolvent_motion::{Setpoint, flags};

use crate::limiting::Limiting;

/// Buckets over time: one to two per pixel of the picture.
pub(crate) const BUCKETS: usize = 1024;

/// Lowest and highest value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Range {
    pub(crate) low: f64,
    pub(crate) high: f64,
}

impl Range {
    const NONE: Self = Self {
        low: f64::INFINITY,
        high: f64::NEG_INFINITY,
    };

    fn see(&mut self, value: f64) {
        self.low = self.low.min(value);
        self.high = self.high.max(value);
    }

    fn join(&mut self, other: Self) {
        self.low = self.low.min(other.low);
        self.high = self.high.max(other.high);
    }

    /// Whether the range has a value.
    pub(crate) fn is_some(self) -> bool {
        self.low <= self.high
    }

    /// Largest magnitude.
    pub(crate) fn magnitude(self) -> f64 {
        if self.is_some() {
            self.low.abs().max(self.high.abs())
        } else {
            0.0
        }
    }
}

/// Extremes over the setpoints of a bucket.
#[derive(Clone, Debug)]
pub(crate) struct Bucket {
    /// Path speed except on rapids, mm/s.
    pub(crate) feed: Range,
    /// Path speed on rapids, mm/s.
    pub(crate) rapid: Range,
    /// Active feed words, mm/s.
    pub(crate) word: Range,
    /// Velocity, acceleration and jerk of each axis of the machine.
    pub(crate) axes: Vec<[Range; 3]>,
    /// Setpoints limited by each cause.
    pub(crate) causes: [u32; Limiting::COUNT],
}

impl Bucket {
    fn new(axes: usize) -> Self {
        Self {
            feed: Range::NONE,
            rapid: Range::NONE,
            word: Range::NONE,
            axes: vec![[Range::NONE; 3]; axes],
            causes: [0; Limiting::COUNT],
        }
    }

    fn join(&mut self, other: &Self) {
        self.feed.join(other.feed);
        self.rapid.join(other.rapid);
        self.word.join(other.word);
        for (mine, theirs) in self.axes.iter_mut().zip(&other.axes) {
            for (mine, theirs) in mine.iter_mut().zip(theirs) {
                mine.join(*theirs);
            }
        }
        for (mine, theirs) in self.causes.iter_mut().zip(&other.causes) {
            *mine = mine.saturating_add(*theirs);
        }
    }

    /// Number of setpoints in the bucket.
    pub(crate) fn count(&self) -> u32 {
        self.causes
            .iter()
            .fold(0, |sum, count| sum.saturating_add(*count))
    }
}

/// Gathers buckets.
#[derive(Debug)]
pub(crate) struct Strips {
    axes: Vec<usize>,
    buckets: Vec<Bucket>,
    /// Setpoints per bucket, and in the last one.
    width: u64,
    filled: u64,
    period_s: f64,
    /// Total number of setpoints, and of those limited by each cause.
    total: u64,
    causes: [u64; Limiting::COUNT],
}

impl Strips {
    pub(crate) fn new(machine: &Machine, period_s: f64) -> Self {
        Self {
            axes: machine.axes.iter().map(|axis| axis.letter.index()).collect(),
            buckets: Vec::with_capacity(BUCKETS),
            width: 1,
            filled: 0,
            period_s,
            total: 0,
            causes: [0; Limiting::COUNT],
        }
    }

    pub(crate) fn see(&mut self, setpoint: &Setpoint, word: Option<f64>, cause: Limiting) {
        if self.buckets.is_empty() || self.filled == self.width {
            if self.buckets.len() == BUCKETS {
                self.join_neighbours();
            }
            // After merging, the last bucket may be only half full.
            if self.buckets.is_empty() || self.filled == self.width {
                self.buckets.push(Bucket::new(self.axes.len()));
                self.filled = 0;
            }
        }
        self.filled += 1;
        self.total += 1;
        self.causes[cause.index()] += 1;
        let Some(bucket) = self.buckets.last_mut() else {
            return;
        };
        if setpoint.flags & flags::RAPID == 0 {
            bucket.feed.see(setpoint.feed_mm_s);
        } else {
            bucket.rapid.see(setpoint.feed_mm_s);
        }
        if let Some(word) = word {
            bucket.word.see(word * setpoint.feed_override);
        }
        for (range, &i) in bucket.axes.iter_mut().zip(&self.axes) {
            range[0].see(setpoint.velocity[i]);
            range[1].see(setpoint.acceleration[i]);
            range[2].see(setpoint.jerk[i]);
        }
        bucket.causes[cause.index()] += 1;
    }

    fn join_neighbours(&mut self) {
        for k in 0..BUCKETS / 2 {
            let (left, right) = self.buckets.split_at_mut(2 * k + 1);
            left[2 * k].join(&right[0]);
            self.buckets.swap(k, 2 * k);
        }
        self.buckets.truncate(BUCKETS / 2);
        self.width *= 2;
        self.filled = self.width;
    }

    pub(crate) fn buckets(&self) -> &[Bucket] {
        &self.buckets
    }

    /// Start of a bucket, s; for the index after the last one, the end.
    pub(crate) fn start_s(&self, bucket: usize) -> f64 {
        if bucket >= self.buckets.len() {
            return self.end_s();
        }
        bucket as f64 * self.width as f64 * self.period_s
    }

    pub(crate) fn end_s(&self) -> f64 {
        self.total as f64 * self.period_s
    }

    /// Fraction of the time limited by each cause, in descending order; only causes that occur.
    pub(crate) fn causes(&self) -> Vec<(Limiting, f64)> {
        let mut causes: Vec<(Limiting, f64)> = self
            .causes
            .iter()
            .enumerate()
            .filter(|(_, count)| **count > 0)
            .map(|(index, count)| (Limiting::of_index(index), *count as f64 / self.total as f64))
            .collect();
        causes.sort_by(|a, b| b.1.total_cmp(&a.1));
        causes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limiting::tests::{mill, moving};

    #[test]
    fn no_peak_is_lost_however_long_the_run() {
        for peak in [0, 1, 77_777, 99_999] {
            let mut strips = Strips::new(&mill(), 0.001);
            for k in 0..100_000 {
                let speed = if k == peak { 50.0 } else { 1.0 };
                let setpoint = moving([speed, 0.0, -speed], [0.0; 3], [0.0; 3]);
                let cause = if k == peak {
                    Limiting::Joint
                } else {
                    Limiting::Feed
                };
                strips.see(&setpoint, Some(1.0), cause);
            }
            let buckets = strips.buckets();
            assert!(buckets.len() <= BUCKETS && buckets.len() > BUCKETS / 4);
            assert_eq!(strips.end_s(), 100.0);
            let at = buckets
                .iter()
                .position(|bucket| bucket.axes[0][0].high == 50.0)
                .unwrap();
            assert_eq!(buckets[at].axes[2][0].low, -50.0);
            assert_eq!(buckets[at].causes[Limiting::Joint.index()], 1);
            let time = f64::from(peak) * 0.001;
            assert!(
                strips.start_s(at) <= time + 1e-9 && time < strips.start_s(at + 1) + 1e-9,
                "peak {peak} in bucket {at}"
            );
            assert_eq!(
                buckets
                    .iter()
                    .map(|bucket| u64::from(bucket.count()))
                    .sum::<u64>(),
                100_000
            );
            assert_eq!(strips.causes()[1], (Limiting::Joint, 1e-5));
        }
    }
}

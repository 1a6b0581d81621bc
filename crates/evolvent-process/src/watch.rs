//! What the load says: depth of cut, peaks, contact, and whether the sensor can be believed.

use crate::law::CutLaw;
use crate::sensor::LoadSample;

/// Parts of a revolution that are told apart.
const BINS: usize = 32;
/// Time constant over which readings are smoothed, s.
pub(crate) const SMOOTHING_S: f64 = 0.004;
/// What noise may make of the largest part of a revolution, as a share of the mean.
const ROUND: f64 = 0.04;
/// The same of the latest reading.
const LATEST: f64 = 0.97;
/// Shortest time after which a missing reading is trouble, s.
const LEAST_STALE_S: f64 = 0.002;
/// Readings below this share of the set load are as good as zero.
const QUIET: f64 = 1e-6;
/// The same reading so many times in a row is no reading.
const READINGS_FROZEN: u32 = 25;

/// Why the load is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorTrouble {
    /// No new reading for too long.
    Silent,
    /// Readings are not numbers.
    NotANumber,
    /// Readings stand at the end of the sensor's range.
    Saturated,
    /// Readings repeat to the last bit.
    Frozen,
    /// Readings lie far below zero.
    Negative,
}

/// What is known of the load now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadView {
    /// Smoothed over milliseconds.
    pub now: f64,
    /// Mean over the last revolution.
    pub mean: f64,
    /// Largest part of the last revolution.
    pub peak: f64,
    /// Depth of cut of the moment, mm.
    pub depth_now_mm: f64,
    /// Mean depth over the last revolution, mm.
    pub depth_mean_mm: f64,
    /// Depth to be reckoned with, mm: the mean where the cut is round, the deepest part of the revolution where not.
    pub depth_mm: f64,
    /// What is wrong with the sensor.
    pub trouble: Option<SensorTrouble>,
}

/// Follows the load. Real-time safe.
#[derive(Clone, Copy, Debug)]
pub struct LoadWatch {
    law: CutLaw,
    period_s: f64,
    stale_s: f64,
    lowest: f64,
    quiet: f64,
    share: f64,
    cycles_per_bin: f64,
    in_bin: f64,
    bin: usize,
    loads: [f64; BINS],
    depths: [f64; BINS],
    sums: (f64, f64, f64),
    now: f64,
    depth_now: f64,
    last: Option<LoadSample>,
    repeats: u32,
    age_s: f64,
    kind: SensorTrouble,
}

impl LoadWatch {
    /// For a spindle that turns once in `turn_s`, and readings that may be `stale_s` apart.
    #[must_use]
    pub fn new(law: CutLaw, set_load: f64, period_s: f64, turn_s: f64, stale_s: f64) -> Self {
        Self {
            law,
            period_s,
            stale_s: Self::stale_s(stale_s, period_s),
            lowest: -0.2 * set_load,
            quiet: QUIET * set_load,
            share: 1.0 - libm::exp(-period_s / SMOOTHING_S),
            cycles_per_bin: (turn_s / period_s / BINS as f64).max(1.0),
            in_bin: 0.0,
            bin: 0,
            loads: [0.0; BINS],
            depths: [0.0; BINS],
            sums: (0.0, 0.0, 0.0),
            now: 0.0,
            depth_now: 0.0,
            last: None,
            repeats: 0,
            age_s: 0.0,
            kind: SensorTrouble::Silent,
        }
    }

    fn stale_s(wanted_s: f64, period_s: f64) -> f64 {
        wanted_s.max(LEAST_STALE_S).max(2.5 * period_s)
    }

    /// The longest that it takes to notice that readings cannot be believed, s.
    pub(crate) fn notice_s(stale_s: f64, period_s: f64) -> f64 {
        Self::stale_s(stale_s, period_s) + f64::from(READINGS_FROZEN + 2) * period_s
    }

    /// Takes the newest reading, if any, at a chip of `chip_mm` a revolution.
    pub fn step(&mut self, sample: Option<LoadSample>, chip_mm: f64, least_chip_mm: f64) -> LoadView {
        self.age_s += self.period_s;
        if let Some(value) = self.believe(sample) {
            self.age_s = 0.0;
            self.now += self.share * (value.max(0.0) - self.now);
        }
        if chip_mm >= least_chip_mm {
            self.depth_now = self.law.depth_mm(self.now, chip_mm);
        }
        self.sums.0 += self.now;
        self.sums.1 += self.depth_now;
        self.sums.2 += 1.0;
        self.loads[self.bin] = self.sums.0 / self.sums.2;
        self.depths[self.bin] = self.sums.1 / self.sums.2;
        self.in_bin += 1.0;
        let view = self.view();
        if self.in_bin >= self.cycles_per_bin {
            self.in_bin -= self.cycles_per_bin;
            self.bin = (self.bin + 1) % BINS;
            self.sums = (0.0, 0.0, 0.0);
        }
        view
    }

    /// The value of a reading that is new and can be believed.
    fn believe(&mut self, sample: Option<LoadSample>) -> Option<f64> {
        let Some(sample) = sample else {
            self.kind = SensorTrouble::Silent;
            return None;
        };
        if let Some(last) = self.last {
            if last.sequence == sample.sequence {
                self.kind = SensorTrouble::Silent;
                return None;
            }
            // A quiet sensor may well show the same zero for ever.
            let same = last.value == sample.value && sample.value > self.quiet;
            self.repeats = if same { self.repeats.saturating_add(1) } else { 0 };
        }
        self.last = Some(sample);
        let value = sample.value;
        self.kind = if !value.is_finite() {
            SensorTrouble::NotANumber
        } else if value >= sample.range_max {
            SensorTrouble::Saturated
        } else if value < self.lowest {
            SensorTrouble::Negative
        } else if self.repeats >= READINGS_FROZEN {
            SensorTrouble::Frozen
        } else {
            return Some(value);
        };
        None
    }

    fn view(&self) -> LoadView {
        let (mut mean, mut peak, mut depth_mean, mut deepest) = (0.0, 0.0, 0.0, 0.0);
        for i in 0..BINS {
            mean += self.loads[i];
            peak = f64::max(peak, self.loads[i]);
            depth_mean += self.depths[i];
            deepest = f64::max(deepest, self.depths[i]);
        }
        mean /= BINS as f64;
        depth_mean /= BINS as f64;
        let reckoned = depth_mean + (deepest - (1.0 + ROUND) * depth_mean).max(0.0);
        LoadView {
            now: self.now,
            mean,
            peak,
            depth_now_mm: self.depth_now,
            depth_mean_mm: depth_mean,
            depth_mm: reckoned.max(LATEST * self.depth_now),
            trouble: (self.age_s > self.stale_s).then_some(self.kind),
        }
    }

    /// Forgets depths of before, after the tool has gone elsewhere.
    pub fn forget(&mut self) {
        self.depths = [0.0; BINS];
        self.depth_now = 0.0;
        self.sums.1 = 0.0;
    }
}

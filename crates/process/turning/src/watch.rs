//! Evaluation of the load: depth of cut, peaks, contact, and whether the sensor is plausible.

use evolvent_machine::LoadSample;

use crate::law::CutLaw;

/// Number of parts into which a revolution is divided.
const BINS: usize = 32;
/// Time constant over which readings are smoothed, s.
pub(crate) const SMOOTHING_S: f64 = 0.004;
/// Parts that are averaged to detect growth: the load is noisy.
const GROWTH_BINS: usize = 4;
/// Relative excess of the largest part of a revolution over the mean that may be noise.
const ROUND: f64 = 0.04;
/// Fraction of the latest depth that the depth for the feed keeps at least, because of noise.
const LATEST: f64 = 0.97;
/// Minimum time after which a missing reading is trouble, s.
const MIN_STALE_S: f64 = 0.002;
/// Readings below this fraction of the set load count as zero.
const QUIET: f64 = 1e-6;
/// Number of equal consecutive readings after which they count as no reading.
const READINGS_FROZEN: u32 = 25;

/// Why the load is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorTrouble {
    /// No new reading for too long.
    Silent,
    /// Readings are not numbers.
    NotANumber,
    /// Readings stay at the end of the sensor's range.
    Saturated,
    /// Readings repeat to the last bit.
    Frozen,
    /// Readings are far below zero.
    Negative,
}

/// The load at present.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoadView {
    /// Smoothed over milliseconds.
    pub now: f64,
    /// Mean over the last revolution.
    pub mean: f64,
    /// Largest part of the last revolution.
    pub peak: f64,
    /// Present depth of cut, mm.
    pub depth_now_mm: f64,
    /// Mean depth over the last revolution, mm.
    pub depth_mean_mm: f64,
    /// Depth for the feed, mm: the mean if the cut is round, otherwise the deepest part of the revolution.
    pub depth_mm: f64,
    /// Growth of the depth over a revolution, mm; 0 where it may be noise.
    pub growth_mm: f64,
    /// What is wrong with the sensor.
    pub trouble: Option<SensorTrouble>,
}

/// Follows the load. Real-time safe.
///
/// ```
/// use evolvent_turning::{CutLaw, LoadSample, LoadWatch};
/// let law = CutLaw { coefficient: 1467.0, depth_exponent: 1.0, feed_exponent: 0.75 };
/// let mut watch = LoadWatch::new(law, 2200.0, 0.001, 0.12, (0.01, 0.01), 0.08);
/// let mut depth_mm = 0.0;
/// for sequence in 1..500_u32 {
///     let value = law.load(3.0, 0.3) * (1.0 + 1e-6 * f64::from(sequence % 2));
///     let sample = LoadSample { sequence: sequence.into(), value, range_max: 8000.0 };
///     depth_mm = watch.step(Some(sample), 0.3).depth_mean_mm;
/// }
/// assert!((depth_mm - 3.0).abs() < 0.01);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct LoadWatch {
    law: CutLaw,
    period_s: f64,
    stale_s: f64,
    /// Weight of smoothing and of the sensor's lag in a cycle.
    fraction: f64,
    lag_fraction: f64,
    /// `chip^feed_exponent` as the sensor shows it, and smoothed like the load.
    chip_shown: f64,
    chip_smooth: f64,
    min_chip: f64,
    now: f64,
    depth_now: f64,
    /// Time since the last plausible reading.
    age_s: f64,
    revolution: Revolution,
    readings: Readings,
}

/// Loads and depths by the parts of a revolution.
#[derive(Clone, Copy, Debug)]
struct Revolution {
    cycles_per_bin: f64,
    in_bin: f64,
    bin: usize,
    loads: [f64; BINS],
    depths: [f64; BINS],
    /// The same parts of the previous revolution.
    depths_before: [f64; BINS],
    /// Sums of load, depth and number of cycles of the present part.
    sums: (f64, f64, f64),
}

impl Revolution {
    fn new(cycles: f64) -> Self {
        Self {
            cycles_per_bin: (cycles / BINS as f64).max(1.0),
            in_bin: 0.0,
            bin: 0,
            loads: [0.0; BINS],
            depths: [0.0; BINS],
            depths_before: [0.0; BINS],
            sums: (0.0, 0.0, 0.0),
        }
    }

    /// Adds a cycle to the present part.
    fn add(&mut self, load: f64, depth: f64) {
        self.sums.0 += load;
        self.sums.1 += depth;
        self.sums.2 += 1.0;
        self.loads[self.bin] = self.sums.0 / self.sums.2;
        self.depths[self.bin] = self.sums.1 / self.sums.2;
        self.in_bin += 1.0;
    }

    /// Goes to the next part if the present one is complete.
    fn advance(&mut self) {
        if self.in_bin >= self.cycles_per_bin {
            self.in_bin -= self.cycles_per_bin;
            self.bin = (self.bin + 1) % BINS;
            self.depths_before[self.bin] = self.depths[self.bin];
            self.sums = (0.0, 0.0, 0.0);
        }
    }

    /// Compares each part with the same part of the previous revolution, so that an uneven cut does not look
    /// like a growing one.
    fn growth(&self) -> f64 {
        let (mut latest, mut before) = (0.0, 0.0);
        // The present part is incomplete.
        for k in 1..=GROWTH_BINS {
            let part = (self.bin + BINS - k) % BINS;
            latest += self.depths[part];
            before += self.depths_before[part];
        }
        (latest - (1.0 + ROUND) * before).max(0.0) / GROWTH_BINS as f64
    }

    fn forget_depths(&mut self) {
        self.depths = [0.0; BINS];
        self.depths_before = [0.0; BINS];
        self.sums.1 = 0.0;
    }
}

/// Decides which readings of the sensor are plausible.
#[derive(Clone, Copy, Debug)]
struct Readings {
    /// Lower values are not loads.
    lowest: f64,
    /// Equal readings up to this value are plausible.
    quiet: f64,
    last: Option<LoadSample>,
    repeats: u32,
    trouble: SensorTrouble,
}

impl Readings {
    /// The value of a new and plausible reading.
    fn believe(&mut self, sample: Option<LoadSample>) -> Option<f64> {
        let Some(sample) = sample else {
            self.trouble = SensorTrouble::Silent;
            return None;
        };
        if let Some(last) = self.last {
            if last.sequence == sample.sequence {
                self.trouble = SensorTrouble::Silent;
                return None;
            }
            // A quiet sensor may repeat the same zero indefinitely.
            let same = last.value == sample.value && sample.value > self.quiet;
            self.repeats = if same { self.repeats.saturating_add(1) } else { 0 };
        }
        self.last = Some(sample);
        let value = sample.value;
        self.trouble = if !value.is_finite() {
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
}

impl LoadWatch {
    /// Creates a watch for a spindle with a revolution of `turn_s`, and a sensor with a time constant of
    /// `lag_s` whose readings may be `stale_s` apart. Chips below `min_chip_mm` give no depth.
    #[must_use]
    pub fn new(
        law: CutLaw,
        set_load: f64,
        period_s: f64,
        turn_s: f64,
        (lag_s, stale_s): (f64, f64),
        min_chip_mm: f64,
    ) -> Self {
        let fraction = |time_s: f64| 1.0 - libm::exp(-period_s / time_s.max(1e-9));
        Self {
            law,
            period_s,
            stale_s: Self::stale_s(stale_s, period_s),
            fraction: fraction(SMOOTHING_S),
            lag_fraction: fraction(lag_s),
            chip_shown: 0.0,
            chip_smooth: 0.0,
            min_chip: libm::pow(min_chip_mm, law.feed_exponent),
            now: 0.0,
            depth_now: 0.0,
            age_s: 0.0,
            revolution: Revolution::new(turn_s / period_s),
            readings: Readings {
                lowest: -0.2 * set_load,
                quiet: QUIET * set_load,
                last: None,
                repeats: 0,
                trouble: SensorTrouble::Silent,
            },
        }
    }

    fn stale_s(wanted_s: f64, period_s: f64) -> f64 {
        wanted_s.max(MIN_STALE_S).max(2.5 * period_s)
    }

    /// Maximum time to detect implausible readings, s.
    pub(crate) fn notice_s(stale_s: f64, period_s: f64) -> f64 {
        Self::stale_s(stale_s, period_s) + f64::from(READINGS_FROZEN + 2) * period_s
    }

    /// Takes the newest reading, if any, at the present chip of `chip_mm` per revolution.
    ///
    /// The load of a depth is proportional to `chip^feed_exponent`. That power passes the same filters as the
    /// load, sensor lag and smoothing, so their ratio gives the depth at any course of the feed.
    pub fn step(&mut self, sample: Option<LoadSample>, chip_mm: f64) -> LoadView {
        self.age_s += self.period_s;
        let chip = libm::pow(chip_mm.max(0.0), self.law.feed_exponent);
        self.chip_shown += self.lag_fraction * (chip - self.chip_shown);
        if let Some(value) = self.readings.believe(sample) {
            self.age_s = 0.0;
            self.now += self.fraction * (value.max(0.0) - self.now);
            self.chip_smooth += self.fraction * (self.chip_shown - self.chip_smooth);
        }
        if self.chip_smooth >= self.min_chip {
            let at_one = self.law.coefficient * self.chip_smooth;
            self.depth_now = libm::pow(self.now / at_one, 1.0 / self.law.depth_exponent);
        }
        self.revolution.add(self.now, self.depth_now);
        let view = self.view();
        self.revolution.advance();
        view
    }

    fn view(&self) -> LoadView {
        let (mut mean, mut peak, mut depth_mean, mut deepest) = (0.0, 0.0, 0.0, 0.0);
        for i in 0..BINS {
            mean += self.revolution.loads[i];
            peak = f64::max(peak, self.revolution.loads[i]);
            depth_mean += self.revolution.depths[i];
            deepest = f64::max(deepest, self.revolution.depths[i]);
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
            growth_mm: self.revolution.growth(),
            trouble: (self.age_s > self.stale_s).then_some(self.readings.trouble),
        }
    }

    /// Discards previous depths, after the tool has moved elsewhere.
    pub fn forget(&mut self) {
        self.revolution.forget_depths();
        self.depth_now = 0.0;
    }
}

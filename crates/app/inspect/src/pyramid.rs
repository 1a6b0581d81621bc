//! A curve of any length in bounded memory, without losing an extreme.

/// The minimum and maximum of each part of a curve; all parts have equal length.
///
/// Parts start with one sample each. When there are too many parts, neighbours are merged in pairs, and parts
/// are twice as long from then on. A short curve is thus kept sample by sample, and a long one with every
/// peak and dip, located to within a part. NaN values are skipped.
#[derive(Clone, Debug)]
pub struct Pyramid {
    capacity: usize,
    width: u64,
    filled: u64,
    open: (f64, f64),
    stretches: Vec<(f64, f64)>,
    least: f64,
    greatest: f64,
}

/// A part without a number.
const NOTHING: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);

/// A [`Pyramid`] as integers for a page.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Level {
    /// Samples per part.
    pub width: u64,
    /// The value of integer 0.
    pub offset: f64,
    /// The step between two integers.
    pub scale: f64,
    /// Minimum and maximum of each part in turn, 0 to 65534; 65535 and 0 without a number. Rounded outwards,
    /// so that they include the recorded values.
    #[serde(skip)]
    pub values: Vec<u16>,
    /// The exact minimum of all samples.
    pub least: f64,
    /// The exact maximum of all samples.
    pub greatest: f64,
}

impl Pyramid {
    /// For at most `capacity` parts, an even number.
    #[must_use]
    pub fn new(capacity: usize) -> Self {
        Self {
            capacity: capacity.max(2) & !1,
            width: 1,
            filled: 0,
            open: NOTHING,
            stretches: Vec::new(),
            least: f64::INFINITY,
            greatest: f64::NEG_INFINITY,
        }
    }

    /// Adds the next sample.
    pub fn push(&mut self, value: f64) {
        if value.is_finite() {
            self.open = (self.open.0.min(value), self.open.1.max(value));
            self.least = self.least.min(value);
            self.greatest = self.greatest.max(value);
        }
        self.filled += 1;
        if self.filled < self.width {
            return;
        }
        self.stretches.push(std::mem::replace(&mut self.open, NOTHING));
        self.filled = 0;
        if self.stretches.len() >= self.capacity {
            let join = |pair: &[(f64, f64)]| (pair[0].0.min(pair[1].0), pair[0].1.max(pair[1].1));
            self.stretches = self.stretches.chunks_exact(2).map(join).collect();
            self.width *= 2;
        }
    }

    /// Adds samples without a number, one per missing sample.
    pub fn skip(&mut self, samples: u64) {
        // A gap longer than everything before it would only be blank.
        for _ in 0..samples.min(100_000_000) {
            self.push(f64::NAN);
        }
    }

    /// Samples per part.
    #[must_use]
    pub fn width(&self) -> u64 {
        self.width
    }

    /// Minimum and maximum of each part; the last one may be shorter.
    #[must_use]
    pub fn stretches(&self) -> Vec<(f64, f64)> {
        let open = (self.filled > 0).then_some(self.open);
        self.stretches.iter().copied().chain(open).collect()
    }

    /// The curve as integers.
    #[must_use]
    pub fn level(&self) -> Level {
        let (least, greatest) = if self.least <= self.greatest {
            (self.least, self.greatest)
        } else {
            (0.0, 0.0)
        };
        // Divided first, because the difference of two large numbers may overflow.
        let scale = (greatest / 65_000.0 - least / 65_000.0).max(f64::MIN_POSITIVE);
        let whole = |value: f64, up: bool| {
            let steps = value / scale - least / scale;
            // One more than the rounding requires, because the division itself rounds.
            let rounded = if up { steps.ceil() + 1.0 } else { steps.floor() };
            rounded.clamp(0.0, 65_534.0) as u16
        };
        let values = self
            .stretches()
            .into_iter()
            .flat_map(|(low, high)| {
                if low <= high {
                    [whole(low, false), whole(high, true)]
                } else {
                    [65_535, 0]
                }
            })
            .collect();
        Level {
            width: self.width,
            offset: least,
            scale,
            values,
            least,
            greatest,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evolvent_random::Random;

    #[test]
    fn samples_are_within_their_bin_and_extremes_are_kept() {
        let mut random = Random::seeded(0x5EED);
        let mut next = || random.bits();
        for _ in 0..40 {
            let count = 1 + next() % 30_000;
            let samples: Vec<f64> = (0..count)
                .map(|n| {
                    // A quiet curve with single-sample spikes.
                    let spike = if next().is_multiple_of(997) {
                        (next() % 2000) as f64 - 1000.0
                    } else {
                        0.0
                    };
                    (n as f64 * 0.01).sin() + spike
                })
                .collect();
            let mut pyramid = Pyramid::new(64 + (next() % 500) as usize * 2);
            samples.iter().for_each(|&sample| pyramid.push(sample));
            let (stretches, level) = (pyramid.stretches(), pyramid.level());
            assert_eq!(stretches.len() as u64, count.div_ceil(pyramid.width()));
            assert_eq!(level.values.len(), 2 * stretches.len());
            for (n, sample) in samples.iter().enumerate() {
                let at = n / pyramid.width() as usize;
                let (low, high) = stretches[at];
                assert!(low <= *sample && *sample <= high, "sample {n}");
                let shown = |value: u16| level.offset + f64::from(value) * level.scale;
                let slack = level.scale * 1e-6;
                let (low, high) = (shown(level.values[2 * at]), shown(level.values[2 * at + 1]));
                assert!(
                    low <= sample + slack && *sample <= high + slack,
                    "sample {n} of the page"
                );
            }
            let least = samples.iter().copied().fold(f64::INFINITY, f64::min);
            let greatest = samples.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            assert_eq!((level.least, level.greatest), (least, greatest));
            // The extremes of a part are samples, not bounds of bounds.
            let found: Vec<f64> = stretches.iter().map(|stretch| stretch.1).collect();
            assert!(found.iter().all(|high| samples.contains(high)));
        }
    }

    #[test]
    fn a_gap_is_blank_and_keeps_what_follows_in_its_place() {
        let mut pyramid = Pyramid::new(1000);
        pyramid.push(1.0);
        pyramid.skip(3);
        pyramid.push(2.0);
        let values = pyramid.level().values;
        assert_eq!(values[2..8], [65_535, 0, 65_535, 0, 65_535, 0]);
        assert!(values[0] == 0 && values[9] >= 65_000, "{values:?}");
    }

    #[test]
    fn a_flat_curve_and_none_at_all_are_curves() {
        let mut pyramid = Pyramid::new(8);
        assert!(pyramid.level().values.is_empty());
        (0..100).for_each(|_| pyramid.push(-7.25));
        let level = pyramid.level();
        assert_eq!((level.offset, level.least, level.greatest), (-7.25, -7.25, -7.25));
    }
}

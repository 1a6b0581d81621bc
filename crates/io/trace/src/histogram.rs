//! A histogram of times that costs a few nanoseconds per value and no allocation.

use crate::schema::evolvent;

/// Sub-buckets per power of two: values within one bucket differ by less than 1/16.
const SUB_BITS: u32 = 4;
const SUB: usize = 1 << SUB_BITS;
/// Values up to 2⁴⁰ ns, eighteen minutes, are distinguished; larger ones share the last bucket.
const MAX_BITS: u32 = 40;
const BUCKETS: usize = (MAX_BITS - SUB_BITS + 1) as usize * SUB;

/// Counts of times in ns, with percentiles to 1/16 of the value.
///
/// Buckets are linear up to 16 ns and then sixteen to a power of two, the layout of HDR histograms. A fixed
/// array: recording allocates nothing and may run in the real-time cycle. Negative times (woken early) count
/// as zero, but `min_ns` keeps them.
///
/// ```
/// let mut lateness = evolvent_trace::Histogram::default();
/// (1..=1000).for_each(|us| lateness.record(us * 1000));
/// let p99 = lateness.percentile_ns(99.0);
/// assert!((990_000..=990_000 * 17 / 16).contains(&p99));
/// ```
#[derive(Clone, PartialEq, Eq)]
pub struct Histogram {
    counts: Box<[u64; BUCKETS]>,
    total: u64,
    min_ns: i64,
    max_ns: i64,
    sum_ns: i128,
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            counts: Box::new([0; BUCKETS]),
            total: 0,
            min_ns: i64::MAX,
            max_ns: i64::MIN,
            sum_ns: 0,
        }
    }
}

impl std::fmt::Debug for Histogram {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Histogram")
            .field("count", &self.total)
            .field("min_ns", &self.min_ns())
            .field("p50_ns", &self.percentile_ns(50.0))
            .field("max_ns", &self.max_ns())
            .finish()
    }
}

fn bucket_of(ns: u64) -> usize {
    if ns < SUB as u64 {
        return ns as usize;
    }
    let top = 63 - ns.leading_zeros();
    if top >= MAX_BITS {
        return BUCKETS - 1;
    }
    let sub = (ns >> (top - SUB_BITS)) as usize & (SUB - 1);
    (top - SUB_BITS + 1) as usize * SUB + sub
}

/// The largest value of a bucket.
fn upper_ns(bucket: usize) -> u64 {
    if bucket < SUB {
        return bucket as u64;
    }
    let shift = (bucket / SUB - 1) as u32;
    (((SUB + bucket % SUB + 1) as u64) << shift) - 1
}

impl Histogram {
    /// Counts one time, ns. Allocates nothing; the cycle may call it.
    pub fn record(&mut self, ns: i64) {
        self.counts[bucket_of(ns.max(0).unsigned_abs())] += 1;
        self.total += 1;
        self.min_ns = self.min_ns.min(ns);
        self.max_ns = self.max_ns.max(ns);
        self.sum_ns += i128::from(ns);
    }

    /// Adds all counts of another histogram.
    pub fn add(&mut self, other: &Self) {
        for (count, more) in self.counts.iter_mut().zip(other.counts.iter()) {
            *count += more;
        }
        self.total += other.total;
        self.min_ns = self.min_ns.min(other.min_ns);
        self.max_ns = self.max_ns.max(other.max_ns);
        self.sum_ns += other.sum_ns;
    }

    /// Removes all counts.
    pub fn clear(&mut self) {
        self.counts.fill(0);
        self.total = 0;
        self.min_ns = i64::MAX;
        self.max_ns = i64::MIN;
        self.sum_ns = 0;
    }

    /// Number of times counted.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.total
    }

    /// The minimum, ns; 0 if there is none.
    #[must_use]
    pub fn min_ns(&self) -> i64 {
        if self.total == 0 { 0 } else { self.min_ns }
    }

    /// The maximum, ns; 0 if there is none.
    #[must_use]
    pub fn max_ns(&self) -> i64 {
        if self.total == 0 { 0 } else { self.max_ns }
    }

    /// The sum of all times, ns, saturating.
    #[must_use]
    pub fn sum_ns(&self) -> i64 {
        i64::try_from(self.sum_ns).unwrap_or(if self.sum_ns < 0 { i64::MIN } else { i64::MAX })
    }

    /// The time that `percent` of all do not exceed, ns, too large by at most 1/16; 0 if there is none.
    #[must_use]
    pub fn percentile_ns(&self, percent: f64) -> i64 {
        if self.total == 0 {
            return 0;
        }
        let wanted = ((percent.clamp(0.0, 100.0) / 100.0 * self.total as f64).ceil() as u64).max(1);
        let mut seen = 0;
        for (bucket, count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= wanted {
                let upper = if bucket == BUCKETS - 1 {
                    u64::MAX
                } else {
                    upper_ns(bucket)
                };
                return i64::try_from(upper).unwrap_or(i64::MAX).min(self.max_ns);
            }
        }
        self.max_ns
    }

    pub(crate) fn message(&self) -> evolvent::Histogram {
        evolvent::Histogram {
            count: self.powers_of_two(),
            min_ns: self.min_ns(),
            max_ns: self.max_ns(),
            sum_ns: self.sum_ns(),
        }
    }

    /// Counts of times in [2^(i−1), 2^i) ns (the first: below 1 ns), without trailing empty ones.
    #[must_use]
    pub fn powers_of_two(&self) -> Vec<u64> {
        let mut powers = Vec::new();
        for (bucket, &count) in self.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let power = (u64::BITS - upper_ns(bucket).leading_zeros()) as usize;
            if powers.len() <= power {
                powers.resize(power + 1, 0);
            }
            powers[power] += count;
        }
        powers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bucket_of_a_value_is_at_most_a_sixteenth_too_high() {
        for ns in (0..5000_u64)
            .chain((0..40).map(|bit| 1 << bit))
            .chain((1..40).map(|bit| (1 << bit) - 1))
        {
            let upper = upper_ns(bucket_of(ns));
            assert!(upper >= ns, "{upper} < {ns}");
            assert!((upper - ns) as f64 <= ns as f64 / 16.0, "{upper} for {ns}");
        }
    }

    #[test]
    fn percentiles_are_those_of_the_sorted_values() {
        let mut histogram = Histogram::default();
        for ns in 1..=1000 {
            histogram.record(ns * 100);
        }
        for (percent, exact) in [(50.0, 50_000), (99.0, 99_000), (99.9, 99_900), (100.0, 100_000)] {
            let found = histogram.percentile_ns(percent);
            assert!(
                found >= exact && found - exact <= exact / 16,
                "p{percent} is {found}, not {exact}"
            );
        }
        assert_eq!((histogram.min_ns(), histogram.max_ns()), (100, 100_000));
    }

    #[test]
    fn extreme_times_neither_panic_nor_vanish() {
        let mut histogram = Histogram::default();
        for ns in [i64::MIN, -1, 0, i64::MAX, i64::MAX] {
            histogram.record(ns);
        }
        assert_eq!(histogram.count(), 5);
        assert_eq!(histogram.powers_of_two().iter().sum::<u64>(), 5);
        assert_eq!(
            (histogram.min_ns(), histogram.percentile_ns(100.0)),
            (i64::MIN, i64::MAX)
        );
    }

    #[test]
    fn powers_of_two_bound_their_values() {
        let mut histogram = Histogram::default();
        for ns in [0, 1, 2, 3, 4, 1023, 1024] {
            histogram.record(ns);
        }
        assert_eq!(histogram.powers_of_two(), [1, 1, 2, 1, 0, 0, 0, 0, 0, 0, 1, 1]);
    }
}

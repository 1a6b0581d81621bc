//! The newest cutting load, from the receiving thread to the cycle.

use std::sync::atomic::{AtomicU64, Ordering};

use evolvent_turning::LoadSample;

/// One reading, replaced by the next; no access waits.
#[derive(Debug, Default)]
pub(crate) struct LoadCell {
    /// The value as f32 in the upper half, the number of readings in the lower half.
    reading: AtomicU64,
    range: AtomicU64,
}

impl LoadCell {
    /// Stores a reading and the highest value that its sensor can report. From one thread only.
    pub(crate) fn observe(&self, value: f64, range_max: f64) {
        let count = (self.reading.load(Ordering::Relaxed) as u32)
            .wrapping_add(1)
            .max(1);
        self.range.store(range_max.to_bits(), Ordering::Relaxed);
        let bits = u64::from((value as f32).to_bits()) << 32 | u64::from(count);
        self.reading.store(bits, Ordering::Release);
    }

    /// The newest reading; `None` before the first. Real-time safe.
    pub(crate) fn newest(&self) -> Option<LoadSample> {
        let bits = self.reading.load(Ordering::Acquire);
        let range = f64::from_bits(self.range.load(Ordering::Relaxed));
        (bits != 0).then(|| LoadSample {
            sequence: bits & u64::from(u32::MAX),
            value: f64::from(f32::from_bits((bits >> 32) as u32)),
            range_max: f64::from(range as f32),
        })
    }
}

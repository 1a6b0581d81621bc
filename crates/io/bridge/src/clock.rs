//! The clock of the bus.

use rustix::time::{ClockId, clock_gettime};

/// `CLOCK_MONOTONIC` in ns. Real-time safe.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

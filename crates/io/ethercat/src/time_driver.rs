//! The clock of the MainDevice's timeouts. Its timers wake no task: the pump polls.

use core::sync::atomic::{AtomicU64, Ordering};
use core::task::Waker;

use embassy_time_driver::{Driver, TICK_HZ, time_driver_impl};
use evolvent_bridge::monotonic_ns;
use rustix::time::{ClockId, clock_gettime};

/// Processor time of the calling thread in ns.
pub(crate) fn thread_ns() -> u64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

/// Expiry of the first polled timer, in ticks.
static NEXT: AtomicU64 = AtomicU64::new(u64::MAX);

struct MonotonicDriver;

impl Driver for MonotonicDriver {
    fn now(&self) -> u64 {
        (u128::from(monotonic_ns()) * u128::from(TICK_HZ) / 1_000_000_000) as u64
    }

    fn schedule_wake(&self, at: u64, _waker: &Waker) {
        NEXT.fetch_min(at, Ordering::Relaxed);
    }
}

time_driver_impl!(static DRIVER: MonotonicDriver = MonotonicDriver);

/// Clears the timers before futures are polled.
pub(crate) fn forget_timers() {
    NEXT.store(u64::MAX, Ordering::Relaxed);
}

/// Expiry of the first timer polled since then, ns.
pub(crate) fn next_timer_ns() -> u64 {
    let ticks = NEXT.load(Ordering::Relaxed);
    if ticks == u64::MAX {
        return u64::MAX;
    }
    // One tick more: the present one may have started.
    ((u128::from(ticks) + 1) * 1_000_000_000 / u128::from(TICK_HZ)) as u64
}

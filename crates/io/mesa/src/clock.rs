//! Sleeping by the clock of the bus.

use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec};

pub(crate) fn sleep_until(at_ns: u64) {
    let at = Timespec {
        tv_sec: (at_ns / 1_000_000_000) as i64,
        tv_nsec: (at_ns % 1_000_000_000) as i64,
    };
    // A signal ends the sleep early; one cycle is then early.
    let _interrupted = clock_nanosleep_absolute(ClockId::Monotonic, &at);
}

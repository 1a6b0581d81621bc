//! Round-trip times of packets, sent in the same way as by a bridge.

use core::time::Duration;

use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec};

use crate::clock::monotonic_ns;
use crate::privileges::raise_priority;

/// Priority of the measuring thread: that of a bridge whose core has 80.
const PRIORITY: u8 = 78;

/// Measured round trips.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RoundTrips {
    /// Number of packets sent.
    pub sent: u64,
    /// Number of packets without a reply within a period.
    pub lost: u64,
    /// Median, ns.
    pub p50_ns: u64,
    /// 99.9th percentile, ns.
    pub p999_ns: u64,
    /// Maximum, ns.
    pub max_ns: u64,
    /// Whether the thread had real-time priority.
    pub is_real_time: bool,
}

/// Measures round trips for `duration`, one in each `period`, on a thread with real-time priority if
/// permitted. `exchange` sends a packet and waits for its reply until the given time in ns of
/// `CLOCK_MONOTONIC`; it returns whether the reply was received.
///
/// # Errors
/// The thread cannot be started, or `exchange` panics.
pub fn measure_round_trips(
    period: Duration,
    duration: Duration,
    mut exchange: impl FnMut(u64) -> bool + Send,
) -> std::io::Result<RoundTrips> {
    let period_ns = (period.as_nanos() as u64).max(1000);
    let count = (duration.as_nanos() as u64 / period_ns).clamp(1, 10_000_000);
    std::thread::scope(|scope| {
        let measuring = std::thread::Builder::new().spawn_scoped(scope, || {
            let mut trips = RoundTrips {
                is_real_time: raise_priority(PRIORITY).is_ok(),
                ..RoundTrips::default()
            };
            let mut times = Vec::with_capacity(count as usize);
            let mut next_ns = monotonic_ns() + period_ns;
            for _ in 0..count {
                let at = Timespec {
                    tv_sec: (next_ns / 1_000_000_000) as i64,
                    tv_nsec: (next_ns % 1_000_000_000) as i64,
                };
                // A signal ends the sleep early; one packet is then early.
                let _interrupted = clock_nanosleep_absolute(ClockId::Monotonic, &at);
                let sent_ns = monotonic_ns();
                trips.sent += 1;
                let received = exchange(sent_ns + period_ns);
                let elapsed_ns = monotonic_ns() - sent_ns;
                // A thread that woke late can still find a reply; the bridge's cycle would have been over.
                if received && elapsed_ns <= period_ns {
                    times.push(elapsed_ns);
                } else {
                    trips.lost += 1;
                }
                next_ns = (next_ns + period_ns).max(monotonic_ns());
            }
            times.sort_unstable();
            let percentile = |fraction: f64| {
                let rank = (times.len() as f64 * fraction).ceil() as usize;
                times.get(rank.max(1) - 1).or(times.last()).copied().unwrap_or(0)
            };
            (trips.p50_ns, trips.p999_ns, trips.max_ns) =
                (percentile(0.5), percentile(0.999), percentile(1.0));
            trips
        })?;
        measuring
            .join()
            .map_err(|_| std::io::Error::other("the measuring thread has panicked"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replies_after_their_period_are_lost() {
        let period = Duration::from_millis(2);
        let trips = measure_round_trips(period, period * 5, |until_ns| {
            while monotonic_ns() <= until_ns {
                std::thread::yield_now();
            }
            true
        })
        .expect("a thread");
        assert_eq!((trips.sent, trips.lost, trips.max_ns), (5, 5, 0));
    }
}

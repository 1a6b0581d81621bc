//! The clock of the drives.

use rustix::time::{ClockId, clock_gettime};

/// CLOCK_MONOTONIC in ns, the clock of the bus.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

/// A clock with its own crystal: its periods are slightly longer or shorter than the core's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveClock {
    origin_ns: u64,
    period_ns: u64,
    drift_ppm: f64,
    ticks: u64,
}

impl DriveClock {
    /// Creates a clock that ticks from `origin_ns` on. A positive drift makes the periods longer.
    #[must_use]
    pub const fn new(origin_ns: u64, period_ns: u64, drift_ppm: f64) -> Self {
        Self {
            origin_ns,
            period_ns,
            drift_ppm,
            ticks: 0,
        }
    }

    /// Time of the next tick, ns of CLOCK_MONOTONIC.
    #[must_use]
    pub fn next_ns(&self) -> u64 {
        let ideal_ns = self.ticks.wrapping_mul(self.period_ns);
        let drift_ns = (ideal_ns as f64 * self.drift_ppm * 1e-6) as i64;
        self.origin_ns
            .wrapping_add(ideal_ns)
            .wrapping_add_signed(drift_ns)
    }

    /// Advances by one tick and returns the time of the tick that has passed.
    pub fn tick(&mut self) -> u64 {
        let now_ns = self.next_ns();
        self.ticks += 1;
        now_ns
    }

    /// Skips the ticks up to `now_ns`.
    pub fn skip_to(&mut self, now_ns: u64) {
        let behind_ns = now_ns.saturating_sub(self.next_ns());
        self.ticks += behind_ns / self.period_ns.max(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drift_of_100_ppm_is_100_us_a_second() {
        let mut clock = DriveClock::new(5_000, 1_000_000, 100.0);
        let mut last = 0;
        for _ in 0..=1000 {
            last = clock.tick();
        }
        assert_eq!(last, 5_000 + 1_000_000_000 + 100_000);
        clock.skip_to(last + 500_000_000);
        assert!(clock.next_ns().abs_diff(last + 500_000_000) <= 2_000_000);
    }
}

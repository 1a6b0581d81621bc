//! The distributed clock of one device: a crystal that drifts, and a loop that follows the reference.

/// Maximum correction of the rate, as a ratio.
const MAX_CORRECTION: f64 = 1e-3;
/// Maximum number of pulses delivered late after a pause of the simulator.
const MAX_PULSES: u64 = 1000;

/// A clock with a drift. A PI loop follows the reference. The adder of a real controller steps by single ns,
/// which is slower and less smooth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Clock {
    drift: f64,
    /// Correction of the rate by the loop, as a ratio.
    correction: f64,
    integral: f64,
    /// Local time `local_ns` plus `fraction_ns` at the simulator's time `at_ns`.
    at_ns: u64,
    local_ns: u64,
    fraction_ns: f64,
    /// System time minus local time.
    pub(crate) offset_ns: u64,
    pub(crate) delay_ns: u32,
    mean_difference_ns: f64,
    /// The registers have 32 bits.
    pub(crate) is_short: bool,
    /// The loop does not follow the reference.
    pub(crate) ignores_reference: bool,
    compared_at_ns: Option<u64>,
    /// System time of the next SYNC0, where it is on.
    next_sync_ns: Option<u64>,
    /// SYNC0 has occurred since it was switched on.
    has_pulsed: bool,
    cycle_ns: u64,
}

impl Clock {
    /// Creates the clock of a device that has just been supplied. A positive drift makes it fast.
    pub(crate) fn new(now_ns: u64, drift_ppm: f64) -> Self {
        Self {
            drift: drift_ppm * 1e-6,
            correction: 0.0,
            integral: 0.0,
            at_ns: now_ns,
            local_ns: 0,
            fraction_ns: 0.0,
            offset_ns: 0,
            delay_ns: 0,
            mean_difference_ns: 0.0,
            is_short: false,
            ignores_reference: false,
            compared_at_ns: None,
            next_sync_ns: None,
            has_pulsed: false,
            cycle_ns: 0,
        }
    }

    fn rate(&self) -> f64 {
        (1.0 + self.drift) * (1.0 + self.correction)
    }

    /// Local time, of the receive times.
    pub(crate) fn local(&self, now_ns: u64) -> u64 {
        let passed = now_ns.saturating_sub(self.at_ns) as f64 * self.rate() + self.fraction_ns;
        self.local_ns.wrapping_add(passed as u64)
    }

    /// The device's copy of the system time.
    pub(crate) fn system(&self, now_ns: u64) -> u64 {
        self.local(now_ns).wrapping_add(self.offset_ns)
    }

    /// A time as the registers show it.
    pub(crate) const fn shown(&self, time_ns: u64) -> u64 {
        if self.is_short {
            time_ns as u32 as u64
        } else {
            time_ns
        }
    }

    /// The full time that corresponds to a register, next to the present time.
    fn meant(&self, now_ns: u64, register: u64) -> u64 {
        let system_ns = self.system(now_ns);
        if self.is_short {
            let ahead_ns = (register as u32).wrapping_sub(system_ns as u32).cast_signed();
            system_ns.wrapping_add_signed(i64::from(ahead_ns))
        } else {
            register
        }
    }

    fn rebase(&mut self, now_ns: u64) {
        let passed = now_ns.saturating_sub(self.at_ns) as f64 * self.rate() + self.fraction_ns;
        self.local_ns = self.local_ns.wrapping_add(passed as u64);
        self.fraction_ns = passed - passed.trunc();
        self.at_ns = now_ns;
    }

    /// Resets the loop, as a write to its start value does.
    pub(crate) fn reset_loop(&mut self, now_ns: u64) {
        self.rebase(now_ns);
        (self.correction, self.integral, self.mean_difference_ns) = (0.0, 0.0, 0.0);
        self.compared_at_ns = None;
    }

    /// Compares the clock with the lower 32 bits of the reference's system time.
    pub(crate) fn compare(&mut self, now_ns: u64, received: u32) {
        let own = self.system(now_ns) as u32;
        let difference_ns = f64::from(own.wrapping_sub(received.wrapping_add(self.delay_ns)) as i32);
        self.rebase(now_ns);
        self.mean_difference_ns += (difference_ns - self.mean_difference_ns) / 4.0;
        let Some(last_ns) = self.compared_at_ns.replace(now_ns) else {
            return;
        };
        if self.ignores_reference {
            (self.correction, self.integral) = (0.0, 0.0);
            return;
        }
        let interval_ns = now_ns.saturating_sub(last_ns).max(1) as f64;
        // A time constant of twenty intervals, critically damped: rate' = -e/T - integral(e)/(4 T^2).
        let constant_ns = 20.0 * interval_ns;
        self.integral += difference_ns * interval_ns / (4.0 * constant_ns * constant_ns);
        self.integral = self.integral.clamp(-MAX_CORRECTION, MAX_CORRECTION);
        self.correction =
            (-difference_ns / constant_ns - self.integral).clamp(-MAX_CORRECTION, MAX_CORRECTION);
    }

    /// Register 092Ch: the magnitude of the difference; bit 31 is set if the local copy is late.
    pub(crate) fn difference(&self) -> u32 {
        let magnitude = (self.mean_difference_ns.abs() as u32).min(0x7FFF_FFFF);
        magnitude | u32::from(self.mean_difference_ns < 0.0) << 31
    }

    /// Switches SYNC0 on. If the start time has passed, SYNC0 never occurs.
    pub(crate) fn start_sync(&mut self, now_ns: u64, start_ns: u64, cycle_ns: u32) {
        let start_ns = self.meant(now_ns, start_ns);
        let ahead_ns = start_ns.wrapping_sub(self.system(now_ns)) as i64;
        self.next_sync_ns = (cycle_ns > 0 && ahead_ns > 0).then_some(start_ns);
        self.cycle_ns = u64::from(cycle_ns);
        self.has_pulsed = false;
    }

    pub(crate) fn stop_sync(&mut self) {
        self.next_sync_ns = None;
    }

    /// Whether SYNC0 has occurred.
    pub(crate) const fn has_pulsed(&self) -> bool {
        self.has_pulsed
    }

    /// Whether SYNC0 is running or will start.
    pub(crate) const fn has_sync(&self) -> bool {
        self.next_sync_ns.is_some()
    }

    /// Time from the last SYNC0 to `now_ns`, if SYNC0 is on.
    pub(crate) fn after_sync_ns(&self, now_ns: u64) -> Option<u64> {
        let until_ns = self.next_sync_ns?.wrapping_sub(self.system(now_ns)).cast_signed();
        let cycle_ns = self.cycle_ns.cast_signed().max(1);
        Some(until_ns.wrapping_neg().rem_euclid(cycle_ns).unsigned_abs())
    }

    pub(crate) const fn sync_cycle_ns(&self) -> u64 {
        self.cycle_ns
    }

    /// Returns the next SYNC0 up to `now_ns`, in the simulator's time. Call repeatedly until it returns
    /// `None`.
    pub(crate) fn take_sync(&mut self, now_ns: u64) -> Option<u64> {
        let next_ns = self.next_sync_ns?;
        let since_ns = self.system(now_ns).wrapping_sub(next_ns);
        if since_ns as i64 <= 0 {
            return None;
        }
        self.has_pulsed = true;
        let behind = since_ns / self.cycle_ns.max(1);
        let skipped = behind.saturating_sub(MAX_PULSES);
        self.next_sync_ns = Some(next_ns.wrapping_add((skipped + 1) * self.cycle_ns));
        Some(now_ns.saturating_sub(since_ns.saturating_sub(skipped * self.cycle_ns)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drift_of_50_ppm_is_removed_by_the_loop() {
        let mut clock = Clock::new(1_000, 50.0);
        assert!(clock.local(1_000_001_000).abs_diff(1_000_050_000) <= 1);
        for millisecond in 1..2000_u64 {
            let now_ns = 1_000 + millisecond * 1_000_000;
            clock.compare(now_ns, (now_ns - 1_000) as u32);
        }
        let now_ns = 1_000 + 2_000 * 1_000_000;
        assert!(clock.system(now_ns).abs_diff(now_ns - 1_000) < 50, "{clock:?}");
        assert!(clock.difference() & 0x7FFF_FFFF < 50);
    }

    #[test]
    fn a_clock_that_does_not_follow_differs_by_its_drift() {
        for (drift_ppm, sign) in [(50.0, 0), (-50.0, 1)] {
            let mut clock = Clock::new(0, drift_ppm);
            clock.ignores_reference = true;
            for millisecond in 1..=1000_u64 {
                clock.compare(millisecond * 1_000_000, (millisecond * 1_000_000) as u32);
            }
            let difference = clock.difference();
            // 50 us after a second; the mean lags by three comparisons.
            assert!(
                (difference & 0x7FFF_FFFF).abs_diff(50_000) < 300,
                "{difference:x}"
            );
            assert_eq!(difference >> 31, sign, "bit 31: behind");
        }
    }

    #[test]
    fn clock_of_32_bits_continues_after_wrap() {
        let mut clock = Clock::new(0, 0.0);
        clock.is_short = true;
        let wrap_ns = 1 << 32;
        assert_eq!(clock.shown(clock.system(wrap_ns + 5)), 5);
        // The start is after the wrap of the register, with a pulse every ms from there on.
        clock.start_sync(wrap_ns - 2_000_000, 500_000, 1_000_000);
        let mut pulses = Vec::new();
        while let Some(at_ns) = clock.take_sync(wrap_ns + 3_000_000) {
            pulses.push(at_ns - wrap_ns);
        }
        assert_eq!(pulses, [500_000, 1_500_000, 2_500_000]);
    }

    #[test]
    fn sync_comes_once_a_cycle_from_its_start_on() {
        let mut clock = Clock::new(0, 0.0);
        clock.start_sync(0, 5_000_000, 1_000_000);
        let mut pulses = Vec::new();
        for now_ns in (0..10_000_000).step_by(300_000) {
            while let Some(at_ns) = clock.take_sync(now_ns) {
                pulses.push(at_ns);
            }
        }
        assert_eq!(pulses, [5_000_000, 6_000_000, 7_000_000, 8_000_000, 9_000_000]);
        clock.start_sync(20_000_000, 5_000_000, 1_000_000);
        assert!(!clock.has_sync(), "a start in the past");
    }
}

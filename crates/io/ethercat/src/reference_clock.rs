//! The time of the reference clock, whose register 0910h has 64 bits or 32.

/// The system time of the reference without wrap-around. A 32-bit clock wraps every 4.3 s, which is not a
/// whole number of periods: SYNC0 continues with the periods from before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ReferenceClock {
    time_ns: u64,
    /// Time of the last reading, by the clock of this computer.
    read_ns: u64,
}

impl ReferenceClock {
    /// Starts with the reading by which SYNC0 was set up; `now_ns` is of this computer's clock.
    pub(crate) const fn new(register: u64, now_ns: u64) -> Self {
        Self {
            time_ns: register,
            read_ns: now_ns,
        }
    }

    /// The time of a reading. The lower half is correct for both kinds of clocks; the upper half is chosen to
    /// match the time elapsed on this computer's clock: devices may take seconds to reach their next state,
    /// and two clocks differ by less than 2.1 s after hours.
    pub(crate) const fn take(&mut self, register: u64, now_ns: u64) -> u64 {
        let expected_ns = self.time_ns.wrapping_add(now_ns.wrapping_sub(self.read_ns));
        self.time_ns = same_time(register, expected_ns);
        self.read_ns = now_ns;
        self.time_ns
    }
}

/// Converts a time of one clock, at most 2.1 s away, to another clock with the same lower 32 bits, whose
/// register shows `now_ns`.
pub(crate) const fn same_time(time_ns: u64, now_ns: u64) -> u64 {
    let ahead_ns = (time_ns as u32).wrapping_sub(now_ns as u32).cast_signed();
    now_ns.wrapping_add_signed(ahead_ns as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_the_same_by_clocks_of_either_kind() {
        let end_ns = 1 << 32;
        let upper_ns = 7 * end_ns;
        // 200 ms ahead, with and without the end of the lower half in between.
        for now_ns in [1_000_000, end_ns - 5] {
            let ahead_ns = now_ns + 200_000_000;
            for reference_ns in [now_ns, upper_ns + now_ns] {
                let first_ns = reference_ns + 200_000_000;
                assert_eq!(same_time(first_ns, upper_ns + now_ns), upper_ns + ahead_ns);
                assert_eq!(same_time(first_ns, now_ns), ahead_ns);
            }
        }
    }

    const PERIOD_NS: u64 = 1_000_000;

    #[test]
    fn clocks_of_32_and_64_bits_keep_phase_of_frames() {
        let begin_ns = 77 * PERIOD_NS + 123_456;
        for mask in [u64::MAX, u64::from(u32::MAX)] {
            let mut clock = ReferenceClock::new(begin_ns & mask, 5000);
            // This computer's clock is faster by 100 ppm.
            let here_ns = |passed_ns: u64| 5000 + passed_ns + passed_ns / 10_000;
            // Twenty seconds, in which 32 bits wrap four times; one frame is late.
            for period in 1..20_000_u64 {
                let late_ns = if period == 5000 { 700 } else { 0 };
                let time_ns = begin_ns + period * PERIOD_NS + late_ns;
                let now_ns = here_ns(time_ns - begin_ns);
                assert_eq!(
                    clock.take(time_ns & mask, now_ns),
                    time_ns,
                    "{mask:x} at {period}"
                );
            }
            // Devices that take long to reach their next state, over one wrap and over three.
            for pause_ns in [3_000_000_000, 13_000_000_000] {
                let mut clock = ReferenceClock::new(begin_ns & mask, 5000);
                let time_ns = begin_ns + pause_ns;
                assert_eq!(clock.take(time_ns & mask, here_ns(pause_ns)), time_ns, "{mask:x}");
            }
        }
    }
}

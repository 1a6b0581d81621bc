//! The time of the reference clock, whose register 0910h has 64 bits or 32.

/// The system time of the reference without wrap-around. A clock of 32 bits begins again each 4.3 s, which is no whole number of periods:
/// SYNC0 goes on at the periods of the time before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ReferenceClock {
    low: u32,
    time_ns: u64,
}

impl ReferenceClock {
    /// From a first reading, by which SYNC0 was set up.
    pub(crate) const fn new(register: u64) -> Self {
        Self {
            low: register as u32,
            time_ns: register,
        }
    }

    /// The time of a reading, less than 2.1 s from the last one: the lower half is right for both kinds.
    pub(crate) const fn take(&mut self, register: u64) -> u64 {
        let step_ns = (register as u32).wrapping_sub(self.low).cast_signed();
        self.low = register as u32;
        self.time_ns = self.time_ns.wrapping_add_signed(step_ns as i64);
        self.time_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 1_000_000;

    #[test]
    fn a_clock_of_either_kind_keeps_the_phase_of_its_frames() {
        let begin_ns = 77 * PERIOD_NS + 123_456;
        for mask in [u64::MAX, u64::from(u32::MAX)] {
            let mut clock = ReferenceClock::new(begin_ns & mask);
            // Twenty seconds, in which 32 bits wrap four times; one frame is late.
            for period in 1..20_000_u64 {
                let late_ns = if period == 5000 { 700 } else { 0 };
                let time_ns = begin_ns + period * PERIOD_NS + late_ns;
                assert_eq!(clock.take(time_ns & mask), time_ns, "{mask:x} at {period}");
            }
        }
    }
}

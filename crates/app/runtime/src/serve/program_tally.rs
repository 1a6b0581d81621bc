//! Number of parts made with the program, and its run time.

/// Counts for the loaded program. Times are counted in setpoints.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ProgramTally {
    parts: u32,
    /// The last setpoint that was counted; `None` while the program does not run.
    seen: Option<u64>,
    cycles: u64,
    held_cycles: u64,
}

impl ProgramTally {
    /// The program begins after this setpoint.
    pub(crate) fn begin(&mut self, sequence: u64) {
        (self.seen, self.cycles, self.held_cycles) = (Some(sequence), 0, 0);
    }

    /// Counts up to the newest setpoint. `is_held`: the machine is at a hold or a program stop.
    pub(crate) fn observe(&mut self, sequence: u64, is_held: bool) {
        let Some(seen) = &mut self.seen else { return };
        let more = sequence.saturating_sub(*seen);
        *seen = sequence.max(*seen);
        self.cycles += more;
        self.held_cycles += if is_held { more } else { 0 };
    }

    /// The program is over; `is_done` if it reached its end.
    pub(crate) fn end(&mut self, is_done: bool) {
        if self.seen.take().is_some() && is_done {
            self.parts = self.parts.saturating_add(1);
        }
    }

    /// How often the program has reached its end since it was loaded.
    pub(crate) fn parts(&self) -> u32 {
        self.parts
    }

    /// Duration of the present or last run, and how much of it was spent at holds and program stops, s.
    pub(crate) fn times_s(&self, period_ns: u64) -> (f64, f64) {
        let seconds = |cycles: u64| cycles as f64 * period_ns as f64 * 1e-9;
        (seconds(self.cycles), seconds(self.held_cycles))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn completed_programs_are_parts_and_holds_are_timed() {
        let mut tally = ProgramTally::default();
        tally.observe(50, false);
        assert_eq!((tally.parts(), tally.times_s(1_000_000)), (0, (0.0, 0.0)));
        tally.begin(100);
        tally.observe(1100, false);
        tally.observe(1600, true);
        // An older view is ignored.
        tally.observe(1500, true);
        tally.observe(2100, false);
        tally.end(true);
        tally.observe(9000, false);
        tally.end(true);
        assert_eq!(tally.parts(), 1);
        let (time_s, held_s) = tally.times_s(1_000_000);
        assert!((time_s - 2.0).abs() < 1e-12 && (held_s - 0.5).abs() < 1e-12);
        tally.begin(9000);
        tally.observe(9500, false);
        tally.end(false);
        assert_eq!(tally.parts(), 1, "one that was stopped is none");
        assert!((tally.times_s(1_000_000).0 - 0.5).abs() < 1e-12);
    }
}

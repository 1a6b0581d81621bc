//! When the loop wakes, and when its setpoints are due.
//!
//! Setpoints carry their due time, so the loop need not wake for each: if a period is shorter than
//! [`MIN_WAKE_NS`], it wakes once for several setpoints and computes them in a row. The results depend only
//! on the cycle's number and its inputs, never on when the loop woke.

use crate::rt::MonotonicClock;

/// Minimum time between two wake-ups, ns. Tuned: 0.1 to 1 ms. Below, a plain kernel spends more time on
/// waking than on cycles (`cargo bench -p evolvent-runtime --bench figures`); above, a hold waits longer for
/// the next wake-up.
const MIN_WAKE_NS: u64 = 250_000;

/// A clock with a sleep.
pub(crate) trait Timer {
    fn now_ns(&mut self) -> u64;
    /// Sleeps until a moment; returns at once if it has passed.
    fn sleep_until(&mut self, moment_ns: u64);
}

/// `CLOCK_MONOTONIC`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RealTimer;

impl Timer for RealTimer {
    fn now_ns(&mut self) -> u64 {
        MonotonicClock::now_ns()
    }

    fn sleep_until(&mut self, moment_ns: u64) {
        let _late = MonotonicClock::sleep_until(moment_ns);
    }
}

/// A cycle that begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cycle {
    /// Its deadline at the control rate, ns.
    pub deadline_ns: u64,
    /// Due time of its setpoint, ns.
    pub due_ns: u64,
    /// When it began, ns; later than its deadline if it is computed in a row with others.
    pub begun_ns: u64,
    /// Lateness of the wake-up for its row, ns.
    pub lateness_ns: u64,
}

/// Deadlines of the cycles in real time.
#[derive(Clone, Debug)]
pub(crate) struct Pacing {
    period_ns: u64,
    lead_ns: u64,
    cycles_per_wake: u64,
    deadline_ns: u64,
    /// Number of cycles to compute before the next wake-up.
    left: u64,
    /// Lateness of the wake-up, ns.
    lateness_ns: u64,
}

impl Pacing {
    /// The first cycle begins two periods after this moment.
    pub(crate) fn new(now_ns: u64, period_ns: u64, lead_cycles: u32) -> Self {
        Self {
            period_ns,
            lead_ns: u64::from(lead_cycles) * period_ns,
            cycles_per_wake: cycles_per_wake(period_ns, lead_cycles),
            deadline_ns: now_ns + 2 * period_ns,
            left: 0,
            lateness_ns: 0,
        }
    }

    /// Waits for the next cycle to begin. The cycle may call it: at most one system call, no allocation.
    pub(crate) fn wait(&mut self, timer: &mut impl Timer) -> Cycle {
        let mut wake_ns = None;
        if self.left == 0 {
            self.left = self.cycles_per_wake;
            // The last deadline of the row: an input then takes effect with the next row, at most one row
            // after it arrived.
            let last_ns = self.deadline_ns + (self.cycles_per_wake - 1) * self.period_ns;
            timer.sleep_until(last_ns);
            wake_ns = Some(last_ns);
        }
        self.left -= 1;
        let begun_ns = timer.now_ns();
        if let Some(wake_ns) = wake_ns {
            self.lateness_ns = begun_ns.saturating_sub(wake_ns);
        }
        Cycle {
            deadline_ns: self.deadline_ns,
            due_ns: self.deadline_ns + self.lead_ns,
            begun_ns,
            lateness_ns: self.lateness_ns,
        }
    }

    /// Continues with the next cycle, whose deadline is corrected by this amount, ns; much less than a
    /// period.
    pub(crate) fn advance(&mut self, correction_ns: i64) {
        self.deadline_ns = (self.deadline_ns + self.period_ns).saturating_add_signed(correction_ns);
    }
}

/// Counts setpoints that are completed after their due time.
#[derive(Clone, Debug)]
pub(crate) struct LatenessCounter {
    max_in_a_row: u32,
    in_a_row: u32,
    total: u64,
}

impl LatenessCounter {
    /// `max_in_a_row` consecutive late setpoints are too many; 0 permits any number.
    pub(crate) fn new(max_in_a_row: u32) -> Self {
        Self {
            max_in_a_row,
            in_a_row: 0,
            total: 0,
        }
    }

    /// Counts the setpoint of a cycle that was completed at this moment. Returns whether it is late.
    pub(crate) fn count(&mut self, cycle: &Cycle, finished_ns: u64) -> bool {
        let is_late = finished_ns > cycle.due_ns;
        if is_late {
            self.total += 1;
            self.in_a_row = self.in_a_row.saturating_add(1);
        } else {
            self.in_a_row = 0;
        }
        is_late
    }

    /// Whether too many consecutive setpoints are late.
    pub(crate) fn is_too_late(&self) -> bool {
        self.max_in_a_row > 0 && self.in_a_row >= self.max_in_a_row
    }

    /// Number of late setpoints so far.
    pub(crate) fn total(&self) -> u64 {
        self.total
    }
}

/// Number of cycles computed per wake-up. The first of them loses at most a quarter of its lead.
pub(crate) fn cycles_per_wake(period_ns: u64, lead_cycles: u32) -> u64 {
    let row = MIN_WAKE_NS.div_ceil(period_ns.max(1));
    row.min(u64::from(lead_cycles) / 4).max(1)
}

/// Time between two wake-ups, ns.
pub(crate) fn wake_interval_ns(period_ns: u64, lead_cycles: u32) -> u64 {
    cycles_per_wake(period_ns, lead_cycles) * period_ns
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A timer that wakes late according to a list; reading the clock takes 1 us.
    struct Late {
        now_ns: u64,
        late_ns: Vec<u64>,
        sleeps: usize,
    }

    impl Timer for Late {
        fn now_ns(&mut self) -> u64 {
            self.now_ns += 1000;
            self.now_ns
        }

        fn sleep_until(&mut self, moment_ns: u64) {
            let late_ns = self.late_ns[self.sleeps % self.late_ns.len()];
            self.sleeps += 1;
            self.now_ns = self.now_ns.max(moment_ns + late_ns);
        }
    }

    fn cycles(period_ns: u64, count: u64, late_ns: &[u64]) -> (Vec<Cycle>, usize) {
        let mut timer = Late {
            now_ns: 5_000_000,
            late_ns: late_ns.to_vec(),
            sleeps: 0,
        };
        let mut pacing = Pacing::new(5_000_000, period_ns, 70);
        let mut cycles = Vec::new();
        for _ in 0..count {
            cycles.push(pacing.wait(&mut timer));
            pacing.advance(0);
        }
        (cycles, timer.sleeps)
    }

    #[test]
    fn due_times_do_not_depend_on_when_the_loop_wakes() {
        let period_ns = 28_571;
        let (cycles, sleeps) = cycles(period_ns, 900, &[0, 300_000, 40_000_000, 0, 1]);
        for (number, cycle) in cycles.iter().enumerate() {
            let deadline_ns = 5_000_000 + (number as u64 + 2) * period_ns;
            assert_eq!(
                (cycle.deadline_ns, cycle.due_ns),
                (deadline_ns, deadline_ns + 70 * period_ns)
            );
            let wake_ns = 5_000_000 + (number as u64 / 9 * 9 + 10) * period_ns;
            assert!(cycle.begun_ns >= wake_ns + cycle.lateness_ns);
        }
        assert_eq!(sleeps, 100);
    }

    #[test]
    fn a_row_is_computed_at_the_last_of_its_deadlines() {
        let (cycles, _) = cycles(28_571, 90, &[2000]);
        for row in cycles.chunks(9) {
            let wake_ns = row[8].deadline_ns;
            let is_in_time = |cycle: &Cycle| (wake_ns..wake_ns + 20_000).contains(&cycle.begun_ns);
            assert!(row.iter().all(is_in_time));
            assert!(row.iter().all(|cycle| cycle.lateness_ns == 3000));
        }
    }

    /// A hold at any moment takes effect with a setpoint that is due at most a lead and two cycles later.
    #[test]
    fn inputs_act_within_the_lead_and_two_cycles() {
        let period_ns = 28_571;
        let (cycles, _) = cycles(period_ns, 90, &[0]);
        for moment_ns in (6_000_000..7_000_000).step_by(1009) {
            let first = cycles.iter().find(|cycle| cycle.begun_ns > moment_ns).unwrap();
            assert!(first.due_ns < moment_ns + 72 * period_ns, "{moment_ns}");
        }
    }

    #[test]
    fn a_short_lead_is_not_spent_on_rows() {
        assert_eq!(cycles_per_wake(28_571, 2), 1);
        assert_eq!(cycles_per_wake(28_571, 8), 2);
        assert_eq!(cycles_per_wake(28_571, 1000), 9);
    }

    #[test]
    fn slow_rates_wake_for_every_cycle() {
        for (rate_hz, in_a_row) in [
            (250, 1),
            (1000, 1),
            (4000, 1),
            (4001, 2),
            (10_000, 3),
            (35_000, 9),
        ] {
            let period_ns = 1_000_000_000 / rate_hz;
            assert_eq!(cycles_per_wake(period_ns, 70), in_a_row, "{rate_hz} Hz");
            assert!((250_000..5_000_000).contains(&wake_interval_ns(period_ns, 70)));
        }
        assert_eq!(cycles(1_000_000, 50, &[0]).1, 50);
    }

    #[test]
    fn a_timely_setpoint_resets_the_count_of_late_ones() {
        let cycle = Cycle {
            deadline_ns: 1000,
            due_ns: 3000,
            begun_ns: 1100,
            lateness_ns: 100,
        };
        let (in_time_ns, late_ns) = (3000, 3001);
        let mut lateness = LatenessCounter::new(3);
        let mut never = LatenessCounter::new(0);
        let mut verdicts = Vec::new();
        for finished_ns in [
            late_ns, late_ns, in_time_ns, late_ns, late_ns, late_ns, in_time_ns,
        ] {
            let is_late = lateness.count(&cycle, finished_ns);
            assert_eq!(is_late, never.count(&cycle, finished_ns));
            assert_eq!(is_late, finished_ns == late_ns);
            assert!(!never.is_too_late());
            verdicts.push(lateness.is_too_late());
        }
        assert_eq!(verdicts, [false, false, false, false, false, true, false]);
        assert_eq!((lateness.total(), never.total()), (5, 5));
    }

    #[test]
    fn a_correction_moves_all_deadlines_behind_it() {
        let mut timer = Late {
            now_ns: 0,
            late_ns: vec![0],
            sleeps: 0,
        };
        let mut pacing = Pacing::new(0, 1_000_000, 2);
        pacing.advance(-1000);
        assert_eq!(pacing.wait(&mut timer).deadline_ns, 2_999_000);
        pacing.advance(500);
        assert_eq!(pacing.wait(&mut timer).due_ns, 5_999_500);
    }
}

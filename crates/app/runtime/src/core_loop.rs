//! The core loop of a run and of a served machine: cycle after cycle at the control rate.
//!
//! It handles deadlines, lateness, and the queues to bus and trace; a [`SetpointSource`] computes the motion.
//! While it runs it allocates nothing, locks nothing, and waits for nothing but its deadline. With the
//! virtual clock it also waits for the planner and for capacity in the queues, because its time is not real.

use evolvent_motion::{Setpoint, flags};
use evolvent_path::Jet;
use evolvent_trace::Histogram;
use rtrb::Producer;

use crate::cycle_sample::CycleSample;
use crate::due_setpoint::{DriveRequest, DueSetpoint, SpindleOverrides};
use crate::job::Clock;
use crate::pacing::{LatenessCounter, Pacing, RealTimer};
use crate::rt::MonotonicClock;

/// Iterations that a virtual run spins on a full queue before it yields to another thread.
const SPINS: u32 = 64;

/// Computes the motion. The cycle's thread calls all methods: they must not allocate, lock, log or wait.
pub(crate) trait SetpointSource {
    /// With the virtual clock, waits before a cycle until its plan is available.
    fn await_plan(&mut self);

    /// Computes the next setpoint. Outputs that change with it are passed on here, before the setpoint.
    fn step(&mut self, begin: &CycleBegin) -> Computed;

    /// Handles too many late setpoints in a row; `sequence` is the last of them.
    fn stop_for_lateness(&mut self, sequence: u64);

    /// Adds to the record what only the source knows.
    fn describe(&mut self, sample: &mut CycleSample);

    /// Ends the cycle, after the setpoint was passed on.
    fn finish(&mut self, end: &CycleEnd<'_>) -> Next;
}

/// The start of a cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CycleBegin {
    /// Number of cycles before it.
    pub number: u64,
    /// Its deadline at the control rate, ns; counted from 0 with the virtual clock.
    pub deadline_ns: u64,
}

/// A setpoint and its accompanying data.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Computed {
    pub setpoint: Setpoint,
    /// The setpoint sent to the drives, if it differs.
    pub corrected: Option<Jet>,
    pub drive: DriveRequest,
    /// The job of the program that it belongs to, or of the last program.
    pub job: u64,
    /// Whether it belongs to a program rather than to a jog, homing or rest.
    pub is_of_program: bool,
    /// Factor on the commanded speed of each spindle.
    pub spindle_overrides: SpindleOverrides,
    /// Spindles whose override the program has switched off.
    pub override_off_mask: u32,
    /// The inputs on which it depended, as bits of the trace.
    pub input_bits: u32,
}

/// A complete cycle, except [`SetpointSource::finish`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct CycleEnd<'a> {
    /// The setpoint as passed on.
    pub setpoint: &'a Setpoint,
    /// Lateness of the wake-up, ns.
    pub lateness_ns: u64,
    /// Time until the setpoint was computed, ns.
    pub work_ns: u64,
    /// Counts including this cycle.
    pub counts: &'a CycleCounts,
}

/// What follows a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Next {
    /// Another cycle, with this correction of its deadline, ns.
    Cycle { correction_ns: i64 },
    /// Nothing.
    End,
}

/// Counts of the loop.
#[derive(Clone, Debug, Default)]
pub(crate) struct CycleCounts {
    pub cycles: u64,
    /// Setpoints completed after their due time.
    pub late_cycles: u64,
    /// Records that did not fit into their queue.
    pub dropped_records: u64,
    /// Setpoints that did not fit into their queue.
    pub dropped_setpoints: u64,
    /// Lateness of the wake-ups.
    pub lateness: Histogram,
    /// Duration of a cycle, including the queues.
    pub work: Histogram,
}

/// Everything that the loop needs besides a source; built before it starts.
pub(crate) struct CoreLoop {
    pub clock: Clock,
    pub period_ns: u64,
    pub lead_cycles: u32,
    /// Number of consecutive late setpoints at which the core stops; 0 for never.
    pub max_late_cycles: u32,
    /// Unix time of the first setpoint.
    pub start_unix_ns: u64,
    pub bus: Option<Producer<DueSetpoint>>,
    pub trace: Option<Producer<CycleSample>>,
}

impl CoreLoop {
    /// Runs until the source ends.
    pub(crate) fn run(mut self, source: &mut impl SetpointSource) -> CycleCounts {
        let mut counts = CycleCounts::default();
        let is_realtime = self.clock == Clock::Realtime;
        let mut pacing = Pacing::new(MonotonicClock::now_ns(), self.period_ns, self.lead_cycles);
        let mut late = LatenessCounter::new(self.max_late_cycles);
        loop {
            let cycle = is_realtime.then(|| pacing.wait(&mut RealTimer));
            if cycle.is_none() {
                source.await_plan();
            }
            let path_time_ns = counts.cycles * self.period_ns;
            let computed = source.step(&CycleBegin {
                number: counts.cycles,
                deadline_ns: cycle.map_or(path_time_ns, |cycle| cycle.deadline_ns),
            });
            let mut setpoint = computed.setpoint;
            let lateness_ns = cycle.map_or(0, |cycle| cycle.lateness_ns);
            let mut work_ns = 0;
            if let Some(cycle) = cycle {
                let now_ns = MonotonicClock::now_ns();
                work_ns = now_ns.saturating_sub(cycle.begun_ns);
                counts.lateness.record(lateness_ns as i64);
                if late.count(&cycle, now_ns) {
                    setpoint.flags |= flags::LATE;
                }
                counts.late_cycles = late.total();
                if late.is_too_late() {
                    source.stop_for_lateness(setpoint.sequence);
                }
            }
            if let Some(bus) = &mut self.bus {
                let due = DueSetpoint {
                    setpoint,
                    corrected: computed.corrected,
                    due_time_ns: cycle.map_or(path_time_ns, |cycle| cycle.due_ns),
                    drive: computed.drive,
                    job: computed.job,
                    spindle_overrides: computed.spindle_overrides,
                    override_off_mask: computed.override_off_mask,
                    is_of_program: computed.is_of_program,
                };
                counts.dropped_setpoints += u64::from(!hand_over(bus, due, is_realtime));
            }
            if let Some(trace) = &mut self.trace {
                let due_unix_ns = self.start_unix_ns + setpoint.sequence * self.period_ns;
                let inputs = computed.input_bits;
                let mut sample = CycleSample::new(&setpoint, due_unix_ns, lateness_ns, work_ns, inputs);
                if let Some(corrected) = &computed.corrected {
                    sample.record.drive_position = corrected.position.into();
                }
                source.describe(&mut sample);
                counts.dropped_records += u64::from(!hand_over(trace, sample, is_realtime));
            }
            counts.cycles += 1;
            let next = source.finish(&CycleEnd {
                setpoint: &setpoint,
                lateness_ns,
                work_ns,
                counts: &counts,
            });
            if let Some(cycle) = cycle {
                // Includes the queues, whose time the record of the same cycle cannot contain yet.
                let whole_ns = MonotonicClock::now_ns().saturating_sub(cycle.begun_ns);
                counts.work.record(whole_ns as i64);
            }
            match next {
                Next::Cycle { correction_ns } => pacing.advance(correction_ns),
                Next::End => return counts,
            }
        }
    }
}

/// Passes an item on. In real time an item that does not fit is dropped; with the virtual clock this waits.
/// Returns whether the item was passed on.
pub(crate) fn hand_over<T>(queue: &mut Producer<T>, item: T, is_realtime: bool) -> bool {
    if !is_realtime {
        wait_until(|| !queue.is_full() || queue.is_abandoned());
    }
    queue.push(item).is_ok()
}

/// Waits for a condition, with the virtual clock only.
pub(crate) fn wait_until(mut is_ready: impl FnMut() -> bool) {
    let mut spins = 0;
    while !is_ready() {
        spins += 1;
        if spins < SPINS {
            std::hint::spin_loop();
        } else {
            std::thread::yield_now();
        }
    }
}

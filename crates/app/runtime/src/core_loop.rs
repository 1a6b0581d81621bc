//! The core loop: cycle after cycle at the control rate, of a run and of a served machine alike.
//!
//! Deadlines, lateness, and the hand-over to bus and trace are here; what the axes do is a
//! [`SetpointSource`]'s. Once it runs it allocates nothing, locks nothing, and waits for nothing but its
//! deadline (the virtual clock also waits for the planner and for room in the queues, because its time is not
//! real).

use evolvent_motion::{Setpoint, flags};
use evolvent_path::Jet;
use evolvent_trace::Histogram;
use rtrb::Producer;

use crate::cycle_sample::CycleSample;
use crate::due_setpoint::{DriveRequest, DueSetpoint, SpindleOverrides};
use crate::job::Clock;
use crate::pacing::{LatenessCounter, Pacing, RealTimer};
use crate::rt::MonotonicClock;

/// Cycles that a virtual run may spin on a full queue before it lets another thread run.
const SPINS: u32 = 64;

/// What moves the axes. Everything is called by the cycle's thread: nothing may allocate, lock, log or wait.
pub(crate) trait SetpointSource {
    /// Before a cycle whose time is not real: waits until the plan for it is there.
    fn await_plan(&mut self);

    /// The next setpoint. What counts with it, as outputs do, is handed over here: before the setpoint
    /// itself.
    fn step(&mut self, begin: &CycleBegin) -> Computed;

    /// Too many setpoints in a row are late; this is the last of them.
    fn stop_for_lateness(&mut self, sequence: u64);

    /// Adds to the record what only the source knows.
    fn describe(&mut self, sample: &mut CycleSample);

    /// After the hand-over.
    fn finish(&mut self, end: &CycleEnd<'_>) -> Next;
}

/// A cycle that begins.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CycleBegin {
    /// Cycles before it.
    pub number: u64,
    /// When it begins at the control rate, ns; from 0 on where time is not real.
    pub deadline_ns: u64,
}

/// A setpoint, and what goes with it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Computed {
    pub setpoint: Setpoint,
    /// What the drives are sent, where that is something else.
    pub corrected: Option<Jet>,
    pub drive: DriveRequest,
    /// The job to whose program it belongs, or to whose program the last one did.
    pub job: u64,
    /// Whether it belongs to a program, and not to a jog, to homing or to rest.
    pub is_of_program: bool,
    /// By what the commanded speed of each spindle is multiplied.
    pub spindle_overrides: SpindleOverrides,
    /// Spindles for which the program has switched that off.
    pub override_off_mask: u32,
    /// What it depended on, as bits of the trace.
    pub input_bits: u32,
}

/// A cycle that has ended, but for this.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CycleEnd<'a> {
    /// As it has left.
    pub setpoint: &'a Setpoint,
    /// By how much the loop woke late, ns.
    pub lateness_ns: u64,
    /// Time until the setpoint was there, ns.
    pub work_ns: u64,
    /// This cycle and those before.
    pub counts: &'a CycleCounts,
}

/// What follows a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Next {
    /// Another, whose deadline is corrected by this much, ns.
    Cycle { correction_ns: i64 },
    /// Nothing.
    End,
}

/// What the loop has counted.
#[derive(Clone, Debug, Default)]
pub(crate) struct CycleCounts {
    pub cycles: u64,
    /// Setpoints that were finished after they were due.
    pub late_cycles: u64,
    /// Records that found no room.
    pub dropped_records: u64,
    /// Setpoints that found no room.
    pub dropped_setpoints: u64,
    /// By how much the loop woke late.
    pub lateness: Histogram,
    /// What a cycle took, with the handing over.
    pub work: Histogram,
}

/// Everything that the loop needs beside a source; built before it starts.
pub(crate) struct CoreLoop {
    pub clock: Clock,
    pub period_ns: u64,
    pub lead_cycles: u32,
    /// Number of late setpoints in a row at which the core stops; 0: never.
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
                // With the handing over, which the cycle's own record cannot know yet.
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

/// In real time what finds no room is dropped; in virtual time there is time to wait. Whether it was handed
/// over.
pub(crate) fn hand_over<T>(queue: &mut Producer<T>, item: T, is_realtime: bool) -> bool {
    if !is_realtime {
        wait_until(|| !queue.is_full() || queue.is_abandoned());
    }
    queue.push(item).is_ok()
}

/// Waits, where time is not real.
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

//! What a trace recorded.

use std::path::Path;

use evolvent_trace::TraceFile;

use evolvent_disturbance::tell_pause;

/// One cycle of a trace.
pub type Cycle = evolvent_trace::CycleRecord;

/// Every cycle of a trace; it must be complete and without a gap.
///
/// # Panics
/// It is not.
#[must_use]
#[track_caller]
pub fn cycles(trace: &Path) -> Vec<Cycle> {
    let mut file = TraceFile::open(trace).expect("a complete trace");
    let found: Vec<Cycle> = file
        .cycles()
        .map(|cycle| cycle.expect("a readable cycle"))
        .collect();
    let latest = found.iter().map(|cycle| cycle.wake_lateness_ns).max();
    tell_pause(latest.map_or(0, |late| late.max(0).cast_unsigned()));
    for (index, cycle) in found.iter().enumerate() {
        // The recorder was kept from writing for longer than its queue lasts: about a millisecond for each record.
        tell_pause(cycle.sequence.saturating_sub(index as u64) * 1_000_000);
        assert_eq!(
            cycle.sequence,
            index as u64,
            "sequence numbers of {}",
            trace.display()
        );
    }
    found
}

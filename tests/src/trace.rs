//! What a trace recorded.

use std::path::Path;

use evolvent_trace::{TraceFile, inputs};

use evolvent_disturbance::tell_pause;

use crate::{Finished, evolvent};

/// A missed answer does not say by how much it was late: as much as explains a failure.
const LATE_PLANNER_NS: u64 = 50_000_000;

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
    // What the core itself counts as lost met a full queue: the recorder was kept from writing for at least a period each. A gap
    // that the core does not know of is a defect.
    let lost = file.info().summary_number("dropped_records").unwrap_or(0.0);
    tell_pause(lost as u64 * 1_000_000);
    let found: Vec<Cycle> = file
        .cycles()
        .map(|cycle| cycle.expect("a readable cycle"))
        .collect();
    let latest = found.iter().map(|cycle| cycle.wake_lateness_ns).max();
    tell_pause(latest.map_or(0, |late| late.max(0).cast_unsigned()));
    for (index, cycle) in found.iter().enumerate() {
        assert_eq!(
            cycle.sequence,
            index as u64,
            "sequence numbers of {}, {lost} records lost by its own count",
            trace.display()
        );
    }
    found
}

/// Tells a trial that the host kept the planner from answering in motion, as the core recorded it: from there on neither the feed
/// nor what `trace verify` computes is what an idle host gives, where it always answers in time.
pub fn tell_late_planner(cycles: &[Cycle]) {
    let is_late = |cycle: &Cycle| cycle.inputs & inputs::WAITED != 0 && cycle.feed_mm_s > 0.0;
    if cycles.iter().any(is_late) {
        tell_pause(LATE_PLANNER_NS);
    }
}

/// `trace verify` computes the same setpoints.
///
/// # Panics
/// It does not.
#[track_caller]
pub fn verifies(trace: &Path) {
    let output = evolvent().args(["trace", "verify"]).arg(trace).output();
    Finished::from(output.expect("the binary to start")).expect_code(&[0]);
}

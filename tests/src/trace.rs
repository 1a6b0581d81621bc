//! The contents of a trace.

use std::path::Path;

use evolvent_trace::TraceFile;

use evolvent_disturbance::report_pause;

use crate::{Finished, evolvent};

/// One cycle of a trace.
pub type Cycle = evolvent_trace::CycleRecord;

/// Every cycle of a trace, which must be complete and without a gap.
///
/// # Panics
/// If it is not.
#[must_use]
#[track_caller]
pub fn cycles(trace: &Path) -> Vec<Cycle> {
    let mut file = TraceFile::open(trace).expect("a complete trace");
    // Records that the core counts as lost met a full queue: the recorder could not write for at least one
    // period each. A gap that the core does not count is a defect.
    let lost = file.info().summary_number("dropped_records").unwrap_or(0.0);
    report_pause(lost as u64 * 1_000_000);
    let found: Vec<Cycle> = file
        .cycles()
        .map(|cycle| cycle.expect("a readable cycle"))
        .collect();
    let latest = found.iter().map(|cycle| cycle.wake_lateness_ns).max();
    report_pause(latest.map_or(0, |late| late.max(0).cast_unsigned()));
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

/// Asserts that `trace verify` computes the same setpoints.
///
/// # Panics
/// If it does not.
#[track_caller]
pub fn verifies(trace: &Path) {
    let output = evolvent().args(["trace", "verify"]).arg(trace).output();
    Finished::from(output.expect("the binary to start")).expect_code(&[0]);
}

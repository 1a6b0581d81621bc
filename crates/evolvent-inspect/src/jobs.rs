//! The jobs of a served machine, as its trace tells of them.

use std::collections::VecDeque;

use evolvent_daemon::JobStart;
use evolvent_machine::Machine;
use evolvent_path::Axes;
use evolvent_trace::{EventKind, ReadError, TraceFile};

/// A job, and the cycle with which it begins.
#[derive(Clone, Debug)]
pub(crate) struct Start {
    pub(crate) sequence: u64,
    pub(crate) job: u32,
    /// `None` where this version does not understand it.
    pub(crate) start: Option<JobStart>,
}

/// Another travel, and the cycle from which it counts.
pub(crate) type Travel = (u64, Axes, Axes);

/// Every job in order; none for a run of one program.
pub(crate) fn starts(trace: &mut TraceFile) -> Result<VecDeque<Start>, ReadError> {
    let mut starts = VecDeque::new();
    for event in trace.events() {
        let event = event?;
        if event.kind == EventKind::Job {
            starts.push_back(Start {
                sequence: event.sequence,
                job: event.code,
                start: JobStart::parse(&event.text),
            });
        }
    }
    Ok(starts)
}

/// Cycles with which the operator switched something that counts for lines not yet read: single step, optional stop, block
/// delete, rapid override. How far the planner had read is not recorded.
pub(crate) fn switched(trace: &mut TraceFile) -> Result<Vec<u64>, ReadError> {
    // By their words: commands of the program bear their line as code.
    const SWITCHES: [&str; 5] = [
        "step",
        "single step",
        "optional stop",
        "block delete",
        "rapid override",
    ];
    let mut switched = Vec::new();
    for event in trace.events() {
        let event = event?;
        let is_switch = SWITCHES.iter().any(|words| event.text.starts_with(words));
        if event.kind == EventKind::Command && is_switch {
            switched.push(event.sequence);
        }
    }
    Ok(switched)
}

/// The travel that a job may use, from its first cycle on: an axis that is not homed may be jogged its travel's length.
pub(crate) fn travel_of(start: &Start, machine: &Machine) -> Travel {
    let limits = machine.limits();
    match &start.start {
        Some(JobStart::Steered(steered)) => (
            start.sequence,
            limits.travel_min.inf(&steered.travel_min),
            limits.travel_max.sup(&steered.travel_max),
        ),
        _ => (start.sequence, limits.travel_min, limits.travel_max),
    }
}

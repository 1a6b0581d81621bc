//! The jobs of a served machine in its trace.

use std::collections::{BTreeMap, VecDeque};

use evolvent_machine::Machine;
use evolvent_path::Axes;
use evolvent_runtime::{JobStart, Switched};
use evolvent_trace::{EventKind, ReadError, TraceFile};

/// The name of a block of MDI.
pub(crate) const MDI: &str = "MDI";

/// A job, and its first cycle.
#[derive(Clone, Debug)]
pub struct RecordedJob {
    /// Number of its first cycle.
    pub sequence: u64,
    /// The job's number, from 1.
    pub job: u32,
    /// `None` if this version does not understand it.
    pub start: Option<JobStart>,
    /// Changes of switches while its program was read, in order.
    pub switched: VecDeque<Switched>,
}

impl RecordedJob {
    /// A description of the job.
    #[must_use]
    pub fn name(&self) -> String {
        match &self.start {
            Some(JobStart::Program(program)) if program.is_mdi => MDI.to_owned(),
            Some(JobStart::Program(program)) => {
                let name = program.program.rsplit('/').next().unwrap_or_default();
                format!("program {name}")
            }
            Some(JobStart::Steered(_) | JobStart::Retrace { .. }) => "jog or homing".to_owned(),
            None => "of another version".to_owned(),
        }
    }

    /// Whether it is a program or a block of MDI.
    #[must_use]
    pub const fn is_program(&self) -> bool {
        matches!(self.start, Some(JobStart::Program(_)))
    }
}

/// Another travel, and the cycle from which it applies.
pub type TravelFrom = (u64, Axes, Axes);

/// Every job in order; none for a run of one program.
///
/// # Errors
/// The trace cannot be read.
pub fn recorded_jobs(trace: &mut TraceFile) -> Result<VecDeque<RecordedJob>, ReadError> {
    let mut starts = VecDeque::new();
    let mut switched: BTreeMap<u32, VecDeque<Switched>> = BTreeMap::new();
    for event in trace.events() {
        let event = event?;
        match event.kind {
            EventKind::Job => starts.push_back(RecordedJob {
                sequence: event.sequence,
                job: event.code,
                start: JobStart::parse(&event.text),
                switched: VecDeque::new(),
            }),
            // A planner reads ahead: this may precede the start of the job.
            EventKind::Switched => {
                let list = switched.entry(event.code).or_default();
                list.extend(Switched::parse(&event.text));
            }
            _ => {}
        }
    }
    for start in &mut starts {
        start.switched = switched.remove(&start.job).unwrap_or_default();
    }
    Ok(starts)
}

/// The travel of a job from its first cycle on. An axis that is not homed may be jogged by the length of its
/// travel.
#[must_use]
pub fn travel_of(start: &RecordedJob, machine: &Machine) -> TravelFrom {
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

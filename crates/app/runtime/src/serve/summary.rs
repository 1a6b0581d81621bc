//! What serving came to.

use evolvent_trace::PhaseFigures;

/// What serving came to.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ServeSummary {
    /// The machine's name.
    pub machine: String,
    /// Setpoints.
    pub cycles: u64,
    /// The control rate.
    pub rate_hz: f64,
    /// Jobs begun.
    pub jobs: u64,
    /// Commands accepted.
    pub commands_accepted: u64,
    /// Commands rejected.
    pub commands_rejected: u64,
    /// Setpoints that left after they were due.
    pub late_cycles: u64,
    /// Readers of setpoints and bridges that were connected at the same time, at most. Late setpoints count
    /// for the exit code only where there was one.
    pub listeners: u64,
    /// Trace records lost.
    pub dropped_records: u64,
    /// Setpoints lost on the way to the bus.
    pub dropped_setpoints: u64,
    /// How the cycle followed the drives' clock once the lock had settled; none where it followed none, or
    /// not for long enough.
    pub clock: Option<PhaseFigures>,
    /// Alarms in force at the end.
    pub alarms: Vec<u32>,
    /// The trace file, if one was written.
    pub trace: Option<String>,
    /// What the user should know.
    pub notes: Vec<String>,
}

//! The summary of a service.

use evolvent_trace::PhaseFigures;

/// The summary of a service.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ServeSummary {
    /// The machine's name.
    pub machine: String,
    /// Number of setpoints.
    pub cycles: u64,
    /// The control rate.
    pub rate_hz: f64,
    /// Number of jobs begun.
    pub jobs: u64,
    /// Number of commands accepted.
    pub commands_accepted: u64,
    /// Number of commands rejected.
    pub commands_rejected: u64,
    /// Setpoints published after their due time.
    pub late_cycles: u64,
    /// Maximum number of readers of setpoints and bridges connected at the same time. Late setpoints affect
    /// the exit code only if there was one.
    pub listeners: u64,
    /// Trace records lost.
    pub dropped_records: u64,
    /// Setpoints lost on the way to the bus.
    pub dropped_setpoints: u64,
    /// How the cycle followed the drives' clock once the lock had settled; `None` if it followed none, or not
    /// for long enough.
    pub clock: Option<PhaseFigures>,
    /// Alarms in force at the end.
    pub alarms: Vec<u32>,
    /// The trace file, if one was written.
    pub trace: Option<String>,
    /// Notes to the user.
    pub notes: Vec<String>,
}

//! `job_result` of the status.

use evolvent_control::JobResult;

/// The job ran to its end.
pub const DONE: u32 = JobResult::Done as u32;
/// It was stopped.
pub const STOPPED: u32 = JobResult::Stopped as u32;
/// It ended at an error of the program.
pub const FAILED: u32 = JobResult::Failed as u32;
/// It ended by a fault.
pub const FAULT: u32 = JobResult::Fault as u32;

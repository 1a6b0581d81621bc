//! Threads and clocks: the real-time loop, planner feeding, publisher, recorder.

mod doctor;
mod rt;

pub use doctor::{BareLoopError, DoctorReport, Finding, LatenessReport, Verdict, bare_loop, examine};
pub use rt::{LowLatencyHold, MonotonicClock, RealtimeGranted, RealtimeRequest, apply_to_this_thread};

//! Reading traces, months later and on another computer.
//!
//! ```text
//!   trace ──► Opened (run, machine, program) ──► report   one page with verdict and pictures
//!                                              ├► export   CSV or Parquet
//!                                              └► compare  two runs by place on the path
//! ```
//!
//! Everything goes through a trace once, cycle by cycle, and keeps what it needs: an hour at 1 kHz takes megabytes, not
//! gigabytes. [`Opened`] holds what is attached to a trace. [`LimitCheck`] differentiates positions and holds them
//! against the machine's limits; it knows nothing of plans. [`LineTimes`] adds up, line by line, where time went and
//! what limited it. [`Pyramid`] thins a curve out so that no extreme is lost.
//!
//! Nothing here writes to a trace, starts a thread or is for the real-time cycle. Recorded runs are driven again by
//! `evolvent-replay`.

mod check;
mod columns;
mod compare;
mod export;
mod jobs;
mod lines;
mod opened;
mod parquet;
mod pyramid;
mod report;
mod selection;

pub use check::{LimitCheck, Worst};
pub use compare::{Comparison, LineDifference, compare};
pub use export::{ExportError, ExportFormat, Exported, export};
pub use jobs::{RecordedJob, TravelFrom, recorded_jobs, travel_of};
pub use lines::{Limit, LineTime, LineTimes};
pub use opened::{InspectError, Opened, before_tool_changes};
pub use pyramid::{Level, Pyramid};
pub use report::{ReportError, write_report};
pub use selection::{ExportChannel, Selection};

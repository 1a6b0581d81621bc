//! Reading traces, months later and on another computer.
//!
//! ```text
//!   trace ──► Opened (run, machine, program) ──► report   one page with verdict and pictures
//!                                              ├► export   CSV or Parquet
//!                                              └► compare  two runs by path length
//! ```
//!
//! Every function reads a trace once, cycle by cycle, and keeps only its result: an hour at 1 kHz takes
//! megabytes, not gigabytes. [`Opened`] has the attachments of a trace. [`LimitCheck`] differentiates
//! positions and checks them against the machine's limits, independent of plans. [`LineTimes`] sums up the
//! time of each line, and its limits. [`Pyramid`] reduces a curve without losing an extreme:
//!
//! ```
//! use evolvent_inspect::Pyramid;
//!
//! let mut curve = Pyramid::new(16);
//! for sample in 0..1000 {
//!     curve.push(if sample == 700 { 5.0 } else { 0.0 });
//! }
//! assert!(curve.stretches().len() <= 16);
//! let level = curve.level();
//! assert_eq!((level.least, level.greatest), (0.0, 5.0));
//! ```
//!
//! This crate does not write to a trace, start a thread or run in the real-time cycle. `evolvent-replay`
//! replays and recomputes recorded runs.

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
pub use compare::{ComparedRun, Comparison, LineDifference, compare, compare_runs};
pub use export::{ExportError, ExportFormat, Exported, export};
pub use jobs::{RecordedJob, TravelFrom, recorded_jobs, travel_of};
pub use lines::{LineTime, LineTimes};
pub use opened::{InspectError, Opened, before_tool_changes};
pub use pyramid::{Level, Pyramid};
pub use report::{ReportError, report_data, report_page, write_report};
pub use selection::{ExportChannel, Selection};

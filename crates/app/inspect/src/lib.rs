//! Reading traces, months later and on another computer.
//!
//! ```text
//!   trace ──► Opened (run, machine, program) ──► report   one page with verdict and pictures
//!                                              ├► export   CSV or Parquet
//!                                              ├► compare  two runs by place on the path
//!                                              ├► verify   the run computed again, bit for bit
//!                                              └► replay   the setpoints on the bus again
//! ```
//!
//! Everything goes through a trace once, cycle by cycle, and keeps what it needs: an hour at 1 kHz takes megabytes, not
//! gigabytes. [`Opened`] holds what is attached to a trace. [`LimitCheck`] differentiates positions and holds them
//! against the machine's limits; it knows nothing of plans. [`LineTimes`] adds up, line by line, where time went and
//! what limited it. [`Pyramid`] thins a curve out so that no extreme is lost.
//!
//! Nothing here writes to a trace, and nothing is for the real-time cycle.

mod check;
mod columns;
mod compare;
mod export;
mod jobs;
mod lines;
mod opened;
mod parquet;
mod pyramid;
mod replay;
mod report;
mod selection;
mod verify;

pub use check::{LimitCheck, Worst};
pub use compare::{Comparison, LineDifference, compare};
pub use export::{ExportError, ExportFormat, Exported, export};
pub use lines::{Limit, LineTime, LineTimes};
pub use opened::{InspectError, Opened};
pub use pyramid::{Level, Pyramid};
pub use replay::{Pace, Replay, ReplayError, Replayed, replay};
pub use report::{ReportError, write_report};
pub use selection::{ExportChannel, Selection};
pub use verify::{Difference, Verified, verify};

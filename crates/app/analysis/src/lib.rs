//! What limits a plan and why a line is slow; control rates, hole milling, chatter and turning trials.
//!
//! | type | input | result |
//! |---|---|---|
//! | [`LimitClassifier`] | a setpoint, its feed word | the active limit |
//! | [`FeedWords`] | a program | the feed word of each block |
//! | [`LineExplainer`] | the setpoints of a plan | why a line is slow, and what would help, measured |
//! | [`NeededRate`], [`LongestStopReport`] | the setpoints of a plan | the required control rate; the longest hold |
//! | [`PlanFigure`] | the setpoints of a plan | path and axes over time, as SVG |
//! | [`RateReport`], [`ChordQuestion`] | limits of a machine | the rational control rate; chord and chord error |
//! | [`BoreProgram`] | a hole and a tool | a part program along involutes, and its comparison with other paths |
//! | [`ChatterAnswer`], [`chatter_warnings`] | a case file | whether a cut vibrates; lines of a program that would |
//! | [`TurningTrial`] | a job of load-adaptive turning | its passes and figures on a simulated stock |
//!
//! A hole of 60 mm with a tool of 20 mm, roughed along an involute of 4 mm per turn:
//!
//! ```
//! use evolvent_analysis::{BoreProgram, BoreRequest, BoreRoughing};
//! use evolvent_path::{HoleStart, Milling};
//!
//! let program = BoreProgram::new(BoreRequest {
//!     hole_mm: 60.0,
//!     tool_mm: 20.0,
//!     milling: Milling::Climb,
//!     centre_mm: [0.0, 0.0],
//!     top_mm: 0.0,
//!     depth_mm: 5.0,
//!     step_mm: None,
//!     safe_mm: 5.0,
//!     roughing: Some(BoreRoughing {
//!         pitch_mm: 4.0,
//!         turns: None,
//!         allowance_mm: 0.0,
//!         start: HoleStart::Centre,
//!     }),
//!     finishing: None,
//!     feed_mm_min: 1000.0,
//!     finish_feed_mm_min: None,
//!     plunge_feed_mm_min: 200.0,
//!     spindle_rpm: 3000.0,
//!     tool_number: None,
//!     tolerance_mm: None,
//! })?;
//! assert!(program.text().contains("G3.2 "));
//! # Ok::<(), evolvent_analysis::BoreError>(())
//! ```
//!
//! This crate is not for the real-time cycle. `evolvent-runtime` makes the plans with the virtual clock, so
//! the same input gives the same result. User-written files are read within a time limit; an error in them is
//! an [`AnalysisError::Input`] with file and position. The `evolvent` command prints the results of these
//! types.

mod bore;
mod chatter;
mod error;
mod explain;
mod feed_words;
mod figure;
mod limiting;
mod load_setup;
mod longest_stop;
mod needed_rate;
mod process;
mod rate;
mod scratch;
mod turn;
mod unobserved;
mod user_file;

pub use bore::{BoreComparison, BoreError, BoreFinishing, BoreProgram, BoreRequest, BoreRoughing};
pub use chatter::{
    ChatterAnswer, ChatterKick, ChatterRequest, ChatterWarning, ChatterWarnings, chatter_warnings,
    read_chatter_case,
};
pub use error::AnalysisError;
pub use explain::{Explanation, LineExplainer};
pub use feed_words::FeedWords;
pub use figure::PlanFigure;
pub use limiting::{LimitClassifier, LimitRatios, Limiting, Order};
pub use load_setup::load_setup;
pub use longest_stop::LongestStopReport;
pub use needed_rate::NeededRate;
pub use process::{install_process_file, read_adaptive, read_process, sort_process_files};
pub use rate::{ChordPoint, ChordQuestion, ChordQuestionError, RateReport};
pub use turn::{TurningRoute, TurningTrial};
pub use user_file::read_text;

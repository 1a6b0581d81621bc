//! Load-adaptive turning on a simulated workpiece, its report, and the passes as a part program.

mod passes;
mod report;
mod summary;
mod trial;

pub use trial::{TurningRoute, TurningTrial};

//! How a program begins in the middle.

use serde::Serialize;
use ts_rs::TS;

/// What START with a line does before the line.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct RestartInfo {
    /// The line that is executed first: later than asked for where that is inside a subroutine.
    pub line: u32,
    /// Modes, feed, speed, tool and coolant in force there.
    pub modes: String,
    /// Where the program supposes the tool to be, machine coordinates in the order of the machine's axes: mm,
    /// degrees.
    pub position: Vec<f64>,
    /// The way there from where the machine stands, step by step.
    pub steps: Vec<String>,
    /// Why the program cannot begin there; empty where it can.
    pub problem: String,
}

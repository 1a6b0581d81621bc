//! Offsets and tools as the core keeps them.

use serde::Serialize;
use ts_rs::TS;

/// A work coordinate system.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct WorkOffset {
    /// 1 for G54 to 9 for G59.3.
    pub system: u32,
    /// Origin in machine coordinates, in the order of the machine's axes: mm, degrees.
    pub values: Vec<f64>,
    /// Rotation of X and Y about Z (G10 L2 R), degrees.
    pub rotation_deg: f64,
}

/// A line of the tool table.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct ToolEntry {
    /// From 1.
    pub number: u32,
    /// In the order of the machine's axes: mm, degrees.
    pub offsets: Vec<f64>,
    /// In mm; 0 if unknown.
    pub diameter: f64,
    /// Orientation of the tip of a turning tool, 1 to 9; 0 for a mill.
    pub orientation: u32,
    /// Front and back angle of a turning tool, degrees.
    pub angles_deg: [f64; 2],
    /// What the table says of it.
    pub comment: String,
}

//! One spindle, for pages.

use evolvent_wire::SpindleReading;
use serde::Serialize;
use ts_rs::TS;

/// A spindle as the status has it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, TS)]
pub struct SpindleStatus {
    /// Its number.
    pub number: u32,
    /// The present command, rpm, on its ramp, with its override; negative counter-clockwise.
    pub command_rpm: f64,
    /// The measured speed, rpm, negative counter-clockwise; null if it is not known.
    pub measured_rpm: Option<f64>,
    /// Whether the spindle override counts for it.
    pub override_counts: bool,
}

impl From<SpindleReading> for SpindleStatus {
    fn from(reading: SpindleReading) -> Self {
        Self {
            number: reading.number,
            command_rpm: reading.command_rpm,
            measured_rpm: reading.measured_rpm,
            override_counts: reading.counts_override,
        }
    }
}

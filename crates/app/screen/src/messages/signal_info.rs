//! Inputs and outputs as the machine file describes them, and their values.

use evolvent_machine::{InputSettings, OutputSettings, SignalKind};
use serde::Serialize;
use ts_rs::TS;

/// An input or output.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct SignalInfo {
    /// Its name in the machine file.
    pub name: String,
    /// `digital` or `analog`.
    #[ts(type = "'digital' | 'analog'")]
    pub kind: &'static str,
    /// Number in programs and on the bus.
    pub number: u32,
    /// Minimum and maximum value of an analog one.
    pub range: [f64; 2],
}

impl SignalInfo {
    fn new(name: &str, kind: SignalKind, number: u32, range: [f64; 2]) -> Self {
        Self {
            name: name.to_owned(),
            kind: kind.name(),
            number,
            // Without limits in the machine file they are infinite, which JSON cannot represent.
            range: range.map(|limit| limit.clamp(f64::MIN, f64::MAX)),
        }
    }
}

impl From<&InputSettings> for SignalInfo {
    fn from(input: &InputSettings) -> Self {
        Self::new(&input.name, input.kind, input.number, input.range)
    }
}

impl From<&OutputSettings> for SignalInfo {
    fn from(output: &OutputSettings) -> Self {
        Self::new(&output.name, output.kind, output.number, output.range)
    }
}

/// Present values, in the order of the machine file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, TS)]
pub struct SignalValues {
    /// 0 and 1 for a digital one; null if unknown.
    pub inputs: Vec<Option<f64>>,
    /// As commanded; null while no core sends them.
    pub outputs: Vec<Option<f64>>,
    /// Speed that is commanded for each spindle, rpm, negative counter-clockwise; null if unknown.
    pub spindles_rpm: Vec<Option<f64>>,
    /// State of the probe; null without one.
    #[ts(type = "'none' | 'open' | 'tripped' | null")]
    pub probe: Option<String>,
}

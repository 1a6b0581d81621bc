//! The handwheel: the inputs of its counts, its axis and its step.

use evolvent_path::AxisLetter;
use schemars::JsonSchema;
use serde::Deserialize;

/// Maximum number of steps of a handwheel.
pub const MAX_WHEEL_STEPS: usize = 8;

/// The handwheel as written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct HandwheelFile {
    /// Name of the analog input with the counts of the wheel since the start of the bridge, increasing or decreasing without wrap.
    pub(crate) counts: String,
    /// Counts per detent of the wheel. Default: 4, as usual for encoders of handwheels.
    #[schemars(range(min = 1, max = 10000))]
    pub(crate) counts_per_detent: Option<f64>,
    /// Travel of a linear axis per detent, mm. Default: 0.001, 0.01 and 0.1.
    #[schemars(length(min = 1, max = 8))]
    pub(crate) steps_mm: Option<Vec<f64>>,
    /// Travel of a rotary axis per detent, degrees, as many values as `steps_mm`. Default: the same numbers.
    #[schemars(length(min = 1, max = 8))]
    pub(crate) steps_deg: Option<Vec<f64>>,
    /// Digital inputs of the axis selector: `{ X = "wheel-x", Y = "wheel-y" }`. Default: commands select the axis.
    #[serde(default)]
    pub(crate) axis_inputs: std::collections::BTreeMap<String, String>,
    /// Digital inputs of the step selector, as many as `steps_mm`. Default: commands select the step.
    #[serde(default)]
    pub(crate) step_inputs: Vec<String>,
    /// Digital input of the enabling switch: the axis moves only while it is on, and stops when it is released.
    pub(crate) enable_input: Option<String>,
}

/// The handwheel.
#[derive(Clone, Debug, PartialEq)]
pub struct HandwheelSettings {
    /// Number of the analog input with the counts.
    pub counts: u32,
    /// Counts per detent.
    pub counts_per_detent: f64,
    /// Travel of a linear axis per detent, mm.
    pub steps_mm: Vec<f64>,
    /// Travel of a rotary axis per detent, degrees; as many values.
    pub steps_deg: Vec<f64>,
    /// Digital inputs that select the axis; empty if commands select it.
    pub axis_inputs: Vec<(AxisLetter, u32)>,
    /// Digital inputs that select the step; empty if commands select it.
    pub step_inputs: Vec<u32>,
    /// Digital input that enables motion.
    pub enable_input: Option<u32>,
}

impl HandwheelSettings {
    /// Travel of an axis per detent with the step of this index, mm or degrees; `None` if the step does not
    /// exist.
    #[must_use]
    pub fn step(&self, axis: AxisLetter, number: usize) -> Option<f64> {
        let steps = if axis.is_rotary() {
            &self.steps_deg
        } else {
            &self.steps_mm
        };
        steps.get(number).copied()
    }
}

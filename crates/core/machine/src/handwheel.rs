//! The handwheel: which inputs tell its counts, its axis and its step.

use evolvent_path::AxisLetter;
use schemars::JsonSchema;
use serde::Deserialize;

/// Steps of a handwheel at most.
pub const MAX_WHEEL_STEPS: usize = 8;

/// The handwheel as it is written.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct HandwheelFile {
    /// Name of the analog input that tells the wheel's counts since the bridge began; they go on in both directions.
    pub(crate) counts: String,
    /// Counts from one detent of the wheel to the next; 4 where it is not given, as encoders of wheels have.
    #[schemars(range(min = 1, max = 10000))]
    pub(crate) counts_per_detent: Option<f64>,
    /// Way of a linear axis a detent, mm: 0.001, 0.01 and 0.1 where it is not given.
    #[schemars(length(min = 1, max = 8))]
    pub(crate) steps_mm: Option<Vec<f64>>,
    /// Way of a rotary axis a detent, degrees, as many as `steps_mm`; the same numbers where it is not given.
    #[schemars(length(min = 1, max = 8))]
    pub(crate) steps_deg: Option<Vec<f64>>,
    /// Digital inputs of the axis selector: `{ X = "wheel-x", Y = "wheel-y" }`. Where it is not given the axis is chosen by command.
    #[serde(default)]
    pub(crate) axis_inputs: std::collections::BTreeMap<String, String>,
    /// Digital inputs of the step selector, as many as `steps_mm`. Where it is not given the step is chosen by command.
    #[serde(default)]
    pub(crate) step_inputs: Vec<String>,
    /// Digital input of the enabling button: the axis moves only while it is on, and stops when it is let go.
    pub(crate) enable_input: Option<String>,
}

/// The handwheel.
#[derive(Clone, Debug, PartialEq)]
pub struct HandwheelSettings {
    /// Number of the analog input with its counts.
    pub counts: u32,
    /// Counts from one detent to the next.
    pub counts_per_detent: f64,
    /// Way of a linear axis a detent, mm.
    pub steps_mm: Vec<f64>,
    /// Way of a rotary axis a detent, degrees; as many.
    pub steps_deg: Vec<f64>,
    /// Digital inputs that choose the axis; none where commands do.
    pub axis_inputs: Vec<(AxisLetter, u32)>,
    /// Digital inputs that choose the step; none where commands do.
    pub step_inputs: Vec<u32>,
    /// Digital input without which nothing moves.
    pub enable_input: Option<u32>,
}

impl HandwheelSettings {
    /// Way of an axis a detent with a step of this number, mm or degrees; none where there is no such step.
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

//! The handwheel of the machine.

use evolvent_machine::HandwheelSettings;
use serde::Serialize;
use ts_rs::TS;

/// What can be selected by command.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct HandwheelInfo {
    /// Distances of a linear axis per detent, mm.
    pub steps_mm: Vec<f64>,
    /// Distances of a rotary axis per detent, degrees.
    pub steps_deg: Vec<f64>,
    /// Switches of the handwheel select the axis, and commands cannot.
    pub switches_select_axis: bool,
    /// Switches of the handwheel select the step, and commands cannot.
    pub switches_select_step: bool,
}

impl From<&HandwheelSettings> for HandwheelInfo {
    fn from(wheel: &HandwheelSettings) -> Self {
        Self {
            steps_mm: wheel.steps_mm.clone(),
            steps_deg: wheel.steps_deg.clone(),
            switches_select_axis: !wheel.axis_inputs.is_empty(),
            switches_select_step: !wheel.step_inputs.is_empty(),
        }
    }
}

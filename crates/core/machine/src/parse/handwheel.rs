//! Checks the handwheel against axes and inputs.

use evolvent_path::AxisLetter;

use super::Check;
use crate::error::MachineError;
use crate::file::MachineFile;
use crate::handwheel::{HandwheelSettings, MAX_WHEEL_STEPS};
use crate::machine::Axis;
use crate::signals::{InputSettings, SignalKind};

/// Default travel per detent, mm or degrees: the steps of common handwheels.
const DEFAULT_STEPS: [f64; 3] = [0.001, 0.01, 0.1];

impl Check<'_> {
    pub(super) fn handwheel(
        &self,
        raw: &MachineFile,
        axes: &[Axis],
        inputs: &[InputSettings],
    ) -> Result<Option<HandwheelSettings>, MachineError> {
        let Some(wheel) = &raw.handwheel else {
            return Ok(None);
        };
        let counts = self.input_of_kind("handwheel.counts", &wheel.counts, inputs, SignalKind::Analog)?;
        let steps_mm = self.steps("handwheel.steps_mm", wheel.steps_mm.as_deref(), &DEFAULT_STEPS)?;
        let steps_deg = self.steps("handwheel.steps_deg", wheel.steps_deg.as_deref(), &steps_mm)?;
        if steps_deg.len() != steps_mm.len() {
            let what = format!("{} steps, and steps_mm has {}", steps_deg.len(), steps_mm.len());
            return Err(self.error("handwheel.steps_deg", what, "give as many steps as steps_mm has"));
        }
        let mut axis_inputs = Vec::new();
        for (letter, name) in &wheel.axis_inputs {
            let key = format!("handwheel.axis_inputs.{letter}");
            let axis = axes
                .iter()
                .map(|axis| axis.letter)
                .find(|axis| letter.eq_ignore_ascii_case(&axis.letter().to_string()));
            let Some(axis) = axis else {
                let known: String = axes.iter().map(|axis| axis.letter.letter()).collect();
                let what = format!("the machine has no axis {letter:?}");
                return Err(self.error(&key, what, format!("name an axis of {known}")));
            };
            axis_inputs.push((axis, self.input_of_kind(&key, name, inputs, SignalKind::Digital)?));
        }
        axis_inputs.sort_by_key(|(axis, _)| AxisLetter::index(*axis));
        let mut step_inputs = Vec::new();
        for (index, name) in wheel.step_inputs.iter().enumerate() {
            let key = format!("handwheel.step_inputs[{index}]");
            step_inputs.push(self.input_of_kind(&key, name, inputs, SignalKind::Digital)?);
        }
        if !step_inputs.is_empty() && step_inputs.len() != steps_mm.len() {
            let what = format!(
                "{} inputs, and steps_mm has {} steps",
                step_inputs.len(),
                steps_mm.len()
            );
            return Err(self.error("handwheel.step_inputs", what, "give an input for each step"));
        }
        let enable_input = match &wheel.enable_input {
            Some(name) => {
                Some(self.input_of_kind("handwheel.enable_input", name, inputs, SignalKind::Digital)?)
            }
            None => None,
        };
        Ok(Some(HandwheelSettings {
            counts,
            counts_per_detent: self.or_default(
                "handwheel.counts_per_detent",
                wheel.counts_per_detent,
                4.0,
                [1.0, 10_000.0],
            )?,
            steps_mm,
            steps_deg,
            axis_inputs,
            step_inputs,
            enable_input,
        }))
    }

    /// Travel per detent, or the default.
    fn steps(&self, key: &str, given: Option<&[f64]>, usual: &[f64]) -> Result<Vec<f64>, MachineError> {
        let Some(given) = given else {
            return Ok(usual.to_vec());
        };
        if !(1..=MAX_WHEEL_STEPS).contains(&given.len()) {
            let what = format!("{} steps", given.len());
            return Err(self.error(key, what, format!("give 1 to {MAX_WHEEL_STEPS}")));
        }
        for (index, step) in given.iter().enumerate() {
            self.number(&format!("{key}[{index}]"), *step, 1e-6, 10.0)?;
        }
        Ok(given.to_vec())
    }
}

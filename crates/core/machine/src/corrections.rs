//! Corrected errors of a machine: backlash, screw error, squareness, thermal growth.

use std::path::PathBuf;

use evolvent_compensation::{AxisLimits, Design, DesignError, MachineErrors};
use evolvent_path::{AXES, Axes, AxisLetter};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::machine::{Axis, Machine};

/// Format of a table of screw errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
pub(crate) enum TableFormat {
    /// Comma-separated columns with a header line.
    #[serde(rename = "csv")]
    Csv,
    /// Lists of numbers.
    #[serde(rename = "json")]
    Json,
    /// LinuxCNC's COMP_FILE with COMP_FILE_TYPE = 0: nominal position, position reached forwards, position reached backwards.
    #[serde(rename = "linuxcnc-0")]
    LinuxCnc0,
    /// LinuxCNC's COMP_FILE with COMP_FILE_TYPE = 1: nominal position, correction forwards, correction backwards.
    #[serde(rename = "linuxcnc-1")]
    LinuxCnc1,
}

/// Unit of the numbers in a LinuxCNC file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum TableUnit {
    /// Millimetres (degrees for a rotary axis).
    #[default]
    Mm,
    /// Inches.
    Inch,
}

/// Squareness errors of X, Y and Z.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SquarenessFile {
    /// Drift of the tool towards larger X while Y alone moves forwards, um per m; positive for an angle below 90 degrees.
    #[serde(default)]
    #[schemars(range(min = -10_000, max = 10_000))]
    pub(crate) xy_um_m: f64,
    /// Drift of the tool towards larger X while Z alone moves forwards, um per m.
    #[serde(default)]
    #[schemars(range(min = -10_000, max = 10_000))]
    pub(crate) xz_um_m: f64,
    /// Drift of the tool towards larger Y while Z alone moves forwards, um per m.
    #[serde(default)]
    #[schemars(range(min = -10_000, max = 10_000))]
    pub(crate) yz_um_m: f64,
}

/// The content of a screw-error file, to be attached to traces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScrewFile {
    /// Name as in the machine file.
    pub name: PathBuf,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// The corrections of a machine, and what they leave to the planner.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrectionSettings {
    /// The errors of the machine and the design of their correction.
    pub design: Design,
    /// The analog input that supplies the thermal offset of each axis, mm.
    pub thermal_inputs: [Option<u32>; AXES],
    /// The table files.
    pub files: Vec<ScrewFile>,
    /// The fractions of velocity, acceleration and jerk that remain for the planner.
    pub(crate) planned: [[f64; 3]; AXES],
}

impl CorrectionSettings {
    /// Creates the settings for these errors.
    pub(crate) fn new(
        errors: &MachineErrors,
        axes: &[Axis],
        thermal_inputs: [Option<u32>; AXES],
        files: Vec<ScrewFile>,
    ) -> Result<Self, DesignError> {
        let mut limits = [None; AXES];
        for axis in axes {
            limits[axis.letter.index()] = Some(AxisLimits {
                velocity: axis.max_velocity,
                acceleration: axis.max_acceleration,
                jerk: axis.max_jerk,
            });
        }
        let design = Design::new(errors, &limits)?;
        let planned = std::array::from_fn(|i| match (design.planner_limits(i), limits[i]) {
            (Some(planned), Some(limit)) if planned != limit => [
                planned.velocity / limit.velocity,
                planned.acceleration / limit.acceleration,
                planned.jerk / limit.jerk,
            ],
            _ => [1.0; 3],
        });
        Ok(Self {
            design,
            thermal_inputs,
            files,
            planned,
        })
    }

    /// Maximum distance of each drive's setpoint from the ideal position, mm or degrees.
    #[must_use]
    pub fn reach(&self, machine: &Machine) -> Axes {
        let mut reach = self.design.largest_correction();
        let mut farthest = Axes::zeros();
        for axis in &machine.axes {
            farthest[axis.letter.index()] = axis.travel_min.abs().max(axis.travel_max.abs());
        }
        for i in 0..AXES {
            for j in 0..AXES {
                reach[i] += self.design.coupling(i, j) * farthest[j];
            }
        }
        reach
    }

    /// Whether nothing is corrected.
    #[must_use]
    pub fn is_none(&self) -> bool {
        self.design.is_none()
    }
}

/// The axis to which an error refers.
pub(crate) fn axis_of(error: &DesignError) -> Option<AxisLetter> {
    match error {
        DesignError::Reserve { axis, .. } | DesignError::Slope { axis, .. } => Some(*axis),
        DesignError::Value { .. } => None,
    }
}

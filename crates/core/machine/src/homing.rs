//! Homing settings.

use evolvent_path::AxisLetter;
use schemars::JsonSchema;
use serde::Deserialize;

/// The end of the travel at which the home switch is mounted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum EndFile {
    /// Towards smaller coordinates.
    Negative,
    /// Towards larger coordinates.
    Positive,
}

/// Homing of one axis: keys in mm for linear axes, in degrees for rotary ones.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct HomingFile {
    /// The axis.
    #[schemars(regex(pattern = "^[XYZABCUVWxyzabcuvw]$"))]
    pub(crate) axis: String,
    /// Position in the homing sequence, ascending. Default: 0.
    #[serde(default)]
    pub(crate) order: i64,
    /// Direction of the search for the switch.
    pub(crate) towards: EndFile,
    /// Search speed, mm/s.
    pub(crate) search_mm_s: Option<f64>,
    /// Search speed, degrees/s.
    pub(crate) search_deg_s: Option<f64>,
    /// Speed of the second, slow approach, mm/s.
    pub(crate) latch_mm_s: Option<f64>,
    /// Speed of the second, slow approach, degrees/s.
    pub(crate) latch_deg_s: Option<f64>,
    /// Machine coordinate at which the switch closes, mm.
    pub(crate) switch_mm: Option<f64>,
    /// Machine coordinate at which the switch closes, degrees.
    pub(crate) switch_deg: Option<f64>,
}

/// How one axis is referenced to the home switch of its drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingSettings {
    /// The axis.
    pub axis: AxisLetter,
    /// Position in the homing sequence, ascending.
    pub order: u32,
    /// Whether the search runs towards smaller coordinates.
    pub negative: bool,
    /// Search speed, mm/s or degrees/s.
    pub search_speed: f64,
    /// Speed of the second, slow approach, mm/s or degrees/s.
    pub latch_speed: f64,
    /// Machine coordinate at which the switch closes, mm or degrees.
    pub switch_position: f64,
}

//! How axes are homed.

use evolvent_path::AxisLetter;
use schemars::JsonSchema;
use serde::Deserialize;

/// Which end of the travel the home switch is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum EndFile {
    /// Towards smaller coordinates.
    Negative,
    /// Towards larger coordinates.
    Positive,
}

/// How one axis is homed: keys in mm for linear axes, in degrees for rotary ones.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct HomingFile {
    /// The axis.
    #[schemars(regex(pattern = "^[XYZABCUVWxyzabcuvw]$"))]
    pub(crate) axis: String,
    /// Place in the sequence, the smallest first; 0 where it is not given.
    #[serde(default)]
    pub(crate) order: i64,
    /// Where the switch is searched.
    pub(crate) towards: EndFile,
    /// Speed of the search, mm/s.
    pub(crate) search_mm_s: Option<f64>,
    /// Speed of the search, degrees/s.
    pub(crate) search_deg_s: Option<f64>,
    /// Speed of the second approach, mm/s.
    pub(crate) latch_mm_s: Option<f64>,
    /// Speed of the second approach, degrees/s.
    pub(crate) latch_deg_s: Option<f64>,
    /// Machine coordinate at which the switch closes, mm.
    pub(crate) switch_mm: Option<f64>,
    /// Machine coordinate at which the switch closes, degrees.
    pub(crate) switch_deg: Option<f64>,
}

/// How one axis finds machine zero: by the home switch of its drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingSettings {
    /// The axis.
    pub axis: AxisLetter,
    /// Its place in the sequence, the smallest first.
    pub order: u32,
    /// Whether the switch is searched towards smaller coordinates.
    pub negative: bool,
    /// Speed of the search, mm/s or degrees/s.
    pub search_speed: f64,
    /// Speed of the second approach, mm/s or degrees/s.
    pub latch_speed: f64,
    /// Machine coordinate at which the switch closes, mm or degrees.
    pub switch_position: f64,
}

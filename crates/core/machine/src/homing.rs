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

/// By what an axis finds machine zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum MethodFile {
    /// The edge at which the home switch closes.
    #[default]
    Switch,
    /// The first index pulse of the encoder after an edge of the home switch.
    SwitchIndex,
    /// The next index pulse, without a switch.
    Index,
    /// Nothing is searched: the encoder knows machine zero, as its drive says.
    Absolute,
}

impl MethodFile {
    /// Its name in the file.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Switch => "switch",
            Self::SwitchIndex => "switch-index",
            Self::Index => "index",
            Self::Absolute => "absolute",
        }
    }

    pub(crate) const fn has_switch(self) -> bool {
        matches!(self, Self::Switch | Self::SwitchIndex)
    }

    pub(crate) const fn has_index(self) -> bool {
        matches!(self, Self::SwitchIndex | Self::Index)
    }
}

/// Behind which edge of the home switch the index pulse is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum EdgeFile {
    /// Where the switch closes, on the way onto it.
    Closing,
    /// Where the switch opens, on the way off it.
    Opening,
}

/// How one axis is homed: keys in mm for linear axes, in degrees for rotary ones.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct HomingFile {
    /// The axis.
    #[schemars(regex(pattern = "^[XYZABCUVWxyzabcuvw]$"))]
    pub(crate) axis: String,
    /// By what machine zero is found: "switch", "switch-index", "index" or "absolute"; "switch" where it is not given.
    #[serde(default)]
    pub(crate) method: MethodFile,
    /// Place in the sequence, the smallest first; 0 where it is not given.
    #[serde(default)]
    pub(crate) order: i64,
    /// Where the switch, or without one the index pulse, is searched.
    pub(crate) towards: Option<EndFile>,
    /// Speed of the search, mm/s.
    pub(crate) search_mm_s: Option<f64>,
    /// Speed of the search, degrees/s.
    pub(crate) search_deg_s: Option<f64>,
    /// Speed of the second approach, and at which the index pulse is searched, mm/s.
    pub(crate) latch_mm_s: Option<f64>,
    /// Speed of the second approach, and at which the index pulse is searched, degrees/s.
    pub(crate) latch_deg_s: Option<f64>,
    /// Machine coordinate at which the switch closes, mm.
    pub(crate) switch_mm: Option<f64>,
    /// Machine coordinate at which the switch closes, degrees.
    pub(crate) switch_deg: Option<f64>,
    /// Machine coordinate of the index pulse, mm.
    pub(crate) index_mm: Option<f64>,
    /// Machine coordinate of the index pulse, degrees.
    pub(crate) index_deg: Option<f64>,
    /// How far behind the switch's edge, or behind the start, the index pulse may come, mm.
    pub(crate) index_within_mm: Option<f64>,
    /// How far behind the switch's edge, or behind the start, the index pulse may come, degrees.
    pub(crate) index_within_deg: Option<f64>,
    /// The edge of the switch behind which the index pulse is looked for: "closing" or "opening"; "closing" where it is not
    /// given.
    pub(crate) index_edge: Option<EdgeFile>,
}

/// How an axis finds machine zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HomingMethod {
    /// The edge at which the home switch closes, at the speed of the second approach.
    Switch,
    /// The first index pulse of the encoder after an edge of the home switch.
    SwitchThenIndex {
        /// Whether the edge is the one at which the switch opens, as the axis leaves it; otherwise it is the
        /// one at which the switch closes, as the axis reaches it.
        when_opening: bool,
        /// Maximum distance of the pulse after the edge, mm or degrees.
        within: f64,
    },
    /// The next index pulse, without a switch.
    Index {
        /// Maximum distance of the pulse, mm or degrees.
        within: f64,
    },
    /// No search: the drive reports an absolute position.
    Absolute,
}

/// How one axis finds machine zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingSettings {
    /// The axis.
    pub axis: AxisLetter,
    /// How it finds machine zero.
    pub method: HomingMethod,
    /// Its position in the sequence; the smallest number comes first.
    pub order: u32,
    /// Whether the switch or the index pulse is searched towards smaller coordinates.
    pub negative: bool,
    /// Speed of the search, mm/s or degrees/s.
    pub search_velocity: f64,
    /// Speed of the second approach and of the search for the index pulse, mm/s or degrees/s.
    pub latch_velocity: f64,
    /// Machine coordinate of the reference: of the edge at which the switch closes, or of the index pulse, mm
    /// or degrees.
    pub reference: f64,
}

impl HomingSettings {
    /// Whether it has a home switch.
    #[must_use]
    pub const fn has_switch(&self) -> bool {
        matches!(
            self.method,
            HomingMethod::Switch | HomingMethod::SwitchThenIndex { .. }
        )
    }
}

//! A case file as it is written: keys with their units, before any check of the numbers.

use serde::Deserialize;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CaseFile {
    pub(crate) name: String,
    #[serde(default)]
    pub(crate) description: String,
    pub(crate) cut: Option<CutFile>,
    pub(crate) force: Option<ForceFile>,
    pub(crate) tool: Option<ToolFile>,
    #[serde(default)]
    pub(crate) solver: SolverFile,
    pub(crate) sweep: Option<SweepFile>,
    pub(crate) map: Option<MapFile>,
    pub(crate) turning: Option<TurningFile>,
    pub(crate) milling: Option<MillingFile>,
    pub(crate) lobes: Option<LobesFile>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CutFile {
    pub(crate) speed_m_min: f64,
    pub(crate) depth_mm: f64,
    pub(crate) feed_mm_rev: f64,
    pub(crate) diameter_mm: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ForceFile {
    pub(crate) law: String,
    pub(crate) rake_deg: f64,
    pub(crate) lead_deg: f64,
    pub(crate) radial_ratio: Option<f64>,
    pub(crate) floor_m_min: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ToolFile {
    pub(crate) beta_deg: f64,
    pub(crate) axis: Vec<AxisFile>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct AxisFile {
    pub(crate) mass_kg: Option<f64>,
    pub(crate) frequency_hz: Option<f64>,
    pub(crate) stiffness_n_m: f64,
    pub(crate) damping_ratio: Option<f64>,
    pub(crate) damping_ns_m: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SolverFile {
    pub(crate) harmonics: Option<i64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SweepFile {
    pub(crate) speed_m_min: [f64; 2],
    pub(crate) points: Option<i64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MapFile {
    pub(crate) speed_m_min: [f64; 2],
    pub(crate) depth_mm: [f64; 2],
    pub(crate) feed_mm_rev: Option<Vec<f64>>,
    pub(crate) columns: Option<i64>,
    pub(crate) rows: Option<i64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TurningFile {
    pub(crate) coefficient_n_mm2: f64,
    pub(crate) force_deg: Option<f64>,
    pub(crate) mode: Vec<TurningModeFile>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TurningModeFile {
    pub(crate) frequency_hz: f64,
    pub(crate) damping_ratio: f64,
    pub(crate) stiffness_n_m: f64,
    pub(crate) direction_deg: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MillingFile {
    pub(crate) teeth: i64,
    pub(crate) entry_deg: Option<f64>,
    pub(crate) exit_deg: Option<f64>,
    pub(crate) immersion_ratio: Option<f64>,
    pub(crate) direction: Option<DirectionWord>,
    pub(crate) tangential_n_mm2: f64,
    pub(crate) radial_n_mm2: f64,
    #[serde(default)]
    pub(crate) x: Vec<ModeFile>,
    #[serde(default)]
    pub(crate) y: Vec<ModeFile>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum DirectionWord {
    Up,
    Down,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ModeFile {
    pub(crate) frequency_hz: f64,
    pub(crate) damping_ratio: f64,
    pub(crate) stiffness_n_m: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LobesFile {
    pub(crate) speed_rpm: [f64; 2],
    pub(crate) points: Option<i64>,
    pub(crate) max_depth_mm: Option<f64>,
    pub(crate) exact: Option<bool>,
}

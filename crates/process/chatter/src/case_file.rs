//! A case file as it is written: keys with their units, before any check of the numbers.
//!
//! The JSON schema is made from these types, so their doc comments are what an editor shows to the person who writes a
//! case file.

use schemars::JsonSchema;
use serde::Deserialize;

/// A cut and the machine that takes it, for `evolvent chatter`: [cut], [force] and [tool] for self-oscillation, [turning]
/// or [milling] for stability lobes, or several of these.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Evolvent chatter case file")]
pub(crate) struct CaseFile {
    /// For headings.
    pub(crate) name: String,
    /// One line for people.
    #[serde(default)]
    pub(crate) description: String,
    /// The cut.
    pub(crate) cut: Option<CutFile>,
    /// The cutting force.
    pub(crate) force: Option<ForceFile>,
    /// The tool.
    pub(crate) tool: Option<ToolFile>,
    /// How finely it is solved.
    #[serde(default)]
    pub(crate) solver: SolverFile,
    /// Amplitude over speed.
    pub(crate) sweep: Option<SweepFile>,
    /// Which cuts vibrate, over speed and depth.
    pub(crate) map: Option<MapFile>,
    /// Stability lobes of turning.
    pub(crate) turning: Option<TurningFile>,
    /// Stability lobes of milling.
    pub(crate) milling: Option<MillingFile>,
    /// The diagram of stability lobes.
    pub(crate) lobes: Option<LobesFile>,
}

/// The cut.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct CutFile {
    /// Cutting speed.
    #[schemars(range(min = 0.1, max = 1e4))]
    pub(crate) speed_m_min: f64,
    /// Depth of cut.
    #[schemars(range(min = 1e-4, max = 1e3))]
    pub(crate) depth_mm: f64,
    /// Feed.
    #[schemars(range(min = 1e-4, max = 100.0))]
    pub(crate) feed_mm_rev: f64,
    /// Diameter of the workpiece: tells speeds in rpm.
    #[schemars(range(min = 0.1, max = 1e5))]
    pub(crate) diameter_mm: Option<f64>,
}

/// The cutting force.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ForceFile {
    /// A law that is built in (40X-R1), or a law file relative to this one.
    pub(crate) law: String,
    /// Rake angle of the tool.
    #[schemars(range(min = -45.0, max = 45.0))]
    pub(crate) rake_deg: f64,
    /// Lead angle of the tool.
    #[schemars(range(min = 1.0, max = 120.0))]
    pub(crate) lead_deg: f64,
    /// Py / Pz. Default: the law's, or 0.4, which is assumed.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub(crate) radial_ratio: Option<f64>,
    /// A law of its own for Py, named like `law`: what it calls tangential is radial here. Instead of `radial_ratio`.
    pub(crate) radial_law: Option<String>,
    /// Below this speed the law is not trusted. Default: 2.
    #[schemars(range(min = 1e-3, max = 1e4))]
    pub(crate) floor_m_min: Option<f64>,
}

/// The tool, by the two principal axes of its stiffness.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ToolFile {
    /// From the machine's axes to the principal axes.
    #[schemars(range(min = -360.0, max = 360.0))]
    pub(crate) beta_deg: f64,
    /// V1 and V2.
    #[schemars(length(equal = 2))]
    pub(crate) axis: Vec<AxisFile>,
}

/// A principal axis: one of `mass_kg` and `frequency_hz`, and one of `damping_ratio` and `damping_ns_m`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(transform = one_of_each_pair)]
pub(crate) struct AxisFile {
    /// Modal mass.
    #[schemars(range(min = 1e-6, max = 1e6))]
    pub(crate) mass_kg: Option<f64>,
    /// Natural frequency.
    #[schemars(range(min = 0.1, max = 1e5))]
    pub(crate) frequency_hz: Option<f64>,
    /// Stiffness.
    #[schemars(range(min = 1e3, max = 1e13))]
    pub(crate) stiffness_n_m: f64,
    /// Damping as a share of the critical one.
    #[schemars(range(min = 0.0, max = 0.9))]
    pub(crate) damping_ratio: Option<f64>,
    /// Damping.
    #[schemars(range(min = 0.0, max = 1e9))]
    pub(crate) damping_ns_m: Option<f64>,
}

fn one_of_each_pair(schema: &mut schemars::Schema) {
    let one_of = |pair: [&str; 2]| serde_json::json!({ "oneOf": pair.map(|key| serde_json::json!({ "required": [key] })) });
    let pairs = [["mass_kg", "frequency_hz"], ["damping_ratio", "damping_ns_m"]].map(one_of);
    schema.insert("allOf".to_owned(), pairs.to_vec().into());
}

/// How finely it is solved.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SolverFile {
    /// Harmonics that are kept. Default: 5.
    #[schemars(range(min = 1, max = 32))]
    pub(crate) harmonics: Option<i64>,
}

/// Amplitude over speed.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SweepFile {
    /// From and to.
    pub(crate) speed_m_min: [f64; 2],
    /// Speeds. Default: 101.
    #[schemars(range(min = 2, max = 2000))]
    pub(crate) points: Option<i64>,
}

/// Which cuts vibrate, over speed and depth.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct MapFile {
    /// From and to.
    pub(crate) speed_m_min: [f64; 2],
    /// From and to.
    pub(crate) depth_mm: [f64; 2],
    /// One map for each of these feeds. Default: the cut's.
    #[schemars(length(min = 1, max = 9))]
    pub(crate) feed_mm_rev: Option<Vec<f64>>,
    /// Speeds. Default: 100.
    #[schemars(range(min = 2, max = 500))]
    pub(crate) columns: Option<i64>,
    /// Depths. Default: 100.
    #[schemars(range(min = 2, max = 500))]
    pub(crate) rows: Option<i64>,
}

/// Stability lobes of turning.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct TurningFile {
    /// Cutting force per chip area.
    #[schemars(range(min = 1.0, max = 1e6))]
    pub(crate) coefficient_n_mm2: f64,
    /// Angle of the force from the chip's thickness. Default: 0.
    #[schemars(range(min = -360.0, max = 360.0))]
    pub(crate) force_deg: Option<f64>,
    /// Measured modes.
    #[schemars(length(min = 1, max = 50))]
    pub(crate) mode: Vec<TurningModeFile>,
}

/// A measured mode of a lathe.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct TurningModeFile {
    /// Natural frequency.
    #[schemars(range(min = 0.1, max = 1e5))]
    pub(crate) frequency_hz: f64,
    /// Damping as a share of the critical one.
    #[schemars(range(min = 1e-5, max = 0.9))]
    pub(crate) damping_ratio: f64,
    /// Modal stiffness.
    #[schemars(range(min = 1e3, max = 1e13))]
    pub(crate) stiffness_n_m: f64,
    /// From the chip's thickness to the mode.
    #[schemars(range(min = -360.0, max = 360.0))]
    pub(crate) direction_deg: f64,
}

/// Stability lobes of milling: `entry_deg` and `exit_deg`, or `immersion_ratio` and `direction`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct MillingFile {
    /// Teeth of the cutter.
    #[schemars(range(min = 1, max = 100))]
    pub(crate) teeth: i64,
    /// Where a tooth comes in.
    #[schemars(range(min = 0.0, max = 180.0))]
    pub(crate) entry_deg: Option<f64>,
    /// Where it goes out.
    #[schemars(range(min = 0.0, max = 180.0))]
    pub(crate) exit_deg: Option<f64>,
    /// Radial immersion over diameter.
    #[schemars(range(min = 1e-3, max = 1.0))]
    pub(crate) immersion_ratio: Option<f64>,
    /// Up-milling or down-milling.
    pub(crate) direction: Option<DirectionWord>,
    /// Tangential force per chip area.
    #[schemars(range(min = 1.0, max = 1e6))]
    pub(crate) tangential_n_mm2: f64,
    /// Radial force per chip area.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub(crate) radial_n_mm2: f64,
    /// Modes along the feed; one of both at least.
    #[serde(default)]
    pub(crate) x: Vec<ModeFile>,
    /// Modes across it.
    #[serde(default)]
    pub(crate) y: Vec<ModeFile>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum DirectionWord {
    Up,
    Down,
}

/// A measured mode of a mill.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ModeFile {
    /// Natural frequency.
    #[schemars(range(min = 0.1, max = 1e5))]
    pub(crate) frequency_hz: f64,
    /// Damping as a share of the critical one.
    #[schemars(range(min = 1e-5, max = 0.9))]
    pub(crate) damping_ratio: f64,
    /// Modal stiffness.
    #[schemars(range(min = 1e3, max = 1e13))]
    pub(crate) stiffness_n_m: f64,
}

/// The diagram of stability lobes.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct LobesFile {
    /// From and to.
    pub(crate) speed_rpm: [f64; 2],
    /// Speeds. Default: 400.
    #[schemars(range(min = 2, max = 5000))]
    pub(crate) points: Option<i64>,
    /// Largest depth to look at. Default: 6 times the minimum limit.
    #[schemars(range(min = 1e-3, max = 1e3))]
    pub(crate) max_depth_mm: Option<f64>,
    /// The limit of the delay equation too (milling). Default: true.
    pub(crate) exact: Option<bool>,
}

/// The JSON schema of the case file, shipped as `config/chatter-case.schema.json` for completion and checks
/// in editors.
#[must_use]
pub fn case_schema() -> serde_json::Value {
    schemars::schema_for!(CaseFile).to_value()
}

//! The process file as it is written: keys with their units, before any check of the numbers.
//!
//! The JSON schema is made from these types, so their doc comments are what an editor shows to the person who writes a
//! process file.

use schemars::JsonSchema;
use serde::Deserialize;

/// Turning passes that find themselves from the cutting load: `evolvent turn`, `--process` of `run`, `serve`, `check` and
/// `bridge sim`.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Evolvent process file")]
pub struct JobFile {
    /// Name for people and files.
    pub name: String,
    /// The cut.
    pub cut: CutFile,
    /// The tool.
    pub tool: ToolFile,
    /// The force law.
    pub law: LawFile,
    /// The load.
    pub load: LoadFile,
    /// The feed.
    pub feed: FeedFile,
    /// How passes are chosen.
    #[serde(default)]
    pub strategy: StrategyFile,
    /// Prices, where passes are to cost the least instead of taking the least time.
    pub cost: Option<CostFile>,
    /// Stock for trials.
    pub stock: Option<StockFile>,
    /// Sensor for trials.
    #[serde(default)]
    pub sensor: SensorFile,
}

/// The cut.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CutFile {
    /// Longitudinal turning or facing.
    pub kind: CutKind,
    /// Longitudinal: the final diameter. Facing: the outer diameter at which the tool comes in.
    #[schemars(range(min = 0.1, max = 1e4))]
    pub diameter_mm: f64,
    /// Z of the face at which the tool comes in (longitudinal), or of the finished face (facing).
    #[schemars(range(min = -1e4, max = 1e4))]
    pub z_mm: f64,
    /// Length of the cut: towards lower Z (longitudinal) or towards the axis (facing).
    #[schemars(range(min = 0.1, max = 1e4))]
    pub length_mm: f64,
    /// What stands behind the end of the cut. At a shoulder passes end the earlier the deeper they are, all at the wall that
    /// the edge leaves along itself.
    #[serde(default)]
    pub end: CutEnd,
    /// Longitudinal: the place along the cut from which it is a cone, up to its end; with `cone_deg`.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 1e4))]
    pub cone_from_mm: Option<f64>,
    /// By how much that cone rises, against the axis of the work.
    #[serde(default)]
    #[schemars(range(min = 0.1, max = 88.0))]
    pub cone_deg: Option<f64>,
    /// The most that the stock stands above the final size: radially (longitudinal) or along Z (facing).
    #[schemars(range(min = 0.01, max = 1e3))]
    pub allowance_max_mm: f64,
    /// Speed of the spindle.
    #[schemars(range(min = 0.1, max = 1e5))]
    pub spindle_rpm: f64,
    /// Diameter for which the cutting speed is reckoned; the final one if left out.
    #[schemars(range(min = 0.1, max = 1e4))]
    pub speed_diameter_mm: Option<f64>,
}

/// Which way the tool feeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum CutKind {
    /// Along Z, as G82.
    Longitudinal,
    /// Along X towards the axis, as G75.
    Facing,
}

/// What stands behind the end of a cut.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum CutEnd {
    /// Stock may go on. Right everywhere, and up to a few seconds slower where it does not.
    #[default]
    Shoulder,
    /// Nothing, behind any cut of the process: the end of the bar, or a recess as deep as the final size.
    Open,
}

/// The tool.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ToolFile {
    /// Lead angle.
    #[schemars(range(min = 15.0, max = 89.0))]
    pub lead_deg: f64,
    /// Length of the cutting edge.
    pub edge_mm: f64,
    /// Rake angle, for laws that know it.
    #[serde(default)]
    #[schemars(range(min = -45.0, max = 45.0))]
    pub rake_deg: f64,
}

/// Which force law.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LawFile {
    /// A law that is built in.
    pub name: Option<String>,
    /// A power law: N at 1 m/min, 1 mm, 1 mm/rev.
    #[schemars(range(min = 1e-3, max = 1e9))]
    pub coefficient_n: Option<f64>,
    /// Exponent of the speed.
    #[schemars(range(min = -3.0, max = 3.0))]
    pub speed_exponent: Option<f64>,
    /// Exponent of the depth.
    #[schemars(range(min = 0.05, max = 3.0))]
    pub depth_exponent: Option<f64>,
    /// Exponent of the feed.
    #[schemars(range(min = 0.05, max = 3.0))]
    pub feed_exponent: Option<f64>,
}

/// The load.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LoadFile {
    /// The load to be held.
    pub set_n: f64,
    /// What machine and insert permit.
    pub permitted_n: f64,
    /// Above this the tool is drawn out; 1.5 times the set load if left out.
    pub overload_n: Option<f64>,
    /// For how long.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub overload_ms: Option<f64>,
    /// Above this there is contact; 5 % of the set load if left out.
    pub contact_n: Option<f64>,
}

/// The feed.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FeedFile {
    /// Smallest: chips still break.
    pub min_mm_rev: f64,
    /// Largest: the roughness.
    pub max_mm_rev: f64,
    /// Feed after backing off; equation (4) if left out.
    pub back_off_mm_rev: Option<f64>,
}

/// How passes are chosen.
#[derive(Clone, Copy, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StrategyFile {
    /// Which one.
    #[serde(default)]
    pub name: StrategyName,
    /// The place of the face is known to a few tenths of a millimetre.
    #[serde(default)]
    pub face_is_known: bool,
}

/// Names of strategies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum StrategyName {
    /// As the paper.
    Literal,
    /// With protection against its own transients.
    #[default]
    Safe,
    /// Passes of least time.
    Fast,
}

/// Prices of machine and edge, in any currency.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CostFile {
    /// An hour of the machine with its operator.
    pub machine_per_h: f64,
    /// A new cutting edge, with the time to change it.
    pub edge: f64,
    /// How long an edge lasts at the feed and depth below, and the speed of the job, min.
    pub life_min: f64,
    /// Feed of that cut.
    pub life_feed_mm_rev: f64,
    /// Depth of that cut.
    pub life_depth_mm: f64,
    /// Exponent of the feed in the tool life.
    #[schemars(range(min = 0.0, max = 5.0))]
    pub life_feed_exponent: f64,
    /// Exponent of the depth.
    #[schemars(range(min = 0.0, max = 5.0))]
    pub life_depth_exponent: f64,
}

/// Stock for trials.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StockFile {
    /// Height above the final size over the place from the face. The last height goes on behind it.
    pub outline_mm: Vec<[f64; 2]>,
    /// From, to, height that is left there.
    #[serde(default)]
    pub grooves_mm: Vec<[f64; 3]>,
    /// From, to, factor of the load.
    #[serde(default)]
    pub hard_spots: Vec<[f64; 3]>,
    /// Eccentricity.
    #[serde(default)]
    pub runout_mm: f64,
    /// Sectors without stock, in turns.
    #[serde(default)]
    pub slots_turn: Vec<[f64; 2]>,
}

/// What a sensor shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SensorKind {
    /// The cutting force at the tool, N.
    #[default]
    Force,
    /// The torque of the spindle, N m.
    Torque,
    /// The power of the spindle's drive, W.
    Power,
    /// The current of the spindle's drive, A.
    Current,
}

/// Sensor for trials, and what the controller reckons with.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SensorFile {
    /// What it shows: the cutting force in N, or of the spindle's drive the torque in N m, the power in W or the current in A.
    pub kind: SensorKind,
    /// What it shows in air at the speed of the job, in its unit.
    pub idle: f64,
    /// What that grows by with each rev/min, in its unit.
    pub idle_per_rpm: f64,
    /// Power: share of what is measured that reaches the tool.
    #[schemars(range(min = 0.05, max = 1.0))]
    pub efficiency: f64,
    /// Current: A for 1 N m at the spindle.
    pub amps_per_nm: Option<f64>,
    /// Lag.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub lag_ms: f64,
    /// Longest time between readings.
    #[schemars(range(min = 0.1, max = 1000.0))]
    pub stale_ms: f64,
    /// Noise as a share of the reading.
    #[schemars(range(min = 0.0, max = 0.5))]
    pub noise: f64,
    /// End of its range, as a force; four times the set load if left out.
    pub range_n: Option<f64>,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for SensorFile {
    fn default() -> Self {
        Self {
            kind: SensorKind::Force,
            idle: 0.0,
            idle_per_rpm: 0.0,
            efficiency: 1.0,
            amps_per_nm: None,
            lag_ms: 10.0,
            stale_ms: 10.0,
            noise: 0.02,
            range_n: None,
            seed: 0,
        }
    }
}

/// The JSON schema of the process file, as `config/process.schema.json` ships it: editors complete and check with it.
#[must_use]
pub fn process_schema() -> serde_json::Value {
    schemars::schema_for!(JobFile).to_value()
}

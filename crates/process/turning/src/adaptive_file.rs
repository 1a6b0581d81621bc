//! The file of `evolvent run --adaptive` as it is written: keys with their units.
//!
//! The JSON schema is made from this type, so its doc comments are what an editor shows to the person who writes a file.

use evolvent_config::{ConfigDocument, ConfigError};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::adaptive::{AdaptiveFeed, AdaptiveSettings};

/// The key of each number, and the factor from the file's unit to the setting's.
const KEYS: [(&str, &str, f64); 15] = [
    ("the set load", "set_load", 1.0),
    ("the exponent of the feed", "feed_exponent", 1.0),
    ("the smallest factor", "factor_min", 1.0),
    ("the largest factor", "factor_max", 1.0),
    ("the entry factor", "factor_entry", 1.0),
    ("the idle factor", "factor_idle", 1.0),
    ("the load of contact", "contact_load", 1.0),
    ("the overload limit", "overload", 1.0),
    ("the duration of an overload in s", "overload_ms", 1e3),
    ("the fastest rise of the factor per s", "slew_up_per_s", 1.0),
    ("the fastest fall of the factor per s", "slew_down_per_s", 1.0),
    ("the longest time between readings in s", "stale_ms", 1e3),
    ("the time of a turn in s", "turn_ms", 1e3),
    ("the number of edges", "edges", 1.0),
    ("the lag of the sensor in s", "lag_ms", 1e3),
];

/// Adaptive feed for one tool: `evolvent run PROGRAM --adaptive FILE`. Loads are in the unit of the sensor.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Evolvent adaptive feed file")]
pub(crate) struct AdaptiveFile {
    /// The load to be held.
    #[schemars(range(min = 1e-9, max = 1e9))]
    set_load: f64,
    /// Above this for overload_ms the run is stopped; at least 1.01 times the set load.
    #[schemars(range(max = 1e9))]
    overload: f64,
    /// Below this nothing is cut; at most half of the set load.
    #[schemars(range(min = 1e-9))]
    contact_load: f64,
    /// Exponent of the feed in the load.
    #[schemars(range(min = 0.05, max = 3.0))]
    feed_exponent: f64,
    /// Smallest factor of the programmed feed.
    #[schemars(range(min = 0.02, max = 1.0))]
    factor_min: f64,
    /// Largest factor while cutting; at least the smallest.
    #[schemars(range(max = 2.0))]
    factor_max: f64,
    /// Factor for the first revolution of contact; from the smallest to the largest.
    #[schemars(range(max = 2.0))]
    factor_entry: f64,
    /// Factor in air; at least the smallest.
    #[schemars(range(max = 2.0))]
    factor_idle: f64,
    /// A revolution: of the work in turning, of the tool in milling.
    #[schemars(range(max = 60_000.0))]
    turn_ms: f64,
    /// Edges that come by in a revolution: 1 in turning, the teeth of the cutter in milling.
    #[serde(default = "one_edge")]
    #[schemars(range(min = 1, max = 100))]
    edges: u32,
    /// Time constant of the sensor, with what delays its readings on their way.
    #[schemars(range(min = 0.0, max = 1000.0))]
    lag_ms: f64,
    /// How long an overload may last.
    #[schemars(range(min = 0.0, max = 10_000.0))]
    overload_ms: f64,
    /// Longest time between readings.
    #[schemars(range(min = 0.0, max = 1000.0))]
    stale_ms: f64,
    /// Fastest rise of the factor.
    #[schemars(range(min = 1e-3, max = 1e4))]
    slew_up_per_s: f64,
    /// Fastest fall of the factor.
    #[schemars(range(min = 1e-2, max = 1e4))]
    slew_down_per_s: f64,
}

/// Turning has one edge.
const fn one_edge() -> u32 {
    1
}

impl AdaptiveSettings {
    /// Reads the text of a file for a control period in s; `file` names it in errors.
    ///
    /// # Errors
    /// Text that is not TOML (or JSON, if the name ends in .json), and keys that are unknown, missing or out
    /// of range, with line and column.
    pub fn parse(text: &str, file: &str, period_s: f64) -> Result<Self, ConfigError> {
        let sheet = ConfigDocument::parse(text, file)?;
        let read: AdaptiveFile = sheet.read()?;
        let settings = Self {
            set_load: read.set_load,
            feed_exponent: read.feed_exponent,
            factor_min: read.factor_min,
            factor_max: read.factor_max,
            factor_entry: read.factor_entry,
            factor_idle: read.factor_idle,
            contact_load: read.contact_load,
            overload: read.overload,
            overload_s: 1e-3 * read.overload_ms,
            slew_up_per_s: read.slew_up_per_s,
            slew_down_per_s: read.slew_down_per_s,
            stale_s: 1e-3 * read.stale_ms,
            turn_s: 1e-3 * read.turn_ms,
            edges: read.edges,
            lag_s: 1e-3 * read.lag_ms,
            period_s,
        };
        let Err(error) = AdaptiveFeed::new(settings) else {
            return Ok(settings);
        };
        let Some((_, key, scale)) = KEYS.iter().find(|(name, ..)| *name == error.name) else {
            // The control period is not in the file.
            return Err(sheet.error(".", error.to_string(), "change the control rate of the machine"));
        };
        let (min, max) = (error.min * scale, error.max * scale);
        sheet.number(key, error.value * scale, min, max)?;
        Err(sheet.error(key, error.to_string(), "correct the value"))
    }
}

/// The JSON schema of the file, shipped as `config/adaptive.schema.json` for completion and checks in
/// editors.
#[must_use]
pub fn adaptive_schema() -> serde_json::Value {
    schemars::schema_for!(AdaptiveFile).to_value()
}

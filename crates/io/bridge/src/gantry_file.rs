//! The table of a gantry in the files of bridges: the second drive of an axis.

use evolvent_config::{ConfigDocument, ConfigError};
use evolvent_drive::GantrySettings;
use schemars::JsonSchema;
use serde::Deserialize;

/// The second drive of an axis. One unit each: mm for a linear axis, degrees for a rotary one.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GantryFile {
    /// By how much this drive's coordinate exceeds that of the first where the beam is square, mm or degrees.
    #[serde(default)]
    squaring_offset: f64,
    /// By how much the drives may be apart beyond that before all drives stop, mm or degrees.
    max_difference: f64,
    /// Speed at which drives are moved until the beam is square, when power comes and after homing, mm/s or degrees/s.
    #[serde(default = "slow")]
    square_speed: f64,
}

const fn slow() -> f64 {
    1.0
}

impl GantryFile {
    /// Checks the numbers; `key` is that of the table.
    ///
    /// # Errors
    /// A number out of range, with its position in the file.
    pub fn check(self, sheet: &ConfigDocument<'_>, key: &str) -> Result<GantrySettings, ConfigError> {
        sheet.number(&format!("{key}.squaring_offset"), self.squaring_offset, -1e3, 1e3)?;
        sheet.number(&format!("{key}.max_difference"), self.max_difference, 1e-4, 1e3)?;
        sheet.number(&format!("{key}.square_speed"), self.square_speed, 1e-3, 1e3)?;
        Ok(GantrySettings {
            squaring_offset: self.squaring_offset,
            max_difference: self.max_difference,
            square_velocity: self.square_speed,
        })
    }
}

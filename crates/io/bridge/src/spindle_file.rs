//! Settings of measured spindles, common to the files of bridges.

use evolvent_config::{ConfigDocument, ConfigError};
use evolvent_drive::{OrientationSettings, SpindleIndex};
use schemars::JsonSchema;
use serde::Deserialize;

/// Where the index pulse of a spindle comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SpindleIndexFile {
    /// Once per turn of the spindle: it is on the spindle, or on an encoder that turns as fast.
    #[default]
    Spindle,
    /// Once per turn of an encoder that turns faster or slower: the first pulse after the start of the bridge is the zero.
    Encoder,
    /// There is none: speed only; the angle stays unknown, and threads and M19 are refused.
    None,
}

impl SpindleIndexFile {
    /// The index setting of the encoder.
    #[must_use]
    pub const fn index(self) -> SpindleIndex {
        match self {
            Self::Spindle => SpindleIndex::PerSpindleTurn,
            Self::Encoder => SpindleIndex::PerEncoderTurn,
            Self::None => SpindleIndex::None,
        }
    }
}

/// Spindle orientation (M19) by a position loop of the bridge.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OrientationFile {
    /// Speed per error, 1/s: the spindle approaches its angle with this time constant.
    gain: f64,
    /// Integral gain, 1/s2: removes what an analog speed of zero is off.
    #[serde(default)]
    i_gain: f64,
    /// Greatest speed while it turns to the angle, rpm.
    #[serde(default = "sixty")]
    rpm: f64,
    /// How near the angle it has to be, degrees.
    #[serde(default = "half")]
    tolerance_deg: f64,
}

const fn sixty() -> f64 {
    60.0
}

const fn half() -> f64 {
    0.5
}

impl OrientationFile {
    /// Checks the numbers; `key` is that of the table.
    ///
    /// # Errors
    /// A number out of range, with its position in the file.
    pub fn check(self, sheet: &ConfigDocument<'_>, key: &str) -> Result<OrientationSettings, ConfigError> {
        sheet.number(&format!("{key}.gain"), self.gain, 0.1, 1000.0)?;
        sheet.number(&format!("{key}.i_gain"), self.i_gain, 0.0, 1e5)?;
        sheet.number(&format!("{key}.rpm"), self.rpm, 0.1, 10_000.0)?;
        sheet.number(&format!("{key}.tolerance_deg"), self.tolerance_deg, 0.01, 45.0)?;
        Ok(OrientationSettings {
            gain: self.gain,
            integral_gain: self.i_gain,
            max_rpm: self.rpm,
            tolerance_deg: self.tolerance_deg,
        })
    }
}

/// Checks turns of the encoder and of the spindle.
///
/// # Errors
/// One is out of range, or the index is of an encoder that turns as fast as the spindle.
pub fn check_gear(
    gear: [u32; 2],
    index: SpindleIndexFile,
    sheet: &ConfigDocument<'_>,
    key: &str,
) -> Result<(), ConfigError> {
    for (i, turns) in gear.into_iter().enumerate() {
        sheet.number(&format!("{key}.gear[{i}]"), f64::from(turns), 1.0, 10_000.0)?;
    }
    if index == SpindleIndexFile::Encoder && gear[0] == gear[1] {
        return Err(sheet.error(
            &format!("{key}.index"),
            "the encoder turns as fast as the spindle, so its index is the spindle's".to_owned(),
            "write index = \"spindle\", or give gear: turns of the encoder, turns of the spindle",
        ));
    }
    Ok(())
}

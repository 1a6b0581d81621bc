//! The spindle of the board file.

use evolvent_config::{ConfigDocument, ConfigError};
use schemars::JsonSchema;
use serde::Deserialize;

use super::MAX_UNITS;
use super::pins::PinFile;
use crate::board_settings::SpindlePins;

/// A spindle.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SpindleFile {
    /// Number in the machine file.
    #[serde(default)]
    #[schemars(range(max = 3))]
    pub(super) number: u32,
    /// The PWM generator of its speed.
    #[schemars(range(max = 15))]
    pub(super) pwm: Option<u32>,
    /// The [[remote]] with the spindle outputs (SpinOut, SpinEna, SpinDir), from 0.
    #[schemars(range(max = 3))]
    pub(super) remote: Option<u32>,
    /// Speed at full output, rpm.
    pub(super) full_rpm: Option<f64>,
    /// Output for clockwise.
    pub(super) forward: Option<PinFile>,
    /// Output for counter-clockwise.
    pub(super) reverse: Option<PinFile>,
}

impl SpindleFile {
    pub(super) fn check(&self, sheet: &ConfigDocument<'_>) -> Result<SpindlePins, ConfigError> {
        sheet.number("spindle.number", f64::from(self.number), 0.0, 3.0)?;
        let remote = self.remote.map(|remote| remote as usize);
        if let (Some(remote), None, Some(full)) = (remote, self.pwm, self.full_rpm) {
            sheet.number("spindle.full_rpm", full, 1e-3, 1e6)?;
            return Ok(SpindlePins {
                number: self.number as usize,
                speed: None,
                remote: Some((remote, full)),
                forward: PinFile::check_driven(self.forward, sheet, "spindle.forward")?,
                reverse: PinFile::check_driven(self.reverse, sheet, "spindle.reverse")?,
            });
        }
        let speed = match (self.pwm, self.full_rpm) {
            (None, None) if remote.is_none() => None,
            (Some(unit), Some(full)) => {
                sheet.number("spindle.pwm", f64::from(unit), 0.0, MAX_UNITS)?;
                sheet.number("spindle.full_rpm", full, 1e-3, 1e6)?;
                Some((unit as usize, full))
            }
            _ => {
                return Err(sheet.error(
                    "spindle",
                    "pwm or remote, and full_rpm, belong together".to_owned(),
                    "give pwm and full_rpm, or remote and full_rpm, or none",
                ));
            }
        };
        Ok(SpindlePins {
            number: self.number as usize,
            speed,
            remote: None,
            forward: PinFile::check_driven(self.forward, sheet, "spindle.forward")?,
            reverse: PinFile::check_driven(self.reverse, sheet, "spindle.reverse")?,
        })
    }
}

//! Pins of the board file, alone and as inputs and outputs of the machine file.

use evolvent_config::{ConfigDocument, ConfigError};
use schemars::JsonSchema;
use serde::Deserialize;

use super::MAX_UNITS;
use crate::board_settings::{InputSource, OutputTarget, Pin};

/// Maximum number of HostMot2 pins.
const MAX_PINS: f64 = 143.0;

/// A pin.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PinFile {
    /// Its number on the board, from 0; with `remote` the number of a field input or output of that device.
    #[schemars(range(max = 143))]
    pub(super) pin: u32,
    /// The [[remote]] that it belongs to, from 0.
    #[schemars(range(max = 3))]
    pub(super) remote: Option<u32>,
    /// Low is on.
    #[serde(default)]
    pub(super) inverted: bool,
    /// Long filter of an input, for mechanical switches that bounce. Not for home switches, because it delays them.
    #[serde(default)]
    pub(super) slow: bool,
}

/// An input of the machine file.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct InputPinFile {
    /// Its name in the machine file.
    pub(super) name: String,
    /// The pin of a digital input.
    #[schemars(range(max = 143))]
    pub(super) pin: Option<u32>,
    /// The [[remote]] that the pin or the data belong to, from 0.
    #[schemars(range(max = 3))]
    pub(super) remote: Option<u32>,
    /// For an analog input: name of a number in the process data of a smart-serial device.
    pub(super) data: Option<String>,
    /// The encoder whose counts an analog input tells, as those of a handwheel.
    #[schemars(range(max = 15))]
    pub(super) encoder: Option<u32>,
    /// Low is on.
    #[serde(default)]
    pub(super) inverted: bool,
    /// Long filter of the board, for mechanical switches that bounce.
    #[serde(default)]
    pub(super) slow: bool,
}

/// An output of the machine file.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct OutputPinFile {
    /// Its name in the machine file.
    pub(super) name: String,
    /// The pin of a digital output.
    #[schemars(range(max = 143))]
    pub(super) pin: Option<u32>,
    /// The [[remote]] that the pin belongs to, from 0.
    #[schemars(range(max = 3))]
    pub(super) remote: Option<u32>,
    /// Low is on.
    #[serde(default)]
    pub(super) inverted: bool,
    /// The PWM generator of an analog output.
    #[schemars(range(max = 15))]
    pub(super) pwm: Option<u32>,
    /// Value at which an analog output is full.
    pub(super) full: Option<f64>,
}

impl PinFile {
    pub(super) fn check(self, sheet: &ConfigDocument<'_>, key: &str) -> Result<Pin, ConfigError> {
        sheet.number(&format!("{key}.pin"), f64::from(self.pin), 0.0, MAX_PINS)?;
        Ok(Pin {
            pin: self.pin as usize,
            inverted: self.inverted,
            slow: self.slow,
            remote: self.remote.map(|remote| remote as usize),
        })
    }

    pub(super) fn check_any(
        pin: Option<Self>,
        sheet: &ConfigDocument<'_>,
        key: &str,
    ) -> Result<Option<Pin>, ConfigError> {
        pin.map(|pin| pin.check(sheet, key)).transpose()
    }

    /// An output pin.
    pub(super) fn check_driven(
        pin: Option<Self>,
        sheet: &ConfigDocument<'_>,
        key: &str,
    ) -> Result<Option<Pin>, ConfigError> {
        match pin {
            Some(pin) if pin.slow => Err(sheet.error(
                &format!("{key}.slow"),
                "an output has no filter".to_owned(),
                "remove slow",
            )),
            _ => Self::check_any(pin, sheet, key),
        }
    }
}

impl InputPinFile {
    pub(super) fn source(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<InputSource, ConfigError> {
        let (inverted, slow) = (self.inverted, self.slow);
        let remote = self.remote;
        if let (None, None, Some(data)) = (self.pin, self.encoder, &self.data) {
            return match remote.filter(|_| !inverted && !slow) {
                Some(remote) => Ok(InputSource::Remote {
                    remote: remote as usize,
                    data: data.clone(),
                }),
                None => Err(sheet.error(
                    key,
                    "an input with `data` needs `remote`, and is neither inverted nor slow".to_owned(),
                    "give the number of the [[remote]], from 0",
                )),
            };
        }
        if self.data.is_some() {
            return Err(sheet.error(
                &format!("{key}.data"),
                "`data` is a number of a smart-serial device and excludes `pin` and `encoder`".to_owned(),
                "remove one of them",
            ));
        }
        match (self.pin, self.encoder) {
            (Some(pin), None) => {
                let pin = PinFile {
                    pin,
                    remote,
                    inverted,
                    slow,
                };
                pin.check(sheet, key).map(InputSource::Pin)
            }
            (None, Some(_)) if slow => Err(sheet.error(
                &format!("{key}.slow"),
                "an encoder has no filter of this kind".to_owned(),
                "remove slow",
            )),
            (None, Some(unit)) => {
                sheet.number(&format!("{key}.encoder"), f64::from(unit), 0.0, MAX_UNITS)?;
                let unit = unit as usize;
                Ok(InputSource::Encoder { unit, inverted })
            }
            _ => Err(sheet.error(
                key,
                "an input needs either `pin` or `encoder`".to_owned(),
                "give pin for a digital input, encoder for an analog one that counts",
            )),
        }
    }
}

impl OutputPinFile {
    pub(super) fn target(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<OutputTarget, ConfigError> {
        match (self.pin, self.pwm, self.full) {
            (Some(pin), None, None) => {
                let pin = PinFile {
                    pin,
                    remote: self.remote,
                    inverted: self.inverted,
                    slow: false,
                };
                pin.check(sheet, key).map(OutputTarget::Pin)
            }
            (None, Some(unit), Some(full)) => {
                sheet.number(&format!("{key}.pwm"), f64::from(unit), 0.0, MAX_UNITS)?;
                sheet.number(&format!("{key}.full"), full, 1e-6, 1e9)?;
                let unit = unit as usize;
                Ok(OutputTarget::Pwm { unit, full })
            }
            _ => Err(sheet.error(
                key,
                "an output needs `pin`, or `pwm` and `full`".to_owned(),
                "give pin for a digital output, pwm and full for an analog one",
            )),
        }
    }
}

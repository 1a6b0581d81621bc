//! Inputs and outputs of terminals in the network file: which bits of a device are which signal of the machine.

use evolvent_config::{ConfigDocument, ConfigError};
use schemars::JsonSchema;
use serde::Deserialize;

/// Digital inputs and outputs of a drive: bits of objects 60FDh and 60FEh.
const DRIVE_BITS: u32 = 32;
/// Bits of process data that a device may have: those of all devices.
const MAX_BIT: u32 = 8 * 1024 - 1;

/// An input of the machine as bits of a device.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct InputFile {
    /// Name of the input in the machine file.
    name: String,
    /// Its first bit in the device's input process data, from 0; of a drive, the bit of its digital inputs (60FDh).
    #[schemars(range(max = 8191))]
    bit: u32,
    /// The bit is 1 where the input is off.
    #[serde(default)]
    inverted: bool,
    /// Size of an analog value in bits.
    #[schemars(range(min = 2, max = 32))]
    bits: Option<u32>,
    /// Whether an analog value has a sign; true where it is not given.
    signed: Option<bool>,
    /// Two numbers of an analog value as the device has it; 0 and 32767 where they are not given.
    raw: Option<[i64; 2]>,
    /// What these two numbers mean in the machine file's unit; makes the input an analog one.
    values: Option<[f64; 2]>,
    /// Bit of the device's input process data that is 1 where the value is invalid: the input is unknown to the core then.
    #[schemars(range(max = 8191))]
    error_bit: Option<u32>,
}

/// An output of the machine as bits of a device.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct OutputFile {
    /// Name of the output in the machine file.
    name: Option<String>,
    /// In place of a name: coolant or spindle.
    function: Option<OutputFunction>,
    /// Number of the spindle of the function; 0 where it is not given.
    #[schemars(range(max = 3))]
    spindle: Option<u32>,
    /// Its first bit in the device's output process data, from 0; of a drive, the bit of its digital outputs (60FEh).
    #[schemars(range(max = 8191))]
    bit: u32,
    /// The bit is 1 where the output is off.
    #[serde(default)]
    inverted: bool,
    /// Size of an analog value in bits.
    #[schemars(range(min = 2, max = 32))]
    bits: Option<u32>,
    /// Whether an analog value has a sign; true where it is not given.
    signed: Option<bool>,
    /// Two numbers of an analog value as the device has it; 0 and 32767 where they are not given. It never gets one outside.
    raw: Option<[i64; 2]>,
    /// What these two numbers mean in the machine file's unit (rpm for the speed of a spindle); makes the output an analog one.
    values: Option<[f64; 2]>,
}

/// What an output without a name shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OutputFunction {
    /// Coolant: flood (M8).
    Flood,
    /// Coolant: mist (M7).
    Mist,
    /// The spindle turns, in either direction.
    SpindleOn,
    /// The spindle turns clockwise (M3).
    SpindleClockwise,
    /// The spindle turns counter-clockwise (M4).
    SpindleCounterclockwise,
    /// Its speed, rpm, not negative; analog.
    SpindleSpeed,
}

impl OutputFunction {
    /// Whether it is a number.
    #[must_use]
    pub const fn is_analog(self) -> bool {
        matches!(self, Self::SpindleSpeed)
    }

    /// Whether it is one of a spindle.
    #[must_use]
    pub const fn is_of_spindle(self) -> bool {
        !matches!(self, Self::Flood | Self::Mist)
    }
}

/// On and off, or a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ChannelForm {
    /// One bit.
    Digital {
        /// 1 is off.
        inverted: bool,
    },
    /// A number.
    Analog(AnalogChannel),
}

/// How a number lies in process data, and what it means: the straight line through two points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnalogChannel {
    /// Its size.
    pub bits: u32,
    /// Whether it has a sign.
    pub signed: bool,
    /// Two numbers of the device.
    pub raw: [i64; 2],
    /// What they mean.
    pub values: [f64; 2],
}

impl AnalogChannel {
    /// What a number of the device means. May be called by the cycle.
    #[must_use]
    pub fn value(&self, number: i64) -> f64 {
        let [from, to] = self.raw.map(|raw| raw as f64);
        let u = (number as f64 - from) / (to - from);
        // Exact at both points.
        self.values[0] * (1.0 - u) + self.values[1] * u
    }

    /// The number of the device for a value, never outside the two numbers of the file. May be called by the cycle.
    #[must_use]
    pub fn number(&self, value: f64) -> i64 {
        let [from, to] = self.values;
        let u = ((value - from) / (to - from)).clamp(0.0, 1.0);
        let [first, second] = self.raw.map(|raw| raw as f64);
        (first * (1.0 - u) + second * u).round() as i64
    }

    /// The lower and the upper of its values.
    #[must_use]
    pub fn range(&self) -> [f64; 2] {
        let [a, b] = self.values;
        [a.min(b), a.max(b)]
    }
}

/// Where a signal lies in the process data of its device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Channel {
    /// First bit.
    pub bit: u32,
    /// What it holds.
    pub form: ChannelForm,
}

impl Channel {
    /// Whether it is a number.
    #[must_use]
    pub const fn is_analog(&self) -> bool {
        matches!(self.form, ChannelForm::Analog(_))
    }

    /// The bit behind its last.
    #[must_use]
    pub const fn end(&self) -> u32 {
        self.bit
            + match self.form {
                ChannelForm::Digital { .. } => 1,
                ChannelForm::Analog(analog) => analog.bits,
            }
    }
}

/// A named input, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkInput {
    /// Of the machine file.
    pub name: String,
    /// Where it is read.
    pub channel: Channel,
    /// Bit that tells that the value is invalid.
    pub error_bit: Option<u32>,
}

/// What an output shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OutputSource {
    /// An output of the machine file.
    Named(String),
    /// Coolant, or a spindle by its number.
    Function(OutputFunction, u32),
}

/// An output, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkOutput {
    /// What it shows.
    pub source: OutputSource,
    /// Where it is written.
    pub channel: Channel,
}

/// What the two kinds of signals have in common in the file.
struct ChannelFile {
    bit: u32,
    inverted: bool,
    bits: Option<u32>,
    signed: Option<bool>,
    raw: Option<[i64; 2]>,
    values: Option<[f64; 2]>,
}

impl ChannelFile {
    fn check(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<Channel, ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        sheet.number(&at("bit"), f64::from(self.bit), 0.0, f64::from(MAX_BIT))?;
        let Some(values) = self.values else {
            let analog = [
                ("bits", self.bits.is_some()),
                ("signed", self.signed.is_some()),
                ("raw", self.raw.is_some()),
            ];
            if let Some((name, _)) = analog.into_iter().find(|(_, is_given)| *is_given) {
                return Err(sheet.error(
                    &at(name),
                    "this is a key of analog signals".to_owned(),
                    "give `values` as well, or remove it",
                ));
            }
            return Ok(Channel {
                bit: self.bit,
                form: ChannelForm::Digital {
                    inverted: self.inverted,
                },
            });
        };
        if self.inverted {
            return Err(sheet.error(
                &at("inverted"),
                "an analog signal is inverted by its `values`".to_owned(),
                "exchange the two numbers of `values`",
            ));
        }
        let (bits, signed) = (self.bits.unwrap_or(16), self.signed.unwrap_or(true));
        sheet.number(&at("bits"), f64::from(bits), 2.0, 32.0)?;
        let raw = self.raw.unwrap_or([0, 32767]);
        let [least, most] = if signed {
            [-(1_i64 << (bits - 1)), (1_i64 << (bits - 1)) - 1]
        } else {
            [0, (1_i64 << bits) - 1]
        };
        if raw[0] == raw[1] || raw.iter().any(|raw| !(least..=most).contains(raw)) {
            let key = if self.raw.is_some() {
                at("raw")
            } else {
                at("values")
            };
            return Err(sheet.error(
                &key,
                format!(
                    "{} and {} are not two different numbers of {bits} bits",
                    raw[0], raw[1]
                ),
                format!("give `raw` two numbers of {least} to {most}, or another size in `bits`"),
            ));
        }
        let are_apart = values.iter().all(|value| value.abs() <= 1e9) && values[0] != values[1];
        if !are_apart {
            return Err(sheet.error(
                &at("values"),
                "these are not two different values up to 10^9".to_owned(),
                "give what the two numbers of `raw` mean",
            ));
        }
        Ok(Channel {
            bit: self.bit,
            form: ChannelForm::Analog(AnalogChannel {
                bits,
                signed,
                raw,
                values,
            }),
        })
    }
}

impl InputFile {
    /// `is_drive`: the device has an axis or a spindle, so bits are those of object 60FDh.
    pub(crate) fn check(
        &self,
        sheet: &ConfigDocument<'_>,
        key: &str,
        is_drive: bool,
    ) -> Result<NetworkInput, ConfigError> {
        let channel = ChannelFile {
            bit: self.bit,
            inverted: self.inverted,
            bits: self.bits,
            signed: self.signed,
            raw: self.raw,
            values: self.values,
        }
        .check(sheet, key)?;
        if is_drive && (channel.is_analog() || channel.bit >= DRIVE_BITS || self.error_bit.is_some()) {
            return Err(sheet.error(
                &format!("{key}.bit"),
                "inputs of a drive are bits of its digital inputs (60FDh)".to_owned(),
                format!(
                    "give a bit of 0 to {}, without values or error_bit",
                    DRIVE_BITS - 1
                ),
            ));
        }
        if let Some(bit) = self.error_bit {
            sheet.number(
                &format!("{key}.error_bit"),
                f64::from(bit),
                0.0,
                f64::from(MAX_BIT),
            )?;
        }
        Ok(NetworkInput {
            name: self.name.clone(),
            channel,
            error_bit: self.error_bit,
        })
    }
}

impl OutputFile {
    /// `is_drive`: the device has an axis or a spindle, so bits are those of object 60FEh.
    pub(crate) fn check(
        &self,
        sheet: &ConfigDocument<'_>,
        key: &str,
        is_drive: bool,
    ) -> Result<NetworkOutput, ConfigError> {
        let channel = ChannelFile {
            bit: self.bit,
            inverted: self.inverted,
            bits: self.bits,
            signed: self.signed,
            raw: self.raw,
            values: self.values,
        }
        .check(sheet, key)?;
        if is_drive && (channel.is_analog() || channel.bit >= DRIVE_BITS) {
            return Err(sheet.error(
                &format!("{key}.bit"),
                "outputs of a drive are bits of its digital outputs (60FEh)".to_owned(),
                format!("give a bit of 0 to {}, without values", DRIVE_BITS - 1),
            ));
        }
        let source = match (&self.name, self.function) {
            (Some(name), None) if self.spindle.is_none() => OutputSource::Named(name.clone()),
            (None, Some(function)) if self.spindle.is_none() || function.is_of_spindle() => {
                let spindle = self.spindle.unwrap_or(0);
                sheet.number(&format!("{key}.spindle"), f64::from(spindle), 0.0, 3.0)?;
                OutputSource::Function(function, spindle)
            }
            (Some(_), None) | (None, Some(_)) => {
                return Err(sheet.error(
                    &format!("{key}.spindle"),
                    "this output does not belong to a spindle".to_owned(),
                    "remove the number",
                ));
            }
            (Some(_), Some(_)) | (None, None) => {
                return Err(sheet.error(
                    key,
                    "an output needs `name` or `function`, and not both".to_owned(),
                    "give the name of an output of the machine file, or what it shows",
                ));
            }
        };
        if let OutputSource::Function(function, _) = &source
            && function.is_analog() != channel.is_analog()
        {
            let advice = if function.is_analog() {
                "give `values`, in rpm"
            } else {
                "remove `values`"
            };
            return Err(sheet.error(
                &format!("{key}.function"),
                "this function does not fit the signal".to_owned(),
                advice,
            ));
        }
        Ok(NetworkOutput { source, channel })
    }
}

/// Whether two channels of one device share a bit.
pub(crate) const fn overlap(one: &Channel, other: &Channel) -> bool {
    one.bit < other.end() && other.bit < one.end()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 4 to 20 mA on 0 to 32767 as a pressure of 0 to 16 bar that falls, by hand.
    #[test]
    fn values_lie_on_the_line_and_outputs_stay_within_it() {
        let channel = AnalogChannel {
            bits: 16,
            signed: true,
            raw: [0, 32767],
            values: [16.0, 0.0],
        };
        assert_eq!(channel.value(0), 16.0);
        assert_eq!(channel.value(32767), 0.0);
        assert!((channel.value(8192) - (16.0 - 8192.0 / 32767.0 * 16.0)).abs() < 1e-12);
        assert!(channel.value(-100) > 16.0, "inputs go on beyond");
        for (value, number) in [
            (16.0, 0),
            (0.0, 32767),
            (8.0, 16384),
            (99.0, 0),
            (-99.0, 32767),
            (f64::INFINITY, 0),
        ] {
            assert_eq!(channel.number(value), number, "{value}");
        }
        assert_eq!(channel.range(), [0.0, 16.0]);
    }
}

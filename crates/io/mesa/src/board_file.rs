//! The board file: the board, its axes and its pins.

mod axis;
mod pins;
mod spindle;

use std::net::IpAddr;
use std::path::Path;

use evolvent_config::{ConfigDocument, ConfigError, TextFileError, read_text};
use evolvent_path::AxisMask;
use schemars::JsonSchema;
use serde::Deserialize;
use thiserror::Error;

use axis::AxisFile;
use pins::{InputPinFile, OutputPinFile, PinFile};
use spindle::SpindleFiles;

use crate::board_settings::{BoardSettings, InputPin, InputSource, OutputPin, RemoteSettings, SpindleSpeed};
use crate::smart_serial::MAX_REMOTES;

/// The largest file that is read, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;
/// Maximum time of the watchdog, ms.
pub(crate) const MAX_WATCHDOG_MS: f64 = 1000.0;
/// Maximum number of units of one module.
const MAX_UNITS: f64 = 15.0;

/// Why a board file was rejected.
#[derive(Debug, Error)]
pub enum BoardFileError {
    /// It gives no text.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// A key is unknown, missing or invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// A Mesa Ethernet board: `evolvent bridge mesa --board FILE`.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Evolvent Mesa board file")]
pub(crate) struct BoardFile {
    /// Address of the board, such as 192.168.1.121.
    address: String,
    /// What the board calls itself, such as 7I96S; another board is refused. Without it any.
    name: Option<String>,
    /// Packets in a row that may be lost, each way, before the axes are stopped.
    #[serde(default = "five")]
    #[schemars(range(min = 1, max = 50))]
    max_lost_packets: u32,
    /// Time without packets after which the board takes its pins away by itself, ms.
    #[serde(default = "fifty")]
    #[schemars(range(min = 2, max = 1000))]
    watchdog_ms: f64,
    /// Frequency of the PWM generators, Hz.
    #[serde(default = "twenty_thousand")]
    #[schemars(range(min = 100, max = 48000))]
    pwm_hz: f64,
    /// Time for which an input with a filter of the board (InM) has to be stable before it changes, us.
    #[serde(default = "two_hundred_and_fifty")]
    #[schemars(range(min = 0, max = 3000))]
    input_filter_us: f64,
    /// The same for inputs with `slow`, ms.
    #[serde(default = "twenty_five")]
    #[schemars(range(min = 0, max = 50))]
    slow_filter_ms: f64,
    /// Smart-serial devices, such as the field I/O of a 7I76E.
    #[serde(default)]
    remote: Vec<RemoteFile>,
    /// The axes.
    axis: Vec<AxisFile>,
    /// Inputs of the machine file that are read at pins.
    #[serde(default)]
    input: Vec<InputPinFile>,
    /// Outputs of the machine file that are set at pins or PWM generators.
    #[serde(default)]
    output: Vec<OutputPinFile>,
    /// The spindles: speed, direction, encoder.
    #[serde(default)]
    spindle: SpindleFiles,
    /// Pin for flood coolant.
    flood: Option<PinFile>,
    /// Pin for mist coolant.
    mist: Option<PinFile>,
}

/// A smart-serial device.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct RemoteFile {
    /// Number of the smart-serial module.
    #[serde(default)]
    #[schemars(range(max = 3))]
    port: u32,
    /// Its channel.
    #[serde(default)]
    #[schemars(range(max = 7))]
    channel: u32,
    /// Name of the device, such as 7I76; a device with another name is rejected. Without it, any device is accepted.
    name: Option<String>,
    /// Its mode, which selects the process data.
    #[serde(default)]
    #[schemars(range(max = 255))]
    mode: u32,
}

const fn five() -> u32 {
    5
}

const fn fifty() -> f64 {
    50.0
}

const fn two_hundred_and_fifty() -> f64 {
    250.0
}

const fn twenty_five() -> f64 {
    25.0
}

const fn twenty_thousand() -> f64 {
    20_000.0
}

/// The JSON schema of board files.
#[must_use]
pub fn board_schema() -> serde_json::Value {
    schemars::schema_for!(BoardFile).to_value()
}

impl BoardFile {
    fn address(&self, sheet: &ConfigDocument<'_>) -> Result<IpAddr, ConfigError> {
        self.address.parse().map_err(|_| {
            let what = format!("`{}` is not an address", self.address);
            sheet.error("address", what, "give the board's, such as \"192.168.1.121\"")
        })
    }

    fn check_numbers(&self, sheet: &ConfigDocument<'_>) -> Result<(), ConfigError> {
        sheet.number("max_lost_packets", f64::from(self.max_lost_packets), 1.0, 50.0)?;
        sheet.number("watchdog_ms", self.watchdog_ms, 2.0, MAX_WATCHDOG_MS)?;
        sheet.number("pwm_hz", self.pwm_hz, 100.0, 48_000.0)?;
        sheet.number("input_filter_us", self.input_filter_us, 0.0, 3000.0)?;
        sheet.number("slow_filter_ms", self.slow_filter_ms, 0.0, 50.0)
    }

    fn inputs(&self, sheet: &ConfigDocument<'_>) -> Result<Vec<InputPin>, ConfigError> {
        let inputs = self.input.iter().enumerate();
        inputs
            .map(|(i, input)| {
                Ok(InputPin {
                    name: input.name.clone(),
                    source: input.source(sheet, &format!("input[{i}]"))?,
                })
            })
            .collect()
    }

    fn outputs(&self, sheet: &ConfigDocument<'_>) -> Result<Vec<OutputPin>, ConfigError> {
        let outputs = self.output.iter().enumerate();
        outputs
            .map(|(i, output)| {
                Ok(OutputPin {
                    name: output.name.clone(),
                    target: output.target(sheet, &format!("output[{i}]"))?,
                })
            })
            .collect()
    }
}

impl BoardSettings {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or its contents are invalid.
    pub fn load(path: &Path) -> Result<Self, BoardFileError> {
        let (text, file) = read_text(path, MAX_FILE_BYTES, "board file")?;
        Ok(Self::parse(&text, &file)?)
    }

    /// Reads the text of a file; `file` names it in errors.
    ///
    /// # Errors
    /// Text that is not TOML; unknown, missing or invalid keys: with line and column.
    pub fn parse(text: &str, file: &str) -> Result<Self, ConfigError> {
        let sheet = ConfigDocument::toml(text, file)?;
        let read: BoardFile = sheet.read()?;
        let address = read.address(&sheet)?;
        read.check_numbers(&sheet)?;
        let remotes = RemoteFile::check_all(&read.remote, &sheet)?;
        let axes = AxisFile::check_all(&read.axis, &sheet)?;
        let inputs = read.inputs(&sheet)?;
        let outputs = read.outputs(&sheet)?;
        let spindles = read.spindle.check(&axes, &sheet)?;
        let settings = Self {
            file: file.to_owned(),
            address,
            name: read.name,
            max_lost_packets: read.max_lost_packets,
            watchdog_s: read.watchdog_ms * 1e-3,
            pwm_hz: read.pwm_hz,
            input_filter_s: read.input_filter_us * 1e-6,
            slow_filter_s: read.slow_filter_ms * 1e-3,
            remotes,
            axes,
            inputs,
            outputs,
            spindles,
            has_single_spindle: read.spindle.is_single,
            coolant: [
                PinFile::check_driven(read.flood, &sheet, "flood")?,
                PinFile::check_driven(read.mist, &sheet, "mist")?,
            ],
        };
        settings.check_remotes(&sheet)?;
        settings.check_uses(&sheet)?;
        Ok(settings)
    }

    /// Checks that the smart-serial devices that the file refers to are listed.
    fn check_remotes(&self, sheet: &ConfigDocument<'_>) -> Result<(), ConfigError> {
        for (key, remote) in self.remotes_used() {
            if remote >= self.remotes.len() {
                let what = format!("there is no [[remote]] {remote}");
                return Err(sheet.error(&key, what, "count them from 0, in their order"));
            }
        }
        Ok(())
    }

    /// Smart-serial devices that the file refers to, with the key of each reference.
    fn remotes_used(&self) -> Vec<(String, usize)> {
        let pins = self.pin_uses().into_iter();
        let mut used: Vec<_> = pins
            .filter_map(|used| Some((format!("{}.remote", used.key), used.pin.remote?)))
            .collect();
        for (i, spindle) in self.spindles.iter().enumerate() {
            if let Some(SpindleSpeed::Remote { remote, .. }) = spindle.speed {
                used.push((format!("{}.remote", self.spindle_key(i)), remote));
            }
        }
        for (i, input) in self.inputs.iter().enumerate() {
            if let InputSource::Remote { remote, .. } = input.source {
                used.push((format!("input[{i}].remote"), remote));
            }
        }
        used
    }

    /// Its axes.
    #[must_use]
    pub fn axes_mask(&self) -> AxisMask {
        self.axes.iter().map(|axis| axis.axis).collect()
    }
}

impl RemoteFile {
    fn check_all(listed: &[Self], sheet: &ConfigDocument<'_>) -> Result<Vec<RemoteSettings>, ConfigError> {
        let mut checked: Vec<RemoteSettings> = Vec::new();
        for (i, remote) in listed.iter().enumerate() {
            let key = format!("remote[{i}]");
            for (name, value, most) in [
                ("port", remote.port, 3.0),
                ("channel", remote.channel, 7.0),
                ("mode", remote.mode, 255.0),
            ] {
                sheet.number(&format!("{key}.{name}"), f64::from(value), 0.0, most)?;
            }
            let (port, channel) = (remote.port as usize, remote.channel as usize);
            let is_taken = checked
                .iter()
                .any(|other| (other.port, other.channel) == (port, channel));
            if is_taken || i >= MAX_REMOTES {
                let what = if is_taken {
                    "another entry is at this channel".to_owned()
                } else {
                    format!("{MAX_REMOTES} devices at most")
                };
                return Err(sheet.error(&key, what, "list each device once"));
            }
            checked.push(RemoteSettings {
                port,
                channel,
                name: remote.name.clone(),
                mode: remote.mode as u8,
            });
        }
        Ok(checked)
    }
}

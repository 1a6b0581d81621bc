//! The board file: the step generator, or encoder and PWM generator, of each axis, and the pins.

use std::net::IpAddr;
use std::path::Path;

use evolvent_config::{ConfigDocument, ConfigError, read_regular};
use evolvent_path::{AxisLetter, AxisMask};
use schemars::JsonSchema;
use serde::Deserialize;
use thiserror::Error;

use crate::board_settings::{
    Actuator, BoardAxis, BoardSettings, Gains, InputPin, InputSource, OutputPin, OutputTarget, Pin,
    RemoteSettings, SpindlePins, StepTiming,
};
use crate::smart_serial::MAX_REMOTES;

/// The largest file that is read, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;
/// Maximum number of HostMot2 pins.
const MAX_PINS: f64 = 143.0;
/// Maximum number of units of one module.
const MAX_UNITS: f64 = 15.0;
/// Maximum time of a step generator: 14 bits of 10 ns.
const MAX_TIME_NS: f64 = 163_830.0;

/// Why a board file was rejected.
#[derive(Debug, Error)]
pub enum BoardFileError {
    /// The file cannot be read.
    #[error("{file}: cannot read the board file: {source}; check the path and its permissions")]
    Read {
        /// The file as given.
        file: String,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The file is not text.
    #[error("{file}: not UTF-8 text; save the file as UTF-8")]
    NotText {
        /// The file as given.
        file: String,
    },
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
    /// A spindle with analog speed.
    spindle: Option<SpindleFile>,
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

/// A pin.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct PinFile {
    /// Its number on the board, from 0; with `remote` the number of a field input or output of that device.
    #[schemars(range(max = 143))]
    pin: u32,
    /// The [[remote]] that it belongs to, from 0.
    #[schemars(range(max = 3))]
    remote: Option<u32>,
    /// Low is on.
    #[serde(default)]
    inverted: bool,
    /// Long filter of an input, for mechanical switches that bounce. Not for home switches, because it delays them.
    #[serde(default)]
    slow: bool,
}

/// An axis.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct AxisFile {
    /// Letter of the axis in the machine file.
    letter: String,
    /// A stepper: number of the step generator.
    #[schemars(range(max = 15))]
    stepgen: Option<u32>,
    /// Steps a mm; of a rotary axis steps a degree.
    #[serde(rename = "steps_per_unit")]
    steps: Option<f64>,
    /// How long a step pulse is, ns.
    step_length_ns: Option<f64>,
    /// Shortest time between two step pulses, ns.
    step_space_ns: Option<f64>,
    /// How long the direction stands before a step, ns.
    direction_setup_ns: Option<f64>,
    /// How long the direction stands after a step, ns.
    direction_hold_ns: Option<f64>,
    /// A servo: number of the encoder.
    #[schemars(range(max = 15))]
    encoder: Option<u32>,
    /// Counts a mm (four to a line); of a rotary axis counts a degree.
    #[serde(rename = "counts_per_unit")]
    counts: Option<f64>,
    /// Number of the PWM generator (or analog output) that gives the drive its velocity.
    #[schemars(range(max = 15))]
    pwm: Option<u32>,
    /// Velocity at full output, mm/s; of a rotary axis degrees/s.
    full_velocity: Option<f64>,
    /// Proportional gain of the position loop, 1/s.
    p_gain: Option<f64>,
    /// Integral gain, 1/s2.
    #[serde(default)]
    i_gain: f64,
    /// Derivative gain.
    #[serde(default)]
    d_gain: f64,
    /// The motor turns against the axis.
    #[serde(default)]
    inverted: bool,
    /// The machine coordinate at which the axis stands when the board is set up, until it is homed.
    #[serde(default)]
    zero: f64,
    /// Output that switches the drive on.
    enable: Option<PinFile>,
    /// Input by which the drive reports a fault.
    fault: Option<PinFile>,
    /// Home switch.
    home_switch: Option<PinFile>,
    /// Limit switch at the negative end.
    negative_limit: Option<PinFile>,
    /// Limit switch at the positive end.
    positive_limit: Option<PinFile>,
}

/// An input of the machine file.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct InputPinFile {
    /// Its name in the machine file.
    name: String,
    /// The pin of a digital input.
    #[schemars(range(max = 143))]
    pin: Option<u32>,
    /// The [[remote]] that the pin or the data belong to, from 0.
    #[schemars(range(max = 3))]
    remote: Option<u32>,
    /// For an analog input: name of a number in the process data of a smart-serial device.
    data: Option<String>,
    /// The encoder whose counts an analog input tells, as those of a handwheel.
    #[schemars(range(max = 15))]
    encoder: Option<u32>,
    /// Low is on.
    #[serde(default)]
    inverted: bool,
    /// Long filter of the board, for mechanical switches that bounce.
    #[serde(default)]
    slow: bool,
}

/// An output of the machine file.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct OutputPinFile {
    /// Its name in the machine file.
    name: String,
    /// The pin of a digital output.
    #[schemars(range(max = 143))]
    pin: Option<u32>,
    /// The [[remote]] that the pin belongs to, from 0.
    #[schemars(range(max = 3))]
    remote: Option<u32>,
    /// Low is on.
    #[serde(default)]
    inverted: bool,
    /// The PWM generator of an analog output.
    #[schemars(range(max = 15))]
    pwm: Option<u32>,
    /// Value at which an analog output is full.
    full: Option<f64>,
}

/// A spindle.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SpindleFile {
    /// Number in the machine file.
    #[serde(default)]
    #[schemars(range(max = 3))]
    number: u32,
    /// The PWM generator of its speed.
    #[schemars(range(max = 15))]
    pwm: Option<u32>,
    /// The [[remote]] with the spindle outputs (SpinOut, SpinEna, SpinDir), from 0.
    #[schemars(range(max = 3))]
    remote: Option<u32>,
    /// Speed at full output, rpm.
    full_rpm: Option<f64>,
    /// Output for clockwise.
    forward: Option<PinFile>,
    /// Output for counter-clockwise.
    reverse: Option<PinFile>,
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

impl BoardSettings {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or what it says makes no sense.
    pub fn load(path: &Path) -> Result<Self, BoardFileError> {
        let file = path.display().to_string();
        let bytes = read_regular(path, MAX_FILE_BYTES).map_err(|source| BoardFileError::Read {
            file: file.clone(),
            source,
        })?;
        let text = String::from_utf8(bytes).map_err(|_| BoardFileError::NotText { file: file.clone() })?;
        Ok(Self::parse(&text, &file)?)
    }

    /// Reads the text of a file; `file` names it in errors.
    ///
    /// # Errors
    /// Text that is not TOML, keys that are unknown, missing or make no sense: with line and column.
    pub fn parse(text: &str, file: &str) -> Result<Self, ConfigError> {
        let sheet = ConfigDocument::toml(text, file)?;
        let read: BoardFile = sheet.read()?;
        let address: IpAddr = read.address.parse().map_err(|_| {
            let what = format!("`{}` is not an address", read.address);
            sheet.error("address", what, "give the board's, such as \"192.168.1.121\"")
        })?;
        sheet.number("max_lost_packets", f64::from(read.max_lost_packets), 1.0, 50.0)?;
        sheet.number("watchdog_ms", read.watchdog_ms, 2.0, 1000.0)?;
        sheet.number("pwm_hz", read.pwm_hz, 100.0, 48_000.0)?;
        sheet.number("input_filter_us", read.input_filter_us, 0.0, 3000.0)?;
        sheet.number("slow_filter_ms", read.slow_filter_ms, 0.0, 50.0)?;
        let remotes = RemoteFile::check_all(&read.remote, &sheet)?;
        let mut axes: Vec<BoardAxis> = Vec::new();
        for (i, axis) in read.axis.iter().enumerate() {
            let key = format!("axis[{i}]");
            let checked = axis.check(&sheet, &key)?;
            if axes.iter().any(|other| other.axis == checked.axis) {
                let what = "another entry moves this axis".to_owned();
                return Err(sheet.error(&format!("{key}.letter"), what, "give each axis one entry"));
            }
            axes.push(checked);
        }
        if axes.is_empty() {
            return Err(sheet.error("axis", "no axis is listed".to_owned(), "list each axis: [[axis]]"));
        }
        let mut inputs = Vec::new();
        for (i, input) in read.input.iter().enumerate() {
            inputs.push(InputPin {
                name: input.name.clone(),
                source: input.source(&sheet, &format!("input[{i}]"))?,
            });
        }
        let mut outputs = Vec::new();
        for (i, output) in read.output.iter().enumerate() {
            let key = format!("output[{i}]");
            let target = match (output.pin, output.pwm, output.full) {
                (Some(pin), None, None) => OutputTarget::Pin(
                    PinFile {
                        pin,
                        remote: output.remote,
                        inverted: output.inverted,
                        slow: false,
                    }
                    .check(&sheet, &key)?,
                ),
                (None, Some(unit), Some(full)) => {
                    sheet.number(&format!("{key}.pwm"), f64::from(unit), 0.0, MAX_UNITS)?;
                    sheet.number(&format!("{key}.full"), full, 1e-6, 1e9)?;
                    OutputTarget::Pwm {
                        unit: unit as usize,
                        full,
                    }
                }
                _ => {
                    return Err(sheet.error(
                        &key,
                        "an output needs `pin`, or `pwm` and `full`".to_owned(),
                        "give pin for a digital output, pwm and full for an analog one",
                    ));
                }
            };
            outputs.push(OutputPin {
                name: output.name.clone(),
                target,
            });
        }
        let spindle = match &read.spindle {
            Some(spindle) => Some(spindle.check(&sheet)?),
            None => None,
        };
        let settings = Self {
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
            spindle,
            coolant: [
                PinFile::check_driven(read.flood, &sheet, "flood")?,
                PinFile::check_driven(read.mist, &sheet, "mist")?,
            ],
        };
        for (key, remote) in settings.remotes_used() {
            if remote >= settings.remotes.len() {
                let what = format!("there is no [[remote]] {remote}");
                return Err(sheet.error(&key, what, "count them from 0, in their order"));
            }
        }
        Ok(settings)
    }

    /// Smart-serial devices that the file refers to, with the key of each reference.
    fn remotes_used(&self) -> Vec<(String, usize)> {
        let mut used = Vec::new();
        let mut add =
            |key: String, pin: Option<Pin>| used.extend(pin.and_then(|pin| Some((key, pin.remote?))));
        for (i, axis) in self.axes.iter().enumerate() {
            let [home, negative, positive] = axis.switches;
            for (name, pin) in [
                ("enable", axis.enable),
                ("fault", axis.fault),
                ("home_switch", home),
                ("negative_limit", negative),
                ("positive_limit", positive),
            ] {
                add(format!("axis[{i}].{name}.remote"), pin);
            }
        }
        for (i, output) in self.outputs.iter().enumerate() {
            if let OutputTarget::Pin(pin) = output.target {
                add(format!("output[{i}].remote"), Some(pin));
            }
        }
        add("flood.remote".to_owned(), self.coolant[0]);
        add("mist.remote".to_owned(), self.coolant[1]);
        if let Some(spindle) = &self.spindle {
            add("spindle.forward.remote".to_owned(), spindle.forward);
            add("spindle.reverse.remote".to_owned(), spindle.reverse);
            used.extend(
                spindle
                    .remote
                    .map(|(remote, _)| ("spindle.remote".to_owned(), remote)),
            );
        }
        for (i, input) in self.inputs.iter().enumerate() {
            let remote = match &input.source {
                InputSource::Pin(pin) => pin.remote,
                InputSource::Remote { remote, .. } => Some(*remote),
                InputSource::Encoder { .. } => None,
            };
            used.extend(remote.map(|remote| (format!("input[{i}].remote"), remote)));
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

impl PinFile {
    fn check(self, sheet: &ConfigDocument<'_>, key: &str) -> Result<Pin, ConfigError> {
        sheet.number(&format!("{key}.pin"), f64::from(self.pin), 0.0, MAX_PINS)?;
        Ok(Pin {
            pin: self.pin as usize,
            inverted: self.inverted,
            slow: self.slow,
            remote: self.remote.map(|remote| remote as usize),
        })
    }

    fn check_any(
        pin: Option<Self>,
        sheet: &ConfigDocument<'_>,
        key: &str,
    ) -> Result<Option<Pin>, ConfigError> {
        pin.map(|pin| pin.check(sheet, key)).transpose()
    }
}

impl PinFile {
    /// An output pin.
    fn check_driven(
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
    fn source(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<InputSource, ConfigError> {
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

impl SpindleFile {
    fn check(&self, sheet: &ConfigDocument<'_>) -> Result<SpindlePins, ConfigError> {
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

impl AxisFile {
    fn check(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<BoardAxis, ConfigError> {
        let at = |name: &str| format!("{key}.{name}");
        let mut letters = self.letter.chars();
        let letter = match (letters.next().and_then(AxisLetter::from_letter), letters.next()) {
            (Some(letter), None) => letter,
            _ => {
                return Err(sheet.error(
                    &at("letter"),
                    format!("`{}` is not an axis", self.letter),
                    "give one of X Y Z A B C U V W",
                ));
            }
        };
        let missing =
            |name: &str, of: &str| sheet.error(key, format!("{of} needs {name}"), format!("give {name}"));
        let (actuator, per_unit) = match (self.stepgen, self.encoder) {
            (Some(unit), None) => {
                sheet.number(&at("stepgen"), f64::from(unit), 0.0, MAX_UNITS)?;
                let per_unit = self
                    .steps
                    .ok_or_else(|| missing("steps_per_unit", "a step generator"))?;
                sheet.number(&at("steps_per_unit"), per_unit, 1e-3, 1e7)?;
                let time = |name: &str, value: Option<f64>| {
                    let value = value.ok_or_else(|| missing(name, "a step generator"))?;
                    sheet.number(&at(name), value, 20.0, MAX_TIME_NS)?;
                    Ok::<_, ConfigError>(value)
                };
                let timing = StepTiming {
                    length_ns: time("step_length_ns", self.step_length_ns)?,
                    space_ns: time("step_space_ns", self.step_space_ns)?,
                    setup_ns: time("direction_setup_ns", self.direction_setup_ns)?,
                    hold_ns: time("direction_hold_ns", self.direction_hold_ns)?,
                };
                let unit = unit as usize;
                (Actuator::Steps { unit, timing }, per_unit)
            }
            (None, Some(encoder)) => {
                sheet.number(&at("encoder"), f64::from(encoder), 0.0, MAX_UNITS)?;
                let needed = |name: &str, value: Option<f64>, least: f64, most: f64| {
                    let value = value.ok_or_else(|| missing(name, "an encoder"))?;
                    sheet.number(&at(name), value, least, most)?;
                    Ok::<_, ConfigError>(value)
                };
                let per_unit = needed("counts_per_unit", self.counts, 1e-3, 1e7)?;
                let pwm = needed("pwm", self.pwm.map(f64::from), 0.0, MAX_UNITS)? as usize;
                let full_velocity = needed("full_velocity", self.full_velocity, 1e-3, 1e6)?;
                let p = needed("p_gain", self.p_gain, 0.1, 1e4)?;
                sheet.number(&at("i_gain"), self.i_gain, 0.0, 1e6)?;
                sheet.number(&at("d_gain"), self.d_gain, 0.0, 10.0)?;
                let servo = Actuator::Servo {
                    encoder: encoder as usize,
                    pwm,
                    full_velocity,
                    gains: Gains {
                        p,
                        i: self.i_gain,
                        d: self.d_gain,
                    },
                };
                (servo, per_unit)
            }
            _ => {
                return Err(sheet.error(
                    key,
                    "an axis needs either `stepgen` or `encoder`".to_owned(),
                    "give stepgen for step and direction, encoder and pwm for an analog servo",
                ));
            }
        };
        sheet.number(&at("zero"), self.zero, -1e6, 1e6)?;
        let pin = |pin: Option<PinFile>, name: &str| PinFile::check_any(pin, sheet, &at(name));
        Ok(BoardAxis {
            axis: letter.index(),
            actuator,
            per_unit,
            inverted: self.inverted,
            zero: self.zero,
            enable: PinFile::check_driven(self.enable, sheet, &at("enable"))?,
            fault: pin(self.fault, "fault")?,
            switches: [
                pin(self.home_switch, "home_switch")?,
                pin(self.negative_limit, "negative_limit")?,
                pin(self.positive_limit, "positive_limit")?,
            ],
        })
    }
}

//! The network file: the devices on the wire, and the axis of each drive.

use std::path::Path;

use evolvent_config::{ConfigDocument, ConfigError, read_regular};
use evolvent_path::{AxisLetter, AxisMask};
use schemars::JsonSchema;
use serde::Deserialize;
use thiserror::Error;

use crate::gantry::GantrySettings;
use crate::homing::HomingOnDrive;
use crate::pdo::Extras;
use crate::scale::Scale;
use crate::signal::{InputFile, NetworkInput, NetworkOutput, OutputFile, OutputSource, overlap};

/// The largest file that is read, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;
/// Maximum number of devices in a network.
pub const MAX_DEVICES: usize = 32;

/// Why a network file was rejected.
#[derive(Debug, Error)]
pub enum NetworkError {
    /// The file cannot be read.
    #[error("{file}: cannot read the network file: {source}; check the path and its permissions")]
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

/// An EtherCAT network: `evolvent bridge ethercat --network FILE`.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Evolvent EtherCAT network file")]
pub(crate) struct NetworkFile {
    /// The network interface that the devices are on.
    interface: Option<String>,
    /// Frames in a row that may be lost, or come back short, before the drives are stopped.
    #[serde(default = "three")]
    #[schemars(range(min = 1, max = 50))]
    max_lost_cycles: u32,
    /// Whether drives take over targets by their distributed clocks (SYNC0); else as frames come.
    #[serde(default = "yes")]
    distributed_clocks: bool,
    /// The axes hold guesses, as after a scan: the bridge does not run.
    #[serde(default)]
    unchecked: bool,
    /// The devices in their order on the wire.
    device: Vec<DeviceFile>,
}

/// One device.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct DeviceFile {
    /// A name for messages.
    name: String,
    /// Vendor, as the device names itself.
    vendor: u32,
    /// Product code.
    product: u32,
    /// Revision; without it any.
    revision: Option<u32>,
    /// Objects that are written at start-up, in this order, before process data are mapped.
    #[serde(default)]
    startup: Vec<StartupFile>,
    /// The axis that this device drives; without it the device is a coupler or terminal.
    axis: Option<AxisFile>,
    /// Inputs of the machine file that this device reads.
    #[serde(default)]
    input: Vec<InputFile>,
    /// Outputs of the machine file that this device sets.
    #[serde(default)]
    output: Vec<OutputFile>,
}

/// An object to be written.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct StartupFile {
    /// Index.
    index: u16,
    /// Sub-index.
    #[serde(default)]
    sub_index: u8,
    /// Size of the object in bytes: 1, 2 or 4.
    bytes: u8,
    /// The number.
    value: i64,
}

/// What a drive turns.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct AxisFile {
    /// Letter of the axis in the machine file.
    letter: String,
    /// Increments of the drive's position a turn of the motor.
    #[schemars(range(min = 1))]
    increments_per_turn: u32,
    /// Turns of the motor, and turns of the other side of the gear in the same time.
    #[serde(default = "direct")]
    gear: [u32; 2],
    /// What one turn behind the gear moves the axis, in mm; the lead of a screw.
    turn_mm: Option<f64>,
    /// The same for a rotary axis, in degrees.
    turn_deg: Option<f64>,
    /// The motor turns against the axis.
    #[serde(default)]
    inverted: bool,
    /// Whether the encoder knows its position at power-up.
    #[serde(default)]
    absolute: bool,
    /// The machine coordinate, in mm or degrees, at which the drive's position is zero, until the axis is homed.
    #[serde(default)]
    zero: f64,
    /// Process data are written to the drive as the bridge needs them; else those are taken that it has.
    #[serde(default = "yes")]
    map: bool,
    /// The velocity of the setpoints is handed on as velocity offset (60B1h).
    #[serde(default)]
    velocity_offset: bool,
    /// Inertia of motor and load at the motor, kg m2: their acceleration is handed on as torque offset (60B2h).
    inertia_kg_m2: Option<f64>,
    /// Rated torque of the motor, N m; needed with an inertia.
    rated_torque_n_m: Option<f64>,
    /// Bit of the digital inputs (60FDh) with the home switch.
    #[schemars(range(max = 31))]
    home_switch_bit: Option<u8>,
    /// Bits 0 and 1 of the digital inputs (60FDh) are limit switches.
    #[serde(default)]
    limit_switches: bool,
    /// The following error of the feedback is the drive's own (60F4h).
    #[serde(default)]
    following_error: bool,
    /// Touch probe 1 (60B8h, 60B9h, 60BAh) latches positions at its rising edge.
    #[serde(default)]
    touch_probe: bool,
    /// Bit of the digital inputs (60FDh) with the probe.
    #[schemars(range(max = 31))]
    probe_input_bit: Option<u8>,
    /// The drive finds its machine zero by itself when power is first requested: the axis moves then.
    homing: Option<HomingFile>,
    /// This is the second drive of a gantry: another device without it drives the same axis.
    gantry: Option<GantryFile>,
}

/// The second drive of an axis. One unit each: mm for a linear axis, degrees for a rotary one.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct GantryFile {
    /// By how much this drive's coordinate exceeds that of the first where the beam is square, mm or degrees.
    #[serde(default)]
    squaring_offset: f64,
    /// By how much the drives may be apart beyond that before all drives stop, mm or degrees.
    max_difference: f64,
    /// Speed at which this drive is moved until the beam is square, when power comes, mm/s or degrees/s.
    #[serde(default = "slow")]
    square_speed: f64,
}

const fn slow() -> f64 {
    1.0
}

/// Homing on the drive (mode of operation 6). One unit each: mm for a linear axis, degrees for a rotary one.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct HomingFile {
    /// Object 6098h, as the drive's manual lists methods.
    method: i8,
    /// Speed of the search (6099h:1), mm/s.
    search_mm_s: Option<f64>,
    /// The same in degrees/s.
    search_deg_s: Option<f64>,
    /// Speed of the latch (6099h:2), mm/s.
    latch_mm_s: Option<f64>,
    /// The same in degrees/s.
    latch_deg_s: Option<f64>,
    /// Acceleration (609Ah), mm/s2; the drive's own where it is not given.
    acceleration_mm_s2: Option<f64>,
    /// The same in degrees/s2.
    acceleration_deg_s2: Option<f64>,
    /// Machine coordinate of the place that the drive finds, mm or degrees.
    #[serde(default)]
    position: f64,
    /// Place in the sequence: axes with the smallest number begin, equal ones together.
    #[serde(default)]
    #[schemars(range(max = 100))]
    order: u32,
    /// How long it may take, s.
    #[serde(default = "minute")]
    #[schemars(range(min = 1, max = 600))]
    timeout_s: f64,
}

const fn minute() -> f64 {
    60.0
}

const fn three() -> u32 {
    3
}

const fn yes() -> bool {
    true
}

const fn direct() -> [u32; 2] {
    [1, 1]
}

/// A network, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// The network interface.
    pub interface: Option<String>,
    /// Frames in a row that may be lost.
    pub max_lost_cycles: u32,
    /// Whether SYNC0 is used.
    pub distributed_clocks: bool,
    /// Whether its axes have guessed values.
    pub is_unchecked: bool,
    /// The devices in their order.
    pub devices: Vec<NetworkDevice>,
}

/// A device, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkDevice {
    /// For messages.
    pub name: String,
    /// Vendor.
    pub vendor: u32,
    /// Product code.
    pub product: u32,
    /// Revision; none for any.
    pub revision: Option<u32>,
    /// Objects written at start-up.
    pub startup: Vec<Startup>,
    /// The axis that it drives.
    pub axis: Option<NetworkAxis>,
    /// Inputs that it reads.
    pub inputs: Vec<NetworkInput>,
    /// Outputs that it sets.
    pub outputs: Vec<NetworkOutput>,
}

/// An object to be written, with its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Startup {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub_index: u8,
    /// Size: 1, 2 or 4.
    pub bytes: u8,
    /// The number as it is written, the lowest bytes of it.
    pub value: u32,
}

/// An axis, checked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NetworkAxis {
    /// Index into X Y Z A B C U V W.
    pub axis: usize,
    /// Increments per unit.
    pub scale: Scale,
    /// The motor turns opposite to the axis.
    pub inverted: bool,
    /// The encoder knows its position at power-up.
    pub absolute: bool,
    /// The machine coordinate of the drive's zero.
    pub zero: f64,
    /// Whether process data are written.
    pub map: bool,
    /// Whether 60B1h is served.
    pub velocity_offset: bool,
    /// Torque offset (60B2h) in thousandths of the rated torque per acceleration of one unit/s2; 0 for none.
    pub torque_per_acceleration: f64,
    /// Bit of the home switch in 60FDh.
    pub home_switch_bit: Option<u8>,
    /// Whether bits 0 and 1 of 60FDh are limit switches.
    pub limit_switches: bool,
    /// Whether 60F4h is the following error of the feedback.
    pub following_error: bool,
    /// Whether touch probe 1 latches positions.
    pub touch_probe: bool,
    /// Bit of the probe in 60FDh.
    pub probe_input_bit: Option<u8>,
    /// Homing by the drive, if configured.
    pub homing: Option<HomingOnDrive>,
    /// Set for the second drive of its axis.
    pub gantry: Option<GantrySettings>,
}

impl NetworkAxis {
    pub(crate) const fn extras(&self) -> Extras {
        Extras {
            velocity_offset: self.velocity_offset,
            torque_offset: self.torque_per_acceleration != 0.0,
            following_error: self.following_error,
            touch_probe: self.touch_probe,
        }
    }
}

/// The JSON schema of network files.
#[must_use]
pub fn network_schema() -> serde_json::Value {
    schemars::schema_for!(NetworkFile).to_value()
}

impl Network {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or its contents are invalid.
    pub fn load(path: &Path) -> Result<Self, NetworkError> {
        let file = path.display().to_string();
        let bytes = read_regular(path, MAX_FILE_BYTES).map_err(|source| NetworkError::Read {
            file: file.clone(),
            source,
        })?;
        let text = String::from_utf8(bytes).map_err(|_| NetworkError::NotText { file: file.clone() })?;
        Ok(Self::parse(&text, &file)?)
    }

    /// Reads the text of a file; `file` names it in errors.
    ///
    /// # Errors
    /// Text that is not TOML; unknown, missing or invalid keys: with line and column.
    pub fn parse(text: &str, file: &str) -> Result<Self, ConfigError> {
        let sheet = ConfigDocument::toml(text, file)?;
        let read: NetworkFile = sheet.read()?;
        sheet.number("max_lost_cycles", f64::from(read.max_lost_cycles), 1.0, 50.0)?;
        if read.device.is_empty() || read.device.len() > MAX_DEVICES {
            let what = format!("{} devices are not a network", read.device.len());
            return Err(sheet.error(
                "device",
                what,
                format!("list 1 to {MAX_DEVICES}, in their order on the wire"),
            ));
        }
        let mut devices: Vec<NetworkDevice> = Vec::new();
        for (i, device) in read.device.into_iter().enumerate() {
            let key = format!("device[{i}]");
            if devices.iter().any(|other| other.name == device.name) {
                let what = format!("`{}` is also the name of another device", device.name);
                return Err(sheet.error(&format!("{key}.name"), what, "give each its own name"));
            }
            let startup = device.startup.iter().enumerate();
            let startup = startup
                .map(|(j, entry)| entry.check(&sheet, &format!("{key}.startup[{j}]")))
                .collect::<Result<_, _>>()?;
            let axis = match &device.axis {
                Some(axis) => Some(axis.check(&sheet, &format!("{key}.axis"))?),
                None => None,
            };
            let taken = axis.is_some_and(|axis| {
                devices
                    .iter()
                    .filter_map(|other| other.axis)
                    .any(|other| other.axis == axis.axis && other.gantry.is_some() == axis.gantry.is_some())
            });
            if taken {
                let what = "another device drives this axis".to_owned();
                return Err(sheet.error(
                    &format!("{key}.axis.letter"),
                    what,
                    "give each drive its own axis, or make it the second of a gantry: [device.axis.gantry]",
                ));
            }
            let (inputs, outputs) = check_signals(&sheet, &key, &device, &devices)?;
            devices.push(NetworkDevice {
                name: device.name,
                vendor: device.vendor,
                product: device.product,
                revision: device.revision,
                startup,
                axis,
                inputs,
                outputs,
            });
        }
        for (i, device) in devices.iter().enumerate() {
            let Some(axis) = device.axis.filter(|axis| axis.gantry.is_some()) else {
                continue;
            };
            let mut others = devices.iter().filter_map(|other| other.axis);
            let first = others.find(|other| other.axis == axis.axis && other.gantry.is_none());
            let key = format!("device[{i}].axis.gantry");
            let Some(first) = first else {
                return Err(sheet.error(
                    &key,
                    "no other device drives this axis".to_owned(),
                    "give the first drive of the gantry the same letter, without [device.axis.gantry]",
                ));
            };
            // Otherwise one drive would know its position and the other would not.
            let alike = first.absolute == axis.absolute
                && first.homing.map(|homing| homing.order) == axis.homing.map(|homing| homing.order);
            if !alike {
                return Err(sheet.error(
                    &key,
                    "the drives of a gantry find their zero in different ways".to_owned(),
                    "give both `absolute`, or both homing with the same `order`, or neither",
                ));
            }
        }
        if devices.iter().all(|device| device.axis.is_none()) {
            return Err(sheet.error(
                "device",
                "no device has an axis".to_owned(),
                "assign an axis to each drive: [device.axis]",
            ));
        }
        Ok(Self {
            interface: read.interface,
            max_lost_cycles: read.max_lost_cycles,
            distributed_clocks: read.distributed_clocks,
            is_unchecked: read.unchecked,
            devices,
        })
    }

    /// Whether a device reads an input, sets an output, or latches the position of a probe.
    #[must_use]
    pub fn has_signals(&self) -> bool {
        self.devices.iter().any(|device| {
            let probes = device
                .axis
                .is_some_and(|axis| axis.touch_probe || axis.probe_input_bit.is_some());
            probes || !device.inputs.is_empty() || !device.outputs.is_empty()
        })
    }

    /// Its axes.
    #[must_use]
    pub fn axes_mask(&self) -> AxisMask {
        self.devices
            .iter()
            .filter_map(|device| device.axis)
            .map(|axis| axis.axis)
            .collect()
    }
}

/// Inputs and outputs of one device: each name once in the file, each bit once in the device.
fn check_signals(
    sheet: &ConfigDocument<'_>,
    key: &str,
    device: &DeviceFile,
    before: &[NetworkDevice],
) -> Result<(Vec<NetworkInput>, Vec<NetworkOutput>), ConfigError> {
    let is_drive = device.axis.is_some();
    let twice = |key: String, name: &str| {
        let what = format!("`{name}` is also a signal of another entry");
        sheet.error(&key, what, "assign each signal once")
    };
    let shared = |key: String, bit: u32| {
        let what = format!("bit {bit} also belongs to another signal of this device");
        sheet.error(&key, what, "give each signal its own bits")
    };
    let mut inputs: Vec<NetworkInput> = Vec::new();
    for (i, entry) in device.input.iter().enumerate() {
        let key = format!("{key}.input[{i}]");
        let input = entry.check(sheet, &key, is_drive)?;
        let mut others = before.iter().flat_map(|device| &device.inputs).chain(&inputs);
        if others.any(|other| other.name == input.name) {
            return Err(twice(format!("{key}.name"), &input.name));
        }
        if inputs.iter().any(|other| overlap(&other.channel, &input.channel)) {
            return Err(shared(format!("{key}.bit"), input.channel.bit));
        }
        inputs.push(input);
    }
    let mut outputs: Vec<NetworkOutput> = Vec::new();
    for (i, entry) in device.output.iter().enumerate() {
        let key = format!("{key}.output[{i}]");
        let output = entry.check(sheet, &key, is_drive)?;
        let mut others = before.iter().flat_map(|device| &device.outputs).chain(&outputs);
        // A function may drive two outputs: a lamp and a valve.
        if let OutputSource::Named(name) = &output.source
            && others.any(|other| other.source == output.source)
        {
            return Err(twice(format!("{key}.name"), name));
        }
        if outputs
            .iter()
            .any(|other| overlap(&other.channel, &output.channel))
        {
            return Err(shared(format!("{key}.bit"), output.channel.bit));
        }
        outputs.push(output);
    }
    Ok((inputs, outputs))
}

impl StartupFile {
    fn check(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<Startup, ConfigError> {
        if !matches!(self.bytes, 1 | 2 | 4) {
            let what = format!("{} bytes is not the size of a number", self.bytes);
            return Err(sheet.error(&format!("{key}.bytes"), what, "give 1, 2 or 4"));
        }
        let bits = u32::from(self.bytes) * 8;
        let (least, most) = (-(1_i64 << (bits - 1)), (1_i64 << bits) - 1);
        sheet.number(
            &format!("{key}.value"),
            self.value as f64,
            least as f64,
            most as f64,
        )?;
        Ok(Startup {
            index: self.index,
            sub_index: self.sub_index,
            bytes: self.bytes,
            value: self.value as u32,
        })
    }
}

impl AxisFile {
    fn check(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<NetworkAxis, ConfigError> {
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
        let turn = match (self.turn_mm, self.turn_deg, letter.is_rotary()) {
            (Some(turn), None, false) | (None, Some(turn), true) => turn,
            (.., false) => {
                return Err(sheet.error(
                    key,
                    "a linear axis needs turn_mm alone".to_owned(),
                    "give what one turn moves it, in mm",
                ));
            }
            (.., true) => {
                return Err(sheet.error(
                    key,
                    "a rotary axis needs turn_deg alone".to_owned(),
                    "give what one turn moves it, in degrees",
                ));
            }
        };
        let scale = Scale::new(self.increments_per_turn, self.gear, turn).map_err(|error| {
            sheet.error(
                key,
                format!("increments_per_turn, gear and turn give no valid scale: {error}"),
                "give the numbers of the drive's encoder and the gear",
            )
        })?;
        sheet.number(&at("zero"), self.zero, -1e6, 1e6)?;
        let torque_per_acceleration = match (self.inertia_kg_m2, self.rated_torque_n_m) {
            (None, _) => 0.0,
            (Some(_), None) => {
                return Err(sheet.error(
                    &at("inertia_kg_m2"),
                    "an inertia needs a rated torque".to_owned(),
                    "give rated_torque_n_m as well",
                ));
            }
            (Some(inertia), Some(torque)) => {
                sheet.number(&at("inertia_kg_m2"), inertia, 1e-9, 1e3)?;
                sheet.number(&at("rated_torque_n_m"), torque, 1e-3, 1e6)?;
                let turns = scale.per_unit() / f64::from(self.increments_per_turn);
                1000.0 * inertia / torque * core::f64::consts::TAU * turns
            }
        };
        if let Some(bit) = self.home_switch_bit {
            sheet.number(&at("home_switch_bit"), f64::from(bit), 0.0, 31.0)?;
        }
        if let Some(bit) = self.probe_input_bit {
            sheet.number(&at("probe_input_bit"), f64::from(bit), 0.0, 31.0)?;
        }
        let homing = match &self.homing {
            Some(homing) => Some(homing.check(sheet, &at("homing"), scale, letter.is_rotary())?),
            None => None,
        };
        if homing.is_some() && self.absolute {
            return Err(sheet.error(
                &at("absolute"),
                "an encoder that knows its position needs no homing".to_owned(),
                "remove `absolute` or `homing`",
            ));
        }
        Ok(NetworkAxis {
            axis: letter.index(),
            scale,
            inverted: self.inverted,
            absolute: self.absolute,
            zero: self.zero,
            map: self.map,
            velocity_offset: self.velocity_offset,
            torque_per_acceleration,
            home_switch_bit: self.home_switch_bit,
            limit_switches: self.limit_switches,
            following_error: self.following_error,
            touch_probe: self.touch_probe,
            probe_input_bit: self.probe_input_bit,
            homing,
            gantry: match &self.gantry {
                Some(gantry) => Some(gantry.check(sheet, &at("gantry"))?),
                None => None,
            },
        })
    }
}

impl GantryFile {
    fn check(self, sheet: &ConfigDocument<'_>, key: &str) -> Result<GantrySettings, ConfigError> {
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

impl HomingFile {
    fn check(
        &self,
        sheet: &ConfigDocument<'_>,
        key: &str,
        scale: Scale,
        is_rotary: bool,
    ) -> Result<HomingOnDrive, ConfigError> {
        // In the unit of the axis, as increments.
        let increments = |name: &str, mm: Option<f64>, deg: Option<f64>| {
            let unit = if is_rotary { "deg" } else { "mm" };
            let value = match (mm, deg, is_rotary) {
                (Some(value), None, false) | (None, Some(value), true) => value,
                (None, None, _) => return Ok(None),
                _ => {
                    return Err(sheet.error(
                        key,
                        format!("{name} has another unit than the axis"),
                        format!("give it in {unit}"),
                    ));
                }
            };
            let increments = value * scale.per_unit();
            if !(1.0..=f64::from(u32::MAX)).contains(&increments) {
                return Err(sheet.error(
                    key,
                    format!("{name} is {increments:.0} increments, which is not within 1 to 4294967295"),
                    "give another speed or acceleration",
                ));
            }
            Ok(Some(increments.round() as u32))
        };
        let needed = |name: &str, value: Option<u32>| {
            value.ok_or_else(|| {
                sheet.error(
                    key,
                    format!("homing needs {name}"),
                    "give it in the unit of the axis",
                )
            })
        };
        sheet.number(&format!("{key}.position"), self.position, -1e6, 1e6)?;
        sheet.number(&format!("{key}.order"), f64::from(self.order), 0.0, 100.0)?;
        sheet.number(&format!("{key}.timeout_s"), self.timeout_s, 1.0, 600.0)?;
        let search = increments("search", self.search_mm_s, self.search_deg_s)?;
        let latch = increments("latch", self.latch_mm_s, self.latch_deg_s)?;
        Ok(HomingOnDrive {
            method: self.method,
            search: needed("the speed of the search", search)?,
            latch: needed("the speed of the latch", latch)?,
            acceleration: increments("acceleration", self.acceleration_mm_s2, self.acceleration_deg_s2)?,
            position: self.position,
            order: self.order,
            timeout_s: self.timeout_s,
        })
    }
}

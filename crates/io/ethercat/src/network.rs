//! The network: the devices on the wire, and the axis of each drive.

mod axis;
mod file;
mod homing;
mod spindle;

use std::path::Path;

use evolvent_config::{ConfigDocument, ConfigError, TextFileError, read_text};
use evolvent_drive::GantrySettings;
use evolvent_path::AxisMask;
use thiserror::Error;

pub use file::network_schema;
use file::{NetworkFile, check_signals};
pub use spindle::NetworkSpindle;

use crate::homing::HomingOnDrive;
use crate::pdo::{Extras, TargetObject};
use crate::scale::Scale;
use crate::signal::{NetworkInput, NetworkOutput};
use crate::zero_impulse::ProbeNumber;

/// The largest file that is read, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;
/// Maximum number of devices in a network.
pub const MAX_DEVICES: usize = 32;

/// Why a network file was rejected.
#[derive(Debug, Error)]
pub enum NetworkError {
    /// The file cannot be read as text.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// A key is unknown, missing or invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// A network, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// The network interface.
    pub interface: Option<String>,
    /// Maximum number of consecutive lost frames.
    pub max_lost_cycles: u32,
    /// Whether SYNC0 is used.
    pub distributed_clocks: bool,
    /// Whether its axes have guessed values.
    pub is_unchecked: bool,
    /// The devices in order.
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
    /// The spindle that it drives.
    pub spindle: Option<NetworkSpindle>,
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
    /// Increments per turn of the motor.
    pub increments_per_turn: u32,
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
    /// The touch probe that latches the zero impulse of the encoder when the core requests an index pulse.
    pub index_probe: Option<ProbeNumber>,
    /// Homing by the drive, if configured.
    pub homing: Option<HomingOnDrive>,
    /// Set for the second drive of its axis.
    pub gantry: Option<GantrySettings>,
}

impl NetworkAxis {
    pub(crate) const fn extras(&self) -> Extras {
        Extras {
            target: TargetObject::Position,
            velocity_offset: self.velocity_offset,
            torque_offset: self.torque_per_acceleration != 0.0,
            following_error: self.following_error,
            touch_probe: self.touch_probe,
            index_probe: self.index_probe,
            digital_outputs: false,
        }
    }
}

impl Network {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or its contents are invalid.
    pub fn load(path: &Path) -> Result<Self, NetworkError> {
        let (text, file) = read_text(path, MAX_FILE_BYTES, "network file")?;
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
            let spindle = match &device.spindle {
                Some(spindle) => Some(spindle.check(&sheet, &format!("{key}.spindle"))?),
                None => None,
            };
            if axis.is_some() && spindle.is_some() {
                return Err(sheet.error(
                    &format!("{key}.spindle"),
                    "a drive moves an axis or turns a spindle".to_owned(),
                    "remove [device.axis] or [device.spindle]",
                ));
            }
            let mut others = devices.iter().filter_map(|other| other.spindle);
            if let Some(spindle) = spindle
                && others.any(|other| other.number == spindle.number)
            {
                return Err(sheet.error(
                    &format!("{key}.spindle.number"),
                    format!("another device drives spindle {}", spindle.number),
                    "give each its own number, 0 to 3",
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
                spindle,
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
            // Otherwise only one of the drives would know its position.
            let alike = first.absolute == axis.absolute
                && first.homing.map(|homing| homing.order) == axis.homing.map(|homing| homing.order);
            if !alike {
                return Err(sheet.error(
                    &key,
                    "the drives of a gantry find their zero in different ways".to_owned(),
                    "give both `absolute`, or both homing with the same `order`, or neither",
                ));
            }
            if first.home_switch_bit.is_some() != axis.home_switch_bit.is_some() {
                let key = if axis.home_switch_bit.is_some() {
                    format!("device[{i}].axis.home_switch_bit")
                } else {
                    key
                };
                return Err(sheet.error(
                    &key,
                    "one drive of a gantry has a home switch, the other has none".to_owned(),
                    "give each its own home_switch_bit, or remove it: then the beam is assumed to be square",
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

    /// Whether a device reads an input, sets an output, turns a spindle, or latches the position of a probe.
    #[must_use]
    pub fn has_signals(&self) -> bool {
        self.devices.iter().any(|device| {
            let probes = device
                .axis
                .is_some_and(|axis| axis.touch_probe || axis.probe_input_bit.is_some());
            probes || device.spindle.is_some() || !device.inputs.is_empty() || !device.outputs.is_empty()
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

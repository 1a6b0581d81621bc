//! The network: the devices on the wire, and the axis of each drive.

mod axis;
mod file;
mod gantry;
mod homing;
mod spindle;

use std::path::Path;

use evolvent_config::{ConfigDocument, ConfigError, TextFileError, read_text};
use evolvent_drive::GantrySettings;
use evolvent_path::AxisMask;
use thiserror::Error;

use file::NetworkFile;
pub use file::network_schema;
use gantry::check_gantries;
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

impl NetworkDevice {
    /// Whether it drives an axis or a spindle; otherwise it is a coupler or a terminal.
    pub(crate) const fn is_drive(&self) -> bool {
        self.axis.is_some() || self.spindle.is_some()
    }
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
        let mut devices = Vec::new();
        for (i, device) in read.device.into_iter().enumerate() {
            devices.push(device.check(&sheet, &format!("device[{i}]"), &devices)?);
        }
        check_gantries(&sheet, &devices)?;
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

    /// The devices that drive an axis, by their index.
    pub(crate) fn axis_devices(&self) -> impl Iterator<Item = usize> {
        let devices = self.devices.iter().enumerate();
        devices.filter_map(|(device, listed)| listed.axis.is_some().then_some(device))
    }

    /// The devices that turn a spindle, by their index.
    pub(crate) fn spindle_devices(&self) -> impl Iterator<Item = usize> {
        let devices = self.devices.iter().enumerate();
        devices.filter_map(|(device, listed)| listed.spindle.is_some().then_some(device))
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

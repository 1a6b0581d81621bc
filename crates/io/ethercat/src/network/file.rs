//! The network file as written: its devices, with their start-up objects and signals.

use evolvent_config::{ConfigDocument, ConfigError};
use schemars::JsonSchema;
use serde::Deserialize;

use super::axis::AxisFile;
use super::spindle::SpindleFile;
use super::{NetworkAxis, NetworkDevice, NetworkSpindle, Startup};
use crate::signal::{InputFile, NetworkInput, NetworkOutput, OutputFile, OutputSource, overlap};

/// An EtherCAT network: `evolvent bridge ethercat --network FILE`.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Evolvent EtherCAT network file")]
pub(super) struct NetworkFile {
    /// The network interface that the devices are on.
    pub(super) interface: Option<String>,
    /// Frames in a row that may be lost, or come back short, before the drives are stopped.
    #[serde(default = "three")]
    #[schemars(range(min = 1, max = 50))]
    pub(super) max_lost_cycles: u32,
    /// Whether drives take over targets by their distributed clocks (SYNC0); else as frames come.
    #[serde(default = "yes")]
    pub(super) distributed_clocks: bool,
    /// The axes hold guesses, as after a scan: the bridge does not run.
    #[serde(default)]
    pub(super) unchecked: bool,
    /// The devices in their order on the wire.
    pub(super) device: Vec<DeviceFile>,
}

/// One device.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct DeviceFile {
    /// A name for messages.
    pub(super) name: String,
    /// Vendor, as the device names itself.
    pub(super) vendor: u32,
    /// Product code.
    pub(super) product: u32,
    /// Revision; without it any.
    pub(super) revision: Option<u32>,
    /// Objects that are written at start-up, in this order, before process data are mapped.
    #[serde(default)]
    pub(super) startup: Vec<StartupFile>,
    /// The axis that this device drives; without it the device is a coupler or terminal.
    pub(super) axis: Option<AxisFile>,
    /// The spindle that this device drives.
    pub(super) spindle: Option<SpindleFile>,
    /// Inputs of the machine file that this device reads.
    #[serde(default)]
    pub(super) input: Vec<InputFile>,
    /// Outputs of the machine file that this device sets.
    #[serde(default)]
    pub(super) output: Vec<OutputFile>,
}

/// An object to be written.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct StartupFile {
    /// Index.
    pub(super) index: u16,
    /// Sub-index.
    #[serde(default)]
    pub(super) sub_index: u8,
    /// Size of the object in bytes: 1, 2 or 4.
    pub(super) bytes: u8,
    /// The number.
    pub(super) value: i64,
}

pub(super) const fn three() -> u32 {
    3
}

pub(super) const fn yes() -> bool {
    true
}

/// The JSON schema of network files.
#[must_use]
pub fn network_schema() -> serde_json::Value {
    schemars::schema_for!(NetworkFile).to_value()
}

impl DeviceFile {
    /// Checks a device, also against the devices before it.
    pub(super) fn check(
        self,
        sheet: &ConfigDocument<'_>,
        key: &str,
        before: &[NetworkDevice],
    ) -> Result<NetworkDevice, ConfigError> {
        if before.iter().any(|other| other.name == self.name) {
            let what = format!("`{}` is also the name of another device", self.name);
            return Err(sheet.error(&format!("{key}.name"), what, "give each its own name"));
        }
        let startup = self.startup.iter().enumerate();
        let startup = startup
            .map(|(j, entry)| entry.check(sheet, &format!("{key}.startup[{j}]")))
            .collect::<Result<_, _>>()?;
        let axis = self.check_axis(sheet, key, before)?;
        let spindle = self.check_spindle(sheet, key, before)?;
        let (inputs, outputs) = check_signals(sheet, key, &self, before)?;
        Ok(NetworkDevice {
            name: self.name,
            vendor: self.vendor,
            product: self.product,
            revision: self.revision,
            startup,
            axis,
            spindle,
            inputs,
            outputs,
        })
    }

    fn check_axis(
        &self,
        sheet: &ConfigDocument<'_>,
        key: &str,
        before: &[NetworkDevice],
    ) -> Result<Option<NetworkAxis>, ConfigError> {
        let Some(axis) = &self.axis else {
            return Ok(None);
        };
        let axis = axis.check(sheet, &format!("{key}.axis"))?;
        let mut others = before.iter().filter_map(|other| other.axis);
        if others.any(|other| other.axis == axis.axis && other.gantry.is_some() == axis.gantry.is_some()) {
            return Err(sheet.error(
                &format!("{key}.axis.letter"),
                "another device drives this axis".to_owned(),
                "give each drive its own axis, or make it the second of a gantry: [device.axis.gantry]",
            ));
        }
        Ok(Some(axis))
    }

    fn check_spindle(
        &self,
        sheet: &ConfigDocument<'_>,
        key: &str,
        before: &[NetworkDevice],
    ) -> Result<Option<NetworkSpindle>, ConfigError> {
        let Some(spindle) = &self.spindle else {
            return Ok(None);
        };
        let spindle = spindle.check(sheet, &format!("{key}.spindle"))?;
        if self.axis.is_some() {
            return Err(sheet.error(
                &format!("{key}.spindle"),
                "a drive moves an axis or turns a spindle".to_owned(),
                "remove [device.axis] or [device.spindle]",
            ));
        }
        let mut others = before.iter().filter_map(|other| other.spindle);
        if others.any(|other| other.number == spindle.number) {
            return Err(sheet.error(
                &format!("{key}.spindle.number"),
                format!("another device drives spindle {}", spindle.number),
                "give each its own number, 0 to 3",
            ));
        }
        Ok(Some(spindle))
    }
}

/// Inputs and outputs of one device: each name once in the file, each bit once in the device.
fn check_signals(
    sheet: &ConfigDocument<'_>,
    key: &str,
    device: &DeviceFile,
    before: &[NetworkDevice],
) -> Result<(Vec<NetworkInput>, Vec<NetworkOutput>), ConfigError> {
    let is_drive = device.axis.is_some() || device.spindle.is_some();
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
    pub(super) fn check(&self, sheet: &ConfigDocument<'_>, key: &str) -> Result<Startup, ConfigError> {
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

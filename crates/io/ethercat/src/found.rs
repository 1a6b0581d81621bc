//! The result of a scan, as text, as JSON, and as a network file to start from.

use core::fmt::Write as _;

use evolvent_path::AxisLetter;
use serde_json::{Value, json};

use crate::scale::Scale;
use crate::sii::{Pdo, SiiContents};

/// Profile number of drives in the lower half of object 1000h.
const DRIVE_PROFILE: u32 = 402;
/// Increments per turn if the drive does not report them.
const USUAL_INCREMENTS: u32 = 1 << 20;

/// One device on the wire.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FoundDevice {
    /// AL state in which it was found.
    pub state: String,
    /// AL status code then; 0 for none.
    pub status_code: u16,
    /// Distributed clock: `none`, `32 bits` or `64 bits`.
    pub clock: &'static str,
    /// The contents of its EEPROM.
    pub sii: SiiContents,
    /// Object 1000h.
    pub device_type: Option<u32>,
    /// The assigned process data (1C12h), by CoE; none without.
    pub outputs: Option<Vec<Pdo>>,
    /// The same of 1C13h.
    pub inputs: Option<Vec<Pdo>>,
    /// Increments and turns of the motor (608Fh), if the drive reports them.
    pub resolution: Option<[u32; 2]>,
    /// Turns of the motor and of the shaft (6091h), if the drive reports them.
    pub gear: Option<[u32; 2]>,
    /// The data that could not be read, with the reason.
    pub problems: Vec<String>,
}

impl FoundDevice {
    /// Its outputs: by CoE, otherwise by its EEPROM.
    #[must_use]
    pub fn outputs(&self) -> &[Pdo] {
        self.outputs.as_deref().unwrap_or(&self.sii.outputs)
    }

    /// Its inputs: by CoE, otherwise by its EEPROM.
    #[must_use]
    pub fn inputs(&self) -> &[Pdo] {
        self.inputs.as_deref().unwrap_or(&self.sii.inputs)
    }

    /// Whether it is a drive of CiA 402: by object 1000h, otherwise by a control word in its process data.
    #[must_use]
    pub fn is_drive(&self) -> bool {
        self.device_type.map_or_else(
            || {
                let mut entries = self.sii.outputs.iter().flat_map(|pdo| &pdo.entries);
                entries.any(|entry| entry.index == 0x6040)
            },
            |device_type| device_type & 0xFFFF == DRIVE_PROFILE,
        )
    }

    fn title(&self) -> &str {
        match (self.sii.order.as_str(), self.sii.name.as_str()) {
            ("", "") => "without a name",
            ("", name) | (name, _) => name,
        }
    }

    fn increments_per_turn(&self) -> Option<u32> {
        let [increments, turns] = self.resolution?;
        (turns > 0 && increments % turns == 0 && increments >= turns).then(|| increments / turns)
    }
}

fn pdo_lines(device: &FoundDevice, mut line: impl FnMut(String)) {
    for (direction, pdos) in [("outputs", device.outputs()), ("inputs", device.inputs())] {
        // Bits are the positions of signals in a network file.
        let mut bit = 0;
        for pdo in pdos {
            line(
                format!("{direction} {:04X}h {}", pdo.index, pdo.name)
                    .trim_end()
                    .to_owned(),
            );
            for entry in &pdo.entries {
                let text = if entry.index == 0 {
                    format!("  bit {bit}: {} unused", entry.bits)
                } else {
                    format!(
                        "  bit {bit}: {:04X}h:{:02X} {} bits {}{}",
                        entry.index,
                        entry.sub_index,
                        entry.bits,
                        entry.name,
                        if entry.unit.is_empty() {
                            String::new()
                        } else {
                            format!(", {}", entry.unit)
                        }
                    )
                };
                line(text.trim_end().to_owned());
                bit += u32::from(entry.bits);
            }
        }
    }
}

/// The devices as text.
#[must_use]
pub fn scan_text(devices: &[FoundDevice]) -> String {
    let mut text = String::new();
    for (position, device) in (1..).zip(devices) {
        let sii = &device.sii;
        let _written = writeln!(
            text,
            "{position}: {}{}\n   vendor {:#x} product {:#x} revision {:#x} serial {} alias {}\n   {}{}, \
             clock: {}{}",
            device.title(),
            if sii.name.is_empty() || sii.order.is_empty() {
                String::new()
            } else {
                format!(" ({})", sii.name)
            },
            sii.vendor,
            sii.product,
            sii.revision,
            sii.serial,
            sii.alias,
            device.state,
            if device.status_code == 0 {
                String::new()
            } else {
                format!(" with AL status code {:#06x}", device.status_code)
            },
            device.clock,
            if device.is_drive() { ", CiA 402 drive" } else { "" },
        );
        pdo_lines(device, |line| {
            let _written = writeln!(text, "   {line}");
        });
        for problem in &device.problems {
            let _written = writeln!(text, "   not read: {problem}");
        }
    }
    text
}

fn pdos_json(pdos: &[Pdo]) -> Value {
    pdos.iter()
        .map(|pdo| {
            let entries: Vec<Value> = pdo
                .entries
                .iter()
                .map(|entry| {
                    json!({
                        "index": entry.index,
                        "sub_index": entry.sub_index,
                        "bits": entry.bits,
                        "name": entry.name,
                        "unit": entry.unit,
                    })
                })
                .collect();
            json!({"index": pdo.index, "name": pdo.name, "entries": entries})
        })
        .collect()
}

/// The devices as JSON.
#[must_use]
pub fn scan_json(devices: &[FoundDevice]) -> Value {
    let devices: Vec<Value> = devices
        .iter()
        .map(|device| {
            json!({
                "vendor": device.sii.vendor,
                "product": device.sii.product,
                "revision": device.sii.revision,
                "serial": device.sii.serial,
                "alias": device.sii.alias,
                "order": device.sii.order,
                "name": device.sii.name,
                "state": device.state,
                "al_status_code": device.status_code,
                "clock": device.clock,
                "coe": device.sii.has_coe,
                "drive": device.is_drive(),
                "outputs": pdos_json(device.outputs()),
                "inputs": pdos_json(device.inputs()),
                "problems": device.problems,
            })
        })
        .collect();
    json!({ "devices": devices })
}

/// A network file to start from: the drives receive the letters in their order, and data that a scan cannot
/// find (screws, gear ratios, directions) are guessed. The file marks this by `unchecked`, with which no
/// bridge runs.
///
/// None if no device is a drive, or no letter is given.
#[must_use]
pub fn network_text(devices: &[FoundDevice], interface: &str, letters: &[AxisLetter]) -> Option<String> {
    let mut text = format!(
        "# What `evolvent bridge ethercat --scan` found. See docs/ethercat.md.\n\n\
         # A scan cannot find screws, gear ratios and directions: check each [device.axis], then remove \
         this line.\n\
         unchecked = true\n\
         interface = {}\n",
        quoted(interface)
    );
    let mut letters = letters.iter();
    let mut has_axis = false;
    for (position, device) in (1..).zip(devices) {
        let letter = device.is_drive().then(|| letters.next()).flatten();
        let name = letter.map_or_else(
            || format!("device-{position}"),
            |letter| format!("{}-drive", letter.letter().to_ascii_lowercase()),
        );
        let _written = write!(
            text,
            "\n# {position}: {}{}\n",
            device.title(),
            if device.sii.name.is_empty() {
                String::new()
            } else {
                format!(", {}", device.sii.name)
            },
        );
        pdo_lines(device, |line| {
            let _written = writeln!(text, "#    {line}");
        });
        let _written = write!(
            text,
            "[[device]]\nname = {}\nvendor = {:#010X}\nproduct = {:#X}\nrevision = {:#X}\n",
            quoted(&name),
            device.sii.vendor,
            device.sii.product,
            device.sii.revision,
        );
        let Some(letter) = letter else {
            if device.is_drive() {
                text.push_str("# A drive for which there was no axis left.\n");
            }
            continue;
        };
        has_axis = true;
        let turn = if letter.is_rotary() { 360.0 } else { 5.0 };
        let fits = |increments, gear| Scale::new(increments, gear, turn).is_ok();
        let reported = device
            .increments_per_turn()
            .filter(|&reported| fits(reported, [1, 1]));
        let increments = reported.unwrap_or(USUAL_INCREMENTS);
        let _written = write!(
            text,
            "\n[device.axis]\nletter = \"{}\"\nincrements_per_turn = {increments} # {}\n{} = {turn} # a \
             guess\n",
            letter.letter(),
            if reported.is_some() { "by 608Fh" } else { "a guess" },
            if letter.is_rotary() { "turn_deg" } else { "turn_mm" },
        );
        if let Some([motor, shaft]) = device.gear {
            let _written = if fits(increments, [motor, shaft]) {
                writeln!(text, "gear = [{motor}, {shaft}] # by 6091h")
            } else {
                writeln!(text, "# 6091h has {motor} to {shaft}, which is not a valid gear.")
            };
        }
        if !device.sii.is_mappable {
            text.push_str("map = false # its process data cannot be written\n");
        }
    }
    has_axis.then_some(text)
}

/// A basic string of TOML.
fn quoted(text: &str) -> String {
    let escaped: String = text
        .chars()
        .map(|letter| match letter {
            '"' | '\\' => format!("\\{letter}"),
            letter if letter.is_control() => format!("\\u{:04X}", u32::from(letter)),
            letter => letter.to_string(),
        })
        .collect();
    format!("\"{escaped}\"")
}

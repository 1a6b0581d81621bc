//! ESI files: descriptions of devices by their vendors, in XML (ETG.2000).
//!
//! A scan uses them for data that devices do not report: names, process data of devices without CoE, units,
//! and the defaults of the resolution and gear of a drive.

use std::path::{Path, PathBuf};

use evolvent_config::{TextFileError, read_text};
use roxmltree::{Document, Node, ParsingOptions};
use thiserror::Error;

use crate::found::FoundDevice;
use crate::sii::{Pdo, PdoEntry};

/// Maximum size of a file, bytes. Vendors describe hundreds of devices in one file.
const MAX_FILE_BYTES: u64 = 64 << 20;
/// Maximum number of elements, texts and comments of a file.
const MAX_NODES: u32 = 4_000_000;
/// Maximum number of files of a folder.
const MAX_FILES: usize = 1000;
/// Maximum number of entries of a PDO, and of PDOs of a device in each direction.
const MAX_ENTRIES: usize = 255;
const MAX_PDOS: usize = 512;
/// English.
const ENGLISH: &str = "1033";

/// Why an ESI file was rejected.
#[derive(Debug, Error)]
pub enum EsiError {
    /// A folder cannot be read.
    #[error("{folder}: the folder of ESI files cannot be read: {source}; check the path and its permissions")]
    UnreadableFolder {
        /// The folder.
        folder: String,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A file gives no text.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// It is not XML.
    #[error("{file}:{line}:{column}: not valid XML: {what}; download the vendor's file again")]
    Xml {
        /// The file.
        file: String,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// The error.
        what: String,
    },
    /// XML of another kind.
    #[error("{file}: its root element is `{found}`, not EtherCATInfo: this is not an ESI file")]
    NoInfo {
        /// The file.
        file: String,
        /// The root element.
        found: String,
    },
    /// A folder without files, or with too many.
    #[error("{folder}: no .xml file in this folder, or more than {MAX_FILES}")]
    Folder {
        /// The folder.
        folder: String,
    },
}

/// An object of a dictionary, or one of its sub-indices.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct EsiObject {
    index: u16,
    sub_index: u8,
    unit: String,
    default: Option<u32>,
}

/// A device according to its vendor.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct EsiDevice {
    vendor: u32,
    product: u32,
    revision: u32,
    order: String,
    name: String,
    outputs: Vec<Pdo>,
    inputs: Vec<Pdo>,
    objects: Vec<EsiObject>,
    profile: Option<u32>,
}

/// The devices of a number of ESI files.
///
/// ```
/// let mut library = evolvent_ethercat::EsiLibrary::default();
/// library.add_text("<EtherCATInfo></EtherCATInfo>", "empty.xml")?;
/// assert!(library.is_empty());
/// # Ok::<(), evolvent_ethercat::EsiError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct EsiLibrary {
    devices: Vec<EsiDevice>,
}

impl EsiLibrary {
    /// Reads a file, or every `.xml` of a folder, and adds its devices.
    ///
    /// # Errors
    /// A file cannot be read, is not XML, or is not an ESI file.
    pub fn add(&mut self, path: &Path) -> Result<(), EsiError> {
        if !path.is_dir() {
            return self.add_file(path);
        }
        let failed = |source| EsiError::UnreadableFolder {
            folder: path.display().to_string(),
            source,
        };
        let mut files: Vec<PathBuf> = Vec::new();
        for entry in std::fs::read_dir(path).map_err(failed)? {
            let file = entry.map_err(failed)?.path();
            if file
                .extension()
                .is_some_and(|end| end.eq_ignore_ascii_case("xml"))
            {
                files.push(file);
            }
        }
        if files.is_empty() || files.len() > MAX_FILES {
            return Err(EsiError::Folder {
                folder: path.display().to_string(),
            });
        }
        files.sort();
        files.iter().try_for_each(|file| self.add_file(file))
    }

    fn add_file(&mut self, path: &Path) -> Result<(), EsiError> {
        let (text, file) = read_text(path, MAX_FILE_BYTES, "ESI file")?;
        self.add_text(&text, &file)
    }

    /// Adds the devices of the text of a file; `file` names it in errors.
    ///
    /// # Errors
    /// It is not XML, or not an ESI file.
    pub fn add_text(&mut self, text: &str, file: &str) -> Result<(), EsiError> {
        let options = ParsingOptions {
            nodes_limit: MAX_NODES,
            ..ParsingOptions::default()
        };
        let text = text.trim_start_matches('\u{FEFF}');
        let document = Document::parse_with_options(text, options).map_err(|error| {
            let position = error.pos();
            EsiError::Xml {
                file: file.to_owned(),
                line: position.row,
                column: position.col,
                what: error.to_string(),
            }
        })?;
        let root = document.root_element();
        if root.tag_name().name() != "EtherCATInfo" {
            return Err(EsiError::NoInfo {
                file: file.to_owned(),
                found: root.tag_name().name().escape_default().to_string(),
            });
        }
        let vendor = child(root, "Vendor")
            .and_then(|vendor| value(vendor, "Id"))
            .unwrap_or(0);
        let devices = child(root, "Descriptions").and_then(|found| child(found, "Devices"));
        for device in devices
            .into_iter()
            .flat_map(|devices| children(devices, "Device"))
        {
            self.devices.extend(read_device(device, vendor));
        }
        Ok(())
    }

    /// Number of devices.
    #[must_use]
    pub fn len(&self) -> usize {
        self.devices.len()
    }

    /// Whether there are no devices.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.devices.is_empty()
    }

    /// The device with this vendor, product and revision; otherwise the next lower revision; otherwise the
    /// lowest.
    fn find(&self, vendor: u32, product: u32, revision: u32) -> Option<&EsiDevice> {
        let same = || {
            self.devices
                .iter()
                .filter(|device| (device.vendor, device.product) == (vendor, product))
        };
        same()
            .filter(|device| device.revision <= revision)
            .max_by_key(|device| device.revision)
            .or_else(|| same().min_by_key(|device| device.revision))
    }

    /// Adds data that the devices of a scan did not report. Notes devices that are in no file, or in a file
    /// with another revision.
    pub fn complete(&self, devices: &mut [FoundDevice]) {
        for device in devices {
            let sii = &device.sii;
            let Some(found) = self.find(sii.vendor, sii.product, sii.revision) else {
                if !self.is_empty() {
                    device
                        .problems
                        .push("ESI: none of the given files describes this device".to_owned());
                }
                continue;
            };
            if found.revision != sii.revision {
                device.problems.push(format!(
                    "ESI: revision {:#x} is in none of the given files; revision {:#x} was used",
                    sii.revision, found.revision
                ));
            }
            found.complete(device);
        }
    }
}

impl EsiDevice {
    fn complete(&self, device: &mut FoundDevice) {
        if device.sii.order.is_empty() {
            device.sii.order.clone_from(&self.order);
        }
        if device.sii.name.is_empty() {
            device.sii.name.clone_from(&self.name);
        }
        if device.outputs.is_none() && device.sii.outputs.is_empty() {
            device.sii.outputs.clone_from(&self.outputs);
        }
        if device.inputs.is_none() && device.sii.inputs.is_empty() {
            device.sii.inputs.clone_from(&self.inputs);
        }
        if device.device_type.is_none() {
            device.device_type = self.profile;
        }
        let lists = [
            device.outputs.as_mut(),
            device.inputs.as_mut(),
            Some(&mut device.sii.outputs),
            Some(&mut device.sii.inputs),
        ];
        for pdo in lists.into_iter().flatten().flatten() {
            self.describe(pdo);
        }
        if device.is_drive() {
            device.resolution = device.resolution.or_else(|| self.pair(0x608F));
            device.gear = device.gear.or_else(|| self.pair(0x6091));
        }
    }

    /// Adds missing names and units of a PDO and its entries.
    fn describe(&self, pdo: &mut Pdo) {
        let known = || self.outputs.iter().chain(&self.inputs);
        if pdo.name.is_empty()
            && let Some(same) = known().find(|other| other.index == pdo.index)
        {
            pdo.name.clone_from(&same.name);
        }
        for entry in pdo.entries.iter_mut().filter(|entry| entry.index != 0) {
            let is_same = |index, sub_index| (index, sub_index) == (entry.index, entry.sub_index);
            let mut entries = known().flat_map(|pdo| &pdo.entries);
            if entry.name.is_empty()
                && let Some(same) = entries.find(|other| is_same(other.index, other.sub_index))
            {
                entry.name.clone_from(&same.name);
            }
            let object = self
                .objects
                .iter()
                .find(|object| is_same(object.index, object.sub_index));
            if let Some(object) = object {
                entry.unit.clone_from(&object.unit);
            }
        }
    }

    /// Defaults of sub-indices 1 and 2.
    fn pair(&self, index: u16) -> Option<[u32; 2]> {
        let at = |sub_index| {
            let mut objects = self.objects.iter();
            objects
                .find(|object| (object.index, object.sub_index) == (index, sub_index))?
                .default
        };
        Some([at(1)?, at(2)?])
    }
}

fn child<'a>(node: Node<'a, 'a>, name: &str) -> Option<Node<'a, 'a>> {
    node.children().find(|child| child.has_tag_name(name))
}

fn children<'a>(node: Node<'a, 'a>, name: &'static str) -> impl Iterator<Item = Node<'a, 'a>> {
    node.children().filter(move |child| child.has_tag_name(name))
}

/// The text of a child, in English if there are several; at most 80 characters.
fn text(node: Node<'_, '_>, name: &'static str) -> String {
    let mut named = children(node, name);
    let first = named.next();
    let english = first
        .into_iter()
        .chain(named)
        .find(|child| child.attribute("LcId") == Some(ENGLISH))
        .or(first);
    let text = english.and_then(|child| child.text()).unwrap_or_default().trim();
    text.chars()
        .filter(|letter| !letter.is_control())
        .take(80)
        .collect()
}

/// A number of an ESI file: decimal, or hexadecimal after `#x`.
fn number(text: &str) -> Option<u32> {
    let text = text.trim();
    match text.strip_prefix("#x").or_else(|| text.strip_prefix("0x")) {
        Some(digits) => u32::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    }
}

fn value(node: Node<'_, '_>, name: &str) -> Option<u32> {
    number(child(node, name)?.text()?)
}

fn read_device(device: Node<'_, '_>, vendor: u32) -> Option<EsiDevice> {
    let kind = child(device, "Type")?;
    let profile = child(device, "Profile");
    let mut read = EsiDevice {
        vendor,
        product: number(kind.attribute("ProductCode")?)?,
        revision: kind.attribute("RevisionNo").and_then(number).unwrap_or(0),
        order: text(device, "Type"),
        name: text(device, "Name"),
        profile: profile.and_then(|profile| value(profile, "ProfileNo")),
        ..EsiDevice::default()
    };
    for (name, pdos) in [("RxPdo", &mut read.outputs), ("TxPdo", &mut read.inputs)] {
        // PDOs without a SyncManager are optional ones, which are not assigned by default.
        let assigned = children(device, name).filter(|pdo| pdo.attribute("Sm").is_some());
        pdos.extend(assigned.take(MAX_PDOS).filter_map(read_pdo));
    }
    if let Some(dictionary) = profile.and_then(|profile| child(profile, "Dictionary")) {
        let objects = child(dictionary, "Objects");
        for object in objects
            .into_iter()
            .flat_map(|objects| children(objects, "Object"))
        {
            read_object(object, &mut read.objects);
        }
    }
    Some(read)
}

fn read_pdo(pdo: Node<'_, '_>) -> Option<Pdo> {
    let entries = children(pdo, "Entry").take(MAX_ENTRIES).filter_map(|entry| {
        Some(PdoEntry {
            index: u16::try_from(value(entry, "Index")?).ok()?,
            sub_index: u8::try_from(value(entry, "SubIndex").unwrap_or(0)).ok()?,
            bits: u8::try_from(value(entry, "BitLen")?).ok()?,
            name: text(entry, "Name"),
            unit: String::new(),
        })
    });
    Some(Pdo {
        index: u16::try_from(value(pdo, "Index")?).ok()?,
        name: text(pdo, "Name"),
        entries: entries.collect(),
    })
}

/// Adds an object and its sub-indices that have a unit or a default.
fn read_object(object: Node<'_, '_>, objects: &mut Vec<EsiObject>) {
    let Some(index) = value(object, "Index").and_then(|index| u16::try_from(index).ok()) else {
        return;
    };
    let Some(info) = child(object, "Info") else {
        return;
    };
    let mut add = |sub_index, info: Node<'_, '_>| {
        let unit = value(info, "Unit").map(unit_text).unwrap_or_default();
        let default =
            value(info, "DefaultValue").or_else(|| little_endian(child(info, "DefaultData")?.text()?));
        if !unit.is_empty() || default.is_some() {
            objects.push(EsiObject {
                index,
                sub_index,
                unit,
                default,
            });
        }
    };
    add(0, info);
    // The first SubItem is sub-index 0.
    for (sub_index, part) in (0..=u8::MAX).zip(children(info, "SubItem")) {
        if let Some(info) = child(part, "Info") {
            add(sub_index, info);
        }
    }
}

/// Bytes in hexadecimal, low byte first.
fn little_endian(text: &str) -> Option<u32> {
    let text = text.trim();
    if text.is_empty() || text.len() > 8 || !text.len().is_multiple_of(2) || !text.is_ascii() {
        return None;
    }
    let bytes = (0..text.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&text[at..at + 2], 16));
    bytes.enumerate().try_fold(0, |value, (i, byte)| {
        Some(value | u32::from(byte.ok()?) << (8 * i))
    })
}

/// Symbol of a unit of ETG.1004: power of ten, numerator, denominator.
fn unit_text(unit: u32) -> String {
    let [_, denominator, numerator, power] = unit.to_le_bytes();
    let symbol = |code| {
        Some(match code {
            0x01 => "m",
            0x03 => "s",
            0x04 => "A",
            0x05 => "K",
            0x20 => "Hz",
            0x21 => "N",
            0x24 => "W",
            0x26 => "V",
            0x2D => "degC",
            0x41 => "deg",
            0x47 => "min",
            0x57 => "s2",
            0xB4 => "rev",
            0xB5 => "inc",
            _ => return None,
        })
    };
    let prefix = match power as i8 {
        0 => Some(""),
        3 => Some("k"),
        -3 => Some("m"),
        -6 => Some("u"),
        -9 => Some("n"),
        _ => None,
    };
    match (prefix, symbol(numerator), denominator) {
        _ if unit == 0 => String::new(),
        (Some(prefix), Some(above), 0) => format!("{prefix}{above}"),
        (Some(prefix), Some(above), below) => match symbol(below) {
            Some(below) => format!("{prefix}{above}/{below}"),
            None => format!("unit {unit:08X}h"),
        },
        _ => format!("unit {unit:08X}h"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Examples of ETG.1004 and of manuals of drives.
    #[test]
    fn units_have_their_symbols() {
        for (unit, wanted) in [
            (0xFD01_0000, "mm"),
            (0x0041_0000, "deg"),
            (0x00B4_4700, "rev/min"),
            (0x00B5_0000, "inc"),
            (0xFD01_0300, "mm/s"),
            (0x0001_5700, "m/s2"),
            (0, ""),
            (0x00EE_0000, "unit 00EE0000h"),
        ] {
            assert_eq!(unit_text(unit), wanted);
        }
    }

    #[test]
    fn numbers_are_read_as_they_are_written() {
        assert_eq!(number(" #x1A00 "), Some(0x1A00));
        assert_eq!(number("17"), Some(17));
        assert_eq!(number("#xFFFFFFFFF"), None);
        assert_eq!(little_endian("00001000"), Some(1 << 20));
        assert_eq!(little_endian("0"), None);
        assert_eq!(little_endian("äää"), None);
    }

    #[test]
    fn invalid_files_are_rejected_with_their_position() {
        let mut library = EsiLibrary::default();
        let error =
            |library: &mut EsiLibrary, text: &str| library.add_text(text, "x.xml").unwrap_err().to_string();
        assert!(error(&mut library, "<EtherCATInfo>\n  <Vendor></EtherCATInfo>").starts_with("x.xml:2:"));
        assert!(error(&mut library, "<html/>").contains("`html`, not EtherCATInfo"));
        // Entities are rejected, so they cannot expand.
        let bomb = "<!DOCTYPE a [<!ENTITY b \"bbbbbbbb\">]><EtherCATInfo>&b;</EtherCATInfo>";
        assert!(error(&mut library, bomb).starts_with("x.xml:1:"));
        assert!(library.is_empty());
    }
}

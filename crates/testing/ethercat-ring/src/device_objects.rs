//! The object dictionary of a device, and the PDOs in it.

use crate::drive_objects::add_drive_objects;
use crate::object::{Access, Dictionary, Entry, ObjectCode, data_type as t};
use crate::process_data::{INPUTS, OUTPUTS};
use crate::sii::{Identity, SiiEntry, SiiPdo};
use crate::subdevice::Device;

/// PDOs of the drive, with index and sub-index of what they map; index 0 is a gap of 8 bits.
const DRIVE_OUTPUTS: [(u16, u8); 8] = [
    (0x6040, 0),
    (0x607A, 0),
    (0x60B1, 0),
    (0x60B2, 0),
    (0x60B8, 0),
    (0x6060, 0),
    (0, 0),
    (0, 0),
];
const DRIVE_INPUTS: [(u16, u8); 12] = [
    (0x6041, 0),
    (0x6064, 0),
    (0x606C, 0),
    (0x60F4, 0),
    (0x6077, 0),
    (0x60B9, 0),
    (0x60BA, 0),
    (0x60FD, 0),
    (0x603F, 0),
    (0x6061, 0),
    (0, 0),
    (0, 0),
];
/// Maximum number of entries of a drive's PDO.
const PDO_SLOTS: usize = 16;

/// Objects of a device, its PDOs, and whether it has a mailbox.
pub(crate) fn device_objects(
    device: &Device,
    identity: Identity,
    name: &'static str,
) -> (Dictionary, Vec<SiiPdo>, bool) {
    let mut objects = Dictionary::default();
    let (pdos, device_type, has_mailbox) = match device {
        Device::Drive(drive) => {
            add_drive_objects(drive.settings(), &mut objects);
            (
                vec![(0x1600, DRIVE_OUTPUTS.to_vec()), (0x1A00, DRIVE_INPUTS.to_vec())],
                0x0002_0192,
                true,
            )
        }
        Device::Terminal(terminal) => (
            terminal.objects(&mut objects),
            0x0000_1389,
            terminal.has_mailbox(),
        ),
    };
    let is_drive = matches!(device, Device::Drive(_));
    objects.variable(0x1000, Entry::integer("Device type", t::UNSIGNED32, device_type));
    objects.variable(0x1001, Entry::integer("Error register", t::UNSIGNED8, 0));
    objects.variable(0x1008, Entry::text("Device name", name));
    objects.variable(0x1009, Entry::text("Hardware version", "simulated"));
    objects.variable(0x100A, Entry::text("Software version", env!("CARGO_PKG_VERSION")));
    let Identity {
        vendor,
        product,
        revision,
        serial,
    } = identity;
    let numbers = [
        ("Vendor", vendor),
        ("Product code", product),
        ("Revision", revision),
        ("Serial number", serial),
    ];
    let entries = numbers
        .map(|(name, value)| Entry::integer(name, t::UNSIGNED32, i64::from(value)))
        .to_vec();
    objects.compound(0x1018, "Identity", ObjectCode::Record, entries);
    let kinds = (1..=4)
        .map(|kind| Entry::integer("Type", t::UNSIGNED8, kind))
        .collect();
    objects.compound(0x1C00, "SyncManager types", ObjectCode::Array, kinds);
    let mut described = Vec::new();
    for (index, mapped) in &pdos {
        let values: Vec<i64> = mapped
            .iter()
            .map(|&(mapped, sub_index)| {
                let bits = objects.entry(mapped, sub_index).map_or(8, |entry| entry.bits);
                i64::from(mapped) << 16 | i64::from(sub_index) << 8 | i64::from(bits)
            })
            .collect();
        let name = if *index < 0x1A00 { "Outputs" } else { "Inputs" };
        let slots = if is_drive { PDO_SLOTS } else { values.len() };
        list(
            &mut objects,
            *index,
            name,
            t::UNSIGNED32,
            &values,
            slots,
            is_drive,
        );
        described.push(describe(&objects, *index, name, mapped));
    }
    for (index, name, is_input) in [
        (OUTPUTS, "Assignment of outputs", false),
        (INPUTS, "Assignment of inputs", true),
    ] {
        let values: Vec<i64> = pdos
            .iter()
            .map(|(pdo, _)| *pdo)
            .filter(|&pdo| (pdo >= 0x1A00) == is_input)
            .map(i64::from)
            .collect();
        list(
            &mut objects,
            index,
            name,
            t::UNSIGNED16,
            &values,
            values.len(),
            has_mailbox,
        );
    }
    (objects, described, has_mailbox)
}

/// Creates a list whose sub-index 0 is the number of valid entries.
fn list(
    objects: &mut Dictionary,
    index: u16,
    name: &'static str,
    kind: u16,
    values: &[i64],
    slots: usize,
    writable: bool,
) {
    let entry_of = |value: i64| {
        let entry = Entry::integer("Entry", kind, value);
        if writable { entry.configuration() } else { entry }
    };
    let entries = (0..slots)
        .map(|i| entry_of(values.get(i).copied().unwrap_or(0)))
        .collect();
    objects.compound(index, name, ObjectCode::Record, entries);
    objects.set_integer(index, 0, values.len() as i64);
    if let (true, Some(count)) = (writable, objects.entry_mut(index, 0)) {
        count.access = Access::Configuration;
    }
}

fn describe(objects: &Dictionary, index: u16, name: &'static str, mapped: &[(u16, u8)]) -> SiiPdo {
    let entries = mapped
        .iter()
        .map(|&(index, sub_index)| {
            let entry = objects.entry(index, sub_index);
            SiiEntry {
                index,
                sub_index,
                name: entry.map_or("", |entry| entry.name),
                data_type: entry.map_or(0, |entry| entry.data_type as u8),
                bits: entry.map_or(8, |entry| entry.bits),
            }
        })
        .collect();
    SiiPdo {
        index,
        sync_manager: 0,
        name,
        is_input: index >= 0x1A00,
        entries,
    }
}

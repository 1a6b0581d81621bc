//! The objects of a drive (CiA 402), by purpose.

use crate::drive_settings::{DriveSettings, OutputMask};
use crate::object::{Dictionary, Entry, ObjectCode, data_type as t};

/// Adds the objects of a drive with these settings.
pub(crate) fn add_drive_objects(settings: &DriveSettings, objects: &mut Dictionary) {
    let resolution = i64::from(settings.resolution);
    let rated_torque_mn_m = (settings.mechanics.rated_torque_n_m * 1000.0) as i64;
    let quick_stop = (i64::from(settings.quick_stop_turns_s2) * resolution).min(i64::from(u32::MAX));
    let variables = state_objects(quick_stop)
        .into_iter()
        .chain(position_objects(resolution, rated_torque_mn_m))
        .chain(homing_objects(resolution))
        .chain(input_objects());
    for (index, entry) in variables {
        objects.variable(index, entry);
    }
    // Longer than a mailbox, so that it is transferred in segments.
    objects.variable(
        0x2000,
        Entry::text("Note", &"test simulator ".repeat(20)).writable(),
    );
    add_pairs(resolution, objects);
    add_outputs(settings, objects);
    add_limits(settings, objects);
}

/// The state machine and the modes of operation.
fn state_objects(quick_stop: i64) -> [(u16, Entry); 8] {
    [
        (0x603F, Entry::integer("Error code", t::UNSIGNED16, 0).input()),
        (0x6040, Entry::integer("Control word", t::UNSIGNED16, 0).output()),
        (0x6041, Entry::integer("Status word", t::UNSIGNED16, 0).input()),
        (0x605A, Entry::integer("Quick stop option code", t::INTEGER16, 2)),
        (
            0x6060,
            Entry::integer("Modes of operation", t::INTEGER8, 0).output(),
        ),
        (
            0x6061,
            Entry::integer("Modes of operation display", t::INTEGER8, 0).input(),
        ),
        (
            0x6085,
            Entry::integer("Quick stop deceleration", t::UNSIGNED32, quick_stop).writable(),
        ),
        (
            0x6502,
            Entry::integer("Supported drive modes", t::UNSIGNED32, 0b1_1010_0000),
        ),
    ]
}

/// Cyclic synchronous position and velocity: targets, offsets, actual values.
fn position_objects(resolution: i64, rated_torque_mn_m: i64) -> [(u16, Entry); 11] {
    [
        (
            0x6064,
            Entry::integer("Position actual value", t::INTEGER32, 0).input(),
        ),
        (
            0x6065,
            Entry::integer("Following error window", t::UNSIGNED32, resolution).writable(),
        ),
        (
            0x6066,
            Entry::integer("Following error time out", t::UNSIGNED16, 20).writable(),
        ),
        (
            0x606C,
            Entry::integer("Velocity actual value", t::INTEGER32, 0).input(),
        ),
        (
            0x6076,
            Entry::integer("Motor rated torque", t::UNSIGNED32, rated_torque_mn_m),
        ),
        (
            0x6077,
            Entry::integer("Torque actual value", t::INTEGER16, 0).input(),
        ),
        (
            0x607A,
            Entry::integer("Target position", t::INTEGER32, 0).output(),
        ),
        (
            0x60FF,
            Entry::integer("Target velocity", t::INTEGER32, 0).output(),
        ),
        (
            0x60B1,
            Entry::integer("Velocity offset", t::INTEGER32, 0).output(),
        ),
        (0x60B2, Entry::integer("Torque offset", t::INTEGER16, 0).output()),
        (
            0x60F4,
            Entry::integer("Following error actual value", t::INTEGER32, 0).input(),
        ),
    ]
}

/// Homing.
fn homing_objects(resolution: i64) -> [(u16, Entry); 3] {
    [
        (0x607C, Entry::integer("Home offset", t::INTEGER32, 0).writable()),
        (
            0x6098,
            Entry::integer("Homing method", t::INTEGER8, 35).writable(),
        ),
        (
            0x609A,
            Entry::integer("Homing acceleration", t::UNSIGNED32, 50 * resolution.min(1 << 24)).writable(),
        ),
    ]
}

/// Digital inputs and the touch probes.
fn input_objects() -> [(u16, Entry); 7] {
    [
        (
            0x60B8,
            Entry::integer("Touch probe function", t::UNSIGNED16, 0).output(),
        ),
        (
            0x60B9,
            Entry::integer("Touch probe status", t::UNSIGNED16, 0).input(),
        ),
        (
            0x60BA,
            Entry::integer("Touch probe 1 positive edge", t::INTEGER32, 0).input(),
        ),
        (
            0x60BB,
            Entry::integer("Touch probe 1 negative edge", t::INTEGER32, 0).input(),
        ),
        (
            0x60BC,
            Entry::integer("Touch probe 2 positive edge", t::INTEGER32, 0).input(),
        ),
        (
            0x60BD,
            Entry::integer("Touch probe 2 negative edge", t::INTEGER32, 0).input(),
        ),
        (0x60FD, Entry::integer("Digital inputs", t::UNSIGNED32, 0).input()),
    ]
}

/// The drive's own limits, of which it has those that its settings give. It does not limit targets by them.
fn add_limits(settings: &DriveSettings, objects: &mut Dictionary) {
    let of_turns = |turns: u32| i64::from(turns) * i64::from(settings.resolution);
    for (index, name, value) in [
        (0x6080, "Max motor speed", settings.max_motor_rpm.map(i64::from)),
        (
            0x607F,
            "Max profile velocity",
            settings.max_profile_turns_s.map(of_turns),
        ),
        (0x60C5, "Max acceleration", settings.max_turns_s2.map(of_turns)),
    ] {
        if let Some(value) = value {
            objects.variable(index, Entry::integer(name, t::UNSIGNED32, value).writable());
        }
    }
}

/// Digital outputs: bits 0 (brake) and 16 to 31.
fn add_outputs(settings: &DriveSettings, objects: &mut Dictionary) {
    let start = i64::from(settings.start_outputs);
    let mut entries = vec![Entry::integer("Physical outputs", t::UNSIGNED32, start).output()];
    entries.extend(match settings.output_mask {
        OutputMask::Writable => Some(Entry::integer("Bit mask", t::UNSIGNED32, 0).output()),
        OutputMask::Fixed(mask) => Some(Entry::integer("Bit mask", t::UNSIGNED32, i64::from(mask))),
        OutputMask::Absent => None,
    });
    objects.compound(0x60FE, "Digital outputs", ObjectCode::Array, entries);
}

/// Objects of two numbers: homing speeds, the period, and the units.
fn add_pairs(resolution: i64, objects: &mut Dictionary) {
    let numbers = |names: [(&'static str, u16, i64); 2]| {
        names
            .map(|(name, kind, value)| Entry::integer(name, kind, value))
            .to_vec()
    };
    let writable = |entries: Vec<Entry>| entries.into_iter().map(Entry::writable).collect();
    let speeds = numbers([
        ("Search for switch", t::UNSIGNED32, 5 * resolution),
        ("Search for zero", t::UNSIGNED32, resolution / 2),
    ]);
    objects.compound(0x6099, "Homing speeds", ObjectCode::Array, writable(speeds));
    let period = numbers([("Value", t::UNSIGNED8, 1), ("Index", t::INTEGER8, -3)]);
    objects.compound(
        0x60C2,
        "Interpolation time period",
        ObjectCode::Record,
        writable(period),
    );
    let encoder = numbers([
        ("Increments", t::UNSIGNED32, resolution),
        ("Motor revolutions", t::UNSIGNED32, 1),
    ]);
    objects.compound(0x608F, "Position encoder resolution", ObjectCode::Array, encoder);
    let gear = numbers([
        ("Motor revolutions", t::UNSIGNED32, 1),
        ("Shaft revolutions", t::UNSIGNED32, 1),
    ]);
    objects.compound(0x6091, "Gear ratio", ObjectCode::Array, writable(gear));
}

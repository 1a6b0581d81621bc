//! Digital outputs of simulated drives (60FEh) as outputs of the machine, over real sockets.
//!
//! Needs the right to create a network namespace.

#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::time::{Duration, Instant};

use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat::{Network, check_fit};
use evolvent_ethercat_ring::{DriveSettings, OutputMask, SharedRing, SubDevice, TerminalKind, on_bench};
use evolvent_machine::Machine;

use crate::signals::with_files;

const X: usize = 1;
const Y: usize = 2;
const Z: usize = 3;

const MACHINE: &str = r#"
output = [
    { name = "clamp", number = 4, safe_on = true },
    { name = "lamp", number = 6 },
    { name = "brake", number = 7, safe_on = true },
]
"#;

/// The outputs of each drive.
const OUTPUTS: [(&str, &str); 3] = [
    (
        "x-drive",
        "[{ name = \"clamp\", bit = 16 }, { name = \"lamp\", bit = 17, inverted = true }]",
    ),
    ("y-drive", "[{ name = \"brake\", bit = 0 }]"),
    ("z-drive", "[{ function = \"flood\", bit = 31 }]"),
];

fn machine() -> Machine {
    let mill = evolvent_file_tests::shipped("machines/mill-ethercat.toml");
    Machine::parse(&format!("{MACHINE}{mill}"), "mill.toml").expect("a machine")
}

fn network() -> Network {
    let mut text = evolvent_file_tests::shipped("networks/sim-mill.toml");
    for (drive, outputs) in OUTPUTS {
        let name = format!("name = \"{drive}\"");
        text = text.replacen(&name, &format!("{name}\noutput = {outputs}"), 1);
    }
    Network::parse(&text, "drives.toml").expect("a network")
}

/// The mill with these masks of the digital outputs of X, Y and Z.
fn devices(masks: [OutputMask; 3], start_outputs: u32) -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    for (output_mask, serial) in masks.into_iter().zip(2..) {
        let settings = DriveSettings {
            output_mask,
            start_outputs,
            ..DriveSettings::default()
        };
        devices.push(SubDevice::drive(settings, serial, 0.0));
    }
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    devices
}

/// The contacts of the three drives.
fn contacts(ring: &SharedRing) -> [u32; 3] {
    let ring = ring.lock().expect("no panic");
    [X, Y, Z].map(|at| {
        let drive = ring.devices()[at].as_drive().expect("a drive");
        drive.digital_outputs()
    })
}

/// Clamp on, lamp off (inverted), brake on; X and Z have closed their own brakes.
const SAFE: [u32; 3] = [0x0003_0001, 0x0000_0001, 0x0000_0001];

#[test]
fn outputs_of_drives_follow_the_core_and_are_safe_without_it() {
    assert_eq!(check_fit(&machine(), &network()), Ok(()));
    unless_disturbed(|| {
        on_bench(devices([OutputMask::Writable; 3], 0xFFFF_FFFF), |ring| {
            with_files(machine(), network(), ring, |core, ring, _| {
                core.outputs.digital_mask = 1 << 4 | 1 << 6 | 1 << 7;
                core.outputs.digital = 1 << 4 | 1 << 7;
                core.outputs.safe_digital = 1 << 4 | 1 << 7;
                core.until("safe outputs", |_| contacts(ring) == SAFE);
                let masks = [X, Y, Z].map(|at| {
                    let ring = ring.lock().expect("no panic");
                    ring.devices()[at].objects().integer(0x60FE, 2)
                });
                assert_eq!(masks, [0x0003_0000, 0x0000_0001, 0x8000_0000]);
                core.outputs.digital = 1 << 6;
                core.outputs.coolant = 0b10;
                let wanted = [0x0000_0001, 0, 0x8000_0001];
                core.until("outputs as the core says", |_| contacts(ring) == wanted);
                // The core becomes silent.
                let begin = Instant::now();
                while contacts(ring) != SAFE {
                    assert!(begin.elapsed() < Duration::from_secs(2), "{:X?}", contacts(ring));
                    std::thread::sleep(Duration::from_millis(2));
                }
                assert!(
                    begin.elapsed() >= Duration::from_millis(150),
                    "{:?}",
                    begin.elapsed()
                );
            });
            // The bridge has ended: safe values first, then the drives leave OP and have their outputs back.
            let last = contacts(ring);
            assert!(last == SAFE || last == [1; 3], "{last:X?}");
        });
    });
}

/// Without a mask, or with one that cannot be written, the bus has more outputs than the network file names:
/// they stay as the drive had them.
#[test]
fn outputs_without_names_keep_the_bits_of_the_drive() {
    unless_disturbed(|| {
        let masks = [
            OutputMask::Absent,
            OutputMask::Fixed(0x0004_0001),
            OutputMask::Fixed(0xFFFF_0000),
        ];
        on_bench(devices(masks, 0x8014_0000), |ring| {
            with_files(machine(), network(), ring, |core, ring, _| {
                core.outputs.coolant = 0b10;
                core.until("named and other bits", |_| {
                    contacts(ring) == [0x8017_0000, 0x0004_0001, 0x8014_0001]
                });
                core.outputs.coolant = 0;
                core.until("no coolant", |_| contacts(ring)[2] == 0x0014_0001);
            });
        });
    });
}

#[test]
fn a_mask_without_the_output_is_told() {
    unless_disturbed(|| {
        let masks = [
            OutputMask::Fixed(0x0001_0000),
            OutputMask::Absent,
            OutputMask::Absent,
        ];
        on_bench(devices(masks, 0x0010_0000), |ring| {
            with_files(machine(), network(), ring, |core, ring, messages| {
                let expected =
                    "`x-drive`: object 60FEh:2 cannot be written: the device rejects it: 0x06010002";
                core.until(expected, |_| messages.contain(expected));
                // Before the bus has them, they are safe: an earlier bridge may have left them on.
                let ring = ring.lock().expect("no panic");
                assert_eq!(ring.devices()[X].objects().integer(0x60FE, 1), 0x0013_0000);
            });
        });
    });
}

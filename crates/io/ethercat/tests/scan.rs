//! `scan` on the simulated ring over a real socket: what is on the wire, and a network file that a bridge
//! takes. A reply later than half a second counts as missing: a trial in which the host kept the ring from
//! running for that long is repeated.
//!
//! Needs the right to create a network namespace.

use std::time::Duration;

use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat::{
    FitError, Network, ScanError, SiiContents, check_fit, network_text, round_trips, scan, scan_text,
};
use evolvent_ethercat_ring::{
    DriveSettings, FaultKind, MAIN_INTERFACE, PacketSocket, SubDevice, TerminalKind, monotonic_ns, on_bench,
};
use evolvent_machine::Machine;
use evolvent_path::AxisLetter;
use evolvent_random::{Random, cases};

fn devices() -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    devices.extend((2..5).map(|serial| SubDevice::drive(DriveSettings::default(), serial, 0.0)));
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    devices.push(SubDevice::terminal(TerminalKind::DigitalOutput, 6));
    devices.push(SubDevice::terminal(TerminalKind::AnalogInput, 7));
    devices
}

fn letters(text: &str) -> Vec<AxisLetter> {
    text.chars().filter_map(AxisLetter::from_letter).collect()
}

/// A second MainDevice would take the devices of the first out of operation.
#[test]
fn an_interface_in_use_is_refused() {
    on_bench(devices(), |ring| {
        let other = PacketSocket::open(MAIN_INTERFACE).expect("another MainDevice");
        let period = Duration::from_millis(1);
        let refused = [
            scan(MAIN_INTERFACE).expect_err("a scan").to_string(),
            round_trips(MAIN_INTERFACE, period, period)
                .expect_err("round trips")
                .to_string(),
        ];
        let own = format!(
            "is in use by another EtherCAT MainDevice (process {}",
            std::process::id()
        );
        assert!(refused.iter().all(|why| why.contains(&own)), "{refused:?}");
        assert_eq!(ring.lock().expect("the ring").frames(), 0);
        drop(other);
        let (trips, _) = round_trips(MAIN_INTERFACE, period, period).expect("an interface");
        assert_eq!(trips.sent, 1);
        assert_eq!(ring.lock().expect("the ring").frames(), 1);
    });
}

#[test]
fn scan_lists_devices_and_its_file_fits_machine() {
    unless_disturbed(|| {
        on_bench(devices(), |_| {
            let found = scan(MAIN_INTERFACE).expect("a ring");
            let names: Vec<&str> = found.iter().map(|device| device.sii.order.as_str()).collect();
            let drive = found[1].sii.order.as_str();
            assert_eq!(
                names,
                [
                    "SIM-EK1100",
                    drive,
                    drive,
                    drive,
                    "SIM-EL1008",
                    "SIM-EL2008",
                    "SIM-EL3102"
                ]
            );
            assert!(found.iter().all(|device| device.state == "Init"), "{found:#?}");
            assert!(
                found.iter().all(|device| device.problems.is_empty()),
                "{found:#?}"
            );
            let serials: Vec<u32> = found.iter().map(|device| device.sii.serial).collect();
            assert_eq!(serials, [1, 2, 3, 4, 5, 6, 7]);
            let is_drive: Vec<bool> = found.iter().map(|device| device.is_drive()).collect();
            assert_eq!(is_drive, [false, true, true, true, false, false, false]);
            assert_eq!(found[1].clock, "64 bits");
            // 8 bits each way, 2 channels of status and value.
            let sizes = |device: usize| {
                let bits = |pdos: &[evolvent_ethercat::Pdo]| -> u32 {
                    let entries = pdos.iter().flat_map(|pdo| &pdo.entries);
                    entries.map(|entry| u32::from(entry.bits)).sum()
                };
                (bits(found[device].outputs()), bits(found[device].inputs()))
            };
            assert_eq!(
                [sizes(0), sizes(4), sizes(5), sizes(6)],
                [(0, 0), (0, 8), (8, 0), (0, 64)]
            );
            let control_word = found[1].outputs()[0].entries[0].index;
            assert_eq!(control_word, 0x6040, "{}", scan_text(&found));

            let text = network_text(&found, MAIN_INTERFACE, &letters("XYZ")).expect("drives");
            let network = Network::parse(&text, "scanned.toml").expect(&text);
            assert_eq!(network.devices.len(), 7);
            assert_eq!(network.axes_mask().bits(), 0b111);
            let machine = Machine::parse(
                &evolvent_file_tests::shipped("machines/mill-ethercat.toml"),
                "mill.toml",
            )
            .expect("a machine");
            assert_eq!(check_fit(&machine, &network), Err(FitError::Unchecked));
            let checked =
                Network::parse(&text.replace("unchecked = true\n", ""), "scanned.toml").expect(&text);
            assert_eq!(check_fit(&machine, &checked), Ok(()));
            // The same identities and letters as in the file for the same ring that was written by hand.
            let by_hand = Network::parse(
                &evolvent_file_tests::shipped("networks/sim-mill.toml"),
                "sim-mill.toml",
            )
            .expect("a network");
            for (device, other) in checked.devices.iter().zip(&by_hand.devices) {
                assert_eq!((device.vendor, device.product), (other.vendor, other.product));
                assert_eq!(
                    device.axis.map(|axis| axis.axis),
                    other.axis.map(|axis| axis.axis)
                );
            }
        });
    });
}

#[test]
fn missing_device_is_not_listed_dead_wire_is_reported() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            let begin = |kind, device| {
                ring.lock()
                    .expect("no panic")
                    .begin_fault(monotonic_ns(), kind, device, None);
            };
            begin(FaultKind::Break, 4);
            assert_eq!(scan(MAIN_INTERFACE).expect("what is before the break").len(), 4);
            begin(FaultKind::Loss, 0);
            assert!(matches!(scan(MAIN_INTERFACE), Err(ScanError::NoDevices)));
        });
    });
}

#[test]
fn an_emergency_message_is_listed_with_its_device() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            ring.lock()
                .expect("no panic")
                .begin_fault(monotonic_ns(), FaultKind::Emergency, 1, None);
            let found = scan(MAIN_INTERFACE).expect("a ring");
            let problem = "emergency message 7121h: motor: blocked, or commutation lost (error register 01h)";
            assert_eq!(found[1].problems, [problem]);
            assert!(found[2].problems.is_empty(), "{found:#?}");
            assert!(scan_text(&found).contains(problem));
        });
    });
}

#[test]
fn a_network_without_drives_gives_no_file() {
    assert_eq!(network_text(&[], "ec0", &letters("XYZ")), None);
}

/// Whatever devices report, the written file loads, and is marked as unchecked.
#[test]
fn files_of_hostile_devices_load() {
    let mut random = Random::seeded(17);
    for _ in 0..cases(500) {
        let mut found: Vec<evolvent_ethercat::FoundDevice> = (0..1 + random.bits() % 12)
            .map(|_| {
                let mut image: Vec<u8> = (0..random.bits() % 4096).map(|_| random.bits() as u8).collect();
                // Half of them with categories of a likely kind, so that the parser gets beyond the first.
                if random.unit() < 0.5 {
                    let kinds = [10_u16, 30, 40, 41, 50, 51, 60];
                    let mut offset = 0x80;
                    while offset + 4 <= image.len() {
                        let kind = kinds[(random.bits() % 7) as usize].to_le_bytes();
                        let words = random.bits() % 64;
                        image[offset..offset + 4].copy_from_slice(&[kind[0], kind[1], words as u8, 0]);
                        offset += 4 + 2 * words as usize;
                    }
                }
                evolvent_ethercat::FoundDevice {
                    sii: SiiContents::parse(&image),
                    device_type: (random.unit() < 0.7).then_some(0x0002_0192),
                    resolution: (random.unit() < 0.5)
                        .then(|| [random.bits() as u32, random.bits() as u32 % 3]),
                    gear: (random.unit() < 0.5).then(|| [random.bits() as u32, random.bits() as u32 % 3]),
                    ..evolvent_ethercat::FoundDevice::default()
                }
            })
            .collect();
        found[0].device_type = Some(402);
        // Text of devices is one line of printable characters.
        for text in found
            .iter()
            .flat_map(|device| [&device.sii.name, &device.sii.order])
        {
            assert!(text.bytes().all(|byte| (0x20..0x7F).contains(&byte)), "{text:?}");
        }
        let text = network_text(&found, "ec\"0\\\n", &letters("XYZABCUVW")).expect("a drive");
        let network = Network::parse(&text, "hostile.toml").unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert!(network.is_unchecked);
        assert_eq!(network.devices.len(), found.len());
        for (device, found) in network.devices.iter().zip(&found) {
            assert_eq!(
                (device.vendor, device.product, device.revision),
                (found.sii.vendor, found.sii.product, Some(found.sii.revision))
            );
        }
    }
}

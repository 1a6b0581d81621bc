//! The bridge of the shipped network, with a core that holds or moves X.

#![expect(clippy::expect_used, reason = "a test")]
#![allow(dead_code, reason = "each test takes its part")]

use std::sync::atomic::{AtomicU32, Ordering};

use evolvent_bridge_trial::{Messages, TrialCore, with_bridge as with_bridge_and_core};
use evolvent_ethercat::{BridgeReport, Network, RunSettings, run};
use evolvent_ethercat_ring::{
    DriveSettings, FaultKind, MAIN_INTERFACE, SharedRing, SubDevice, TerminalKind, monotonic_ns,
};
use evolvent_machine::Machine;

pub(crate) fn devices() -> Vec<SubDevice> {
    devices_of(DriveSettings::default())
}

/// The devices with other settings of the drives.
pub(crate) fn devices_of(drives: DriveSettings) -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    devices.extend((2..5).map(|serial| SubDevice::drive(drives, serial, 10.0 * f64::from(serial))));
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    devices
}

/// Runs the bridge, with its messages, during a test.
pub(crate) fn with_bridge(
    edit: impl FnOnce(&mut Network),
    ring: &SharedRing,
    test: impl FnOnce(&mut TrialCore, &SharedRing, &Messages),
) -> BridgeReport {
    with_settings(|settings| edit(&mut settings.network), ring, test)
}

/// Like [`with_bridge`], with other settings of the bridge.
pub(crate) fn with_settings(
    edit: impl FnOnce(&mut RunSettings),
    ring: &SharedRing,
    test: impl FnOnce(&mut TrialCore, &SharedRing, &Messages),
) -> BridgeReport {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let prefix = format!("ecft{}-{number}_", std::process::id());
    let mut network = Network::parse(
        &evolvent_file_tests::shipped("networks/sim-mill.toml"),
        "sim-mill.toml",
    )
    .expect("a network");
    network.max_lost_cycles = 20;
    let mut settings = RunSettings {
        machine: Machine::parse(
            &evolvent_file_tests::shipped("machines/mill-ethercat.toml"),
            "mill.toml",
        )
        .expect("a machine"),
        machine_name: Some("ethercat-faults".to_owned()),
        network,
        interface: MAIN_INTERFACE.to_owned(),
        prefix: Some(prefix.clone()),
        duration: None,
        dump: None,
    };
    edit(&mut settings);
    with_bridge_and_core(
        &prefix,
        |stop, messages| run(&settings, stop, |text| messages.push(text)),
        TrialCore::open("ethercat-faults", &prefix),
        |core, messages| test(core, ring, messages),
    )
}

pub(crate) fn begin(ring: &SharedRing, kind: FaultKind, device: usize, duration_ns: Option<u64>) {
    ring.lock()
        .expect("no panic")
        .begin_fault(monotonic_ns(), kind, device, duration_ns);
}

pub(crate) fn speeds(ring: &SharedRing) -> Vec<f64> {
    let ring = ring.lock().expect("no panic");
    ring.devices()
        .iter()
        .filter_map(|device| device.as_drive())
        .map(|drive| drive.speed_turns_s().abs())
        .collect()
}

//! The suite for all bridges, on the simulated ring over real sockets.
//!
//! Needs the right to create a network namespace.

#![expect(clippy::expect_used, clippy::print_stdout, reason = "a test")]

use core::ops::Range;

use evolvent_bridge_test::{CASES, ThreadBridge};
use evolvent_bridge_trial::{failed_cases, failed_probe_cases, failed_spindle_cases};
use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat::{Network, RunSettings, run};
use evolvent_ethercat_ring::{DriveSettings, MAIN_INTERFACE, SubDevice, TerminalKind, on_bench};
use evolvent_machine::Machine;

const NETWORK: &str = include_str!("../../../../config/networks/sim-mill.toml");

fn devices() -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    for serial in 2..5 {
        devices.push(SubDevice::drive(
            DriveSettings::default(),
            serial,
            15.0 * f64::from(serial),
        ));
    }
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    devices.push(SubDevice::terminal(TerminalKind::DigitalOutput, 6));
    devices
}

/// Bit 2 of the outputs is output 0, bit 2 of the inputs input 0; the ring wires them.
const SIGNALS: &str = r#"
input = [{ name = "echo", bit = 2 }]

[[device]]
name = "outputs"
vendor = 0x4556534D
product = 0x2008
output = [{ name = "lamp", bit = 2 }]
"#;
const MACHINE_SIGNALS: &str = r#"
input = [{ name = "echo", number = 0 }]
output = [{ name = "lamp", number = 0 }]
"#;

/// A spindle drive after the axes and the inputs.
const SPINDLE: &str = r#"
[[device]]
name = "spindle"
vendor = 0x4556534D
product = 0x402

[device.spindle]
increments_per_turn = 1048576
index_probe = 2
"#;
const MACHINE_SPINDLE: &str = "\n[[spindle]]\nmax_rpm = 3000\nfeedback = true\n";

/// The bridge on a thread of this process, with this network file.
fn ethercat_bridge(machine: Machine, network: String) -> ThreadBridge {
    ThreadBridge::new(move |machine_name, prefix, stop| {
        let mut network = Network::parse(&network, "sim-mill.toml").expect("a network");
        // The suite's period is 2 ms, the devices' watchdog 100 ms; a busy host may be late for that long.
        network.max_lost_cycles = 40;
        let settings = RunSettings {
            machine: machine.clone(),
            machine_name: Some(machine_name.to_owned()),
            network,
            interface: MAIN_INTERFACE.to_owned(),
            prefix: Some(prefix.to_owned()),
            duration: None,
            dump: None,
        };
        let report = run(&settings, stop, |text| println!("{text}"));
        println!("{report:?}");
    })
}

/// Its drives come into fault if the bridge is killed, for which it must be a process:
/// `the_ethercat_bridge_and_its_core_may_be_killed` of the tests across crates.
const LEFT_OUT: &[&str] = &["new_core_reset"];

fn suite(cases: Range<usize>) {
    unless_disturbed(|| {
        let cases = cases.clone();
        on_bench(devices(), |ring| {
            ring.lock().expect("no panic").wire(5, 4);
            let text = evolvent_file_tests::shipped("machines/mill-ethercat.toml");
            let machine = Machine::parse(&format!("{MACHINE_SIGNALS}{text}"), "mill-3axis.toml");
            // Both halves may run at the same time.
            let prefix = format!("ecbt{}_{}", std::process::id(), cases.start);
            let mut bridge = ethercat_bridge(machine.expect("a machine"), format!("{NETWORK}{SIGNALS}"));
            let failures = failed_cases(&mut bridge, &prefix, &CASES[cases], LEFT_OUT);
            assert!(failures.is_empty(), "{failures:#?}");
        });
    });
}

/// Two halves run at the same time, because each waits most of the time.
const HALF: usize = CASES.len() / 2;

#[test]
fn it_does_what_every_bridge_must() {
    suite(0..HALF);
}

#[test]
fn it_does_the_rest_of_what_every_bridge_must() {
    suite(HALF..CASES.len());
}

#[test]
fn its_spindle_does_what_every_spindle_must() {
    unless_disturbed(|| {
        let mut devices = devices();
        let spindle = DriveSettings {
            limits_turns: [f64::NEG_INFINITY, f64::INFINITY],
            probe_turns: f64::INFINITY,
            index_turns: 0.3,
            ..DriveSettings::default()
        };
        devices[5] = SubDevice::drive(spindle, 6, -15.0);
        on_bench(devices, |_| {
            let text = evolvent_file_tests::shipped("machines/mill-ethercat.toml");
            let machine = Machine::parse(&format!("{text}{MACHINE_SPINDLE}"), "mill-3axis.toml");
            let mut bridge = ethercat_bridge(machine.expect("a machine"), format!("{NETWORK}{SPINDLE}"));
            let failures = failed_spindle_cases(&mut bridge, &format!("ecbs{}_", std::process::id()));
            assert!(failures.is_empty(), "{failures:#?}");
        });
    });
}

/// X makes contact 2.3 mm from its position, latched by its touch probe 1 (60B8h).
#[test]
fn its_probe_does_what_every_probe_must() {
    const SCREW_MM: f64 = 5.0;
    unless_disturbed(|| {
        let mut devices = devices();
        // The shipped network has no outputs.
        devices.truncate(5);
        let x = DriveSettings {
            probe_turns: 2.3 / SCREW_MM,
            ..DriveSettings::default()
        };
        devices[1] = SubDevice::drive(x, 2, 30.0);
        on_bench(devices, |_| {
            let text = evolvent_file_tests::shipped("machines/mill-ethercat.toml");
            let machine = Machine::parse(&text, "mill-3axis.toml").expect("a machine");
            let of_x = "velocity_offset = true";
            let network = NETWORK.replacen(
                of_x,
                "touch_probe = true\nprobe_input_bit = 16\nvelocity_offset = true",
                1,
            );
            let mut bridge = ethercat_bridge(machine, network);
            let failures = failed_probe_cases(&mut bridge, &format!("ecbp{}_", std::process::id()));
            assert!(failures.is_empty(), "{failures:#?}");
        });
    });
}

//! Every shipped pair of files, a machine with its network or board, started as in the docs: core, bridge and
//! simulator as in use. Only timeouts for busy hosts are changed: how long setpoints, frames, packets and
//! feedback may be missing.
//!
//! The EtherCAT ring needs the right to create a network namespace.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU8, Ordering};

use evolvent_bus::ControlRequest;
use evolvent_ethercat_ring::{DriveSettings, MAIN_INTERFACE, SubDevice, TerminalKind, on_bench};
use evolvent_mesa_board::{Board, BoardModel, BoardServer, Switch, now_ns};
use evolvent_tests::job_result::DONE;
use evolvent_tests::{
    Domain, HardwareBridge, Operator, Served, Workshop, command, repository, run, unless_disturbed,
};

/// Machines with their networks; and machines with their boards, the model of the simulator, and its
/// switches.
const NETWORKS: [(&str, &str); 2] = [("mill-ethercat", "sim-mill"), ("lathe-ethercat", "sim-lathe")];
const BOARDS: [(&str, &str, BoardModel, &[&str]); 4] = [
    ("router-3axis", "7i96s-router", BoardModel::B7i96s, &ROUTER),
    ("router-3axis", "7i96s-gantry", BoardModel::B7i96s, &[]),
    ("router-3axis", "7i76e-router", BoardModel::B7i76e, &ROUTER),
    (
        "lathe-mesa",
        "7i96s-lathe",
        BoardModel::B7i96s,
        &["0:0:3200", "1:1:2560"],
    ),
];
const ROUTER: [&str; 3] = ["0:0:-640", "1:1:640", "2:2:1600"];

/// A shipped file with pieces of its text replaced.
fn changed(file: &str, changes: &[(&str, &str)]) -> String {
    let path = repository().join("config").join(file);
    let mut text = std::fs::read_to_string(path).expect("a file that ships");
    for (from, to) in changes {
        assert!(text.contains(from), "{from} is not in {file}");
        text = text.replacen(from, to, 1);
    }
    text
}

/// The machine file, with a long lead and long timeouts for feedback and inputs.
fn machine(name: &str, workshop: &Workshop) -> PathBuf {
    let lead = ("rate = 1000 ", "lead_cycles = 60\nrate = 1000 ");
    let mut text = changed(&format!("machines/{name}.toml"), &[lead]);
    let patience = "feedback_timeout_ms = 1000\n";
    let usual = "feedback_timeout_ms = 20 ";
    if text.contains(usual) {
        text = text.replacen(usual, "feedback_timeout_ms = 1000 ", 1);
    } else if text.contains("\n[drives]\n") {
        text = text.replacen("\n[drives]\n", &format!("\n[drives]\n{patience}"), 1);
    } else {
        text += &format!("\n[drives]\n{patience}");
    }
    assert!(!text.contains("\n[signals]\n"));
    text += "\n[signals]\ninput_timeout_ms = 1000\n";
    workshop.write(&format!("{name}.toml"), text)
}

/// Serves the machine, starts the bridge, requests power, and jogs one axis. Drives that home on their own
/// first move to these positions.
fn starts(name: &str, bridge: &[String], machine: &Path, workshop: &Workshop, homed_at: &[(usize, f64)]) {
    let domain = Domain::new();
    let served = Served::start(machine, name, &domain, &workshop.path("state"), &[]);
    let hardware = HardwareBridge::start(bridge, machine, &domain);
    let mut operator = Operator::join(name, &domain);
    operator.waits("drives", |status| status.feedback_age_ns < 500_000_000);
    operator.says("ESTOP_RESET");
    operator.says("ON");
    if !homed_at.is_empty() {
        operator.waits("machine zero of the drives", |status| {
            let near =
                |(axis, position): &(usize, f64)| (status.position_actual[*axis] - position).abs() < 0.05;
            homed_at.iter().all(near)
        });
        operator.says("OFF");
        operator.says("ON");
    }
    operator.waits("power", |status| status.machine_state == 2);
    operator.says_number("MODE", 1);
    if !homed_at.is_empty() {
        let homed = operator.homes();
        assert_eq!(homed.job_result, DONE, "{}", homed.alarm_sentence());
    }
    let mut jog = ControlRequest {
        axes_mask: 1,
        index: 1,
        amount: 10.0,
        ..command("JOG")
    };
    // Into the travel of X.
    jog.values[0] = if name.starts_with("lathe") { -10.0 } else { 1.0 };
    let job = operator.does(&jog).job;
    let moved = operator.sees_end(job);
    assert_eq!(moved.job_result, DONE, "{name}: {}", moved.alarm_sentence());
    operator.says("OFF");
    operator.waits("off", |status| status.machine_state != 2);
    drop(operator);
    let _ended = served.end().expect_code(&[0, 3]);
    drop(hardware);
}

/// The devices that the header of the network file names.
fn devices(network: &str) -> Vec<SubDevice> {
    let axis = |serial, limits_turns| {
        let settings = DriveSettings {
            limits_turns,
            ..DriveSettings::default()
        };
        SubDevice::drive(settings, serial, 10.0)
    };
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    if network == "sim-mill" {
        devices.extend((2..5).map(|serial| axis(serial, DriveSettings::default().limits_turns)));
        devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    } else {
        devices.extend((2..4).map(|serial| axis(serial, [-90.0, 10.0])));
        let spindle = DriveSettings {
            limits_turns: [f64::NEG_INFINITY, f64::INFINITY],
            probe_turns: f64::INFINITY,
            ..DriveSettings::default()
        };
        devices.push(SubDevice::drive(spindle, 4, 10.0));
        devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
        devices.push(SubDevice::terminal(TerminalKind::DigitalOutput, 6));
        devices.push(SubDevice::terminal(TerminalKind::AnalogInput, 7));
    }
    devices
}

#[test]
fn every_machine_starts_with_its_network() {
    for (name, network) in NETWORKS {
        unless_disturbed(|| {
            on_bench(devices(network), move |_ring| {
                let workshop = Workshop::new();
                let machine = machine(name, &workshop);
                let lost = if network == "sim-mill" {
                    ("max_lost_cycles = 3 ", "max_lost_cycles = 40 ")
                } else {
                    ("interface = \"ec0\"", "max_lost_cycles = 40\ninterface = \"ec0\"")
                };
                let file = workshop.write(
                    "network.toml",
                    changed(&format!("networks/{network}.toml"), &[lost]),
                );
                let file = file.display().to_string();
                let bridge = ["ethercat", "--network", &file, "--interface", MAIN_INTERFACE];
                let homed_at: &[(usize, f64)] = if network == "sim-mill" {
                    &[]
                } else {
                    &[(0, 205.0), (2, 605.0)]
                };
                starts(name, &bridge.map(str::to_owned), &machine, &workshop, homed_at);
            });
        });
    }
}

#[test]
fn every_machine_starts_with_its_board() {
    static NUMBER: AtomicU8 = AtomicU8::new(1);
    for (name, board, model, switches) in BOARDS {
        unless_disturbed(|| {
            let process = std::process::id();
            let number = NUMBER.fetch_add(1, Ordering::Relaxed);
            let address = std::net::IpAddr::from([127, 30, process as u8, number]);
            let server = BoardServer::start(Board::new(model, now_ns()), address).expect("an address");
            for switch in switches {
                let switch: Switch = switch.parse().expect("a switch");
                server.lock().add_switch(switch);
            }
            // Current through the isolated input of the lathe's inverter, when it is in order, makes the
            // input low; other boards ignore it.
            if name == "lathe-mesa" {
                server.lock().set_level(3, false);
            }
            let workshop = Workshop::new();
            let machine = machine(name, &workshop);
            let mut text = changed(&format!("boards/{board}.toml"), &[]);
            for line in ["max_lost_packets = 5 ", "watchdog_ms = 50 "] {
                text = text.replacen(line, "# ", 1);
            }
            let text = format!("max_lost_packets = 40\nwatchdog_ms = 400\n{text}");
            let file = workshop.write("board.toml", text).display().to_string();
            let address = address.to_string();
            let bridge = ["mesa", "--board", &file, "--address", &address].map(str::to_owned);
            starts(name, &bridge, &machine, &workshop, &[]);
        });
    }
}

/// A new file belongs to a pair.
#[test]
fn no_network_and_no_board_ships_without_its_machine() {
    for (folder, paired) in [
        ("networks", NETWORKS.map(|(_, network)| network).to_vec()),
        ("boards", BOARDS.map(|(_, board, ..)| board).to_vec()),
    ] {
        for entry in std::fs::read_dir(repository().join("config").join(folder)).expect("a folder") {
            let path = entry.expect("a file").path();
            let name = path.file_stem().and_then(|name| name.to_str()).expect("a name");
            assert!(paired.contains(&name), "{folder}/{name}.toml is not tried");
        }
    }
}

/// The command of the docs, with the network of a machine whose period the drives do not support.
#[test]
fn a_bridge_whose_drives_lack_the_period_ends() {
    let workshop = Workshop::new();
    let network = "config/networks/sim-mill.toml";
    let slow = workshop.write(
        "slow.toml",
        changed("machines/mill-ethercat.toml", &[("rate = 1000 ", "rate = 750 ")]),
    );
    let slow = slow.display().to_string();
    for (machine, texts) in [
        (
            "config/machines/mill-3axis.toml",
            ["rate = \"rational\"", "write rate = 1000"],
        ),
        (slow.as_str(), ["rate = 750", "write rate = 1000"]),
    ] {
        let finished = run(["bridge", "ethercat", "--machine", machine, "--network", network]);
        for text in texts {
            assert!(finished.err.contains(text), "{text}: {}", finished.err);
        }
        let _refused = finished.expect_code(&[2]);
    }
}

//! Hardware and bridges that fail during a motion: the simulators of the EtherCAT ring and of the Mesa board,
//! and then their bridges, are killed while a served machine moves. The core reports a fault in time, stops
//! the axes without power, and works again after they have returned and power was requested again.
//!
//! The EtherCAT ring needs the right to create a network namespace.
#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail and talk as tests do"
)]

use std::path::Path;
use std::time::{Duration, Instant};

use evolvent_ethercat_ring::{MAIN_INTERFACE, on_bench};
use evolvent_tests::job_result::{DONE, FAULT};
use evolvent_tests::{
    Domain, HardwareBridge, Operator, Served, Simulator, Workshop, command, repository, unless_disturbed,
};

/// Maximum age of feedback for the core: busy hosts delay bridge and simulator.
const TIMEOUT_MS: u64 = 400;
/// Additional time for the core, its status and this test.
const SLACK: Duration = Duration::from_millis(300);

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

/// Requests power until the machine is on, as an operator does: a drive that lost its fieldbus needs a reset
/// that it can see.
fn recovers(operator: &mut Operator) {
    for _ in 0..20 {
        operator.waits("drives", |status| status.feedback_age_ns < 100_000_000);
        operator.says("CLEAR_ALARMS");
        std::thread::sleep(Duration::from_millis(300));
        let _accepted = operator.request(&command("ON"));
        for _ in 0..40 {
            if operator.now().machine_state == 2 {
                return;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }
    panic!("no power: {}", operator.now().alarm_sentence());
}

/// Moves X, and kills something meanwhile that the drives need.
fn stops(name: &str, operator: &mut Operator, kill: impl FnOnce()) {
    operator.says_number("MODE", 2);
    let job = operator.says_text("MDI", "G91 G1 X60 F1200").job;
    operator.waits("motion", |status| status.velocity[0] > 15.0);
    kill();
    let killed = Instant::now();
    let status = operator.waits("the alarm", |status| status.alarm_count > 0);
    let after = killed.elapsed();
    // Feedback has ended, or drives do not reply in the last message.
    let alarm = status.listed_alarms()[0];
    println!(
        "{name}: alarm {alarm} after {after:?}: {}",
        status.alarm_sentence()
    );
    assert!([401, 406].contains(&alarm), "{}", status.alarm_sentence());
    let max = Duration::from_millis(TIMEOUT_MS) + SLACK;
    assert!(after < max, "the alarm came after {after:?}, at most {max:?}");
    assert_eq!(operator.sees_end(job).job_result, FAULT);
    operator.waits("rest without power", |status| {
        status.velocity == [0.0; 9] && status.power == 0 && status.machine_state == 1
    });
    assert_eq!(
        operator.request(&command("ON")).alarm,
        918,
        "the alarm stays until it is cleared"
    );
}

/// Nothing switches on by itself when the drives return; after a reset the machine is homed and moves.
fn works_again(operator: &mut Operator) {
    operator.waits("drives again", |status| status.feedback_age_ns < 100_000_000);
    std::thread::sleep(Duration::from_millis(500));
    let returned = operator.now();
    assert_eq!(
        (returned.machine_state, returned.power),
        (1, 0),
        "{}",
        returned.alarm_sentence()
    );
    recovers(operator);
    // It counts from another zero, and is homed again.
    let homed = operator.homes();
    assert_eq!(homed.job_result, DONE, "{}", homed.alarm_sentence());
    operator.says_number("MODE", 2);
    let before = operator.now().position_actual[0];
    let job = operator.says_text("MDI", "G91 G1 X5 F1200").job;
    let ended = operator.sees_end(job);
    assert_eq!(ended.job_result, DONE, "{}", ended.alarm_sentence());
    let moved = operator.now().position_actual[0] - before;
    assert!((moved - 5.0).abs() < 0.05, "{moved} mm");
}

/// Serves the machine, and kills the hardware and then the bridge while X moves.
fn are_killed(
    name: &str,
    machine: &Path,
    bridge: &[String],
    workshop: &Workshop,
    start: &dyn Fn() -> Simulator,
) {
    let domain = Domain::new();
    let simulator = start();
    let served = Served::start(machine, name, &domain, &workshop.path("state"), &[]);
    let hardware = HardwareBridge::start(bridge, machine, &domain);
    let mut operator = Operator::join(name, &domain);
    operator.waits("drives", |status| status.feedback_age_ns < 100_000_000);
    operator.brings_up();
    let homed = operator.homes();
    assert_eq!(homed.job_result, DONE, "{}", homed.alarm_sentence());
    stops(name, &mut operator, || simulator.kill());
    let simulator = start();
    works_again(&mut operator);
    stops(name, &mut operator, || drop(hardware));
    let hardware = HardwareBridge::start(bridge, machine, &domain);
    works_again(&mut operator);
    operator.says("OFF");
    operator.waits("off", |status| status.machine_state != 2);
    drop(operator);
    let _ended = served.end().expect_code(&[0, 3]);
    drop((hardware, simulator));
}

#[test]
fn a_killed_ring_or_bridge_stops_the_machine() {
    unless_disturbed(|| {
        // No other device is at the other end of the cable.
        on_bench(Vec::new(), |_ring| {
            let workshop = Workshop::new();
            let (name, timeout) = ("mill-ethercat", format!("feedback_timeout_ms = {TIMEOUT_MS} "));
            let text = changed(
                "machines/mill-ethercat.toml",
                &[
                    ("rate = 1000 ", "lead_cycles = 60\nrate = 1000 "),
                    ("feedback_timeout_ms = 20 ", &timeout),
                    ("# max_late_cycles = 1000", "max_late_cycles = 0"),
                ],
            );
            let machine = workshop.write("mill.toml", text);
            let lost = [("max_lost_cycles = 3 ", "max_lost_cycles = 40 ")];
            let network = workshop.write("network.toml", changed("networks/sim-mill.toml", &lost));
            let network = network.display().to_string();
            let bridge = ["ethercat", "--network", &network, "--interface", MAIN_INTERFACE];
            are_killed(name, &machine, &bridge.map(str::to_owned), &workshop, &|| {
                Simulator::start(
                    "ethercat-ring",
                    &[
                        "--interface",
                        "ec1",
                        "--device",
                        "coupler",
                        "--device",
                        "drive",
                        "--device",
                        "drive",
                        "--device",
                        "drive",
                        "--device",
                        "digital-in",
                    ],
                )
            });
        });
    });
}

#[test]
fn a_killed_board_or_bridge_stops_the_machine() {
    unless_disturbed(|| {
        let process = std::process::id();
        let address = format!("127.29.{}.{}", process >> 8 & 255, process & 255);
        let workshop = Workshop::new();
        // Without switches its position is its zero, and it need not be homed.
        let text = changed(
            "machines/router-3axis.toml",
            &[("rate = 1000 ", "lead_cycles = 60\nrate = 1000 ")],
        );
        let (axes, rest) = text.split_once("[[homing]]").expect("homing");
        let (_homing, signals) = rest.split_once("[[input]]").expect("an input");
        let text = format!(
            "{axes}[[input]]{signals}\n[drives]\nfeedback = \"required\"\n\
             feedback_timeout_ms = {TIMEOUT_MS}\n[signals]\ninput_timeout_ms = 1000\n[realtime]\n\
             max_late_cycles = 0\n"
        );
        let machine = workshop.write("router.toml", text);
        let text = changed(
            "boards/7i96s-router.toml",
            &[
                ("max_lost_packets = 5 ", "max_lost_packets = 40 "),
                ("watchdog_ms = 50 ", "watchdog_ms = 400 "),
            ],
        );
        let board = workshop.write("board.toml", text).display().to_string();
        let bridge = ["mesa", "--board", &board, "--address", &address].map(str::to_owned);
        are_killed("router-3axis", &machine, &bridge, &workshop, &|| {
            Simulator::start("mesa-board", &["--address", &address, "--model", "7i96s"])
        });
    });
}

//! Foreign MainDevices on the ring, over real sockets: SOEM and KickCAT, in Python.
//!
//! They need EVOLVENT_PYTHON, which `tools/test` sets, and the right to create a network namespace.

#![expect(clippy::expect_used, clippy::print_stdout, reason = "a test")]

use std::path::Path;
use std::process::Command;

use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat_ring::{DriveSettings, MAIN_INTERFACE, SharedRing, SubDevice, TerminalKind, on_bench};

fn devices() -> Vec<SubDevice> {
    vec![
        SubDevice::terminal(TerminalKind::Coupler, 1),
        SubDevice::drive(DriveSettings::default(), 2, 20.0),
        SubDevice::terminal(TerminalKind::DigitalInput, 3),
        SubDevice::terminal(TerminalKind::DigitalOutput, 4),
        SubDevice::terminal(TerminalKind::AnalogInput, 5),
    ]
}

fn set_inputs(ring: &SharedRing) {
    let mut ring = ring.lock().expect("no panic");
    let terminal = |device: Option<&mut SubDevice>| {
        device.and_then(SubDevice::as_terminal_mut).map(|terminal| {
            terminal.set_inputs(0xA5);
            terminal.set_analog(1, -1234);
        })
    };
    terminal(ring.device_mut(2)).expect("inputs");
    terminal(ring.device_mut(4)).expect("analog inputs");
}

/// Runs a script of `tests/python` on the bench. Returns the outputs at its end, or `None` if it could not be
/// run.
fn play(script: &'static str) -> Option<(u8, f64)> {
    let Some(python) = std::env::var_os("EVOLVENT_PYTHON") else {
        println!("not measured: run tools/test");
        return None;
    };
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../tests/python")
        .join(script);
    on_bench(devices(), move |ring| {
        set_inputs(ring);
        let output = Command::new(python)
            .arg(path)
            .arg(MAIN_INTERFACE)
            .output()
            .expect("Python to start");
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        assert!(
            output.status.success(),
            "{}{}",
            text(&output.stdout),
            text(&output.stderr)
        );
        assert!(text(&output.stdout).contains("all is well"));
        let mut ring = ring.lock().expect("no panic");
        let turns = ring.devices()[1].as_drive().expect("a drive").motor_turns();
        let driven = ring
            .device_mut(3)
            .and_then(SubDevice::as_terminal_mut)
            .map_or(0, |terminal| terminal.bits());
        (driven, turns)
    })
}

#[test]
fn soem_reaches_op_and_moves_the_drive() {
    unless_disturbed(|| {
        let Some((driven, turns)) = play("ethercat_soem.py") else {
            return;
        };
        assert_eq!(driven, 0, "outputs are off without OP");
        assert!((turns - 1.0).abs() < 0.01, "{turns}");
    });
}

#[test]
fn kickcat_does_so_too() {
    unless_disturbed(|| {
        let Some((driven, turns)) = play("ethercat_kickcat.py") else {
            return;
        };
        // The MainDevice has ended, less or more than the watchdog's time ago.
        assert!(matches!(driven, 0 | 0x5A), "{driven:x}");
        assert!((turns - 1.0).abs() < 0.01, "{turns}");
    });
}

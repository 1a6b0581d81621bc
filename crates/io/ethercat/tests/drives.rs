//! Functions of the drives themselves, on the simulated ring over real sockets: homing, touch probe,
//! following error.
//!
//! Needs the right to create a network namespace.

#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers of tests fail and talk as tests do"
)]

use std::time::{Duration, Instant};

use evolvent_bridge_trial::{TrialCore, states};
use evolvent_bus::Feedback;
use evolvent_disturbance::unless_disturbed;
use evolvent_drive::{DriveState, PowerRequest};
use evolvent_ethercat::{HomingOnDrive, Network};
use evolvent_ethercat_ring::{DriveSettings, FaultKind, SharedRing, SubDevice, TerminalKind, on_bench};

use crate::support::*;

/// X has its lower limit switch 3 turns away, Y 2, Z none near; the probe of X closes 2 turns away.
fn devices() -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    for (serial, lower) in [(2, -3.0), (3, -2.0), (4, -200.0)] {
        let settings = DriveSettings {
            limits_turns: [lower, 200.0],
            start_increments: 777_777 * serial as i32,
            probe_turns: if serial == 2 { 2.25 } else { 1000.0 },
            ..DriveSettings::default()
        };
        devices.push(SubDevice::drive(settings, serial, 10.0 * f64::from(serial)));
    }
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    devices
}

fn homing(order: u32, position: f64) -> HomingOnDrive {
    HomingOnDrive {
        // The negative limit switch.
        method: 17,
        search: 4 << 20,
        latch: 1 << 18,
        acceleration: Some(100 << 20),
        position,
        order,
        timeout_s: 20.0,
    }
}

fn set_homing(network: &mut Network, device: usize, homing: HomingOnDrive) {
    let axis = network.devices[device].axis.as_mut().expect("an axis");
    axis.homing = Some(homing);
}

/// Moves X to a position at 10 mm/s and waits until it arrives, even if the host makes the drives stop
/// meanwhile. Returns the following errors during the motion, mm.
fn move_x(core: &mut TrialCore, to: f64) -> Vec<f64> {
    let begin = Instant::now();
    let has_stopped = |core: &TrialCore| {
        core.fresh().is_some_and(|feedback| {
            states(&feedback) != [Some(DriveState::OperationEnabled); 3]
                || matches!(feedback.bridge_state, 3 | 4)
        })
    };
    let mut errors = Vec::new();
    loop {
        let sign = (to - core.position[0]).signum();
        core.velocity_x = 10.0 * sign;
        while (to - core.position[0]) * sign > 0.0 && !has_stopped(core) {
            core.cycle();
            errors.extend(core.fresh().map(|feedback| feedback.following_error[0]));
        }
        core.stop();
        let goal = core.position[0];
        let is_there = |feedback: &Feedback| (feedback.position[0] - goal).abs() < 1e-2;
        while !has_stopped(core) && !core.fresh().is_some_and(|feedback| is_there(&feedback)) {
            core.cycle();
            assert!(begin.elapsed() < Duration::from_secs(60), "{:?}", core.newest);
        }
        if !has_stopped(core) {
            return errors;
        }
        println!("the host made the drives stop: {:?}", core.newest);
        core.fault_reset += 1;
        core.bring_up();
    }
}

fn turns(ring: &SharedRing) -> Vec<f64> {
    let ring = ring.lock().expect("no panic");
    let drives = ring.devices().iter().filter_map(|device| device.as_drive());
    drives.map(|drive| drive.motor_turns()).collect()
}

/// Multi-turn counters 500 turns from their zero: X is homed by its drive, and begins at `zero`; Y counts on.
#[test]
fn drive_far_from_zero_starts_where_core_can_home_it() {
    unless_disturbed(|| {
        let far = DriveSettings {
            start_increments: 500 << 20,
            ..DriveSettings::default()
        };
        let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
        devices.extend((2..5).map(|serial| SubDevice::drive(far, serial, 10.0 * f64::from(serial))));
        devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
        on_bench(devices, |ring| {
            with_bridge(
                |network| set_homing(network, 1, homing(1, 25.0)),
                ring,
                |core, _, _| {
                    let before = core.until("feedback", |_| true);
                    assert!(before.position[0].abs() < 0.01, "{:?}", before.position);
                    assert!(
                        (before.position[1].abs() - 2500.0).abs() < 0.01,
                        "{:?}",
                        before.position
                    );
                },
            );
        });
    });
}

/// Y first, then X; Z has no homing and holds. Without power nothing moves, and in operation the axes are at
/// the positions of the files.
#[test]
fn drives_home_in_order_when_power_is_requested() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |network| {
                    set_homing(network, 1, homing(2, -380.0));
                    set_homing(network, 2, homing(1, 25.0));
                },
                ring,
                |core, ring, messages| {
                    let before = core.until("feedback", |_| true);
                    assert_eq!(before.absolute_mask, 0);
                    for _ in 0..200 {
                        core.cycle();
                    }
                    assert!(
                        turns(ring).iter().all(|turns| turns.abs() < 1e-3),
                        "without power nothing moves"
                    );
                    core.power = PowerRequest::On;
                    let begin = Instant::now();
                    let (mut x_first, mut max_z) = (false, 0.0_f64);
                    while !messages.contain("drive of X: machine zero found") {
                        core.cycle();
                        let turns = turns(ring);
                        x_first |=
                            turns[0].abs() > 0.1 && !messages.contain("drive of Y: machine zero found");
                        max_z = max_z.max(turns[2].abs());
                        let (_, feedback) = core.newest.expect("feedback");
                        assert!(
                            states(&feedback)
                                .iter()
                                .all(|state| *state != Some(DriveState::OperationEnabled)),
                            "not in operation before all have homed"
                        );
                        assert!(
                            begin.elapsed() < Duration::from_secs(20),
                            "{turns:?} {messages:?} {feedback:?}"
                        );
                    }
                    assert!(!x_first, "Y homes before X moves");
                    assert!(max_z < 0.01, "Z holds: {max_z} turns");
                    // Not in operation until power was off, so that the core accepts the new positions first.
                    for _ in 0..200 {
                        core.cycle();
                        assert!(core.newest.is_some_and(|(_, feedback)| {
                            states(&feedback)
                                .iter()
                                .all(|state| *state != Some(DriveState::OperationEnabled))
                        }));
                    }
                    let here = core.bring_up();
                    assert_eq!(here.absolute_mask, 0b011);
                    // 5 mm a turn; the motor of Y turns against its axis. Switches close at load turns -3 and
                    // -2.
                    let turns = turns(ring);
                    let expected = [-380.0 + 5.0 * (turns[0] + 3.0), 25.0 - 5.0 * (turns[1] + 2.0)];
                    for axis in 0..2 {
                        assert!(
                            (here.position[axis] - expected[axis]).abs() < 0.05,
                            "{axis}: {} instead of {}",
                            here.position[axis],
                            expected[axis]
                        );
                    }
                    // And it follows from there.
                    core.velocity_x = 20.0;
                    for _ in 0..100 {
                        core.cycle();
                    }
                    core.stop();
                    let goal = core.position[0];
                    core.until("the goal", |feedback| (feedback.position[0] - goal).abs() < 1e-3);
                },
            );
        });
    });
}

#[test]
fn aborted_or_failed_homing_ends_at_rest() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |network| {
                    // Z has no switch within 20 turns.
                    set_homing(
                        network,
                        3,
                        HomingOnDrive {
                            timeout_s: 1.0,
                            ..homing(0, 0.0)
                        },
                    );
                },
                ring,
                |core, ring, messages| {
                    core.until("feedback", |_| true);
                    core.power = PowerRequest::On;
                    let moves = |ring: &SharedRing| speeds(ring)[2] > 0.5;
                    core.until("motion", |_| moves(ring));
                    // Power off during homing: at rest at once, and no message of a failure.
                    core.power = PowerRequest::Off;
                    core.until("rest", |_| speeds(ring).iter().all(|speed| *speed < 0.02));
                    let stop_position = turns(ring)[2];
                    for _ in 0..300 {
                        core.cycle();
                    }
                    assert!((turns(ring)[2] - stop_position).abs() < 0.01);
                    core.power = PowerRequest::On;
                    let begin = Instant::now();
                    while !messages.contain("drive of Z: homing failed") {
                        core.cycle();
                        assert!(begin.elapsed() < Duration::from_secs(20), "{messages:?}");
                    }
                    core.until("rest after the failure", |_| {
                        speeds(ring).iter().all(|speed| *speed < 0.02)
                    });
                    let stop_position = turns(ring)[2];
                    for _ in 0..500 {
                        core.cycle();
                    }
                    assert!(
                        (turns(ring)[2] - stop_position).abs() < 0.01,
                        "it does not try again by itself"
                    );
                },
            );
        });
    });
}

#[test]
fn a_fault_of_another_drive_ends_homing() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |network| set_homing(network, 3, homing(0, 0.0)),
                ring,
                |core, ring, messages| {
                    core.until("feedback", |_| true);
                    core.power = PowerRequest::On;
                    core.until("motion", |_| speeds(ring)[2] > 0.5);
                    begin(ring, FaultKind::Drive, 1, Some(100_000_000));
                    core.until("rest", |_| speeds(ring).iter().all(|speed| *speed < 0.02));
                    assert!(messages.contain("drive of X: fault 2310h"), "{messages:?}");
                },
            );
        });
    });
}

/// The probe of X closes at 2.25 turns of 5 mm; the drive knows the position within a period.
#[test]
fn touch_probe_latches_and_following_error_is_sent() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |network| {
                    let axis = network.devices[1].axis.as_mut().expect("an axis");
                    (axis.touch_probe, axis.probe_input_bit, axis.following_error) = (true, Some(16), true);
                    // Without it the drive lags by speed divided by gain.
                    axis.velocity_offset = false;
                    // A busy host must not end the session, which counts the contacts.
                    network.max_lost_cycles = 50;
                },
                ring,
                |core, ring, _| {
                    let start = core.bring_up().position[0];
                    let at = |turns: f64, ring: &SharedRing, position: f64| {
                        position + 5.0 * (turns - self::turns(ring)[0])
                    };
                    let here = core.until("feedback", |_| true);
                    let closes = at(2.25, ring, here.position[0]);
                    assert!(closes - start > 10.0);
                    let inputs = core.inputs.expect("inputs");
                    assert_eq!((inputs.probe, inputs.probe_trips), (1, 0), "open");
                    for trips in 1..=2_u64 {
                        let mut errors = move_x(core, closes + 4.0);
                        if trips == 1 {
                            // 2 turns a second over a gain of 80 /s: 0.025 turns, 0.125 mm. The
                            // median, because pauses of the host spoil some values.
                            errors.sort_unstable_by(f64::total_cmp);
                            let error = errors[errors.len() / 2];
                            assert!((error - 0.125).abs() < 0.03, "{error} mm");
                        }
                        core.until_inputs("the contact", |inputs| inputs.probe == 2);
                        let inputs = core.inputs.expect("inputs");
                        assert_eq!((inputs.probe, inputs.probe_trips), (2, trips), "{inputs:?}");
                        assert_eq!(inputs.probe_latched_mask, 0b001);
                        assert!(inputs.probe_time_ns > 0 && inputs.probe_time_ns <= inputs.time_ns);
                        assert!(
                            (inputs.probe_position[0] - closes).abs() < 2e-3,
                            "{} instead of {closes}",
                            inputs.probe_position[0]
                        );
                        // Back, and it is armed for the next.
                        let _errors = move_x(core, closes - 2.0);
                        core.until_inputs("the probe is open", |inputs| inputs.probe == 1);
                    }
                },
            );
        });
    });
}

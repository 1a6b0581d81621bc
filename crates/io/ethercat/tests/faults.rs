//! Faults of the network and of drives, on the simulated ring over real sockets: reports to the core, and
//! reactions of the drives.
//!
//! Needs the right to create a network namespace.

use std::time::{Duration, Instant};

use evolvent_bridge_trial::{PERIOD_NS, states};
use evolvent_bus::Feedback;
use evolvent_disturbance::unless_disturbed;
use evolvent_drive::{DriveState, PowerRequest};
use evolvent_ethercat::Network;
use evolvent_ethercat_ring::{FaultKind, SharedRing, SubDevice, on_bench};

use crate::support::*;

/// An axis follows the setpoints, with the scale of its gear, and opposite to its motor if that is inverted.
#[test]
fn a_drive_follows_its_axis() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            let report = with_bridge(
                |_| {},
                ring,
                |core, ring, messages| {
                    let start = core.bring_up();
                    assert!(start.position.iter().all(|position| position.abs() < 1e-3));
                    core.velocity_x = 20.0;
                    for _ in 0..250 {
                        core.cycle();
                    }
                    core.stop();
                    let goal = core.position[0];
                    let end = core.until("the goal", |feedback| {
                        (feedback.position[0] - goal).abs() < 1e-3 && feedback.velocity[0].abs() < 0.5
                    });
                    assert!(end.missed_setpoints < 20, "{end:?}");
                    let turns = ring.lock().expect("no panic").devices()[1]
                        .as_drive()
                        .expect("a drive")
                        .motor_turns();
                    assert!(
                        (turns * 5.0 - goal).abs() < 2e-3,
                        "{turns} turns of 5 mm for {goal} mm"
                    );
                    assert!(messages.contain("all devices are in OP"));
                },
            );
            assert!(report.cycles > 200 && report.sessions == 1, "{report:?}");
        });
    });
}

#[test]
fn fault_of_one_drive_stops_others_and_is_reported() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |_| {},
                ring,
                |core, ring, messages| {
                    core.bring_up();
                    core.velocity_x = 20.0;
                    for _ in 0..100 {
                        core.cycle();
                    }
                    begin(ring, FaultKind::Temperature, 2, Some(50_000_000));
                    let since = Instant::now();
                    let feedback = core.until("the fault", |feedback| feedback.error_code != 0);
                    assert_eq!(feedback.error_code, 0x4310);
                    println!("told after {:?}", since.elapsed());
                    core.until("all drives stopped", |feedback| {
                        states(feedback)
                            .iter()
                            .all(|state| *state != Some(DriveState::OperationEnabled))
                    });
                    let _ = core.until("rest", |_| speeds(ring).iter().all(|speed| *speed < 0.02));
                    assert!(
                        messages.contain("drive of Y: fault 4310h: temperature"),
                        "{messages:?}"
                    );
                    // Reset, and power on again.
                    core.power = PowerRequest::Off;
                    core.fault_reset += 1;
                    let reset = core.fault_reset;
                    core.until("the reset", |feedback| {
                        feedback.fault_reset_done == reset && feedback.error_code == 0
                    });
                    core.bring_up();
                },
            );
        });
    });
}

#[test]
fn a_device_without_supply_is_named_and_comes_back() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            let report = with_bridge(
                |_| {},
                ring,
                |core, ring, messages| {
                    let before = core.bring_up();
                    begin(ring, FaultKind::Gone, 3, Some(3_000_000_000));
                    let feedback = core.until("the loss", |feedback| feedback.error_code == 0x7500);
                    assert_eq!(states(&feedback)[2], Some(DriveState::Fault));
                    core.until("the others stopped", |_| {
                        let ring = ring.lock().expect("no panic");
                        ring.devices()
                            .iter()
                            .filter_map(|device| device.as_drive())
                            .all(|drive| drive.state() != DriveState::OperationEnabled)
                    });
                    assert!(messages.contain("`z-drive` does not reply"), "{messages:?}");
                    core.power = PowerRequest::Off;
                    core.until("the network again", |feedback| {
                        feedback.instance != before.instance
                    });
                    core.fault_reset += 1;
                    core.bring_up();
                },
            );
            assert!(report.sessions >= 2, "{report:?}");
        });
    });
}

#[test]
fn lost_frames_end_feedback_and_drives_stop_alone() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |_| {},
                ring,
                |core, ring, messages| {
                    core.bring_up();
                    core.velocity_x = 20.0;
                    for _ in 0..100 {
                        core.cycle();
                    }
                    begin(ring, FaultKind::Loss, 0, Some(1_000_000_000));
                    let lost = Instant::now();
                    while core
                        .newest
                        .is_some_and(|(at, _)| at.elapsed() < Duration::from_millis(300))
                    {
                        core.cycle();
                        assert!(lost.elapsed() < Duration::from_secs(5), "feedback goes on");
                    }
                    assert!(
                        speeds(ring).iter().all(|speed| *speed < 0.02),
                        "drives stop by their watchdog"
                    );
                    core.power = PowerRequest::Off;
                    core.velocity_x = 0.0;
                    core.until("the network again", |_| true);
                    core.fault_reset += 1;
                    core.bring_up();
                    assert!(messages.contain("did not return"), "{messages:?}");
                },
            );
        });
    });
}

/// A drive that reports a blocked motor by emergency messages: at once, and before each reply to an object.
#[test]
fn emergencies_at_start_are_reported_and_start_works() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            begin(ring, FaultKind::Emergency, 2, None);
            let report = with_bridge(
                |_| {},
                ring,
                |core, _, messages| {
                    core.bring_up();
                    let text = "`y-drive` has sent an emergency message: 7121h: motor: blocked, or \
                                commutation lost (error register 01h)";
                    assert!(messages.contain(text), "{messages:?}");
                },
            );
            assert_eq!(report.sessions, 1, "at the first attempt");
        });
    });
}

/// Without frames drives leave OP by their watchdogs. They still increment the working counter of later
/// frames.
#[test]
fn devices_out_of_op_are_named_not_working_counter() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |network| network.max_lost_cycles = 150,
                ring,
                |core, ring, messages| {
                    core.bring_up();
                    begin(ring, FaultKind::Break, 2, Some(200_000_000));
                    core.power = PowerRequest::Off;
                    core.until("the loss", |feedback| feedback.error_code == 0x7500);
                    // The message about the working counter would be the first.
                    core.until("the messages", |_| {
                        messages.contain("`y-drive` does not reply, or has left OP")
                    });
                    assert!(!messages.contain("working counter"), "{messages:?}");
                },
            );
        });
    });
}

#[test]
fn network_that_differs_from_its_file_is_reported() {
    type Edit = fn(&mut Network);
    let cases: [(Edit, &str); 5] = [
        (
            |network| network.devices[1].product = 7,
            "device 2 (`x-drive`): product is 0x402 on the wire and 0x7 in the network file",
        ),
        (
            |network| network.devices[1].revision = Some(3),
            "revision is 0x10000",
        ),
        (
            |network| drop(network.devices.pop()),
            "5 devices are on the wire, the network file lists 4",
        ),
        (
            |network| network.devices[1].startup[0].index = 0x5555,
            "`x-drive`: object 5555h:0 cannot be written: the device rejects it",
        ),
        (
            |network| network.devices[1].startup[0].bytes = 2,
            "object 6065h:0 cannot be written",
        ),
    ];
    unless_disturbed(|| {
        on_bench(devices(), move |ring| {
            for (edit, expected) in cases {
                with_bridge(edit, ring, |core, _, messages| {
                    let begin = Instant::now();
                    while !messages.contain(expected) {
                        core.cycle();
                        assert!(
                            begin.elapsed() < Duration::from_secs(15),
                            "{expected}: {messages:#?}"
                        );
                    }
                    assert!(core.newest.is_none(), "no feedback without a network");
                });
            }
        });
    });
}

/// Brings the drives up, moves X, begins a fault, and waits until the feedback shows it and all drives are at
/// rest.
fn while_moving(
    kind: FaultKind,
    device: usize,
    shows_fault: fn(&Feedback) -> bool,
    expected: &'static [&'static str],
) {
    unless_disturbed(move || {
        on_bench(devices(), move |ring| {
            with_bridge(
                |_| {},
                ring,
                |core, ring, messages| {
                    core.bring_up();
                    core.velocity_x = 20.0;
                    for _ in 0..100 {
                        core.cycle();
                    }
                    assert!(speeds(ring)[0] > 1.0, "X moves: {:?}", speeds(ring));
                    begin(ring, kind, device, Some(1_000_000_000));
                    core.until("the fault", shows_fault);
                    core.velocity_x = 0.0;
                    let begin = Instant::now();
                    while speeds(ring).iter().any(|speed| *speed > 0.02) {
                        core.cycle();
                        assert!(begin.elapsed() < Duration::from_secs(5), "{:?}", speeds(ring));
                    }
                    for text in expected {
                        assert!(messages.contain(text), "{text}: {messages:?}");
                    }
                },
            );
        });
    });
}

#[test]
fn open_cable_stops_drives_before_and_after_it() {
    while_moving(
        FaultKind::Break,
        3,
        |feedback| feedback.error_code == 0x7500 && states(feedback)[2] == Some(DriveState::Fault),
        &["`z-drive` does not reply"],
    );
}

/// All devices report OP, and the working counter lacks the increment of one of them.
#[test]
fn device_without_working_count_stops_all_drives() {
    while_moving(
        FaultKind::WorkingCounter,
        2,
        |feedback| {
            let states = states(feedback);
            // The core's alarm names the first axis in fault.
            assert_ne!(states[0], Some(DriveState::Fault), "{feedback:?}");
            feedback.error_code == 0x7500 && states[1] == Some(DriveState::Fault)
        },
        &[
            "working counter",
            "`y-drive` is in OP and does not exchange process data",
        ],
    );
}

#[test]
fn safe_torque_off_of_one_drive_stops_all() {
    while_moving(
        FaultKind::TorqueOff,
        2,
        |feedback| {
            states(feedback)
                .iter()
                .all(|state| *state != Some(DriveState::OperationEnabled))
        },
        &[],
    );
}

#[test]
fn an_overcurrent_is_told_with_its_code() {
    while_moving(
        FaultKind::Drive,
        1,
        |feedback| feedback.error_code == 0x2310,
        &["drive of X: fault 2310h"],
    );
}

#[test]
fn a_load_that_is_blocked_is_a_following_error() {
    while_moving(
        FaultKind::Blocked,
        1,
        |feedback| feedback.error_code == 0x8611,
        &["drive of X: fault 8611h"],
    );
}

/// The switches of Z, which the network file names, are reported; those of X, which it does not, are not.
#[test]
fn limit_switches_named_in_network_file_are_reported() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |_| {},
                ring,
                |core, ring, _| {
                    let before = core.bring_up();
                    assert_eq!((before.negative_limit_mask, before.positive_limit_mask), (0, 0));
                    for device in [1, 3] {
                        begin(ring, FaultKind::Limit, device, Some(1_000_000_000));
                    }
                    core.until("both switches of Z", |feedback| {
                        (feedback.negative_limit_mask, feedback.positive_limit_mask) == (0b100, 0b100)
                    });
                    core.until("none", |feedback| {
                        (feedback.negative_limit_mask, feedback.positive_limit_mask) == (0, 0)
                    });
                },
            );
        });
    });
}

#[test]
fn a_jump_that_persists_is_not_followed() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |_| {},
                ring,
                |core, ring, _| {
                    core.jumps(0.01, || {
                        let ring = ring.lock().expect("no panic");
                        ring.devices()[1].as_drive().expect("a drive").motor_turns() * 5.0
                    });
                },
            );
        });
    });
}

/// Following begins at a distance from the axes: no target of the drive steps by that distance, at rest and
/// with an immediate motion of X.
#[test]
fn following_begins_without_a_step_of_the_targets() {
    /// Lead of X, mm per turn.
    const LEAD_MM: f64 = 5.0;
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |_| {},
                ring,
                |core, ring, _| {
                    for (distance, velocity) in [(0.05, 0.0), (-0.3, 0.0), (0.45, 0.0), (-0.45, 20.0)] {
                        let drive = |ring: &SharedRing| {
                            let mut ring = ring.lock().expect("no panic");
                            let drive = ring.device_mut(1).and_then(SubDevice::as_drive_mut);
                            let drive = drive.expect("a drive");
                            let step_mm = drive.take_longest_step_turns() * LEAD_MM;
                            (step_mm, drive.motor_turns() * LEAD_MM)
                        };
                        drive(ring);
                        core.bring_up_beside(distance);
                        core.velocity_x = velocity;
                        core.rest(0.4);
                        core.stop();
                        core.rest(0.4);
                        let (step_mm, at_mm) = drive(ring);
                        // It takes dozens of periods; a busy host may skip some.
                        let max_mm = 0.125 * distance.abs() + 3.0 * velocity * PERIOD_NS as f64 * 1e-9;
                        assert!(
                            step_mm > 0.0 && step_mm <= max_mm,
                            "{distance} mm at {velocity} mm/s: {step_mm} mm"
                        );
                        let off = at_mm - core.position[0];
                        assert!(off.abs() < 0.02, "{distance} mm at {velocity} mm/s: {off} mm off");
                    }
                },
            );
        });
    });
}

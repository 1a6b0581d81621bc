//! Faults of the cable, of the board and of drives, on the simulated board over real sockets: reports to the
//! core, and motion of the motors.

use std::cell::Cell;
use std::sync::atomic::{AtomicU64, Ordering};

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bridge_trial::{TrialCore, states};
use evolvent_disturbance::unless_disturbed;
use evolvent_drive::{DriveState, PowerRequest};
use evolvent_mesa::BoardSettings;
use evolvent_mesa_board::{BoardModel, FaultKind};
use evolvent_random::{Random, cases};

use crate::common::core::{STEPS, with_bridge, with_bridge_to, with_suspended_bridge_to};

#[test]
fn the_motor_turns_as_many_steps_as_the_setpoints_say() {
    with_bridge(
        |_| {},
        |core, server, _| {
            let here = core.bring_up();
            let (from, motor) = (here.position[0], server.lock().motor_steps(0));
            core.velocity_x = 40.0;
            core.rest(1.0);
            core.velocity_x = 0.0;
            core.rest(0.5);
            let wanted = (core.position[0] - from) * STEPS;
            let turned = server.lock().motor_steps(0) - motor;
            assert!(
                wanted > 10_000.0 && (turned - wanted).abs() <= 2.0,
                "{turned} of {wanted}"
            );
            assert_eq!(server.lock().step_times_ns(0), [2500, 2500, 5000, 5000]);
            assert!(server.lock().level(11), "the drive of X is enabled");
            // Y is inverted.
            let motor = server.lock().motor_steps(1);
            core.travel(1, 5.0, 5.0);
            let turned = server.lock().motor_steps(1) - motor;
            assert!((turned + 5.0 * STEPS).abs() <= 2.0, "{turned}");
            core.power = PowerRequest::Off;
            core.rest(0.5);
            assert!(!server.lock().level(11));
        },
    );
}

/// Losses that are shorter than the configured number have no effect other than their count.
#[test]
fn short_losses_are_counted_and_ridden_through() {
    for kind in [
        FaultKind::LossOut,
        FaultKind::LossIn,
        FaultKind::Half,
        FaultKind::Delay,
        FaultKind::Reorder,
        FaultKind::Short,
    ] {
        // A host that keeps the bridge from running loses more.
        unless_disturbed(|| {
            let report = with_bridge(
                |board| board.max_lost_packets = 45,
                |core, server, messages| {
                    let mut random = Random::seeded(kind as u64);
                    core.bring_up();
                    let motor = server.lock().motor_steps(0) - core.position[0] * STEPS;
                    for _ in 0..cases(3) {
                        core.velocity_x = random.between(-40.0, 40.0);
                        core.rest(random.between(0.05, 0.3));
                        server.lock().fault_now(kind, Some(20_000_000));
                        core.rest(0.1);
                    }
                    core.velocity_x = 0.0;
                    core.rest(0.5);
                    let (_, feedback) = core.newest.expect("feedback");
                    assert_eq!(states(&feedback), [Some(DriveState::OperationEnabled); 3]);
                    assert!(!messages.contain("in a row"), "{messages:?}");
                    let off = server.lock().motor_steps(0) - core.position[0] * STEPS - motor;
                    assert!(off.abs() <= 2.0, "{kind:?}: {off} steps off");
                    assert_eq!(server.lock().motor_stalls(0), 0);
                },
            );
            assert_eq!(report.sessions, 1, "{kind:?}: {report:?}");
            let counted = report.lost_replies + report.lost_writes + report.stale_replies;
            assert!(counted > 0, "{kind:?}: {report:?}");
        });
    }
}

/// Longer faults end in a stop of every axis, a fault for the core, and a new session once they are over.
#[test]
fn longer_losses_and_lost_boards_stop_every_axis() {
    for (kind, wanted) in [
        (FaultKind::LossOut, "did not return in time"),
        (FaultKind::Short, "did not return in time"),
        (FaultKind::LossIn, "did not return in time"),
        (FaultKind::Bite, "watchdog has tripped"),
        (FaultKind::Reset, "in a row"),
    ] {
        for moment in 0..cases(1) {
            longer_loss(kind, wanted, moment as u64);
        }
    }
}

fn longer_loss(kind: FaultKind, wanted: &str, moment: u64) {
    let report = with_bridge(
        |_| {},
        |core, server, messages| {
            let mut random = Random::seeded(7 + kind as u64 + 100 * moment);
            let before = core.bring_up();
            core.velocity_x = 30.0;
            core.rest(random.between(0.1, 0.5));
            let duration_ns = (!matches!(kind, FaultKind::Bite | FaultKind::Reset)).then_some(1_500_000_000);
            server.lock().fault_now(kind, duration_ns);
            let feedback = core.until("a fault", |feedback| {
                states(feedback)
                    .iter()
                    .any(|state| state.is_some_and(DriveState::is_fault))
            });
            assert_eq!(feedback.error_code, 0x7500, "{kind:?}");
            (core.power, core.velocity_x) = (PowerRequest::Off, 0.0);
            core.rest(0.6);
            let motor = server.lock().motor_steps(0);
            core.rest(0.2);
            let moved = server.lock().motor_steps(0) - motor;
            assert!(moved.abs() < 1.0, "{kind:?}: {moved} steps after the stop");
            assert!(messages.contain(wanted), "{kind:?}: {messages:?}");
            // The core has seen the fault, and resets it.
            core.rest(1.5);
            core.fault_reset += 1;
            let after = core.bring_up();
            assert_ne!(after.instance, before.instance, "another session");
        },
    );
    assert!(report.sessions >= 2, "{kind:?}: {report:?}");
}

#[test]
fn another_program_at_the_board_ends_the_session() {
    let address = Cell::new(None);
    let report = with_bridge(
        |board| address.set(Some(board.address)),
        |core, server, messages| {
            core.bring_up();
            core.velocity_x = 30.0;
            core.rest(0.3);
            let address = address.get().expect("an address");
            let mut packet = evolvent_mesa::Packet::new();
            packet
                .write_word(evolvent_mesa::Space::Timer, 0x14, 0)
                .expect("room");
            evolvent_mesa::Link::open(address)
                .expect("a socket")
                .send(&packet);
            let feedback = core.until("a fault", |feedback| {
                states(feedback)[0].is_some_and(DriveState::is_fault)
            });
            assert_eq!(feedback.error_code, 0x7500);
            core.rest(0.3);
            assert!(server.lock().step_rate(0).abs() < 1.0, "it has braked");
            assert!(messages.contain("no longer has this session"), "{messages:?}");
            core.until("another session", |later| later.instance != feedback.instance);
        },
    );
    assert!(report.sessions >= 2, "{report:?}");
}

#[test]
fn a_drive_in_fault_stops_all_quickly() {
    with_bridge(
        |board| {
            board.axes[1].fault = Some(evolvent_mesa::Pin {
                pin: 5,
                remote: None,
                inverted: true,
                slow: false,
            });
        },
        |core, server, messages| {
            core.bring_up();
            core.velocity_x = 30.0;
            core.rest(0.3);
            server.lock().set_level(5, false);
            let feedback = core.until("a fault of Y", |feedback| {
                states(feedback)[1] == Some(DriveState::Fault)
            });
            assert_eq!(feedback.error_code, 0x9000);
            core.until("X off", |feedback| {
                states(feedback)[0] == Some(DriveState::SwitchOnDisabled)
            });
            assert!(server.lock().step_rate(0).abs() < 1.0);
            assert!(!server.lock().level(11) && !server.lock().level(12));
            assert!(messages.contain("Y: 9000h"), "{messages:?}");
            server.lock().set_level(5, true);
            core.fault_reset += 1;
            core.bring_up();
        },
    );
}

/// Three analog servos: encoder, PWM, and a velocity drive with a lag of 2 ms.
fn servos(board: &mut BoardSettings) {
    let rest = "name = \"7I97\"\n".to_owned();
    let text = ["X", "Y", "Z"]
        .iter()
        .enumerate()
        .fold(rest, |text, (unit, letter)| {
            let inverted = unit == 1;
            text + &format!(
                "[[axis]]\nletter = \"{letter}\"\nencoder = {unit}\npwm = {unit}\ncounts_per_unit = 1000\n\
                 full_velocity = 200\np_gain = 60\ni_gain = 200\ninverted = {inverted}\nzero = 5\n"
            )
        });
    let text = format!("address = \"{}\"\n{text}", board.address);
    *board = BoardSettings {
        watchdog_s: 0.1,
        max_lost_packets: 20,
        ..BoardSettings::parse(&text, "servos.toml").expect("a board file")
    };
}

#[test]
fn analog_servos_follow_by_their_encoders() {
    with_bridge_to(BoardModel::B7i97, servos, |core, server, _| {
        let here = core.bring_up();
        assert!(
            (here.position[0] - 5.0).abs() < 0.01,
            "`zero` is where they stand"
        );
        let x = server.lock().shaft(0);
        let y = server.lock().shaft(1);
        // 80 mm and back make the 16-bit counter wrap.
        let mut largest: f64 = 0.0;
        for velocity in [60.0, -60.0, 60.0] {
            core.velocity_x = velocity;
            core.rest(1.3);
            let (_, feedback) = core.newest.expect("feedback");
            largest = largest.max(feedback.following_error[0].abs());
        }
        core.velocity_x = 0.0;
        core.rest(1.0);
        let wanted = (core.position[0] - here.position[0]) * 1000.0;
        let turned = server.lock().shaft(0) - x;
        assert!(
            wanted.abs() > 70_000.0 && (turned - wanted).abs() < 20.0,
            "{turned} of {wanted}"
        );
        assert!(largest < 1.0, "following error {largest} mm");
        let drift = server.lock().shaft(1) - y;
        assert!(drift.abs() < 20.0, "Y stands: {drift}");
        core.power = PowerRequest::Off;
        core.rest(0.5);
        assert!(server.lock().duty(0).abs() < 1e-9);
    });
}

/// 16 bits are 65 536 counts: at 140 mm/s and 1000 counts per mm a full wrap takes 0.47 s, and half of it
/// 0.23 s.
#[test]
fn counter_unread_for_too_long_ends_session() {
    let suspend_ms = AtomicU64::new(0);
    let slow_watchdog = |board: &mut BoardSettings| {
        servos(board);
        board.watchdog_s = 1.0;
    };
    with_suspended_bridge_to(
        BoardModel::B7i97,
        slow_watchdog,
        &suspend_ms,
        |core, server, messages| {
            let before = core.bring_up();
            let offset = before.position[0] * 1000.0 - server.lock().shaft(0);
            core.velocity_x = 140.0;
            core.rest(0.3);
            // Shorter than 167 ms: nothing is lost.
            suspend_ms.store(120, Ordering::Relaxed);
            core.until("a brake", |feedback| {
                feedback.bridge_state != evolvent_drive::BridgeState::Following.number()
            });
            core.velocity_x = 0.0;
            core.rest(0.5);
            core.power = PowerRequest::Off;
            core.rest(0.3);
            let (_, feedback) = core.newest.expect("feedback");
            assert_eq!(feedback.instance, before.instance);
            let off = feedback.position[0] * 1000.0 - server.lock().shaft(0) - offset;
            assert!(off.abs() < 10.0, "{off} counts");
            core.bring_up();
            core.velocity_x = 140.0;
            core.rest(0.3);
            suspend_ms.store(300, Ordering::Relaxed);
            let feedback = core.until("a fault", |feedback| {
                states(feedback)[0].is_some_and(DriveState::is_fault)
            });
            assert_eq!(feedback.error_code, 0x7500);
            (core.power, core.velocity_x) = (PowerRequest::Off, 0.0);
            core.until("another session", |later| later.instance != before.instance);
            assert!(
                messages.contain("encoder 0 was not read for") && messages.contain("after 167 ms"),
                "{messages:?}"
            );
        },
    );
}

/// 1.2 x 150 mm/s x 4000 counts a mm are 30 000 counts in 41.7 ms, 20 of this core's periods.
#[test]
fn losses_that_allow_a_counter_wrap_are_refused() {
    let fast = |board: &mut BoardSettings| {
        servos(board);
        board.max_lost_packets = 41;
        for axis in &mut board.axes {
            axis.per_unit = 4000.0;
        }
    };
    with_bridge_to(BoardModel::B7i97, fast, |core, _, messages| {
        core.rest(1.5);
        let wanted = "encoder 0 overflows in 41.7 ms at 1.2 times the maximum speed, which is not detected \
                      while max_lost_packets = 41 replies are missing: choose max_lost_packets = 19 or \
                      less, or a higher control rate";
        assert!(messages.contain(wanted), "{messages:?}");
    });
}

/// The spindle at 12000 rpm, and the first digital output on.
fn outputs_with_spindle() -> evolvent_bus::MachineOutputs {
    let mut outputs = evolvent_bus::MachineOutputs {
        spindle_mask: 1,
        digital_mask: 1,
        digital: 1,
        ..evolvent_bus::MachineOutputs::default()
    };
    (outputs.spindle_direction[0], outputs.spindle_rpm[0]) = (1, 12_000.0);
    outputs
}

#[test]
fn a_spindle_turns_by_its_pwm_and_stops_with_the_core() {
    with_bridge(
        |_| {},
        |core, server, _| {
            core.bring_up();
            let mut outputs = outputs_with_spindle();
            for _ in 0..100 {
                outputs.sequence += 1;
                outputs.due_time_ns = monotonic_ns();
                let _reached = core.bus.publish_outputs(&outputs);
                core.rest(0.01);
            }
            let duty = server.lock().duty(0);
            assert!((duty - 0.5).abs() < 0.001, "half of 24000 rpm: {duty}");
            assert!(server.lock().level(15) && server.lock().level(14));
            core.rest(0.6);
            assert!(server.lock().duty(0).abs() < 1e-9, "no message for 0.6 s");
            assert!(!server.lock().level(15) && !server.lock().level(14));
        },
    );
}

/// The board still receives packets when its replies are lost: the axes brake with them, which takes time,
/// but outputs do not wait.
#[test]
fn outputs_are_safe_while_axes_brake_at_session_end() {
    with_bridge(
        |_| {},
        |core, server, _| {
            core.bring_up();
            let mut outputs = outputs_with_spindle();
            let mut cycle = |core: &mut TrialCore| {
                outputs.sequence += 1;
                outputs.due_time_ns = monotonic_ns();
                let _reached = core.bus.publish_outputs(&outputs);
                core.cycle();
                let board = server.lock();
                let is_on = board.level(14) || board.level(15) || board.duty(0).abs() > 1e-9;
                (is_on, board.step_rate(0).abs())
            };
            core.velocity_x = 100.0;
            let mut full_rate = 0.0;
            for _ in 0..200 {
                full_rate = cycle(core).1;
            }
            assert!(cycle(core).0 && full_rate > 90.0 * STEPS, "{full_rate}");
            server.lock().fault_now(FaultKind::LossOut, Some(2_000_000_000));
            let begin = std::time::Instant::now();
            let rate_when_safe = loop {
                let (is_on, rate) = cycle(core);
                if !is_on {
                    break rate;
                }
                assert!(begin.elapsed() < std::time::Duration::from_secs(3), "never safe");
            };
            assert!(
                rate_when_safe > 0.3 * full_rate,
                "outputs were safe when X was at {rate_when_safe} of {full_rate} steps/s"
            );
        },
    );
}

#[test]
fn a_jump_that_persists_is_not_followed() {
    with_bridge(
        |_| {},
        |core, server, _| core.jumps(2.0 / STEPS, || server.lock().motor_steps(0) / STEPS),
    );
}

/// Following begins at a distance from the axes: the motor does not remove that distance at once.
#[test]
fn following_begins_without_a_step_of_the_targets() {
    with_bridge(
        |_| {},
        |core, server, _| {
            for (distance, velocity) in [(0.05, 0.0), (-0.3, 0.0), (0.45, 0.0), (-0.45, 20.0)] {
                core.bring_up_beside(distance);
                core.velocity_x = velocity;
                core.rest(0.4);
                core.stop();
                core.rest(0.4);
                let fastest = server.lock().take_fastest_rate(0) / STEPS;
                // A correction proportional to the distance, plus the edges of single steps.
                let max = 20.0 * f64::abs(distance) + 1.0 + velocity;
                assert!(
                    fastest > 0.0 && fastest <= max,
                    "{distance} mm at {velocity} mm/s: {fastest} mm/s"
                );
                let (_, feedback) = core.newest.expect("feedback");
                let off = feedback.position[0] - core.position[0];
                assert!(
                    off.abs() < 2.0 / STEPS,
                    "{distance} mm at {velocity} mm/s: {off} mm off"
                );
            }
        },
    );
}

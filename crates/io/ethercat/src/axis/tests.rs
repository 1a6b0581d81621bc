use super::*;
use crate::homing::HomingOnDrive;
use crate::scale::Scale;
use crate::zero_impulse::ProbeNumber;

fn axis(inverted: bool) -> DriveAxis {
    DriveAxis::new(NetworkAxis {
        axis: 0,
        scale: Scale::new(1000, [1, 1], 5.0).expect("a scale"),
        increments_per_turn: 1000,
        inverted,
        absolute: false,
        zero: 10.0,
        map: true,
        velocity_offset: true,
        torque_per_acceleration: 0.0,
        home_switch_bit: Some(2),
        limit_switches: true,
        following_error: false,
        touch_probe: false,
        probe_input_bit: None,
        index_probe: Some(ProbeNumber::Two),
        homing: None,
        gantry: None,
    })
}

#[test]
fn a_counter_that_wraps_around_goes_on() {
    for inverted in [false, true] {
        let mut axis = axis(inverted);
        let sign = if inverted { -1.0 } else { 1.0 };
        axis.take(
            DriveInputs {
                position: i32::MAX - 100,
                ..DriveInputs::default()
            },
            1e-3,
            1e6,
        );
        let before = axis.position();
        axis.take(
            DriveInputs {
                position: i32::MIN + 99,
                ..DriveInputs::default()
            },
            1e-3,
            1e6,
        );
        assert!(
            (axis.position() - before - sign).abs() < 1e-6,
            "200 increments are 1 mm"
        );
        assert!((axis.velocity() - sign * 1000.0).abs() < 1e-6);
    }
}

fn search_at_5_mm_s() -> HomingOnDrive {
    HomingOnDrive {
        method: 18,
        search: 1000,
        latch: 100,
        acceleration: None,
        position: 605.0,
        order: 0,
        timeout_s: 10.0,
    }
}

/// The counter of a drive returns to 0 at its zero, some periods before the drive reports that it has homed.
#[test]
fn step_to_zero_found_by_drive_is_no_motion() {
    let (period_s, max_velocity) = (1e-3, 400.0);
    let mut homed = axis(false);
    homed.homing = HomingProgress::Needed;
    homed.settings.homing = Some(search_at_5_mm_s());
    let (mut positions, mut velocities) = (Vec::new(), Vec::new());
    for period in 0..40 {
        let is_found = period >= 20;
        let attained = if period >= 24 { 1 << 10 | 1 << 12 } else { 0 };
        let inputs = DriveInputs {
            status_word: DriveState::OperationEnabled.code() | attained,
            mode: HOMING_MODE,
            // 200 increments are 1 mm.
            position: if is_found { 0 } else { 100_000 },
            ..DriveInputs::default()
        };
        homed.take(inputs, period_s, max_velocity);
        positions.push(homed.position());
        velocities.push(homed.velocity());
        let _outputs = homed.outputs(None, PowerRequest::On, Some(0), period_s);
    }
    assert_eq!(homed.homing(), HomingProgress::Done);
    assert_eq!(velocities, [0.0; 40]);
    assert!(
        positions[..24].iter().all(|position| *position == 510.0),
        "{positions:?}"
    );
    assert_eq!(positions.last(), Some(&605.0));
    // Outside homing such a step is passed on as a velocity, and the core rejects it (alarm 417).
    let mut axis = axis(false);
    for position in [0, 100_000] {
        let inputs = DriveInputs {
            position,
            ..DriveInputs::default()
        };
        axis.take(inputs, period_s, max_velocity);
    }
    assert_eq!(axis.velocity(), 500_000.0);
}

/// 20 lost frames, in which the counter has gone back to 0: 4 mm, which the axis could move at its maximum
/// velocity, but not at the 5 mm/s of the search.
#[test]
fn step_to_zero_after_lost_frames_is_no_motion() {
    let mut homed = axis(false);
    homed.settings.homing = Some(search_at_5_mm_s());
    homed.homing = HomingProgress::Running(20);
    let at = |position: i32| DriveInputs {
        position,
        ..DriveInputs::default()
    };
    homed.take(at(800), 1e-3, 400.0);
    homed.take(at(799), 1e-3, 400.0);
    let before = (homed.position(), homed.velocity(), homed.moved());
    homed.take(at(0), 21e-3, 400.0);
    assert_eq!((homed.position(), homed.velocity(), homed.moved()), before);
    // A motion at the speed of the search over the same time is one.
    homed.take(at(-21), 21e-3, 400.0);
    assert!((homed.velocity() + 5.0).abs() < 1e-9, "{}", homed.velocity());
}

#[test]
fn target_is_actual_position_until_enabled() {
    let mut axis = axis(true);
    let status = |state: DriveState| DriveInputs {
        status_word: state.code(),
        position: 4321,
        ..DriveInputs::default()
    };
    for state in [
        DriveState::SwitchOnDisabled,
        DriveState::ReadyToSwitchOn,
        DriveState::SwitchedOn,
    ] {
        axis.take(status(state), 1e-3, 1e6);
        assert_eq!(axis.outputs(None, PowerRequest::On, None, 1e-3).target, 4321);
    }
}

/// The core has removed power at the end of its own ramp; the ramp of the drive (6085h) is longer.
#[test]
fn power_off_keeps_quick_stop_until_axis_stands() {
    let mut axis = axis(false);
    let mut position = 0;
    let mut period = |increments: i32, request| {
        position += increments;
        let inputs = DriveInputs {
            status_word: DriveState::QuickStopActive.code(),
            position,
            ..DriveInputs::default()
        };
        axis.take(inputs, 1e-3, 1e6);
        axis.outputs(None, request, None, 1e-3).control_word
    };
    for _ in 0..10 {
        assert_eq!(period(50, PowerRequest::QuickStop), control::QUICK_STOP);
    }
    for _ in 0..1000 {
        assert_eq!(period(20, PowerRequest::Off), control::QUICK_STOP, "100 mm/s");
    }
    assert_eq!(
        period(1, PowerRequest::Off),
        control::DISABLE_VOLTAGE,
        "it stands"
    );
}

#[test]
fn switches_of_an_inverted_axis_change_sides() {
    let mut axis = axis(true);
    axis.take(
        DriveInputs {
            digital_inputs: 0b101,
            ..DriveInputs::default()
        },
        1e-3,
        1e6,
    );
    assert_eq!(axis.switches(), [true, false, true]);
}

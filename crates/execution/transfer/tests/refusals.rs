//! Invalid problems and their errors, and degenerate problems that must be solved.

#![expect(clippy::panic, reason = "a test may fail")]

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, AxisLetter};
use evolvent_transfer::{AxesState, Method, Quantity, Sync, Transfer, TransferEnd, TransferError};

/// X, Y, Z: 100 mm/s, 1000 mm/s2, 20 000 mm/s3, +- 200 mm.
fn limits() -> Limits {
    let mut limits = Limits {
        present: [false; AXES],
        velocity: Axes::repeat(100.0),
        acceleration: Axes::repeat(1000.0),
        jerk: Axes::repeat(20_000.0),
        travel_min: Axes::repeat(-200.0),
        travel_max: Axes::repeat(200.0),
        home: Axes::zeros(),
    };
    limits.present[..3].fill(true);
    limits
}

fn at(x: f64) -> AxesState {
    let mut position = Axes::zeros();
    position[0] = x;
    AxesState::at_rest(position)
}

fn moving(x: f64, velocity: f64, acceleration: f64) -> AxesState {
    let mut state = at(x);
    state.velocity[0] = velocity;
    state.acceleration[0] = acceleration;
    state
}

fn refused(limits: &Limits, from: AxesState, to: AxesState, sync: Sync) -> TransferError {
    match Transfer::solve(limits, &from, &to, sync) {
        Err(error) => error,
        Ok(transfer) => panic!("solved in {} s", transfer.duration_s()),
    }
}

#[test]
fn numbers_that_are_none_are_refused_with_their_place() {
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut bad = at(0.0);
        bad.acceleration[1] = value;
        let error = refused(&limits(), at(0.0), bad, Sync::Time);
        assert!(
            matches!(
                error,
                TransferError::NotFinite {
                    axis: AxisLetter::Y,
                    end: TransferEnd::Target,
                    quantity: Quantity::Acceleration,
                    ..
                }
            ),
            "{error}"
        );
    }
}

#[test]
fn limits_must_be_usable_numbers() {
    for value in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-7, 1e13] {
        let mut bad = limits();
        bad.jerk[2] = value;
        let error = refused(&bad, at(0.0), at(1.0), Sync::Time);
        assert!(
            matches!(
                error,
                TransferError::Limit {
                    axis: AxisLetter::Z,
                    quantity: Quantity::Jerk,
                    ..
                }
            ),
            "{error}"
        );
    }
    // Values of an axis that the machine does not have are ignored.
    let mut other = limits();
    other.jerk[8] = f64::NAN;
    assert!(Transfer::solve(&other, &at(0.0), &at(1.0), Sync::Time).is_ok());
}

#[test]
fn axes_that_the_machine_has_not_stay_where_they_are() {
    let mut to = at(1.0);
    to.position[5] = 1.0;
    let error = refused(&limits(), at(0.0), to, Sync::Time);
    assert_eq!(error, TransferError::NoSuchAxis { axis: AxisLetter::C });
    let mut from = to;
    from.position[0] = 0.0;
    let transfer = Transfer::solve(&limits(), &from, &to, Sync::Time).unwrap();
    assert_eq!(transfer.at(0.5 * transfer.duration_s()).position[5], 1.0);
}

#[test]
fn states_that_must_exceed_a_limit_are_rejected() {
    for (bad, quantity) in [
        (moving(0.0, 100.1, 0.0), Quantity::Velocity),
        (moving(0.0, 0.0, -1001.0), Quantity::Acceleration),
        // 80 mm/s and 1000 mm/s2 reach 80 + 1000^2 / (2 20 000) = 105 mm/s in any case.
        (moving(0.0, 80.0, 1000.0), Quantity::Velocity),
    ] {
        let error = refused(&limits(), bad, at(50.0), Sync::Time);
        let TransferError::BeyondLimit {
            end, quantity: named, ..
        } = error
        else {
            panic!("{error}");
        };
        assert_eq!((end, named), (TransferEnd::Start, quantity));
    }
    // The same acceleration brakes: valid at the start, impossible at the target.
    assert!(Transfer::solve(&limits(), &moving(0.0, 80.0, -1000.0), &at(50.0), Sync::Time).is_ok());
    let error = refused(&limits(), at(0.0), moving(50.0, 80.0, -1000.0), Sync::Time);
    assert!(
        matches!(
            error,
            TransferError::BeyondLimit {
                end: TransferEnd::Target,
                ..
            }
        ),
        "{error}"
    );
    assert!(Transfer::solve(&limits(), &at(0.0), &moving(50.0, 80.0, 1000.0), Sync::Time).is_ok());
}

#[test]
fn the_travel_is_kept_at_both_ends_and_on_the_way() {
    let error = refused(&limits(), at(0.0), at(200.001), Sync::Time);
    assert!(
        matches!(
            error,
            TransferError::OutsideTravel {
                end: TransferEnd::Target,
                position,
                ..
            } if position == 200.001
        ),
        "{error}"
    );
    // From 100 mm/s a stop takes A/J + v/A = 0.15 s and 7.5 mm: 7 mm before the end is too late.
    let error = refused(&limits(), moving(193.0, 100.0, 0.0), at(0.0), Sync::Time);
    let TransferError::LeavesTravel { axis, position, .. } = error else {
        panic!("{error}");
    };
    assert_eq!(axis, AxisLetter::X);
    assert!((position - 200.5).abs() < 1e-3, "{position}");
    assert!(Transfer::solve(&limits(), &moving(192.4, 100.0, 0.0), &at(0.0), Sync::Time).is_ok());
}

#[test]
fn axes_by_themselves_must_end_at_rest() {
    let mut to = moving(10.0, 5.0, 0.0);
    to.position[1] = 3.0;
    let error = refused(&limits(), at(0.0), to, Sync::None);
    assert!(
        matches!(error, TransferError::ArrivesMoving { axis: AxisLetter::X, velocity, .. } if velocity == 5.0),
        "{error}"
    );
    // A single axis needs no synchronisation.
    assert!(Transfer::solve(&limits(), &at(0.0), &moving(10.0, 5.0, 0.0), Sync::None).is_ok());
}

#[test]
fn motion_off_the_line_is_rejected_when_straight() {
    let mut from = moving(0.0, 10.0, 0.0);
    from.velocity[1] = 0.5;
    let error = refused(&limits(), from, at(50.0), Sync::Phase);
    assert!(
        matches!(
            error,
            TransferError::NotStraight {
                axis: AxisLetter::Y,
                end: TransferEnd::Start,
                quantity: Quantity::Velocity,
                off,
            } if (off - 0.5).abs() < 1e-12
        ),
        "{error}"
    );
    assert!(Transfer::solve(&limits(), &from, &at(50.0), Sync::Time).is_ok());
}

#[test]
fn every_refusal_says_what_to_do() {
    let errors = [
        refused(&limits(), at(0.0), at(201.0), Sync::Time),
        refused(&limits(), moving(0.0, 101.0, 0.0), at(0.0), Sync::Time),
        refused(&limits(), moving(199.0, 100.0, 0.0), at(0.0), Sync::Time),
    ];
    for error in errors {
        let text = error.to_string();
        assert!(text.contains("axis X") && text.contains(';'), "{text}");
    }
}

#[test]
fn nothing_to_do_takes_no_time() {
    for sync in [Sync::Time, Sync::Phase, Sync::None] {
        let transfer = Transfer::solve(&limits(), &at(7.0), &at(7.0), sync).unwrap();
        assert_eq!(transfer.duration_s(), 0.0);
        assert_eq!(transfer.at(0.0).position[0], 7.0);
    }
}

#[test]
fn the_state_itself_as_target_is_reached_while_moving() {
    let state = moving(3.0, 40.0, 100.0);
    for sync in [Sync::Time, Sync::Phase] {
        let transfer = Transfer::solve(&limits(), &state, &state, sync).unwrap();
        let end = transfer.at(transfer.duration_s());
        assert_eq!((end.position[0], end.velocity[0]), (3.0, 40.0));
        assert_eq!(transfer.duration_s(), 0.0);
    }
}

#[test]
fn a_cruise_at_the_limit_is_held() {
    let transfer = Transfer::solve(
        &limits(),
        &moving(0.0, 100.0, 0.0),
        &moving(150.0, 100.0, 0.0),
        Sync::Time,
    )
    .unwrap();
    assert!((transfer.duration_s() - 1.5).abs() < 1e-6);
    assert_eq!(transfer.method(), Method::Ruckig);
}

/// 75 mm/s and 1000 mm/s2 lead to, or come from, exactly 75 + 1000^2 / (2 20 000) = 100 mm/s.
#[test]
fn states_that_need_the_full_speed_limit_are_solved() {
    for (from, to) in [
        (moving(0.0, 75.0, 1000.0), at(100.0)),
        (at(0.0), moving(100.0, 75.0, -1000.0)),
        (moving(0.0, 75.0, 1000.0), moving(100.0, 75.0, -1000.0)),
    ] {
        let transfer = Transfer::solve(&limits(), &from, &to, Sync::Time).unwrap();
        assert_eq!(transfer.method(), Method::Ruckig);
        assert!(transfer.duration_s() < 1.2, "{}", transfer.duration_s());
    }
}

#[test]
fn ways_from_a_picometre_to_ten_metres_are_solved() {
    let mut wide = limits();
    (wide.travel_min, wide.travel_max) = (Axes::repeat(-2e4), Axes::repeat(2e4));
    for (exponent, from) in (-9..=4).flat_map(|exponent| [(exponent, 0.0), (exponent, 317.3)]) {
        let distance = 10_f64.powi(exponent);
        for sync in [Sync::Time, Sync::Phase, Sync::None] {
            let transfer = Transfer::solve(&wide, &at(from), &at(from + distance), sync).unwrap();
            // As far as the digits of the position permit.
            let distance = (from + distance) - from;
            // Jerk alone, as long as it does not reach 1000 mm/s2: 2 A^3 / J^2 = 5 mm.
            if distance < 5.0 {
                let wanted = (32.0 * distance / 20_000.0).cbrt();
                assert!(
                    (transfer.duration_s() / wanted - 1.0).abs() < 1e-6,
                    "1e{exponent} mm"
                );
            }
        }
    }
}

/// In metres the C++ solver fails on this move: `ErrorExecutionTimeCalculation`.
#[test]
fn a_move_of_8_um_at_2e6_jerk_is_solved() {
    let mut limits = limits();
    (limits.velocity, limits.acceleration, limits.jerk) =
        (Axes::repeat(100.0), Axes::repeat(2500.0), Axes::repeat(2e6));
    let transfer = Transfer::solve(&limits, &at(0.0), &at(7.8e-3), Sync::Time).unwrap();
    assert!((transfer.duration_s() - (32.0 * 7.8e-3_f64 / 2e6).cbrt()).abs() < 1e-9);
}

#[test]
fn a_micrometre_beside_a_metre_arrives_with_it() {
    let mut wide = limits();
    (wide.travel_min, wide.travel_max) = (Axes::repeat(-2e3), Axes::repeat(2e3));
    let mut to = at(1000.0);
    (to.position[1], to.position[2]) = (1e-3, -1e-6);
    let transfer = Transfer::solve(&wide, &at(0.0), &to, Sync::Time).unwrap();
    let half = transfer.at(0.5 * transfer.duration_s());
    assert!((half.position[1] - 5e-4).abs() < 1e-9 && (half.position[2] + 5e-7).abs() < 1e-12);
}

/// The solver reads its vectors past their end if they are short, and waypoints would leave the computer.
#[test]
fn one_module_names_the_solver_and_sets_no_waypoints() {
    let sources = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for file in std::fs::read_dir(sources).unwrap() {
        let path = file.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        let code: Vec<&str> = text
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"))
            .collect();
        let engine = path.ends_with("engine.rs");
        for line in code {
            assert!(engine || !line.contains("ruckig::"), "{}: {line}", path.display());
            assert!(
                !line.contains("intermediate_positions")
                    || line.trim() == "input.intermediate_positions.clear();",
                "{}: {line}",
                path.display()
            );
        }
    }
}

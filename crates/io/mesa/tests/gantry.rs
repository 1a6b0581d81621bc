//! Two motors of one axis on the simulated board, over real sockets, with a beam that is racked at power-on:
//! homing by the core, and faults during homing.

use evolvent_bridge_trial::{HomingTrial, Messages, TrialCore, states};
use evolvent_drive::{DriveState, GantrySettings, PowerRequest};
use evolvent_mesa::{Actuator, BoardSettings, Pin};
use evolvent_mesa_board::{Beam, BeamMotor, BeamSide, BoardModel, BoardServer, FaultKind};
use evolvent_random::{Random, cases};

use crate::common::core::{STEPS, with_bridge_to};

/// Positions at which the switches close, mm of the beam; they are not quite square.
const SWITCHES: [f64; 2] = [-8.0, -8.12];
/// Coordinate of the first switch.
const SWITCH_MM: f64 = -3.0;
const MAX_DIFFERENCE: f64 = 1.0;
const HOMING: HomingTrial = HomingTrial {
    search_mm_s: 20.0,
    latch_mm_s: 4.0,
    acceleration_mm_s2: 400.0,
    switch_mm: SWITCH_MM,
    home_mm: 2.0,
    travel_mm: 60.0,
};
/// A step of each motor, and two edges that are each seen a period of 2 ms late at most, at 4 mm/s.
const SQUARE_MM: f64 = 2.0 / STEPS + 2.0 * 0.008;
/// The fault input of the second drive, and the pin that enables it.
const FAULT_PIN: usize = 6;
const ENABLE_PIN: usize = 16;

const fn pin(pin: usize, inverted: bool) -> Pin {
    Pin {
        pin,
        remote: None,
        inverted,
        slow: false,
    }
}

/// Adds a second motor of X: on step generator 3, turning against the axis.
fn steppers(board: &mut BoardSettings) {
    let mut second = board.axes[0];
    if let Actuator::Steps { unit, .. } = &mut second.actuator {
        *unit = 3;
    }
    second.inverted = true;
    second.enable = Some(pin(ENABLE_PIN, false));
    second.fault = Some(pin(FAULT_PIN, true));
    second.switches[0] = Some(pin(4, true));
    second.gantry = Some(gantry());
    board.axes.push(second);
    // Each home switch is the limit switch of the negative end as well.
    for motor in [0, board.axes.len() - 1] {
        board.axes[motor].switches[1] = board.axes[motor].switches[0];
    }
}

/// All axes as analog servos of a 7I97, and a second motor of X at encoder 3.
fn servos(board: &mut BoardSettings) {
    let mut text = format!("address = \"{}\"\nname = \"7I97\"\n", board.address);
    for (unit, letter) in ["X", "Y", "Z", "X"].iter().enumerate() {
        text += &format!(
            "[[axis]]\nletter = \"{letter}\"\nencoder = {unit}\npwm = {unit}\ncounts_per_unit = 1000\n\
             full_velocity = 200\np_gain = 60\ni_gain = 200\n"
        );
        if *letter == "X" {
            text += &format!("home_switch = {{ pin = {}, inverted = true }}\n", 40 + unit);
        }
    }
    text += "[axis.gantry]\nmax_difference = 1\nsquaring_offset = 0.12\nsquare_speed = 4\n";
    let parsed = BoardSettings::parse(&text, "servos.toml").expect("a board file");
    *board = BoardSettings {
        watchdog_s: board.watchdog_s,
        max_lost_packets: board.max_lost_packets,
        ..parsed
    };
}

fn gantry() -> GantrySettings {
    GantrySettings {
        squaring_offset: SWITCHES[0] - SWITCHES[1],
        max_difference: MAX_DIFFERENCE,
        square_velocity: 4.0,
    }
}

/// Asserts that neither motor of the beam turns.
fn assert_stopped(server: &BoardServer) {
    for unit in [0, 3] {
        let rate = server.lock().step_rate(unit);
        assert!(rate.abs() < 1.0, "motor {unit} turns at {rate} steps/s");
    }
}

/// Runs a test on a board with a beam racked by `rack` mm.
fn on_beam(model: BoardModel, rack: f64, test: impl Fn(&mut TrialCore, &BoardServer, &Messages)) {
    let is_servo = model == BoardModel::B7i97;
    let side = |side: usize, start_mm: f64| BeamSide {
        motor: match (is_servo, side) {
            (true, side) => BeamMotor::Shaft([0, 3][side]),
            (false, side) => BeamMotor::Steps([0, 3][side]),
        },
        per_mm: if is_servo {
            1000.0
        } else {
            STEPS * [1.0, -1.0][side]
        },
        start_mm,
        switch_pin: if is_servo { [40, 43][side] } else { [0, 4][side] },
        switch_mm: SWITCHES[side],
    };
    let beam = Beam::new([side(0, 0.0), side(1, rack)], 3.0);
    with_bridge_to(
        model,
        if is_servo { servos } else { steppers },
        |core, server, messages| {
            server.lock().set_beam(beam);
            test(core, server, messages);
        },
    );
}

fn sides(server: &BoardServer) -> [f64; 2] {
    server.lock().beam().expect("a beam").position_mm()
}

/// Errors of the beam's squareness and of the first motor's coordinate in the core, mm.
fn errors(core: &TrialCore, server: &BoardServer) -> [f64; 2] {
    let [first, second] = sides(server);
    let (_, feedback) = core.newest.expect("feedback");
    let zero = feedback.position[0] - (first - SWITCHES[0] + SWITCH_MM);
    [second - first, zero]
}

fn assert_square(core: &TrialCore, server: &BoardServer, bound: f64) {
    let found = errors(core, server);
    println!("square within {:.4}, zero within {:.4} mm", found[0], found[1]);
    assert!(
        found.iter().all(|error| error.abs() <= bound),
        "square and zero: {found:?} mm off, {bound} permitted"
    );
}

fn switch_off(core: &mut TrialCore) {
    (core.power, core.velocity_x) = (PowerRequest::Off, 0.0);
    core.rest(0.3);
}

#[test]
fn homing_by_the_core_squares_a_racked_beam() {
    let mut random = Random::seeded(72);
    for _ in 0..cases(3) {
        let rack = random.between(-0.8, 0.8);
        on_beam(BoardModel::B7i96s, rack, |core, server, messages| {
            core.bring_up();
            assert!(server.lock().level(ENABLE_PIN), "the second drive is enabled");
            let [was, _] = errors(core, server);
            assert!((was - rack).abs() < 2.0 / STEPS, "power on moves nothing: {was}");
            core.home_x(&HOMING, |_| {}).expect("machine zero");
            assert!(
                messages.contain("gantry of X: homed by both switches"),
                "{messages:?}"
            );
            core.rest(0.6);
            assert_square(core, server, SQUARE_MM);
            core.velocity_x = 30.0;
            for _ in 0..200 {
                core.cycle();
                let [square, _] = errors(core, server);
                assert!(square.abs() < SQUARE_MM + 1.0 / STEPS, "{square} mm in motion");
            }
            core.velocity_x = 0.0;
            core.rest(0.2);
            // The loss is corrected by homing: a motor without torque slips.
            switch_off(core);
            assert!(!server.lock().level(ENABLE_PIN) && !server.lock().level(11));
            server.lock().beam().expect("a beam").slip(1, -0.4);
            core.bring_up();
            core.home_x(&HOMING, |_| {}).expect("machine zero");
            core.rest(0.6);
            assert_square(core, server, SQUARE_MM);
            let stalls = [0, 3].map(|unit| server.lock().motor_stalls(unit));
            assert_eq!(stalls, [0, 0]);
        });
    }
}

/// Analog servos, whose encoders always show their difference.
#[test]
fn a_racked_beam_of_servos_is_square_after_homing() {
    on_beam(BoardModel::B7i97, -0.5, |core, server, _| {
        core.bring_up();
        core.home_x(&HOMING, |_| {}).expect("machine zero");
        core.rest(1.0);
        // Each loop is within 0.02 mm at rest.
        assert_square(core, server, SQUARE_MM + 0.04);
    });
}

#[test]
fn a_home_switch_that_never_closes_stops_both_motors() {
    for side in 0..2 {
        on_beam(BoardModel::B7i96s, 0.3, |core, server, messages| {
            server.lock().beam().expect("a beam").wire_switch(side, false);
            core.bring_up();
            let failed = core.home_x(&HOMING, |_| {});
            assert!(failed.expect_err("no switch").contains("8611h"));
            let (_, feedback) = core.newest.expect("feedback");
            assert!(states(&feedback)[0].is_some_and(DriveState::is_fault));
            core.rest(0.5);
            assert_stopped(server);
            let [first, second] = sides(server);
            let beyond = SWITCHES[1 - side] - [first, second][1 - side];
            // max_difference and squaring_offset, three periods at 20 mm/s, and the ramp of 0.27 mm at 1500
            // mm/s2 with its jerk.
            assert!(
                (0.8..2.2).contains(&beyond),
                "{beyond} mm beyond the other switch"
            );
            let missing = ["first", "second"][side];
            let text = format!("gantry of X: the home switch of the {missing} drive has not closed");
            assert!(messages.contain(&text), "{messages:?}");
            // The wire is repaired; power has to be off once.
            server.lock().beam().expect("a beam").wire_switch(side, true);
            switch_off(core);
            core.fault_reset += 1;
            core.bring_up();
            core.home_x(&HOMING, |_| {}).expect("machine zero");
            core.rest(0.6);
            assert_square(core, server, SQUARE_MM);
        });
    }
}

/// One side is blocked while the axis moves: encoders show it, so both stop before the beam is racked much
/// farther than permitted.
#[test]
fn blocked_servo_stops_both_soon_after_the_limit() {
    on_beam(BoardModel::B7i97, 0.0, |core, server, messages| {
        core.bring_up();
        core.velocity_x = 30.0;
        core.rest(0.4);
        server.lock().beam().expect("a beam").hold(1, true);
        let feedback = core.until("a fault", |feedback| feedback.error_code == 0x8611);
        assert!(states(&feedback)[0].is_some_and(DriveState::is_fault));
        core.velocity_x = 0.0;
        core.rest(0.5);
        let [first, second] = sides(server);
        let rack = (second - first).abs();
        // The limit, two periods at 30 mm/s and the ramp: v2 / 2a is 0.3 mm at 1500 mm/s2, and twice that
        // with its jerk.
        assert!(
            (MAX_DIFFERENCE - 0.2..MAX_DIFFERENCE + 1.2).contains(&rack),
            "{rack} mm apart"
        );
        assert!(
            messages.contain("gantry of X: the second drive is"),
            "{messages:?}"
        );
    });
}

/// Steppers do not show that one was blocked. The next homing detects it, and does not continue.
#[test]
fn homing_finds_steps_lost_by_a_blocked_side() {
    on_beam(BoardModel::B7i96s, 0.0, |core, server, _| {
        core.bring_up();
        core.home_x(&HOMING, |_| {}).expect("machine zero");
        core.rest(0.5);
        core.velocity_x = 30.0;
        for lost in [0.6, 1.6] {
            // One side is blocked for this time.
            core.velocity_x = 30.0;
            server.lock().beam().expect("a beam").hold(0, true);
            let [_, from] = sides(server);
            while sides(server)[1] - from < lost {
                core.cycle();
            }
            server.lock().beam().expect("a beam").hold(0, false);
            core.velocity_x = 0.0;
            core.rest(0.4);
            let [rack, _] = errors(core, server);
            assert!(rack > lost - 0.1, "{rack}");
            let result = core.home_x(&HOMING, |_| {});
            if rack > MAX_DIFFERENCE {
                assert!(result.expect_err("racked too far").contains("8611h"));
            } else {
                result.expect("machine zero");
                core.rest(0.6);
                assert_square(core, server, SQUARE_MM);
            }
        }
    });
}

/// The drive of the second motor has a fault during homing; afterwards the beam is homed as if nothing had
/// happened.
#[test]
fn second_drive_failing_in_homing_stops_the_first() {
    let mut random = Random::seeded(74);
    for _ in 0..cases(2) {
        let at = 50 + random.below(1200);
        on_beam(BoardModel::B7i96s, -0.6, |core, server, messages| {
            server.lock().set_level(FAULT_PIN, true);
            core.bring_up();
            let mut cycles = 0;
            let result = core.home_x(&HOMING, |_| {
                cycles += 1;
                if cycles == at {
                    server.lock().set_level(FAULT_PIN, false);
                }
            });
            if cycles < at {
                server.lock().set_level(FAULT_PIN, false);
                core.until("the fault", |feedback| feedback.error_code == 0x9000);
            } else {
                assert!(
                    result.expect_err("a fault").contains("9000h"),
                    "after {at} cycles"
                );
            }
            core.rest(0.4);
            assert_stopped(server);
            assert!(messages.contain("X, second drive: 9000h"), "{messages:?}");
            // Its steps count although it has no torque; the ramps of both are the same.
            switch_off(core);
            server.lock().set_level(FAULT_PIN, true);
            core.fault_reset += 1;
            core.bring_up();
            core.home_x(&HOMING, |_| {}).expect("machine zero");
            core.rest(0.6);
            assert_square(core, server, SQUARE_MM);
        });
    }
}

/// The board restarts, or power is switched off, during homing: the next homing is not affected.
#[test]
fn homing_that_is_interrupted_begins_again() {
    let mut random = Random::seeded(75);
    for restarts in [true, false] {
        let at = 50 + random.below(1400);
        on_beam(BoardModel::B7i96s, 0.7, |core, server, _| {
            let before = core.bring_up();
            let mut cycles = 0;
            let _interrupted = core.home_x(&HOMING, |core| {
                cycles += 1;
                if cycles == at && restarts {
                    server.lock().fault_now(FaultKind::Reset, None);
                } else if cycles == at {
                    core.power = PowerRequest::Off;
                }
            });
            switch_off(core);
            core.rest(2.0);
            core.fault_reset += 1;
            let after = core.bring_up();
            if restarts && cycles >= at {
                assert_ne!(after.instance, before.instance, "another session");
            }
            core.home_x(&HOMING, |_| {}).expect("machine zero");
            core.rest(0.6);
            assert_square(core, server, SQUARE_MM);
        });
    }
}

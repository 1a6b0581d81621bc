//! Two drives of one axis on the simulated ring, over real sockets: squaring, and the limit of their
//! difference.
//!
//! Needs the right to create a network namespace.

#![expect(clippy::expect_used, reason = "a test")]

use std::time::{Duration, Instant};

use evolvent_bridge_trial::{HomingTrial, Messages, TrialCore, states};
use evolvent_disturbance::unless_disturbed;
use evolvent_drive::{DriveState, PowerRequest};
use evolvent_ethercat::{GantrySettings, HomingOnDrive, Network, NetworkAxis};
use evolvent_ethercat_ring::{DriveSettings, FaultKind, SharedRing, SubDevice, TerminalKind, on_bench};
use evolvent_random::{Random, cases};

use crate::support::*;

/// X, Y, Z and a second drive of X; lower limit switches of the two of X at -2 and -2.5 turns.
fn devices() -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    for (serial, lower, start) in [(2, -2.0, 0), (3, -200.0, 0), (4, -200.0, 0)] {
        devices.push(drive(serial, lower, start));
    }
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    devices.push(drive(6, -2.5, 5_000_000));
    devices
}

fn drive(serial: u32, lower: f64, start_increments: i32) -> SubDevice {
    let settings = DriveSettings {
        limits_turns: [lower, 200.0],
        start_increments,
        ..DriveSettings::default()
    };
    SubDevice::drive(settings, serial, 10.0 * f64::from(serial))
}

/// Adds the second drive of X to the shipped network.
fn add_second(network: &mut Network, edit: impl Fn(&mut NetworkAxis)) {
    let mut second = network.devices[1].clone();
    second.name = "x2-drive".to_owned();
    let gantry = GantrySettings {
        squaring_offset: 0.0,
        max_difference: 0.5,
        square_velocity: 2.0,
    };
    second.axis.as_mut().expect("an axis").gantry = Some(gantry);
    network.devices.push(second);
    for device in [1, 5] {
        edit(network.devices[device].axis.as_mut().expect("an axis"));
    }
}

fn set_gantry(axis: &mut NetworkAxis, change: impl Fn(&mut GantrySettings)) {
    if let Some(gantry) = &mut axis.gantry {
        change(gantry);
    }
}

/// Turns of the first and the second drive of X.
fn turns(ring: &SharedRing) -> [f64; 2] {
    let ring = ring.lock().expect("no panic");
    [1, 5].map(|device| ring.devices()[device].as_drive().expect("a drive").motor_turns())
}

#[test]
fn both_drives_move_together_whatever_their_counters() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |network| add_second(network, |_| {}),
                ring,
                |core, ring, _| {
                    core.bring_up();
                    core.velocity_x = 20.0;
                    let mut apart = 0.0_f64;
                    for _ in 0..250 {
                        core.cycle();
                        let [one, other] = turns(ring);
                        apart = apart.max((one - other).abs() * 5.0);
                    }
                    core.stop();
                    let goal = core.position[0];
                    core.until("the goal", |feedback| {
                        (feedback.position[0] - goal).abs() < 1e-3 && feedback.velocity[0].abs() < 0.5
                    });
                    let [one, other] = turns(ring);
                    assert!((one * 5.0 - goal).abs() < 2e-3 && (other * 5.0 - goal).abs() < 2e-3);
                    assert!(apart < 0.05, "{apart} mm apart in motion");
                },
            );
        });
    });
}

/// The second drive's load is blocked; its own window of following errors is a turn, 5 mm.
#[test]
fn drives_that_diverge_stop_soon_after_the_limit() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |network| add_second(network, |_| {}),
                ring,
                |core, ring, messages| {
                    core.bring_up();
                    core.velocity_x = 20.0;
                    for _ in 0..100 {
                        core.cycle();
                    }
                    begin(ring, FaultKind::Blocked, 5, Some(2_000_000_000));
                    let feedback = core.until("the fault", |feedback| feedback.error_code == 0x8611);
                    assert_eq!(states(&feedback)[0], Some(DriveState::Fault));
                    core.velocity_x = 0.0;
                    core.until("rest", |_| speeds(ring).iter().all(|speed| *speed < 0.02));
                    let [one, other] = turns(ring);
                    let apart = (one - other).abs() * 5.0;
                    // 0.5 mm, plus the distances of one frame at 20 mm/s and of the quick stop.
                    assert!((0.3..1.5).contains(&apart), "{apart} mm apart");
                    assert!(
                        messages.contain("gantry of X: the second drive is"),
                        "{messages:?}"
                    );
                },
            );
        });
    });
}

/// Each drive homes at its own switch; on a square beam the second one's coordinate is 0.3 mm above that of
/// the first. The second then moves there at 2 mm/s.
#[test]
fn a_beam_is_made_square_after_homing() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(
                |network| {
                    let homing = HomingOnDrive {
                        method: 17,
                        search: 2 << 20,
                        latch: 1 << 18,
                        acceleration: Some(100 << 20),
                        position: -100.0,
                        order: 0,
                        timeout_s: 20.0,
                    };
                    // Switches half a turn apart: 2.5 mm, by which the frame may twist during the search.
                    add_second(network, |axis| {
                        axis.homing = Some(homing);
                        set_gantry(axis, |gantry| {
                            (gantry.squaring_offset, gantry.max_difference) = (0.3, 4.0);
                        });
                    });
                },
                ring,
                |core, ring, messages| {
                    core.until("feedback", |_| true);
                    core.power = PowerRequest::On;
                    let begin = Instant::now();
                    while messages.count("drive of X: machine zero found") < 2 {
                        core.cycle();
                        assert!(begin.elapsed() < Duration::from_secs(20), "{messages:?}");
                    }
                    for _ in 0..100 {
                        core.cycle();
                    }
                    let before = turns(ring);
                    assert!(
                        (before[0] - before[1] - 0.5).abs() < 0.1,
                        "at their switches: {before:?}"
                    );
                    core.bring_up();
                    let begun = Instant::now();
                    let switch_apart = |ring: &SharedRing| {
                        let [one, other] = turns(ring);
                        // Coordinates of both, from the positions of their switches.
                        let (one, other) = (-100.0 + 5.0 * (one + 2.0), -100.0 + 5.0 * (other + 2.5));
                        other - one
                    };
                    core.until("a square beam", |_| (switch_apart(ring) - 0.3).abs() < 0.05);
                    assert!(begun.elapsed() < Duration::from_secs(5));
                    core.velocity_x = 20.0;
                    for _ in 0..200 {
                        core.cycle();
                        assert!((switch_apart(ring) - 0.3).abs() < 0.1, "{}", switch_apart(ring));
                    }
                    assert!(!messages.contain("gantry of X"), "{messages:?}");
                },
            );
        });
    });
}

/// Positions at which the home switches of X and its second drive close, mm of their motors: 10 mm below, and
/// not quite square.
const SWITCHES: [f64; 2] = [-10.0, -10.15];
/// Coordinate of the first switch.
const SWITCH_MM: f64 = -3.0;
const HOMING: HomingTrial = HomingTrial {
    search_mm_s: 20.0,
    latch_mm_s: 4.0,
    acceleration_mm_s2: 400.0,
    switch_mm: SWITCH_MM,
    home_mm: 2.0,
    travel_mm: 60.0,
};

/// A bench whose beam is racked by `rack` mm at power-on; the core homes it by switches at bit 0, which are
/// the limit switches of the negative end as well. `switches` in mm.
fn on_switch_bench(
    rack: f64,
    switches: [f64; 2],
    test: impl Fn(&mut TrialCore, &SharedRing, &Messages) + Send + Clone + 'static,
) {
    unless_disturbed(move || {
        let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
        for (serial, lower) in [(2, switches[0] / 5.0), (3, -200.0), (4, -200.0)] {
            devices.push(drive(serial, lower, 0));
        }
        devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
        let second = DriveSettings {
            limits_turns: [switches[1] / 5.0, 200.0],
            start_turns: rack / 5.0,
            start_increments: 77_000_000,
            ..DriveSettings::default()
        };
        devices.push(SubDevice::drive(second, 6, 60.0));
        let test = test.clone();
        on_bench(devices, move |ring| {
            with_bridge(
                |network| {
                    add_second(network, |axis| {
                        axis.home_switch_bit = Some(0);
                        axis.limit_switches = true;
                        set_gantry(axis, |gantry| {
                            gantry.squaring_offset = SWITCHES[0] - SWITCHES[1];
                            gantry.max_difference = 1.0;
                        });
                    });
                },
                ring,
                |core, ring, messages| test(core, ring, messages),
            );
        });
    });
}

/// Errors of the beam's squareness and of the first drive's coordinate in the core, mm.
fn errors(core: &TrialCore, ring: &SharedRing) -> (f64, f64) {
    let [one, other] = turns(ring).map(|turns| 5.0 * turns);
    let (_, feedback) = core.newest.expect("feedback");
    (
        other - one,
        feedback.position[0] - (one - SWITCHES[0] + SWITCH_MM),
    )
}

/// Two edges, each seen a period of 2 ms late at most, at 4 mm/s, and the twist between a drive's motor and
/// its load.
const SQUARE_MM: f64 = 0.02;
const HOMINGS: usize = 3;

/// Homes X until the beam is square and its zero is true. A period that the host withholds at an edge moves
/// that edge by 0.008 mm, which no other homing repeats; a fault of the procedure recurs each time.
fn home_square(core: &mut TrialCore, ring: &SharedRing, rest_s: f64) {
    let found: Vec<_> = (0..HOMINGS)
        .map(|_| {
            core.home_x(&HOMING, |_| {}).expect("machine zero");
            core.rest(rest_s);
            errors(core, ring)
        })
        .take_while(|(square, zero)| square.abs() >= SQUARE_MM || zero.abs() >= SQUARE_MM)
        .collect();
    assert!(found.len() < HOMINGS, "square and zero, mm off: {found:?}");
}

#[test]
fn homing_by_the_core_squares_a_racked_beam() {
    let mut random = Random::seeded(72);
    for _ in 0..cases(2) {
        let rack = random.between(-0.8, 0.8);
        on_switch_bench(rack, SWITCHES, move |core, ring, messages| {
            core.bring_up();
            assert!(
                (errors(core, ring).0 - rack).abs() < 0.02,
                "power on moves nothing"
            );
            home_square(core, ring, 1.5);
            assert!(
                messages.contain("gantry of X: homed by both switches"),
                "{messages:?}"
            );
            // Also in motion; homed again, it stays.
            core.velocity_x = 20.0;
            for _ in 0..100 {
                core.cycle();
                let (square, _) = errors(core, ring);
                assert!(square.abs() < 0.06, "{square} mm from square in motion");
            }
            core.velocity_x = 0.0;
            core.rest(0.3);
            home_square(core, ring, 0.5);
        });
    }
}

#[test]
fn a_home_switch_that_never_closes_stops_both_drives() {
    for side in 0..2 {
        let mut switches = SWITCHES;
        switches[side] = -500.0;
        on_switch_bench(0.2, switches, move |core, ring, messages| {
            core.bring_up();
            let mut deepest = 0.0_f64;
            let failed = core.home_x(&HOMING, |_| {
                let lowest = turns(ring).map(|turns| 5.0 * turns)[1 - side];
                deepest = deepest.max(SWITCHES[1 - side] - lowest);
            });
            assert!(failed.expect_err("no switch").contains("8611h"));
            core.power = PowerRequest::Off;
            core.rest(0.5);
            assert!(speeds(ring).iter().all(|speed| *speed < 0.02));
            let lowest = turns(ring).map(|turns| 5.0 * turns)[1 - side];
            deepest = deepest.max(SWITCHES[1 - side] - lowest);
            // max_difference and squaring_offset, three periods at 20 mm/s, and the distance of the quick
            // stop.
            assert!((0.7..2.0).contains(&deepest), "{deepest} mm beyond its switch");
            let missing = ["first", "second"][side];
            let text = format!("the home switch of the {missing} drive has not closed");
            assert!(messages.contain(&text), "{messages:?}");
        });
    }
}

/// The second drive has a fault, or loses its torque, while the beam is homed; afterwards it is homed as if
/// nothing had happened.
#[test]
fn second_drive_failing_in_homing_stops_the_first() {
    for (kind, seed) in [(FaultKind::Drive, 1), (FaultKind::TorqueOff, 2)] {
        on_switch_bench(0.4, SWITCHES, move |core, ring, _| {
            let mut random = Random::seeded(seed);
            core.bring_up();
            let at = 50 + random.below(1200);
            let mut cycles = 0;
            let result = core.home_x(&HOMING, |_| {
                cycles += 1;
                if cycles == at {
                    begin(ring, kind, 5, Some(100_000_000));
                }
            });
            if cycles < at {
                begin(ring, kind, 5, Some(100_000_000));
            } else {
                assert!(result.is_err(), "{kind:?} after {at} cycles");
            }
            core.rest(0.5);
            assert!(speeds(ring).iter().all(|speed| *speed < 0.02), "{kind:?}");
            let (square, _) = errors(core, ring);
            assert!(square.abs() < 1.5, "{square} mm from square");
            (core.power, core.velocity_x) = (PowerRequest::Off, 0.0);
            core.rest(0.3);
            core.fault_reset += 1;
            core.bring_up();
            home_square(core, ring, 1.5);
        });
    }
}

#[test]
fn second_drive_needs_first_with_same_homing_method() {
    let text = evolvent_file_tests::shipped("networks/sim-mill.toml");
    let second = |letter: &str, more: &str| {
        format!(
            "{text}\n[[device]]\nname = \"second\"\nvendor = 1\nproduct = 2\n[device.axis]\n\
             letter = \"{letter}\"\nincrements_per_turn = 1048576\nturn_mm = 5\n{more}\n\
             [device.axis.gantry]\nmax_difference = 0.5\n"
        )
    };
    assert!(Network::parse(&second("X", ""), "good.toml").is_ok());
    for (text, what) in [
        (second("U", ""), "no other device drives this axis"),
        (
            second("X", "absolute = true"),
            "find their zero in different ways",
        ),
        (
            second("X", "").replace("max_difference = 0.5", "max_difference = 0"),
            "out of range",
        ),
        (
            second("X", "").replace("max_difference = 0.5", ""),
            "max_difference",
        ),
        (second("X", "home_switch_bit = 2"), "the other has none"),
        (
            second("X", "touch_probe = true"),
            "give it to the first drive of the axis",
        ),
        (
            second("X", "")
                .replace("letter = \"X\"", "letter = \"X\"\nhome_switch_bit = 2")
                .replacen(
                    "[device.axis]\nletter = \"X\"\nhome_switch_bit = 2\nincrements_per_turn = 1048576\n\
                 turn_mm = 5\n\n[device.axis.gantry]",
                    "[device.axis]\nletter = \"X\"\nincrements_per_turn = 1048576\nturn_mm = 5\n\n\
                 [device.axis.gantry]",
                    1,
                ),
            "the other has none",
        ),
        (
            second("X", "").replace("\n[device.axis.gantry]\nmax_difference = 0.5", ""),
            "[device.axis.gantry]",
        ),
    ] {
        let error = Network::parse(&text, "bad.toml").expect_err(what).to_string();
        assert!(error.starts_with("bad.toml:") && error.contains(what), "{error}");
    }
}

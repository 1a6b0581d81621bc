//! The latch of encoder index pulses for the core, on the simulated board over real sockets.

use evolvent_bridge_trial::TrialCore;
use evolvent_machine::Machine;
use evolvent_mesa::{BoardSettings, FitError, check_fit};
use evolvent_mesa_board::{BoardModel, BoardServer, FaultKind};
use evolvent_random::Random;

use crate::common::core::with_bridge_to;
use crate::common::{machine, router};

/// Counts per turn of each encoder.
const TURN: i64 = 4000;
/// Counts per mm; Y turns against its axis.
const COUNTS: [f64; 3] = [1000.0, -1000.0, 1000.0];
/// The count of the index within a turn.
const INDEX: [i64; 3] = [1300, 2750, 10];

/// Three analog servos; the index of Z is low.
fn servos(board: &mut BoardSettings) {
    let text = ["X", "Y", "Z"].iter().enumerate().fold(
        format!("address = \"{}\"\nname = \"7I97\"\n", board.address),
        |text, (unit, letter)| {
            let (inverted, low) = (unit == 1, unit == 2);
            text + &format!(
                "[[axis]]\nletter = \"{letter}\"\nencoder = {unit}\npwm = {unit}\ncounts_per_unit = 1000\n\
                 full_velocity = 200\np_gain = 60\ni_gain = 200\ninverted = {inverted}\nzero = 5\n\
                 index_inverted = {low}\n"
            )
        },
    );
    *board = BoardSettings {
        watchdog_s: 0.1,
        max_lost_packets: 50,
        ..BoardSettings::parse(&text, "servos.toml").expect("a board file")
    };
}

/// The board, its bridge, and the request of the core.
struct Latch<'a> {
    core: &'a mut TrialCore,
    server: &'a BoardServer,
}

impl Latch<'_> {
    /// The machine coordinate of the first pulse that an axis at rest meets in a direction: its edge, in
    /// whole counts.
    fn next(&mut self, axis: usize, direction: f64) -> f64 {
        let feedback = self.core.until("feedback", |_| true);
        let here = self.server.lock().shaft(axis).floor() as i64;
        let forwards = direction * COUNTS[axis] > 0.0;
        // Z has its falling edge: where the pulse ends.
        let edge = INDEX[axis]
            + match (axis, forwards) {
                (2, true) => 1,
                (2, false) => -1,
                _ => 0,
            };
        let count = if forwards {
            here + (edge - here - 1).rem_euclid(TURN) + 1
        } else {
            here - (here - edge - 1).rem_euclid(TURN) - 1
        };
        feedback.position[axis] + (count - here) as f64 / COUNTS[axis]
    }

    /// Asserts that the position latched for the newest request is that of the pulse.
    fn check(&mut self, axis: usize, expected: f64) {
        let counts = (self.core.latched_index() - expected) * COUNTS[axis];
        println!("axis {axis}: {counts:.2} counts off");
        // Feedback and shaft are read a moment apart: at rest a servo may hunt by one.
        assert!(counts.abs() < 1.01, "axis {axis}: {counts} counts off");
    }
}

fn with_latch(starts: [f64; 3], test: impl Fn(&mut Latch<'_>)) {
    let edit = |board: &mut BoardSettings| servos(board);
    with_bridge_to(BoardModel::B7i97, edit, |core, server, _| {
        for unit in 0..3 {
            server.lock().set_index(unit, INDEX[unit]);
            let already = server.lock().shaft(unit);
            server.lock().turn_shaft(unit, starts[unit] - already);
        }
        core.rest(0.2);
        core.bring_up();
        core.rest(0.5);
        test(&mut Latch { core, server });
    });
}

/// From random positions, in both directions, at two speeds, also for an inverted axis and for a pulse that
/// is low.
#[test]
fn the_latched_position_is_the_place_of_the_pulse() {
    let mut random = Random::new();
    let starts = core::array::from_fn(|_| random.between(-20_000.0, 20_000.0));
    let directions: [f64; 6] = core::array::from_fn(|_| {
        if random.bits().is_multiple_of(2) {
            1.0
        } else {
            -1.0
        }
    });
    with_latch(starts, |latch| {
        for (i, velocity) in [5.0, 40.0].into_iter().enumerate() {
            for axis in 0..3 {
                let direction = directions[3 * i + axis];
                latch.core.request_index(axis as u32);
                let expected = latch.next(axis, direction);
                latch.core.travel(axis, direction * 5.0, velocity);
                latch.check(axis, expected);
            }
        }
    });
}

#[test]
fn requests_follow_each_other() {
    with_latch([0.0; 3], |latch| {
        latch.core.request_index(0);
        let first = latch.next(0, 1.0);
        latch.core.travel(0, 4.0, 20.0);
        latch.check(0, first);
        latch.core.request_index(0);
        let second = latch.next(0, 1.0);
        assert!((second - first - 4.0).abs() < 0.005, "a turn further");
        latch.core.travel(0, 4.0, 20.0);
        latch.check(0, second);
        // X is pending when Y is requested: only that of Y counts.
        latch.core.request_index(0);
        latch.core.request_index(1);
        let of_y = latch.next(1, -1.0);
        latch.core.travel(0, 5.0, 20.0);
        let feedback = latch.core.until("feedback", |_| true);
        assert!(
            feedback.index_position.is_nan(),
            "the pulse of X is not that of Y"
        );
        latch.core.travel(1, -5.0, 20.0);
        latch.check(1, of_y);
        latch.core.index = (0, 0);
        latch.core.until("nothing is asked for", |feedback| {
            (feedback.index_request, feedback.index_position) == (0, 0.0)
        });
        latch.core.index = (40, 0);
        latch.core.cycle();
        latch.core.index = (41, 0);
        latch.core.cycle();
        latch.core.request_index(0);
        let last = latch.next(0, -1.0);
        latch.core.travel(0, -5.0, 20.0);
        latch.check(0, last);
        // An axis at rest in the pulse latches the next one, because it has passed this edge.
        latch.core.request_index(0);
        let further = latch.next(0, -1.0);
        latch.core.travel(0, -5.0, 20.0);
        latch.check(0, further);
    });
}

/// Packets lost in either direction around the arming and the pulse neither lose the pulse nor latch the one
/// after it.
#[test]
fn lost_packets_lose_no_pulse() {
    with_latch([0.0; 3], |latch| {
        let mut random = Random::seeded(3);
        for kind in [FaultKind::LossIn, FaultKind::LossOut, FaultKind::Half] {
            for _ in 0..2 {
                let expected = latch.next(0, 1.0);
                latch.core.index = (latch.core.index.0 + 1, 0);
                let mut lost = 0;
                let around_pulse = expected - random.between(0.02, 0.15);
                for i in 0..220 {
                    // The arming is due a lead after it was sent: 50 periods.
                    if i > 60 {
                        latch.core.velocity_x = 10.0;
                    }
                    if i == 48 || lost == 1 && latch.core.position[0] > around_pulse {
                        latch.server.lock().fault_now(kind, Some(16_000_000));
                        lost += 1;
                    }
                    latch.core.cycle();
                }
                latch.core.stop();
                let left = expected + 0.5 - latch.core.position[0];
                latch.core.travel(0, left.max(0.1), 20.0);
                latch.check(0, expected);
                latch.server.lock().clear_faults();
            }
        }
    });
}

#[test]
fn nothing_latches_without_wire_or_on_steppers() {
    with_latch([0.0; 3], |latch| {
        latch.server.lock().fault_now(FaultKind::IndexMissing, None);
        latch.core.request_index(0);
        latch.core.travel(0, 9.0, 40.0);
        let feedback = latch.core.until("feedback", |_| true);
        assert!(feedback.index_position.is_nan() && feedback.index_request == latch.core.index.0);
    });
    with_bridge_to(
        BoardModel::B7i96s,
        |_| {},
        |core, _, _| {
            core.bring_up();
            core.index = (1, 0);
            core.rest(0.5);
            let feedback = core.until("feedback", |_| true);
            assert_eq!((feedback.index_request, feedback.index_position), (0, 0.0));
        },
    );
    let shipped = evolvent_file_tests::shipped("machines/router-3axis.toml");
    let switch =
        "axis = \"X\"\norder = 1\ntowards = \"negative\"\nsearch_mm_s = 40\nlatch_mm_s = 4\nswitch_mm = -2\n";
    assert!(shipped.contains(switch));
    let index = "axis = \"X\"\nmethod = \"index\"\ntowards = \"negative\"\nlatch_mm_s = 5\nindex_mm = 0\n\
                 index_within_mm = 5\n";
    let text = shipped.replace(switch, index);
    let homed = Machine::parse(&text, "machine.toml").expect("a machine");
    let board = router([127, 0, 0, 1].into());
    assert_eq!(check_fit(&machine("router-3axis"), &board), Ok(()));
    assert_eq!(check_fit(&homed, &board), Err(FitError::NoIndex { letter: 'X' }));
}

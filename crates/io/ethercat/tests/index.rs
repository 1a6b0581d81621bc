//! The latch of the encoder's zero impulse for the core, on the simulated ring over real sockets.
//!
//! Needs the right to create a network namespace.

#![expect(clippy::expect_used, clippy::print_stdout, reason = "a test")]

use evolvent_bridge_trial::TrialCore;
use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat::{GantrySettings, Network, NetworkAxis, ProbeNumber};
use evolvent_ethercat_ring::{DriveSettings, FaultKind, SharedRing, SubDevice, TerminalKind, on_bench};
use evolvent_random::Random;

use crate::support::*;

/// Where the impulse of X, Y and Z, and of the second drive of X, is within a turn.
const PHASES: [f64; 4] = [0.3, 0.55, 0.8, 0.05];
/// Increments per turn.
const RESOLUTION: f64 = 1_048_576.0;
/// Travel of X, Y and Z per turn of the motor: 5 mm, 5 mm against the axis, a gear of 3 to 2 and a screw of
/// 5.08 mm.
const TURNS: [f64; 3] = [5.0, -5.0, 5.08 / 1.5];

fn drive(serial: u32, phase: f64, start_turns: f64) -> SubDevice {
    let settings = DriveSettings {
        index_turns: phase,
        start_turns,
        // The counter passes its end within the first turns.
        start_increments: i32::MAX - 1_200_000 * (serial as i32 - 2),
        // The probe of X closes two turns away.
        probe_turns: if serial == 2 { start_turns + 2.0 } else { 1000.0 },
        ..DriveSettings::default()
    };
    SubDevice::drive(settings, serial, 10.0 * f64::from(serial))
}

fn devices(starts: [f64; 4]) -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    for (serial, axis) in (2..).zip(0..3) {
        devices.push(drive(serial, PHASES[axis], starts[axis]));
    }
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    devices.push(drive(6, PHASES[3], starts[3]));
    devices
}

/// The shipped network with the second drive of X; X and Z latch the impulse by touch probe 2, Y by 1.
fn edit(network: &mut Network) {
    for (device, probe) in [
        (1, ProbeNumber::Two),
        (2, ProbeNumber::One),
        (3, ProbeNumber::Two),
    ] {
        axis(network, device).index_probe = Some(probe);
    }
    let mut second = network.devices[1].clone();
    second.name = "x2-drive".to_owned();
    network.devices.push(second);
    let gantry = GantrySettings {
        squaring_offset: 0.0,
        max_difference: 0.5,
        square_velocity: 2.0,
    };
    let second = axis(network, 5);
    (second.gantry, second.index_probe) = (Some(gantry), None);
}

fn axis(network: &mut Network, device: usize) -> &mut NetworkAxis {
    network.devices[device].axis.as_mut().expect("an axis")
}

fn turns(ring: &SharedRing, device: usize) -> f64 {
    let ring = ring.lock().expect("no panic");
    ring.devices()[device].as_drive().expect("a drive").motor_turns()
}

/// The drives, their bridge, and the request of the core.
struct Latch<'a> {
    core: &'a mut TrialCore,
    ring: &'a SharedRing,
}

impl Latch<'_> {
    /// The machine coordinate of the first impulse that an axis at rest meets in a direction.
    fn next(&mut self, axis: usize, direction: f64) -> f64 {
        let feedback = self.core.until("feedback", |_| true);
        let here = turns(self.ring, axis + 1);
        let forwards = direction * TURNS[axis] > 0.0;
        let phase = PHASES[axis];
        let pulse = if forwards {
            (here - phase).floor() + 1.0
        } else {
            (here - phase).ceil() - 1.0
        } + phase;
        // The position of the feedback is that of a whole increment.
        let shown = (here * RESOLUTION).floor() / RESOLUTION;
        feedback.position[axis] + TURNS[axis] * (pulse - shown)
    }

    /// Asserts that the latched position is that of the impulse.
    fn check(&mut self, axis: usize, expected: f64) {
        let latched = self.core.latched_index();
        let increments = (latched - expected) / TURNS[axis] * RESOLUTION;
        println!("axis {axis}: {increments:.2} increments off");
        // Feedback and motor are read a moment apart: the motor may still creep by one.
        assert!(
            increments.abs() < 2.01,
            "axis {axis}: {latched} instead of {expected}, {increments} increments"
        );
    }
}

fn with_latch(
    edit_more: impl Fn(&mut Network) + Send + Clone + 'static,
    starts: [f64; 4],
    test: impl Fn(&mut Latch<'_>) + Send + Clone + 'static,
) {
    on_bench(devices(starts), move |ring| {
        with_bridge(
            |network| {
                edit(network);
                edit_more(network);
            },
            ring,
            |core, ring, _| {
                core.bring_up();
                core.rest(0.3);
                test(&mut Latch { core, ring });
            },
        );
    });
}

/// From random positions, in both directions, at two speeds, for axes that are inverted and geared, with the
/// counter passing its end.
#[test]
fn the_latched_position_is_the_place_of_the_impulse() {
    unless_disturbed(|| {
        let mut random = Random::new();
        let starts = core::array::from_fn(|_| random.between(-3.0, 3.0));
        let directions: [f64; 6] = core::array::from_fn(|_| {
            if random.bits().is_multiple_of(2) {
                1.0
            } else {
                -1.0
            }
        });
        with_latch(
            |_| {},
            starts,
            move |latch| {
                for (i, velocity) in [5.0, 30.0].into_iter().enumerate() {
                    for axis in 0..3 {
                        let direction = directions[3 * i + axis];
                        latch.core.request_index(axis as u32);
                        let expected = latch.next(axis, direction);
                        latch
                            .core
                            .travel(axis, direction * 1.2 * TURNS[axis].abs(), velocity);
                        latch.check(axis, expected);
                    }
                }
            },
        );
    });
}

/// Another request arms again, also while one is open; one for an axis whose drive does not latch is never
/// accepted, and cancels the latch of the others; 0 requests nothing.
#[test]
fn requests_follow_each_other() {
    unless_disturbed(|| {
        with_latch(
            |network| axis(network, 3).index_probe = None,
            [0.0; 4],
            |latch| {
                latch.core.request_index(0);
                let first = latch.next(0, 1.0);
                latch.core.travel(0, 5.0, 20.0);
                latch.check(0, first);
                latch.core.request_index(0);
                let second = latch.next(0, 1.0);
                assert!((second - first - 5.0).abs() < 1e-3, "a turn further");
                latch.core.travel(0, 5.0, 20.0);
                latch.check(0, second);
                // X is pending when Y is requested: only that of Y counts.
                latch.core.request_index(0);
                latch.core.request_index(1);
                let of_y = latch.next(1, -1.0);
                latch.core.travel(0, 5.0, 20.0);
                let feedback = latch.core.until("feedback", |_| true);
                assert!(
                    feedback.index_position.is_nan(),
                    "the impulse of X is not that of Y"
                );
                latch.core.travel(1, -5.0, 20.0);
                latch.check(1, of_y);
                let taken = latch.core.index.0;
                latch.core.index = (taken + 1, 2);
                latch.core.travel(2, 6.0, 20.0);
                let feedback = latch.core.until("feedback", |_| true);
                assert_eq!(feedback.index_request, taken, "Z latches none");
                latch.core.index = (0, 0);
                latch.core.until("nothing is asked for", |feedback| {
                    (feedback.index_request, feedback.index_position) == (0, 0.0)
                });
                // Two at once: the second one receives the reply.
                latch.core.index = (40, 0);
                latch.core.cycle();
                latch.core.index = (41, 0);
                latch.core.cycle();
                latch.core.request_index(0);
                let last = latch.next(0, -1.0);
                latch.core.travel(0, -5.0, 20.0);
                latch.check(0, last);
            },
        );
    });
}

/// Frames lost while the impulse passes do not lose it, because the drive has latched it.
#[test]
fn an_impulse_during_lost_frames_is_found_afterwards() {
    unless_disturbed(|| {
        with_latch(
            |network| network.max_lost_cycles = 50,
            [0.0; 4],
            |latch| {
                for _ in 0..3 {
                    latch.core.request_index(0);
                    let expected = latch.next(0, 1.0);
                    let mut has_lost = false;
                    latch.core.velocity_x = 10.0;
                    for _ in 0..260 {
                        latch.core.cycle();
                        // Shortly before the impulse.
                        let near = latch.core.position[0] > expected - 0.06;
                        if near && !has_lost {
                            begin(latch.ring, FaultKind::Loss, 0, Some(16_000_000));
                            has_lost = true;
                        }
                    }
                    assert!(has_lost);
                    latch.core.stop();
                    latch.core.rest(0.5);
                    latch.check(0, expected);
                }
            },
        );
    });
}

/// The probe input of X by touch probe 1 and its zero impulse by touch probe 2, at the same time.
#[test]
fn a_touch_probe_works_beside_it() {
    unless_disturbed(|| {
        with_latch(
            |network| axis(network, 1).touch_probe = true,
            [0.1, 0.0, 0.0, 0.0],
            |latch| {
                latch.core.request_index(0);
                let (impulse, here) = (latch.next(0, 1.0), turns(latch.ring, 1));
                let position = latch.core.until("feedback", |_| true).position[0];
                let probe = position + TURNS[0] * (2.1 - here);
                latch.core.travel(0, 12.0, 20.0);
                latch.check(0, impulse);
                let inputs = latch.core.inputs.expect("inputs");
                assert_eq!((inputs.probe_trips, inputs.probe_latched_mask), (1, 0b001));
                assert!(
                    (inputs.probe_position[0] - probe).abs() < 2e-3,
                    "{inputs:?} {probe}"
                );
            },
        );
    });
}

/// An axis at rest in the impulse: this impulse or the next is latched, never another position. An axis that
/// starts just beyond it in the direction of motion finds the next one.
#[test]
fn an_impulse_at_the_start_is_it_or_the_next() {
    unless_disturbed(|| {
        let starts = [PHASES[0] + 0.3 / RESOLUTION, PHASES[1], PHASES[2], PHASES[3]];
        with_latch(
            |_| {},
            starts,
            |latch| {
                latch.core.index = (7, 0);
                latch
                    .core
                    .until("taken over", |feedback| feedback.index_request == 7);
                let here = latch.core.until("feedback", |_| true).position[0];
                latch.core.travel(0, 6.0, 20.0);
                let away = (latch.core.latched_index() - here) / TURNS[0];
                let off = (away - away.round()) * RESOLUTION;
                assert!(
                    (-0.5..1.5).contains(&away) && off.abs() < 2.01,
                    "{away} turns away"
                );
            },
        );
    });
}

/// A drive that does not report an enabled latch, or whose encoder has no impulse.
#[test]
fn without_an_impulse_nothing_is_latched() {
    unless_disturbed(|| {
        with_latch(
            |_| {},
            [0.0; 4],
            |latch| {
                begin(latch.ring, FaultKind::IndexMissing, 1, None);
                latch.core.request_index(0);
                latch.core.travel(0, 12.0, 20.0);
                let feedback = latch.core.until("feedback", |_| true);
                assert!(feedback.index_position.is_nan() && feedback.index_request == latch.core.index.0);
            },
        );
    });
}

/// With the drive's own mapping the objects must be present: 60BAh is, 60BCh is not.
#[test]
fn a_mapping_without_the_object_is_named() {
    unless_disturbed(|| {
        on_bench(devices([0.0; 4]), |ring| {
            with_bridge(
                |network| {
                    edit(network);
                    axis(network, 1).map = false;
                },
                ring,
                |core, _, messages| {
                    for _ in 0..3000 {
                        core.cycle();
                        if messages.contain("60BCh is not in its process data") {
                            return;
                        }
                    }
                    panic!("{messages:?}");
                },
            );
        });
        on_bench(devices([0.0; 4]), |ring| {
            with_bridge(
                |network| {
                    edit(network);
                    let x = axis(network, 1);
                    (x.map, x.index_probe) = (false, Some(ProbeNumber::One));
                },
                ring,
                |core, ring, _| {
                    core.bring_up();
                    core.rest(0.3);
                    let mut latch = Latch { core, ring };
                    latch.core.request_index(0);
                    let expected = latch.next(0, 1.0);
                    latch.core.travel(0, 6.0, 20.0);
                    latch.check(0, expected);
                },
            );
        });
    });
}

//! The velocity offset (60B1h) and the torque offset (60B2h) of moving axes, as they arrive at the drives of
//! the simulated ring.
//!
//! Needs the right to create a network namespace.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use evolvent_bridge_trial::ACCELERATION;
use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat_ring::on_bench;

use crate::support::*;

/// Velocity of the axes at full speed, mm/s, and the distance of a move, mm.
const VELOCITY: f64 = 40.0;
const DISTANCE: f64 = 30.0;
/// Increments per mm of X and Y.
const PER_MM: f64 = 1_048_576.0 / 5.0;
/// Motor and load of both, kg m2, the rated torque, N m, and the lead of the screw, mm.
const INERTIA: f64 = 0.0003;
const RATED: f64 = 2.4;
const LEAD_MM: f64 = 5.0;

/// Values of an object, in order, with their maximum and minimum.
#[derive(Debug, Default)]
struct Extremes {
    values: Vec<i64>,
}

impl Extremes {
    fn ends(&self) -> [i64; 2] {
        let values = || self.values.iter().copied();
        [values().max().unwrap_or(0), values().min().unwrap_or(0)]
    }

    /// Whether values near the maximum come before those near the minimum.
    fn rises_first(&self) -> bool {
        let [max, min] = self.ends();
        let first = |wanted: i64| self.values.iter().position(|value| *value == wanted);
        first(max) < first(min)
    }
}

/// Moves an axis by a distance. Returns the extreme values of 60B1h and 60B2h at its drive.
fn moved(axis: usize, distance: f64) -> [Extremes; 2] {
    on_bench(devices(), move |ring| {
        let mut found = [Extremes::default(), Extremes::default()];
        with_bridge(
            |network| {
                let torque = network.devices[2].axis.expect("Y").torque_per_acceleration;
                network.devices[1]
                    .axis
                    .as_mut()
                    .expect("X")
                    .torque_per_acceleration = torque;
            },
            ring,
            |core, ring, _| {
                core.sends_acceleration = true;
                core.bring_up();
                let stop = AtomicBool::new(false);
                found = std::thread::scope(|scope| {
                    let watching = scope.spawn(|| {
                        let mut extremes = [Extremes::default(), Extremes::default()];
                        while !stop.load(Ordering::Relaxed) {
                            let ring = ring.lock().expect("no panic");
                            let objects = ring.devices()[axis + 1].objects();
                            for (extremes, index) in extremes.iter_mut().zip([0x60B1, 0x60B2]) {
                                extremes.values.push(objects.integer(index, 0));
                            }
                            drop(ring);
                            std::thread::sleep(Duration::from_micros(700));
                        }
                        extremes
                    });
                    core.travel_smoothly(axis, distance, VELOCITY);
                    stop.store(true, Ordering::Relaxed);
                    watching.join().expect("no panic")
                });
            },
        );
        found
    })
    .unwrap_or_default()
}

/// X has the direction of its motor; Y is inverted, so its forward motion is backward for its drive.
#[test]
fn offsets_match_motion_at_drive_in_sign_and_size() {
    // Thousandths of the rated torque at full acceleration: the screw turns by 2 pi per lead.
    let torque = ACCELERATION * 2.0 * core::f64::consts::PI / LEAD_MM * INERTIA / RATED * 1000.0;
    let velocity = VELOCITY * PER_MM;
    for (axis, inverted) in [(0, false), (1, true)] {
        for distance in [DISTANCE, -DISTANCE] {
            unless_disturbed(|| {
                let [speeds, torques] = moved(axis, distance);
                if speeds.values.is_empty() {
                    return;
                }
                let is_forward = (distance > 0.0) != inverted;
                let [max, min] = speeds.ends();
                let what = format!(
                    "axis {axis}, {distance} mm: velocity {max} to {min}, torque {:?}",
                    torques.ends()
                );
                println!("{what}");
                let (along, against) = if is_forward { (max, -min) } else { (-min, max) };
                assert!(
                    (along as f64 / velocity - 1.0).abs() < 0.02,
                    "{what}, expected {velocity}"
                );
                assert!(
                    (against as f64) < 0.02 * velocity,
                    "it does not turn back: {what}"
                );
                // It accelerates in the direction of motion first, and then brakes.
                let [max, min] = torques.ends();
                for found in [max, -min] {
                    assert!(
                        (found as f64 / torque - 1.0).abs() < 0.05,
                        "{what}, expected {torque}"
                    );
                }
                assert_eq!(torques.rises_first(), is_forward, "{what}");
            });
        }
    }
}

//! Braking: within the limits, to rest, in the minimum time.

use evolvent_drive::{Brake, BrakeState};
use evolvent_random::Random;

fn cases() -> usize {
    std::env::var("EVOLVENT_CASES")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(20_000)
}

#[test]
fn every_brake_keeps_its_limits_and_ends_at_rest() {
    let mut random = Random::new();
    for _ in 0..cases() {
        let (limit, jerk) = (random.between(10.0, 20_000.0), random.between(100.0, 1e6));
        let start = BrakeState {
            position: random.between(-1e3, 1e3),
            velocity: random.between(-1e3, 1e3),
            acceleration: random.between(-1.0, 1.0) * limit,
        };
        let brake = Brake::new(start, limit, jerk);
        let (end, n) = (brake.duration_s(), 64);
        let mut before = brake.at(0.0);
        assert_eq!(before, start);
        for i in 1..=n {
            let now = brake.at(end * f64::from(i) / f64::from(n));
            let dt = end / f64::from(n);
            assert!(
                now.acceleration.abs() <= limit * (1.0 + 1e-9),
                "{start:?} {now:?}"
            );
            let jump = (now.acceleration - before.acceleration).abs();
            assert!(jump <= jerk * dt * (1.0 + 1e-9) + 1e-6, "{start:?}");
            before = now;
        }
        // Just before the end only rounding is left: the end is not forced.
        let almost = brake.at(end * (1.0 - 1e-9));
        assert!(
            almost.velocity.abs() < 1e-4 * (1.0 + start.velocity.abs()),
            "{start:?} {almost:?}"
        );
        assert!(
            almost.acceleration.abs() < 1e-4 * limit + jerk * end * 1e-8,
            "{start:?} {almost:?}"
        );
        assert_eq!(brake.at(end * 2.0 + 1.0).velocity, 0.0);
    }
}

/// With an almost unlimited jerk the distance is v^2 / 2a; with an unlimited acceleration the time is 2
/// sqrt(v / j).
#[test]
fn distances_and_times_are_those_of_the_textbook() {
    let start = BrakeState {
        position: 0.0,
        velocity: 500.0,
        acceleration: 0.0,
    };
    let brake = Brake::new(start, 5000.0, 1e12);
    assert!((brake.at(10.0).position - 500.0 * 500.0 / 10_000.0).abs() < 1e-3);
    let brake = Brake::new(start, 1e9, 200_000.0);
    assert!((brake.duration_s() - 2.0 * (500.0_f64 / 200_000.0).sqrt()).abs() < 1e-12);
    // Symmetric in time: the mean velocity is half the first.
    assert!((brake.at(10.0).position - 250.0 * brake.duration_s()).abs() < 1e-9);
}

#[test]
fn self_stopping_motion_only_removes_acceleration() {
    let jerk = 1000.0;
    let start = BrakeState {
        position: 1.0,
        velocity: 0.5 * 100.0 * 100.0 / jerk,
        acceleration: -100.0,
    };
    let brake = Brake::new(start, 200.0, jerk);
    assert!((brake.duration_s() - 0.1).abs() < 1e-9, "{brake:?}");
}

#[test]
fn nonsense_stands_still() {
    for (velocity, limit, jerk) in [(f64::NAN, 1.0, 1.0), (1.0, 0.0, 1.0), (1.0, 1.0, f64::INFINITY)] {
        let start = BrakeState {
            position: 4.0,
            velocity,
            acceleration: 0.0,
        };
        let brake = Brake::new(start, limit, jerk);
        assert_eq!(
            (brake.duration_s(), brake.at(0.1).position, brake.at(0.1).velocity),
            (0.0, 4.0, 0.0)
        );
    }
}

/// The acceleration already exceeds the limit: it is reduced together with the velocity, and both reach zero
/// together.
#[test]
fn brake_from_beyond_its_limit_still_ends_at_rest() {
    for velocity in [0.7, 10.0, -0.7, -10.0_f64] {
        let start = BrakeState {
            position: 0.0,
            velocity,
            acceleration: -8.0 * velocity.signum(),
        };
        let brake = Brake::new(start, 5.0, 50.0);
        let end = brake.at(brake.duration_s() * (1.0 - 1e-9));
        assert!(
            end.velocity.abs() < 1e-6 && end.acceleration.abs() < 1e-6,
            "{end:?}"
        );
    }
}

//! Random limits and states.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "each test uses its part of it, may fail, and tells its seed"
)]

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes};
pub use evolvent_random::Random;
use evolvent_transfer::AxesState;

pub fn sign(random: &mut Random) -> f64 {
    if random.unit() < 0.5 { -1.0 } else { 1.0 }
}

/// Seed and number of cases; the environment may set both.
pub fn campaign(seed: u64, cases: usize) -> (Random, usize) {
    (
        Random::from_state(evolvent_random::seed(seed)),
        evolvent_random::cases(cases),
    )
}

/// Limits over four decades, different for every axis.
pub fn limits(random: &mut Random, axes: usize) -> Limits {
    let mut limits = Limits {
        present: [false; AXES],
        velocity: Axes::zeros(),
        acceleration: Axes::zeros(),
        jerk: Axes::zeros(),
        travel_min: Axes::repeat(-1e7),
        travel_max: Axes::repeat(1e7),
        home: Axes::zeros(),
    };
    for i in 0..axes {
        limits.present[i] = true;
        limits.velocity[i] = random.log(5.0, 2000.0);
        limits.acceleration[i] = random.log(50.0, 50_000.0);
        limits.jerk[i] = random.log(500.0, 5e6);
    }
    limits
}

/// A state from which, or to which, the limits can be kept.
pub fn state(random: &mut Random, limits: &Limits, from: &Axes, rest: f64) -> AxesState {
    let mut state = AxesState::at_rest(*from);
    for i in (0..AXES).filter(|&i| limits.present[i]) {
        if random.unit() < 0.8 {
            state.position[i] += sign(random) * random.log(1e-4, 500.0);
        }
        if random.unit() < rest {
            continue;
        }
        let (v, a, j) = (limits.velocity[i], limits.acceleration[i], limits.jerk[i]);
        // A jog moves at its speed limit most of the time.
        if random.unit() < 0.15 {
            state.velocity[i] = sign(random) * v;
            continue;
        }
        state.acceleration[i] = sign(random) * random.unit() * a.min((v * j).sqrt());
        let spent = state.acceleration[i] * state.acceleration[i] / (2.0 * j);
        state.velocity[i] = sign(random) * random.unit() * (v - spent).max(0.0);
    }
    state
}

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
use evolvent_transfer::AxesState;

#[derive(Clone, Copy)]
pub struct Random(pub u64);

impl Random {
    pub fn unit(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn log(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.unit())
    }

    pub fn sign(&mut self) -> f64 {
        if self.unit() < 0.5 { -1.0 } else { 1.0 }
    }
}

/// Seed and number of cases; both may be given in the environment.
pub fn campaign(seed: u64, cases: usize) -> (Random, usize) {
    let number = |name: &str| std::env::var(name).ok();
    let seed = number("EVOLVENT_SEED").map_or(seed, |text| {
        text.strip_prefix("0x").map_or_else(
            || text.parse().unwrap(),
            |hex| u64::from_str_radix(hex, 16).unwrap(),
        )
    });
    let cases = number("EVOLVENT_CASES").map_or(cases, |text| text.parse().unwrap());
    println!("EVOLVENT_SEED={seed:#x} EVOLVENT_CASES={cases}");
    (Random(seed), cases)
}

/// Limits over four decades, unlike on every axis.
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
            state.position[i] += random.sign() * random.log(1e-4, 500.0);
        }
        if random.unit() < rest {
            continue;
        }
        let (v, a, j) = (limits.velocity[i], limits.acceleration[i], limits.jerk[i]);
        // A cruise at the limit is what a jog is most of its time.
        if random.unit() < 0.15 {
            state.velocity[i] = random.sign() * v;
            continue;
        }
        state.acceleration[i] = random.sign() * random.unit() * a.min((v * j).sqrt());
        let spent = state.acceleration[i] * state.acceleration[i] / (2.0 * j);
        state.velocity[i] = random.sign() * random.unit() * (v - spent).max(0.0);
    }
    state
}

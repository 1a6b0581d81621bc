//! Holds at random moments of a program, with the plan ahead of each, as JSON lines for `shortest_stop.py` in
//! the same folder.
//!
//! `cargo run --release -p evolvent-runtime --example holds -- PROGRAM MACHINE RATE COUNT SEED`. In every
//! third hold the planner stops working from the hold until the machine is at rest.

#![allow(
    clippy::print_stdout,
    clippy::expect_used,
    clippy::panic,
    reason = "an example prints, and ends where it cannot be set up"
)]

use std::path::Path;

use evolvent_motion::{MotionState, Setpoint};
use evolvent_path::Axes;
use evolvent_random::Random;
use evolvent_runtime::Setup;

use driven::{Driven, set_up};

#[path = "../tests/common/driven.rs"]
mod driven;

/// Time between two samples of the plan.
const SAMPLE_NS: u64 = 100_000;
/// Length of the plan that is written, in addition to the duration of the hold.
const BEYOND_S: f64 = 0.05;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [program, machine, rate, count, seed] = words.as_slice() else {
        panic!("give PROGRAM MACHINE RATE COUNT SEED");
    };
    let rate_hz: f64 = rate.parse().expect("a rate in Hz");
    let setup = set_up(Path::new(machine), rate_hz);
    let program = Path::new(program);
    let samples = Driven::new(program, &setup, SAMPLE_NS).whole();
    let plain = Driven::new(program, &setup, setup.period_ns).whole();
    let moving: Vec<usize> = (1..plain.len())
        .filter(|&k| plain[k - 1].feed_mm_s > 0.0 && plain[k - 1].state == MotionState::Running)
        .collect();
    let mut random = Random::from_state(seed.parse().expect("a seed"));
    for number in 0..count.parse().expect("a number of holds") {
        let moment = moving[random.below(moving.len())];
        let is_frozen = number % 3 == 0;
        let held = Driven::new(program, &setup, setup.period_ns).held(moment, is_frozen);
        print!(
            "{{\"program\":{program:?},\"machine\":{machine:?},\"rate_hz\":{rate_hz},\"is_frozen\":{is_frozen},"
        );
        write(&setup, &samples, &held, moment);
    }
}

/// Writes the rest of a line: limits, the plan from the hold on, and the motion from the setpoint before the
/// hold until rest.
fn write(setup: &Setup, samples: &[Setpoint], held: &[Setpoint], moment: usize) {
    let limits = setup.machine.limits();
    let period_s = setup.period_ns as f64 * 1e-9;
    let sample_s = SAMPLE_NS as f64 * 1e-9;
    let took_s = (held.len() - moment) as f64 * period_s;
    let from = &held[moment - 1];
    // Both rates begin with the same rest, so the sample at the same path length is near.
    let guess = (moment as f64 * period_s / sample_s) as usize;
    let near = guess.saturating_sub(60).min(samples.len() - 1)..(guess + 60).min(samples.len());
    let off = |k: &usize| (samples[*k].path_mm - from.path_mm).abs();
    let begin = near.min_by(|a, b| off(a).total_cmp(&off(b))).expect("a sample");
    let end = (begin + ((took_s + BEYOND_S) / sample_s) as usize).min(samples.len());
    let rows = |setpoints: &[Setpoint], of: fn(&Setpoint) -> Axes| -> String {
        let rows: Vec<String> = setpoints
            .iter()
            .map(|setpoint| format!("{:?}", &of(setpoint).as_slice()[..3]))
            .collect();
        format!("[{}]", rows.join(","))
    };
    let (plan, motion) = (&samples[begin..end], &held[moment - 1..]);
    println!(
        "\"line\":{},\"moment\":{moment},\"feed_mm_s\":{},\"took_s\":{took_s},\"period_s\":{period_s},\"sample_s\":{sample_s},\"acceleration\":{:?},\"jerk\":{:?},\"v\":{},\"a\":{},\"j\":{},\"driven_v\":{},\"driven_a\":{}}}",
        from.line,
        from.feed_mm_s,
        &limits.acceleration.as_slice()[..3],
        &limits.jerk.as_slice()[..3],
        rows(plan, |setpoint| setpoint.velocity),
        rows(plan, |setpoint| setpoint.acceleration),
        rows(plan, |setpoint| setpoint.jerk),
        rows(motion, |setpoint| setpoint.velocity),
        rows(motion, |setpoint| setpoint.acceleration),
    );
}

//! A lower bound of the time for exactly known stock, by dynamic programming, and how near the strategies
//! come that have to feel the stock.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may fail, and prints its table"
)]

use evolvent_turning::{Blank, Simulation, TurningSettings, run_fixed_at_load};

use crate::common::{
    SET, TURN_S, law,
    open::{fast, safe},
    sensor,
};

/// Grid of heights, mm: coarser than the cells of the stock, and rounded down.
const HEIGHT_MM: f64 = 0.1;
const POSITIONS: usize = 400;
const MAX_PASSES: usize = 12;

/// `min[m][k]`: the minimum time per mm of path, s, to remove `k` steps of height in at most `m` cuts at
/// the set load, including the return in rapid.
fn removal(hardness: f64, steps: usize, settings: &TurningSettings) -> Vec<Vec<f64>> {
    let law = law();
    let cut = |k: usize| {
        let depth = HEIGHT_MM * k as f64;
        let feed = (SET / (law.coefficient * hardness * depth.powf(law.depth_exponent)))
            .powf(1.0 / law.feed_exponent)
            .min(0.7);
        // Below the smallest feed chips do not break.
        let speed = if feed < 0.2 { 0.0 } else { feed / TURN_S };
        1.0 / speed + 1.0 / settings.rapid_mm_s
    };
    let mut min = vec![vec![f64::INFINITY; steps + 1]; MAX_PASSES + 1];
    min[0][0] = 0.0;
    for m in 1..=MAX_PASSES {
        for k in 0..=steps {
            let more = (1..=k).map(|by| min[m - 1][k - by] + cut(by));
            min[m][k] = more.fold(min[m - 1][k], f64::min);
        }
    }
    min
}

/// The same if gaps have to be crossed at a feed at every height, because only the tool's own passes reveal
/// them.
fn blind_bound_s(blank: &Blank, settings: &TurningSettings) -> f64 {
    let filled = Blank {
        grooves_mm: Vec::new(),
        ..blank.clone()
    };
    bound_s(&filled, settings).0
}

/// Minimum time of any job on a blank: in at most `n` passes, each position in the best number of them. A
/// pass costs its moves out and in, and a revolution at its end. Shoulders, run-ups and ramps cost nothing
/// here, so every job takes longer.
fn bound_s(blank: &Blank, settings: &TurningSettings) -> (f64, usize) {
    let length = settings.length_mm;
    let overhead = TURN_S + 2.0 * settings.clear_out_mm / settings.out_speed_mm_s;
    let step = length / POSITIONS as f64;
    let mut tables: Vec<(f64, Vec<Vec<f64>>)> = Vec::new();
    let mut times = [0.0; MAX_PASSES + 1];
    for position in 0..POSITIONS {
        let at = (position as f64 + 0.5) * step;
        let (height, hardness) = (blank.height_mm(at), blank.hardness(at));
        let known = tables.iter().position(|(other, _)| *other == hardness);
        let known = known.unwrap_or_else(|| {
            tables.push((hardness, removal(hardness, (12.0 / HEIGHT_MM) as usize, settings)));
            tables.len() - 1
        });
        let k = (height / HEIGHT_MM + 1e-9) as usize;
        for (n, time) in times.iter_mut().enumerate() {
            *time += step * tables[known].1[n][k];
        }
    }
    let all = times
        .iter()
        .enumerate()
        .map(|(n, time)| (time + n as f64 * overhead, n));
    all.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
}

fn stocks() -> Vec<(&'static str, Blank)> {
    let mut all = crate::common::stocks().to_vec();
    all.push(("uniform 3", Blank::uniform(3.0)));
    all.push(("uniform 10", Blank::uniform(10.0)));
    all.push(("taper 5 to 10", Blank::outline(&[(0.0, 5.0), (200.0, 10.0)])));
    all.push((
        "4, then 8",
        Blank::outline(&[(0.0, 4.0), (100.0, 4.0), (100.0, 8.0), (200.0, 8.0)]),
    ));
    all.push((
        "8, then 3",
        Blank::outline(&[(0.0, 8.0), (100.0, 8.0), (100.0, 3.0), (200.0, 3.0)]),
    ));
    all
}

#[test]
fn no_strategy_beats_the_bound_and_safe_comes_near() {
    for (name, blank) in stocks() {
        let (bound, passes) = bound_s(&blank, &safe());
        let run = |settings: TurningSettings| {
            let mut sim = Simulation::new(settings, blank.clone(), law(), sensor(0)).unwrap();
            sim.run(3000.0, |_, _| {}).0
        };
        let (safe_job, fast_job) = (run(safe()), run(fast()));
        let regime = safe().regime;
        let same = run_fixed_at_load(
            &safe(),
            &blank,
            law(),
            (regime.depth_back_off_mm, regime.feed_back_off_mm_rev),
            SET,
        );
        println!(
            "| {name} | {:.1} | {:.1} | {:.1} ({}) | {:.1} ({}) | {bound:.1} ({passes}) | {:.0} % | {:.0} % \
             |",
            same.time_s,
            same.peak / SET,
            safe_job.time_s,
            safe_job.passes,
            fast_job.time_s,
            fast_job.passes,
            100.0 * (1.0 - safe_job.time_s / same.time_s),
            100.0 * (1.0 - bound / same.time_s)
        );
        println!("    gaps not known: {:.1} s", blind_bound_s(&blank, &safe()));
        // The strategies gain less than this by loads above the set one.
        assert!(
            safe_job.time_s > 0.97 * bound && fast_job.time_s > 0.97 * bound,
            "{name}"
        );
        // If the stock is unknown, a taper shows its height only at the end of the first pass.
        let above = safe_job.time_s / blind_bound_s(&blank, &safe());
        let max = if name.starts_with("taper") { 1.18 } else { 1.165 };
        assert!(above < max, "{name}: {above}");
        assert!(safe_job.peak < 1.3 * SET, "{name}: {}", safe_job.peak / SET);
    }
}

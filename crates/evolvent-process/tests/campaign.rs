//! Self-programmed turning of the reference stocks and of random ones, against the figures published with the cases.
#![allow(clippy::unwrap_used, reason = "a test may fail")]

mod common;

use common::{
    Limits, Random, SET, TURN_S, cases, fast, law, literal, random_stock, regime, safe, sensor, stocks, tool,
};
use evolvent_process::{
    BackOff, Blank, Figures, FixedPasses, OnThin, Simulation, Strategy, TurningSettings, Workpiece, run_fixed,
};

fn turn(settings: TurningSettings, blank: &Blank, seed: u64) -> Figures {
    let mut limits = Limits::new(&settings);
    let mut simulation = Simulation::new(settings, blank.clone(), law(), sensor(seed)).unwrap();
    let mut log = String::new();
    let (figures, _) = simulation.run(3000.0, |output, _| {
        limits.see(output);
        if let Some(transition) = output.transition {
            log += &format!("{transition:?}\n");
        }
    });
    assert!(figures.done, "{blank:?}\n{log}");
    figures
}

fn fixed(blank: &Blank, depth: f64, feed: f64) -> Figures {
    let steps = TURN_S / common::PERIOD_S;
    let piece = Workpiece::new(blank.clone(), 200.0, law(), tool(), steps);
    run_fixed(
        FixedPasses::new(&safe(), blank.highest_mm(200.0), depth, feed),
        piece,
        SET,
    )
}

/// G82 at the same load: the depth and feed of equation (4).
fn same_load(blank: &Blank) -> Figures {
    let regime = regime(BackOff::Balanced);
    fixed(blank, regime.depth_back_off_mm, regime.feed_back_off_mm_rev)
}

/// G82 for stock that is known exactly: equal passes in the number that takes the least time.
fn known(blank: &Blank) -> Figures {
    let regime = regime(BackOff::Balanced);
    let height = blank.highest_mm(200.0);
    (1..=9)
        .map(|passes| height / f64::from(passes))
        .filter(|depth| *depth <= regime.depth_max_mm)
        .map(|depth| fixed(blank, depth, regime.feed_mm_rev(depth)))
        .min_by(|a, b| a.time_s.total_cmp(&b.time_s))
        .unwrap()
}

#[test]
fn fixed_passes_take_the_published_times() {
    // (same load, stock known, 70 % feed), s.
    let published = [
        (200.7031, 156.9001, 283.1731),
        (267.6041, 196.1252, 377.5641),
        (200.7031, 156.9001, 283.1731),
        (200.7031, 142.6411, 283.1731),
    ];
    let regime = regime(BackOff::Balanced);
    for ((name, blank), published) in stocks().into_iter().zip(published) {
        let slow = fixed(
            &blank,
            regime.depth_back_off_mm,
            0.7 * regime.feed_back_off_mm_rev,
        );
        for (what, time, published) in [
            ("same load", same_load(&blank).time_s, published.0),
            ("known", known(&blank).time_s, published.1),
            ("70 %", slow.time_s, published.2),
        ] {
            assert!(
                (time / published - 1.0).abs() < 0.015,
                "{name}, {what}: {time} for {published}"
            );
        }
    }
}

#[test]
fn the_literal_strategy_takes_the_published_time_and_overloads_as_published() {
    // Time in s and peak over the set load.
    let published = [
        (188.0854, 1.7126),
        (173.6573, 1.9756),
        (162.2656, 1.7126),
        (174.3655, 1.8762),
    ];
    for ((name, blank), (time, peak)) in stocks().into_iter().zip(published) {
        let figures = turn(literal(), &blank, 0);
        // The published simulation switches feeds within 15 ms and knows no acceleration.
        assert!(
            (figures.time_s / time - 1.0).abs() < 0.07,
            "{name}: {} for {time}",
            figures.time_s
        );
        let own = figures.peak / SET;
        assert!(own > 1.5 && own < peak * 1.05, "{name}: {own} for {peak}");
    }
}

#[test]
fn the_safe_strategy_is_as_fast_as_published_and_peaks_lower() {
    let published = [
        (190.3039, 1.2798),
        (181.1624, 1.2816),
        (169.6459, 1.3161),
        (179.3231, 1.3625),
    ];
    for ((name, blank), (time, peak)) in stocks().into_iter().zip(published) {
        let figures = turn(safe(), &blank, 0);
        assert!(
            figures.time_s < time * 1.01,
            "{name}: {} for {time}",
            figures.time_s
        );
        assert!(
            figures.peak / SET < peak * 1.02,
            "{name}: {} for {peak}",
            figures.peak / SET
        );
        assert!(
            figures.over_130_s <= TURN_S && figures.residual_mm <= 0.1,
            "{name}: {figures:?}"
        );
        let ideal = regime(BackOff::Balanced).passes(blank.highest_mm(200.0));
        assert!(figures.passes <= ideal + 2, "{name}: {figures:?}");
    }
}

#[test]
fn a_slow_sensor_costs_peaks_but_no_size() {
    for (name, blank) in stocks() {
        let settings = TurningSettings {
            sensor_lag_s: 0.1,
            thin_mm: 6.0,
            confirm_s: 0.2,
            overload: 9000.0,
            ..safe()
        };
        let slow = evolvent_process::SensorModel {
            lag_s: 0.1,
            ..sensor(0)
        };
        let mut simulation = Simulation::new(settings, blank.clone(), law(), slow).unwrap();
        let (figures, _) = simulation.run(3000.0, |_, _| {});
        assert!(figures.done && figures.residual_mm <= 0.1, "{name}: {figures:?}");
        // Published: 1.785 to 1.797.
        assert!(figures.peak / SET < 2.05, "{name}: {}", figures.peak / SET);
    }
}

#[test]
fn random_stocks_come_to_size_within_the_load_and_in_few_passes() {
    let mut random = Random::new(7);
    let (mut safe_s, mut fast_s, mut same_s, mut known_s) = (0.0, 0.0, 0.0, 0.0);
    let continuing = TurningSettings {
        strategy: Strategy {
            on_thin: OnThin::Continue,
            ..safe().strategy
        },
        ..safe()
    };
    let count = cases(5);
    for case in 0..count {
        let blank = random_stock(&mut random);
        let ideal = regime(BackOff::Balanced).passes(blank.highest_mm(200.0));
        for (which, settings) in [("safe", safe()), ("continuing", continuing), ("fast", fast())] {
            let figures = turn(settings, &blank, case as u64);
            let what = format!("case {case}, {which}, ideal {ideal}: {figures:?} of {blank:?}");
            assert!(figures.residual_mm <= 0.1 && figures.undercut_mm < 1e-9, "{what}");
            assert!(figures.over_130_s <= TURN_S, "{what}");
            match which {
                "safe" => safe_s += figures.time_s,
                "fast" => fast_s += figures.time_s,
                _ => assert!(figures.passes <= ideal + 2, "{what}"),
            }
        }
        same_s += same_load(&blank).time_s;
        known_s += known(&blank).time_s;
    }
    println!(
        "{count} stocks: safe {safe_s:.0} s, fast {fast_s:.0} s, G82 same load {same_s:.0} s, G82 known {known_s:.0} s"
    );
    assert!(safe_s < 0.79 * same_s, "{safe_s} against {same_s}");
    assert!(fast_s < known_s, "{fast_s} against {known_s}");
}

#[test]
fn the_same_inputs_give_the_same_bits() {
    let run = || {
        let mut bits = 0_u64;
        let mut simulation = Simulation::new(fast(), stocks()[1].1.clone(), law(), sensor(3)).unwrap();
        simulation.run(60.0, |output, _| {
            let [a, b] = [output.along.position.to_bits(), output.out.position.to_bits()];
            bits = bits.rotate_left(7) ^ a ^ b.rotate_left(32);
        });
        bits
    };
    assert_eq!(run(), run());
}

//! Adaptive feed on the simulated process: fast and slow sensors, delayed sensors, noise.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::collections::VecDeque;

use evolvent_turning::{AdaptiveFeed, AdaptiveSettings, Blank, CutPhase, Sensor, SensorModel, Workpiece};

use crate::common::{PERIOD_S, SET, TURN_S, law, tool};

/// The programmed feed, mm/rev.
const FEED: f64 = 0.4;
/// Lag of first order and dead time of sensors, s.
const SENSORS: [(f64, f64); 8] = [
    (0.005, 0.0),
    (0.01, 0.0),
    (0.03, 0.0),
    (0.1, 0.0),
    (0.3, 0.0),
    (0.0, 0.03),
    (0.0, 0.1),
    (0.05, 0.05),
];

fn settings(lag_s: f64) -> AdaptiveSettings {
    AdaptiveSettings {
        overload: 4.0 * SET,
        lag_s,
        ..AdaptiveSettings::usual(SET, TURN_S, PERIOD_S)
    }
}

/// Loads over the set one.
#[derive(Clone, Copy, Debug, Default)]
struct LoadRatios {
    peak: f64,
    /// Longest time above 1.3, s.
    over_130_s: f64,
    /// Minimum, maximum and mean of the last 30 mm, where the cut is even or nearly so.
    min: f64,
    max: f64,
    mean: f64,
}

/// One cycle of a pass.
#[derive(Clone, Copy, Debug)]
struct Moment {
    position: f64,
    load: f64,
    factor: f64,
}

/// A pass at the final size over a stock of 120 mm, up to 117: at the programmed feed, or at a feed adapted
/// to the load.
fn drive(
    blank: Blank,
    adaptive: Option<AdaptiveSettings>,
    (lag_s, dead_s): (f64, f64),
    noise: f64,
    mut observe: impl FnMut(Moment),
) {
    let mut piece = Workpiece::new(blank, 120.0, law(), tool(), TURN_S / PERIOD_S);
    let model = SensorModel {
        lag_s,
        noise,
        range_max: 20_000.0,
        seed: 1,
    };
    let mut sensor = Sensor::new(model, PERIOD_S);
    let mut feed = adaptive.map(|settings| AdaptiveFeed::new(settings).unwrap());
    let mut late: VecDeque<f64> = vec![0.0; (dead_s / PERIOD_S).round() as usize].into();
    let mut now = Moment {
        position: -4.0,
        load: 0.0,
        factor: 1.0,
    };
    for _ in 0..300_000 {
        late.push_back(now.load);
        let sample = sensor.read(late.pop_front().unwrap(), None);
        if let Some(feed) = &mut feed {
            let output = feed.step(sample, now.factor, CutPhase::Feed);
            assert_eq!(output.stop, None);
            now.factor = output.factor;
        }
        now.position += now.factor * FEED / TURN_S * PERIOD_S;
        now.load = piece.step(now.position, 0.0).load;
        observe(now);
        if now.position > 117.0 {
            return;
        }
    }
    panic!("it does not end: {now:?}");
}

/// Loads of a pass.
fn pass(blank: Blank, settings: AdaptiveSettings, sensor: (f64, f64), noise: f64) -> LoadRatios {
    let (mut above, mut sum, mut count) = (0.0, 0.0, 0.0);
    let mut ratios = LoadRatios {
        min: f64::INFINITY,
        ..LoadRatios::default()
    };
    drive(blank, Some(settings), sensor, noise, |now| {
        let fraction = now.load / SET;
        ratios.peak = ratios.peak.max(fraction);
        above = if fraction > 1.3 { above + PERIOD_S } else { 0.0 };
        ratios.over_130_s = ratios.over_130_s.max(above);
        if now.position > 90.0 {
            (ratios.min, ratios.max) = (ratios.min.min(fraction), ratios.max.max(fraction));
            (sum, count) = (sum + fraction, count + 1.0);
        }
    });
    ratios.mean = sum / count;
    ratios
}

fn blanks() -> [(&'static str, Blank); 5] {
    let outline = Blank::outline;
    [
        ("taper", outline(&[(0.0, 1.5), (120.0, 5.0)])),
        ("even", Blank::uniform(4.5)),
        (
            "step",
            outline(&[(0.0, 2.0), (60.0, 2.0), (60.0, 4.5), (120.0, 4.5)]),
        ),
        (
            "steps",
            outline(&[
                (0.0, 3.0),
                (30.0, 3.0),
                (30.0, 4.0),
                (60.0, 4.0),
                (60.0, 2.0),
                (80.0, 2.0),
                (80.0, 4.5),
                (120.0, 4.5),
            ]),
        ),
        (
            "groove",
            Blank {
                grooves_mm: vec![(30.0, 50.0, 0.0)],
                ..Blank::uniform(4.0)
            },
        ),
    ]
}

#[test]
fn the_load_is_held_with_slow_and_noisy_sensors() {
    for (lag_s, dead_s) in SENSORS {
        for noise in [0.0, 0.02, 0.05] {
            for (name, blank) in blanks() {
                let ratios = pass(blank, settings(lag_s + dead_s), (lag_s, dead_s), noise);
                let what = format!("{name}, lag {lag_s}, late by {dead_s}, noise {noise}: {ratios:?}");
                // The feed must not oscillate: a sensor that lags shows the load at an earlier feed. Noise
                // that looks like growth lowers the feed, more so with a longer extrapolation.
                let dips = noise * (1.0 + (lag_s + dead_s) / TURN_S);
                assert!(ratios.min > 0.97 - dips && ratios.max < 1.02 + noise, "{what}");
                assert!((ratios.mean - 1.0).abs() < 0.01 + 0.5 * noise, "{what}");
                // A sensor that is slow relative to a revolution shows a step of the stock late.
                let max = if lag_s + dead_s > 0.25 * TURN_S {
                    TURN_S
                } else {
                    0.0
                };
                assert!(ratios.over_130_s <= max, "{what}");
            }
        }
    }
}

#[test]
fn a_wrong_lag_keeps_the_load_bounded() {
    for (true_s, configured_s) in [(0.1, 0.05), (0.05, 0.1), (0.02, 0.01), (0.01, 0.02)] {
        for (name, blank) in blanks() {
            let ratios = pass(blank, settings(configured_s), (true_s, 0.0), 0.02);
            let what = format!("{name}, {true_s} for {configured_s}: {ratios:?}");
            assert!(ratios.over_130_s <= TURN_S, "{what}");
            assert!(ratios.min > 0.9 && ratios.max < 1.1, "{what}");
        }
    }
}

#[test]
fn a_fixed_feed_does_not_hold_the_load_on_a_taper() {
    let mut peak = 0.0;
    let blank = Blank::outline(&[(0.0, 1.5), (120.0, 5.0)]);
    drive(blank, None, (0.01, 0.0), 0.02, |now| {
        peak = f64::max(peak, now.load);
    });
    assert!(peak > 1.6 * SET, "{peak}");
}

#[test]
fn factors_stay_within_their_limits_and_slew_rates() {
    let blank = Blank {
        grooves_mm: vec![(30.0, 50.0, 0.0)],
        ..Blank::outline(&[(0.0, 2.0), (70.0, 2.0), (70.0, 4.5), (120.0, 0.4)])
    };
    let (mut before, mut left) = (None, false);
    drive(blank, Some(settings(0.01)), (0.01, 0.0), 0.02, |now| {
        let change = (now.factor - before.unwrap_or(now.factor)) / PERIOD_S;
        assert!((-100.0 - 1e-9..=2.0 + 1e-9).contains(&change), "{change} per s");
        assert!((0.2..=1.5).contains(&now.factor));
        before = Some(now.factor);
        // Nothing is cut in the groove, but the load does not show that stock ends there.
        let in_groove = now.position > 40.0 && now.position < 48.0;
        assert!(!in_groove || now.factor <= 0.8, "{now:?}");
        left |= in_groove && now.factor >= 0.5;
    });
    assert!(left);
}

#[test]
fn invalid_lags_and_edge_counts_are_rejected() {
    assert!(AdaptiveFeed::new(settings(-0.1)).is_err());
    assert!(AdaptiveFeed::new(settings(f64::NAN)).is_err());
    let error = AdaptiveFeed::new(settings(1.5)).unwrap_err();
    assert!(error.to_string().contains("lag of the sensor"), "{error}");
    let none = AdaptiveSettings {
        edges: 0,
        ..settings(0.01)
    };
    assert!(AdaptiveFeed::new(none).is_err());
}

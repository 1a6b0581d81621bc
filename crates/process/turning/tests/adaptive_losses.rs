//! Adaptive feed when the load goes away in a cut: a broken insert, or a sensor that reads zero.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may fail, and prints its figures"
)]

use evolvent_machine::LoadSample;
use evolvent_turning::{AdaptiveFeed, AdaptiveSettings, Blank, CutPhase, Sensor, SensorModel, Workpiece};

use crate::common::{PERIOD_S, Random, SET, TURN_S, cases, law, random_rough_stock, random_stock, tool};

/// The programmed feed, mm/rev.
const FEED: f64 = 0.4;
const LENGTH_MM: f64 = 120.0;
/// Cycles of a revolution.
const TURN: usize = 60;
/// Cycles after which sensor and smoothing show a load: three time constants of each.
const SHOWN: usize = 21;

fn settings() -> AdaptiveSettings {
    AdaptiveSettings {
        overload: 4.0 * SET,
        ..AdaptiveSettings::usual(SET, TURN_S, PERIOD_S)
    }
}

/// What becomes of the load.
#[derive(Clone, Copy, Debug)]
enum Loss {
    /// The sensor reads zero.
    Zero,
    /// Readings fall to zero within this time, s.
    Decays(f64),
    /// The insert breaks: the sensor shows zero with its lag.
    Breaks,
}

/// A pass at the final size of the stock.
#[derive(Clone)]
struct Pass {
    piece: Workpiece,
    feed: AdaptiveFeed,
    sensor: Sensor,
    position: f64,
    load: f64,
    depth: f64,
    factor: f64,
    in_air: bool,
    time_s: f64,
}

impl Pass {
    fn new(blank: Blank, settings: AdaptiveSettings, noise: f64) -> Self {
        let model = SensorModel {
            lag_s: 0.01,
            noise,
            range_max: 20_000.0,
            seed: 1,
        };
        Self {
            piece: Workpiece::new(blank, LENGTH_MM, law(), tool(), TURN_S / PERIOD_S),
            feed: AdaptiveFeed::new(settings).unwrap(),
            sensor: Sensor::new(model, PERIOD_S),
            position: -4.0,
            load: 0.0,
            depth: 0.0,
            factor: 1.0,
            in_air: true,
            time_s: 0.0,
        }
    }

    /// One cycle, `since_s` after the load was lost.
    fn step(&mut self, lost: Option<(Loss, f64)>) {
        let load = match lost {
            Some((Loss::Breaks, _)) => 0.0,
            _ => self.load,
        };
        let left = match lost {
            Some((Loss::Zero, _)) => 0.0,
            Some((Loss::Decays(within_s), since_s)) => (1.0 - since_s / within_s).max(0.0),
            _ => 1.0,
        };
        let sample = self.sensor.read(load, None).map(|sample| LoadSample {
            value: left * sample.value,
            ..sample
        });
        let output = self.feed.step(sample, self.factor, CutPhase::Feed);
        assert_eq!(output.stop, None);
        (self.factor, self.in_air) = (output.factor, output.in_air);
        self.position += self.factor * FEED / TURN_S * PERIOD_S;
        let cut = self.piece.step(self.position, 0.0);
        (self.load, self.depth) = (cut.load, cut.depth_mm);
        self.time_s += PERIOD_S;
    }
}

impl Pass {
    fn rapid(&mut self) {
        let sample = self.sensor.read(0.0, None);
        self.factor = self.feed.step(sample, 0.0, CutPhase::Rapid).factor;
        self.time_s += PERIOD_S;
    }

    /// One cycle of a hold: the axes are at rest, and nothing is cut.
    fn hold(&mut self) {
        let sample = self.sensor.read(0.0, None);
        self.feed.step(sample, 0.0, CutPhase::Rest);
        self.piece.step(self.position, 0.0);
        self.time_s += PERIOD_S;
    }
}

/// The sensor dies in a cut; after a rapid the next pass is a cut of which no load is seen.
#[test]
fn a_dead_sensor_is_no_air_in_later_passes() {
    let settings = AdaptiveSettings::usual(2200.0, TURN_S, PERIOD_S);
    for (name, blank) in blanks() {
        let mut pass = Pass::new(blank, settings, 0.01);
        while pass.position < 15.0 {
            pass.step(None);
        }
        if pass.in_air || pass.depth < 1.5 {
            continue;
        }
        for _ in 0..3 {
            (0..1000).for_each(|_| pass.step(Some((Loss::Zero, 0.0))));
            (0..200).for_each(|_| pass.rapid());
            for _ in 0..1000 {
                pass.step(Some((Loss::Zero, 0.0)));
                assert!(
                    pass.factor <= settings.factor_entry.min(1.0) + 1e-9,
                    "{name}: {}",
                    pass.factor
                );
            }
        }
    }
}

/// The load is lost while the program is held in the cut.
#[test]
fn a_load_lost_in_a_hold_is_not_taken_for_air() {
    for (name, blank) in blanks() {
        for at_mm in [8.0, 15.0, 25.0, 60.0] {
            let mut pass = Pass::new(
                blank.clone(),
                AdaptiveSettings::usual(2200.0, TURN_S, PERIOD_S),
                0.01,
            );
            while pass.position < at_mm {
                pass.step(None);
            }
            if pass.in_air || pass.depth < 1.5 {
                continue;
            }
            let factor = pass.factor;
            (0..500).for_each(|_| pass.hold());
            let whole = pass.clone();
            for cycle in 0..1000 {
                pass.step(Some((Loss::Zero, f64::from(cycle) * PERIOD_S)));
                assert!(
                    pass.factor <= factor.max(0.2) + 1e-9,
                    "{name} at {at_mm}: {} of {factor}",
                    pass.factor
                );
            }
            // With a load it is the hold of any cut: as fast again within some revolutions.
            let (mut pass, mut fastest) = (whole, 0.0_f64);
            for _ in 0..500 {
                pass.step(None);
                fastest = fastest.max(pass.factor);
            }
            assert!(fastest > 0.8 * factor, "{name} at {at_mm}: {fastest} of {factor}");
        }
    }
}

fn blanks() -> Vec<(String, Blank)> {
    let outline = Blank::outline;
    let mut all = vec![
        ("even", Blank::uniform(4.5)),
        ("thin", Blank::uniform(1.6)),
        ("taper", outline(&[(0.0, 1.5), (120.0, 5.0)])),
        ("falling", outline(&[(0.0, 5.0), (120.0, 0.2)])),
        (
            "steps",
            outline(&[(0.0, 3.0), (40.0, 3.0), (40.0, 1.5), (80.0, 1.5), (80.0, 4.5)]),
        ),
        (
            "groove",
            Blank {
                grooves_mm: vec![(30.0, 50.0, 0.0)],
                ..Blank::uniform(4.0)
            },
        ),
        (
            "slots",
            Blank {
                runout_mm: 0.3,
                slots: vec![(0.1, 0.25), (0.5, 0.8)],
                ..Blank::uniform(4.0)
            },
        ),
    ]
    .into_iter()
    .map(|(name, blank)| (name.to_owned(), blank))
    .collect::<Vec<_>>();
    let mut random = Random::seeded(31);
    for case in 0..cases(4) {
        let blank = if case % 2 == 0 {
            random_stock(&mut random)
        } else {
            random_rough_stock(&mut random)
        };
        all.push((format!("random {case}"), blank));
    }
    all
}

/// A load that goes away at any moment of a cut never raises the factor: with a reading of zero not by a bit,
/// where it decays by no more than the slew rate permits until the decay shows.
#[test]
fn a_lost_load_never_raises_the_factor() {
    let (mut moments, mut max_rise, mut min_factor) = (0, 0.0_f64, f64::INFINITY);
    let mut random = Random::seeded(32);
    for (idle, noise) in [(1.5, 0.0), (1.5, 0.02), (2.0, 0.02)] {
        let settings = AdaptiveSettings {
            factor_idle: idle,
            ..settings()
        };
        for (name, blank) in blanks() {
            let mut pass = Pass::new(blank, settings, noise);
            let (mut shown, mut since, mut next) = (0, 0, 0.0);
            let mut depths = [0.0; TURN];
            let mut cycle = 0;
            while pass.position < 117.0 {
                pass.step(None);
                cycle += 1;
                depths[cycle % TURN] = pass.depth;
                shown = if pass.load > 1.5 * settings.contact_load {
                    shown + 1
                } else {
                    0
                };
                since = if pass.in_air { 0 } else { since + 1 };
                // A steady cut that is light even at the idle factor may be left as if for air.
                let deepest = depths.iter().copied().fold(0.0, f64::max);
                let heavy = law().load(deepest, idle * FEED) > 0.6 * SET;
                if shown < SHOWN || !(heavy || since < TURN) || f64::from(cycle as u32) < next {
                    continue;
                }
                // Close together where contact begins and the factor rises.
                let young = since < 6 * TURN;
                next = f64::from(cycle as u32) + random.between(1.0, if young { 40.0 } else { 900.0 });
                for loss in [
                    Loss::Zero,
                    Loss::Breaks,
                    Loss::Decays(0.3 * TURN_S),
                    Loss::Decays(TURN_S),
                ] {
                    let mut lost = pass.clone();
                    let what = format!(
                        "{name}, idle {idle}, noise {noise}, {:.2} mm, {loss:?}",
                        pass.position
                    );
                    // A decay shows when the cut is a fifth lower than the mean of its revolution, which is
                    // later while the cut grows.
                    let unseen_s = match loss {
                        Loss::Zero => 0.0,
                        Loss::Breaks => 0.01,
                        Loss::Decays(within_s) => 0.5 * within_s + 0.01,
                    };
                    let rise = settings.slew_up_per_s * unseen_s;
                    for k in 0..8 * TURN {
                        lost.step(Some((loss, k as f64 * PERIOD_S)));
                        let above = lost.factor - pass.factor;
                        max_rise = max_rise.max(above);
                        assert!(
                            above <= rise,
                            "{what}: {} after {k} of {}",
                            lost.factor,
                            pass.factor
                        );
                        assert!(
                            !lost.in_air || above <= 0.0,
                            "{what}: {} in air of {}",
                            lost.factor,
                            pass.factor
                        );
                    }
                    assert!(
                        lost.in_air && lost.factor <= settings.factor_entry,
                        "{what}: {}",
                        lost.factor
                    );
                    assert!(lost.factor >= settings.factor_min, "{what}: {}", lost.factor);
                    min_factor = min_factor.min(lost.factor);
                    moments += 1;
                }
            }
        }
    }
    println!(
        "{moments} losses: {max_rise:.4} above the factor before at most; left at {min_factor:.3} at least"
    );
    assert!(moments > 1000, "{moments}");
}

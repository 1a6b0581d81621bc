//! Evaluation of load readings: the depth of cut by the force law, and the limits of plausibility.

use evolvent_turning::{LoadSample, LoadView, LoadWatch, SensorTrouble};

use crate::common::{SET, TURN_S, law};

const PERIOD_S: f64 = 0.001;
const STALE_S: f64 = 0.01;
const MIN_CHIP_MM: f64 = 0.08;
const RANGE: f64 = 8000.0;
const TURN: u64 = 120;

/// A watch, and a sensor with a time constant that it reads in each cycle.
struct Watched {
    watch: LoadWatch,
    lag_s: f64,
    shown: f64,
    sequence: u64,
}

impl Watched {
    fn new(lag_s: f64) -> Self {
        Self {
            watch: LoadWatch::new(law(), SET, PERIOD_S, TURN_S, (lag_s, STALE_S), MIN_CHIP_MM),
            lag_s,
            shown: 0.0,
            sequence: 0,
        }
    }

    fn reading(&mut self, value: f64, chip_mm: f64) -> LoadView {
        self.sequence += 1;
        let sample = LoadSample {
            sequence: self.sequence,
            value,
            range_max: RANGE,
        };
        self.watch.step(Some(sample), chip_mm)
    }

    /// One cycle in a cut of a depth: Pz = C t s^0.75, through the sensor. The last digits change from cycle
    /// to cycle.
    fn cut(&mut self, depth_mm: f64, chip_mm: f64) -> LoadView {
        let load = law().coefficient * depth_mm * chip_mm.powf(0.75);
        let fraction = if self.lag_s > 0.0 {
            1.0 - (-PERIOD_S / self.lag_s).exp()
        } else {
            1.0
        };
        self.shown += fraction * (load - self.shown);
        let digit = (self.sequence % 7) as f64 * 1e-9;
        self.reading(self.shown * (1.0 + digit), chip_mm)
    }

    fn cut_for(&mut self, cycles: u64, depth_mm: f64, chip_mm: f64) -> LoadView {
        for _ in 1..cycles {
            self.cut(depth_mm, chip_mm);
        }
        self.cut(depth_mm, chip_mm)
    }
}

/// Number of cycles with one kind of reading until there is trouble, and its kind.
fn until_trouble(mut next: impl FnMut(&mut Watched) -> LoadView) -> Option<(u32, SensorTrouble)> {
    let mut watched = Watched::new(0.0);
    assert_eq!(watched.cut_for(300, 3.0, 0.4).trouble, None);
    (1..1000).find_map(|cycle| Some((cycle, next(&mut watched).trouble?)))
}

#[test]
fn a_steady_cut_has_the_depth_of_its_law() {
    for (depth, chip, lag) in [(3.0, 0.4, 0.0), (0.5, 0.7, 0.03), (5.0, 0.2, 0.1)] {
        let view = Watched::new(lag).cut_for(20 * TURN, depth, chip);
        let load = law().coefficient * depth * chip.powf(0.75);
        for (what, value, expected) in [
            ("now", view.now, load),
            ("mean", view.mean, load),
            ("peak", view.peak, load),
            ("depth now", view.depth_now_mm, depth),
            ("mean depth", view.depth_mean_mm, depth),
            ("depth", view.depth_mm, depth),
        ] {
            assert!(
                (value / expected - 1.0).abs() < 1e-6,
                "{what}: {value} for {expected}"
            );
        }
        assert_eq!(view.growth_mm, 0.0);
    }
}

#[test]
fn feed_changes_do_not_change_the_depth() {
    for lag in [0.0, 0.02, 0.1] {
        let mut watched = Watched::new(lag);
        watched.cut_for(20 * TURN, 3.0, 0.2);
        for k in 0..5 * TURN {
            let chip = if k / 50 % 2 == 0 { 0.5 } else { 0.25 };
            let view = watched.cut(3.0, chip);
            assert!(
                (view.depth_now_mm / 3.0 - 1.0).abs() < 0.01,
                "{lag}, {k}: {view:?}"
            );
            assert_eq!(view.growth_mm, 0.0, "{lag}, {k}");
        }
    }
}

#[test]
fn a_cut_that_is_not_round_counts_by_its_deepest_part() {
    let mut watched = Watched::new(0.0);
    let mut view = watched.cut(2.0, 0.4);
    for k in 0..10 * TURN {
        view = watched.cut(if k % TURN < TURN / 2 { 2.0 } else { 4.0 }, 0.4);
        // It only looks like growth, and must not count as growth at any part of the revolution.
        assert!(k < 3 * TURN || view.growth_mm < 0.1, "{k}: {view:?}");
    }
    assert!((view.depth_mean_mm - 3.0).abs() < 0.05, "{view:?}");
    assert!(view.depth_mm > 0.95 * 4.0 && view.depth_mm <= 4.0, "{view:?}");
    let (low, high) = (
        law().coefficient * 2.0 * 0.4_f64.powf(0.75),
        law().coefficient * 4.0 * 0.4_f64.powf(0.75),
    );
    assert!((view.peak / high - 1.0).abs() < 0.01, "{view:?}");
    assert!((view.mean / (0.5 * (low + high)) - 1.0).abs() < 0.02, "{view:?}");
}

#[test]
fn growth_is_that_of_a_revolution_and_noise_is_none() {
    let mut watched = Watched::new(0.0);
    watched.cut_for(5 * TURN, 2.0, 0.4);
    let mut view = watched.cut(2.0, 0.4);
    for k in 1..=3 * TURN {
        view = watched.cut(2.0 + 0.8 * k as f64 / TURN as f64, 0.4);
    }
    // 4.4 mm now, 3.6 before; 4 % of the earlier depth may be noise, and a few milliseconds are smoothed.
    let expected = 0.8 - 0.04 * 3.6;
    assert!((view.growth_mm - expected).abs() < 0.15, "{view:?}");
    // A falling depth does not grow.
    for k in 1..=2 * TURN {
        view = watched.cut(4.4 - 0.8 * k as f64 / TURN as f64, 0.4);
        assert!(k < TURN || view.growth_mm == 0.0, "{k}: {view:?}");
    }
}

#[test]
fn thin_chips_and_cleared_readings_are_ignored() {
    let mut watched = Watched::new(0.0);
    watched.cut_for(5 * TURN, 3.0, 0.4);
    let view = watched.cut_for(TURN / 4, 3.0, 0.0);
    assert!((view.depth_now_mm / 3.0 - 1.0).abs() < 0.01, "{view:?}");
    // Just above the minimum chip it does.
    let view = Watched::new(0.0).cut_for(5 * TURN, 3.0, 1.01 * MIN_CHIP_MM);
    assert!((view.depth_now_mm / 3.0 - 1.0).abs() < 0.01, "{view:?}");
    let view = Watched::new(0.0).cut_for(5 * TURN, 3.0, 0.99 * MIN_CHIP_MM);
    assert_eq!(view.depth_now_mm, 0.0);
    watched.watch.forget();
    let view = watched.watch.step(None, 0.0);
    assert_eq!(
        (view.depth_now_mm, view.depth_mean_mm, view.depth_mm),
        (0.0, 0.0, 0.0)
    );
}

#[test]
fn implausible_readings_become_trouble() {
    // 10 ms without a reading are permitted; the sum of tenths may be off by a cycle.
    let soon = 10..=11;
    let (cycle, trouble) = until_trouble(|w| w.watch.step(None, 0.4)).unwrap_or((0, SensorTrouble::Frozen));
    assert!(
        soon.contains(&cycle) && trouble == SensorTrouble::Silent,
        "{cycle} {trouble:?}"
    );
    for (value, expected) in [
        (f64::NAN, SensorTrouble::NotANumber),
        (f64::NEG_INFINITY, SensorTrouble::NotANumber),
        (RANGE, SensorTrouble::Saturated),
        (2.0 * RANGE, SensorTrouble::Saturated),
        (-0.21 * SET, SensorTrouble::Negative),
    ] {
        let found = until_trouble(|w| w.reading(value, 0.4));
        assert!(
            found.is_some_and(|(cycle, trouble)| soon.contains(&cycle) && trouble == expected),
            "{value}: {found:?}"
        );
    }
    // 25 equal readings are too many; then 10 ms more.
    for value in [2000.0, 1e-5 * SET] {
        let found = until_trouble(|w| w.reading(value, 0.4));
        assert!(
            found.is_some_and(
                |(cycle, trouble)| (35..=37).contains(&cycle) && trouble == SensorTrouble::Frozen
            ),
            "{value}: {found:?}"
        );
    }
}

#[test]
fn readings_that_may_be_are_no_trouble() {
    // A sensor in air may repeat a value near zero indefinitely.
    for value in [0.0, 1e-7 * SET, -0.19 * SET] {
        assert_eq!(until_trouble(|w| w.reading(value, 0.4)), None, "{value}");
    }
    // 24 equal values, then another, repeatedly.
    assert_eq!(
        until_trouble(|w| w.reading(2000.0 + f64::from(u8::from(w.sequence / 25 % 2 == 0)), 0.4)),
        None
    );
    // One in eight cycles has a new reading.
    let mut cycle = 0;
    assert_eq!(
        until_trouble(|w| {
            cycle += 1;
            if cycle % 8 == 0 {
                w.cut(3.0, 0.4)
            } else {
                w.watch.step(None, 0.4)
            }
        }),
        None
    );
    // Just below the end of the range, with a changing digit.
    assert_eq!(
        until_trouble(|w| w.reading(0.999 * RANGE + (w.sequence % 2) as f64, 0.4)),
        None
    );
}

#[test]
fn trouble_ends_with_a_reading_that_can_be_believed() {
    let mut watched = Watched::new(0.0);
    watched.cut_for(300, 3.0, 0.4);
    for _ in 0..50 {
        watched.reading(f64::NAN, 0.4);
    }
    assert_eq!(watched.cut(3.0, 0.4).trouble, None);
}

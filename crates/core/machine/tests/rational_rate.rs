//! The rational control rate against the figures of Kombarov and Sorokin, and against an independent search.

use evolvent_machine::{
    ControlRate, LimitedBy, Machine, RateInput, acceleration_rate_hz, chord_error_increments,
    chord_feed_limit_mm_s, period_ns_of, rate_for, rational_rate,
};
use proptest::prelude::*;

const INF: f64 = f64::INFINITY;

fn input(feed_mm_min: f64, acceleration_mm_s2: f64, jerk_m_s3: f64, k: f64) -> RateInput {
    RateInput {
        max_feed_mm_s: feed_mm_min / 60.0,
        acceleration_mm_s2,
        jerk_mm_s3: jerk_m_s3 * 1000.0,
        increments_per_mm: k,
        permitted_error_increments: 1.0,
        min_radius_mm: 0.25,
    }
}

fn assert_near(got: f64, expected: f64, tolerance: f64, what: &str) {
    assert!(
        (got - expected).abs() <= tolerance,
        "{what}: got {got}, expected {expected} +- {tolerance}"
    );
}

#[test]
fn headline_rates_of_the_paper() {
    // feed mm/min, n, J m/s3, k, Hz, R = A^3 / J^2 mm, F = 60 A^2 / J mm/min, tolerance Hz
    let cases = [
        (INF, 0.1, 5.0, 1e3, 350.18, 37.76, 11_548.3, 0.01),
        (INF, 1.0, 50.0, 1e3, 1107.36, 377.6, 115_482.0, 0.01),
        (100_000.0, 1.0, 50.0, 1e3, 1068.2, 304.3, 100_000.0, 0.05),
        (INF, 0.1, 5.0, 1e5, 3501.8, 37.76, 11_548.3, 0.05),
        (INF, 1.0, 50.0, 1e5, 11_073.6, 377.6, 115_482.0, 0.05),
        (INF, 10.0, 500.0, 1e5, 35_017.9, 3776.0, 1_154_810.0, 0.05),
    ];
    for (feed, n, jerk, k, hz, radius_mm, feed_mm_min, tolerance) in cases {
        let rate = rational_rate(&input(feed, n * 9810.0, jerk, k)).unwrap();
        assert_near(rate.rate_hz, hz, tolerance, "rate");
        assert_near(rate.radius_mm, radius_mm, 0.05 * radius_mm / 37.76, "radius");
        assert_near(rate.feed_mm_min, feed_mm_min, 5e-5 * feed_mm_min, "feed");
        assert_eq!(rate.and_by, Some(LimitedBy::Jerk));
    }
    for (n, k, hz) in [(0.1, 1e3, 350.18), (1.0, 1e3, 1107.36)] {
        assert_near(acceleration_rate_hz(n * 9810.0, k, 1.0), hz, 0.01, "closed form");
    }
    for (n, k, hz) in [(0.1, 1e5, 3501.8), (1.0, 1e5, 11_073.6), (10.0, 1e5, 35_017.9)] {
        assert_near(acceleration_rate_hz(n * 9810.0, k, 1.0), hz, 0.05, "closed form");
    }
}

#[test]
fn rates_of_the_machines_named_in_the_paper() {
    let g = 9810.0;
    // A and J of the MA655SM30A's X axis as solved from the text of figure 3c.
    let jerk_mm_s3: f64 = 100.0_f64.powi(3) / 40.0_f64.powi(2);
    let ma655_x = (55.0 * jerk_mm_s3 * jerk_mm_s3).cbrt();
    assert_near(ma655_x / g, 0.02834, 5e-6, "n of figure 3c");
    let cases = [
        ("6R13GN1", 1000.0, 0.01 * g, 5.0, [110.85, 350.21, 1107.37]),
        ("FP7M", 1500.0, 0.012 * g, 5.0, [121.43, 383.64, 1213.07]),
        ("FP7SMN", 4500.0, 0.02 * g, 5.0, [156.73, 495.27, 1566.06]),
        ("MA655SM30A", 6000.0, 0.1 * g, 5.0, [297.31, 940.15, 2973.02]),
        (
            "MA655SM30A, X",
            6000.0,
            ma655_x,
            jerk_mm_s3 / 1000.0,
            [176.78, 559.02, 1767.77],
        ),
        ("16K20F3", 7500.0, 0.08 * g, 5.0, [313.21, 990.46, 3132.09]),
        ("UCP 710, X", 30_000.0, 2500.0, 5.0, [444.57, 1405.85, 4445.70]),
        ("UCP 710, Z", 30_000.0, 2100.0, 50.0, [512.38, 1620.20, 5123.48]),
    ];
    for (name, feed, acceleration, jerk, expected) in cases {
        for (k, hz) in [1e3, 1e4, 1e5].into_iter().zip(expected) {
            let rate = rational_rate(&input(feed, acceleration, jerk, k)).unwrap();
            assert_near(rate.rate_hz, hz, 0.01, &format!("{name}, k = {k}"));
            assert!(
                1e9 / rate.period_ns as f64 >= rate.rate_hz,
                "{name}: the period must be rounded down"
            );
        }
    }
}

#[test]
fn crossing_radii_agree_with_the_paper() {
    let x = input(30_000.0, 2500.0, 5.0, 1e3);
    assert_near(x.jerk_to_acceleration_radius_mm(), 625.0, 1e-9, "UCP 710 X");
    let z = input(30_000.0, 2100.0, 50.0, 1e3);
    assert_near(z.jerk_to_acceleration_radius_mm(), 3.70, 0.005, "UCP 710 Z");
    let ma655_x = input(6000.0, 278.0, 0.625, 1e3);
    assert_near(ma655_x.jerk_to_feed_radius_mm(), 40.0, 1e-9, "MA655SM30A X");
    assert_near(
        ma655_x.jerk_to_acceleration_radius_mm(),
        55.0,
        0.05,
        "MA655SM30A X",
    );
}

#[test]
fn a_crossing_above_a_third_limit_is_not_reported() {
    // UCP 710 X: jerk meets acceleration at 625 mm, but feed is the active limit from 158 mm.
    let rate = rational_rate(&input(30_000.0, 2500.0, 5.0, 1e3)).unwrap();
    assert_near(
        rate.radius_mm,
        (500.0_f64.powi(3) / 5000.0).sqrt(),
        1e-9,
        "radius",
    );
    assert_eq!(
        (rate.limited_by, rate.and_by),
        (LimitedBy::Feed, Some(LimitedBy::Jerk))
    );
}

#[test]
fn acceleration_limits_rate_at_minimum_radius() {
    // On the acceleration limit the rate falls towards its asymptote: 1 / sqrt(1 - D / (2 R k)) above it.
    let rate = rational_rate(&input(INF, 981.0, INF, 1e3)).unwrap();
    assert_near(rate.radius_mm, 0.25, 0.0, "radius");
    let expected = acceleration_rate_hz(981.0, 1e3, 1.0) / (1.0_f64 - 1.0 / 500.0).sqrt();
    assert_near(rate.rate_hz, expected, 1e-9, "rate");
    assert_eq!((rate.limited_by, rate.and_by), (LimitedBy::Acceleration, None));
}

#[test]
fn chord_error_is_stable_on_the_finest_grid() {
    // 100 km radius on a 1 nm grid: r = 1e14 increments; the printed form of (1) would give 0 or 0.0156
    // steps. Independent: h^2 / (2 r) (1 + h^2 / (4 r^2)), exact to 1e-22 here.
    let (rate, feed, radius, k) = (1000.0, 500.0, 1e8, 1e6);
    let half = feed * k / (2.0 * rate);
    let r = radius * k;
    let expected = half * half / (2.0 * r) * (1.0 + half * half / (4.0 * r * r));
    let got = chord_error_increments(feed, rate, radius, k);
    assert_near(got / expected, 1.0, 1e-14, "chord error");
    // A 3-4-5 triangle: radius 5, half chord 4, sagitta 2.
    assert_near(chord_error_increments(8.0, 1.0, 5.0, 1.0), 2.0, 1e-15, "3-4-5");
    // Ten times the rate gives a hundredth of the error.
    let slow = chord_error_increments(100.0, 1000.0, 50.0, 1000.0);
    let fast = chord_error_increments(100.0, 10_000.0, 50.0, 1000.0);
    assert_near(slow / fast, 100.0, 1e-4, "ratio");
}

#[test]
fn straight_paths_and_tiny_circles_are_unlimited() {
    assert_eq!(chord_feed_limit_mm_s(1000.0, 0.0, 1000.0, 1.0), INF);
    assert_eq!(chord_feed_limit_mm_s(1000.0, -0.0, 1000.0, 1.0), INF);
    assert_eq!(
        chord_feed_limit_mm_s(1000.0, f64::MIN_POSITIVE / 4.0, 1000.0, 1.0),
        INF
    );
    // R k = D / 2: the whole circle is within one increment.
    assert_eq!(chord_feed_limit_mm_s(1000.0, 2000.0, 1000.0, 1.0), INF);
    assert_eq!(chord_feed_limit_mm_s(1000.0, f64::INFINITY, 1000.0, 1.0), INF);
    assert_eq!(rate_for(10.0, 0.0005, 1000.0, 1.0), 0.0);
    assert_eq!(rate_for(10.0, INF, 1000.0, 1.0), 0.0);
    assert_eq!(chord_error_increments(10.0, 1000.0, INF, 1000.0), 0.0);
}

#[test]
fn nan_never_means_unlimited() {
    let nan = f64::NAN;
    assert_eq!(chord_feed_limit_mm_s(nan, 0.1, 1000.0, 1.0), 0.0);
    assert_eq!(chord_feed_limit_mm_s(1000.0, nan, 1000.0, 1.0), 0.0);
    assert_eq!(chord_feed_limit_mm_s(1000.0, 0.1, nan, 1.0), 0.0);
    assert_eq!(chord_feed_limit_mm_s(1000.0, 0.1, 1000.0, nan), 0.0);
    assert!(!rate_for(nan, 1.0, 1000.0, 1.0).is_finite());
    assert!(!rate_for(1.0, nan, 1000.0, 1.0).is_finite());
    assert!(chord_error_increments(nan, 1000.0, 1.0, 1000.0).is_nan());
}

#[test]
fn errors_name_invalid_numbers() {
    let good = input(30_000.0, 2500.0, 5.0, 1e3);
    for bad in [0.0, -1.0, f64::NAN, -INF, 1e300] {
        let inputs = [
            (
                RateInput {
                    max_feed_mm_s: bad,
                    ..good
                },
                "feed",
            ),
            (
                RateInput {
                    acceleration_mm_s2: bad,
                    ..good
                },
                "acceleration",
            ),
            (
                RateInput {
                    jerk_mm_s3: bad,
                    ..good
                },
                "jerk",
            ),
            (
                RateInput {
                    increments_per_mm: bad,
                    ..good
                },
                "increments per mm",
            ),
            (
                RateInput {
                    permitted_error_increments: bad,
                    ..good
                },
                "permitted error",
            ),
            (
                RateInput {
                    min_radius_mm: bad,
                    ..good
                },
                "minimum radius",
            ),
        ];
        for (input, name) in inputs {
            let message = rational_rate(&input).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
        }
    }
    let unlimited = RateInput {
        max_feed_mm_s: INF,
        acceleration_mm_s2: INF,
        jerk_mm_s3: INF,
        ..good
    };
    assert!(
        rational_rate(&unlimited)
            .unwrap_err()
            .to_string()
            .contains("unlimited")
    );
    // R k = D / 2 is the minimum radius that has a rate.
    let tiny = RateInput {
        min_radius_mm: 0.0005,
        ..good
    };
    assert!(
        rational_rate(&tiny)
            .unwrap_err()
            .to_string()
            .contains("0.0005 mm")
    );
    assert!(
        rational_rate(&RateInput {
            min_radius_mm: 0.000_500_1,
            ..good
        })
        .is_ok()
    );
}

#[test]
fn periods_are_whole_nanoseconds_rounded_down() {
    assert_eq!(period_ns_of(1000.0), 1_000_000);
    assert_eq!(period_ns_of(35_000.0), 28_571);
    assert_eq!(period_ns_of(250.0), 4_000_000);
    assert_eq!(period_ns_of(f64::NAN), u64::MAX);
    assert_eq!(period_ns_of(1e300), 1);
}

#[test]
fn the_loop_runs_between_250_hz_and_35_khz() {
    let machine = |rate: &str, acceleration: &str, k: f64| {
        let text = format!(
            "name = \"m\"\nkind = \"mill\"\nincrements_per_mm = {k}\nrate = {rate}\n[[axis]]\n\
         letter = \"X\"\ntravel_min_mm = -1\ntravel_max_mm = 1\nmax_velocity_mm_s = 1e5\n{acceleration}\n\
         max_jerk_m_s3 = 1e5\n"
        );
        Machine::parse(&text, "m.toml").unwrap()
    };
    let slow = machine("\"rational\"", "max_acceleration_g = 0.01", 1e3);
    assert!(slow.rational_rate().unwrap().rate_hz < 250.0);
    assert_eq!(slow.period_ns(slow.rate).unwrap(), 4_000_000);
    let fast = machine("\"rational\"", "max_acceleration_g = 20", 1e5);
    assert!(fast.rational_rate().unwrap().rate_hz > 35_000.0);
    assert_eq!(fast.period_ns(fast.rate).unwrap(), 28_571);
    for hz in [249.9, 35_000.1, 0.0, -1000.0, f64::NAN, INF] {
        assert!(
            slow.period_ns(ControlRate::Hz(hz))
                .unwrap_err()
                .to_string()
                .contains("250 to 35000")
        );
    }
    assert_eq!(slow.period_ns(ControlRate::Hz(35_000.0)).unwrap(), 28_571);
    assert_eq!(slow.period_ns(ControlRate::Hz(1000.0)).unwrap(), 1_000_000);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    /// No radius of a fine search needs more than the rational rate, and its own radius needs exactly that.
    #[test]
    fn no_radius_needs_more_than_the_rational_rate(
        feed in prop_oneof![Just(INF), (0.0..4.0_f64).prop_map(|e| 10.0_f64.powf(e))],
        acceleration in prop_oneof![Just(INF), (0.0..6.0_f64).prop_map(|e| 10.0_f64.powf(e))],
        jerk in (2.0..8.0_f64).prop_map(|e| 10.0_f64.powf(e)),
        k in (0.0..6.0_f64).prop_map(|e| 10.0_f64.powf(e)),
        permitted in (-2.0..2.0_f64).prop_map(|e| 10.0_f64.powf(e)),
        above in (-9.0..6.0_f64).prop_map(|e| 10.0_f64.powf(e)),
    ) {
        let min_radius_mm = permitted / (2.0 * k) * (1.0 + above);
        prop_assume!(min_radius_mm < 1e6);
        let input = RateInput {
            max_feed_mm_s: feed, acceleration_mm_s2: acceleration, jerk_mm_s3: jerk,
            increments_per_mm: k, permitted_error_increments: permitted, min_radius_mm,
        };
        let rate = rational_rate(&input).unwrap();
        prop_assert!(rate.radius_mm >= min_radius_mm);
        prop_assert!((input.rate_on_hz(rate.radius_mm) / rate.rate_hz - 1.0).abs() < 1e-12);
        let steps = 4000;
        let octaves = (1e9 / min_radius_mm).ln();
        for i in 0..=steps {
            let radius = (min_radius_mm.ln() + octaves * f64::from(i) / f64::from(steps)).exp().clamp(min_radius_mm, 1e9);
            prop_assert!(
                input.rate_on_hz(radius) <= rate.rate_hz * (1.0 + 1e-9),
                "R = {radius} needs {} Hz, more than {:?}", input.rate_on_hz(radius), rate
            );
        }
    }

    /// At the feed limit the chord error equals the permitted one; the planner relies on this. Below
    /// `R k = D` the chord is a diameter and the error is the radius.
    #[test]
    fn the_feed_limit_reaches_the_permitted_error(
        rate_hz in 250.0..35_000.0_f64,
        radius_k in (-0.3..12.0_f64).prop_map(|e| 10.0_f64.powf(e)),
        k in prop_oneof![Just(1e3), Just(1e4), Just(1e5)],
        permitted in 0.1..10.0_f64,
        sign in prop_oneof![Just(1.0), Just(-1.0)],
    ) {
        let radius_increments = radius_k * permitted * 1.001;
        let radius_mm = radius_increments / k;
        let feed = chord_feed_limit_mm_s(rate_hz, sign / radius_mm, k, permitted);
        let error = chord_error_increments(feed * (1.0 - 1e-14), rate_hz, radius_mm, k);
        let expected = permitted.min(radius_increments);
        // Where the chord is nearly a diameter the error is steep in the feed: sqrt(2 * 1e-14) of the radius.
        prop_assert!((error / expected - 1.0).abs() < 1e-6, "error {error} of {expected}, R k = \
                                                             {radius_increments}");
        prop_assert!(error <= permitted * (1.0 + 1e-12));
        prop_assert!((rate_for(feed, radius_mm, k, permitted) / rate_hz - 1.0).abs() < 1e-12);
    }
}

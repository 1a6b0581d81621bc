//! Stability lobes compared with published and independently computed values, and with each other.

use evolvent_chatter::{ChatterError, Lobes, Milling, MillingCut, MillingDelay, Mode, Turning, TurningMode};

use crate::common::{campaign, near};
use crate::published_cuts::{altintas, insperger, mill_of};

#[test]
fn the_turning_benchmark_with_two_modes() {
    let minima = altintas().minima();
    near(
        minima[0].depth_m,
        7.184_976_875_750_655e-3,
        1e-9,
        "limit of the mode at 250 Hz",
    );
    near(minima[0].frequency_hz, 252.980_2, 1e-6, "its frequency");
    near(
        minima[1].depth_m,
        9.458_426_496_639_81e-3,
        1e-9,
        "limit of the mode at 150 Hz",
    );
    near(minima[1].frequency_hz, 151.491, 1e-6, "its frequency");
    let speeds = [
        20_262.436_204_360_692,
        8_678.015_741_278_05,
        5_521.353_085_933_947,
        4_048.643_096_762_530_6,
    ];
    for (waves, speed) in speeds.into_iter().enumerate() {
        near(
            minima[0].speed_rpm(waves as u32, 1),
            speed,
            1e-6,
            "speed of the lobe",
        );
        near(
            altintas().limit_at(speed).unwrap().depth_m,
            minima[0].depth_m,
            1e-9,
            "limit at that speed",
        );
    }
}

/// At low speed there are many waves between two cuts, more than one between two frequencies of the grid; a
/// fine grid is the reference.
#[test]
fn low_speed_turning_limits_match_fine_grid() {
    for (frequency_hz, damping_ratio) in [(250.0, 0.02), (800.0, 0.05), (1200.0, 0.04), (700.0, 0.08)] {
        let mode = Mode {
            frequency_hz,
            damping_ratio,
            stiffness_n_m: 2e7,
        };
        let tool = TurningMode {
            mode,
            direction_deg: 0.0,
        };
        let turning = Turning::new(&[tool], 0.0, 2e9).unwrap();
        for speed in [20.0, 60.0, 100.0, 160.0, 250.0, 400.0, 1000.0] {
            let mut min = f64::INFINITY;
            let mut before: Option<(f64, f64)> = None;
            for k in 0..=200_000 {
                let frequency = frequency_hz * (1.0 + 0.6 * f64::from(k) / 200_000.0);
                let Some(limit) = turning.limits(frequency)[0] else {
                    continue;
                };
                let waves = frequency * 60.0 / speed - limit.phase;
                let part = waves - waves.round();
                if let Some((depth, other)) = before
                    && part * other <= 0.0
                    && (part - other).abs() < 0.5
                {
                    // At the fraction 0 of a wave, on the line between both.
                    min = min.min(depth + (limit.depth_m - depth) * other / (other - part));
                }
                before = Some((limit.depth_m, part));
            }
            let what = format!("{frequency_hz} Hz, {speed} rpm");
            near(turning.limit_at(speed).unwrap().depth_m, min, 1e-5, &what);
        }
    }
}

/// One mode: `b = 2 k z (1 + z) / (K cos^2)` at `f sqrt(1 + 2 z)`.
#[test]
fn one_mode_has_its_closed_form() {
    let (mut random, cases) = campaign(0x0c4a_0011, 50);
    for _ in 0..cases {
        let mode = Mode {
            frequency_hz: random.between(20.0, 3000.0),
            damping_ratio: random.between(0.003, 0.2),
            stiffness_n_m: random.between(1e6, 1e9),
        };
        let direction = random.between(-60.0, 60.0);
        let turning = Turning::new(
            &[TurningMode {
                mode,
                direction_deg: direction,
            }],
            0.0,
            1.5e9,
        )
        .unwrap();
        let (k, z) = (mode.stiffness_n_m, mode.damping_ratio);
        let expected = 2.0 * k * z * (1.0 + z) / (1.5e9 * f64::cos(direction.to_radians()).powi(2));
        let minima = turning.minima();
        assert_eq!(minima.len(), 1);
        near(minima[0].depth_m, expected, 1e-10, "limit");
        near(
            minima[0].frequency_hz,
            mode.frequency_hz * (1.0 + 2.0 * z).sqrt(),
            1e-5,
            "frequency",
        );
    }
    let mode = Mode {
        frequency_hz: 250.0,
        damping_ratio: 0.012,
        stiffness_n_m: 2.26e8,
    };
    let turning = Turning::new(
        &[TurningMode {
            mode,
            direction_deg: 30.0,
        }],
        0.0,
        1e9,
    )
    .unwrap();
    near(turning.minima()[0].depth_m, 7.318_784e-3, 1e-7, "limit");
}

/// The force at 60 degrees drives modes at 90 and 150 degrees to the chip thickness: the motion of one does
/// not change the chip, and the other is not excited by the force.
#[test]
fn a_mode_that_is_not_excited_has_no_limit() {
    let mode = Mode {
        frequency_hz: 250.0,
        damping_ratio: 0.05,
        stiffness_n_m: 2e7,
    };
    for direction_deg in [90.0, -90.0, 150.0] {
        let tool = TurningMode { mode, direction_deg };
        let turning = Turning::new(&[tool], 60.0, 2e9).unwrap();
        assert!(turning.minima().is_empty(), "{direction_deg}");
        assert!(turning.limit_at(3000.0).is_none(), "{direction_deg}");
    }
}

#[test]
fn zero_order_analysis_of_two_mills() {
    let mode = |frequency_hz, damping_ratio, stiffness_n_m| Mode {
        frequency_hz,
        damping_ratio,
        stiffness_n_m,
    };
    let cut = MillingCut {
        teeth: 3,
        entry_deg: 0.0,
        exit_deg: 90.0,
        tangential_n_m2: 600e6,
        radial_n_m2: 0.07 * 600e6,
    };
    let weck = Milling::new(cut, &[mode(603.0, 0.039, 5.59e6)], &[mode(666.0, 0.035, 5.715e6)]).unwrap();
    near(weck.minima()[0].depth_m, 1.086_829_094_763_418e-3, 1e-7, "limit");
    near(weck.minima()[0].frequency_hz, 632.978, 2e-6, "frequency");
    let cut = MillingCut {
        teeth: 2,
        entry_deg: 90.0,
        exit_deg: 180.0,
        tangential_n_m2: 1319.4e6,
        radial_n_m2: 788.8e6,
    };
    let x = [
        mode(456.780_432_115_313, 0.111_705_399_393_456, 7_933_097.180_868_25),
        mode(
            1_448.889_140_306_56,
            0.017_037_009_579_078_3,
            14_691_778.438_947_9,
        ),
    ];
    let y = [
        mode(516.518_189_147_97, 0.024_579_632_707_099_2, 9_374_613.811_930_87),
        mode(
            1_408.448_140_869_66,
            0.031_357_601_929_568_3,
            12_406_389.714_516_8,
        ),
    ];
    let mill = Milling::new(cut, &x, &y).unwrap();
    near(
        mill.minima()[0].depth_m,
        0.957_103_680_637_243_3e-3,
        1e-4,
        "limit",
    );
    near(mill.minima()[0].frequency_hz, 1440.27, 1e-5, "frequency");
}

#[test]
fn collocation_has_the_exact_multipliers() {
    let delay = MillingDelay::milling(&insperger(1.0), 5000.0).unwrap();
    for (depth_mm, exact, coarse, fine) in [
        (
            0.2,
            0.819_742_784_273_058_1,
            0.798_076_936_318_000_1,
            0.818_827_843_712_767_8,
        ),
        (
            0.5,
            1.073_975_586_650_219,
            1.013_538_182_943_652_7,
            1.071_468_137_894_169_3,
        ),
        (
            0.7,
            1.221_556_135_634_062_3,
            1.138_550_507_635_877_7,
            1.218_127_348_005_274_8,
        ),
        (
            1.0,
            1.406_473_525_319_453,
            1.294_116_981_087_946_7,
            1.401_835_800_025_655_9,
        ),
    ] {
        let depth = 1e-3 * depth_mm;
        near(
            delay.collocation(depth, delay.degree()).unwrap(),
            exact,
            2e-9,
            "collocation",
        );
        // Degree 40 suffices for eight digits here, 30 for the required 1e-5 at small depth.
        near(delay.collocation(depth, 40).unwrap(), exact, 2e-6, "degree 40");
        near(
            delay.semi_discretisation(depth, 40).unwrap(),
            coarse,
            1e-6,
            "40 steps",
        );
        near(
            delay.semi_discretisation(depth, 200).unwrap(),
            fine,
            1e-7,
            "200 steps",
        );
    }
}

#[test]
fn limits_of_milling_over_immersion_and_speed() {
    let speeds = [5000.0, 8000.0, 10_000.0, 12_000.0, 15_000.0, 20_000.0, 25_000.0];
    for (immersion, limits_mm) in [
        (
            1.0,
            [
                0.408_627_81,
                0.676_388_96,
                0.322_379_02,
                2.149_308_31,
                0.386_588_83,
                1.417_505_90,
                3.939_930_36,
            ],
        ),
        (
            0.5,
            [
                0.847_203_51,
                0.797_932_32,
                2.104_689_70,
                0.613_090_92,
                2.596_238_40,
                0.719_643_17,
                1.037_703_53,
            ],
        ),
        (
            0.1,
            [
                1.296_263_24,
                1.220_423_93,
                2.518_412_09,
                0.942_951_02,
                4.343_675_13,
                1.221_466_50,
                1.628_796_02,
            ],
        ),
        (
            0.05,
            [
                2.206_918_43,
                2.163_160_21,
                4.090_710_99,
                1.680_516_97,
                8.212_475_00,
                2.298_676_30,
                2.911_723_93,
            ],
        ),
    ] {
        let milling = insperger(immersion);
        for (speed, limit_mm) in speeds.into_iter().zip(limits_mm) {
            let delay = MillingDelay::milling(&milling, speed).unwrap();
            let limit = delay.limit(0.012).unwrap().unwrap();
            near(1e3 * limit, limit_mm, 1e-6, "limit");
        }
    }
}

/// Two independent methods: at the limit of the frequency domain the delay equation's multiplier is 1.
#[test]
fn at_the_limit_of_turning_the_multiplier_is_one() {
    let (mut random, cases) = campaign(0x0c4a_0012, 12);
    let turning = altintas();
    for _ in 0..cases {
        let speed = random.between(3000.0, 25_000.0);
        let limit = turning.limit_at(speed).unwrap();
        let delay = MillingDelay::turning(&turning, speed).unwrap();
        near(
            delay.collocation(limit.depth_m, delay.degree()).unwrap(),
            1.0,
            1e-8,
            "multiplier at the limit",
        );
        assert!(
            delay.collocation(0.98 * limit.depth_m, delay.degree()).unwrap() < 1.0,
            "{speed} rpm"
        );
    }
}

/// With many teeth in the cut the force is nearly constant, so the zeroth harmonic dominates.
#[test]
fn with_many_teeth_both_analyses_of_milling_agree() {
    let mode = |frequency_hz| Mode {
        frequency_hz,
        damping_ratio: 0.03,
        stiffness_n_m: 1e7,
    };
    let cut = MillingCut {
        teeth: 24,
        entry_deg: 0.0,
        exit_deg: 180.0,
        tangential_n_m2: 7e8,
        radial_n_m2: 2e8,
    };
    let milling = Milling::new(cut, &[mode(600.0)], &[mode(700.0)]).unwrap();
    for speed in [700.0, 1100.0, 1900.0] {
        let delay = MillingDelay::milling(&milling, speed).unwrap();
        let exact = delay.limit(5e-3).unwrap().unwrap();
        near(milling.limit_at(speed).unwrap().depth_m, exact, 2e-3, "limit");
    }
}

/// A tooth that always cuts is turning: three teeth over a whole turn, with constant directions.
#[test]
fn semi_discretisation_converges_quadratically() {
    let delay = MillingDelay::milling(&insperger(0.5), 9000.0).unwrap();
    let exact = delay.collocation(5e-4, delay.degree()).unwrap();
    let miss = |steps: usize| delay.semi_discretisation(5e-4, steps).unwrap() - exact;
    let ratio = miss(60) / miss(120);
    assert!((3.5..4.6).contains(&ratio), "{ratio}");
}

#[test]
fn numbers_that_are_no_cut_are_refused() {
    let mode = Mode {
        frequency_hz: 250.0,
        damping_ratio: 0.01,
        stiffness_n_m: 1e8,
    };
    let turning = |mode, coefficient| {
        Turning::new(
            &[TurningMode {
                mode,
                direction_deg: 0.0,
            }],
            0.0,
            coefficient,
        )
    };
    for bad in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
        for mode in [
            Mode {
                frequency_hz: bad,
                ..mode
            },
            Mode {
                damping_ratio: bad,
                ..mode
            },
            Mode {
                stiffness_n_m: bad,
                ..mode
            },
        ] {
            assert!(matches!(turning(mode, 1e9), Err(ChatterError::Number { .. })));
        }
        assert!(turning(mode, bad).is_err());
        assert!(MillingDelay::milling(&insperger(0.5), bad).is_err());
    }
    assert!(Turning::new(&[], 0.0, 1e9).is_err());
    let delay = MillingDelay::milling(&insperger(0.5), 9000.0).unwrap();
    assert!(delay.collocation(f64::NAN, 30).is_err() && delay.collocation(1e-3, 3).is_err());
    assert!(delay.semi_discretisation(1e-3, 0).is_err() && delay.limit(-1.0).is_err());
}

#[test]
fn turning_chatter_frequency_matches_its_limit() {
    let turning = altintas();
    for rpm in [1500.0, 4000.0, 6500.0, 9000.0, 15_000.0] {
        let limit = turning.limit_at(rpm).unwrap();
        let delay = MillingDelay::turning(&turning, rpm).unwrap();
        let chatter = delay.chatter(limit.depth_m).unwrap();
        near(chatter.frequency_hz, limit.frequency_hz, 1e-6, "frequency");
    }
}

/// Collocation and the limit share only the formula of the force factors: at the limit its largest multiplier
/// is 1.
#[test]
fn multiplier_is_one_at_limits_of_random_mills() {
    let (mut random, cases) = campaign(0x0c4a_0013, 24);
    let mut limits = 0;
    for _ in 0..cases {
        let mut modes = |max: usize| -> Vec<Mode> {
            let count = random.below(max + 1);
            (0..count)
                .map(|_| Mode {
                    frequency_hz: random.between(300.0, 1500.0),
                    damping_ratio: random.between(0.005, 0.06),
                    stiffness_n_m: random.between(2e6, 5e7),
                })
                .collect()
        };
        let (mut x, y) = (modes(2), modes(2));
        if x.is_empty() && y.is_empty() {
            x = modes(1);
        }
        if x.is_empty() && y.is_empty() {
            continue;
        }
        let cut = MillingCut {
            teeth: 1 + random.below(6) as u32,
            entry_deg: 0.0,
            exit_deg: 180.0,
            tangential_n_m2: random.between(4e8, 2e9),
            radial_n_m2: random.between(1e8, 6e8),
        };
        let cut = cut.with_immersion(random.between(0.03, 1.0), random.below(2) == 0);
        let milling = Milling::new(cut, &x, &y).unwrap();
        let rpm = random.between(2000.0, 20_000.0);
        let delay = MillingDelay::milling(&milling, rpm).unwrap();
        let Some(limit) = delay.limit(0.02).unwrap() else {
            continue;
        };
        limits += 1;
        let what = format!("{milling:?}, {rpm} rpm, {limit} m");
        let degree = delay.degree();
        near(delay.collocation(limit, degree).unwrap(), 1.0, 2e-6, &what);
        for part in [0.3, 0.7, 0.9, 0.97] {
            assert!(
                delay.collocation(part * limit, degree).unwrap() < 1.0,
                "{part}: {what}"
            );
        }
        assert!(delay.collocation(1.01 * limit, degree).unwrap() > 1.0, "{what}");
    }
    assert!(limits >= cases / 2, "{limits} limits");
}

/// Tools as measured by modal analysis: 20 modes, in a few waves of the fastest.
#[test]
fn mills_with_many_modes_have_a_limit() {
    let (mut random, _) = campaign(0x0c4a_0014, 1);
    for (count, rpm) in [(5, 3000.0), (10, 10_000.0), (20, 20_000.0)] {
        let mut modes = || -> Vec<Mode> {
            (0..count / 2 + count % 2)
                .map(|_| Mode {
                    frequency_hz: random.between(500.0, 3000.0),
                    damping_ratio: random.between(0.02, 0.05),
                    stiffness_n_m: random.between(1e7, 1e8),
                })
                .collect()
        };
        let cut = MillingCut {
            teeth: 2,
            entry_deg: 0.0,
            exit_deg: 180.0,
            tangential_n_m2: 6e8,
            radial_n_m2: 2e8,
        };
        let milling = Milling::new(cut.with_immersion(0.5, false), &modes(), &modes()).unwrap();
        let delay = MillingDelay::milling(&milling, rpm).unwrap();
        let limit = delay.limit(0.1).unwrap().expect("a limit");
        let what = format!("{count} modes at {rpm} rpm: {limit} m");
        if count > 10 {
            // Collocation would take ten seconds.
            assert!((1e-5..0.1).contains(&limit), "{what}");
            continue;
        }
        assert!(
            delay.collocation(0.97 * limit, delay.degree()).unwrap() < 1.0,
            "{what}"
        );
        assert!(
            delay.collocation(1.03 * limit, delay.degree()).unwrap() > 1.0,
            "{what}"
        );
    }
}

/// A disturbance grows before it dies out, more so with more waves; the bound holds.
#[test]
fn growth_below_the_limit_is_bounded() {
    for (rpm, depth_mm, min) in [(2000.0, 0.313, 4.0), (1000.0, 0.323, 300.0), (500.0, 0.311, 1e6)] {
        let delay = MillingDelay::milling(&mill_of(4000.0, 1.0), rpm).unwrap();
        // Growth of an impulse in a simulation, after many teeth.
        let bound = delay.growth(1e-3 * depth_mm).unwrap();
        assert!((min..100.0 * min).contains(&bound), "{rpm} rpm: {bound}");
    }
}

/// An error instead of a wrong limit, within a short time.
#[test]
fn too_many_waves_are_an_error_of_the_limit() {
    let milling = mill_of(4000.0, 1.0);
    for rpm in [1.0, 10.0, 100.0, 200.0, 300.0] {
        let refused = MillingDelay::milling(&milling, rpm).unwrap().limit(5e-3);
        assert!(
            matches!(
                refused,
                Err(ChatterError::TooManyWaves { .. } | ChatterError::Unresolved { .. })
            ),
            "{rpm} rpm: {refused:?}"
        );
    }
    // Most of the period is free: the wave of a tooth grows from tooth to tooth until it has moved out of the
    // cut.
    let small = MillingDelay::milling(&mill_of(4000.0, 0.1), 200.0).unwrap();
    assert!(matches!(small.limit(5e-3), Err(ChatterError::Growth { growth }) if growth > 1e12));
    let delay = MillingDelay::milling(&milling, 1000.0).unwrap();
    assert!(delay.collocation(1e-4, delay.degree()).is_err());
}

/// An island of chatter from 0.966 to 0.985 of the depth above which every cut chatters: its largest
/// multiplier is 1.0037.
#[test]
fn a_narrow_island_of_chatter_is_found() {
    let cut = MillingCut {
        teeth: 4,
        entry_deg: 98.217_010_733_452_71,
        exit_deg: 180.0,
        tangential_n_m2: 707_293_826.831_111_4,
        radial_n_m2: 234_123_545.254_109_56,
    };
    let mode = |frequency_hz, damping_ratio, stiffness_n_m| Mode {
        frequency_hz,
        damping_ratio,
        stiffness_n_m,
    };
    let x = [mode(
        1_464.295_004_083_099,
        0.036_784_636_442_947_9,
        2.322_273_857_743_167e7,
    )];
    let y = [mode(
        1_259.213_200_233_093_2,
        0.044_652_427_410_923_304,
        2_040_343.856_900_309,
    )];
    let milling = Milling::new(cut, &x, &y).unwrap();
    let delay = MillingDelay::milling(&milling, 17_479.394_701_001_22).unwrap();
    let limit = delay.limit(0.02).unwrap().unwrap();
    assert!((3.510e-3..3.536e-3).contains(&limit), "{limit}");
    // Two multipliers that meet on the real axis and separate again.
    for k in 0..=20 {
        let depth = 3.643_814_577_581_661e-3 * (0.80 + 0.01 * f64::from(k));
        let expected = delay.collocation(depth, 40).unwrap();
        let multiplier = delay.multiplier(depth).unwrap().unwrap();
        near(multiplier.norm(), expected, 1e-6, "multiplier");
    }
}

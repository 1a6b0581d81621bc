//! Self-oscillation compared with values that were computed independently, in another language, by
//! integration with a relative tolerance of 1e-9 and by another harmonic balance.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use evolvent_chatter::{
    Assessor, ChatterError, CuttingTool, Cycle, Measure, Model, Prediction, Scanner, StabilityVerdict,
    Verified, least_squares, verify,
};

use crate::common::{near, steel, tool};

fn scanned(tool: CuttingTool, harmonics: usize) -> (Prediction, Vec<Verified>) {
    let law = steel();
    let model = Model::new(tool, &law).unwrap();
    let prediction = Scanner::new(harmonics).scan(&model).unwrap();
    let verified = prediction
        .cycles()
        .map(|cycle| verify(&model, cycle, 1e-9).unwrap());
    let verified = verified.collect();
    (prediction, verified)
}

fn verdict(tool: CuttingTool) -> StabilityVerdict {
    let law = steel();
    let model = Model::new(tool, &law).unwrap();
    Assessor::new(5).assess(&model).unwrap().verdict
}

fn only(prediction: &Prediction) -> &Cycle {
    let cycles: Vec<_> = prediction.cycles().collect();
    assert_eq!(cycles.len(), 1);
    cycles[0]
}

#[test]
fn self_excited_case_matches_reference() {
    let (prediction, verified) = scanned(tool(60.0, 0.02), 5);
    assert_eq!(verdict(tool(60.0, 0.02)), StabilityVerdict::SelfExcited);
    near(
        prediction.equilibrium.growth_per_s(),
        23.514_340_643_860_72,
        1e-7,
        "growth",
    );
    near(
        prediction.equilibrium.modes[0].frequency_hz,
        255.382_895_467_881_67,
        1e-9,
        "small frequency",
    );
    near(
        prediction.equilibrium.modes[1].growth_per_s,
        -58.512_619_009_921_934,
        1e-7,
        "decay",
    );
    let cycle = only(&prediction);
    let (f, a) = (
        255.328_567_158_297_46,
        [5.103_962_013_031_213e-6, 4.215_264_039_018_438_6e-4],
    );
    near(cycle.frequency_hz, f, 1e-4, "frequency");
    near(cycle.amplitude_m(0), a[0], 1e-3, "A1");
    near(cycle.amplitude_m(1), a[1], 1e-3, "A2");
    // The known error of this number of harmonics.
    near(
        cycle.amplitude_m(1) / a[1] - 1.0,
        1.068e-5,
        0.02,
        "error of five harmonics",
    );
    // The paper writes both as sines of separate angles; lead or lag is the same difference.
    near(cycle.phase_rad().abs(), 2.116_606_513_123_745, 1e-3, "phase");
    near(cycle.mean_m(0), -2.754_059_366_126_744e-5, 1e-5, "mean 1");
    near(cycle.mean_m(1), -2.351_086_286_261_262_7e-4, 1e-5, "mean 2");
    let exact = &verified[0];
    near(exact.frequency_hz, f, 1e-7, "frequency in time");
    near(exact.amplitude_m[0], a[0], 1e-6, "A1 in time");
    near(exact.amplitude_m[1], a[1], 1e-6, "A2 in time");
    near(
        exact.half_peak_to_peak_m[1],
        4.215_611_633_249_239e-4,
        1e-5,
        "half peak to peak",
    );
    near(exact.speed_m_min[0], 26.889_4, 1e-4, "lowest speed");
    near(exact.depth_mm[0], 3.643_88, 1e-4, "lowest depth");
    assert!(exact.stable() && exact.trivial_error < 1e-8 && exact.closure < 1e-9);
    let multipliers = exact.multipliers.map(|multiplier| multiplier.norm());
    near(multipliers[0], 0.768_404_9, 1e-5, "multiplier");
    near(multipliers[2], 0.767_795_8, 1e-5, "multiplier");
    // Harmonics of V2 relative to the first.
    let harmonic = |n: usize| cycle.harmonics_m[1][n].norm() / cycle.amplitude_m(1);
    near(harmonic(2), 0.002_005_725_6, 1e-3, "second harmonic");
    near(harmonic(3), 0.001_775_578_1, 1e-3, "third harmonic");
}

#[test]
fn harmonic_truncation_errors_match_reference() {
    for (case, amplitude, frequency, errors) in [
        (
            tool(60.0, 0.02),
            4.215_264_039_018_438_6e-4,
            255.328_567_158_297_46,
            [
                (1, 3.302_557e-4, 2.092_902e-4),
                (3, -8.336_775e-5, 4.096_71e-5),
                (5, 1.068_07e-5, 2.089_5e-6),
            ],
        ),
        (
            tool(100.0, 0.008),
            1.021_942_465_312_599e-3,
            255.131_572_624_927,
            [
                (1, 1.095_987e-3, 6.833_563e-5),
                (3, 1.762_19e-5, 4.497_946e-5),
                (5, 5.627_476e-5, 4.542_59e-6),
            ],
        ),
    ] {
        let law = steel();
        let model = Model::new(case, &law).unwrap();
        for (harmonics, by_amplitude, by_frequency) in errors {
            let prediction = Scanner::new(harmonics).scan(&model).unwrap();
            let cycle = prediction.cycles().find(|cycle| cycle.stable_by_slope()).unwrap();
            let miss = cycle.amplitude_m(1) / amplitude - 1.0;
            // With few harmonics the result depends on the number of samples.
            let slack = if harmonics < 5 { 2e-5 } else { 2e-7 };
            assert!(
                (miss - by_amplitude).abs() < slack,
                "N = {harmonics}: {miss} for {by_amplitude}"
            );
            let miss = cycle.frequency_hz / frequency - 1.0;
            assert!(
                (miss - by_frequency).abs() < slack,
                "N = {harmonics}: {miss} for {by_frequency}"
            );
        }
    }
}

#[test]
fn bistable_case_has_both_cycles_and_basins() {
    let (prediction, verified) = scanned(tool(100.0, 0.008), 5);
    assert_eq!(verdict(tool(100.0, 0.008)), StabilityVerdict::Bistable);
    near(
        prediction.equilibrium.growth_per_s(),
        -2.395_413_277,
        1e-6,
        "growth",
    );
    let cycles: Vec<_> = prediction.cycles().collect();
    assert_eq!(cycles.len(), 2);
    near(
        cycles[0].amplitude_m(1),
        4.177_215_999_88e-4,
        1e-6,
        "unstable amplitude",
    );
    near(
        cycles[0].frequency_hz,
        255.066_442_595_569_24,
        1e-7,
        "unstable frequency",
    );
    near(
        cycles[1].amplitude_m(1),
        1.021_942_465e-3,
        1e-3,
        "stable amplitude",
    );
    near(cycles[1].frequency_hz, 255.131_572_6, 1e-4, "stable frequency");
    assert!(!cycles[0].stable_by_slope() && cycles[1].stable_by_slope());
    near(
        verified[0].multipliers[0].re,
        1.022_245_972,
        1e-6,
        "unstable multiplier",
    );
    near(
        verified[1].multipliers[0].re,
        0.849_209_5,
        1e-5,
        "stable multiplier",
    );
    near(
        verified[1].amplitude_m[1],
        1.021_942_465e-3,
        1e-6,
        "stable amplitude in time",
    );
    assert!(!verified[0].stable() && verified[1].stable());
    // Impulses, integrated over 3 s: those below the unstable cycle die out, those above reach the stable
    // one.
    let law = steel();
    let model = Model::new(tool(100.0, 0.008), &law).unwrap();
    for (kick, stays) in [(0.60, false), (0.64, false), (0.70, true), (0.90, true)] {
        let amplitude = common_kick(&model, kick);
        if stays {
            near(amplitude, 1.021_942_5e-3, 1e-4, "amplitude after the kick");
        } else {
            assert!(amplitude < 5e-6, "{kick} m/s leaves {amplitude} m");
        }
    }
}

/// Half of peak to peak of V2 in the last 20 ms of 3 s after an impulse, m.
fn common_kick(model: &Model<'_>, kick_m_s: f64) -> f64 {
    let rest = model.equilibrium().unwrap().deflection_m;
    let mut state = evolvent_chatter::State::new(rest[0], rest[1], 0.0, kick_m_s);
    let mut integrator = evolvent_chatter::Integrator::<4>::new(evolvent_chatter::Accuracy {
        relative: 1e-8,
        absolute: 1e-12,
        longest_step_s: 2e-4,
    });
    let mut rate = |state: &evolvent_chatter::State| model.derivative(state);
    let event = |state: &evolvent_chatter::State| model.cut_at(state).1;
    state = integrator.run(state, 2.98, &mut rate, &event).unwrap();
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for _ in 0..400 {
        state = integrator.run(state, 5e-5, &mut rate, &event).unwrap();
        (low, high) = (low.min(state[1]), high.max(state[1]));
    }
    0.5 * (high - low)
}

#[test]
fn the_stable_case_has_no_cycle() {
    let (prediction, verified) = scanned(tool(25.0, 0.02), 5);
    assert_eq!(verdict(tool(25.0, 0.02)), StabilityVerdict::Stable);
    assert!(verified.is_empty());
    near(
        prediction.equilibrium.modes[0].growth_per_s,
        -85.389_093_264_574_29,
        1e-7,
        "growth",
    );
    near(
        prediction.equilibrium.modes[1].growth_per_s,
        -153.772_548_654_783_35,
        1e-7,
        "growth",
    );
}

#[test]
fn cycles_over_cutting_speed_match_reference() {
    for (speed, growth, cycle) in [
        (20.0, -80.092_441_876_994_97, None),
        (35.0, -76.269_436_993_882_44, None),
        (40.0, -5.537_433_518_225_953, None),
        (45.0, 41.300_672_293_211_136, Some((255.34, 0.206_882_877_05))),
        (55.0, 37.275_250_107_547_805, Some((255.338, 0.365_981_016_04))),
        (70.0, 2.225_203_377_200_273_3, Some((255.277, 0.505_978_565_11))),
        (80.0, f64::NAN, None),
        (85.0, -14.084_356_798_774_394, None),
        (95.0, -19.508_766_406_177_7, None),
        (110.0, -24.052_536_722_877_164, None),
    ] {
        let (prediction, verified) = scanned(tool(speed, 0.02), 5);
        if !growth.is_nan() {
            near(prediction.equilibrium.growth_per_s(), growth, 1e-6, "growth");
        }
        match cycle {
            None => assert!(verified.is_empty() && verdict(tool(speed, 0.02)) == StabilityVerdict::Stable),
            Some((frequency, amplitude)) => {
                assert!(only(&prediction).stable_by_slope() && verified[0].stable());
                near(only(&prediction).frequency_hz, frequency, 4e-6, "frequency");
                near(
                    only(&prediction).amplitude_m(1),
                    1e-3 * amplitude,
                    2e-5,
                    "amplitude",
                );
            }
        }
    }
    // The ends of the range.
    let grows = |speed: f64| {
        let law = steel();
        let model = Model::new(tool(speed, 0.02), &law).unwrap();
        model.equilibrium().unwrap().growth_per_s() > 0.0
    };
    assert!(!grows(40.0) && grows(41.0) && grows(70.9) && !grows(72.0));
}

/// The tool leaves the work for a quarter of the period: five harmonics are accurate to 5e-3, more are
/// better.
#[test]
fn five_harmonics_suffice_with_loss_of_contact() {
    for (speed, ratio, depth, beta) in [
        (60.0, 0.001, 0.2, 35.0),
        (60.0, 0.0005, 0.1, 70.0),
        (45.0, 0.001, 0.15, 50.0),
    ] {
        let case = CuttingTool {
            depth_mm: depth,
            beta_deg: beta,
            ..tool(speed, ratio)
        };
        let (prediction, verified) = scanned(case, 5);
        assert!(!verified.is_empty());
        for (cycle, exact) in prediction.cycles().zip(&verified) {
            assert!(cycle.free_part > 0.2 && exact.depth_mm[0] < 0.0);
            assert!(exact.amplitude_error.abs() < 5e-3 && exact.frequency_error.abs() < 1e-4);
            assert_eq!(exact.stable(), cycle.stable_by_slope());
        }
        let (_, better) = scanned(case, 32);
        for exact in better {
            assert!(
                exact.amplitude_error.abs() < 1.5e-3,
                "{speed} m/min: {}",
                exact.amplitude_error
            );
        }
    }
}

#[test]
fn one_harmonic_least_squares_has_known_bias() {
    let law = steel();
    let model = Model::new(tool(60.0, 0.02), &law).unwrap();
    let fits = least_squares(&model, 1, Measure::Residual).unwrap();
    let fit = fits.iter().find(|fit| !fit.reaches_floor).unwrap();
    near(
        fit.amplitude_m[1],
        3.738_701_601e-4,
        1e-4,
        "amplitude, 11 % short",
    );
    near(fit.frequency_hz, 255.402_061_59, 1e-6, "frequency");
    near(fit.residual_n2, 4_464.081_2, 1e-5, "residual");
    let fits = least_squares(&model, 1, Measure::Normalised).unwrap();
    let fit = fits.iter().find(|fit| !fit.reaches_floor).unwrap();
    near(
        fit.amplitude_m[1],
        3.868_247e-4,
        1e-4,
        "normalised amplitude, 8 % short",
    );
    near(fit.normalised, 1.370_179e-4, 1e-3, "normalised residual");
    // Only more harmonics remove it.
    let fits = least_squares(&model, 5, Measure::Normalised).unwrap();
    let fit = fits.iter().find(|fit| fit.normalised < 3e-6).unwrap();
    near(
        fit.amplitude_m[1],
        4.215_264e-4,
        5e-3,
        "amplitude with five harmonics",
    );
    // A stable cut has minima too, and their residual shows that they are false.
    let model = Model::new(tool(25.0, 0.02), &law).unwrap();
    let fits = least_squares(&model, 5, Measure::Normalised).unwrap();
    assert!(fits.iter().all(|fit| fit.normalised > 1e-4), "{fits:?}");
}

#[test]
fn what_the_model_cannot_answer_is_said() {
    let law = steel();
    // Almost no damping: the vibration grows until the speed falls to the floor.
    assert_eq!(verdict(tool(60.0, 0.001)), StabilityVerdict::OutOfModel);
    for (speed, depth, feed) in [
        (f64::NAN, 4.0, 0.49),
        (60.0, 0.0, 0.49),
        (60.0, -1.0, 0.49),
        (60.0, 4.0, 0.0),
        (0.0, 4.0, 0.49),
    ] {
        let bad = CuttingTool {
            speed_m_min: speed,
            depth_mm: depth,
            feed_mm_rev: feed,
            ..tool(60.0, 0.02)
        };
        assert!(matches!(Model::new(bad, &law), Err(ChatterError::Number { .. })));
    }
    let slow = CuttingTool {
        floor_m_min: 61.0,
        ..tool(60.0, 0.02)
    };
    assert!(matches!(
        Model::new(slow, &law),
        Err(ChatterError::BelowFloor { .. })
    ));
    let soft = CuttingTool {
        radial_ratio: 0.0,
        beta_deg: -60.0,
        ..tool(60.0, 0.02)
    };
    // Pulled into the cut by a spring that is far too soft.
    let mut softer = soft;
    for axis in &mut softer.axes {
        axis.stiffness_n_m *= 1e-3;
        axis.mass_kg *= 1e-3;
    }
    assert!(Model::new(soft, &law).unwrap().equilibrium().is_ok());
    let answer = Model::new(softer, &law).unwrap().equilibrium();
    assert!(answer.is_ok() || matches!(answer, Err(ChatterError::NoEquilibrium { .. })));
}

//! Cuts that end within the stock: all passes leave one wall along the edge, so that none of them meets the
//! stock of another with its whole edge at once.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may fail, and prints its figures"
)]

use evolvent_turning::{
    BackOff, Blank, Cone, CuttingEdge, Figures, Simulation, Strategy, TurningInputs, TurningSettings,
    TurningState, run_fixed_at_load,
};

use crate::common::{
    Limits, PERIOD_S, Part, Random, SET, TURN_S, cases, fast, law, literal, random_rough_stock, random_stock,
    regime, regime_of, safe, sensor,
};

/// Turns the blank and checks that the part is at size and every limit of motion was kept.
fn turn(settings: TurningSettings, blank: &Blank, seed: u64) -> Figures {
    let mut limits = Limits::new(&settings);
    let mut part = Part::new(&settings, blank);
    let mut simulation = Simulation::new(settings, blank.clone(), law(), sensor(seed)).unwrap();
    let mut log = String::new();
    let (figures, _) = simulation.run(3000.0, |output, _| {
        limits.check(output);
        part.cut(output.along.position, output.out.position);
        if let Some(transition) = output.transition {
            log += &format!("{transition:?}\n");
        }
    });
    let what = || format!("{settings:?}\n{blank:?}\n{log}{figures:?}");
    assert!(figures.done && !figures.hit_holder, "{}", what());
    assert!(
        part.deepest() < 1e-9,
        "{} into the contour: {}",
        part.deepest(),
        what()
    );
    assert!(part.left() <= 0.1, "{} left: {}", part.left(), what());
    // The literal strategy causes overloads by itself.
    let literal = settings.overload_n > 5000.0;
    assert!(literal || figures.over_130_s <= TURN_S, "{}", what());
    figures
}

fn shorter(settings: TurningSettings, length_mm: f64) -> TurningSettings {
    TurningSettings {
        length_mm,
        ..settings
    }
}

#[test]
fn no_height_of_stock_overloads_at_the_shoulder() {
    for length_mm in [20.0, 60.0] {
        for height in 1..=10 {
            let blank = Blank::uniform(f64::from(height));
            for (settings, max) in [(safe(), 1.2), (fast(), 1.2), (literal(), 1.75)] {
                let figures = turn(shorter(settings, length_mm), &blank, 3);
                let peak = figures.peak / SET;
                println!(
                    "{length_mm} {height}: {:.1} s, {} passes, {peak:.2}",
                    figures.time_s, figures.passes
                );
                assert!(peak <= max, "{height} mm: {peak}");
            }
        }
    }
}

#[test]
fn edges_of_any_lead_leave_one_wall() {
    for lead_deg in [30.0, 45.0, 75.0, 85.0, 89.0] {
        let tool = CuttingEdge::new(lead_deg, 12.0).unwrap();
        let regime = regime_of(&tool, BackOff::Balanced);
        let settings = TurningSettings {
            strategy: Strategy::safe(&regime),
            period_s: PERIOD_S,
            ..TurningSettings::usual(regime, tool, 500.0, 40.0)
        };
        // An edge at 89 degrees reaches more than the deepest cut before the load can show it: at the face,
        // not at the wall.
        let fractions: &[f64] = if lead_deg > 88.0 {
            &[0.3]
        } else {
            &[0.3, 0.6, 0.95]
        };
        for fraction in fractions {
            let blank = Blank::uniform(fraction * tool.reach_mm());
            // Steep edges reach their depth within a revolution, faster than the load shows it.
            let max = if lead_deg > 80.0 { 2.0 } else { 1.3 };
            let figures = turn(settings, &blank, 5);
            assert!(
                figures.peak <= max * SET,
                "{lead_deg} degrees: {}",
                figures.peak / SET
            );
        }
    }
}

#[test]
fn random_stocks_are_cut_to_a_shoulder() {
    let mut random = Random::from_state(0x5eed_0123_u64);
    let mut worst = 0.0_f64;
    for case in 0..cases(40) {
        let blank = if case % 4 == 3 {
            random_rough_stock(&mut random)
        } else {
            random_stock(&mut random)
        };
        let base = match case % 3 {
            0 => safe(),
            1 => fast(),
            _ => literal(),
        };
        let length_mm = random.between(10.0, 190.0);
        // As in facing: the axis of the work may be before the end of the wall.
        let beyond_mm = if random.unit() < 0.3 {
            random.between(0.0, 5.0)
        } else {
            f64::INFINITY
        };
        let top = blank.height_mm(length_mm);
        let cone = (random.unit() < 0.3).then(|| {
            let from = random.between(0.0, length_mm);
            let max = ((top * 0.8).max(0.1) / (length_mm - from).max(0.1))
                .atan()
                .to_degrees();
            Cone::new(from, random.between(0.2, max.clamp(0.3, 58.0)))
        });
        let settings = TurningSettings {
            length_mm,
            beyond_mm,
            cone,
            ..base
        };
        let figures = turn(settings, &blank, case as u64);
        if case % 3 != 2 {
            worst = worst.max(figures.peak / SET);
        }
    }
    println!("largest load of safe and fast: {worst:.2} of the set one");
    assert!(worst < 1.35, "{worst}");
}

#[test]
fn a_thin_ridge_before_the_end_is_no_broken_insert() {
    // The edge cuts the ridge while the tip is in the groove before it. At the final size nothing of it may
    // remain to be felt.
    let ridge = |height: f64, from: f64, width: f64, low: f64| Blank {
        grooves_mm: vec![(from - 10.0, from, 0.0), (from + width, 1e3, low)],
        ..Blank::uniform(height)
    };
    let mut cases = vec![
        (
            TurningSettings {
                length_mm: 92.33,
                beyond_mm: 2.18,
                ..safe()
            },
            Blank {
                grooves_mm: vec![(83.25, 93.21, 0.0)],
                ..Blank::outline(&[(0.0, 6.07), (94.37, 8.76), (94.37, 2.78), (200.0, 2.0)])
            },
        ),
        // Bridged by the edge, in a pass of equal depths.
        (
            shorter(fast(), 40.0),
            Blank {
                grooves_mm: vec![(24.0, 26.0, 0.0), (26.4, 1e3, 3.0)],
                ..Blank::uniform(7.0)
            },
        ),
    ];
    for height in [8.5, 10.0] {
        for (position, width) in [
            (-9.0, 1.2),
            (-1.0, 1.2),
            (-1.0, 1.8),
            (0.5, 1.2),
            (0.5, 1.8),
            (1.0, 1.8),
        ] {
            for (settings, low) in [(safe(), 0.0), (fast(), 0.0), (safe(), 3.0), (fast(), 3.0)] {
                cases.push((
                    shorter(settings, 40.0),
                    ridge(height, 40.0 + position, width, low),
                ));
            }
        }
    }
    for (case, (settings, blank)) in cases.iter().enumerate() {
        turn(*settings, blank, case as u64);
    }
}

#[test]
fn no_way_back_leads_through_stock_behind_a_groove() {
    // A pass ends in the groove, within two overhangs of the stock after it, whose height is not known to be
    // that of the pass.
    for case in 0..cases(24) {
        let settings = shorter([fast(), safe()][case % 2], 90.0);
        let width = 8.0 + (case / 2 % 6) as f64;
        let height = [8.0, 9.5][case / 12 % 2];
        let blank = Blank {
            grooves_mm: vec![(40.0, 40.0 + width, 0.0)],
            ..Blank::outline(&[
                (0.0, 1.5),
                (15.0, height),
                (90.0, height + 0.1),
                (200.0, height + 0.1),
            ])
        };
        let mut simulation = Simulation::new(settings, blank, law(), sensor(case as u64)).unwrap();
        while !simulation.controller.is_over() {
            let (output, cut) = simulation.step(TurningInputs::default(), None);
            let goes_back = matches!(output.state, TurningState::Return | TurningState::ReEnter);
            // A tool that draws out of a cut still cuts for a moment.
            let is_cut = cut.depth_mm > 0.5 && (output.along.velocity < -1.0 || output.out.velocity < -1.0);
            assert!(
                !(goes_back && is_cut),
                "case {case}: {:.2} mm deep at {:.2} mm, {:.2} mm high, pass {}",
                cut.depth_mm,
                output.along.position,
                output.out.position,
                output.pass
            );
        }
        assert_eq!(simulation.controller.state(), TurningState::Done, "case {case}");
        assert!(
            simulation.figures.peak <= 1.3 * SET,
            "case {case}: {:?}",
            simulation.figures
        );
    }
}

#[test]
fn hard_stock_ending_before_a_cut_is_no_lost_load() {
    // In harder material the load at the end of a cut falls faster than lead angle and force law say.
    let mut faults = Vec::new();
    for case in 0..cases(96) {
        let hard = [1.2, 1.34][case % 2];
        let height = 1.5 + 0.25 * (case / 2 % 12) as f64;
        let cone = (case / 24 % 2 == 0).then(|| Cone::new(20.0, 0.3));
        let base = if case / 48 == 0 { safe() } else { fast() };
        let settings = TurningSettings {
            cone,
            ..shorter(base, 48.0)
        };
        let blank = Blank {
            grooves_mm: vec![(39.0, 63.0, 0.0)],
            hard_spots: vec![(24.5, 70.0, hard)],
            ..Blank::uniform(height)
        };
        let (figures, _) = Simulation::new(settings, blank, law(), sensor(case as u64))
            .unwrap()
            .run(3000.0, |_, _| {});
        if !figures.done {
            faults.push((hard, height, cone.is_some(), case));
        }
    }
    assert!(faults.is_empty(), "{faults:?}");
}

#[test]
fn stock_ending_with_the_cut_is_no_fault() {
    let mut random = Random::from_state(0x5eed_0456_u64);
    for case in 0..cases(20) {
        let length_mm = random.between(20.0, 150.0);
        let mut blank = random_stock(&mut random);
        let end = length_mm
            + if case % 2 == 0 {
                0.0
            } else {
                random.between(0.0, 4.0)
            };
        // The stock between a groove and the end must not be a ridge narrower than the overhang of the edge,
        // which looks like a cut over the whole depth.
        blank.grooves_mm.retain(|groove| groove.1 < length_mm - 12.0);
        blank.grooves_mm.push((end, 1e3, 0.0));
        let base = if case % 3 == 0 { fast() } else { safe() };
        let figures = turn(shorter(base, length_mm), &blank, case as u64);
        assert!(figures.peak <= 1.3 * SET, "{}", figures.peak / SET);
    }
}

#[test]
fn a_hold_anywhere_near_the_shoulder_changes_nothing() {
    let settings = shorter(safe(), 25.0);
    let blank = Blank::uniform(7.0);
    let whole = turn(settings, &blank, 1).time_s;
    let mut random = Random::from_state(0x5eed_0789_u64);
    for case in 0..cases(30) {
        let at = random.between(0.0, whole);
        let mut simulation = Simulation::new(settings, blank.clone(), law(), sensor(case as u64)).unwrap();
        let mut part = Part::new(&settings, &blank);
        for cycle in 0..(3.0 * whole / PERIOD_S) as u64 {
            let now = cycle as f64 * PERIOD_S;
            let inputs = TurningInputs {
                hold: now >= at && now < at + 1.0,
                ..TurningInputs::default()
            };
            let (output, cut) = simulation.step(inputs, None);
            part.cut(output.along.position, output.out.position);
            assert!(
                cut.load <= 1.3 * SET,
                "{} at {now} s, hold at {at} s",
                cut.load / SET
            );
            if simulation.controller.is_over() {
                break;
            }
        }
        assert_eq!(
            simulation.controller.state(),
            TurningState::Done,
            "hold at {at} s"
        );
        assert!(part.deepest() < 1e-9 && part.left() <= 0.1, "hold at {at} s");
    }
}

#[test]
fn fixed_passes_leave_the_same_wall() {
    let settings = shorter(safe(), 40.0);
    let regime = regime(BackOff::Balanced);
    let nominal = (regime.depth_back_off_mm, regime.feed_back_off_mm_rev);
    for height in [3.0, 6.0, 9.5] {
        let figures = run_fixed_at_load(&settings, &Blank::uniform(height), law(), nominal, SET);
        assert!(
            figures.peak <= 1.021 * SET && figures.residual_mm <= 0.1,
            "{figures:?}"
        );
        assert!(figures.undercut_mm < 1e-9, "{figures:?}");
    }
}

//! Laws compared with printed and independently computed values, and with identities.

#![expect(
    clippy::unwrap_used,
    reason = "helpers of tests fail as tests do, and print their seed"
)]

use evolvent_cutting::{
    Cut, ForceError, ForceLaw, ForceTable, LawDefinition, LawError, PowerLaw, ToolAngles,
};
use evolvent_random::Random;

fn steel(rake_deg: f64, lead_deg: f64) -> ForceLaw {
    let definition = LawDefinition::built_in("40x-r1").unwrap();
    definition.law(ToolAngles { rake_deg, lead_deg }).unwrap()
}

fn cut(speed_m_min: f64, depth_mm: f64, feed_mm_rev: f64) -> Cut {
    Cut {
        speed_m_min,
        depth_mm,
        feed_mm_rev,
    }
}

/// Values computed independently from the formula, in another language.
#[test]
fn the_law_40x_r1_has_independently_computed_forces() {
    for (v, t, s, rake, lead, expected) in [
        (60.0, 4.0, 0.49, 10.0, 60.0, 3430.035994103838),
        (60.0, 2.0, 0.3, 10.0, 45.0, 1216.370309229079),
        (100.0, 1.0, 0.2, 0.0, 90.0, 433.3656966370234),
        (30.0, 3.0, 0.1, 15.0, 60.0, 550.790115574232),
        (15.0, 4.0, 0.6, -5.0, 60.0, 5869.645592460651),
        (5.0, 4.0, 0.49, 10.0, 60.0, 3357.180241321568),
        (38.0, 4.0, 0.49, 10.0, 60.0, 3753.7253771024275),
        (150.0, 4.0, 0.49, 10.0, 60.0, 3125.6780553195927),
    ] {
        let force = steel(rake, lead).force(cut(v, t, s)).unwrap().tangential_n;
        assert!(
            (force / expected - 1.0).abs() < 1e-13,
            "{v} {t} {s}: {force} {expected}"
        );
    }
}

/// Maximum at 38.33 m/min, minimum at 11.28, steepest fall -19.0274 N per m/min, between 10 and 70 m/min.
#[test]
fn the_law_40x_r1_rises_and_falls_as_in_the_figure() {
    let law = steel(10.0, 60.0);
    let at = |v: f64| law.force(cut(v, 4.0, 0.49)).unwrap();
    let (mut max, mut min, mut steepest) = ((0.0, 0.0_f64), (0.0, f64::INFINITY), 0.0_f64);
    for k in 0..=60_000 {
        let v = 10.0 + k as f64 * 1e-3;
        let force = at(v);
        if force.tangential_n > max.1 {
            max = (v, force.tangential_n);
        }
        if force.tangential_n < min.1 {
            min = (v, force.tangential_n);
        }
        steepest = steepest.min(force.per_speed);
    }
    assert!(
        (max.0 - 38.33).abs() < 0.01 && (max.1 - 3753.9432).abs() < 1e-3,
        "{max:?}"
    );
    assert!(
        (min.0 - 11.28).abs() < 0.01 && (min.1 - 3253.1849).abs() < 1e-3,
        "{min:?}"
    );
    assert!((steepest + 19.027_397_79).abs() < 1e-5, "{steepest}");
}

fn derivatives_agree(
    law: &ForceLaw,
    random: &mut Random,
    speeds: [f64; 2],
    depths: [f64; 2],
    feeds: [f64; 2],
) {
    for _ in 0..300 {
        let at = cut(
            random.between(speeds[0], speeds[1]),
            random.between(depths[0], depths[1]),
            random.between(feeds[0], feeds[1]),
        );
        let force = law.force(at).unwrap();
        let value = |v: f64, t: f64, s: f64| law.force(cut(v, t, s)).unwrap().tangential_n;
        let Cut {
            speed_m_min: v,
            depth_mm: t,
            feed_mm_rev: s,
        } = at;
        let h = 1e-5;
        for (x, derivative, difference) in [
            (
                v,
                force.per_speed,
                value(v * (1.0 + h), t, s) - value(v * (1.0 - h), t, s),
            ),
            (
                t,
                force.per_depth,
                value(v, t * (1.0 + h), s) - value(v, t * (1.0 - h), s),
            ),
            (
                s,
                force.per_feed,
                value(v, t, s * (1.0 + h)) - value(v, t, s * (1.0 - h)),
            ),
        ] {
            let error = (x * derivative - difference / (2.0 * h)).abs() / force.tangential_n;
            assert!(
                error < 1e-6,
                "{at:?}: {derivative} is off by {error} of the force"
            );
        }
        let section = law.section(s).unwrap().force(v, t).unwrap();
        assert_eq!(section.tangential_n, force.tangential_n);
        assert_eq!(
            (section.per_speed, section.per_depth),
            (force.per_speed, force.per_depth)
        );
    }
}

#[test]
fn derivatives_agree_with_differences() {
    let mut random = Random::seeded(0x0c07_7106);
    for (rake, lead) in [(10.0, 60.0), (-10.0, 45.0), (25.0, 90.0)] {
        derivatives_agree(
            &steel(rake, lead),
            &mut random,
            [3.0, 200.0],
            [0.05, 6.0],
            [0.08, 0.7],
        );
    }
    derivatives_agree(
        &power().into(),
        &mut random,
        [3.0, 200.0],
        [0.05, 6.0],
        [0.08, 0.7],
    );
    let (speeds, depths, feeds) = (
        [10.0, 20.0, 45.0, 60.0, 100.0],
        [0.5, 1.0, 4.0],
        [0.1, 0.3, 0.35, 0.7],
    );
    let law = steel(10.0, 60.0);
    let force_n = sampled(&feeds, &depths, &speeds, |at| law.force(at).unwrap().tangential_n);
    let table = ForceTable::new(&speeds, &depths, &feeds, &force_n, [None; 3]).unwrap();
    derivatives_agree(
        &table.into(),
        &mut random,
        [10.01, 99.9],
        [0.05, 3.99],
        [0.03, 0.699],
    );
}

fn power() -> PowerLaw {
    PowerLaw {
        coefficient_n: 2943.0,
        factor: 1.1,
        speed_exponent: -0.15,
        depth_exponent: 1.0,
        feed_exponent: 0.75,
    }
}

fn sampled(feeds: &[f64], depths: &[f64], speeds: &[f64], force: impl Fn(Cut) -> f64) -> Vec<Vec<Vec<f64>>> {
    let row = |s: f64, t: f64| speeds.iter().map(|&v| force(cut(v, t, s))).collect();
    let rows = |s: f64| depths.iter().map(|&t| row(s, t)).collect();
    feeds.iter().map(|&s| rows(s)).collect()
}

#[test]
fn a_table_of_a_power_law_is_that_power_law() {
    let law = ForceLaw::from(power().checked().unwrap());
    let closed = |v: f64, t: f64, s: f64| 2943.0 * 1.1 * v.powf(-0.15) * t * s.powf(0.75);
    let mut random = Random::seeded(0x0c07_7106);
    for (speeds, depths, feeds) in [
        (
            &[10.0, 11.0, 40.0, 200.0][..],
            &[0.5, 4.0, 5.0][..],
            &[0.1, 0.2, 0.7][..],
        ),
        (&[10.0, 200.0], &[5.0], &[0.7]),
        (&[10.0, 80.0, 200.0], &[1.0, 5.0], &[0.7]),
    ] {
        let force_n = sampled(feeds, depths, speeds, |at| law.force(at).unwrap().tangential_n);
        let exponents = [None, Some(1.0), Some(0.75)];
        let table = ForceLaw::from(ForceTable::new(speeds, depths, feeds, &force_n, exponents).unwrap());
        for _ in 0..200 {
            let (v, t, s) = (
                random.between(10.0, 200.0),
                random.between(0.01, 5.0),
                random.between(0.02, 0.7),
            );
            let (force, expected) = (table.force(cut(v, t, s)).unwrap(), closed(v, t, s));
            assert!((force.tangential_n / expected - 1.0).abs() < 1e-12);
            assert!((force.per_speed * v / expected + 0.15).abs() < 1e-11);
            assert!((force.per_depth * t / expected - 1.0).abs() < 1e-11);
            assert!((force.per_feed * s / expected - 0.75).abs() < 1e-11);
        }
    }
}

#[test]
fn a_fine_table_follows_the_law_it_was_sampled_from() {
    let law = steel(10.0, 60.0);
    let speeds: Vec<f64> = (0..=60).map(|k| 5.0 * 40_f64.powf(k as f64 / 60.0)).collect();
    let force_n = sampled(&[0.49], &[4.0], &speeds, |at| law.force(at).unwrap().tangential_n);
    let table = ForceTable::new(&speeds, &[4.0], &[0.49], &force_n, [None, Some(0.852), Some(0.8)]).unwrap();
    let table = ForceLaw::from(table);
    let mut random = Random::seeded(0x0c07_7106);
    for _ in 0..300 {
        let at = cut(random.between(6.0, 180.0), random.between(0.1, 6.0), 0.49);
        let (force, expected) = (table.force(at).unwrap(), law.force(at).unwrap());
        assert!((force.tangential_n / expected.tangential_n - 1.0).abs() < 1e-4);
        assert!((force.per_speed - expected.per_speed).abs() * at.speed_m_min < 1e-2 * expected.tangential_n);
    }
}

#[test]
fn what_is_outside_is_refused_with_its_numbers() {
    let law = steel(10.0, 60.0);
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let same = |a: f64| a.to_bits() == bad.to_bits();
        assert!(
            matches!(law.force(cut(bad, 4.0, 0.49)), Err(ForceError::Speed { speed_m_min }) if same(speed_m_min))
        );
        assert!(
            matches!(law.force(cut(60.0, bad, 0.49)), Err(ForceError::Depth { depth_mm }) if same(depth_mm))
        );
        assert!(
            matches!(law.force(cut(60.0, 4.0, bad)), Err(ForceError::Feed { feed_mm_rev }) if same(feed_mm_rev))
        );
    }
    let table = ForceTable::new(
        &[10.0, 90.0],
        &[1.0],
        &[0.3],
        &[vec![vec![900.0, 800.0]]],
        [None, Some(1.0), Some(0.8)],
    );
    let table = ForceLaw::from(table.unwrap());
    let error = table.force(cut(95.0, 1.0, 0.3)).unwrap_err();
    assert!(
        error.to_string().contains("95 m/min") && error.to_string().contains("10 to 90"),
        "{error}"
    );
    assert!(table.force(cut(9.0, 1.0, 0.3)).is_err() && table.force(cut(50.0, 7.0, 0.9)).is_ok());
}

/// `(f k5)^2 / (4 g k6)` is 0.7872 at 10 degrees and reaches 1 at 30.7 degrees, at any feed.
#[test]
fn rake_angles_with_a_pole_are_refused() {
    let definition = LawDefinition::built_in("40X-R1").unwrap();
    let with = |rake_deg| {
        definition.law(ToolAngles {
            rake_deg,
            lead_deg: 60.0,
        })
    };
    assert!(with(30.5).is_ok());
    let Err(LawError::Pole { ratio, .. }) = with(30.9) else {
        panic!("30.9 degrees have a pole")
    };
    assert!((1.0..1.01).contains(&ratio));
    assert!(matches!(with(f64::NAN), Err(LawError::Number { .. })));
    assert!(with(45.0).unwrap_err().to_string().contains("pole"));
}

#[test]
fn a_pole_at_some_feeds_only_is_refused_at_those() {
    let text =
        include_str!("../../../../config/laws/40x-r1.toml").replace("g = [356.4, -2.0]", "g = [356.4, -1.5]");
    let law = LawDefinition::parse(&text, "law.toml").unwrap();
    let law = law
        .law(ToolAngles {
            rake_deg: 10.0,
            lead_deg: 60.0,
        })
        .unwrap();
    // The ratio is proportional to S^-0.5: 0.7872 at 1 mm/rev, 1 at 0.62 mm/rev.
    assert!(law.force(cut(60.0, 4.0, 0.63)).is_ok());
    assert!(matches!(law.force(cut(60.0, 4.0, 0.61)), Err(ForceError::Pole { ratio, .. }) if ratio > 1.0));
}

#[test]
fn extrapolation_is_told() {
    let law = steel(10.0, 60.0);
    assert!(law.covers(cut(10.0, 4.0, 0.49)) && law.covers(cut(70.0, 1.0, 0.2)));
    assert!(!law.covers(cut(93.0, 4.0, 0.49)) && !law.covers(cut(9.9, 4.0, 0.49)));
    assert_eq!(law.radial_ratio(), 0.4);
}

#[test]
fn tables_that_make_no_law_are_refused() {
    let new = |speeds: &[f64], forces: Vec<f64>, exponents| {
        ForceTable::new(speeds, &[1.0], &[0.3], &[vec![forces]], exponents)
    };
    let (one, exponents) = (Some(1.0), [None, Some(1.0), Some(0.8)]);
    assert!(new(&[10.0, 20.0], vec![1.0, 2.0], exponents).is_ok());
    for speeds in [
        &[20.0, 10.0][..],
        &[10.0, 10.0],
        &[0.0, 10.0],
        &[f64::NAN, 10.0],
        &[-1.0, 1.0],
        &[1.0, f64::INFINITY],
    ] {
        assert!(matches!(
            new(speeds, vec![1.0, 2.0], exponents),
            Err(LawError::Axis { axis: "speed", .. })
        ));
    }
    assert!(matches!(
        new(&[10.0], vec![1.0], [None, one, one]),
        Err(LawError::NoExponent { axis: "speed" })
    ));
    assert!(matches!(new(&[], vec![], exponents), Err(LawError::Axis { .. })));
    assert!(matches!(
        new(&[10.0, 20.0], vec![1.0], exponents),
        Err(LawError::Shape { speeds: 2, .. })
    ));
    assert!(matches!(
        new(&[10.0, 20.0], vec![1.0, 0.0], exponents),
        Err(LawError::Number { .. })
    ));
    assert!(matches!(
        new(&[10.0, 20.0], vec![1.0, f64::NAN], exponents),
        Err(LawError::Number { .. })
    ));
}

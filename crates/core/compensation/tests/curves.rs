//! Curves through tables: reference values from a dense exact system of truncated powers, and properties of random tables.

use evolvent_compensation::{ScrewTable, TableError};
use evolvent_random::Random;

/// Reference values computed in rational arithmetic: the system of truncated powers (x - k)^3 over all knots, by elimination.
#[test]
fn a_curve_agrees_with_an_exact_dense_system() {
    let six = (
        vec![-50.0, -20.0, 10.0, 30.0, 75.0, 120.0],
        vec![0.004, -0.003, 0.001, 0.007, -0.002, 0.005],
    );
    let two = (vec![0.0, 10.0], vec![0.002, -0.006]);
    let three = (vec![0.0, 10.0, 20.0], vec![0.0, 0.01, -0.004]);
    let expected = [
        (
            &six,
            -45.0,
            [
                3.947976335725e-3,
                -3.121419856484e-5,
                -1.248567942594e-5,
                -2.497135885187e-6,
            ],
        ),
        (
            &six,
            -31.0,
            [
                1.225705682045e-3,
                -3.904718861799e-4,
                -1.731501127034e-5,
                5.035506751866e-6,
            ],
        ),
        (
            &six,
            -5.0,
            [
                -3.466499162479e-3,
                1.737111483343e-4,
                2.192443699981e-5,
                -1.076741733358e-6,
            ],
        ),
        (
            &six,
            22.0,
            [
                5.391763260748e-3,
                3.004124325330e-4,
                -1.927861529872e-5,
                -2.087660524846e-6,
            ],
        ),
        (
            &six,
            60.0,
            [
                2.593212978473e-4,
                -2.931261244494e-4,
                1.114626631098e-5,
                1.570872193616e-6,
            ],
        ),
        (
            &six,
            80.0,
            [
                -1.362475768570e-3,
                1.941591818259e-4,
                2.263792671634e-5,
                -2.414284499774e-6,
            ],
        ),
        (
            &six,
            110.0,
            [
                4.854725540521e-3,
                4.358233784377e-5,
                -8.716467568754e-6,
                8.716467568754e-7,
            ],
        ),
        (&two, 2.0, [1.658666666667e-3, -5.12e-4, -5.12e-4, -2.56e-4]),
        (&two, 5.0, [-2e-3, -1.6e-3, 0.0, 2.56e-4]),
        (&two, 6.5, [-4.256e-3, -1.312e-3, 3.84e-4, 2.56e-4]),
        (&two, 9.0, [-5.957333333333e-3, -1.28e-4, 2.56e-4, -2.56e-4]),
        (&three, 3.0, [5.76e-4, 5.76e-4, 3.84e-4, 1.28e-4]),
        (&three, 12.0, [6.917333333333e-3, -2.384e-3, -5.44e-4, 4.48e-4]),
        (&three, 19.0, [-3.973333333333e-3, -8e-5, 1.6e-4, -1.6e-4]),
    ];
    for ((positions, values), position, derivatives) in expected {
        let table = ScrewTable::new(positions, values, None).unwrap();
        let at = table.mean().at(position);
        for (order, (at, expected)) in at.iter().zip(derivatives).enumerate() {
            assert!(
                (at - expected).abs() <= 1e-14,
                "order {order} at {position}: {at} instead of {expected}"
            );
        }
    }
}

#[test]
fn a_random_curve_is_smooth_and_within_its_maxima() {
    let mut random = Random::seeded(16_701);
    for _ in 0..300 {
        let (positions, values) = random_table(&mut random);
        let table = ScrewTable::new(&positions, &values, None).unwrap();
        let curve = table.mean();
        let maxima = curve.maxima();
        for (position, value) in positions.iter().zip(&values) {
            assert!((curve.at(*position)[0] - value).abs() <= 1e-13);
        }
        let (low, high) = (positions[0], positions[positions.len() - 1]);
        assert_eq!(curve.at(low - 1.0), [values[0], 0.0, 0.0, 0.0]);
        assert_eq!(curve.at(high + 1.0), [values[values.len() - 1], 0.0, 0.0, 0.0]);
        let steps = 20_000;
        let mut before = curve.at(low - 1.0);
        let width = (high - low + 2.0) / f64::from(steps);
        for step in 1..=steps {
            let position = low - 1.0 + f64::from(step) * width;
            let now = curve.at(position);
            for order in 0..3 {
                // A derivative without steps changes by at most the maximum of the next one times the interval.
                let max = maxima[order + 1].0 * width * (1.0 + 1e-9) + 1e-12;
                assert!(
                    (now[order] - before[order]).abs() <= max,
                    "order {order} at {position}"
                );
            }
            for order in 0..4 {
                assert!(
                    now[order].abs() <= maxima[order].0 * (1.0 + 1e-9) + 1e-15,
                    "order {order}"
                );
            }
            before = now;
        }
        for (order, (max, position)) in maxima.into_iter().enumerate() {
            let near = [curve.at(position), curve.at(position - 1e-9)].map(|at| at[order].abs());
            assert!(
                near.into_iter()
                    .any(|near| (near - max).abs() <= 1e-5 * max + 1e-15),
                "order {order}"
            );
        }
    }
}

#[test]
fn invalid_tables_are_rejected() {
    let ok = [0.0, 0.01, 0.0];
    assert!(ScrewTable::new(&[0.0, 1.0, 2.0], &ok, Some(&ok)).is_ok());
    assert_eq!(ScrewTable::new(&[0.0], &[0.0], None), Err(TableError::Points(1)));
    assert!(matches!(
        ScrewTable::new(&[0.0, 1.0, 2.0], &ok[..2], None),
        Err(TableError::Lengths { .. })
    ));
    assert!(matches!(
        ScrewTable::new(&[0.0, 2.0, 1.0], &ok, None),
        Err(TableError::Order { index: 2, .. })
    ));
    assert!(matches!(
        ScrewTable::new(&[0.0, 0.0, 1.0], &ok, None),
        Err(TableError::Order { index: 1, .. })
    ));
    assert!(matches!(
        ScrewTable::new(&[0.0, f64::NAN, 1.0], &ok, None),
        Err(TableError::Value { index: 1, .. })
    ));
    assert!(matches!(
        ScrewTable::new(&[0.0, 1.0, 2.0], &ok, Some(&[0.0, 0.0, f64::INFINITY])),
        Err(TableError::Value { index: 2, .. })
    ));
}

/// 2 to 40 points, 5 to 60 mm apart, within 20 um.
pub(crate) fn random_table(random: &mut Random) -> (Vec<f64>, Vec<f64>) {
    let points = random.below(39) + 2;
    let mut position = random.between(-500.0, 100.0);
    (0..points)
        .map(|_| {
            position += random.between(5.0, 60.0);
            (position, random.between(-0.02, 0.02))
        })
        .unzip()
}

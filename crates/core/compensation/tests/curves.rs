//! Curves through tables: reference values from a dense exact system of truncated powers, and properties of
//! random tables.

use evolvent_compensation::{ScrewTable, TableError};
use evolvent_random::Random;

/// Reference values computed in rational arithmetic: the natural spline from the system of truncated powers
/// (x - k)^3 over all knots, by elimination; beyond the table the integral of a slope that falls to zero by
/// two parabolas.
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
            -85.0,
            [
                8.655152051963e-03,
                0.000000000000e+00,
                0.000000000000e+00,
                0.000000000000e+00,
            ],
        ),
        (
            &six,
            -72.0,
            [
                8.537451417366e-03,
                -4.413773797417e-05,
                -1.103443449354e-05,
                -1.379304311693e-06,
            ],
        ),
        (
            &six,
            -55.0,
            [
                5.522981844161e-03,
                -2.931021662347e-04,
                -6.896521558464e-06,
                1.379304311693e-06,
            ],
        ),
        (
            &six,
            -45.0,
            [
                2.458978501679e-03,
                -3.039259587311e-04,
                2.567004559919e-06,
                5.134009119837e-07,
            ],
        ),
        (
            &six,
            -31.0,
            [
                -1.309623123271e-03,
                -2.176746055178e-04,
                9.754617327691e-06,
                5.134009119837e-07,
            ],
        ),
        (
            &six,
            -5.0,
            [
                -2.525907883082e-03,
                1.379293376636e-04,
                1.356362562740e-05,
                -1.225601154742e-07,
            ],
        ),
        (
            &six,
            22.0,
            [
                5.149621493947e-03,
                3.118626119476e-04,
                -1.434740675130e-05,
                -2.172719220549e-06,
            ],
        ),
        (
            &six,
            60.0,
            [
                1.699898303973e-03,
                -3.091854476265e-04,
                2.613041148618e-06,
                1.144740055477e-06,
            ],
        ),
        (
            &six,
            80.0,
            [
                -2.467890421012e-03,
                -4.778145924687e-05,
                1.758590398291e-05,
                -4.396475995728e-07,
            ],
        ),
        (
            &six,
            110.0,
            [
                2.033908395815e-03,
                2.819542404327e-04,
                4.396475995728e-06,
                -4.396475995728e-07,
            ],
        ),
        (
            &six,
            130.0,
            [
                7.939304765295e-03,
                2.739181887658e-04,
                -6.003686329114e-06,
                -6.003686329114e-07,
            ],
        ),
        (
            &six,
            155.0,
            [
                1.173851252044e-02,
                3.001843164557e-05,
                -6.003686329114e-06,
                6.003686329114e-07,
            ],
        ),
        (
            &six,
            166.0,
            [
                1.183857395926e-02,
                0.000000000000e+00,
                0.000000000000e+00,
                0.000000000000e+00,
            ],
        ),
        (
            &two,
            -3.0,
            [
                4.256000000000e-03,
                -6.560000000000e-04,
                -9.600000000000e-05,
                3.200000000000e-05,
            ],
        ),
        (
            &two,
            2.0,
            [
                4.000000000000e-04,
                -8.000000000000e-04,
                0.000000000000e+00,
                0.000000000000e+00,
            ],
        ),
        (
            &two,
            5.0,
            [
                -2.000000000000e-03,
                -8.000000000000e-04,
                0.000000000000e+00,
                0.000000000000e+00,
            ],
        ),
        (
            &two,
            9.0,
            [
                -5.200000000000e-03,
                -8.000000000000e-04,
                0.000000000000e+00,
                0.000000000000e+00,
            ],
        ),
        (
            &two,
            13.0,
            [
                -8.256000000000e-03,
                -6.560000000000e-04,
                9.600000000000e-05,
                3.200000000000e-05,
            ],
        ),
        (
            &two,
            18.0,
            [
                -9.957333333333e-03,
                -6.400000000000e-05,
                6.400000000000e-05,
                -3.200000000000e-05,
            ],
        ),
        (
            &three,
            -6.0,
            [
                -7.317333333333e-03,
                5.120000000000e-04,
                2.560000000000e-04,
                6.400000000000e-05,
            ],
        ),
        (
            &three,
            3.0,
            [
                4.638000000000e-03,
                1.438000000000e-03,
                -1.080000000000e-04,
                -3.600000000000e-05,
            ],
        ),
        (
            &three,
            12.0,
            [
                8.928000000000e-03,
                -8.480000000000e-04,
                -2.880000000000e-04,
                3.600000000000e-05,
            ],
        ),
        (
            &three,
            19.0,
            [
                -2.006000000000e-03,
                -1.982000000000e-03,
                -3.600000000000e-05,
                3.600000000000e-05,
            ],
        ),
        (
            &three,
            24.0,
            [
                -1.114666666667e-02,
                -1.360000000000e-03,
                3.200000000000e-04,
                8.000000000000e-05,
            ],
        ),
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
        let last = values.len() - 1;
        // Constant from the length of the interval at the end on; half of what the slope at the end would
        // have given.
        let beyond = [
            (low, positions[0] - positions[1], values[0]),
            (high, positions[last] - positions[last - 1], values[last]),
        ];
        for (end, length, value) in beyond {
            let [constant, first, second, third] = curve.at(end + 1.001 * length);
            assert_eq!([first, second, third], [0.0; 3]);
            let slope = curve.at(end)[1];
            assert!((constant - value - 0.5 * slope * length).abs() <= 1e-13);
            assert!(curve.at(end)[2].abs() <= 1e-15);
        }
        let steps = 20_000;
        let mut before = curve.at(low - 61.0);
        let width = (high - low + 122.0) / f64::from(steps);
        for step in 1..=steps {
            let position = low - 61.0 + f64::from(step) * width;
            let now = curve.at(position);
            for order in 0..3 {
                // A derivative without steps changes by at most the maximum of the next one times the
                // interval.
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

/// A laser measures 0.2 um per mm over the whole screw, at any positions.
#[test]
fn a_uniform_error_of_pitch_stays_uniform() {
    for positions in [
        vec![0.0, 800.0],
        vec![0.0, 3.0, 800.0],
        (0..9).map(|i| 100.0 * f64::from(i)).collect(),
    ] {
        let values: Vec<f64> = positions.iter().map(|position| 2e-4 * position).collect();
        let table = ScrewTable::new(&positions, &values, None).unwrap();
        for position in [0.0, 1.0, 25.0, 50.0, 100.0, 150.0, 200.0, 600.0, 775.0, 799.999] {
            let [value, slope, ..] = table.mean().at(position);
            assert!((value - 2e-4 * position).abs() <= 1e-15, "{value} at {position}");
            assert!((slope - 2e-4).abs() <= 1e-17, "{slope} at {position}");
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

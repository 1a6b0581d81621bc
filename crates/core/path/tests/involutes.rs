//! Involutes against their definition.

use std::f64::consts::PI;

use evolvent_path::Curve;
use nalgebra::Vector3;

use crate::gallery::{ROLLED, Rolled, speed};

#[test]
fn involutes_agree_with_the_papers_formula_over_10_m() {
    // r/2 (60 pi)^2 = 11.2 m of path; equation (2) and phi(s) in f64 are accurate to about 1e-12 mm.
    for handed in [1.0, -1.0] {
        for phi in [[0.0, 60.0 * PI], [60.0 * PI, 0.0], [3.0, 60.0 * PI]] {
            let planted = Rolled {
                handed,
                phi,
                centre: [20.0, -30.0],
                climb: 5.0,
                ..ROLLED
            };
            let curve = Curve::from(planted.curve(1e-6));
            let planar = 0.5 * planted.r * (phi[1] * phi[1] - phi[0] * phi[0]);
            assert!((curve.length() - planar.hypot(5.0)).abs() <= 1e-10);
            for i in 0..=1000 {
                let x = f64::from(i) / 1000.0;
                let at = (phi[0] * phi[0] + x * (phi[1] * phi[1] - phi[0] * phi[0]))
                    .max(0.0)
                    .sqrt();
                let error = (curve.at(curve.length() * x).position - planted.point(at)).amax();
                assert!(error <= 1e-11, "{handed} {phi:?} {x}: {error:e}");
            }
        }
    }
}

#[test]
fn an_involutes_evolute_is_its_base_circle() {
    for (handed, phi) in [(1.0, [0.0, 40.0]), (-1.0, [0.3, 40.0]), (1.0, [40.0, 0.0])] {
        let planted = Rolled {
            handed,
            phi,
            centre: [100.0, 50.0],
            ..ROLLED
        };
        let curve = Curve::from(planted.curve(1e-6));
        for i in 1..100 {
            let jet = curve.jet(curve.domain() * f64::from(i) / 100.0).by_arc_length();
            let centre = jet.position + jet.second / jet.second.norm_squared();
            let distance = (centre[0] - 100.0).hypot(centre[1] - 50.0);
            assert!((distance - planted.r).abs() <= 1e-11, "{distance}");
        }
    }
}

#[test]
fn involute_has_finite_jets_at_base_circle() {
    let planted = Rolled {
        phi: [0.0, 10.0],
        root: 0.0,
        ..ROLLED
    };
    let curve = Curve::from(planted.curve(1e-6));
    // By arc length the curvature is infinite there, by the regular parameter every derivative is finite.
    assert_eq!(curve.curvature(0.0), f64::INFINITY);
    assert_eq!(curve.curvature_derivative(0.0), f64::NEG_INFINITY);
    assert!((curve.tangent(0.0) - Vector3::x()).norm() <= 1e-15);
    let jet = curve.jet(0.0);
    assert!(jet.is_finite() && jet.first.norm() == 0.0);
    assert!(
        (jet.second.normalize()[0] - 1.0).abs() <= 1e-15,
        "sets off along the tangent"
    );
}

#[test]
fn speed_by_the_regular_parameter_rises_smoothly_to_1() {
    let curve = Curve::from(ROLLED.curve(1e-6));
    let mut last = -1.0;
    for i in 0..=2000 {
        let now = speed(&curve.jet(2.0 * f64::from(i) / 2000.0).first);
        assert!(now >= last - 1e-14 && now <= 1.0 + 1e-14);
        last = now;
    }
    assert!((last - 1.0).abs() <= 1e-14);
}

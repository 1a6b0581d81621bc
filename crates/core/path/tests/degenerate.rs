//! Degenerate input: tiny, huge, flat, closed and invalid curves. Each case states why it is difficult.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use evolvent_path::{Arc, Axes, Blend, Curve, CurveError, Involute, InvoluteError, Jet, Line, Plane, Sense};

fn xyz(x: f64, y: f64, z: f64) -> Axes {
    let mut axes = Axes::zeros();
    (axes[0], axes[1], axes[2]) = (x, y, z);
    axes
}

fn ccw(start: Axes, end: Axes, centre: [f64; 2], turns: u32) -> Result<Arc, CurveError> {
    Arc::new(Plane::Xy, start, end, centre, Sense::CounterClockwise, turns)
}

#[test]
fn a_line_without_length_is_rejected() {
    let point = Axes::repeat(3.0);
    assert_eq!(Line::new(point, point), Err(CurveError::ZeroLength));
    // So short that its length underflows: it has no direction.
    assert_eq!(
        Line::new(Axes::zeros(), Axes::repeat(1e-200)),
        Err(CurveError::ZeroLength)
    );
}

#[test]
fn feed_length_is_xyz_then_uvw_then_abc() {
    let mut end = Axes::zeros();
    (end[3], end[4]) = (30.0, 40.0);
    assert_eq!(Curve::from(Line::new(Axes::zeros(), end).unwrap()).length(), 50.0);
    (end[6], end[8]) = (3.0, 4.0);
    assert_eq!(Curve::from(Line::new(Axes::zeros(), end).unwrap()).length(), 5.0);
    (end[0], end[2]) = (-0.6, 0.8);
    assert_eq!(Curve::from(Line::new(Axes::zeros(), end).unwrap()).length(), 1.0);
}

#[test]
fn every_constructor_rejects_invalid_numbers() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -2e9] {
        for axis in 0..9 {
            let (good, mut point) = (xyz(10.0, 0.0, 0.0), xyz(0.0, 10.0, 0.0));
            point[axis] = bad;
            for (a, b) in [(good, point), (point, good)] {
                assert!(matches!(Line::new(a, b), Err(CurveError::Coordinate { .. })));
                assert!(matches!(
                    ccw(a, b, [0.0; 2], 0),
                    Err(CurveError::Coordinate { .. })
                ));
                let involute = Involute::new(Plane::Xy, a, b, [0.0; 2], 1.0, Sense::Clockwise, 1.0);
                assert!(matches!(involute, Err(InvoluteError::Coordinate { .. })));
                let blend = Blend::hermite(&Jet::at_rest(a), &Jet::at_rest(b), 1.0);
                assert!(matches!(blend, Err(CurveError::Coordinate { .. })));
            }
        }
        let (a, b) = (xyz(10.0, 0.0, 0.0), xyz(0.0, 10.0, 0.0));
        assert!(matches!(ccw(a, b, [bad, 0.0], 0), Err(CurveError::Centre { .. })));
        for (centre, r) in [([bad, 0.0], 1.0), ([0.0, bad], 1.0), ([0.0, 0.0], bad)] {
            let involute = Involute::new(Plane::Xy, a, b, centre, r, Sense::Clockwise, 1.0);
            assert!(matches!(involute, Err(InvoluteError::BaseCircle { .. })));
        }
        assert!(matches!(
            Blend::hermite(&Jet::at_rest(a), &Jet::at_rest(b), bad),
            Err(CurveError::Domain { .. })
        ));
        let jet = Jet {
            second: Axes::repeat(bad * 1e10),
            ..Jet::at_rest(a)
        };
        let blend = Blend::hermite(&jet, &Jet::at_rest(b), 1.0);
        assert!(matches!(blend, Err(CurveError::Derivative { order: 2, .. })));
    }
}

#[test]
fn arc_rejects_invalid_radius_sense_and_turns() {
    let (a, b) = (xyz(10.0, 0.0, 0.0), xyz(0.0, 10.0, 0.0));
    assert!(matches!(
        ccw(a, b, [10.0, 0.0], 0),
        Err(CurveError::Radius {
            start_radius_mm: 0.0,
            ..
        })
    ));
    assert!(matches!(
        ccw(a, b, [0.0, 10.0], 0),
        Err(CurveError::Radius {
            end_radius_mm: 0.0,
            ..
        })
    ));
    assert!(matches!(
        ccw(a, b, [0.0; 2], u32::MAX),
        Err(CurveError::Turns { .. })
    ));
    assert_eq!(
        Arc::new(Plane::Xy, a, b, [0.0; 2], Sense::Straight, 0),
        Err(CurveError::Sense)
    );
}

#[test]
fn flat_arcs_keep_their_sagitta() {
    // Radius 100 km, chord c: the sagitta is c^2 / 8R = 1.25e-7 mm for 10 mm, a thousandth of what the
    // rounding of a coordinate near the centre would leave.
    let radius = 1e8;
    for chord in [10.0, 100.0, 1e4] {
        let arc: Curve = ccw(xyz(0.0, 0.0, 0.0), xyz(chord, 0.0, 0.0), [0.5 * chord, radius], 0)
            .unwrap()
            .into();
        let depth = -arc.position(0.5 * arc.length())[1];
        let expected = chord * chord / (8.0 * radius);
        assert!(
            (depth - expected).abs() <= 1e-7 * expected,
            "{chord}: {depth:e} {expected:e}"
        );
        assert!((arc.length() - chord).abs() <= 1e-9 * chord);
    }
}

#[test]
fn the_length_of_an_arc_of_1e_9_rad_is_its_chord() {
    for radius in [1.0, 1e3, 1e8] {
        let chord = 1e-9 * radius;
        let arc: Curve = ccw(xyz(0.0, 0.0, 0.0), xyz(chord, 0.0, 0.0), [0.0, radius], 0)
            .unwrap()
            .into();
        assert!((arc.length() - chord).abs() <= 1e-9 * chord);
        assert!((arc.curvature(0.5 * chord) - 1.0 / radius).abs() <= 1e-6 / radius);
    }
}

#[test]
fn ends_equal_within_rounding_make_a_full_circle() {
    let start = xyz(1e5, 0.1 + 0.2, 0.0);
    for end in [start, xyz(1e5, 0.3, 0.0)] {
        let circle: Curve = ccw(start, end, [1e5 - 50.0, 0.3], 0).unwrap().into();
        assert!(
            (circle.length() - TAU * 50.0).abs() <= 1e-9,
            "{}",
            circle.length()
        );
    }
}

#[test]
fn a_helix_has_the_length_of_the_unrolled_triangle() {
    let helix: Curve = ccw(xyz(10.0, 0.0, 0.0), xyz(0.0, 10.0, 30.0), [0.0; 2], 2)
        .unwrap()
        .into();
    assert!((helix.length() - (4.5 * PI * 10.0).hypot(30.0)).abs() <= 1e-12 * 200.0);
    // Curvature of a helix: r / (r^2 + (h / 2 pi)^2) with pitch h.
    let slope: f64 = 30.0 / (4.5 * PI);
    assert!((helix.curvature(7.0) - 10.0 / (100.0 + slope * slope)).abs() <= 1e-15);
    assert!((helix.jet(3.0).second - helix.at(3.0).second).amax() == 0.0);
    // A million turns: the angle's rounding is 5e-10 rad.
    let long: Curve = ccw(xyz(1.0, 0.0, 0.0), xyz(-1.0, 0.0, 0.0), [0.0; 2], 1_000_000)
        .unwrap()
        .into();
    let near_end = long.position(long.length() - FRAC_PI_2);
    assert!((near_end - xyz(0.0, 1.0, 0.0)).amax() <= 4e-9, "{near_end}");
}

#[test]
fn two_radii_are_interpolated_over_the_angle() {
    let arc: Curve = ccw(xyz(10.0, 0.0, 0.0), xyz(-10.02, 0.0, 0.0), [0.0; 2], 0)
        .unwrap()
        .into();
    for i in 0..=10 {
        let x = f64::from(i) / 10.0;
        let p = arc.position(arc.domain() * x);
        assert!((p[0].hypot(p[1]) - (10.0 + 0.02 * x)).abs() <= 1e-13);
        assert!((p[1].atan2(p[0]) - PI * x).abs() <= 1e-14);
    }
}

fn involute(start: Axes, end: Axes, r: f64, tolerance: f64) -> Result<Involute, InvoluteError> {
    Involute::new(
        Plane::Xy,
        start,
        end,
        [0.0; 2],
        r,
        Sense::CounterClockwise,
        tolerance,
    )
}

/// The involute of a circle of radius 1 about the origin, from (1, 0) counter-clockwise.
fn unit(phi: f64) -> Axes {
    xyz(phi.cos() + phi * phi.sin(), phi.sin() - phi * phi.cos(), 0.0)
}

#[test]
fn an_involute_of_more_than_100_turns_is_rejected() {
    for turns in [0.1, 1.0, 7.3, 99.9] {
        let curve = involute(unit(1.0), unit(1.0 + turns * TAU), 1.0, 1e-9).unwrap();
        let (from, to) = curve.roll_angles_rad();
        assert!((from - 1.0).abs() <= 1e-13 && ((to - from) / TAU - turns).abs() <= 1e-12);
    }
    let error = involute(unit(1.0), unit(1.0 + 100.1 * TAU), 1.0, 1e-9).unwrap_err();
    assert!(matches!(error, InvoluteError::Turns { turns } if (turns - 100.1).abs() < 1e-6));
}

#[test]
fn points_inside_the_base_circle_are_rejected() {
    let inside = xyz(0.0, 0.5, 0.0);
    let error = involute(inside, unit(5.0), 1.0, 1e-3).unwrap_err();
    assert_eq!(
        error,
        InvoluteError::StartInside {
            radius_mm: 0.5,
            base_radius_mm: 1.0
        }
    );
    assert!(error.to_string().contains("0.5 mm") && error.to_string().contains("1 mm"));
    let error = involute(unit(5.0), inside, 1.0, 1e-3).unwrap_err();
    assert_eq!(
        error,
        InvoluteError::EndInside {
            radius_mm: 0.5,
            base_radius_mm: 1.0
        }
    );
    // A point of the base circle, rounded to three decimals, counts as on it.
    assert!(involute(xyz(0.9995, 0.0, 0.0), unit(5.0), 1.0, 1e-3).is_ok());
}

#[test]
fn equal_radii_suggest_a_circle() {
    let error = involute(xyz(5.0, 0.0, 0.0), xyz(0.0, 5.0, 0.0), 1.0, 1e-3).unwrap_err();
    assert_eq!(
        error,
        InvoluteError::EqualRadii {
            start_radius_mm: 5.0,
            end_radius_mm: 5.0
        }
    );
    assert!(error.to_string().contains("G2 or G3"));
    let error = involute(xyz(5.0, 0.0, 0.0), xyz(0.0, 5.0005, 0.0), 1.0, 1e-3).unwrap_err();
    assert!(matches!(error, InvoluteError::EqualRadii { .. }), "{error}");
}

#[test]
fn end_off_involute_is_measured_and_distributed() {
    let (from, to) = (2.0, 9.0);
    for off in [1e-6, -5e-4, 0.02] {
        // Across the curve at its end, along the normal (-sin, cos): a known distance.
        let end = unit(to) + xyz(-to.sin(), to.cos(), 0.0) * off;
        let error = involute(unit(from), end, 1.0, 0.5 * off.abs()).unwrap_err();
        let InvoluteError::OffInvolute {
            distance_mm,
            end_radius_mm,
            involute_radius_mm,
            ..
        } = error
        else {
            panic!("{error}");
        };
        assert!(
            (distance_mm - off.abs()).abs() <= 1e-3 * off.abs(),
            "{distance_mm} {off}"
        );
        assert!((end_radius_mm - end.norm()).abs() <= 1e-12);
        // In the same direction the involute's radius differs by about the same amount.
        let across = (end_radius_mm - involute_radius_mm).abs();
        assert!(
            across > 0.9 * off.abs() && across < 1.2 * off.abs(),
            "{across} {off}"
        );

        let curve = Curve::from(involute(unit(from), end, 1.0, 1.01 * off.abs()).unwrap());
        assert_eq!((curve.start(), curve.end()), (unit(from), end));
        // The offset is largest at the end.
        for i in 0..=100 {
            let s = curve.length() * f64::from(i) / 100.0;
            let phi = (from * from + 2.0 * s).sqrt();
            let fraction = f64::from(i) / 100.0;
            assert!((curve.at(s).position - unit(phi)).norm() <= 1.05 * off.abs() * fraction + 1e-12);
        }
    }
}

#[test]
fn rounding_many_turns_out_is_not_amplified() {
    // At 60 rad a micrometre of radius is 60 micrometres of path: the roll angle must not be computed from
    // the radius.
    let rounded = |p: Axes| p.map(|x| (x * 1e3).round() / 1e3);
    for (from, to) in [(0.0, 60.0), (50.0, 60.0), (59.0, 60.0), (60.0, 3.0)] {
        // Traversed inwards, the same curve rotates the other way.
        let sense = if from < to {
            Sense::CounterClockwise
        } else {
            Sense::Clockwise
        };
        let (start, end) = (rounded(unit(from)), rounded(unit(to)));
        let curve = Involute::new(Plane::Xy, start, end, [0.0; 2], 1.0, sense, 2e-3).unwrap();
        let curve = Curve::from(curve);
        // A parallel curve at distance d is longer by d times the angle turned.
        let off = (curve.length() - 0.5 * (to * to - from * from).abs()).abs();
        assert!(off <= 1e-3 * (1.0 + (to - from).abs()), "{from} {to}: {off}");
        for i in 0..=100 {
            let s = curve.length() * f64::from(i) / 100.0;
            let phi = (from * from + (to * to - from * from) * f64::from(i) / 100.0).sqrt();
            let error = (curve.at(s).position - unit(phi)).norm();
            // The longer parallel curve shifts points along the path; across it there is only rounding.
            assert!(error <= 3e-3 + off, "{from} {to} {i}: {error}");
        }
    }
}

#[test]
fn an_end_of_the_wrong_sense_is_off_the_involute() {
    let error = Involute::new(
        Plane::Xy,
        unit(2.0),
        unit(9.0),
        [0.0; 2],
        1.0,
        Sense::Clockwise,
        1e-3,
    )
    .unwrap_err();
    assert!(matches!(error, InvoluteError::OffInvolute { .. }), "{error}");
}

#[test]
fn an_inward_involute_rotates_in_the_given_sense() {
    // Traversed inwards, a clockwise involute rotates the tangent counter-clockwise.
    let mirrored = |phi: f64| xyz(unit(phi)[0], -unit(phi)[1], 0.0);
    let curve = Curve::from(involute(mirrored(9.0), mirrored(2.0), 1.0, 1e-9).unwrap());
    assert_eq!(curve.sense(), Sense::CounterClockwise);
    for i in 1..50 {
        let jet = curve.jet(curve.domain() * f64::from(i) / 50.0);
        assert!(jet.tangent().cross(&jet.second.fixed_rows::<3>(0).into_owned())[2] > 0.0);
    }
    assert!(
        curve.curvature_derivative(1.0) > 0.0,
        "curvature grows towards the base circle"
    );
}

#[test]
fn an_involutes_curvature_has_its_closed_form() {
    // k = 1/(r phi), dk/ds = -1/(r^2 phi^3).
    let curve = Curve::from(involute(unit(0.0), unit(20.0), 1.0, 1e-9).unwrap());
    for i in 1..=100 {
        let phi = 0.2 * f64::from(i);
        let s = 0.5 * phi * phi;
        assert!((curve.curvature(s) * phi - 1.0).abs() <= 1e-12);
        assert!((curve.curvature_derivative(s) * phi.powi(3) + 1.0).abs() <= 1e-11);
    }
}

#[test]
fn a_blend_matches_its_jets() {
    let left = Jet {
        first: Axes::repeat(1.0),
        second: Axes::repeat(-2.0),
        ..Jet::at_rest(Axes::repeat(5.0))
    };
    let right = Jet {
        first: Axes::repeat(-0.5),
        second: Axes::repeat(3.0),
        ..Jet::at_rest(Axes::repeat(5.7))
    };
    let blend = Curve::from(Blend::hermite(&left, &right, 1.5).unwrap());
    for (jet, given) in [(blend.jet(0.0), left), (blend.jet(1.5), right)] {
        assert_eq!(jet.position, given.position);
        assert!((jet.first - given.first).amax() <= 1e-13 && (jet.second - given.second).amax() <= 1e-12);
    }
}

#[test]
fn a_blend_reproduces_a_quintic() {
    // Planted: x = u^5 - u^3 + u, y = u^4 - 2 u, z = 3.
    let jet = |u: f64| Jet {
        position: xyz(u.powi(5) - u.powi(3) + u, u.powi(4) - 2.0 * u, 3.0),
        first: xyz(5.0 * u.powi(4) - 3.0 * u * u + 1.0, 4.0 * u.powi(3) - 2.0, 0.0),
        second: xyz(20.0 * u.powi(3) - 6.0 * u, 12.0 * u * u, 0.0),
        third: xyz(60.0 * u * u - 6.0, 24.0 * u, 0.0),
    };
    let blend = Curve::from(Blend::hermite(&jet(0.0), &jet(1.3), 1.3).unwrap());
    for i in 0..=20 {
        let u = 1.3 * f64::from(i) / 20.0;
        let (is, should) = (blend.jet(u), jet(u));
        assert!((is.position - should.position).amax() <= 1e-13);
        assert!((is.third - should.third).amax() <= 1e-10);
    }
    // The extreme of y at u = cbrt(1/2) is computed, not sampled.
    let min = blend.bounds(0.0, 1.3).0[1];
    let u = 0.5f64.cbrt();
    assert!((min - (u.powi(4) - 2.0 * u)).abs() <= 1e-14);
}

#[test]
fn curvature_does_not_depend_on_the_parameter() {
    // A parabola (u + u^2, (u + u^2)^2 / 2) with a non-uniform parameter: k = (1 + x^2)^(-3/2), dk/ds = -3 x
    // (1 + x^2)^(-3).
    for u in [0.0, 0.3, 1.0] {
        let (x, x1, x2) = (u + u * u, 1.0 + 2.0 * u, 2.0);
        let jet = Jet {
            position: xyz(x, 0.5 * x * x, 0.0),
            first: xyz(x1, x * x1, 0.0),
            second: xyz(x2, x1 * x1 + x * x2, 0.0),
            third: xyz(0.0, 3.0 * x1 * x2, 0.0),
        };
        for jet in [jet, jet.by_arc_length()] {
            assert!((jet.curvature() - (1.0 + x * x).powf(-1.5)).abs() <= 1e-14);
            assert!((jet.curvature_derivative() + 3.0 * x * (1.0 + x * x).powi(-3)).abs() <= 1e-14);
        }
        assert!((jet.by_arc_length().first.norm() - 1.0).abs() <= 1e-15);
    }
}

#[test]
fn a_blend_with_a_standstill_has_a_length() {
    // Out and back: the speed vanishes in the middle, where arc length has a kink.
    let left = Jet {
        first: xyz(1.0, 0.0, 0.0),
        ..Jet::at_rest(Axes::zeros())
    };
    let right = Jet {
        first: xyz(-1.0, 0.0, 0.0),
        ..Jet::at_rest(Axes::zeros())
    };
    let blend = Curve::from(Blend::hermite(&left, &right, 1.0).unwrap());
    let middle = blend.position(0.5)[0];
    assert!((blend.length() - 2.0 * middle).abs() <= 1e-8 * blend.length());
    assert_eq!(blend.curvature_bound(0.4, 0.6), f64::INFINITY);
    assert!(blend.jet(0.5).is_finite());
}

#[test]
fn curves_are_small_enough_for_queues() {
    assert!(size_of::<Curve>() <= 560, "{}", size_of::<Curve>());
}

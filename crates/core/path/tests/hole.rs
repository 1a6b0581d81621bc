//! Hole milling: the paper's tables, joints, every kind of start, and every error.

use std::f64::consts::TAU;

use evolvent_path::{
    Axes, Curve, Hole, HoleError, HoleStart, InvoluteError, Milling, Plane, Role, depths_mm,
};

const HOLE: Hole = Hole {
    plane: Plane::Xy,
    centre_mm: [0.0, 0.0],
    diameter_mm: 200.0,
    tool_diameter_mm: 40.0,
    milling: Milling::Climb,
};

fn near(value: f64, printed: f64, digits: i32) {
    let half = 0.5 * 10f64.powi(-digits) * 1.000_001;
    assert!(
        (value - printed).abs() <= half,
        "{value} is not {printed} to {digits} digits"
    );
}

#[test]
fn roughing_gives_table_2() {
    let pass = HOLE
        .rough(4.0, None, 1.0, HoleStart::Centre, &Axes::zeros())
        .unwrap();
    assert_eq!((pass.radius_mm, pass.turns, pass.pitch_mm), (79.0, 20, 3.95));
    near(pass.base_radius_mm, 0.628_662_025, 9);
    let [involute, circle] = &pass.blocks[..] else {
        panic!("two blocks")
    };
    near(involute.figures.length_mm, 4_963.716_39, 5);
    near(involute.curve.length(), 4_963.716_39, 5);
    assert_eq!(involute.figures.start_mm, [0.0, 0.0]);
    assert_eq!(
        (involute.figures.turn_rad, involute.figures.start_radius_mm),
        (0.0, 0.0)
    );
    near(involute.figures.end_radius_mm, 79.0, 9);
    near(circle.figures.length_mm, 496.371_639, 6);
    near(circle.curve.length(), 496.371_639, 6);
    assert_eq!(circle.figures.start_mm, [0.0, -79.0]);
    assert_eq!(
        (circle.figures.start_radius_mm, circle.figures.end_radius_mm),
        (79.0, 79.0)
    );
}

#[test]
fn finishing_gives_table_3_with_its_erratum() {
    let pass = HOLE
        .finish(2, 0.0, HoleStart::Point([-40.0, 40.0]), &Axes::zeros())
        .unwrap();
    assert_eq!(pass.radius_mm, 80.0);
    near(pass.base_radius_mm, 6.366_197_724, 9);
    let [involute, circle, _] = &pass.blocks[..] else {
        panic!("three blocks")
    };
    near(involute.figures.length_mm, 242.249_73, 5);
    near(involute.curve.length(), 242.249_73, 5);
    near(involute.figures.start_roll_rad, 9.044_814_77, 8);
    near(involute.figures.turn_rad, 0.946_567_32, 8);
    near(involute.figures.start_radius_mm, 57.5811, 4);
    near(involute.figures.end_radius_mm, 80.0, 9);
    assert_eq!(
        (involute.curve.start()[0], involute.curve.start()[1]),
        (-40.0, 40.0)
    );
    // 160 pi = 502.654 824 57; the paper's last digit is rounded up.
    near(circle.figures.length_mm, 502.654_82, 5);
    // The paper prints (0, -79) here, which is not on the circle: (6) gives this point.
    near(circle.figures.start_mm[0], 64.913_119, 6);
    near(circle.figures.start_mm[1], -46.757_748, 6);
}

fn angle_of(curve: &Curve, u: f64, centre: [f64; 2]) -> f64 {
    let p = curve.position(u);
    (p[1] - centre[1]).atan2(p[0] - centre[0])
}

#[test]
fn passes_join_with_equal_tangent_and_curvature() {
    let seed = 0x0B0E_5EEDu64;
    println!("seed {seed:#x}");
    let mut generator = evolvent_random::Random::from_state(seed);
    let mut random = || generator.unit();
    for round in 0..400 {
        let plane = [Plane::Xy, Plane::Zx, Plane::Yz][round % 3];
        let milling = [Milling::Climb, Milling::Conventional][round % 2];
        let tool_diameter_mm = 1.0 + 30.0 * random();
        let hole = Hole {
            plane,
            centre_mm: [400.0 * random() - 200.0, 400.0 * random() - 200.0],
            diameter_mm: tool_diameter_mm + 0.5 + 200.0 * random(),
            tool_diameter_mm,
            milling,
        };
        let radius = hole.path_radius_mm(0.0).unwrap();
        let (distance, angle) = (random() * 0.999 * radius, random() * TAU);
        let start = match round % 5 {
            0 => HoleStart::Centre,
            1 | 2 => HoleStart::Point([distance * angle.cos(), distance * angle.sin()]),
            3 => HoleStart::CurvatureRadius(distance),
            _ => HoleStart::Length(0.5 * radius * random() + 0.01),
        };
        let at = Axes::repeat(-3.0);
        let turns = 1 + (round as u32) % 3;
        let pass = hole.finish(turns, 0.0, start, &at).unwrap();
        assert_eq!(
            pass.blocks.iter().map(|b| b.role).collect::<Vec<_>>(),
            [Role::Approach, Role::FinishCircle, Role::Departure]
        );
        if let HoleStart::Point(point) = start {
            let begin = plane.project(&pass.blocks[0].curve.start());
            for i in 0..2 {
                assert!(
                    (begin[i] - hole.centre_mm[i] - point[i]).abs() <= 1e-11,
                    "{round}"
                );
            }
        }
        for pair in pass.blocks.windows(2) {
            let (left, right) = (&pair[0].curve, &pair[1].curve);
            assert_eq!(left.end(), right.start());
            let end = left.jet(left.domain()).by_arc_length();
            let begin = right.jet(0.0).by_arc_length();
            let tight = 1e-10 * (1.0 + 1.0 / pass.base_radius_mm);
            let tangent_step = (begin.tangent() - end.tangent()).norm();
            let curvature_step = (begin.second - end.second).amax();
            assert!(tangent_step <= tight, "{round}: {tangent_step}");
            assert!(curvature_step <= tight, "{round}: {curvature_step}");
        }
        for block in &pass.blocks {
            assert_eq!(block.curve.sense(), milling.sense());
            assert!((block.curve.length() - block.figures.length_mm).abs() <= 1e-9);
            // The tool stays inside the hole, and the other axes do not move.
            for i in 0..=100 {
                let p = block.curve.position(block.curve.domain() * f64::from(i) / 100.0);
                let [x, y] = plane.project(&p);
                let out = (x - hole.centre_mm[0]).hypot(y - hole.centre_mm[1]);
                assert!(out <= radius + 1e-10, "{round}: {out} > {radius}");
                assert_eq!(p[plane.axes().2], -3.0);
            }
        }
        // The departure mirrors the approach: equal distances from the centre at equal lengths from the wall.
        let (approach, departure) = (&pass.blocks[0].curve, &pass.blocks[2].curve);
        let [a, b] = [approach.start(), departure.end()].map(|p| {
            let [x, y] = plane.project(&p);
            (x - hole.centre_mm[0]).hypot(y - hole.centre_mm[1])
        });
        assert!((a - b).abs() <= 1e-10);
    }
}

#[test]
fn conventional_milling_mirrors_climb_milling() {
    let climb = HOLE
        .rough(4.0, None, 1.0, HoleStart::Point([10.0, 5.0]), &Axes::zeros())
        .unwrap();
    let hole = Hole {
        milling: Milling::Conventional,
        ..HOLE
    };
    let conventional = hole
        .rough(4.0, None, 1.0, HoleStart::Point([10.0, -5.0]), &Axes::zeros())
        .unwrap();
    let circle = &climb.blocks[1].curve;
    let before = angle_of(circle, 0.0, [0.0, 0.0]);
    assert!(angle_of(circle, 1.0, [0.0, 0.0]) > before);
    for (a, b) in climb.blocks.iter().zip(&conventional.blocks) {
        for i in 0..=50 {
            let u = a.curve.domain() * f64::from(i) / 50.0;
            let (p, q) = (a.curve.position(u), b.curve.position(u));
            assert!((p[0] - q[0]).abs() <= 1e-11 && (p[1] + q[1]).abs() <= 1e-11);
        }
    }
}

#[test]
fn each_turn_adds_pitch_to_curvature_radius() {
    // Planted: rho = r phi, so 2 pi of roll add 2 pi r = R / n.
    let pass = HOLE
        .rough(4.0, None, 1.0, HoleStart::Centre, &Axes::zeros())
        .unwrap();
    let curve = &pass.blocks[0].curve;
    let radius_after = |turns: f64| 1.0 / curve.curvature(0.5 * pass.base_radius_mm * (TAU * turns).powi(2));
    for turn in 1..20 {
        let turn = f64::from(turn);
        assert!((radius_after(turn) - 3.95 * turn).abs() <= 1e-9);
    }
}

#[test]
fn a_start_is_found_where_the_distance_is_stationary() {
    // At phi = 2 pi k the distance from the centre has a stationary point: Newton's method alone would
    // diverge.
    for k in 0..4 {
        for offset in [-1e-3, -1e-9, 0.0, 1e-9, 1e-3] {
            let distance = (79.0 * f64::from(k) / 4.0 + offset).max(0.0);
            let pass = HOLE
                .rough(20.0, None, 1.0, HoleStart::Point([0.0, distance]), &Axes::zeros())
                .unwrap();
            assert!((pass.blocks[0].curve.start()[1] - distance).abs() <= 1e-12);
            assert!(pass.blocks[0].curve.start()[0].abs() <= 1e-12);
        }
    }
}

#[test]
fn depths_are_equal_steps_that_end_at_the_bottom() {
    assert_eq!(depths_mm(0.0, -10.0, 5.0).unwrap(), [-5.0, -10.0]);
    assert_eq!(depths_mm(2.0, -7.0, 4.0).unwrap(), [-1.0, -4.0, -7.0]);
    // 0.3 / 0.1 is a little below 3 in binary, 0.7 / 0.1 a little below 7: no additional tiny step.
    assert_eq!(depths_mm(0.0, -0.3, 0.1).unwrap().len(), 3);
    assert_eq!(depths_mm(0.0, -0.7, 0.1).unwrap().len(), 7);
}

#[test]
fn errors_name_the_value_and_its_limit() {
    let at = Axes::zeros();
    let rough = |hole: Hole, pitch, turns, allowance, start| {
        let error = hole.rough(pitch, turns, allowance, start, &at).unwrap_err();
        (error, error.to_string())
    };
    let centre = HoleStart::Centre;
    let names = |(error, text): (HoleError, String), numbers: &[&str]| {
        for number in numbers {
            assert!(text.contains(number), "{text}");
        }
        error
    };
    let wide = Hole {
        tool_diameter_mm: 200.0,
        ..HOLE
    };
    let error = names(rough(wide, 4.0, None, 1.0, centre), &["200 mm"]);
    assert_eq!(
        error,
        HoleError::ToolTooWide {
            hole_mm: 200.0,
            tool_mm: 200.0
        }
    );
    for pitch in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(
            rough(HOLE, pitch, None, 1.0, centre).0,
            HoleError::Pitch { .. }
        ));
    }
    let error = names(rough(HOLE, 0.5, None, 1.0, centre), &["0.5 mm", "0.79 mm"]);
    assert_eq!(
        error,
        HoleError::PitchTooSmall {
            pitch_mm: 0.5,
            min_mm: 0.79
        }
    );
    assert!(matches!(
        rough(HOLE, 79.0, None, 1.0, centre).0,
        HoleError::PitchTooWide { .. }
    ));
    for allowance in [80.0, 1e9, -0.1, f64::NAN] {
        assert!(matches!(
            rough(HOLE, 4.0, None, allowance, centre).0,
            HoleError::Allowance { .. }
        ));
    }
    names(rough(HOLE, 4.0, None, 81.0, centre), &["81 mm", "80 mm"]);
    for turns in [0, 101, u32::MAX] {
        assert_eq!(
            rough(HOLE, 4.0, Some(turns), 1.0, centre).0,
            HoleError::Turns { turns }
        );
    }
    let error = names(
        rough(HOLE, 4.0, None, 1.0, HoleStart::Point([60.0, 80.0])),
        &["100 mm", "79 mm"],
    );
    assert_eq!(
        error,
        HoleError::StartOutside {
            distance_mm: 100.0,
            limit_mm: 79.0
        }
    );
    for point in [[f64::NAN, 0.0], [0.0, f64::INFINITY], [79.0, 0.0], [1e308, 1e308]] {
        let error = rough(HOLE, 4.0, None, 1.0, HoleStart::Point(point)).0;
        assert!(matches!(error, HoleError::StartOutside { .. }), "{error}");
    }
    for radius in [79.0, -1.0, f64::NAN] {
        let error = rough(HOLE, 4.0, None, 1.0, HoleStart::CurvatureRadius(radius)).0;
        assert!(matches!(error, HoleError::StartRadius { .. }));
    }
    for length in [0.0, 4963.8, -1.0, f64::NAN] {
        let error = rough(HOLE, 4.0, None, 1.0, HoleStart::Length(length)).0;
        assert!(matches!(error, HoleError::StartLength { .. }));
    }
    for diameter in [0.0, -200.0, f64::NAN, f64::INFINITY, 1e300] {
        let hole = Hole {
            diameter_mm: diameter,
            ..HOLE
        };
        assert!(matches!(
            rough(hole, 4.0, None, 1.0, centre).0,
            HoleError::Diameter { .. }
        ));
        let hole = Hole {
            tool_diameter_mm: diameter,
            ..HOLE
        };
        let error = rough(hole, 4.0, None, 1.0, centre).0;
        assert!(matches!(
            error,
            HoleError::Diameter { .. } | HoleError::ToolTooWide { .. }
        ));
    }
    let hole = Hole {
        centre_mm: [f64::NAN, 0.0],
        ..HOLE
    };
    assert!(matches!(
        rough(hole, 4.0, None, 1.0, centre).0,
        HoleError::Centre { .. }
    ));
    let error = HOLE
        .rough(4.0, None, 1.0, centre, &Axes::repeat(f64::NAN))
        .unwrap_err();
    assert!(matches!(
        error,
        HoleError::Involute(InvoluteError::Coordinate { axis: 'Z', .. })
    ));
    for (top, bottom, step) in [
        (0.0, 0.0, 1.0),
        (0.0, 1.0, 1.0),
        (0.0, -1.0, 0.0),
        (0.0, f64::NAN, 1.0),
    ] {
        assert!(matches!(
            depths_mm(top, bottom, step),
            Err(HoleError::Depth { .. })
        ));
    }
    assert!(matches!(
        depths_mm(0.0, -1.0, 1e-9),
        Err(HoleError::Depths { .. })
    ));
    assert!(matches!(
        HOLE.finish(0, 0.0, centre, &at),
        Err(HoleError::Turns { turns: 0 })
    ));
}

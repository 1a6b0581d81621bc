//! Splines, NURBS and holes: the moves follow the curves that the words define.

use evolvent_gcode::{Action, Interpreter, Move, MoveKind, Settings, Tool, ToolTable};
use evolvent_path::Curve;

fn moves_with(program: &str, settings: Settings) -> Vec<Move> {
    let (commands, errors): (Vec<_>, Vec<_>) =
        Interpreter::new(program.as_bytes(), settings).partition(Result::is_ok);
    let shown: Vec<_> = errors
        .into_iter()
        .filter_map(Result::err)
        .map(|error| error.render("test"))
        .collect();
    assert!(shown.is_empty(), "{}", shown.join("\n"));
    let moves = commands
        .into_iter()
        .filter_map(Result::ok)
        .filter_map(|command| match command.action {
            Action::Move(step) => Some(step),
            _ => None,
        });
    moves.collect()
}

fn moves(program: &str) -> Vec<Move> {
    moves_with(program, Settings::default())
}

/// Points of a curve at equal steps of its own parameter.
fn points(curve: &Curve, count: u32) -> Vec<[f64; 2]> {
    let at = |k: u32| curve.position(curve.domain() * f64::from(k) / f64::from(count));
    (0..=count).map(|k| [at(k)[0], at(k)[1]]).collect()
}

/// De Casteljau's construction.
fn bezier(control: &[[f64; 2]], t: f64) -> [f64; 2] {
    let mut work = control.to_vec();
    while work.len() > 1 {
        work = work
            .windows(2)
            .map(|pair| [0, 1].map(|k| (1.0 - t) * pair[0][k] + t * pair[1][k]))
            .collect();
    }
    work[0]
}

#[test]
fn g5_and_g5_1_are_their_bezier_curves() {
    for (program, control) in [
        (
            "F600 G0 X1 Y2\nG5 X11 Y7 I3 J9 P-4 Q6",
            vec![[1.0, 2.0], [4.0, 11.0], [7.0, 13.0], [11.0, 7.0]],
        ),
        (
            "F600 G0 X1 Y2\nG5.1 X11 Y7 I3 J9",
            vec![[1.0, 2.0], [4.0, 11.0], [11.0, 7.0]],
        ),
    ] {
        let found = moves(program);
        assert_eq!(found.len(), 2, "one curve: {program}");
        for (k, point) in points(&found[1].curve, 20).iter().enumerate() {
            let expected = bezier(&control, k as f64 / 20.0);
            let deviation = (point[0] - expected[0]).hypot(point[1] - expected[1]);
            assert!(deviation < 1e-9, "{program}: {deviation} at {k}");
        }
    }
}

#[test]
fn g5_continues_with_the_mirrored_control_point() {
    let splines = moves("F600\nG5 X10 Y0 I2 J5 P-3 Q4\nG5 X20 Y0 P-1 Q-2");
    let (one, two) = (splines[0].curve, splines[1].curve);
    let (left, right) = (one.tangent(one.length()), two.tangent(0.0));
    assert!((left - right).norm() < 1e-9);
}

#[test]
fn g5_1_respects_rotated_and_shifted_coordinates() {
    let plain = moves("F600\nG5.1 X11 Y7 I3 J9")[0].curve;
    let turned = moves("F600 G10 L2 P1 X5 Y-3 R30\nG0 X0 Y0\nG5.1 X11 Y7 I3 J9")[1].curve;
    let (sin, cos) = 30.0_f64.to_radians().sin_cos();
    for (a, b) in points(&plain, 9).iter().zip(points(&turned, 9)) {
        let expected = [5.0 + cos * a[0] - sin * a[1], -3.0 + sin * a[0] + cos * a[1]];
        assert!((expected[0] - b[0]).hypot(expected[1] - b[1]) < 1e-9);
    }
}

#[test]
fn a_nurbs_circle_is_a_smooth_circle() {
    // Quarter of a circle of radius 10 about zero: weights 1, cos 45 degrees, 1.
    let found = moves("F600 G0 X10 Y0\nG5.2 P1 L3\nX10 Y10 P0.707106781186548\nX0 Y10 P1\nG5.3");
    let pieces = &found[1..];
    assert!(pieces.len() < 40, "{} pieces", pieces.len());
    let mut length = 0.0;
    for piece in pieces {
        length += piece.curve.length();
        for [x, y] in points(&piece.curve, 32) {
            assert!((x.hypot(y) - 10.0).abs() < 2e-4, "{x} {y}");
        }
    }
    assert!((length - 5.0 * std::f64::consts::PI).abs() < 1e-3);
    for pair in pieces.windows(2) {
        let (left, right) = (pair[0].curve, pair[1].curve);
        assert_eq!(left.end(), right.start());
        assert!((left.tangent(left.length()) - right.tangent(0.0)).norm() < 1e-9);
        assert!((left.curvature(left.length()) - right.curvature(0.0)).abs() < 1e-6);
    }
}

#[test]
fn a_curve_with_stationary_ends_is_followed() {
    // Without control points: a straight line with zero speed at both ends.
    let found = moves("F600\nG5 X10 Y5 P0 Q0");
    let total: f64 = found.iter().map(|step| step.curve.length()).sum();
    assert!((total - 125.0_f64.sqrt()).abs() < 1e-3);
    assert_eq!(found.last().unwrap().curve.end()[0], 10.0);
}

/// Maximum distance of the feed moves from a centre.
fn reach(moves: &[Move], centre: [f64; 2]) -> f64 {
    let feeds = moves.iter().filter(|step| step.kind == MoveKind::Feed);
    let all = feeds.flat_map(|step| points(&step.curve, 64));
    all.map(|[x, y]| (x - centre[0]).hypot(y - centre[1]))
        .fold(0.0, f64::max)
}

#[test]
fn a_hole_reaches_its_wall_at_every_depth() {
    let found = moves("F600 G99 G0 Z20\nG13.2 X30 Y-10 Z-6 R2 D40 E12 Q3 K0.5 I3 F900");
    assert!((reach(&found, [30.0, -10.0]) - 14.0).abs() < 1e-9);
    // One revolution on the final circle of radius 14 at each of three depths.
    let mut depths: Vec<f64> = found
        .iter()
        .filter(|step| matches!(step.curve, Curve::Arc(arc) if (arc.radius_mm() - 14.0).abs() < 1e-9))
        .map(|step| step.curve.end()[2])
        .collect();
    depths.sort_by(f64::total_cmp);
    assert_eq!(depths.len(), 3);
    for (depth, expected) in depths.iter().zip([-6.0, -3.333_333, -0.666_667]) {
        assert!((depth - expected).abs() < 1e-5, "{depths:?}");
    }
    for pair in found.windows(2) {
        assert_eq!(pair[0].curve.end(), pair[1].curve.start());
    }
    let end = found.last().unwrap().curve.end();
    assert_eq!([end[0], end[1], end[2]], [30.0, -10.0, 2.0]);
    // G13.2 climbs: counter-clockwise.
    assert!(found.iter().all(|step| match step.curve {
        Curve::Arc(arc) => arc.sweep_rad() > 0.0,
        _ => true,
    }));
}

#[test]
fn a_hole_uses_tool_table_offsets_and_inches() {
    let mut tool = Tool::new(4);
    tool.diameter_mm = 12.7;
    let settings = Settings {
        tools: Some(ToolTable::new(vec![tool])),
        ..Settings::default()
    };
    let program = "G20 F30 T4 M6 G92 X-1 Y0\nG98 G0 Z1\nG12.2 Z-0.5 R0.1 D2 Q0.2";
    let found = moves_with(program, settings);
    assert!((reach(&found, [0.0, 0.0]) - 0.5 * (2.0 * 25.4 - 12.7)).abs() < 1e-9);
    assert!((found.last().unwrap().curve.end()[2] - 25.4).abs() < 1e-9);
}

#[test]
fn increments_of_a_nurbs_are_from_its_start() {
    let absolute = moves("F600 G0 X10 Y20\nG5.2 X11 Y21 P1 L3\nX12 Y22 P1\nX13 Y20 P2\nG5.3");
    let increments = moves("F600 G0 X10 Y20\nG91 G5.2 X1 Y1 P1 L3\nX2 Y2 P1\nX3 Y0 P2\nG5.3");
    assert_eq!(absolute.len(), increments.len());
    for (a, b) in absolute.iter().zip(&increments) {
        for (a, b) in points(&a.curve, 8).iter().zip(points(&b.curve, 8)) {
            assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-12, "{a:?} {b:?}");
        }
    }
}

#[test]
fn a_curve_through_its_own_start_is_kept() {
    // It is 30 t (1 - t) (1 - 2 t) along X, and half of that along Y: out and back on both sides.
    let found = moves("F600\nG5 X0 Y0 I10 J5 P-10 Q-5");
    let total: f64 = found.iter().map(|step| step.curve.length()).sum();
    let farthest = 30.0 / (6.0 * 3.0_f64.sqrt());
    let expected = 4.0 * farthest * 1.25_f64.sqrt();
    assert!((total - expected).abs() < 1e-3, "{total} instead of {expected}");
    let end = found.last().unwrap().curve.end();
    assert!(end[0].hypot(end[1]) < 1e-9);
}

#[test]
fn a_nurbs_without_its_end_is_a_warning() {
    let warnings = |program: &str| {
        Interpreter::new(program.as_bytes(), Settings::default())
            .filter(|command| {
                let action = command.as_ref().map(|command| &command.action);
                matches!(action, Ok(Action::Warning(text)) if text.contains("G5.3"))
            })
            .count()
    };
    let nurbs = "F600\nG5.2 P1 L3\nX1 Y2 P1\nX3 Y0 P1\n";
    assert_eq!(warnings(&format!("{nurbs}M2\n")), 1);
    assert_eq!(warnings(nurbs), 1);
    assert_eq!(warnings(&format!("{nurbs}G5.3\nM2\n")), 0);
}

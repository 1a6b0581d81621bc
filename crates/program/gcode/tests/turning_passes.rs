//! G82 and G75 of a lathe: the passes move by move, and the resulting shape.

#![expect(clippy::unwrap_used, reason = "a test may fail")]

use evolvent_gcode::{
    Action, Code, Diagnostic, Interpreter, MachineFeatures, MoveKind, Settings, TurningCycle, TurningKind,
    TurningWords,
};
use evolvent_path::Axes;

fn lathe() -> Settings {
    let mut settings = Settings {
        features: MachineFeatures {
            lathe: true,
            ..MachineFeatures::default()
        },
        ..Settings::default()
    };
    settings.axes = [true, false, true, false, false, false, false, false, false];
    (settings.start[0], settings.start[2]) = (50.0, 10.0);
    settings
}

fn run_with(program: &str, settings: Settings) -> Result<Vec<Action>, Diagnostic> {
    let items = Interpreter::new(program.as_bytes(), settings);
    items.map(|item| item.map(|command| command.action)).collect()
}

/// Ends of moves as (X, Z), whether they cut, speed in mm/min.
fn moves(program: &str) -> Vec<(f64, f64, Option<f64>)> {
    let actions = run_with(program, lathe()).unwrap();
    let ends = actions.iter().filter_map(|action| match action {
        Action::Move(step) => {
            let end = step.curve.end();
            let feed = (step.kind == MoveKind::Feed).then_some((step.feed_mm_s * 60.0).round());
            // Rounded to a nanometre because of sums of increments.
            Some(((end[0] * 1e6).round() / 1e6, (end[2] * 1e6).round() / 1e6, feed))
        }
        _ => None,
    });
    ends.collect()
}

/// The height field that remains of a cylinder, in steps of 0.1 mm, cut by a tool of zero width.
fn remaining_stock(program: &str, x0: f64, z0: f64, length: f64) -> Vec<f64> {
    let actions = run_with(program, lathe()).unwrap();
    let count = (length / 0.1).round() as usize;
    let mut field = vec![x0; count];
    for action in &actions {
        let Action::Move(step) = action else { continue };
        let (a, b) = (step.curve.start(), step.curve.end());
        for (index, height) in field.iter_mut().enumerate() {
            let z = z0 - 0.1 * (index as f64 + 0.5);
            let (low, high) = (a[2].min(b[2]), a[2].max(b[2]));
            if !(low..=high).contains(&z) || low == high {
                continue;
            }
            let x = a[0] + (b[0] - a[0]) * (z - a[2]) / (b[2] - a[2]);
            if x < *height - 1e-9 {
                assert_eq!(step.kind, MoveKind::Feed, "a rapid through the stock at Z{z}");
                *height = x;
            }
        }
    }
    field
}

#[test]
fn a_longitudinal_cycle_has_passes_of_its_depth() {
    // From radius 30 to 26 in passes of 3: 27, 26, shoulder at Z-20.
    let program = "G21 G18 F100\nG0 X30 Z1\nG82 X52 Z-20 D3\nM2\n";
    assert_eq!(
        moves(program),
        [
            (30.0, 1.0, None),
            (27.0, 1.0, None),
            (27.0, -20.0, Some(100.0)),
            (30.0, -20.0, Some(100.0)),
            (30.5, -19.5, None),
            (30.5, 1.0, None),
            (26.0, 1.0, None),
            (26.0, -20.0, Some(100.0)),
            (27.0, -20.0, Some(100.0)),
            (27.5, -19.5, None),
            (27.5, 1.0, None),
            (30.0, 1.0, None),
        ]
    );
}

#[test]
fn turning_passes_leave_the_contour_with_its_cone() {
    for (words, allowance) in [("D1.7", 0.0), ("D1.7 H0.4", 0.0), ("D50", 0.0), ("D0.3 H1", 0.0)] {
        let program = format!("G21 G18 F100\nG0 X30 Z1\nG82 X40 Z-20 R54 L-30 {words}\nM2\n");
        let field = remaining_stock(&program, 30.0, 1.0, 40.0);
        for (index, height) in field.iter().enumerate() {
            let z = 1.0 - 0.1 * (index as f64 + 0.5);
            // Cylinder, cone from radius 20 to 27, shoulder, stock.
            let expected = match z {
                z if z > -20.0 => 20.0,
                z if z > -30.0 => 20.0 + 7.0 * (-20.0 - z) / 10.0,
                _ => 30.0,
            };
            assert!(
                (height - expected - allowance).abs() < 1e-9,
                "{words}: {height} at Z{z}, not {expected}"
            );
        }
    }
}

#[test]
fn inner_steps_are_turned_outwards() {
    let ends = moves("G21 G18 F100\nG0 X10 Z1\nG82 X26 Z-5 D2 H0.5\nM2\n");
    let cuts: Vec<_> = ends
        .iter()
        .filter(|end| end.2.is_some())
        .map(|end| (end.0, end.1))
        .collect();
    assert_eq!(
        cuts,
        [
            (12.0, -4.5),
            (10.0, -4.5),
            (12.5, -4.5),
            (12.0, -4.5),
            (13.0, -5.0),
            (10.0, -5.0)
        ]
    );
}

#[test]
fn facing_uses_its_own_feed_and_finishes() {
    let ends = moves("G21 G18 F100\nG0 X30 Z0\nG75 X20 Z-5 K3 H1 E60\nM2\n");
    assert_eq!(
        ends,
        [
            (30.0, 0.0, None),
            (30.0, -3.0, None),
            (11.0, -3.0, Some(60.0)),
            (11.0, 0.0, Some(100.0)),
            (11.5, 0.5, None),
            (30.0, 0.5, None),
            (30.0, -4.0, None),
            (11.0, -4.0, Some(60.0)),
            (11.0, -3.0, Some(100.0)),
            (11.5, -2.5, None),
            (30.0, -2.5, None),
            (30.0, 0.5, None),
            (10.0, 0.5, None),
            (10.0, -5.0, Some(100.0)),
            (30.0, -5.0, Some(60.0)),
            (30.0, 0.0, None),
        ]
    );
}

#[test]
fn increments_and_radii_are_as_configured() {
    let absolute = moves("G21 G18 F100\nG0 X30 Z1\nG82 X52 Z-20 D3\nM2\n");
    assert_eq!(moves("G21 G18 F100\nG0 X30 Z1\nG82 U-8 W-21 D3\nM2\n"), absolute);
    assert_eq!(
        moves("G21 G18 F100\nG0 X30 Z1\nG91\nG82 X-8 Z-21 D3\nM2\n"),
        absolute
    );
    for (words, x, mode) in [
        (TurningWords::Radius, "X26", "G8"),
        (TurningWords::Mode, "X26", "G8"),
        (TurningWords::Mode, "X52", "G7"),
    ] {
        let settings = Settings {
            features: MachineFeatures {
                turning_words: words,
                ..lathe().features
            },
            ..lathe()
        };
        let program = format!("G21 G18 F100\nG0 X30 Z1\n{mode}\nG82 {x} Z-20 D3\nM2\n");
        let program2 = "G21 G18 F100\nG0 X30 Z1\nG82 X52 Z-20 D3\nM2\n";
        assert_eq!(
            run_with(&program, settings),
            run_with(program2, lathe()),
            "{words:?}"
        );
    }
}

#[test]
fn q1_outputs_the_cycle_if_a_load_is_measured() {
    let program = "G21 G18 F60 S800\nG10 L2 P1 X1 Z2\nG0 X30 Z1\nG82 X40 Z-20 R50 L-25 H0.5 Q1\n\
                   G75 X40 Z-5 K2 E30 Q1\nM2\n";
    let with_load = Settings {
        features: MachineFeatures {
            load_channel: true,
            ..lathe().features
        },
        ..lathe()
    };
    let actions = run_with(program, with_load).unwrap();
    let cycles: Vec<_> = actions
        .iter()
        .filter(|action| matches!(action, Action::Turning(_)))
        .collect();
    let mut start = Axes::zeros();
    (start[0], start[2]) = (31.0, 3.0);
    let first = TurningCycle {
        kind: TurningKind::Longitudinal,
        start,
        x_mm: 21.0,
        z_mm: -18.0,
        cone_mm: Some([26.0, -23.0]),
        depth_mm: None,
        allowance_mm: 0.5,
        diameter_mm: 40.0,
        spindle: 0,
        spindle_rpm: 800.0,
        feed_mm_s: 1.0,
        cross_feed_mm_s: 1.0,
    };
    let second = TurningCycle {
        kind: TurningKind::Facing,
        z_mm: -3.0,
        cone_mm: None,
        depth_mm: Some(2.0),
        allowance_mm: 0.0,
        cross_feed_mm_s: 0.5,
        ..first
    };
    assert_eq!(cycles, [&Action::Turning(first), &Action::Turning(second)]);
    // The allowance is finished as in the plain cycle, to the final corner and back to the start.
    let at = |x: f64, z: f64| move |end: &Axes| (end[0] - x).abs() < 1e-12 && (end[2] - z).abs() < 1e-12;
    let after: Vec<_> = actions
        .iter()
        .skip_while(|action| !matches!(action, Action::Turning(_)))
        .skip(1)
        .take_while(|action| !matches!(action, Action::Turning(_)))
        .filter_map(|action| match action {
            Action::Move(step) => Some((step.kind, step.curve.end())),
            _ => None,
        })
        .collect();
    let is_final = at(21.0, -18.0);
    assert!(
        after
            .iter()
            .any(|(kind, end)| *kind == MoveKind::Feed && is_final(end))
    );
    assert!(after.last().is_some_and(|(_, end)| at(31.0, 3.0)(end)));
    // Without a load channel: the plain cycle if there is a depth, otherwise an error with the reason.
    let error = run_with(program, lathe()).unwrap_err();
    assert_eq!((error.code, error.line), (Code::WordMissing, 4));
    let fallback = run_with("G21 G18 F60\nG0 X30 Z1\nG82 X40 Z-20 D9 Q1\n", lathe()).unwrap();
    assert!(
        fallback
            .iter()
            .any(|action| matches!(action, Action::Message(text) if text.contains("plain")))
    );
}

#[test]
fn invalid_turning_is_rejected_and_mills_drill() {
    let at = |line: &str| {
        let program = format!("G21 G18 F60\nG0 X30 Z1\n{line}\n");
        run_with(&program, lathe()).map_err(|error| (error.code, error.line))
    };
    for (line, code) in [
        ("G82 X52 Z-20", Code::WordMissing),
        ("G82 Z-20 D1", Code::WordMissing),
        ("G82 X52 D1", Code::WordMissing),
        ("G82 X52 Z-20 D0", Code::OutOfRange),
        ("G82 X52 Z-20 D1 H9", Code::OutOfRange),
        ("G82 X52 Z-20 D1 H-1", Code::OutOfRange),
        ("G82 X52 Z-20 D0.00001", Code::OutOfRange),
        ("G82 X52 Z-20 D1 R54", Code::WordMissing),
        ("G82 X52 Z-20 D1 R40 L-30", Code::OutOfRange),
        ("G82 X52 Z-20 D1 R54 L-10", Code::OutOfRange),
        ("G82 X60 Z-20 D1", Code::OutOfRange),
        ("G82 X52 U-1 Z-20 D1", Code::TwoUsers),
        ("G82 X52 Z-20 D1 Q2", Code::OutOfRange),
        ("G82 X52 Z-20 K1", Code::UnusedWord),
        ("G75 X52 Z-20 D1", Code::UnusedWord),
        ("G75 X52 Z-20 K1 E0", Code::OutOfRange),
        ("G93 G82 X52 Z-20 D1", Code::WrongMode),
        ("G0 U3", Code::NoSuchAxis),
        ("G82 X52 Z-20 V1 D1", Code::NoSuchAxis),
    ] {
        assert_eq!(at(line), Err((code, 3)), "{line}");
    }
    // Both cycles, plain or load-adaptive, ignore the tool's radius.
    for line in ["G82 X52 Z-20 D1", "G75 X52 Z-20 K1", "G82 X52 Z-20 Q1"] {
        let program = format!("G21 G18 F60\nG0 X30 Z1\nG41.1 D0.8 L2\nG0 X28 Z0\n{line}\n");
        let settings = Settings {
            features: MachineFeatures {
                load_channel: true,
                ..lathe().features
            },
            ..lathe()
        };
        let error = run_with(&program, settings).unwrap_err();
        assert_eq!((error.code, error.line), (Code::CompensationActive, 5), "{line}");
        assert!(error.help.is_some_and(|help| help.contains("G40")), "{line}");
    }
    let mill = run_with("G21 F60\nG82 X5 Y5 Z-3 R1 P2\nM2\n", Settings::default()).unwrap();
    assert!(mill.contains(&Action::Dwell { seconds: 2.0 }));
    let error = run_with("G75 X1 Z1\n", Settings::default()).unwrap_err();
    assert_eq!(error.code, Code::UnsupportedG);
}

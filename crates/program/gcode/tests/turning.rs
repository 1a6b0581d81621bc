//! Cycles of a lathe compared with the shape that they leave, and other properties of turning.

#![expect(clippy::panic, reason = "a test may fail")]

use evolvent_gcode::{Action, Code, Diagnostic, Interpreter, Move, MoveKind, Settings};
use evolvent_path::{Axes, Curve};
use evolvent_random::{Random, cases};

fn actions(program: &str) -> Result<Vec<Action>, Diagnostic> {
    Interpreter::new(program.as_bytes(), Settings::default())
        .map(|item| item.map(|command| command.action))
        .collect()
}

fn moves(program: &str) -> Vec<Move> {
    let all = actions(program).unwrap_or_else(|error| panic!("{}\n{program}", error.render("x")));
    let moves = all.into_iter().filter_map(|action| match action {
        Action::Move(step) => Some(step),
        _ => None,
    });
    moves.collect()
}

/// Height of a chain of points at `z`, which decreases along the chain; the maximum if there are several.
fn height(chain: &[(f64, f64)], z: f64) -> Option<f64> {
    let mut found: Option<f64> = None;
    for pair in chain.windows(2) {
        let ((z0, x0), (z1, x1)) = (pair[0], pair[1]);
        if (z1..=z0).contains(&z) && z0 > z1 {
            let x = x0 + (x1 - x0) * (z0 - z) / (z0 - z1);
            found = Some(found.map_or(x, |other| other.max(x)));
        }
    }
    found
}

#[test]
fn roughing_leaves_the_distance_to_any_profile() {
    let mut random = Random::new();
    for case in 0..cases(200) {
        // A profile of straight lines with pockets, below a stock of radius 30.
        let mut chain = vec![(0.0, 5.0 + (10.0 * random.unit()).round())];
        let mut text = format!("G0 X{} Z0\n", chain[0].1);
        for _ in 0..8 {
            let (z, _) = chain[chain.len() - 1];
            let next = (
                z - (1.0 + (5.0 * random.unit()).round()),
                5.0 + (20.0 * random.unit()).round(),
            );
            text += &format!("G1 X{} Z{}\n", next.1, next.0);
            chain.push(next);
        }
        let end = chain[chain.len() - 1].0;
        let rough = |code: &str| {
            let program =
                format!("G18 F100\nG0 X40 Z2\nO1 sub\n{text}O1 endsub\n{code} Q1 X30 Z1 D0.1 I3 R0.8\nM2\n");
            moves(&program)
        };
        for code in ["G71", "G71.1", "G71.2"] {
            // The first move starts at the machine's zero.
            for step in rough(code).into_iter().skip(1) {
                for fraction in 0..=8 {
                    let at = step
                        .curve
                        .at(f64::from(fraction) / 8.0 * step.curve.length())
                        .position;
                    if let Some(min_radius) = height(&chain, at[2]) {
                        // The distance is kept everywhere, along X at least as well as across.
                        assert!(
                            at[0] >= min_radius + 0.1 - 1e-3,
                            "case {case}, {code}: X{} Z{}",
                            at[0],
                            at[2]
                        );
                    }
                }
            }
        }
        // After G71 some cut is within the distance plus half a pass everywhere.
        let cuts: Vec<Move> = rough("G71")
            .into_iter()
            .filter(|step| step.kind == MoveKind::Feed)
            .collect();
        let mut z = -0.05;
        while z > end + 1.0 {
            let min_radius = height(&chain, z).unwrap();
            let reached = cuts
                .iter()
                .flat_map(|step| {
                    let count = (step.curve.length() / 0.05).ceil();
                    (0..=count as u32)
                        .map(move |k| step.curve.at(f64::from(k) / count * step.curve.length()).position)
                })
                .filter(|at| (at[2] - z).abs() < 0.06)
                .map(|at| at[0])
                .fold(f64::INFINITY, f64::min);
            // 0.1 across a slope is more along X: at most by the steepest slope of these profiles.
            assert!(
                reached - min_radius < 12.0,
                "case {case}: Z{z} is left at {reached}, {min_radius} wanted"
            );
            z -= 0.7;
        }
        let finish = format!("G18 F100\nG0 X40 Z2\nO1 sub\n{text}O1 endsub\nG70 Q1 X30 Z1\nM2\n");
        let ends: Vec<(f64, f64)> = moves(&finish)
            .iter()
            .filter(|step| step.kind == MoveKind::Feed)
            .map(|step| (step.curve.end()[2], step.curve.end()[0]))
            .collect();
        assert_eq!(ends, chain[1..], "case {case}");
    }
}

#[test]
fn a_profile_is_read_without_side_effects() {
    let program = "G18 F100 S5\nG0 X30 Z5\nO1 sub\nF7 S900 M3 G91\nG0 X[10 - #<_x>] Z[0 - #<_z>]\nG1 Z-5\n\
                   X5\nG90\n#100 = 3\nO1 endsub\nG71 Q1 X20 Z1 I50\nG1 X[#100]\nM2\n";
    let all = actions(program).unwrap();
    assert!(
        !all.iter()
            .any(|action| matches!(action, Action::Spindle { speed_rpm, .. } if *speed_rpm != 5.0)),
        "{all:?}"
    );
    let found = moves(program);
    let last = found.last().unwrap();
    assert!((last.feed_mm_s - 100.0 / 60.0).abs() < 1e-12);
    assert_eq!(last.curve.end()[0], 3.0);
    // The cycle starts at its own start, not at that of the profile.
    assert_eq!((found[1].curve.end()[0], found[1].curve.end()[2]), (20.0, 1.0));
    for pair in found.windows(2) {
        assert_eq!(pair[0].curve.end(), pair[1].curve.start());
    }
}

#[test]
fn invalid_profile_cycles_are_rejected() {
    let profile = "O1 sub\nG0 X10 Z0\nG1 Z-9\nX20\nO1 endsub\n";
    for (line, code) in [
        ("G71 X20 Z1", Code::WordMissing),
        ("G71 Q1 X20 Z1 D20", Code::ProfileRefused),
        ("G71 Q1 X20 Z1 I0", Code::OutOfRange),
        ("G71 Q1 X20 Z1 I0.00001", Code::OutOfRange),
        ("G71 Q1 X20 Z1 D-1", Code::OutOfRange),
        ("G70 Q1 X20 Z1 P0", Code::OutOfRange),
        ("G71 Q1 X20 Z1 Y3", Code::UnusedWord),
        ("G71 Q1 X20 Z1 K3", Code::UnusedWord),
        ("G71 Q77 X20 Z1", Code::SubroutineMissing),
        ("G17 G71 Q1 X20 Z1", Code::WrongPlane),
        ("G71 Q1 X20 Z1 M98 P1", Code::TwoUsers),
    ] {
        let error = actions(&format!("{profile}G18 F100\n{line}\nG0 X1\nM2\n")).unwrap_err();
        assert_eq!((error.code, error.line), (code, 7), "{line}: {error}");
    }
    for (body, code) in [
        ("", Code::ProfileRefused),
        ("G0 X1 Z1\n", Code::ProfileRefused),
        ("G0 X9 Z1\nG1 Z-5\nZ-2\n", Code::ProfileRefused),
        ("G0 X9 Z1\nG1 Z-5 A30\nX15\n", Code::ProfileRefused),
        ("G0 X9 Z1\nG1 Z-5 A-1\nX15\n", Code::OutOfRange),
        ("G0 X9 Z1\nG71 Q1 X20\n", Code::ProfileRefused),
        ("G0 X9 Z1\nM2\n", Code::ProfileRefused),
    ] {
        let error = actions(&format!("O1 sub\n{body}O1 endsub\nG18 F100\nG71 Q1 X20 Z1\nM2\n")).unwrap_err();
        assert_eq!(error.code, code, "{body}: {error}");
    }
}

/// Each of two numbers is valid by itself; together they would exhaust memory.
#[test]
fn cycles_with_too_many_passes_are_rejected() {
    let pocket = "O1 sub\nG0 X30 Z0\nG1 Z-5\nX10 Z-10\nZ-15\nX30 Z-20\nO1 endsub\n";
    let lathe = |line: &str| format!("{pocket}G18 F100\n{line}\nM2\n");
    for (program, line) in [
        // A pocket below a profile that begins at the stock's surface.
        (lathe("G71 Q1 X30 Z1 I0.00001"), 9),
        (lathe("G71.2 Q1 X30 Z1 I0.000000001"), 9),
        (lathe("G71.2 Q1 X30 Z1 I0.0001"), 9),
        (lathe("G70 Q1 X30 Z1 P90000"), 9),
        ("F100\nG91 G83 X1 Z-10 R0 Q0.001 L90000\nM2\n".to_owned(), 2),
        ("F100\nG91 G73 X1 Z-10 R0 Q0.001 L11\nM2\n".to_owned(), 2),
    ] {
        let error = actions(&program).unwrap_err();
        assert_eq!(
            (error.code, error.line),
            (Code::OutOfRange, line),
            "{program}: {error}"
        );
    }
    // Long cycles are accepted.
    assert!(moves(&lathe("G71.2 Q1 X30 Z1 I0.01")).len() > 2000);
    assert!(moves("F100\nG91 G83 X1 Z-10 R0 Q0.1 L100\nM2\n").len() > 10_000);
}

#[test]
fn an_arc_in_a_rotated_vertical_plane_is_circular() {
    let degrees = 30.0_f64;
    let program =
        format!("G21 F600\nG10 L2 P1 X4 Y5 Z6 R{degrees}\nG18\nG0 X10 Y2 Z0\nG3 X40 Z0 I15 K0 Y5\nM2\n");
    let found = moves(&program);
    // The same with an absolute centre.
    let absolute = program
        .replace("G18\n", "G18 G90.1\n")
        .replace("I15 K0", "I25 K0");
    for (same, step) in moves(&absolute).iter().zip(&found) {
        for fraction in [0.25, 0.5, 1.0] {
            let at = |step: &Move| step.curve.position(fraction * step.curve.domain());
            assert!((at(same) - at(step)).norm() < 1e-9);
        }
    }
    let (sin, cos) = degrees.to_radians().sin_cos();
    let turned = |x: f64, y: f64, z: f64| [cos * x - sin * y + 4.0, sin * x + cos * y + 5.0, z + 6.0];
    let arc = &found[1..];
    assert!(arc.len() > 2 && arc.iter().all(|step| matches!(step.curve, Curve::Blend(_))));
    let end = arc.last().unwrap().curve.end();
    for (found, expected) in end.iter().zip(turned(40.0, 5.0, 0.0)) {
        assert!((found - expected).abs() < 1e-9, "{end}");
    }
    let mut total = 0.0;
    for step in arc {
        total += step.curve.length();
        for fraction in 0..=16 {
            let at = step
                .curve
                .position(f64::from(fraction) / 16.0 * step.curve.domain());
            // In program coordinates: a semicircle of radius 15 about X25 Z0, Y rising with the angle.
            let (dx, dy, z) = (at[0] - 4.0, at[1] - 5.0, at[2] - 6.0);
            let (x, y) = (cos * dx + sin * dy, cos * dy - sin * dx);
            assert!(((x - 25.0).hypot(z) - 15.0).abs() < 1e-4, "{x} {z}");
            let angle = z.abs().atan2(25.0 - x);
            assert!(
                (y - 2.0 - 3.0 * angle / std::f64::consts::PI).abs() < 1e-3,
                "{y} at {angle}"
            );
        }
    }
    let helix = (15.0 * std::f64::consts::PI).hypot(3.0);
    assert!((total - helix).abs() < 1e-3, "{total} {helix}");
    for pair in found.windows(2) {
        assert_eq!(pair[0].curve.end(), pair[1].curve.start());
        assert_eq!(pair[1].kind, MoveKind::Feed);
    }
}

#[test]
fn uvw_cycles_behave_as_xyz_cycles() {
    for (plane, words) in [(17, "X3 Y4 Z-5"), (18, "X3 Z4 Y-5"), (19, "Y3 Z4 X-5")] {
        for cycle in ["G81", "G83 Q2", "G73 Q2", "G85", "G82 P1"] {
            let first = moves(&format!("F100\nG{plane} {cycle} {words} R1\nM2\n"));
            let second_words = words.replace('X', "U").replace('Y', "V").replace('Z', "W");
            let second = moves(&format!("F100\nG{plane}.1 {cycle} {second_words} R1\nM2\n"));
            assert_eq!(first.len(), second.len(), "{plane} {cycle}");
            for (first, second) in first.iter().zip(&second) {
                for axis in 0..3 {
                    assert_eq!(
                        first.curve.end()[axis],
                        second.curve.end()[axis + 6],
                        "{plane} {cycle}"
                    );
                    assert_eq!(second.curve.end()[axis], 0.0);
                }
            }
        }
    }
    assert_eq!(
        actions("F100\nG17.1\nG81 X1 Y1 Z-1 R1\n").unwrap_err().code,
        Code::UnusedWord
    );
}

#[test]
fn input_and_probe_results_reach_the_next_line() {
    let program = "G21 F100\nM66 P1 L3 Q2\nG0 X[#5399]\nG38.2 Z-10\nG1 X[#5063] Y[#5070]\nM2\n";
    let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
    let mut ends = Vec::new();
    while let Some(item) = interpreter.next() {
        match item.unwrap().action {
            Action::WaitInput { .. } => interpreter.set_input_result(7.0),
            Action::Probe { curve, .. } => {
                let mut at = curve.end();
                at[2] = -3.5;
                assert!(interpreter.set_probe_result(&at, &at, true));
                assert!(!interpreter.set_probe_result(&at, &Axes::repeat(f64::NAN), true));
            }
            Action::Move(step) => {
                ends.push((step.curve.start()[2], step.curve.end()[0], step.curve.end()[1]));
            }
            _ => {}
        }
    }
    assert_eq!(ends, [(0.0, 7.0, 0.0), (-3.5, -3.5, 1.0)]);
    // Without a reply: a timeout, and no contact.
    assert_eq!(moves(program)[0].curve.end()[0], -1.0);
}

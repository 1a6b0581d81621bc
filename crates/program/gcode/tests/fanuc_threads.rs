//! G32 and G92 of Fanuc's lathes, if the machine file enables them.

use evolvent_gcode::{Action, Code, Diagnostic, Interpreter, MachineFeatures, Settings};
use evolvent_path::Curve;

/// A thread or rapid: from, to (X radius, Z), path per revolution, angle, position at which the tool is
/// clear.
type PathMove = ([f64; 2], [f64; 2], Option<(f64, f64, Option<f64>)>);

fn read(program: &str, fanuc_threads: bool) -> (Vec<PathMove>, Vec<Diagnostic>) {
    let settings = Settings {
        features: MachineFeatures {
            fanuc_threads,
            lathe: true,
            ..MachineFeatures::default()
        },
        ..Settings::default()
    };
    let (mut path_moves, mut errors) = (Vec::new(), Vec::new());
    for command in Interpreter::new(program.as_bytes(), settings) {
        let point = |curve: &Curve, end: bool| {
            let at = if end { curve.end() } else { curve.start() };
            [at[0], at[2]]
        };
        match command.map(|command| command.action) {
            Ok(Action::Move(motion)) => {
                path_moves.push((point(&motion.curve, false), point(&motion.curve, true), None));
            }
            Ok(Action::Thread {
                curve,
                pitch_mm,
                start_degrees,
                clear_x,
                ..
            }) => path_moves.push((
                point(&curve, false),
                point(&curve, true),
                Some((pitch_mm, start_degrees, clear_x)),
            )),
            Ok(_) => {}
            Err(error) => errors.push(error),
        }
    }
    (path_moves, errors)
}

const HEAD: &str = "G21 G18 G90 G8 G94 S500 M3\nG0 X15 Z5\n";

#[test]
fn g32_leads_along_its_longer_axis() {
    let program = format!("{HEAD}G32 Z-20 F1.5\nX17 Z-22 Q90000\nG0 X20\nM2\n");
    let (path_moves, errors) = read(&program, true);
    assert_eq!(errors, []);
    let length = 8.0_f64.sqrt();
    assert_eq!(
        path_moves[1],
        ([15.0, 5.0], [15.0, -20.0], Some((1.5, 0.0, None)))
    );
    let (from, to, thread) = path_moves[2];
    assert_eq!((from, to), ([15.0, -20.0], [17.0, -22.0]));
    let (pitch, degrees, _) = thread.unwrap();
    // Both axes move by 2 mm, so each moves by 1.5 mm per revolution.
    assert!((pitch - 1.5 * length / 2.0).abs() < 1e-12, "{pitch}");
    assert_eq!(degrees, 90.0);
}

#[test]
fn g92_cuts_a_box_per_depth_and_returns() {
    let program = format!("{HEAD}G92 X14.5 Z-20 R-1 F2\nX14.2\nG0 X20\nM2\n");
    let (path_moves, errors) = read(&program, true);
    assert_eq!(errors, []);
    // The lead refers to Z, for any taper.
    let taper = 2.0 * 626.0_f64.sqrt() / 25.0;
    for (pass, depth) in [14.5, 14.2].into_iter().enumerate() {
        let box_moves = &path_moves[1 + 4 * pass..5 + 4 * pass];
        assert_eq!(box_moves[0], ([15.0, 5.0], [depth - 1.0, 5.0], None));
        let (from, to, thread) = box_moves[1];
        assert_eq!((from, to), ([depth - 1.0, 5.0], [depth, -20.0]));
        let (pitch, degrees, clear) = thread.unwrap();
        assert!((pitch - taper).abs() < 1e-12, "{pitch}");
        assert_eq!((degrees, clear), (0.0, Some(15.0)));
        assert_eq!(box_moves[2], ([depth, -20.0], [15.0, -20.0], None));
        assert_eq!(box_moves[3], ([15.0, -20.0], [15.0, 5.0], None));
    }
    assert_eq!(path_moves.len(), 10);
}

#[test]
fn a_lead_is_no_feed_and_a_feed_no_lead() {
    let (_, errors) = read(&format!("{HEAD}G32 Z-20 F1.5\nG1 X20\nM2\n"), true);
    assert_eq!(errors.iter().map(|error| error.line).collect::<Vec<_>>(), [4]);
    let (_, errors) = read(&format!("{HEAD}G32 Z-20 F1.5\nG1 X20 F100\nG32 Z5\nM2\n"), true);
    assert_eq!(errors[0].code, Code::WordMissing);
    assert!(errors[0].message.contains("F"), "{:?}", errors[0]);
}

#[test]
fn invalid_threads_are_rejected_with_advice() {
    for (line, code, part) in [
        ("G92 S2000", Code::WordMissing, "highest spindle speed"),
        ("G92 Z-20 F1", Code::OutOfRange, "X"),
        ("G92 X14 F1", Code::WordMissing, "Z"),
        ("G92 X14 Z-20", Code::WordMissing, "F"),
        ("G92 X15 Z-20 F1", Code::OutOfRange, "depth"),
        ("G92 X14 Y1 Z-20 F1", Code::UnusedWord, "Y"),
        ("G32 Z-20 F1 Q360000", Code::OutOfRange, "Q"),
        ("M5\nG32 Z-20 F1", Code::SpindleSpeedMissing, "G32"),
    ] {
        let (_, errors) = read(&format!("{HEAD}{line}\nM2\n"), true);
        assert_eq!(
            errors.first().map(|error| error.code),
            Some(code),
            "{line}: {errors:?}"
        );
        assert!(errors[0].message.contains(part), "{line}: {errors:?}");
    }
}

#[test]
fn without_the_option_g32_fails_and_g92_offsets() {
    let (_, errors) = read(&format!("{HEAD}G32 Z-20 F1.5\nM2\n"), false);
    assert_eq!(errors[0].code, Code::UnknownG);
    assert!(
        errors[0]
            .help
            .as_deref()
            .unwrap_or_default()
            .contains("fanuc_threads"),
        "{errors:?}"
    );
    let (path_moves, errors) = read(&format!("{HEAD}G92 X0 Z0\nG0 X1 Z0\nM2\n"), false);
    assert_eq!(errors, []);
    assert_eq!(path_moves[1].1, [16.0, 5.0]);
}

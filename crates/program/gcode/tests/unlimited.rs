//! Unlimited rotary axes: the target of G90, and the angle that programs read. Values computed by hand.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use evolvent_gcode::{Action, Interpreter, Move, RotaryDirection, Settings};
use evolvent_path::Axes;

fn settings(direction: RotaryDirection) -> Settings {
    let mut settings = Settings::default();
    settings.features.unlimited[5] = Some(direction);
    settings
}

fn moves(program: &str, settings: Settings) -> Result<Vec<Move>, String> {
    let mut moves = Vec::new();
    for command in Interpreter::new(program.as_bytes(), settings) {
        if let Action::Move(step) = command.map_err(|error| error.render("test"))?.action {
            moves.push(step);
        }
    }
    Ok(moves)
}

/// C at the end of each move.
#[track_caller]
fn angles(program: &str, settings: Settings) -> Vec<f64> {
    let moves = moves(program, settings).unwrap();
    moves.iter().map(|step| step.curve.end()[5]).collect()
}

#[test]
fn every_motion_uses_the_shorter_direction() {
    let shorter = || settings(RotaryDirection::Shorter);
    assert_eq!(
        angles("G0 C350\nG1 F100 C10\nC100\nC-170\nG0 C0", shorter()),
        // Half a turn goes in the positive direction.
        [-10.0, 10.0, 100.0, 190.0, 360.0]
    );
    assert_eq!(
        angles("G0 C350\nG53 G0 C200\nG53 C0", shorter()),
        [-10.0, -160.0, 0.0]
    );
    assert_eq!(angles("G0 X10 C350\nG2 F100 X20 R5 C5", shorter()), [-10.0, 5.0]);
    // A word of more than a turn is an angle as well.
    assert_eq!(angles("G0 C725", shorter()), [5.0]);
    // At its angle already, it does not move.
    assert!(angles("G0 C90\nC450\nC-270", shorter()).len() == 1);
    // In G91 the word is the increment.
    assert_eq!(angles("G91 G0 C725\nC-1000", shorter()), [725.0, -275.0]);
}

#[test]
fn the_sign_selects_the_direction() {
    let sign = || settings(RotaryDirection::Sign);
    assert_eq!(
        angles("G0 C350\nC10\nC-350\nC-0\nC-90\nC90\nC0", sign()),
        // C90 is the position reached by C-90.
        [350.0, 370.0, 350.0, 0.0, -270.0, 0.0]
    );
    // The angle refers to the program's coordinates.
    assert_eq!(
        angles("G10 L2 P1 C30\nG0 C0\nC-350\nC10", sign()),
        [30.0, 20.0, 40.0]
    );
    for word in ["360", "-360", "400"] {
        let error = moves(&format!("G0 C{word}"), sign()).unwrap_err();
        assert!(error.contains("G0412") && error.contains("below 360"), "{error}");
    }
    assert_eq!(angles("G91 G0 C-400", sign()), [-400.0]);
}

#[test]
fn offsets_and_stored_positions_are_angles() {
    let shorter = || settings(RotaryDirection::Shorter);
    assert_eq!(
        angles("G0 C100\nG92 C0\nG0 C-10\nC300", shorter()),
        [100.0, 90.0, 40.0]
    );
    let far = Settings {
        start: Axes::from_fn(|axis, _| if axis == 5 { 3600.5 } else { 0.0 }),
        ..shorter()
    };
    assert_eq!(angles("G0 C0\nC90", far.clone()), [3600.0, 3690.0]);
    // G28 goes to the stored angle in the shorter direction.
    let stored = Settings {
        parameters: vec![(5166, 350.0)],
        ..far.clone()
    };
    assert_eq!(angles("G28 C0", stored), [3600.0, 3590.0]);
    // G10 L20 assigns a value to the present angle.
    assert_eq!(angles("G10 L20 P1 C0\nG0 C10", far), [3610.5]);
}

#[test]
fn programs_read_angles_within_one_turn() {
    let program = "G91 G0 C-10\nG90\nX[#5425] Y[#<_c>] Z[#<_abs_c>]\nG91 C380\nG90 X[#5425]";
    let moves_made = moves(program, settings(RotaryDirection::Shorter)).unwrap();
    let ends: Vec<_> = moves_made.iter().map(|step| step.curve.end()).collect();
    assert_eq!((ends[1][0], ends[1][1], ends[1][2]), (350.0, 350.0, 350.0));
    assert_eq!((ends[2][5], ends[3][0]), (370.0, 10.0));
}

#[test]
fn limited_rotary_axes_move_to_the_programmed_value() {
    let mut both = settings(RotaryDirection::Shorter);
    both.features.unlimited[3] = None;
    let moves = moves("G0 A350 C350", both).unwrap();
    let end = moves[0].curve.end();
    assert_eq!((end[3], end[5]), (350.0, -10.0));
}

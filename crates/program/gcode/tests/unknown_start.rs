//! Programs that start at an unknown position.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use evolvent_gcode::{Action, Interpreter, Settings};
use evolvent_path::{AXES, AxisLetter};

/// The axes whose position is unknown with each move, as letters; `unknown` at the start.
fn uncertain(unknown: &str, program: &str) -> Vec<String> {
    let letter = |axis: usize| AxisLetter::letter_of(axis);
    let settings = Settings {
        unhomed: std::array::from_fn(|axis| unknown.contains(letter(axis))),
        ..Settings::default()
    };
    let mut interpreter = Interpreter::new(program.as_bytes(), settings);
    let mut moves = Vec::new();
    while let Some(item) = interpreter.next() {
        if matches!(item.expect("a program without faults").action, Action::Move(_)) {
            let axes = interpreter.uncertain_axes();
            moves.push((0..AXES).filter(|axis| axes[*axis]).map(letter).collect());
        }
    }
    moves
}

#[test]
fn absolute_moves_define_the_position_of_an_axis() {
    assert_eq!(uncertain("", "G0 X1 Y1\nM2\n"), [""]);
    assert_eq!(
        uncertain("XZ", "G0 X1 Y1\nG91 Z1\nX1\nG90 Z5\nM2\n"),
        ["Z", "Z", "Z", ""]
    );
    assert_eq!(uncertain("XA", "G53 G0 A3\nG1 F100 X1\nM2\n"), ["X", ""]);
    // A move by an offset from an unknown position is as unknown as the offset, along its axis.
    assert_eq!(uncertain("X", "G92 X0\nG0 X1\nM2\n"), ["X"]);
    assert_eq!(uncertain("X", "G10 L20 P1 X0\nG0 X1\nM2\n"), ["X"]);
    assert_eq!(
        uncertain("XZ", "G92 X0 Y0 Z0\nG0 X1 Y1\nG53 G0 Z5\nM2\n"),
        ["XZ", "XZ"]
    );
    assert_eq!(
        uncertain("XZ", "G92 X0 Y0\nG0 X1\nG0 Z1\nG0 Y1\nM2\n"),
        ["XZ", "X", "X"]
    );
    // In rotated coordinates both axes of the plane depend on it.
    let rotated = "G10 L2 P1 R30\nG54\n";
    assert_eq!(
        uncertain("X", &format!("{rotated}G92 Y0\nG0 X1 Y1\nM2\n")),
        ["XY"]
    );
    assert_eq!(
        uncertain("X", &format!("{rotated}G0 X1\nG0 X1 Y2\nM2\n")),
        ["X", ""]
    );
    assert_eq!(uncertain("X", &format!("G92 X0\n{rotated}G0 Y1\nM2\n")), ["XY"]);
    assert_eq!(uncertain("X", "G10 L2 P1 X0\nG0 X1\nM2\n"), [""]);
    assert_eq!(uncertain("X", "G92 Y0\nG0 X1\nM2\n"), [""]);
}

#[test]
fn an_arc_from_an_unknown_position_is_no_error() {
    let arc = "F100 G2 X10 Y0 R3\nM2\n";
    let errors = |unhomed| {
        let settings = Settings {
            unhomed,
            ..Settings::default()
        };
        Interpreter::new(arc.as_bytes(), settings)
            .filter(Result::is_err)
            .count()
    };
    assert_eq!(errors([false; AXES]), 1);
    assert_eq!(errors(std::array::from_fn(|axis| axis == 0)), 0);
}

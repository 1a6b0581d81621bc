//! MDI blocks, and blocks that block delete skips.

use evolvent_gcode::{Action, Interpreter, Outputs, Settings, SpindleDirection};

use crate::interpreted::interpret;

#[test]
fn an_mdi_block_keeps_spindle_and_coolant() {
    let outputs = |program: &str, before: Outputs, is_mdi: bool| {
        let settings = Settings {
            outputs: before,
            is_mdi,
            ..Settings::default()
        };
        let (commands, found) = interpret(program, settings);
        assert!(found.is_empty(), "{found:?}");
        let mut after = before;
        for command in &commands {
            after.apply(&command.action);
        }
        (
            after.spindle(0).signed_rpm_at(0.0, 1.0, f64::INFINITY),
            after.mist,
            after.flood,
        )
    };
    let mut on = Outputs {
        flood: true,
        ..Outputs::default()
    };
    on.spindles[0].direction = SpindleDirection::Clockwise;
    on.spindles[0].speed_rpm = 600.0;
    let off = Outputs::default();
    assert_eq!(outputs("M3 S500 M7\n", off, true), (500.0, true, false));
    assert_eq!(outputs("G0 X1\n", on, true), (600.0, false, true));
    assert_eq!(
        outputs("S900\n", on, true),
        (900.0, false, true),
        "a running spindle takes the speed"
    );
    assert_eq!(outputs("M9\n", on, true), (600.0, false, false));
    assert_eq!(
        outputs("M5\nM2\n", on, true),
        (0.0, false, false),
        "M2 says so itself"
    );
    // The end of a program switches everything off, including outputs that were on before.
    assert_eq!(outputs("G0 X1\n", on, false), (0.0, false, false));
    assert_eq!(outputs("G0 X1\nM2\n", on, false), (0.0, false, false));
}

#[test]
fn lines_of_block_delete_are_counted() {
    for (block_delete, counted) in [(true, (2, 0)), (false, (0, 2))] {
        let settings = Settings {
            block_delete,
            ..Settings::default()
        };
        let mut interpreter = Interpreter::new(&b"G0 X1\n/G0 X2\n / G0 X3\n(/)\nM2\n"[..], settings);
        let moves = interpreter
            .by_ref()
            .filter(|command| matches!(command.as_ref().unwrap().action, Action::Move(_)))
            .count();
        assert_eq!(interpreter.block_delete_lines(), counted);
        assert_eq!(moves as u64, 1 + counted.1);
    }
}

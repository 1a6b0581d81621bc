//! Checks of programs while axes are not homed, when their positions are meaningless.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests fail as tests do"
)]

use std::path::Path;

use evolvent_machine::Machine;
use evolvent_path::{Axes, AxisMask};
use evolvent_runtime::{CheckBounds, Setup, check};

/// The errors of a program with the axes at (1000, 0, 0); the axes in the mask are not homed.
fn errors(unhomed: u32, program: &str) -> Vec<String> {
    errors_from(1000.0, unhomed, program)
}

/// The same with X at another position.
fn errors_from(x_mm: f64, unhomed: u32, program: &str) -> Vec<String> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let machine = Machine::parse(&text, "mill.toml").unwrap();
    let mut setup = Setup::new(machine, file, text, None).unwrap();
    let mut position = Axes::zeros();
    position[0] = x_mm;
    (setup.position, setup.unhomed) = (Some(position), AxisMask::from_bits(unhomed));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part.ngc");
    std::fs::write(&path, program).unwrap();
    let found = check(&path, &setup, CheckBounds::whole(9)).unwrap();
    (found.errors.iter())
        .map(|error| format!("{}: {}", error.line, error.message))
        .collect()
}

/// One message, of this line and axis.
#[track_caller]
fn is_of(found: &[String], line: u32, axis: char) {
    let [one] = found else { panic!("{found:?}") };
    let begin = format!("{line}: ");
    assert!(
        one.starts_with(&begin) && one.contains(&format!("axis {axis}")),
        "{one}"
    );
}

#[test]
fn an_unhomed_axis_may_be_outside_its_travel() {
    let goes_in = "G0 X10\nX20 Y5\nM2\n";
    is_of(&errors(0, goes_in), 1, 'X');
    assert_eq!(errors(0b001, goes_in), [] as [&str; 0]);
    // The axis need not move, and the distance that it moves says nothing.
    assert_eq!(errors(0b001, "G0 Y5\nG91 X5\nX-5\nM2\n"), [] as [&str; 0]);
}

#[test]
fn where_the_program_sends_it_is_known() {
    // Beyond the travel, at once and from within; also if another axis does so, homed or not.
    is_of(&errors(0b001, "G0 X401\nG0 X10\nM2\n"), 1, 'X');
    is_of(&errors(0b001, "G0 X399\nG91 X2\nM2\n"), 2, 'X');
    is_of(&errors(0b001, "G0 X10 Y251\nY0\nM2\n"), 1, 'Y');
    is_of(&errors(0b011, "G0 X10 Y251\nY0\nM2\n"), 1, 'Y');
    is_of(&errors(0b001, "G0 Y251\nY0\nM2\n"), 1, 'Y');
    assert_eq!(errors(0b011, "G91 G0 Y251\nY-251\nM2\n"), [] as [&str; 0]);
}

#[test]
fn an_axis_sent_to_its_own_position_is_known_there() {
    // The arc reaches X405.
    let bulges = "G0 X395 Y0\nG3 X395 Y20 I0 J10 F500\nG0 X0\nM2\n";
    is_of(&errors_from(395.0, 0b001, bulges), 2, 'X');
    is_of(&errors_from(0.0, 0b001, bulges), 2, 'X');
}

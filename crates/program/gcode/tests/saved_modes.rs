//! M70, M72 and M73 with tool lengths and cutter compensation.

use evolvent_gcode::{Action, Code, Interpreter, Settings, ToolTable};

const TOOLS: &str = "T1 Z10 D6\nT2 Z20 D8\n";

/// Z of the last move in machine coordinates, and the code and the line of the first error.
fn last(program: &str) -> (f64, Option<(Code, u32)>) {
    let settings = Settings {
        tools: ToolTable::parse(TOOLS).ok(),
        ..Settings::default()
    };
    let (mut z, mut error) = (f64::NAN, None);
    for command in Interpreter::new(program.as_bytes(), settings) {
        match command {
            Ok(command) => {
                if let Action::Move(step) = command.action {
                    z = step.curve.end()[2];
                }
            }
            Err(fault) => {
                error.get_or_insert((fault.code, fault.line));
            }
        }
    }
    (z, error)
}

#[test]
fn a_cancelled_length_is_restored_after_a_subroutine() {
    for (before, inside, z) in [
        ("G43", "G49", 11.0),
        ("G43 H2", "G49", 21.0),
        ("G43.1 Z7", "G49", 8.0),
        ("G49", "G43", 1.0),
        ("G49", "G43.1 Z7", 1.0),
        // As in LinuxCNC, one length does not replace another.
        ("G43", "G43 H2", 21.0),
        // A length that was measured in between.
        ("G43", "G49\nG10 L1 P1 Z15", 16.0),
        // The length of a tool that was changed in between.
        ("G43", "G49\nT2 M6", 21.0),
        ("G43.1 Z7", "G49\nT2 M6", 21.0),
    ] {
        let program = format!("T1 M6\no1 sub\nM73\n{inside}\no1 endsub\n{before}\no1 call\nG0 Z1\nM2\n");
        assert_eq!(last(&program), (z, None), "{before}, {inside}");
        let program = format!("T1 M6\n{before}\nM70\n{inside}\nM72\nG0 Z1\nM2\n");
        assert_eq!(last(&program), (z, None), "{before}, {inside}");
    }
}

#[test]
fn cancelled_compensation_is_not_restored() {
    let contour = "G21 F100\nG41.1 D2\nG1 X10\n";
    let program = format!("o1 sub\nM73\nG40\no1 endsub\n{contour}o1 call\nG1 X20\nM2\n");
    assert_eq!(last(&program).1, Some((Code::CompensationActive, 4)));
    let program = format!("{contour}M70\nG40\nG1 X12 Y5\nM72\nG1 X20\nM2\n");
    assert_eq!(last(&program).1, Some((Code::CompensationActive, 7)));
    // It continues, because it was not cancelled.
    let program = format!("{contour}M70\nG1 X12\nM72\nG1 X20\nG40\nM2\n");
    assert_eq!(last(&program).1, None);
}

#[test]
fn each_m98_repetition_starts_with_callers_modes() {
    for (inside, times, z) in [
        ("M73\nG91\nG1 Z1", 2, 9.0),
        ("M73\nG91 G1 Z1\nG20", 3, 9.0),
        // M70 alone is never restored.
        ("M70\nG91\nG1 Z1", 2, 11.0),
    ] {
        let program = format!("F100\nM98 P100 L{times}\nG1 Z9\nM30\nO100\n{inside}\nM99\n");
        assert_eq!(last(&program), (z, None), "{inside}");
    }
    // Modes saved in one repetition do not apply to the next one.
    let program = "F100\nM98 P100 L2\nM30\nO100\nO1 if [#1 EQ 1]\nM72\nO1 endif\n#1=1\nM70\nM99\n";
    assert_eq!(last(program).1, Some((Code::NothingSaved, 6)));
}

#[test]
fn restoring_modes_restores_g92_activity_but_not_values() {
    for (before, inside, z) in [
        ("", "G92 Z5", 1.0),
        ("", "G52 Z3", 1.0),
        ("G92 Z5", "G92.2", -4.0),
        ("G92 Z5", "G92 Z7", -6.0),
        ("G92 Z5", "G92.1", 1.0),
        ("G92 Z5\nG92.2", "G92.3", 1.0),
    ] {
        let program = format!("o1 sub\nM73\n{inside}\no1 endsub\n{before}\no1 call\nG0 Z1\nM2\n");
        assert_eq!(last(&program), (z, None), "{before}, {inside}");
        let program = format!("{before}\nM70\n{inside}\nM72\nG0 Z1\nM2\n");
        assert_eq!(last(&program), (z, None), "{before}, {inside}");
    }
    // The parameter agrees.
    assert_eq!(
        last("G92 Z5\nM70\nG92.2\nM72\nG53 G0 Z[7+#5210]\nM2\n"),
        (8.0, None)
    );
}

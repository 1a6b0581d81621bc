//! Lines of other lathes: none is executed with another meaning without a warning.

use evolvent_gcode::{Action, MachineFeatures, Settings};

use crate::interpreted::interpret;

pub(crate) type Messages = Vec<(u32, String)>;

/// Warnings and errors of a program on a lathe: line and text, with the help of errors.
pub(crate) fn on_lathe(program: &str) -> (Messages, Messages) {
    let settings = Settings {
        block_delete: false,
        axes: std::array::from_fn(|axis| matches!(axis, 0 | 2)),
        features: MachineFeatures {
            lathe: true,
            ..MachineFeatures::default()
        },
        ..Settings::default()
    };
    let (commands, errors) = interpret(program, settings);
    let warnings = commands.into_iter().filter_map(|command| match command.action {
        Action::Warning(text) => Some((command.line, text)),
        _ => None,
    });
    let errors = errors.into_iter().map(|error| {
        let help = error.help.as_deref().unwrap_or_default();
        (error.line, format!("{}; {help}", error.message))
    });
    (warnings.collect(), errors.collect())
}

#[test]
fn lines_of_other_lathes_are_errors_or_warnings() {
    // Program, whether it is an error, line, parts of the message.
    let start = "G18 G21 G0 X40 Z2\n";
    for (text, is_error, line, parts) in [
        (
            "G90 X28 Z-20 F0.2\nX26\n",
            true,
            2,
            ["turning cycle", "at rapid", "G1 Z.. F.."],
        ),
        (
            "G94 X0 Z0 F100\nZ-1\n",
            true,
            2,
            ["turning cycle", "at rapid", "G1 Z.. F.."],
        ),
        (
            "F100\nG90 X28 Z-20\n",
            false,
            3,
            ["turning cycle", "at rapid", "G1 Z.. F.."],
        ),
        (
            "G1 Z1 F100\nG90 X28 Z-20 F0.2\n",
            false,
            3,
            ["turning cycle", "straight", "G1 Z.. F.."],
        ),
        (
            "G92 X19.5 Z-20 F1.5\nX19\n",
            true,
            2,
            ["threading cycle", "sets an offset", "fanuc_threads = true"],
        ),
        (
            "G99\nG1 Z-1 F0.2\nX30 F0.1\n",
            false,
            3,
            ["feed per revolution", "per minute", "G95"],
        ),
        (
            "S100 M3 G95 F0.2\nG98\n",
            false,
            3,
            ["feed per minute", "per revolution", "G94"],
        ),
        (
            "T0101\n",
            false,
            2,
            ["tool 1 with offset 1", "only selects tool 101", "T1 M6 G43 H1"],
        ),
        (
            "T0300\n",
            false,
            2,
            ["tool 3 with offset 0", "only selects", "T3 M6 G49"],
        ),
        (
            "G73 U5 W2 R3\n",
            true,
            2,
            ["does not repeat a profile", "O1 sub", "G70 Q1"],
        ),
        (
            "G1 X20 F100\nZ-20 C1\n",
            true,
            3,
            ["no such axis", "a chamfer", "as a line"],
        ),
        (
            "G1 X20 Z-20 R2 F100\n",
            true,
            2,
            ["uses R", "rounding", "G2 or G3"],
        ),
        (
            "G1 X20 A45 F100\n",
            true,
            2,
            ["no such axis", "angle of a line", "end point"],
        ),
        (
            "G75 X10 K1 F0.1\n",
            true,
            2,
            ["facing cycle", "not grooving", "O1 while"],
        ),
        (
            "#3000=1(TOOL BROKEN)\n",
            false,
            2,
            ["ordinary parameter", "continues", "(ABORT"],
        ),
        ("#3006=1\n", false, 2, ["ordinary parameter", "(MSG", "M0"]),
    ] {
        let (warnings, errors) = on_lathe(&format!("{start}{text}M2\n"));
        let (found, others) = if is_error {
            (errors, warnings)
        } else {
            (warnings, errors)
        };
        assert_eq!(
            (found.len(), others.len()),
            (1, 0),
            "{text}: {found:?} {others:?}"
        );
        assert_eq!(found[0].0, line, "{text}: {found:?}");
        for part in parts {
            assert!(found[0].1.contains(part), "{text}: {part:?} is not in {found:?}");
        }
    }
}

/// A rejected line has no effect: neither its G99 nor its warning counts.
#[test]
fn rejected_lines_do_not_change_the_warning_of_g99() {
    let lines = |program: &str| -> (Vec<u32>, Vec<u32>) {
        let (warnings, errors) = on_lathe(&format!("G18 G21 G0 X40 Z2\n{program}M2\n"));
        let lines = |messages: Messages| messages.into_iter().map(|(line, _)| line).collect();
        (lines(warnings), lines(errors))
    };
    // The warning of the rejected line is given with the next.
    assert_eq!(lines("G99\nG2 X1 F0.2\nG1 Z1 F0.2\n"), (vec![4], vec![3]));
    // G99 of a rejected line.
    assert_eq!(lines("G99 G2 X1 F100\nG1 Z1 F0.2\n"), (vec![], vec![2]));
}

#[test]
fn lines_of_this_dialect_cause_no_warning_on_a_lathe() {
    for text in [
        "G90 G0 X28 Z-20\nG90 G1 X28 Z-20 F100\nG90 X20\nG90\nX30 Z2\n",
        "G94 F100\nG1 X28 Z-20\nG94 G1 X2 Z2\n",
        "G92 X10 Z0\nG92.1\nG53 G0 X1 Z1 G90\n",
        "G99\nG81 X2 Z-3 R1 F3\nG80\nG99 G95 S10 M3\nG1 X3 F0.2\n",
        "G99\nF100\nG1 Z1\n",
        "G99 G81 X2 Z-3 R1 F100\nG98 G81 X2 Z-3 R1\nG80\n",
        "G18 G21 G40 G80 G90 G94 G98\n",
        "T1 M6\nT12\nT0\nT101 M6\n",
        "#100=3\n#3001=0\n#3000=31.5\n",
    ] {
        let (warnings, errors) = on_lathe(&format!("G17 G21 G0 X40 Z2\n{text}M2\n"));
        assert_eq!((warnings, errors), (vec![], vec![]), "{text}");
    }
    // On mills G90 and G94 only set modes.
    let (commands, errors) = interpret(
        "G0 X1\nG90 X2 Z3 F100\nG99\nT0101\nG92 X1 F100\n",
        Settings::default(),
    );
    assert!(
        errors.is_empty()
            && !commands
                .iter()
                .any(|command| matches!(command.action, Action::Warning(_)))
    );
}

#[test]
fn lines_of_other_controls_name_their_replacement() {
    // Text of the line, its meaning, the replacement. On a lathe in G18, and on a mill unless the replacement
    // is for lathes.
    for (text, meaning, replacement) in [
        (
            "G83 Z-20 R2 Q5 F100",
            "G83 drills along Y in G18",
            "write G17 G83",
        ),
        (
            "G33 Z-17.3 F1.5",
            "takes its lead from K",
            "write K1.5 in place of F1.5",
        ),
        (
            "G76 P010060 Q100 R0.1",
            "one line with other words",
            "G76 P1.5 Z-20 I-1",
        ),
        (
            "G76 X18 Z-20 P920 Q300 F1.5",
            "one line with other words",
            "P lead",
        ),
        (
            "G76 X18 Z-20 K0.9 D0.3 F1.5",
            "one line with other words",
            "J first depth",
        ),
        ("G74 R1.", "left-hand tapping", "G17 G83 Z-20"),
        ("G74 Z-20 K5", "left-hand tapping", "Q is the depth of a peck"),
        ("G75 R1.", "not grooving", "G1 X.. F.."),
        ("G75 X0 I0.5", "not grooving", "G1 X.. F.."),
        ("#21= #21 + #23", "without brackets", "write #21 = [#21 + #23]"),
        ("N5 #3=[#21-1]*2", "without brackets", "write #3 = [[#21-1]*2]"),
        ("#5=#21-1 (next)", "without brackets", "write #5 = [#21-1]"),
        ("G50", "here is none to end", "delete G50"),
        ("G40 G15 G80", "here is none to end", "delete G15"),
        ("G50 S2000", "word D of G96", "G96 D2000"),
        ("G50 S800", "word D of G96", "every line with G96, as in G96 D800"),
        ("G50 X100 Z150.5", "is G92", "write G92 X100 Z150.5"),
        ("G50 U1 W1", "is G92", "the present position gets"),
        ("G2 X10 Z-5 R1", "radius", "write G7"),
        ("$H", "a command of Grbl", "home the machine"),
        ("$$", "a command of Grbl", "delete the line"),
        ("$J=G91 X10 F100", "$J is a command of Grbl", "G91 G1"),
        (":0100", "program number", "(O0100)"),
        ("G1 X1 Z1 ,R2.", "corner rounding", "G2 or G3"),
        ("G1 X1,C1", "chamfer", "G1 X.. Y.."),
        ("/2 G0 X1", "no levels", "write / without a number"),
        ("G28 U0 W0", "increments of X and Z", "write G28 alone"),
        ("G1 X5 W-2 F100", "increments of X and Z", "write G91"),
        ("M98 P51000", "repetitions", "write M98 P1000 L5"),
        ("M97 P100", "jump to a line number", "O100 sub"),
        ("G12 I5 F100", "circular pocket", "G3 I.."),
        ("G68.2 X0 Z0", "tilted planes", "axes of the machine"),
        ("G187 P1", "G187, the smoothness", "G64"),
        ("G1 X=10 F100", "words with =", "X10 in place of X=10"),
        ("G2 X1 Z1 CR=5", "the radius of an arc", "R5"),
        ("CYCLE81(10,0,2,-5)", "by name", "G81"),
        ("#<_a|#<b>>=1", "inside another name", "#[100 + #<b>]"),
    ] {
        let (_, errors) = on_lathe(&format!("G18 G21 S100 M3 F100\n{text}\n"));
        assert_eq!(errors.len(), 1, "{text}: {errors:?}");
        assert_eq!(errors[0].0, 2, "{text}: {errors:?}");
        for part in [meaning, replacement] {
            assert!(
                errors[0].1.contains(part),
                "{text}: {part:?} is not in {errors:?}"
            );
        }
    }
}

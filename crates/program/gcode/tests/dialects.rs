//! Lines of other dialects: the replacements that errors name, what is accepted, and warnings.

use evolvent_gcode::{Action, CanonicalCommand, Code, MachineFeatures, Settings, ToolTable};

use crate::interpreted::{errors, interpret};
use crate::lathe_dialects::on_lathe;

#[test]
fn lines_of_other_dialects_name_their_replacement() {
    // Program, line of the error, meaning of the line, replacement. One error each: no other error follows
    // from it.
    for (program, line, meaning, replacement) in [
        ("G21\nG05.1 Q1\nG0 X1\n", 2, "quadratic spline", "remove the line"),
        (
            "IF [#1 EQ 1] GOTO 10\nG0 X1\n",
            1,
            "conditions are O-words",
            "O1 if [#1 EQ 1]",
        ),
        (
            "N10 if[#1EQ1]then #2=3\nG0 X1\n",
            1,
            "conditions are O-words",
            "O1 endif",
        ),
        (
            "#1=0\nWHILE [#1 LT 3] DO1\n#1=[#1+1]\n",
            2,
            "loops are O-words",
            "O1 while [#1 LT 3]",
        ),
        (
            "M3 P1 S500\nG0 X1\n",
            1,
            "M3 selects the spindle by $",
            "write M3 $1 in place of M3 P1",
        ),
        ("M5 P3\nG0 X1\n", 1, "M5 selects the spindle by $", "write M5 $3"),
        (
            "M4 S100 P11\nG0 X1\n",
            1,
            "by $ in this dialect, not by P",
            "count from 0 to 3",
        ),
        ("M29 S1000\nG0 X1\n", 1, "M29, rigid tapping", "G33.1 Z.. K.."),
        (
            "M29 S500\nG0 X1\n",
            1,
            "M29, rigid tapping",
            "write S500 M3 in its place",
        ),
        ("M29\nG0 X1\n", 1, "M29, rigid tapping", "delete it"),
        (
            "(TITLE)\n%\nG0 X1\n",
            2,
            "in the middle",
            "move it to the first line",
        ),
        ("(TITLE)\n%PART 1\nG0 X1\n", 2, "text after %", "(PART 1)"),
        (
            "G0 G91 G28 Z0\nG0 X1\n",
            1,
            "both use the axis words",
            "leave G0 out",
        ),
        (
            "G1 G91 G28 Z0\nG0 X1\n",
            1,
            "both use the axis words",
            "two lines",
        ),
        ("G80\nX5\nG0 X1\n", 2, "no motion mode", "G80 ends"),
        ("F100\nG9 G1 X5\n", 2, "exact stop for one line", "G61.1"),
        (
            "G53 G90 G91.1 G40\nG0 X1\n",
            1,
            "G53 needs G0 or G1",
            "delete G53 if the line moves nothing",
        ),
        ("G44 H1\nG0 X1\n", 1, "subtracted", "write G43"),
        ("G27 X0\nG0 X1\n", 1, "check of the reference", "delete"),
        ("G29 X0\nG0 X1\n", 1, "return from the reference", "G0 Z"),
        ("G154 P2\nG0 X1\n", 1, "nine work offsets", "G59.3"),
        ("G54 P2\nG0 X1\n", 1, "further work offset", "G59.3"),
        ("G30 P2 Z0\nG0 X1\n", 1, "each has one", "delete P"),
        ("G8 P1\nG0 X1\n", 1, "look-ahead", "delete the line"),
        ("M99 P100\nG0 X1\n", 1, "return to another line", "O1 if"),
        ("M13 S500\nG0 X1\n", 1, "spindle and coolant", "M3 M8"),
        ("M17\nG0 X1\n", 1, "end of a subroutine", "endsub"),
        ("M10\nG0 X1\n", 1, "clamp", "user_codes"),
        ("M41\nG0 X1\n", 1, "gear", "user_codes"),
        ("M31\nG0 X1\n", 1, "chip conveyor", "user_codes"),
        ("G0 G80 Z10 M89\nG0 X1\n", 1, "through the spindle", "M9"),
        ("M84\nG0 X1\n", 1, "air blast", "M7"),
        ("M69\nG0 X1\n", 1, "clamp", "user_codes"),
        ("M24\nG0 X1\n", 1, "no M24", "100 to 199"),
        ("M215\nG0 X1\n", 1, "no M215", "100 to 199"),
        ("G00 G45 H03 Z2.0\nG0 X1\n", 1, "G45 to G48", "G43 H"),
        ("G47 P0 X2 Y2 E10 F15\nG0 X1\n", 1, "engraves", "characters"),
        ("G103 P1\nG0 X1\n", 1, "limit of the look-ahead", "delete"),
        ("G10 L2 P1 X0\nG11\nG0 X1\n", 2, "end of data input", "delete"),
        ("G112\nG0 X1\n", 1, "polar coordinate", "postprocessor"),
        ("G12.1\nG0 X1\n", 1, "polar coordinate", "postprocessor"),
        ("G50.1 X0\nG0 X1\n", 1, "mirror", "other sign"),
        ("G37 Z-10\nG0 X1\n", 1, "measurement of a tool", "G38.2"),
        ("G34 Z-10 F1 K0.1\nG0 X1\n", 1, "variable lead", "G33"),
        ("G78 X10 Z-5 F1\nG0 X1\n", 1, "G77 to G79", "G76"),
        ("G150 P1 X1 Y1\nG0 X1\n", 1, "pocket", "G13.2"),
        ("G10 L12 P5 R6\nG0 X1\n", 1, "G10 supports", "G10 L1 P.. R.."),
        (
            "F100\nG83 X9 Y2 Z-20 R2 Q2 P500\nG0 X1\n",
            2,
            "no dwell",
            "delete P500",
        ),
        ("F100\nG81 X1 Z-5 R1 K3\nG0 X1\n", 2, "repetitions", "write L3"),
        ("F100\nG81 X1 Z-5 R1 K0\nG0 X1\n", 2, "repetitions", "first hole"),
        ("F100\nG81 X1 Z-5 R1 L0\nG0 X1\n", 2, "1 to", "first hole"),
        ("F100\nG83 X1 Z-5 R1 Q1 I3\nG0 X1\n", 2, "same depth", "write Q"),
        ("$BR0137.MIN%\nG0 X1\n", 1, "name of a program", "comment"),
        ("G0 X1,5 Y2\nG0 X1\n", 1, "X1,5", "write X1.5"),
        ("G0 Y-12,25\nG0 X1\n", 1, "Y-12,25", "write Y-12.25"),
        ("\u{2}\nG0 X1\n", 1, "0x02", "transmission"),
        ("G0 X1\n\u{1a}\n", 2, "0x1A", "transmission"),
        (
            "F100 G0 X40.317 Y47.103\nG3 X39.997 Y46.783 I40.317 J46.783\n",
            2,
            "differs",
            "write G90.1",
        ),
        (
            "F100 G90.1\nG0 X10 Y0\nG3 X0 Y10 I-10 J0\n",
            3,
            "differs",
            "write G91.1",
        ),
        ("G0 X1\nEND1\n", 2, "loops end with an O-word", "O1 endwhile"),
        ("GOTO 10\nN10 G0 X1\n", 1, "no jumps", "O1 if"),
        (
            "G71\nG0 X1\n",
            1,
            "turning cycle in this dialect, not the selection of millimetres",
            "write G21",
        ),
        ("G70\nG0 X1\n", 1, "not the selection of inches", "write G20"),
        (
            "G05 P10000\nG0 X1\n",
            1,
            "high-speed machining",
            "remove the line",
        ),
        ("G50 S2000\nG0 X1\n", 1, "highest spindle speed", "G96 D2000"),
        ("G0 X1\nG92 S2000\n", 2, "highest spindle speed", "G96 D2000"),
        ("G71 U2 R1\nG0 X1\n", 1, "one line", "O1 sub"),
        ("G71 P10 Q20 U0.4 W0.1 F0.2\nG0 X1\n", 1, "one line", "O1 sub"),
        ("G70 P10 Q20\nG0 X1\n", 1, "one line", "O1 sub"),
        (
            "IF [#1 EQ 1] THEN #2=3\nG0 X1\n",
            1,
            "conditions are O-words",
            "in place of THEN",
        ),
        (
            "G68 X0 Y0 R30\nG0 X1\n",
            1,
            "rotated with a work offset",
            "G10 L2 P0 R30",
        ),
        ("G0 X1\nG69\n", 2, "rotation", "G10 L2 P0 R0"),
        ("G65 P1000 A1\nG0 X1\n", 1, "macro calls", "O1000 call [1] [2]"),
        ("G54.1 P3\nG0 X1\n", 1, "nine work offsets", "G59.3"),
        ("G4 X1.5\nG0 X1\n", 1, "takes its time from P", "G4 P1.5"),
        (
            "G0 X#<_ini[AXIS_X]MAX_LIMIT>\n",
            1,
            "an INI file",
            "#<_limit> = 400",
        ),
        (
            "G0 X#<_hal[spindle.0.speed]>\n",
            1,
            "HAL pins",
            "write the number",
        ),
    ] {
        let found = errors(program);
        assert_eq!(found.len(), 1, "{program}: {found:?}");
        let text = format!(
            "{} {}",
            found[0].message,
            found[0].help.clone().unwrap_or_default()
        );
        assert_eq!(found[0].line, line, "{program}");
        assert!(
            text.contains(meaning) && text.contains(replacement),
            "{program}: {text}"
        );
    }
}

/// Lines of this dialect with an error keep that error.
#[test]
fn errors_in_this_dialect_name_no_other() {
    for program in [
        "G18 F1\nG70 Q10 X20 Z1 P2\nM2\n",
        "G18 F1\nG71 Q10 X20 Z1 D1\nM2\n",
        "G5 X1 Y1 P1 Q1\nM2\n",
        "G92 X1 S-5\nM2\n",
    ] {
        let found = errors(program);
        assert!(!found.is_empty(), "{program}");
        assert!(
            !found.iter().any(|error| format!("{error:?}").contains("dialect")),
            "{program}: {found:?}"
        );
    }
}

#[test]
fn valid_words_of_other_dialects_are_accepted() {
    for program in [
        "O1 if [1 EQ 1]\nG0 X1\nO1 endif\n",
        "#1=0\nO1 while [#1 LT 3]\n#1=[#1+1]\nO1 endwhile\n",
        "G5.1 X1 Y1 I0.5 J1 F100\n",
        "G18 F100\nO1 sub\nG1 X1 Z-1\nO1 endsub\nG0 X2 Z1\nG71 Q1 X2 Z1\n",
        "G4 P1.5\n",
        "#<_limit>=4\nG0 X#<_limit>\n",
    ] {
        let found: Vec<_> = errors(program)
            .into_iter()
            .filter(|error| error.code != Code::ProfileRefused)
            .collect();
        assert!(
            found
                .iter()
                .all(|error| !format!("{error:?}").contains("dialect")),
            "{program}: {found:?}"
        );
    }
}

#[test]
fn a_dwell_of_a_thousand_seconds_is_a_warning() {
    let warnings = |program: &str| {
        let (commands, errors) = interpret(program, Settings::default());
        assert!(errors.is_empty(), "{errors:?}");
        let is_warning = |command: &&CanonicalCommand| matches!(command.action, Action::Warning(_));
        commands.iter().filter(is_warning).cloned().collect::<Vec<_>>()
    };
    let found = warnings("G0 X1\nG4 P1000\n");
    assert_eq!((found.len(), found[0].line), (1, 2));
    let Action::Warning(text) = &found[0].action else {
        unreachable!("a warning")
    };
    assert!(text.contains("1000 seconds") && text.ends_with("P1"), "{text}");
    // Once for the line with the value, not for every hole.
    let found = warnings("F100 G0 Z5\nG82 X1 Z-1 R1 P500\nX2\nX3\nG80\n");
    assert_eq!((found.len(), found[0].line), (1, 2));
    for short in ["G4 P99\n", "G4 P0.5\n", "G4 P120.5\n"] {
        assert!(warnings(short).is_empty(), "{short}");
    }
}

#[test]
fn lines_of_other_mills_name_their_replacement() {
    for (text, meaning, replacement) in [
        ("G76 X0 Y0 Z-20 R2 Q0.2 F50", "not fine boring", "M19 R0"),
        ("G17 G2 X10 Y0 I5 J0 K0.000", "K", "delete K0"),
        ("G2 X10 Y0 R1", "", "at least half"),
    ] {
        let found = errors(&format!("G21 F100\n{text}\n"));
        assert_eq!(found.len(), 1, "{text}: {found:?}");
        let reported = format!(
            "{}; {}",
            found[0].message,
            found[0].help.as_deref().unwrap_or_default()
        );
        assert!(
            reported.contains(meaning) && reported.contains(replacement),
            "{text}: {reported}"
        );
        assert!(!reported.contains("G7 "), "{text}: {reported}");
    }
    let found = errors("%O1000\nG0 X1\nM2\n");
    let help = found[0].help.as_deref().unwrap_or_default();
    assert!(
        found.len() == 1 && found[0].message.contains("alone") && help.contains("next line"),
        "{found:?}"
    );
    let (_, found) = on_lathe("G18 F100\nG1 Y1 W2\n");
    assert!(
        found.len() == 1 && !found[0].1.contains("increments"),
        "{found:?}"
    );
    // Correct lines remain unchanged, and so do lines with other mistakes.
    assert_eq!(
        errors("#1=[#2+1] #3=-5 #4=#1\nS1 M3 $0\n/ G0 X1\nG50.5\n").len(),
        1
    );
}

#[test]
fn a_tool_word_with_an_offset_names_its_replacement() {
    let settings = Settings {
        features: MachineFeatures {
            lathe: true,
            ..MachineFeatures::default()
        },
        tools: Some(ToolTable::parse("T1 P1 Z5 D1\n").unwrap()),
        ..Settings::default()
    };
    let (_, errors) = interpret("T0102\n", settings.clone());
    assert!(errors[0].message.contains("tool 1 with offset 2"), "{errors:?}");
    let help = errors[0].help.as_deref().unwrap_or_default();
    assert!(
        help.starts_with("write T1 M6 G43 H2;") && help.contains("write G7"),
        "{help}"
    );
    let (_, errors) = interpret("G7\nT0102\n", settings);
    assert_eq!(errors[0].help.as_deref(), Some("write T1 M6 G43 H2"));
}

/// On other controls G10 L10 P R sets a length; here it sets the radius.
#[test]
fn a_tool_length_in_r_is_a_warning() {
    let warnings = |line: &str| {
        let (commands, errors) = interpret(&format!("{line}\nM2\n"), Settings::default());
        assert_eq!(errors, [], "{line}");
        let texts = commands.into_iter().filter_map(|command| match command.action {
            Action::Warning(text) => Some(text),
            _ => None,
        });
        texts.collect::<Vec<_>>()
    };
    for line in ["G10 L10 P5 R-112.5", "G10 L11 P5 R0.02"] {
        let texts = warnings(line);
        assert!(
            matches!(&texts[..], [text] if text.contains("the radius of tool 5") && text.contains("G10 L1 P5 Z")),
            "{texts:?}"
        );
    }
    for line in ["G10 L1 P5 R3", "G10 L10 P5 Z0 R3", "G10 L10 P5 Z0"] {
        assert_eq!(warnings(line), Vec::<String>::new(), "{line}");
    }
}

#[test]
fn m19_angle_of_another_dialect_is_a_warning() {
    let warnings = |line: &str| {
        let (commands, errors) = interpret(&format!("G21\n{line}\nM2\n"), Settings::default());
        assert_eq!(errors, [], "{line}");
        let texts = commands.into_iter().filter_map(|command| match command.action {
            Action::Warning(text) => Some((command.line, text)),
            _ => None,
        });
        texts.collect::<Vec<_>>()
    };
    // As in LinuxCNC, S is a speed on every line, and M19 without R turns to 0 degrees.
    let reported = warnings("M19 S90");
    assert!(
        matches!(&reported[..], [(2, text)] if text.contains("M19 R90") && text.contains("speed")),
        "{reported:?}"
    );
    for line in ["M19", "M19 R90", "M19 R90 S300", "M19 S1500", "S90"] {
        assert_eq!(warnings(line), [], "{line}");
    }
}

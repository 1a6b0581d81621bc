//! Values that other dialects write in other units or read from other parameters: a warning, because the line
//! is executed.

use evolvent_gcode::{Action, Interpreter, Settings};

fn warnings_with(program: &str, settings: Settings) -> Vec<(u32, String)> {
    let found = Interpreter::new(program.as_bytes(), settings).filter_map(Result::ok);
    let texts = found.filter_map(|command| match command.action {
        Action::Warning(text) => Some((command.line, text)),
        _ => None,
    });
    texts.collect()
}

fn warnings(program: &str) -> Vec<(u32, String)> {
    warnings_with(program, Settings::default())
}

#[test]
fn system_variables_of_macro_programs_are_warned_about_once() {
    for (line, meaning) in [
        ("G0 Z[#5043+5]", "#5420"),
        ("G10 L2 P1 X[#5221+#5041]", "#5420"),
        ("#1=#5021", "#<_abs_x>"),
        ("#2=#4001", "#<_motion_mode>"),
        ("o1 if [#4003 EQ 90]\no1 endif", "#<_absolute>"),
        ("#3=#3012", "there is none"),
    ] {
        let found =
            warnings(&format!("G0 X1\n{line}\n{line}\nM2\n").replace("\no1 endif\no1", "\no1 endif\no2"));
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].0 == 2 && found[0].1.contains(meaning), "{found:?}");
    }
    assert_eq!(
        warnings("#4002=0\no1 while [#4002 LT 3]\n#4002=[#4002+1]\no1 endwhile\nM2\n"),
        []
    );
    // Values set here or kept; numbers that other dialects do not use; numbers with a meaning in this
    // dialect.
    assert_eq!(
        warnings("#4001=3\nG0 X#4001\nG0 X[#5420+#5220+#5061+#2000+#5000]\nM2\n"),
        []
    );
    let settings = Settings {
        parameters: vec![(5043, 2.0)],
        ..Settings::default()
    };
    assert_eq!(warnings_with("G0 X#5043\nM2\n", settings), []);
}

/// A rejected line has no effect: its read is not reported with another line, and the next one is.
#[test]
fn rejected_lines_neither_lose_nor_misplace_the_warning_of_a_read() {
    for rejected in [
        // Rejected after the values were read, and while they were read.
        "G0 G1 X#5043",
        "G0 Z#5043 X[1/0]",
        // An assignment that is undone does not make the parameter the program's own.
        "#5043=0 G1 X1",
    ] {
        let lines = |line: &str| -> Vec<u32> {
            let found = warnings(&format!("{rejected}\n{line}\nM2\n"));
            found.into_iter().map(|(line, _)| line).collect()
        };
        assert!(lines("G0 X1").is_empty(), "{rejected}");
        assert_eq!(lines("G0 X#5043"), [2], "{rejected}");
    }
}

#[test]
fn a_peck_in_micrometres_is_a_warning() {
    let hole = |words: &str| warnings(&format!("G21 F100\nG0 Z5\nG83 X1 Z-20 R2 {words}\nG80\nM2\n"));
    let found = hole("Q5000");
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].1.contains("5000 micrometres are Q5"), "{found:?}");
    for words in ["Q5", "Q25", "Q22.5"] {
        assert_eq!(hole(words), [], "{words}");
    }
}

#[test]
fn a_tapping_pitch_as_feed_per_minute_is_a_warning() {
    let tap = |words: &str, cycle: &str| {
        let direction = if cycle == "G84" { "M3" } else { "M4" };
        warnings(&format!(
            "G21\nS500 {direction}\nG0 Z5\n{words}{cycle} X0 Y0 Z-20 R5\nX10\nG80\nM2\n"
        ))
    };
    for cycle in ["G84", "G74"] {
        let found = tap("F1.25 ", cycle);
        assert_eq!(found.len(), 1, "{found:?}");
        let text = &found[0].1;
        assert!(
            text.contains("0.0025 mm") && text.contains("write F625.0000"),
            "{text}"
        );
        for words in ["F625 ", "G95 F1.25 ", "F100 ", "G20\nF24.6\nG21\n"] {
            assert_eq!(tap(words, cycle), [], "{words}");
        }
    }
}

#[test]
fn a_feed_before_a_unit_change_is_a_warning() {
    for (program, found) in [
        (
            "G20\nG21 G1 X10 F500\nM2\n",
            Some("F500 counts in inches, because G21"),
        ),
        ("G21\nG20 G1 X1 F5\nM2\n", Some("F5 counts in mm, because G20")),
        ("G21 G1 X10 F500\nM2\n", None),
        ("G20\nG21\nG1 X10 F500\nM2\n", None),
        ("G20\nG93\nG21 G1 X10 F5\nM2\n", None),
    ] {
        let warned = warnings(program);
        let texts: Vec<&str> = warned.iter().map(|(_, text)| text.as_str()).collect();
        match found {
            Some(text) => assert!(
                matches!(&texts[..], [one] if one.contains(text)),
                "{program}: {texts:?}"
            ),
            None => assert!(texts.is_empty(), "{program}: {texts:?}"),
        }
    }
}

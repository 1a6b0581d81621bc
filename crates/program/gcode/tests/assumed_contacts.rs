//! A check without a machine assumes contacts: errors that depend on them are warnings, all others remain
//! errors.

use evolvent_gcode::{Action, Code, Interpreter, Settings};

type Errors = Vec<(Code, u32)>;
type Warnings = Vec<(u32, String)>;

/// Codes and lines of errors, lines and texts of warnings.
fn found(program: &str) -> (Errors, Warnings) {
    let settings = Settings {
        probes_succeed: true,
        ..Settings::default()
    };
    let (mut errors, mut warnings) = (Vec::new(), Vec::new());
    for item in Interpreter::new(program.as_bytes(), settings) {
        match item {
            Ok(command) => {
                if let Action::Warning(text) = command.action {
                    warnings.push((command.line, text));
                }
            }
            Err(error) => errors.push((error.code, error.line)),
        }
    }
    (errors, warnings)
}

/// The axes X, Y, Z of every move that depend on an assumed contact, as letters, by line.
fn assumed(program: &str) -> Vec<(u32, String)> {
    let settings = Settings {
        probes_succeed: true,
        ..Settings::default()
    };
    let mut interpreter = Interpreter::new(program.as_bytes(), settings);
    let mut moves = Vec::new();
    while let Some(item) = interpreter.next() {
        let Ok(command) = item else {
            moves.push((0, "an error".to_owned()));
            continue;
        };
        if matches!(command.action, Action::Move(_) | Action::Probe { .. }) {
            let axes = interpreter.assumed_axes();
            let letters = "XYZ".chars().zip(axes).filter(|(_, assumed)| *assumed);
            moves.push((command.line, letters.map(|(letter, _)| letter).collect()));
        }
    }
    moves
}

const PROBE: &str = "G21 G90 G17\nF100\nG38.3 Z-5\n";

#[test]
fn the_test_of_a_contact_is_not_an_error() {
    let program = format!("{PROBE}o1 if [#5070 EQ 0]\n(ABORT, no contact)\no1 endif\nG91 G0 Z2\nM2\n");
    let (errors, warnings) = found(&program);
    assert_eq!(errors, []);
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(
        warnings[0].0 == 3 && warnings[0].1.contains("no contact is known"),
        "{warnings:?}"
    );
}

#[test]
fn an_abort_on_an_assumed_result_is_a_warning() {
    for test in [
        // A rapid move that must not touch anything.
        "o1 if [#5070 EQ 1]\n(ABORT, touched)\no1 endif\n",
        "#100=#5063\n#101=[#100*2]\no1 if [#101 LT 0]\n(ABORT, deep)\no1 endif\n",
        "#<z>=#<_z>\no1 if [#<z> NE 1]\n(ABORT, elsewhere)\no1 endif\n",
        "o<s> sub\no1 if [#1 LT 0]\n(ABORT, deep)\no1 endif\no<s> endsub\no<s> call [#5063]\n",
        "o<s> sub\no<s> endsub [#5063]\no<s> call\no1 if [#<_value> LT 0]\n(ABORT, deep)\no1 endif\n",
        "o1 if [#5070 EQ 1]\n#7=1\no1 endif\no2 if [#7 EQ 1]\n(ABORT, touched)\no2 endif\n",
        "o<s> sub\n(ABORT, touched)\no<s> endsub\no1 if [#5070 EQ 1]\no<s> call\no1 endif\n",
        // The skipped line might have left the subroutine.
        "o<s> sub\no1 if [#5070 EQ 0]\no<s> return\no1 endif\n(ABORT, touched)\no<s> endsub\no<s> call\n",
    ] {
        let (errors, warnings) = found(&format!("{PROBE}{test}G0 Z1\nG77\nM2\n"));
        assert_eq!(errors.len(), 1, "{test}: {errors:?}");
        assert_eq!(errors[0].0, Code::UnknownG, "{test}: {errors:?}");
        assert_eq!(warnings.len(), 2, "{test}: {warnings:?}");
        assert!(
            warnings[1]
                .1
                .starts_with("no contact is known: the program aborts"),
            "{warnings:?}"
        );
    }
}

#[test]
fn the_result_of_an_input_depends_on_no_contact() {
    let test = "G10 L20 P1 Z0\nM66 P0 L3 Q0.1\no1 if [#5399 LT 0]\n(ABORT, no input)\no1 endif\n";
    let (errors, _) = found(&format!("{PROBE}{test}M2\n"));
    assert_eq!(errors, [(Code::ActiveComment, 7)]);
}

#[test]
fn an_end_on_an_assumed_result_is_a_warning() {
    let both = [
        "o1 if [#5070 EQ 1]\nM2\no1 endif\n",
        "o1 if [#5070 EQ 0]\nG0 Z9\no1 else\nG0 Z8 M30\no1 endif\n",
        "#100=#5063\no1 if [#100 LT 0]\no2 if [1 EQ 1]\nM30\no2 endif\no1 endif\n",
        "o<s> sub\nM2\no<s> endsub\no1 if [#5070 EQ 1]\no<s> call\no1 endif\n",
        "o<s> sub\no1 if [#1 LT 0]\nM2\no1 endif\no<s> endsub\no<s> call [#5063]\no<s> call [#5063]\n",
        "#7=3\no1 while [#7 GT 0]\no2 if [#5070 EQ 1]\nM2\no2 endif\n#7=[#7-1]\no1 endwhile\n",
    ];
    for test in both {
        let (errors, warnings) = found(&format!("{PROBE}{test}G0 Z1\nG77\nM2\nG78\n"));
        let codes: Vec<_> = errors.iter().map(|(code, _)| *code).collect();
        assert_eq!(codes, [Code::UnknownG], "{test}: {errors:?}");
        assert_eq!(warnings.len(), 2, "{test}: {warnings:?}");
        assert!(
            warnings[1]
                .1
                .starts_with("no contact is known: the program ends here"),
            "{test}: {warnings:?}"
        );
    }
    // The rest of the line is executed, but not the effects of the end.
    let program = format!("{PROBE}M3 S100\no1 if [#5070 EQ 1]\nG0 Z8 M2\no1 endif\nG0 Z1\nM2\n");
    let settings = Settings {
        probes_succeed: true,
        ..Settings::default()
    };
    let actions: Vec<_> = Interpreter::new(program.as_bytes(), settings)
        .map(|item| item.unwrap().action)
        .collect();
    let count = |of: fn(&Action) -> bool| actions.iter().filter(|action| of(action)).count();
    assert_eq!(count(|action| matches!(action, Action::ProgramEnd)), 1);
    assert_eq!(count(|action| matches!(action, Action::Move(_))), 2);
}

#[test]
fn an_end_after_an_assumed_exit_is_a_warning() {
    for test in [
        // With another result the subroutine is left before the end.
        "o<s> sub\no1 if [#5070 EQ 0]\no<s> return\no1 endif\nM2\no<s> endsub\no<s> call\n",
        "o<s> sub\no1 if [#5070 EQ 1]\nG0 Z9\no1 else\no<s> return [1]\no1 endif\nM30\no<s> endsub\n\
         o<s> call\n",
        "o<s> sub\no1 if [1 EQ 2]\no1 elseif [#5070 EQ 0]\no<s> return\no1 endif\nM2\no<s> endsub\n\
         o<s> call\n",
        "o<s> sub\no1 if [#5070 EQ 0]\no1 elseif [1 EQ 1]\nG0 Z9\no1 else\no<s> return\no1 endif\nM2\n\
         o<s> endsub\no<s> call\n",
        "o<s> sub\no1 while [#5070 EQ 0]\no<s> return\no1 endwhile\nM2\no<s> endsub\no<s> call\n",
        "o<s> sub\no1 if [#5070 EQ 0]\no2 if [1 EQ 1]\no<s> return\no2 endif\no1 endif\nM2\no<s> endsub\n\
         o<s> call\n",
        "o100 sub\no1 if [#5070 EQ 0]\nM99\no1 endif\nM2\no100 endsub\nM98 P100\n",
        // In a subroutine of the subroutine.
        "o<t> sub\nM2\no<t> endsub\no<s> sub\no1 if [#5070 EQ 0]\no<s> return\no1 endif\no<t> call\n\
         o<s> endsub\no<s> call\n",
        // A loop is left, or the rest of its body is skipped.
        "o9 repeat [2]\no1 if [#5070 EQ 0]\no9 break\no1 endif\nM2\no9 endrepeat\n",
        "o9 repeat [2]\no1 if [#5070 EQ 0]\no9 continue\no1 endif\nM2\no9 endrepeat\n",
        // The lines that `continue` skips might leave the subroutine.
        "o<s> sub\n#1=0\no9 while [#1 LT 2]\n#1=[#1+1]\no1 if [#5070 EQ 1]\no9 continue\no1 endif\n\
         o<s> return\no9 endwhile\nM2\no<s> endsub\no<s> call\n",
        "o<s> sub\no9 repeat [2]\no1 if [#5070 EQ 1]\no9 continue\no1 endif\no<s> return\no9 endrepeat\nM2\n\
         o<s> endsub\no<s> call\n",
        // A value that is set only with another result.
        "o100 sub\no1 if [#5070 EQ 0]\nm 99 P#<none>\no1 endif\nM2\no100 endsub\nM98 P100\n",
        "o<s> sub\no9 do\no1 if [#5070 EQ 1]\no9 break\no1 endif\no<s> return\no9 while [1]\nM2\n\
         o<s> endsub\no<s> call\n",
    ] {
        let (errors, warnings) = found(&format!("{PROBE}{test}G0 Z1\nG77\nM2\nG78\n"));
        let codes: Vec<_> = errors.iter().map(|(code, _)| *code).collect();
        assert_eq!(codes, [Code::UnknownG], "{test}: {errors:?}");
        assert!(
            warnings.len() == 2
                && warnings[1]
                    .1
                    .starts_with("no contact is known: the program ends here"),
            "{test}: {warnings:?}"
        );
    }
    // The end after the loop, the end after the subroutine, and exits that no result reaches.
    for test in [
        "o9 repeat [2]\no1 if [#5070 EQ 0]\no9 break\no1 endif\no9 endrepeat\nM2\n",
        "o<s> sub\no1 if [#5070 EQ 0]\no<s> return\no1 endif\no<s> endsub\no<s> call\nM2\n",
        "o<s> sub\no1 if [1 EQ 2]\no<s> return\no1 endif\nM2\no<s> endsub\no<s> call\n",
        "o<s> sub\no1 if [#5070 EQ 1]\no2 if [1 EQ 2]\no<s> return\no2 endif\no1 endif\nM2\no<s> endsub\n\
         o<s> call\n",
        "o<s> sub\no1 if [#5070 EQ 0]\no9 repeat [3]\no9 break\no9 endrepeat\no1 endif\nM2\no<s> endsub\n\
         o<s> call\n",
    ] {
        let (errors, warnings) = found(&format!("{PROBE}{test}G77\n"));
        assert_eq!(
            (errors.len(), warnings.len()),
            (0, 1),
            "{test}: {errors:?} {warnings:?}"
        );
    }
    // An endless loop with such an end terminates as well.
    let program = format!("{PROBE}o1 while [1]\no2 if [#5070 EQ 0]\no1 break\no2 endif\nM2\no1 endwhile\n");
    assert_eq!(found(&program).0, []);
}

#[test]
fn an_end_that_does_not_depend_on_it_ends_the_program() {
    for test in [
        "M2\n",
        "M30\n",
        "#1=2\no1 if [#1 EQ 2]\nM2\no1 endif\n",
        "o1 if [#5070 EQ 0]\nG0 Z9\no1 endif\nM2\n",
        // A test of an earlier contact, in another branch.
        "o1 if [#5070 EQ 1]\nG0 Z9\no1 endif\no2 if [1 EQ 1]\nM30\no2 endif\n",
        "o<s> sub\nM2\no<s> endsub\no1 if [#5070 EQ 1]\nG0 Z9\no1 endif\no<s> call\n",
    ] {
        let (errors, warnings) = found(&format!("{PROBE}{test}G77\n"));
        assert_eq!(
            (errors.len(), warnings.len()),
            (0, 1),
            "{test}: {errors:?} {warnings:?}"
        );
    }
    // An endless loop with such an end terminates.
    let program = format!("{PROBE}o1 while [#5070 EQ 1]\nG0 Z1\nM2\no1 endwhile\n");
    assert_eq!(found(&program).0, []);
    // Without the assumption nothing changes.
    let program = format!("{PROBE}o1 if [#5070 EQ 0]\nM2\no1 endif\nG77\n");
    assert!(Interpreter::new(program.as_bytes(), Settings::default()).all(|item| item.is_ok()));
}

#[test]
fn independent_errors_remain_errors() {
    for (test, code) in [
        ("(ABORT, always)\n", Code::ActiveComment),
        (
            "#1=2\no1 if [#1 EQ 2]\n(ABORT, always)\no1 endif\n",
            Code::ActiveComment,
        ),
        ("#1=[1/0]\n", Code::Arithmetic),
        ("G0 X[#<nothing>]\n", Code::UndefinedParameter),
        ("#3=#5063\n#3=0\nG0 X[1/#3]\n", Code::Arithmetic),
        ("G77\n", Code::UnknownG),
        ("G1 X1 F0\n", Code::FeedZero),
        ("G0 X0 Y0 Z0\nG2 X10 Y0 I3 J0\n", Code::ArcRadiusMismatch),
    ] {
        let (errors, _) = found(&format!("{PROBE}{test}M2\n"));
        assert_eq!(
            errors.iter().map(|(code, _)| *code).collect::<Vec<_>>(),
            [code],
            "{test}"
        );
    }
    // Without the assumption nothing changes: no contact, and the program aborts.
    let program = format!("{PROBE}o1 if [#5070 EQ 0]\n(ABORT, no contact)\no1 endif\n");
    let mut items = Interpreter::new(program.as_bytes(), Settings::default());
    assert!(items.any(|item| item.is_err_and(|error| error.code == Code::ActiveComment)));
}

#[test]
fn an_error_from_an_assumed_value_is_a_warning() {
    for test in [
        "#1=[1/[#5063+5]]\n",
        "G91\nG2 X10 Y0 I[5+#5063] J0\n",
        "G38.2 X-5\nG90 G2 X10 Y0 I5 J0\n",
    ] {
        let (errors, warnings) = found(&format!("{PROBE}{test}M2\n"));
        assert_eq!(errors, [], "{test}");
        assert_eq!(warnings.len(), 2, "{test}: {warnings:?}");
    }
}

#[test]
fn positions_are_uncertain_until_commanded() {
    let of = |test: &str| {
        let mut moves = assumed(&format!("{PROBE}{test}M2\n"));
        moves.remove(0);
        moves.into_iter().map(|(_, axes)| axes).collect::<Vec<_>>()
    };
    assert_eq!(of("G0 X1\nG91 Z1\nG90 Z9\nG91 Z1\n"), ["Z", "Z", "", ""]);
    assert_eq!(of("G0 X[#5063]\nX2\n"), ["XZ", "Z"]);
    // An offset from an unknown position leaves every later one unknown, except in machine coordinates.
    assert_eq!(of("G10 L20 P1 Z0\nG0 Z5\nG53 G0 Z1\nG0 Z4\n"), ["Z", "", "Z"]);
    assert_eq!(of("G92 Z0\nG0 X1 Z5\n"), ["Z"]);
    assert_eq!(of("G10 L20 P1 X0\nG0 X5 Z3\n"), [""]);
    assert_eq!(of("G28\nG91 G0 Z1\n"), ["Z", ""]);
    // In a branch.
    assert_eq!(of("o1 if [#5070 EQ 1]\nG0 Z5\no1 endif\nG0 Z6\n"), ["Z", ""]);
    // A second probing move from there.
    assert_eq!(
        of("G91 G0 Z1\nG38.3 Z-2\nG90 G38.3 Z-7\nG0 Z0\n"),
        ["Z", "Z", "", ""]
    );
}

/// The lines with moves whose end may be unknown because of lines without effect.
fn uncertain(program: &str) -> Vec<u32> {
    let settings = Settings {
        probes_succeed: true,
        ..Settings::default()
    };
    let mut interpreter = Interpreter::new(program.as_bytes(), settings);
    let mut lines = Vec::new();
    while let Some(item) = interpreter.next() {
        let is_move = item.is_ok_and(|command| matches!(command.action, Action::Move(_)));
        if is_move && interpreter.uncertain_axes().contains(&true) {
            lines.push(interpreter.line());
        }
    }
    lines
}

#[test]
fn an_abort_that_is_not_executed_changes_no_state() {
    // The text of an (ABORT) has no words.
    let texts = [
        "(ABORT, contact too early)",
        "(abort,TOO HIGH: X#1 Y#2 Z#3 G10 L20 = @^)",
        "(ABORT, get the tool out)",
    ];
    for text in texts {
        let program = format!("{PROBE}o1 if [#5070 NE 0]\n{text}\no1 endif\nG0 X1 Y2 Z3\nX4\nM2\n");
        assert_eq!(uncertain(&program), [] as [u32; 0], "{text}");
    }
}

#[test]
fn an_assumed_error_makes_set_words_unknown() {
    let of = |line: &str| uncertain(&format!("{PROBE}{line}\nG1 X8\nG0 X4 Z9\nZ3\nM2\n"));
    // At this point #5063 is -5, where the probing move ends.
    assert_eq!(of("G1 Z[1/[#5063+5]] (to the top, G92 T1)"), [5]);
    assert_eq!(of("G1 Z[1/[#5063+5]] ; G54 and T1"), [5]);
    assert_eq!(of("#<GOT>=[1/[#5063+5]]"), [] as [u32; 0]);
    assert_eq!(of("G53 G0 Z[1/[#5063+5]]"), [5]);
    // Words that change, or may change, the reference of coordinates.
    assert_eq!(of("G92 Z[1/[#5063+5]]"), [5, 6, 7]);
    assert_eq!(of("g 5 5 X[1/[#5063+5]]"), [5, 6, 7]);
    assert_eq!(of("G#100 Z[1/[#5063+5]]"), [5, 6, 7]);
    assert_eq!(of("T1 M6 X[1/[#5063+5]]"), [5, 6, 7]);
}

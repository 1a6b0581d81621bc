//! Errors of O-words: one for each mistake, in the order of lines, with the word and the line with which its
//! block starts.

use evolvent_gcode::{Action, CanonicalCommand, Code, Diagnostic, Interpreter, Settings};

use crate::interpreted::interpret;

/// The only error of a program.
fn only_error(program: &str) -> Diagnostic {
    let (_, mut errors) = interpret(program, Settings::default());
    assert_eq!(errors.len(), 1, "{program}: {errors:#?}");
    errors.remove(0)
}

/// A program with one mistake, the line of its only error, and parts of the message.
fn is_one_error(program: &str, line: u32, expected_parts: &[&str]) {
    let error = only_error(program);
    assert_eq!(error.line, line, "{program}: {error:?}");
    for words in expected_parts {
        assert!(error.message.contains(words), "{program}: {}", error.message);
    }
}

#[test]
fn an_endsub_of_another_name_is_one_error_in_its_line() {
    let found = only_error("o<a> sub\nG0 X1\no<b> endsub\nG0 X2\nM2\n");
    assert_eq!((found.line, found.code), (3, Code::OWordOrder));
    assert!(found.message.contains("O<a> sub of line 1"), "{}", found.message);
    // Called from before it: the same.
    is_one_error(
        "o<a> call\nG0 X2\nM2\no<a> sub\nG0 X1\no<b> endsub\n",
        6,
        &["O<b> endsub", "O<a> sub of line 4"],
    );
    is_one_error("o<a> sub\nG0 X1\n", 2, &["O<a> sub starts in line 1"]);
}

#[test]
fn an_extra_endsub_is_one_error() {
    let expected_parts = ["O<b> endsub", "O<a> sub of line 1", "ends in line 4"];
    let program = "o<a> sub\nG1 F100 X1\no<b> endsub\no<a> endsub\no<a> call\nM2\n";
    is_one_error(program, 3, &expected_parts);
    let (commands, _) = interpret(
        "o<a> sub\no<b> endsub\nG0 X1\no<a> endsub\no<a> call\nM2\n",
        Settings::default(),
    );
    assert!(commands.iter().any(|command| command.line == 3), "{commands:?}");
    // Called from before it: the same.
    let before = "o<a> call\nM2\no<a> sub\nG0 X1\no<b> endsub\no<a> endsub\n";
    is_one_error(
        before,
        5,
        &["O<b> endsub", "O<a> sub of line 3", "ends in line 6"],
    );
}

#[test]
fn a_subroutine_inside_another_is_one_error() {
    let expected_parts = ["O<b> sub", "O<a> sub of line 1"];
    for remainder in [
        "o<a> endsub\no<b> endsub\no<a> call\nM2\n",
        "o<b> endsub\nG0 X2\no<a> endsub\no<a> call\nM2\n",
        "o<b> endsub\no<a> endsub\no<a> call\no<b> call\nM2\n",
    ] {
        is_one_error(
            &format!("o<a> sub\no<b> sub\nG0 X1\n{remainder}"),
            2,
            &expected_parts,
        );
    }
    let called_before = "o<a> call\nM2\no<a> sub\no<b> sub\nG0 X1\no<a> endsub\no<b> endsub\n";
    is_one_error(called_before, 4, &["O<b> sub", "O<a>"]);
}

#[test]
fn a_forgotten_endsub_is_one_error_at_the_next_sub() {
    let expected_parts = ["O<a> endsub is missing", "O<a> sub starts in line 1"];
    let two = "o<a> sub\nG0 X1\no<b> sub\nG0 X2\no<b> endsub\n";
    is_one_error(&format!("{two}o<a> call\no<b> call\nM2\n"), 3, &expected_parts);
    is_one_error(two, 3, &expected_parts);
    is_one_error(
        &format!("o<a> call\no<b> call\nM2\n{two}"),
        6,
        &["O<a> endsub is missing", "line 4"],
    );
}

#[test]
fn open_blocks_at_the_end_name_word_and_line() {
    for (block, end) in [
        ("o1 while [1]", "endwhile"),
        ("o1 while [0]", "endwhile"),
        ("o1 repeat [2]", "endrepeat"),
        ("o1 repeat [0]", "endrepeat"),
        ("o1 if [1]", "endif"),
        ("o1 if [0]", "endif"),
        ("o1 do", "while"),
        ("o1 sub", "endsub"),
    ] {
        let begin = block.split(' ').nth(1).unwrap();
        for remainder in ["", "\n", "\nG0 X2", "\nG0 X2\n"] {
            let error = only_error(&format!("%\nG21 F100\nG1 X1\n{block}{remainder}"));
            let what = format!("O<1> {end} is missing: O<1> {begin} starts in line 4");
            assert!(error.message.contains(&what), "{block:?}: {}", error.message);
            let last = if remainder.len() > 1 {
                (5, "G0 X2")
            } else {
                (4, block)
            };
            assert_eq!((error.line, &*error.source), last, "{block:?} {remainder:?}");
        }
    }
}

#[test]
fn open_mdi_blocks_name_no_earlier_line() {
    for block in ["o1 while [1]", "o1 if [1]", "o1 repeat [0]", "o1 sub"] {
        let settings = Settings {
            is_mdi: true,
            ..Settings::default()
        };
        let (_, errors) = interpret(&format!("G21\nG90\nG0\n{block}\n\n"), settings);
        assert_eq!(errors.len(), 1, "{errors:?}");
        let message = &errors[0].message;
        assert!(
            message.contains("starts in this block") && !message.contains("line 4"),
            "{message}"
        );
    }
}

#[test]
fn open_blocks_of_a_subroutine_file_are_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("bore.ngc"),
        "(a bore)\no<bore> sub\no2 if [1]\nG0 X1\no<bore> endsub\no3 while [0]\n",
    )
    .unwrap();
    std::fs::write(
        folder.path().join("cut.ngc"),
        "o<cut> sub\no2 repeat [2]\nG0 X1\n",
    )
    .unwrap();
    let settings = Settings {
        subroutine_folders: vec![folder.path().to_path_buf()],
        ..Settings::default()
    };
    let (_, errors) = interpret("o<cut> call\nM2\n", settings);
    assert_eq!(errors.len(), 1, "{errors:?}");
    assert_eq!((errors[0].line, &*errors[0].source), (3, "G0 X1"));
    let message = &errors[0].message;
    assert!(
        message.contains("O<2> endrepeat is missing: O<2> repeat starts in line 2"),
        "{message}"
    );
}

#[test]
fn an_end_with_the_wrong_number_is_one_error() {
    for (begin, end) in [("if", "endif"), ("while", "endwhile"), ("repeat", "endrepeat")] {
        let program = format!("o1 {begin} [1]\nG0 X1\no2 {end}\nM2\n");
        let begun = format!("O<1> {begin} of line 1");
        is_one_error(&program, 3, &[&format!("O<2> {end}"), &begun]);
    }
    // One too many.
    is_one_error(
        "o1 if [1]\no2 endif\nG0 X1\no1 endif\nM2\n",
        2,
        &["O<2> endif has no if"],
    );
}

#[test]
fn the_outermost_loop_is_reported_during_execution() {
    let program = "G0 X2\no1 while [1]\no2 repeat [3]\nG0 X1\nG0 X0\no2 endrepeat\no1 endwhile\n";
    let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
    assert_eq!(interpreter.next().unwrap().unwrap().line, 1);
    assert_eq!(interpreter.outermost_loop(), None);
    for _ in 0..20 {
        let _command = interpreter.next().unwrap().unwrap();
        let start = interpreter.outermost_loop().unwrap();
        assert_eq!((start.file, start.line), (None, 2));
    }
}

#[test]
fn a_file_without_its_subroutine_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let settings = || Settings {
        subroutine_folders: vec![folder.path().to_path_buf()],
        ..Settings::default()
    };
    std::fs::write(
        folder.path().join("bore.ngc"),
        "(a bore)\no<boring> sub\nG0 X1\no<boring> endsub\nM2\n",
    )
    .unwrap();
    std::fs::write(folder.path().join("plain.ngc"), "G0 X1\nG0 X2\n").unwrap();
    let (_, errors) = interpret("o<plain> call\nM2\n", settings());
    assert!(
        errors[0].message.contains("O<plain> sub is missing in ") && errors[0].message.ends_with("plain.ngc"),
        "{errors:?}"
    );
    std::fs::write(
        folder.path().join("bore.ngc"),
        "(a bore)\no<boring> sub\nG0 X1\no<boring> endsub\n",
    )
    .unwrap();
    let (_, errors) = interpret("o<bore> call\nM2\n", settings());
    assert!(
        errors[0].message.contains("O<bore> sub is missing in "),
        "{errors:?}"
    );
    let help = errors[0].help.as_deref().unwrap_or_default();
    assert!(help.contains("line 2 has O<boring> sub"), "{help}");
    // A file that has its subroutine, cut off.
    std::fs::write(folder.path().join("bore.ngc"), "o<bore> sub\nG0 X1\n").unwrap();
    let (_, errors) = interpret("o<bore> call\nM2\n", settings());
    assert!(errors[0].message.contains("endsub is missing"), "{errors:?}");
}

#[test]
fn percent_in_an_open_block_is_an_error() {
    // A block that is open at the % lacks its end, whether its lines are executed, skipped or collected.
    for (open, expected_parts) in [
        ("#1=0\no100 while [#1 LT 3]\n#1=[#1+1]\n", "O<100> endwhile"),
        ("#1=0\no100 while [#1 GT 3]\n#1=[#1+1]\n", "O<100> endwhile"),
        ("#1=0\no100 do\n#1=[#1+1]\n", "O<100> while"),
        ("#1=0\no100 repeat [2]\n#1=[#1+1]\n", "O<100> endrepeat"),
        ("#1=0\no100 if [#1 EQ 0]\n#1=1\n", "O<100> endif"),
        ("#1=0\no100 if [#1 NE 0]\n#1=1\n", "O<100> endif"),
    ] {
        is_one_error(&format!("%\n{open}%\n"), 5, &["the text ends", expected_parts]);
    }
    is_one_error("%\no100 sub\n#1=1\n%\n", 3, &["the text ends", "O<100> endsub"]);
    // If all blocks are complete, the % ends the program, and the lines after it are not read.
    let (commands, errors) = interpret(
        "%\no1 repeat [2]\nG0 X1\no1 endrepeat\n%\nG0 X?\n",
        Settings::default(),
    );
    assert_eq!(errors, []);
    assert!(matches!(
        commands.last().map(|last| &last.action),
        Some(Action::ProgramEnd)
    ));
}

/// The warnings of a program without errors: line and text. The last command is the end.
fn warnings(program: &str, settings: Settings) -> Vec<(u32, String)> {
    let (commands, errors) = interpret(program, settings);
    assert_eq!(errors, [], "{program}");
    assert!(
        matches!(commands.last().map(|last| &last.action), Some(Action::ProgramEnd)),
        "{program}: {commands:?}"
    );
    let warning = |command: &CanonicalCommand| match &command.action {
        Action::Warning(text) => Some((command.line, text.clone())),
        _ => None,
    };
    commands.iter().filter_map(warning).collect()
}

#[test]
fn unclosed_blocks_at_m2_are_a_warning() {
    // LinuxCNC executes each of these programs to its M2.
    for (block, end) in [
        ("o1 while [1]", "endwhile"),
        ("o1 repeat [2]", "endrepeat"),
        ("o1 do", "while"),
        ("o1 if [1]", "endif"),
    ] {
        let begin = block.split(' ').nth(1).unwrap();
        // A repeated number is another block.
        let another = "o1 repeat [2]\nG0 X3\no1 endrepeat\no1 if [1]\no1 endif\n";
        for remainder in [
            "",
            "G0 X2\nM2\n",
            &format!("{block}\n{another}"),
            "%\no1 endif\no1 endwhile\n",
        ] {
            let percent = if remainder.starts_with('%') { "%" } else { "" };
            let found = warnings(
                &format!("{percent}\nG0 X0\n{block}\nG0 X1 M2\n{remainder}"),
                Settings::default(),
            );
            let [(4, text)] = &found[..] else {
                panic!("{block:?} {remainder:?}: {found:?}")
            };
            let expected_parts = format!("O<1> {begin} of line 3, because O<1> {end} is missing");
            assert!(text.contains(&expected_parts), "{text}");
            assert_eq!(text.contains("not repeated"), begin != "if", "{text}");
        }
    }
}

#[test]
fn m2_in_a_closed_block_is_no_warning() {
    for program in [
        "o1 if [1]\nM2\no1 endif\nM2\n",
        "o1 if [1]\no2 if [1]\nM2\no2 else\nM2\no2 endif\no1 elseif [1]\nM2\no1 endif\n",
        "o1 while [1]\nG0 X1\no2 if [1]\nM2\no2 endif\no1 endwhile\n",
        "o1 do\no2 repeat [2]\nM2\no2 endrepeat\no1 while [1]\nM2\n",
        "o1 sub\no2 if [1]\nM2\no2 endif\no1 endsub\no3 if [1]\no1 call\no3 endif\n",
    ] {
        assert_eq!(warnings(program, Settings::default()), [], "{program}");
    }
}

#[test]
fn a_block_around_a_call_with_m2_is_a_warning() {
    let program = "o1 sub\no2 if [1]\nM2\no2 endif\no1 endsub\no3 if [1]\no1 call\nM2\n";
    let found = warnings(program, Settings::default());
    assert!(
        matches!(&found[..], [(3, text)] if text.contains("O<3> if of line 6")),
        "{found:?}"
    );
    let program = "o1 sub\no2 repeat [2]\nM2\no1 endsub\no3 if [1]\no1 call\no3 endif\nM2\n";
    let found = warnings(program, Settings::default());
    assert!(
        matches!(&found[..], [(3, text)] if text.contains("O<2> repeat of line 2")),
        "{found:?}"
    );
}

#[test]
fn open_blocks_at_endsub_are_a_warning() {
    // LinuxCNC executes it.
    for (block, end) in [("if [1]", "endif"), ("repeat [2]", "endrepeat"), ("do", "while")] {
        let begin = block.split(' ').next().unwrap();
        let program = format!("o1 sub\no2 {block}\nG0 X1\no1 endsub\no1 call\nM2\n");
        let found = warnings(&program, Settings::default());
        let expected_parts = format!("O<2> {begin} of line 2, because O<2> {end} is missing");
        assert!(
            matches!(&found[..], [(4, text)] if text.contains(&expected_parts)),
            "{found:?}"
        );
    }
    let program = "o1 sub\no2 if [1]\no1 return\no2 endif\no1 endsub\no1 call\nM2\n";
    assert_eq!(warnings(program, Settings::default()), []);
}

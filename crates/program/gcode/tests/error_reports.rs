//! Errors: one for each mistake, with the calls that led to it, also in loops and long lines.

use std::time::{Duration, Instant};

use evolvent_gcode::{Code, Diagnostic, Settings};

use crate::interpreted::{errors, interpret};

#[test]
fn errors_in_files_of_subroutines_name_the_calls() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write(
        "outer.ngc",
        "o<outer> sub\n(a line)\no<inner> call\no<outer> endsub\nM2\n",
    );
    write("inner.ngc", "o<inner> sub\nG0 X1\nG1 Y?\no<inner> endsub\nM2\n");
    let settings = Settings {
        subroutine_folders: vec![folder.path().to_path_buf()],
        ..Settings::default()
    };
    let (commands, found) = interpret("(main)\n\no<outer> call\nM2\n", settings);
    assert_eq!(found.len(), 1, "{found:?}");
    let file = |name: &str| folder.path().join(name).display().to_string();
    assert_eq!(found[0].file.as_deref(), Some(file("inner.ngc").as_str()));
    let calls: Vec<_> = found[0]
        .calls
        .iter()
        .map(|call| (call.file.as_deref(), call.line))
        .collect();
    assert_eq!(calls, [(Some(file("outer.ngc").as_str()), 3), (None, 3)]);
    let shown = found[0].render("main.ngc");
    for position in ["inner.ngc:3:5", "outer.ngc:3", "called from main.ngc:3"] {
        assert!(shown.contains(position), "{position} is not in\n{shown}");
    }
    // The move carries its origin as well, for consumers that reject it.
    let origin = commands[0].origin.as_ref().unwrap();
    assert_eq!(
        (commands[0].line, origin.line, &*origin.file),
        (3, 2, file("inner.ngc").as_str())
    );
}

/// The calls of an error: file name and line, the innermost first.
fn calls(error: &Diagnostic) -> Vec<(Option<String>, u32)> {
    let name = |file: &str| {
        let name = std::path::Path::new(file).file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    };
    let calls = error.calls.iter();
    calls
        .map(|call| (call.file.as_deref().map(name), call.line))
        .collect()
}

#[test]
fn errors_name_all_calls_of_a_recursion() {
    let program = |depth: u32| {
        format!(
            "o<down> sub\no1 if [#1 GT 1]\no<down> call [#1-1]\no1 else\nG1 X?\no1 endif\no<down> endsub\n\
             o<down> call [{depth}]\n"
        )
    };
    for depth in [1_usize, 2, 11, 60, 100] {
        let found = errors(&program(depth as u32));
        assert_eq!(found.len(), 1, "{depth}: {found:?}");
        let mut expected = vec![(None, 3); depth - 1];
        expected.push((None, 8));
        assert_eq!((found[0].line, calls(&found[0])), (5, expected), "{depth}");
        let shown = found[0].render("main.ngc");
        let reported = shown.lines().filter(|line| line.contains("called from")).count();
        assert_eq!(reported, depth.min(2), "{shown}");
        assert!(
            depth < 3 || shown.contains(&format!("main.ngc:3, {} calls deep", depth - 1)),
            "{shown}"
        );
    }
    // A call that is too deep fails in the calling line, in the deepest subroutine.
    let found = errors(&program(101));
    assert_eq!((found[0].line, found[0].calls.len()), (3, 100));
}

#[test]
fn an_error_that_ends_a_subroutine_names_it() {
    let (library, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let write = |folder: &tempfile::TempDir, name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).unwrap();
    };
    write(
        &library,
        "outer.ngc",
        "o<outer> sub\n\no<inner> call\nG1 Z?\no<outer> endsub\n",
    );
    // In the other folder; its endsub has another name, but still ends it.
    write(&other, "inner.ngc", "o<inner> sub\nG0 X1\nM70\no<wrong> endsub\n");
    let settings = Settings {
        subroutine_folders: vec![library.path().to_path_buf(), other.path().to_path_buf()],
        ..Settings::default()
    };
    let (commands, found) = interpret(
        "o<mine> sub\no<outer> call\no<mine> endsub\no<mine> call\nG1 A?\n",
        settings,
    );
    let of = |error: &Diagnostic| (error.line, calls(error));
    let outer = Some("outer.ngc".to_owned());
    let expected = [
        (4, vec![(outer, 3), (None, 2), (None, 4)]),
        (4, vec![(None, 2), (None, 4)]),
        (5, vec![]),
    ];
    assert_eq!(found.iter().map(of).collect::<Vec<_>>(), expected);
    let files: Vec<bool> = found.iter().map(|error| error.file.is_some()).collect();
    assert_eq!(files, [true, true, false]);
    assert!(found[0].file.as_deref().unwrap().ends_with("inner.ngc"));
    // A command carries the same calls.
    let chain = commands[0].calls.innermost_first();
    assert_eq!(chain.len(), 3);
    assert_eq!(
        chain.last().map(|call| (call.file.is_none(), call.line)),
        Some((true, 4))
    );
}

#[test]
fn loops_of_errors_are_abandoned_with_an_error() {
    for body in ["G1 X?\n", "G1 X?\nG0 X1\nG0 X2\n", "#1=[1/0]\n"] {
        let start = Instant::now();
        let found = errors(&format!("o1 repeat [100000000]\n{body}o1 endrepeat\nG0 X?\nM2\n"));
        assert!(
            start.elapsed() < Duration::from_secs(10),
            "{body}: {:?}",
            start.elapsed()
        );
        assert_eq!(found.len(), 2, "{body}: {found:?}");
        assert_eq!((found[0].line, found[1].code), (2, Code::TooManySteps), "{body}");
        assert!(found[1].message.contains("not checked"), "{}", found[1].message);
    }
    // A short loop is executed, and mistakes after it are found.
    let found = errors("o1 repeat [50]\nG1 X?\no1 endrepeat\nG0 Y?\nM2\n");
    assert_eq!(found.iter().map(|error| error.line).collect::<Vec<_>>(), [2, 4]);
}

#[test]
fn rendered_errors_have_true_columns() {
    for blanks in [0, 3, 90, 150, 400, 5000] {
        let program = format!(
            "G0{}X1 Q7 Y2{}\n",
            " ".repeat(blanks),
            "(a comment behind)".repeat(blanks / 10)
        );
        let found = errors(&program);
        let shown = found[0].render("part.ngc");
        assert!(!shown.contains(":::"), "{shown}");
        assert!(shown.contains(&format!("part.ngc:1:{}", blanks + 6)), "{shown}");
        // The mark is below the word.
        let lines: Vec<&str> = shown.lines().collect();
        let source = lines.iter().position(|line| line.contains("Q7")).unwrap();
        assert_eq!(lines[source].find("Q7"), lines[source + 1].find("^^"), "{shown}");
    }
}

/// A rejected move leaves position and mode unknown for the lines after it.
#[test]
fn a_rejected_move_causes_no_further_errors() {
    let cases = [
        // Arcs from the end of a wrong arc, absolute and incremental, in millimetres and inches.
        "G0 X0 Y0\nG1 X10\nG2 X20 Y10 I3 J0\nG2 X30 Y0 I0 J-10\nG1 X0 Y0\nG2 X10 Y10 I10 J0\n",
        "G91\nG1 X10\nG2 X10 Y10 I3 J0\nX10 Y-10 I0 J-10\nG1 X1\n",
        "G1 X10\nG20 G2 X2 Y1 I.1 J0\nG2 X3 Y0 I0 J-1\n",
        // A contour that is too narrow for the tool, then the arc that follows it and the exit move.
        "G1 X-60 Y0\nG41.1 D10\nX-40\nX0 Y0\nG2 X2.232 Y2.660 I8.660 J-5\nG1 X-3 Y32.2\n\
         G3 X-13 Y42.2 I-10 J0\nG40 X-30 Y32.2\nG1 X0 Y0\n",
        // An arc in the plane that the line would have set.
        "G2 X10 I5\nG18 Q1\nX20 Z5 I5 K0\n",
        // Parameters that were not set.
        "#<b> = [1 / 0]\nG1 X#<b>\n",
        "#1 = [1 / 0]\nG1 X[1 / #1]\nG4 P[1 / #1]\n",
    ];
    for program in cases {
        let errors = errors(&format!("G21 G90 G17 F300\n{program}M2\n"));
        assert_eq!(errors.len(), 1, "{program}\n{errors:#?}");
    }
}

/// Errors that an earlier one does not explain are all reported.
#[test]
fn independent_errors_are_all_reported() {
    let cases: [(&str, &[u32]); 6] = [
        // The rejected lines do not change the mode.
        ("G1 X0\nG1 X5 Q1\nG1 Z1 E5\nX20 Q2\n", &[3, 4, 5]),
        ("G4\nX20 Q2\nG41 D-1\n", &[2, 3, 4]),
        // No assignment was rejected.
        ("G1 X?\nG1 X#<b>\n", &[2, 3]),
        // The position is known again.
        ("G2 X20 Y10 I3 J0\nG1 X0 Y0\nG2 X20 Y10 I3 J0\n", &[2, 4]),
        // The line has its own code.
        ("G1 X? \nG2 X10\n", &[2, 3]),
        ("G1 X1 F?\nG1 X2 F100\nF0\nG1 X3\n", &[2, 5]),
    ];
    for (program, expected) in cases {
        let errors = errors(&format!("G21 G90 G17 F300\n{program}M2\n"));
        let lines: Vec<u32> = errors.iter().map(|error| error.line).collect();
        assert_eq!(lines, expected, "{program}\n{errors:#?}");
    }
}

/// Every arc of the shipped programs with another centre is one error, and every error is on its line.
#[test]
fn one_wrong_arc_of_a_real_program_is_one_error() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../tests/programs");
    let mut checked = 0;
    for file in std::fs::read_dir(folder)
        .expect("the programs")
        .filter_map(Result::ok)
    {
        let path = file.path();
        if path.extension().is_none_or(|extension| extension != "ngc") {
            continue;
        }
        let text = std::fs::read_to_string(&path).expect("a program");
        if !errors(&text).is_empty() {
            continue;
        }
        let lines: Vec<&str> = text.lines().collect();
        let is_arc = |line: &str| {
            (line.contains("G2 ") || line.contains("G3 "))
                && line.contains(" I")
                && !line.contains(['#', '(', 'o'])
        };
        for index in (0..lines.len()).filter(|index| is_arc(lines[*index])).take(40) {
            let words = lines[index].split(' ').map(|word| match word.as_bytes() {
                [b'I', ..] => "I777.7",
                [b'J', ..] => "J-333.3",
                _ => word,
            });
            let wrong = words.collect::<Vec<_>>().join(" ");
            let program = [&lines[..index], &[wrong.as_str()], &lines[index + 1..]]
                .concat()
                .join("\n");
            let found = errors(&program);
            let at: Vec<u32> = found.iter().map(|error| error.line).collect();
            // A full circle may have any centre.
            if at.is_empty() {
                continue;
            }
            assert_eq!(at, [index as u32 + 1], "{}: {found:#?}", path.display());
            checked += 1;
        }
    }
    assert!(checked > 50, "{checked} arcs");
}

#[test]
fn only_returns_inside_a_line_are_errors() {
    assert_eq!(errors("G21\r\r\nG0 X1\r\r\r\n(a)\r\r\nM2\r\r\n"), []);
    let found = errors("G0 X1\rX2\nG0 X3\rX4\nG0 X5\rG77\nG77\n");
    let codes: Vec<_> = found.iter().map(|error| (error.code, error.line)).collect();
    assert_eq!(codes, [(Code::StrayReturn, 1), (Code::UnknownG, 4)]);
    for error in &found {
        assert!(!error.render("x\n").contains('\r'));
    }
    let aborted = errors("(ABORT,a\rb)\n");
    assert!(!aborted[0].render("x").contains('\r'), "{aborted:?}");
}

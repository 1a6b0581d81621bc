//! Errors that help: other dialects, subroutines in files, loops of errors, what is cut of long lines.

use std::time::{Duration, Instant};

use evolvent_gcode::{
    Action, Code, Command, Diagnostic, Interpreter, MachineFeatures, Outputs, Settings, SpindleDirection,
    ToolTable,
};

fn interpret(program: &str, settings: Settings) -> (Vec<Command>, Vec<Diagnostic>) {
    let (mut commands, mut errors) = (Vec::new(), Vec::new());
    for command in Interpreter::new(program.as_bytes(), settings) {
        match command {
            Ok(command) => commands.push(command),
            Err(error) => errors.push(error),
        }
    }
    (commands, errors)
}

fn errors(program: &str) -> Vec<Diagnostic> {
    interpret(program, Settings::default()).1
}

#[test]
fn other_dialects_are_told_what_to_write_here() {
    // Program, line with the error, what it means here, what to write. One error each: nothing follows from it.
    for (program, line, means, write) in [
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
        ("F100\nG9 G1 X5\n", 2, "exact stop for one line", "G61.1"),
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
        assert!(text.contains(means) && text.contains(write), "{program}: {text}");
    }
}

/// Lines of this dialect with an error keep that error.
#[test]
fn own_lines_with_errors_are_not_taken_for_another_dialect() {
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
fn a_dwell_of_a_thousand_seconds_is_warned_of() {
    let warnings = |program: &str| {
        let (commands, errors) = interpret(program, Settings::default());
        assert!(errors.is_empty(), "{errors:?}");
        let is_warning = |command: &&Command| matches!(command.action, Action::Warning(_));
        commands.iter().filter(is_warning).cloned().collect::<Vec<_>>()
    };
    let found = warnings("G0 X1\nG4 P1000\n");
    assert_eq!((found.len(), found[0].line), (1, 2));
    let Action::Warning(text) = &found[0].action else {
        unreachable!("a warning")
    };
    assert!(text.contains("1000 seconds") && text.ends_with("P1"), "{text}");
    // Once for the line that says it, not for every hole.
    let found = warnings("F100 G0 Z5\nG82 X1 Z-1 R1 P500\nX2\nX3\nG80\n");
    assert_eq!((found.len(), found[0].line), (1, 2));
    for short in ["G4 P99\n", "G4 P0.5\n", "G4 P120.5\n"] {
        assert!(warnings(short).is_empty(), "{short}");
    }
}

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
    for place in ["inner.ngc:3:5", "outer.ngc:3", "called from main.ngc:3"] {
        assert!(shown.contains(place), "{place} is not in\n{shown}");
    }
    // The move says where it stands as well, for whoever refuses it.
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
fn the_whole_chain_of_a_recursion_is_named() {
    let program = |depth: u32| {
        format!(
            "o<down> sub\no1 if [#1 GT 1]\no<down> call [#1-1]\no1 else\nG1 X?\no1 endif\no<down> endsub\no<down> call [{depth}]\n"
        )
    };
    for depth in [1_usize, 2, 11, 60, 100] {
        let found = errors(&program(depth as u32));
        assert_eq!(found.len(), 1, "{depth}: {found:?}");
        let mut expected = vec![(None, 3); depth - 1];
        expected.push((None, 8));
        assert_eq!((found[0].line, calls(&found[0])), (5, expected), "{depth}");
        let shown = found[0].render("main.ngc");
        let told = shown.lines().filter(|line| line.contains("called from")).count();
        assert_eq!(told, depth.min(2), "{shown}");
        assert!(
            depth < 3 || shown.contains(&format!("main.ngc:3, {} calls deep", depth - 1)),
            "{shown}"
        );
    }
    // One that goes too deep fails in the line that calls, in the deepest subroutine.
    let found = errors(&program(101));
    assert_eq!((found[0].line, found[0].calls.len()), (3, 100));
}

#[test]
fn an_error_names_the_subroutine_it_ends() {
    let (library, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let write = |folder: &tempfile::TempDir, name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).unwrap();
    };
    write(
        &library,
        "outer.ngc",
        "o<outer> sub\n\no<inner> call\nG1 Z?\no<outer> endsub\n",
    );
    // Of the other folder; its end is that of another one, which ends it all the same.
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
    // A command knows the same of its line.
    let chain = commands[0].calls.innermost_first();
    assert_eq!(chain.len(), 3);
    assert_eq!(
        chain.last().map(|call| (call.file.is_none(), call.line)),
        Some((true, 4))
    );
}

#[test]
fn loops_of_errors_end_soon_and_say_so() {
    for body in ["G1 X?\n", "G1 X?\nG0 X1\nG0 X2\n", "#1=[1/0]\n"] {
        let begin = Instant::now();
        let found = errors(&format!("o1 repeat [100000000]\n{body}o1 endrepeat\nG0 X?\nM2\n"));
        assert!(
            begin.elapsed() < Duration::from_secs(10),
            "{body}: {:?}",
            begin.elapsed()
        );
        assert_eq!(found.len(), 2, "{body}: {found:?}");
        assert_eq!((found[0].line, found[1].code), (2, Code::TooManySteps), "{body}");
        assert!(found[1].message.contains("not checked"), "{}", found[1].message);
    }
    // A short loop is gone through, and what comes then is found.
    let found = errors("o1 repeat [50]\nG1 X?\no1 endrepeat\nG0 Y?\nM2\n");
    assert_eq!(found.iter().map(|error| error.line).collect::<Vec<_>>(), [2, 4]);
}

#[test]
fn rendered_errors_have_no_stray_line_and_true_columns() {
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
        // The mark stands below the word.
        let lines: Vec<&str> = shown.lines().collect();
        let source = lines.iter().position(|line| line.contains("Q7")).unwrap();
        assert_eq!(lines[source].find("Q7"), lines[source + 1].find("^^"), "{shown}");
    }
}

#[test]
fn offsets_without_a_tool_table_are_errors() {
    for (program, line, column) in [
        ("T1 M6\nG43 H1\n", 2, 5),
        ("T1 M6\nG43\n", 2, 1),
        ("G43.2 H2\n", 1, 7),
        ("F100\nG41 D3\nG1 X20\n", 2, 5),
        ("T4 M6\nG42\n", 2, 1),
    ] {
        let found = errors(program);
        assert_eq!(found.len(), 1, "{program}: {found:?}");
        assert_eq!(
            (found[0].code, found[0].line, found[0].column),
            (Code::UnknownTool, line, column),
            "{program}"
        );
        assert!(found[0].help.as_ref().unwrap().contains("--tools"), "{found:?}");
    }
    // Nothing is needed of no tool, of numbers that are given, and where the machine says so.
    for program in ["G43\n", "G43.1 Z5\n", "G41.1 D4\n", "G49\n"] {
        assert!(errors(program).is_empty(), "{program}");
    }
    let lenient = Settings {
        tools_without_table: true,
        ..Settings::default()
    };
    let (commands, found) = interpret("T1 M6\nG43 H1\n", lenient);
    assert!(found.is_empty(), "{found:?}");
    let is_told =
        |command: &Command| matches!(&command.action, Action::Warning(text) if text.contains("tool 1"));
    assert!(commands.iter().any(is_told), "{commands:?}");
    let with_table = Settings {
        tools: Some(ToolTable::parse("T2 P2 Z3\n").unwrap()),
        ..Settings::default()
    };
    assert!(interpret("G43 H2\n", with_table).1.is_empty());
}

#[test]
fn a_probe_to_where_an_unanswered_one_ends_is_no_error() {
    let found = errors("F100 G90\nG38.3 Z-5\nG38.5 Z-5\nG38.3 X2\nG38.5 X2\n");
    assert!(found.is_empty(), "{found:?}");
    // Where nothing was probed it is one.
    assert_eq!(errors("F100 G90\nG0 Z-5\nG38.5 Z-5\n").len(), 1);
}

#[test]
fn a_tapping_cycle_restores_overrides_and_hold() {
    for (program, cycle) in [
        ("G21 F100 S500 M3\nM50 P0\nG0 Z5\nG84 X1 Z-1 R1\nM2\n", "G84"),
        ("G21 F100 S500 M4\nM50 P0\nG0 Z5\nG74 X1 Z-1 R1\nM2\n", "G74"),
    ] {
        let (commands, found) = interpret(program, Settings::default());
        assert!(found.is_empty(), "{found:?}");
        let switches: Vec<_> = commands
            .iter()
            .map(|command| &command.action)
            .filter(|action| matches!(action, Action::Overrides { .. }))
            .collect();
        let overrides = |spindle, feed_stop, cycle| Action::Overrides {
            feed: false,
            spindles: [spindle, true, true, true],
            adaptive: None,
            feed_stop,
            cycle,
        };
        let expected = [
            overrides(true, true, None),
            overrides(false, false, Some(cycle)),
            overrides(true, true, Some(cycle)),
        ];
        assert_eq!(switches, expected.iter().collect::<Vec<_>>());
    }
}

#[test]
fn a_measured_spindle_taps_rigidly() {
    let settings = Settings {
        features: MachineFeatures {
            rigid_tapping: [true, false, false, false],
            ..MachineFeatures::default()
        },
        ..Settings::default()
    };
    for (program, pitch) in [
        (
            "G21 G94 F600 S500 M3\nG0 Z5\nG84 X1 Y2 Z-8 R1\nX5\nG80\nM2\n",
            1.2,
        ),
        (
            "G21 G95 F1.2 S500 M3\nG0 Z5\nG98 G84 X1 Y2 Z-8 R1\nX5\nG80\nM2\n",
            1.2,
        ),
        (
            "G20\nG94 F25 S500 M4\nG0 Z0.2\nG74 X1 Y2 Z-0.3 R0.1\nX5\nG80\nM2\n",
            1.27,
        ),
    ] {
        let (commands, found) = interpret(program, settings.clone());
        assert!(found.is_empty(), "{found:?}");
        let taps: Vec<_> = (commands.iter())
            .filter_map(|command| match &command.action {
                Action::RigidTap {
                    curve,
                    pitch_mm,
                    return_factor,
                    ..
                } => Some((curve.start(), curve.end(), *pitch_mm, *return_factor)),
                _ => None,
            })
            .collect();
        assert_eq!(taps.len(), 2, "{program}");
        for (start, end, told, factor) in taps {
            assert!((told - pitch).abs() < 1e-12 && factor == 1.0, "{told}");
            assert!(start[2] > end[2] && start[0] == end[0] && start[1] == end[1]);
        }
        // No order to the spindle: the tap itself turns it back.
        let orders = (commands.iter()).filter(|command| matches!(command.action, Action::Spindle { .. }));
        assert_eq!(orders.count(), 2, "on and off: {program}");
    }
    let without_speed = "G21 G94 F600 S0 M3\nG0 Z5\nG84 X1 Y2 Z-8 R1\nM2\n";
    let found = interpret(without_speed, settings.clone()).1;
    assert_eq!(found.len(), 1, "{found:?}");
    let with_dwell = "G21 G94 F600 S500 M3\nG0 Z5\nG84 X1 Y2 Z-8 R1 P2\nM2\n";
    let warned = interpret(with_dwell, settings).0;
    assert!(
        warned
            .iter()
            .any(|command| matches!(&command.action, Action::Warning(text) if text.contains("G84: P")))
    );
}

#[test]
fn an_mdi_block_keeps_spindle_and_coolant() {
    let outputs = |program: &str, before: Outputs, is_block: bool| {
        let settings = Settings {
            outputs: before,
            is_block,
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
    // A program ends with all off, whoever has switched it on.
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

/// A move that is refused leaves the place and the mode that the lines behind it were written for.
#[test]
fn a_refused_move_gives_no_errors_behind_it() {
    let cases = [
        // Arcs from the end of a wrong arc, absolute and incremental, in millimetres and inches.
        "G0 X0 Y0\nG1 X10\nG2 X20 Y10 I3 J0\nG2 X30 Y0 I0 J-10\nG1 X0 Y0\nG2 X10 Y10 I10 J0\n",
        "G91\nG1 X10\nG2 X10 Y10 I3 J0\nX10 Y-10 I0 J-10\nG1 X1\n",
        "G1 X10\nG20 G2 X2 Y1 I.1 J0\nG2 X3 Y0 I0 J-1\n",
        // A contour in a tool's radius that leaves no room, then the arc that follows it and the way out.
        "G1 X-60 Y0\nG41.1 D10\nX-40\nX0 Y0\nG2 X2.232 Y2.660 I8.660 J-5\nG1 X-3 Y32.2\nG3 X-13 Y42.2 I-10 J0\n\
         G40 X-30 Y32.2\nG1 X0 Y0\n",
        // Parameters that were not set.
        "#<b> = [1 / 0]\nG1 X#<b>\n",
        "#1 = [1 / 0]\nG1 X[1 / #1]\nG4 P[1 / #1]\n",
    ];
    for program in cases {
        let errors = errors(&format!("G21 G90 G17 F300\n{program}M2\n"));
        assert_eq!(errors.len(), 1, "{program}\n{errors:#?}");
    }
}

/// What an earlier error does not explain is reported all the same.
#[test]
fn errors_of_their_own_are_all_reported() {
    let cases: [(&str, &[u32]); 4] = [
        // No assignment was refused.
        ("G1 X?\nG1 X#<b>\n", &[2, 3]),
        // The place is known again.
        ("G2 X20 Y10 I3 J0\nG1 X0 Y0\nG2 X20 Y10 I3 J0\n", &[2, 4]),
        // Its own code.
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
    let mut tried = 0;
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
            tried += 1;
        }
    }
    assert!(tried > 50, "{tried} arcs");
}

/// As in LinuxCNC; without a table nothing is known of any tool.
#[test]
fn a_tool_that_the_table_lacks_is_an_error_where_it_is_selected() {
    let tools = ToolTable::parse("T1 P1 D6 Z10\n").expect("a table");
    let with_table = Settings {
        tools: Some(tools),
        ..Settings::default()
    };
    for (program, expected) in [("T9 M6\nT1 M6\nT0 M6\nM2\n", vec![1]), ("T1 M6\nM2\n", vec![])] {
        let found = interpret(program, with_table.clone()).1;
        let lines: Vec<u32> = found.iter().map(|error| error.line).collect();
        assert_eq!(lines, expected, "{found:?}");
        assert!(found.iter().all(|error| error.code == Code::UnknownTool));
    }
    assert!(errors("T9 M6\nM2\n").is_empty());
    let empty = Settings {
        tools: Some(ToolTable::default()),
        ..Settings::default()
    };
    assert!(interpret("T9 M6\nM2\n", empty).1.is_empty());
}

type Told = Vec<(u32, String)>;

/// Warnings and errors of a program on a lathe: line and text, with the help of errors.
fn on_lathe(program: &str) -> (Told, Told) {
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
fn valid_lines_of_other_lathes_do_not_run_as_something_else() {
    // Program, whether it is an error, line, what is said.
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

#[test]
fn lines_of_this_dialect_on_a_lathe_are_not_warned_of() {
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
    // G90 and G94 on mills are modes only.
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
fn lines_of_other_controls_are_told_what_to_write() {
    // Text of the line, what it is, what to write; on a lathe in G18, as on a mill unless its cure is of lathes.
    for (text, means, write) in [
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
        ("#<_a|#<b>>=1", "inside another one", "#[100 + #<b>]"),
    ] {
        let (_, errors) = on_lathe(&format!("G18 G21 S100 M3 F100\n{text}\n"));
        assert_eq!(errors.len(), 1, "{text}: {errors:?}");
        assert_eq!(errors[0].0, 2, "{text}: {errors:?}");
        for part in [means, write] {
            assert!(
                errors[0].1.contains(part),
                "{text}: {part:?} is not in {errors:?}"
            );
        }
    }
}

#[test]
fn lines_of_other_mills_are_told_what_to_write() {
    for (text, means, write) in [
        ("G76 X0 Y0 Z-20 R2 Q0.2 F50", "not fine boring", "M19 R0"),
        ("G17 G2 X10 Y0 I5 J0 K0.000", "K", "delete K0"),
        ("G2 X10 Y0 R1", "", "at least half"),
    ] {
        let found = errors(&format!("G21 F100\n{text}\n"));
        assert_eq!(found.len(), 1, "{text}: {found:?}");
        let told = format!(
            "{}; {}",
            found[0].message,
            found[0].help.as_deref().unwrap_or_default()
        );
        assert!(told.contains(means) && told.contains(write), "{text}: {told}");
        assert!(!told.contains("G7 "), "{text}: {told}");
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
    // What is right is not touched, and what is wrong in another way neither.
    assert_eq!(
        errors("#1=[#2+1] #3=-5 #4=#1\nS1 M3 $0\n/ G0 X1\nG50.5\n").len(),
        1
    );
}

#[test]
fn a_tool_with_its_offset_is_told_how_to_change_it() {
    let settings = Settings {
        features: MachineFeatures {
            lathe: true,
            ..MachineFeatures::default()
        },
        tools: Some(ToolTable::parse("T1 P1 Z5 D1\n").unwrap()),
        ..Settings::default()
    };
    let (_, errors) = interpret("T0102\n", settings);
    assert!(errors[0].message.contains("tool 1 with offset 2"), "{errors:?}");
    assert_eq!(errors[0].help.as_deref(), Some("write T1 M6 G43 H2"));
}

#[test]
fn returns_before_a_line_end_are_no_error_and_others_are_one() {
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

#[test]
fn the_angle_of_another_dialect_beside_m19_is_a_warning() {
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
    let told = warnings("M19 S90");
    assert!(
        matches!(&told[..], [(2, text)] if text.contains("M19 R90") && text.contains("speed")),
        "{told:?}"
    );
    for line in ["M19", "M19 R90", "M19 R90 S300", "M19 S1500", "S90"] {
        assert_eq!(warnings(line), [], "{line}");
    }
}

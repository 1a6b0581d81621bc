//! Properties of subroutines, loops and restart for any program.

use std::io::Read;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use evolvent_gcode::{
    Action, Code, Diagnostic, Interpreter, MachineFeatures, PathMode, PersistentParameters, ProgramLimits,
    Settings, SpindleDirection, Tool, ToolChanger, ToolTable,
};
use evolvent_path::{Axes, AxisLetter};

fn interpret(program: &str, settings: Settings) -> (Vec<(u32, Action)>, Vec<Diagnostic>) {
    let mut commands = Vec::new();
    let mut errors = Vec::new();
    for item in Interpreter::new(program.as_bytes(), settings) {
        match item {
            Ok(command) => commands.push((command.line, command.action)),
            Err(error) => errors.push(error),
        }
    }
    (commands, errors)
}

/// X of the ends of all moves.
fn ends(program: &str, settings: Settings) -> Vec<f64> {
    let (commands, errors) = interpret(program, settings);
    assert_eq!(errors, []);
    let ends = commands.iter().filter_map(|(_, action)| match action {
        Action::Move(step) => Some(step.curve.end()[0]),
        _ => None,
    });
    ends.collect()
}

#[test]
fn endless_loops_without_motion_are_bounded() {
    let settings = Settings {
        limits: ProgramLimits {
            max_silent_lines: 5000,
            ..ProgramLimits::default()
        },
        ..Settings::default()
    };
    for program in [
        "O1 while [1]\nO1 endwhile\nG0 X1",
        "O1 do\n#1=[#1+1]\nO1 while [1]",
        "O1 sub\nO1 endsub\nO2 while [1]\nO1 call\nO2 endwhile",
        "O1 repeat [1000000000]\nO1 endrepeat",
    ] {
        let (commands, errors) = interpret(program, settings.clone());
        assert_eq!(commands, [], "{program}");
        assert_eq!(errors.len(), 1, "{program}");
        assert_eq!(errors[0].code, Code::TooManySteps, "{program}");
    }
}

#[test]
fn recursion_ends_with_an_error_at_the_greatest_depth() {
    let (_, errors) = interpret("O1 sub\nO1 call\nO1 endsub\nO1 call", Settings::default());
    assert_eq!(errors[0].code, Code::NestingTooDeep);
    assert_eq!((errors.len(), errors[0].line), (1, 2));
}

#[test]
fn an_endless_program_with_motion_continues() {
    let program = &b"G91\nO1 while [1]\nG0 X1\nO1 endwhile"[..];
    let mut interpreter = Interpreter::new(program, Settings::default());
    for _ in 0..10_000 {
        assert!(matches!(interpreter.next(), Some(Ok(_))));
    }
    assert_eq!(interpreter.position()[0], 10_000.0);
}

#[test]
fn an_interrupt_ends_a_program_that_computes() {
    let mut interpreter = Interpreter::new(&b"O1 while [1]\nO1 endwhile"[..], Settings::default());
    interpreter.set_interrupt(Arc::new(AtomicBool::new(true)));
    let error = interpreter.next().unwrap().unwrap_err();
    assert_eq!(error.code, Code::Interrupted);
    assert!(interpreter.next().is_none());
}

#[test]
fn bodies_respect_the_memory_limit() {
    let settings = Settings {
        limits: ProgramLimits {
            max_body_bytes: 10_000,
            ..ProgramLimits::default()
        },
        ..Settings::default()
    };
    let long = "G0 X1\nG0 X0\n".repeat(2000);
    for program in [
        format!("O1 while [1]\n{long}O1 endwhile"),
        format!("O1 sub\n{long}O1 endsub"),
        format!("O1 call\n{long}M2\nO1 sub\nO1 endsub"),
    ] {
        let (_, errors) = interpret(&program, settings.clone());
        assert!(
            errors.iter().any(|error| error.code == Code::BodyTooLong),
            "{:?}",
            &program[..12]
        );
    }
    // The same outside of bodies is valid, and so is a branch that is not taken.
    assert_eq!(
        interpret(&format!("O1 if [0]\n{long}O1 else\n{long}O1 endif"), settings).1,
        []
    );
}

/// Returns a line repeatedly, and counts how often.
struct Endless<'a>(&'a std::cell::Cell<usize>);

impl Read for Endless<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = buffer.len() / 6 * 6;
        for piece in buffer[..count].chunks_exact_mut(6) {
            piece.copy_from_slice(b"G0 X1\n");
        }
        self.0.set(self.0.get() + count);
        Ok(count)
    }
}

#[test]
fn a_loop_executes_its_first_iteration_while_being_read() {
    let bytes_read = std::cell::Cell::new(0);
    let program = std::io::BufReader::with_capacity(600, b"O1 while [1]\nG91\n".chain(Endless(&bytes_read)));
    let mut interpreter = Interpreter::new(program, Settings::default());
    for _ in 0..50 {
        assert!(matches!(interpreter.next(), Some(Ok(_))));
    }
    assert!(
        bytes_read.get() <= 1200,
        "{} bytes were read ahead",
        bytes_read.get()
    );
}

#[test]
fn subroutine_folders_are_searched_in_order() {
    let folder = std::env::temp_dir().join(format!("evolvent-gcode-{}", std::process::id()));
    let (first, second) = (folder.join("first"), folder.join("second"));
    std::fs::create_dir_all(&first).unwrap();
    std::fs::create_dir_all(&second).unwrap();
    std::fs::write(
        first.join("go.ngc"),
        "%\nO<go> sub\nG0 X#1\nO<inner> call [#1]\nO<go> endsub\n\
                                          O<inner> sub\nG0 X[#1+1]\nO<inner> endsub\n%\n",
    )
    .unwrap();
    std::fs::write(second.join("go.ngc"), "O<go> sub\nG0 X99\nO<go> endsub\n").unwrap();
    std::fs::write(
        second.join("bad.ngc"),
        "(one)\nO<bad> sub\nG0 X?\nO<bad> endsub\n",
    )
    .unwrap();
    std::fs::write(second.join("77.ngc"), "G0 X[#1+70]\nM99\n").unwrap();
    let settings = Settings {
        subroutine_folders: vec![first, second.clone()],
        ..Settings::default()
    };
    assert_eq!(
        ends("O<go> call [5]\nO<GO> call [7]", settings.clone()),
        [5.0, 6.0, 7.0, 8.0]
    );
    assert_eq!(ends("#1=3\nM98 P77", settings.clone()), [73.0]);
    // Commands carry the line of the program that is run, errors name the file.
    let (commands, _) = interpret("\n\nO<go> call [5]", settings.clone());
    assert!(commands[..2].iter().all(|(line, _)| *line == 3));
    let (_, errors) = interpret("O<bad> call", settings);
    assert_eq!((errors[0].code, errors[0].line), (Code::UnexpectedCharacter, 3));
    assert_eq!(errors[0].file.as_deref(), second.join("bad.ngc").to_str());
    assert!(
        errors[0].render("main.ngc").contains("bad.ngc:3:5"),
        "{}",
        errors[0].render("main.ngc")
    );
    std::fs::remove_dir_all(folder).unwrap();
}

/// Lines count towards the limit once, however many subroutines a file has.
#[test]
fn a_library_counts_once_for_all_its_subroutines() {
    let folder = std::env::temp_dir().join(format!("evolvent-library-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let subs: String = (0..100)
        .map(|k| format!("O<s{k}> sub\nG0 X{k}\nO<s{k}> endsub\n"))
        .collect();
    std::fs::write(folder.join("s7.ngc"), &subs).unwrap();
    std::fs::write(
        folder.join("other.ngc"),
        "O<other> sub\nG0 X200\nO<other> endsub\n",
    )
    .unwrap();
    let mut settings = Settings {
        subroutine_folders: vec![folder.clone()],
        ..Settings::default()
    };
    settings.limits.max_body_bytes = 4 * subs.len();
    assert_eq!(
        ends("O<s7> call\nO<s99> call\nO<other> call", settings),
        [7.0, 99.0, 200.0]
    );
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn break_and_continue_work_in_all_loops() {
    let all = Settings::default;
    let repeat = "O1 repeat [5]\n#1=[#1+1]\nO2 if [#1 EQ 2]\nO1 continue\nO2 endif\nO3 if [#1 EQ 4]\n\
                  O1 break\nO3 endif\nG0 X#1\nO1 endrepeat";
    assert_eq!(ends(repeat, all()), [1.0, 3.0]);
    let twice = "O1 do\n#1=[#1+1]\nO2 if [#1 EQ 2]\nO1 continue\nO2 endif\nG0 X#1\nO1 while [#1 LT 4]";
    assert_eq!(ends(twice, all()), [1.0, 3.0, 4.0]);
}

#[test]
fn an_error_in_a_loop_is_reported_once() {
    let (_, errors) = interpret(
        "O1 repeat [50]\nG0 X?\nG0 X#1\n#1=[#1+1]\nO1 endrepeat",
        Settings::default(),
    );
    assert_eq!(errors.len(), 1);
}

#[test]
fn a_faulty_line_writes_no_parameter() {
    let (commands, errors) = interpret(
        "#1=5 G0 X#<no>\n#1=6 #<a>=7 G77\nG0 X[#1+1] Y[EXISTS[#<a>]+1]",
        Settings::default(),
    );
    assert_eq!(errors.len(), 2);
    let Action::Move(step) = &commands[0].1 else {
        panic!("{commands:?}")
    };
    assert_eq!((step.curve.end()[0], step.curve.end()[1]), (1.0, 1.0));
}

#[test]
fn parameters_and_tools_can_be_kept_from_run_to_run() {
    let mut first = Interpreter::new(&b"#100=2.5\nG10 L2 P2 X7\nG10 L1 P5 Z3"[..], Settings::default());
    assert!(first.by_ref().all(|item| item.is_ok()));
    assert_eq!((first.parameter(100), first.parameter(5241)), (2.5, 7.0));
    let settings = Settings {
        parameters: vec![(100, first.parameter(100))],
        tools: first.tools().cloned(),
        ..Settings::default()
    };
    let mut second = Interpreter::new(&b"G43 H5 G0 X#100 Z0"[..], settings);
    assert!(second.by_ref().all(|item| item.is_ok()));
    assert_eq!((second.position()[0], second.position()[2]), (2.5, 3.0));
}

/// MDI blocks and programs start with the tool of the previous one.
#[test]
fn tool_parameters_are_set_before_the_first_line() {
    let mut tool = Tool::new(5);
    (tool.offset[2], tool.diameter_mm) = (50.5, 12.0);
    let settings = Settings {
        tool: 5,
        tools: Some(ToolTable::new(vec![tool])),
        ..Settings::default()
    };
    let mut interpreter = Interpreter::new(&b"G0 X#5403 Y#5410 Z#5400\n"[..], settings);
    assert!(interpreter.by_ref().all(|item| item.is_ok()));
    assert_eq!(
        interpreter.position().fixed_rows::<3>(0).as_slice(),
        [50.5, 12.0, 5.0]
    );
}

/// A LinuxCNC machine in inches: the unit at the start is G20, and #5161 to #5410 are in inches in G21 too.
#[test]
fn inch_machine_parameters_are_inches_kept_in_mm() {
    let mut tool = Tool::new(5);
    tool.offset[2] = 50.8;
    tool.offset[3] = 3.0;
    tool.diameter_mm = 12.7;
    let mut settings = Settings {
        inches: true,
        parameters_in_inches: true,
        tool: 5,
        tools: Some(ToolTable::new(vec![tool])),
        ..Settings::default()
    };
    let persistent = "5161 25.4\n5164 25.4\n5241 254\n5244 30\n100 25.4\n";
    PersistentParameters::parse(persistent)
        .unwrap()
        .apply(&mut settings);
    for (unit, unit_mm) in [("G20", 25.4), ("G21", 1.0)] {
        let text = format!(
            "{unit}\nG92 X{}\n#200=#5161 #201=#5164 #202=#5403 #203=#5404 #204=#5410 #205=#5241 #206=#5244\n\
             #207=#5211 #208=#100 #209=#5400 #210=#5220\n#5221=3 #5224=4\nG10 L2 P1 Y{}\n\
             #211=#5222 #5230=7\n#5390=8\n",
            25.4 / unit_mm,
            50.8 / unit_mm
        );
        let mut interpreter = Interpreter::new(text.as_bytes(), settings.clone());
        for item in interpreter.by_ref() {
            assert!(item.is_ok(), "{unit}: {item:?}");
        }
        let found: Vec<f64> = (200..212).map(|number| interpreter.parameter(number)).collect();
        let expected = [1.0, 25.4, 2.0, 3.0, 0.5, 10.0, 30.0, -1.0, 25.4, 5.0, 1.0, 2.0];
        for (index, (found, expected)) in found.iter().zip(expected).enumerate() {
            assert!(
                (found - expected).abs() < 1e-12,
                "{unit}: #{}: {found}",
                200 + index
            );
        }
        let mut persistent = PersistentParameters::default();
        persistent.update(&interpreter);
        let stored = [
            (5211, -25.4),
            (5221, 76.2),
            (5222, 50.8),
            (5224, 4.0),
            (5230, 7.0),
            (5390, 8.0),
        ];
        for (number, expected) in stored {
            let found = persistent.get(number).unwrap();
            assert!((found - expected).abs() < 1e-12, "{unit}: #{number}: {found}");
        }
    }
    let x = |text: &str| {
        let mut interpreter = Interpreter::new(text.as_bytes(), settings.clone());
        assert!(interpreter.by_ref().all(|item| item.is_ok()), "{text}");
        interpreter.position()[0]
    };
    assert_eq!(x("G0 X1\nM2\n"), 25.4);
    assert_eq!(x("G21 G0 X1\nM2\n"), 1.0);
    assert!((x("#5221=2\nG54\nG0 X1\nM2\n") - 76.2).abs() < 1e-9);
}

#[test]
fn repeat_counts_apply_at_any_nesting() {
    for count in 0..6 {
        let program = format!(
            "#31=0\nO9 sub\nO1 repeat [#1]\nO2 repeat [2]\n#31=[#31+1]\nO2 endrepeat\nO1 endrepeat\n\
             O9 endsub\nO9 call [{count}]\nO3 repeat [{count}]\n#31=[#31+100]\nO3 endrepeat\n\
             G0 X[1000+#31]\nM2\n"
        );
        let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
        assert!(interpreter.by_ref().all(|item| item.is_ok()), "{program}");
        assert_eq!(interpreter.parameter(31), f64::from(102 * count));
    }
}

#[test]
fn a_restart_has_the_state_of_all_preceding_lines() {
    let program = "G21 G64 P0.05 F600 T2\nM6 S800 M3\nM8 G55\nO1 repeat [3]\nG91 G1 X1\nO1 endrepeat\n\
                   G90 G1 X10\nG0 Y5\nX7\n";
    let complete: Vec<_> = Interpreter::new(program.as_bytes(), Settings::default())
        .map(Result::unwrap)
        .collect();
    let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
    let restart = interpreter.start_at(8).unwrap();
    assert_eq!(restart.line, 8);
    assert_eq!(restart.position[0], 10.0);
    assert_eq!(
        restart.actions,
        [
            Action::ChangeTool(2),
            Action::Spindle {
                spindle: 0,
                direction: SpindleDirection::Clockwise,
                speed_rpm: 800.0
            },
            Action::Coolant {
                mist: false,
                flood: true
            },
        ]
    );
    assert_eq!(
        restart.modes,
        "G1 G17 G21 G90 G91.1 G94 G55 G64 P0.05 G99 G8 G40 G49 F600 S800 M3 T2 M8"
    );
    assert_eq!(
        restart.summary(),
        "T2 S800 M3 M8 F600 G55 G1 G17 G21 G90 G91.1 G94 G64 P0.05 G99 G8 G40 G49"
    );
    let rest: Vec<_> = interpreter.map(Result::unwrap).collect();
    let expected: Vec<_> = complete.into_iter().filter(|command| command.line >= 8).collect();
    assert_eq!(rest, expected);
}

#[test]
fn a_restart_approach_retracts_traverses_and_descends() {
    let program = "G21 F600\nG0 X3 Y4 Z10\nG1 Z-2\nX9\n";
    let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
    let restart = interpreter.start_at(4).unwrap();
    let approach = restart.approach(&Axes::zeros(), AxisLetter::Z, 50.0).unwrap();
    let ends: Vec<_> = approach
        .commands
        .iter()
        .map(|command| match &command.action {
            Action::Move(step) => {
                let end = step.curve.end();
                assert_eq!((command.line, step.path_mode), (4, PathMode::ExactStop));
                ((end[0], end[1], end[2]), step.feed_mm_s)
            }
            other => panic!("{other:?}"),
        })
        .collect();
    let rapid = f64::INFINITY;
    assert_eq!(
        ends,
        [
            ((0.0, 0.0, 50.0), rapid),
            ((3.0, 4.0, 50.0), rapid),
            ((3.0, 4.0, 3.0), rapid),
            ((3.0, 4.0, -2.0), 10.0)
        ]
    );
    assert_eq!(
        approach.descriptions.last().unwrap(),
        "Z to -2.000, at 600.0 mm/min"
    );
    // A lathe retracts along X.
    let approach = restart.approach(&Axes::zeros(), AxisLetter::X, 20.0).unwrap();
    assert_eq!(approach.descriptions[0], "X to 20.000, rapid");
    assert_eq!(approach.descriptions[1], "Y to 4.000, Z to -2.000, rapid");
}

#[test]
fn a_restart_without_a_valid_state_is_rejected() {
    let try_restart = |program: &str, line: u32| {
        let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
        interpreter
            .start_at(line)
            .map_err(|error| (error.code, error.line))
    };
    assert_eq!(try_restart("G0 X1\nM2\n", 9).unwrap_err().0, Code::RestartRefused);
    assert_eq!(
        try_restart("F1\nG41.1 D2\nG1 X5\nX9\n", 4).unwrap_err().0,
        Code::RestartRefused
    );
    assert_eq!(
        try_restart("G0 X1\nG0 X?\nX3\n", 3),
        Err((Code::UnexpectedCharacter, 2))
    );
    assert!(try_restart("G0 X1\nX3\n", 1).is_ok());
    // The line of a tool change after a contour, and after tools that were measured in their change.
    assert!(try_restart("F1\nG41.1 D2\nG1 X5\nX9\nG40\nG0 Z9\nM5\nM2\n", 7).is_ok());
    let settings = Settings {
        features: MachineFeatures {
            tool_change: Some(ToolChanger {
                subroutine: "change".to_owned(),
                is_random: false,
            }),
            ..MachineFeatures::default()
        },
        ..Settings::default()
    };
    let program = "o<change> sub\nG38.2 Z-9 F100\no<change> endsub\nT1 M6\nG0 X1\nT2 M6\nG0 X2\nM2\n";
    let mut interpreter = Interpreter::new(program.as_bytes(), settings);
    let restart = interpreter.start_at(7);
    assert_eq!(
        restart.map(|restart| restart.actions),
        Ok(vec![Action::ChangeTool(2)])
    );
    // An unknown contact: in the program, and in a subroutine.
    let probing = "G0 Z10\nG38.2 Z-40 F100\nG10 L20 P1 Z0\nG0 Z10\n";
    assert_eq!(
        try_restart(&format!("{probing}G0 X1\nM2\n"), 5),
        Err((Code::RestartRefused, 2))
    );
    let program = format!("o1 sub\n{probing}o1 endsub\no1 call\nG0 X1\nM2\n");
    assert_eq!(
        try_restart(&program, 8).map_err(|(code, _)| code),
        Err(Code::RestartRefused)
    );
    assert!(try_restart(&format!("{probing}G0 X1\nM2\n"), 2).is_ok());
    // Endless loops before the line, with and without commands.
    for body in ["G0 X1\nG0 X0\n", "#1=[#1+1]\n"] {
        let program = format!("O1 while [1]\n{body}O1 endwhile\nG0 X5\n");
        let settings = Settings {
            limits: ProgramLimits {
                max_lines_before_start: 1000,
                ..ProgramLimits::default()
            },
            ..Settings::default()
        };
        let error = Interpreter::new(program.as_bytes(), settings)
            .start_at(9)
            .unwrap_err();
        assert_eq!(error.code, Code::TooManySteps, "{program}");
    }
}

#[test]
fn a_rejected_restart_shows_its_line() {
    for (program, line) in [
        ("F1\nG41.1 D2\nG1 X5\nX9\nX10\nG40\n", 4),
        ("F9\nG5.2 X1 Y1 P1 L3\nX2 Y2 P1\nX3 Y1 P1\nG5.3\n", 4),
        ("G21\no1 sub\nG0 X1\nG0 X2\no1 endsub\no1 call\n", 4),
    ] {
        let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
        let error = interpreter.start_at(line).expect_err(program);
        let text = program.lines().nth(line as usize - 1).unwrap();
        assert_eq!(
            (error.code, error.line),
            (Code::RestartRefused, line),
            "{error:?}"
        );
        assert_eq!(&*error.source, text, "{error:?}");
    }
}

#[test]
fn restart_in_a_subroutine_suggests_a_line() {
    let try_restart = |program: &str, line: u32| {
        let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
        let error = interpreter.start_at(line).expect_err(program);
        assert_eq!(error.code, Code::RestartRefused, "{program}");
        (
            error.message.to_string(),
            error.help.unwrap_or_default().to_string(),
        )
    };
    // It is not reached before its call; inside the call the arguments would be missing.
    let program = "G21\no<hole> sub\nG0 X1\nG0 X#1\no<hole> endsub\no<hole> call [5]\nG0 X9\nM2\n";
    for line in 3..=5 {
        let (message, help) = try_restart(program, line);
        assert!(
            message.contains("O<hole>") && message.contains("starts in line 2"),
            "{message}"
        );
        assert!(help.contains("O<hole> call"), "{help}");
    }
    for line in [2, 6, 7] {
        let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
        assert_eq!(interpreter.start_at(line).map(|restart| restart.line), Ok(line));
    }
    // Fanuc's: after the end of the program.
    let (message, help) = try_restart("G21\nM98 P100\nM30\nO100\nG0 X5\nM99\n", 5);
    assert!(message.contains("ends in line 3, before line 5"), "{message}");
    assert!(help.contains("M98 P"), "{help}");
}

/// A section of a thread starts at the angle at which the previous section ended, not at its own: alone it
/// would cut beside its groove.
#[test]
fn a_restart_inside_a_chain_of_threads_is_rejected() {
    let program = "G18 G7 S500 M3\nG0 X20 Z10\nG33 Z-10.7 K2\nG33 X28 Z-30 K2\n(a comment)\nG33 Z-40 K2\n\
                   G0 X40\nG0 X20 Z10\nG33 Z-20 K2\nM5\nM2\n";
    let begin = |line: u32| {
        let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
        interpreter.start_at(line).expect("the lines before");
        interpreter.next().expect("a command")
    };
    for line in [4, 5, 6] {
        let error = begin(line).expect_err("a piece of a chain");
        let at = line.max(4 + 2 * u32::from(line == 5));
        assert_eq!((error.code, error.line), (Code::RestartRefused, at));
        assert!(
            error
                .message
                .contains(&format!("line {at} continues the thread that begins in line 3")),
            "{}",
            error.message
        );
    }
    for line in [2, 3, 7, 8, 9, 10] {
        begin(line).expect("a start of its own");
    }
}

/// Moves must be contiguous, whatever lines fail between them. Found by damaging programs.
#[test]
fn a_faulty_line_restores_the_held_moves() {
    for program in [
        // The call fails after the move of its line.
        "M98 P1 G0 X1\nG1 F9 X2 Y3",
        // The move has trimmed the previous one, inside a corner.
        "F100\nG0 X5 Y5\nG41.1 D2\nG1 X0 Y5\nY0\nX10\nY10\nM98 P1 X0\nY5\nG40 G1 X5 Y5",
        "G18 F100\nG0 X-5 Z-5\nG41.1 D2\nG1 X0 Z0\nZ10\nM72 X10\nZ0\nG40 X-5",
        // Only moves in the plane are compensated.
        "S100 M3 F100\nG41.1 D1\nG1 X5\nY20\nG33 X0 Z-2 K1\nX10\nG40 X0",
    ] {
        let mut position = Settings::default().start;
        let mut errors = 0;
        for item in Interpreter::new(program.as_bytes(), Settings::default()) {
            match item.map(|command| command.action) {
                Ok(Action::Move(step)) => {
                    assert_eq!(step.curve.start(), position, "{program}");
                    position = step.curve.end();
                }
                Ok(_) => {}
                Err(_) => errors += 1,
            }
        }
        assert!(errors > 0, "{program}");
    }
}

#[test]
fn an_interpreter_can_be_sent_to_another_thread() {
    fn can_be_sent<T: Send>(_: &T) {}
    can_be_sent(&Interpreter::new(&b""[..], Settings::default()));
}

#[test]
fn a_restart_has_the_outputs_of_all_preceding_lines() {
    let program = "G21 F100\nM64 P1\nM62 P2\nG1 X1\nM65 P1\nM68 E0 Q3\nM67 E1 Q4\nG1 X2\nM2\n";
    let mut interpreter = Interpreter::new(program.as_bytes(), Settings::default());
    let actions = interpreter.start_at(8).unwrap().actions;
    let digital = |index, on| Action::Output {
        index,
        on,
        synchronised: false,
    };
    let analog = |index, value| Action::AnalogOutput {
        index,
        value,
        synchronised: false,
    };
    assert_eq!(
        actions,
        [
            digital(1, false),
            digital(2, true),
            analog(0, 3.0),
            analog(1, 4.0)
        ]
    );
}

#[test]
fn m66_is_rejected_in_cutter_compensation() {
    let program = "G21 F100 G41.1 D1\nG1 X10\nM66 P0 L0\nG1 Y10\nG40\nM66 P0 L0\nG1 X0\nM66 P0 L0\nM2\n";
    let commands: Vec<_> = Interpreter::new(program.as_bytes(), Settings::default()).collect();
    let errors: Vec<_> = commands
        .iter()
        .filter_map(|command| command.as_ref().err())
        .collect();
    assert!(
        errors
            .iter()
            .all(|fault| fault.message.contains("M66 while cutter compensation"))
    );
    assert!(errors.iter().any(|fault| fault.line == 3), "{errors:?}");
    assert!(errors.iter().all(|fault| fault.line < 8), "{errors:?}");
}

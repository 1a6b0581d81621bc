//! M6 by a subroutine of the machine: arguments of the call, effects on the line and its modes, and errors.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::Path;

use evolvent_gcode::{
    Action, Code, Diagnostic, Interpreter, MachineFeatures, Settings, SpindleDirection, ToolChanger,
    ToolTable,
};

/// Stores the present tool and fetches the new one, with its own modes.
const CHANGE: &str = "G91 G20 G0 Z1
M64 P1
(PRINT,#1 #2 #3 #4)
M66 P0 L3 Q5
o10 if [#5399 EQ -1]
(ABORT,the clamp does not open)
o10 endif
G90 G53 G1 Y1 F10
M65 P1
M7
";

struct Magazine {
    folder: tempfile::TempDir,
    settings: Settings,
}

impl Magazine {
    fn new(table: &str, is_random: bool, change: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("toolchange.ngc"), change).expect("a file");
        let settings = Settings {
            subroutine_folders: vec![folder.path().to_path_buf()],
            tools: Some(ToolTable::parse(table).expect("a table")),
            features: MachineFeatures {
                tool_change: Some(ToolChanger {
                    subroutine: "toolchange".to_owned(),
                    is_random,
                }),
                ..MachineFeatures::default()
            },
            waits_succeed: true,
            ..Settings::default()
        };
        Self { folder, settings }
    }

    fn run(&self, program: &str) -> Run {
        let mut interpreter = Interpreter::new(program.as_bytes(), self.settings.clone());
        let (mut actions, mut errors) = (Vec::new(), Vec::new());
        for item in interpreter.by_ref() {
            match item {
                Ok(command) => actions.push((command.line, command.action)),
                Err(error) => errors.push(error),
            }
        }
        let table = interpreter.tools().expect("a table").clone();
        Run {
            actions,
            errors,
            table,
            tool: interpreter.parameter(5400),
        }
    }
}

struct Run {
    actions: Vec<(u32, Action)>,
    errors: Vec<Diagnostic>,
    table: ToolTable,
    tool: f64,
}

impl Run {
    /// Printed lines: the arguments of each change.
    fn calls(&self) -> Vec<String> {
        let texts = self.actions.iter().filter_map(|(_, action)| match action {
            Action::Print(text) => Some(text.replace(".000000", "")),
            _ => None,
        });
        texts.collect()
    }

    fn pocket(&self, tool: u32) -> u32 {
        self.table.get(tool).expect("its line").pocket
    }

    /// The only error.
    #[track_caller]
    fn error(&self) -> &Diagnostic {
        assert_eq!(self.errors.len(), 1, "{:?}", self.errors);
        &self.errors[0]
    }
}

const TABLE: &str = "T1 P11\nT2 P12\nT3 P13\n";

#[test]
fn the_line_is_divided_at_the_change() {
    let magazine = Magazine::new(TABLE, false, CHANGE);
    let run = magazine.run("G21 G90 F600 M3 S500\nG1 X1\nT2 M6 G55 M3 S900 X5\nX6\nM2\n");
    assert_eq!(run.errors, []);
    assert_eq!(run.calls(), ["2 0 12 0"]);
    assert_eq!(run.tool, 2.0);
    let of_line = |line: u32| -> Vec<String> {
        let found = run.actions.iter().filter(|(index, _)| *index == line);
        let names = found.map(|(_, action)| match action {
            Action::Move(step) => format!("move {:?}", (step.curve.end()[0], step.feed_mm_s.is_finite())),
            Action::Spindle {
                direction, speed_rpm, ..
            } => format!("spindle {direction:?} {speed_rpm}"),
            other => format!("{other:?}")
                .split([' ', '(', '{'])
                .next()
                .unwrap()
                .to_owned(),
        });
        names.collect()
    };
    // Stopped, changed, modes as before, then the rest of the line with its feed and speed.
    assert_eq!(
        of_line(3),
        [
            "SelectTool",
            "spindle Stopped 500",
            "BeginToolChange",
            "move (1.0, false)",
            "Output",
            "Print",
            "WaitInput",
            "move (1.0, true)",
            "Output",
            "Coolant",
            "Coolant",
            "ChangeTool",
            "spindle Clockwise 900",
            "move (5.0, true)",
        ]
    );
    // G1, G90, G21 and F600 of the program apply again.
    let Some((_, Action::Move(last))) = run.actions.iter().find(|(line, _)| *line == 4) else {
        panic!("no move")
    };
    assert_eq!((last.curve.end()[0], last.feed_mm_s), (6.0, 10.0));
    let coolant = Action::Coolant {
        mist: false,
        flood: false,
    };
    let index = run
        .actions
        .iter()
        .position(|(_, action)| *action == Action::ChangeTool(2));
    assert_eq!(run.actions[index.unwrap() - 1].1, coolant);
    let stops = Action::Spindle {
        spindle: 0,
        direction: SpindleDirection::Stopped,
        speed_rpm: 500.0,
    };
    assert!(run.actions.contains(&(3, stops)));
}

#[test]
fn the_tool_in_the_spindle_is_not_changed() {
    let magazine = Magazine::new(TABLE, false, CHANGE);
    let run = magazine.run("G21 F600\nT2 M6\nT2 M6 G1 X3\nT0 M6\nM2\n");
    assert_eq!(run.errors, []);
    assert_eq!(run.calls(), ["2 0 12 0", "0 2 0 12"]);
    assert!(
        run.actions
            .iter()
            .any(|(line, action)| *line == 3 && matches!(action, Action::Move(_)))
    );
    assert_eq!(run.tool, 0.0);
    // A fixed changer does not change the table.
    assert_eq!(run.table, ToolTable::parse(TABLE).unwrap());
}

#[test]
fn m61_rejects_a_tool_missing_from_the_table() {
    for is_random in [false, true] {
        let run = Magazine::new(TABLE, is_random, CHANGE).run("M61 Q0\nM61 Q2\nM61 Q77\nM2\n");
        assert_eq!((run.error().code, run.error().line), (Code::UnknownTool, 3));
    }
    assert_eq!(Magazine::new("", false, CHANGE).run("M61 Q77\nM2\n").errors, []);
}

#[test]
fn a_random_changer_moves_tools_from_pocket_to_pocket() {
    let magazine = Magazine::new(TABLE, true, CHANGE);
    let run = magazine.run("T2 M6\nT3 M6\nT1 M6\nT2 M6\nM61 Q3\nM2\n");
    assert_eq!(run.errors, []);
    // By hand: the first change leaves pocket 12 empty, 2 goes to 13, 3 to 11, 1 to 13; then 3 comes out of
    // 11 for 2.
    assert_eq!(run.calls(), ["2 0 12 12", "3 2 13 13", "1 3 11 11", "2 1 13 13"]);
    let pockets = [0, 1, 2, 3].map(|tool| run.pocket(tool));
    assert_eq!(pockets, [12, 13, 11, 0]);
    // No pocket has two tools after any sequence of changes.
    let mut seed = 7_u64;
    let mut program = String::new();
    for _ in 0..200 {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        program.push_str(&format!("T{} M6\n", 1 + (seed >> 33) % 3));
    }
    let run = magazine.run(&program);
    assert_eq!(run.errors, []);
    let mut pockets: Vec<u32> = run.table.tools().iter().map(|tool| tool.pocket).collect();
    pockets.sort_unstable();
    assert_eq!(pockets, [0, 11, 12, 13]);
    // T0 is the empty pocket.
    let run = magazine.run("T2 M6\nT0 M6\nM2\n");
    assert_eq!(run.calls(), ["2 0 12 12", "0 2 12 12"]);
    assert_eq!((run.pocket(2), run.pocket(0)), (12, 0));
}

/// The values of `rs274`, except the -1 after M6, which is that of LinuxCNC's machines.
#[test]
fn t_selects_the_pocket_of_the_loaded_tool() {
    let program = "T2 M6\no1 if [#<_selected_pocket> NE -1]\n(ABORT,M6 leaves none)\no1 endif\n\
                   T2\no2 if [#<_selected_pocket> NE 12]\n(ABORT,T selects it)\no2 endif\nM2\n";
    assert_eq!(Magazine::new(TABLE, false, CHANGE).run(program).errors, []);
}

#[test]
fn inconsistent_tool_tables_are_rejected() {
    let program = "T2 M6\nM2\n";
    let missing = Magazine::new("T1 P11\n", false, CHANGE).run(program);
    assert_eq!(missing.error().code, Code::UnknownTool);
    assert!(
        !missing
            .actions
            .iter()
            .any(|(_, action)| matches!(action, Action::BeginToolChange(_)))
    );
    let magazine = Magazine::new("T2 P12\n", false, CHANGE);
    let settings = Settings {
        tool: 9,
        ..magazine.settings
    };
    let unknown = Interpreter::new(program.as_bytes(), settings)
        .find_map(Result::err)
        .unwrap();
    assert!(unknown.message.contains("tool 9") && unknown.help.unwrap().contains("M61"));
    for (table, code, word) in [
        (
            "T2 P12\nT7 P12\n",
            Code::ToolChange,
            "pocket 12 has tool 2 and tool 7",
        ),
        ("T2 P0\n", Code::ToolChange, "pocket 0"),
        ("T1 P1\n", Code::UnknownTool, "tool 2"),
    ] {
        let run = Magazine::new(table, true, CHANGE).run(program);
        let error = run.error();
        assert_eq!(error.code, code, "{error:?}");
        assert!(error.message.contains(word), "{error:?}");
    }
    // If T0 has no pocket, the present tool cannot be stored.
    let full = Magazine::new("T2 P12\n", true, CHANGE);
    let settings = Settings {
        tool: 2,
        ..full.settings
    };
    let error = Interpreter::new("T0 M6\n".as_bytes(), settings)
        .find_map(Result::err)
        .unwrap();
    assert!(error.help.unwrap().contains("T0 P5"));
    for (change, word) in [
        ("T3 M6\n", "M6 in the tool-change subroutine"),
        ("M2\n", "the program ends inside"),
        ("M30\n", "the program ends inside"),
        ("G1 X?\n", "?"),
        ("o1 if [1]\n", "endif"),
    ] {
        let magazine = Magazine::new(TABLE, false, change);
        let run = magazine.run(program);
        let Some(error) = run.errors.first() else {
            panic!("no error in {change:?}")
        };
        let file = magazine.folder.path().join("toolchange.ngc");
        assert_eq!(
            error.file.as_deref().map(Path::new),
            Some(file.as_path()),
            "{error:?}"
        );
        assert!(error.line == 1 || word == "endif", "{error:?}");
        assert!(error.message.contains(word), "{error:?}");
        assert_eq!(error.calls[0].line, 1);
    }
    let magazine = Magazine::new(TABLE, false, CHANGE);
    std::fs::remove_file(magazine.folder.path().join("toolchange.ngc")).unwrap();
    let run = magazine.run(program);
    assert_eq!(run.error().code, Code::SubroutineMissing);
    assert!(run.error().help.as_deref().unwrap().contains("toolchange.ngc"));
}

#[test]
fn an_aborted_tool_change_ends_the_program() {
    let mut magazine = Magazine::new(TABLE, true, CHANGE);
    magazine.settings.waits_succeed = false;
    let run = magazine.run("T2 M6\nG0 X1\nM2\n");
    assert!(run.error().message.contains("the clamp does not open"));
    assert_eq!(run.error().line, 6);
    assert!(
        !run.actions
            .iter()
            .any(|(_, action)| matches!(action, Action::ChangeTool(_)))
    );
    assert!(
        !run.actions
            .iter()
            .any(|(_, action)| matches!(action, Action::ProgramEnd))
    );
    assert_eq!((run.tool, run.pocket(2)), (0.0, 12));
}

#[test]
fn errors_after_the_change_keep_the_new_tool() {
    let magazine = Magazine::new(TABLE, false, CHANGE);
    let run = magazine.run("G21\nT2 M6 G1 X5\nM2\n");
    // No feed: F was 10 inches per minute in the subroutine, which does not apply here.
    let error = run.error();
    assert_eq!((error.line, error.code), (2, Code::FeedMissing));
    assert!(error.file.is_none());
    assert_eq!(run.tool, 2.0);
}

#[test]
fn a_tool_is_measured_in_its_change() {
    let change =
        "o<toolchange> sub\nG53 G0 Z0\nG38.2 Z-50 F100\nG10 L1 P#1 Z[#5063 + 10]\no<toolchange> endsub\n";
    let magazine = Magazine::new(TABLE, false, change);
    let mut interpreter = Interpreter::new("G21\nT2 M6 G43\nM2\n".as_bytes(), magazine.settings);
    while let Some(command) = interpreter.next() {
        if let Action::Probe { curve, .. } = command.unwrap().action {
            let mut index = curve.end();
            index[2] = -30.0;
            assert!(interpreter.set_probe_result(&index, &index, true));
        }
    }
    let tool = interpreter.tools().unwrap().get(2).copied().unwrap();
    assert_eq!(tool.offset[2], -20.0);
    assert_eq!(interpreter.parameter(5403), -20.0);
    assert_eq!(interpreter.modal().tool_offset[2], -20.0);
}

#[test]
fn two_tools_in_a_fixed_pocket_are_a_warning() {
    let table = "T1 P11\nT2 P12\nT3 P13\nT7 P12\nT8 P0\nT9 P0\n";
    let warnings = |program: &str| {
        let run = Magazine::new(table, false, CHANGE).run(program);
        assert_eq!(run.errors, [], "{program}");
        let texts = run.actions.into_iter().filter_map(|(line, action)| match action {
            Action::Warning(text) => Some((line, text)),
            _ => None,
        });
        texts.collect::<Vec<_>>()
    };
    // The tool is fetched from the pocket, then stored in it.
    let found = warnings("T1 M6\nT2 M6\nT3 M6\nM2\n");
    let lines: Vec<u32> = found.iter().map(|(line, _)| *line).collect();
    assert_eq!(lines, [2, 3], "{found:?}");
    for (_, text) in &found {
        assert!(text.contains("pocket 12 has tool 2 and tool 7"), "{text}");
    }
    assert_eq!(warnings("T1 M6\nT3 M6\nT8 M6\nT9 M6\nT0 M6\nM2\n"), []);
}

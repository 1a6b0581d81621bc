//! Tools missing from the table, and programs without a table.

use evolvent_gcode::{Action, CanonicalCommand, Code, Settings, ToolTable};

use crate::interpreted::{errors, interpret};

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
    // No tool data are needed for tool 0, for given numbers, and if the machine permits it.
    for program in ["G43\n", "G43.1 Z5\n", "G41.1 D4\n", "G49\n"] {
        assert!(errors(program).is_empty(), "{program}");
    }
    let lenient = Settings {
        tools_without_table: true,
        ..Settings::default()
    };
    let (commands, found) = interpret("T1 M6\nG43 H1\n", lenient);
    assert!(found.is_empty(), "{found:?}");
    let is_reported = |command: &CanonicalCommand| matches!(&command.action, Action::Warning(text) if text.contains("tool 1"));
    assert!(commands.iter().any(is_reported), "{commands:?}");
    let with_table = Settings {
        tools: Some(ToolTable::parse("T2 P2 Z3\n").unwrap()),
        ..Settings::default()
    };
    assert!(interpret("G43 H2\n", with_table).1.is_empty());
}

/// As in LinuxCNC; without a table no tool is known.
#[test]
fn selecting_a_tool_not_in_the_table_is_an_error() {
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

/// The warnings of a program without errors, with a table of two tools.
fn warnings(program: &str) -> Vec<String> {
    let settings = Settings {
        tools: ToolTable::parse("T3 P3 Z50 D12\nT4 P4 Z20 D4").ok(),
        ..Settings::default()
    };
    let (commands, errors) = interpret(program, settings);
    assert_eq!(errors, [], "{program}");
    let texts = commands.into_iter().filter_map(|command| match command.action {
        Action::Warning(text) => Some(text),
        _ => None,
    });
    texts.collect()
}

#[test]
fn diameter_of_another_tool_is_a_warning() {
    let contour = "G1 X10 F100\nX20\nX30\nG40 G1 Y30\nM2\n";
    for code in ["T3 M6\nG41 D4", "M61 Q3\nG42 D4"] {
        let found = warnings(&format!("{code}\n{contour}"));
        assert!(
            matches!(&found[..], [text] if text.contains("tool 4") && text.contains("tool 3 is in the spindle")),
            "{code}: {found:?}"
        );
    }
    // The tool itself, one in an empty spindle, a given diameter.
    for code in ["T3 M6\nG41 D3", "T3 M6\nG41", "G41 D4", "T3 M6\nG41.1 D5"] {
        assert_eq!(warnings(&format!("{code}\n{contour}")), [""; 0], "{code}");
    }
}

#[test]
fn length_of_another_tool_is_a_warning() {
    for program in [
        "T3 M6\nG43 H4\nM2\n",
        "M61 Q3\nG0 Z1 G43 H4\nM2\n",
        "T3 M6 G43 H4\nM2\n",
    ] {
        let found = warnings(program);
        assert!(
            matches!(&found[..], [text] if text.contains("tool 4") && text.contains("tool 3 is in the spindle")),
            "{program}: {found:?}"
        );
    }
    // The tool itself, none, an empty spindle, lengths that add up, and equal lengths.
    for program in [
        "T3 M6 G43 H3\nM2\n",
        "T3 M6\nG43\nG43 H0\nM2\n",
        "G43 H4\nM2\n",
        "T3 M6 G43\nG43.2 H4\nG43.1 Z3\nM2\n",
        "G10 L1 P4 Z50\nT3 M6\nG43 H4\nM2\n",
    ] {
        assert_eq!(warnings(program), [""; 0], "{program}");
    }
}

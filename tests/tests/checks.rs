//! What `check`, `plan` and `run` report about a program before any motion.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::Path;

use evolvent_tests::{Workshop, repository, run};
use serde_json::Value;

fn check(program: &Path, options: &[&str]) -> Value {
    let machine = repository().join("config/machines/mill-3axis.toml");
    command("check", program, &machine, options, &[0, 1])
}

fn command(name: &str, program: &Path, machine: &Path, options: &[&str], codes: &[i32]) -> Value {
    let (program, machine) = (program.to_str().expect("UTF-8"), machine.to_str().expect("UTF-8"));
    let words = [name, program, "--machine", machine, "--json"];
    run(words.iter().chain(options)).expect_code(codes).json()
}

/// Code and line of every error.
fn errors(found: &Value) -> Vec<(String, u64)> {
    let list = found["errors"].as_array().expect("a list");
    list.iter()
        .map(|error| {
            (
                error["code"].as_str().expect("a code").to_owned(),
                error["line"].as_u64().expect("a line"),
            )
        })
        .collect()
}

fn found(list: &[(&str, u64)]) -> Vec<(String, u64)> {
    list.iter()
        .map(|(code, line)| ((*code).to_owned(), *line))
        .collect()
}

#[test]
fn a_move_the_machine_rejects_names_the_call_chain() {
    let workshop = Workshop::new();
    let inner = workshop.write("inner.ngc", "o<inner> sub\nG0 X[#1]\no<inner> endsub\n");
    let _outer = workshop.write(
        "outer.ngc",
        "o<outer> sub\n\no<inner> call [#1]\no<outer> endsub\n",
    );
    let program = workshop.write(
        "chain.ngc",
        "o<mine> sub\no<outer> call [5000]\no<mine> endsub\no<mine> call\nM2\n",
    );
    let found = check(&program, &[]);
    let error = &found["errors"][0];
    assert_eq!(
        (&error["code"], &error["line"]),
        (&"G0801".into(), &2.into()),
        "{found}"
    );
    assert_eq!(error["file"].as_str(), inner.to_str());
    let calls: Vec<_> = error["calls"].as_array().expect("a list").iter().collect();
    let lines: Vec<_> = calls.iter().map(|call| call["line"].as_u64()).collect();
    assert_eq!(lines, [Some(3), Some(2), Some(4)]);
    assert!(
        calls[0]["file"]
            .as_str()
            .is_some_and(|file| file.ends_with("outer.ngc"))
    );
    assert!(calls[1]["file"].is_null() && calls[2]["file"].is_null());
    let machine = repository().join("config/machines/mill-3axis.toml");
    let words = [
        "check",
        program.to_str().expect("UTF-8"),
        "--machine",
        machine.to_str().expect("UTF-8"),
    ];
    let shown = run(words).expect_code(&[1]);
    let text = format!("{shown:?}");
    for location in ["inner.ngc:2", "outer.ngc:3", "chain.ngc:2", "chain.ngc:4"] {
        assert!(text.contains(location), "{location} is not in {text}");
    }
}

#[test]
fn one_mistake_is_one_error() {
    let workshop = Workshop::new();
    for (text, expected) in [
        // The mode does not change: later lines use G97.
        ("G96 M3\nG97 S100\nG0 X1\nM5\nM3\nM2\n", &[("G0411", 1)][..]),
        (
            "G21 F100
M19 R10
G0 X1
M19 R20
M2
",
            &[("G0803", 2), ("G0803", 4)],
        ),
        // Back from the target of a rejected move.
        (
            "G0 X5000\nG0 X1\nG0 X5000\nX6000\nM2\n",
            &[("G0801", 1), ("G0801", 3), ("G0801", 4)],
        ),
        (
            "o1 repeat [100]\nG0 X5000\nG0 X1\no1 endrepeat\nM2\n",
            &[("G0801", 2)],
        ),
    ] {
        let program = workshop.write("one.ngc", text);
        assert_eq!(errors(&check(&program, &[])), found(expected), "{text}");
    }
}

#[test]
fn an_error_in_a_subroutine_file_names_that_file() {
    let workshop = Workshop::new();
    let _file = workshop.write(
        "far.ngc",
        "o<far> sub\nG0 X1\nG0 X5000\nG0 X0\no<far> endsub\nM2\n",
    );
    let program = workshop.write("main.ngc", "G21\no<far> call\no<far> call\nM2\n");
    let all = check(&program, &[]);
    assert_eq!(errors(&all), found(&[("G0801", 3)]), "{all}");
    let error = &all["errors"][0];
    assert!(
        error["file"]
            .as_str()
            .is_some_and(|file| file.ends_with("far.ngc")),
        "{error}"
    );
    assert_eq!(error["source"], "G0 X5000");
    assert_eq!(error["calls"], serde_json::json!([{"file": null, "line": 2}]));
}

#[test]
fn a_missing_tool_table_is_an_error_unless_allowed() {
    let workshop = Workshop::new();
    let program = workshop.write("length.ngc", "G21 F100\nT1 M6\nG43 H1\nG0 Z5\nM2\n");
    let strict = check(&program, &[]);
    assert_eq!(errors(&strict), found(&[("G0410", 3)]));
    let shipped =
        std::fs::read_to_string(repository().join("config/machines/mill-3axis.toml")).expect("a mill");
    let text = format!("{shipped}\n[program]\nwithout_tool_table = \"zero\"\n");
    let machine = workshop.write("lenient.toml", text);
    let lenient = command("check", &program, &machine, &[], &[0]);
    assert_eq!(errors(&lenient), []);
    let warning = &lenient["warnings"][0];
    assert_eq!(warning["line"], 3, "{lenient}");
    assert!(
        warning["message"].to_string().contains("no tool table"),
        "{warning}"
    );
    let table = workshop.write("tools.tbl", "T1 P1 Z12 D6\n");
    let with_table = check(&program, &["--tools", table.to_str().expect("UTF-8")]);
    assert_eq!(
        (errors(&with_table), &with_table["warnings"]),
        (vec![], &serde_json::json!([]))
    );
}

#[test]
fn block_delete_lines_run_unless_switched_off() {
    let workshop = Workshop::new();
    let program = workshop.write("slash.ngc", "G21 G90 F6000\nG1 X1\n/G1 X4\nG1 Y1\n/X?\nM2\n");
    let machine = repository().join("config/machines/mill-3axis.toml");
    assert_eq!(errors(&check(&program, &[])), found(&[("G0101", 5)]));
    assert_eq!(errors(&check(&program, &["--block-delete"])), []);
    let program = workshop.write("slash.ngc", "G21 G90 F6000\nG1 X1\n/G1 X4\nG1 Y1\nM2\n");
    for (name, options) in [
        ("plan", &[][..]),
        ("run", &["--clock", "virtual", "--no-trace", "--no-bus"]),
    ] {
        for (switch, x, note) in [
            (&[][..], 4.0, "1 lines that begin with / were executed"),
            (&["--block-delete"], 1.0, "1 lines that begin with / were skipped"),
        ] {
            let options: Vec<&str> = options.iter().chain(switch).copied().collect();
            let summary = command(name, &program, &machine, &options, &[0]);
            assert_eq!(summary["end_position"][0], x, "{name} {switch:?}");
            assert!(
                summary["notes"].to_string().contains(note),
                "{name}: {}",
                summary["notes"]
            );
        }
    }
}

/// A mill with a probe, and its check of a program.
fn check_with_probe(text: &str) -> Value {
    let workshop = Workshop::new();
    let mill = std::fs::read_to_string(repository().join("config/machines/mill-3axis.toml"))
        .expect("a machine file");
    let machine = workshop.write("probe.toml", mill + "\n[probe]\novertravel_mm = 2\n");
    let program = workshop.write("probe.ngc", text);
    command("check", &program, &machine, &[], &[0, 1])
}

#[test]
fn what_depends_on_an_unknown_contact_is_a_warning() {
    let lines = |found: &Value| {
        let list = found["warnings"].as_array().expect("a list");
        let each = |warning: &Value| warning["line"].as_u64().expect("a line");
        list.iter().map(each).collect::<Vec<_>>()
    };
    // The usual test, which a program without a contact would not pass.
    let idiom =
        "G21 G90 G17\nF100\nG38.3 Z-5\no1 if [#5070 EQ 0]\n(ABORT, no contact)\no1 endif\nG91 G0 Z2\nM2\n";
    let all = check_with_probe(idiom);
    assert_eq!((errors(&all), lines(&all)), (vec![], vec![3]), "{all}");
    // The stopping position of the probe is unknown, so the end of the travel may not be reached.
    let far = "G21 G90 G17\nF100\nG91 G38.2 X-380\nG0 X5\nG0 X-30\nG90 X0\nX-500\nM2\n";
    let all = check_with_probe(far);
    assert_eq!(
        (errors(&all), lines(&all)),
        (found(&[("G0801", 7)]), vec![3, 5]),
        "{all}"
    );
    assert!(
        all["warnings"][1]["message"]
            .as_str()
            .is_some_and(|text| text.starts_with("no contact is known: axis X")),
        "{all}"
    );
    // Set to zero at the contact, the position of the part is unknown.
    let zero = "G21 G90 G17\nF100\nG38.2 X-390\nG10 L20 P1 X0\nG0 X-30\nG53 G0 X-401\nM2\n";
    let all = check_with_probe(zero);
    assert_eq!(
        (errors(&all), lines(&all)),
        (found(&[("G0801", 6)]), vec![3, 5]),
        "{all}"
    );
    // A probing move beyond the travel is an error.
    let all = check_with_probe("G21 G90 G17\nF100\nG38.2 X-500\nM2\n");
    assert_eq!(errors(&all), found(&[("G0801", 3)]), "{all}");
}

#[test]
fn a_move_after_a_rejected_line_is_not_reported() {
    let workshop = Workshop::new();
    for (text, expected) in [
        // The move back is rejected.
        (
            "G21 G90\nG0 X390\nG0 X-390 Q5\nG91 G0 X20\nM2\n",
            vec![("G0307", 3)],
        ),
        // So is the line that selects incremental mode.
        ("G21 G90\nG0 X390\nG91 Q5\nG0 X-410\nM2\n", vec![("G0307", 3)]),
        // A parameter was not set.
        ("G21 G90\n#1=5 Q5\nG0 X[10000/[#1+1]]\nM2\n", vec![("G0307", 2)]),
        // Independent of the contact: still an error.
        (
            "G21 G90\nG0 Y5 Q5\nG0 X500\nM2\n",
            vec![("G0307", 2), ("G0801", 3)],
        ),
        (
            "G21 G90\nG0 X5 Q5\nG0 X500\nM2\n",
            vec![("G0307", 2), ("G0801", 3)],
        ),
    ] {
        let program = workshop.write("follows.ngc", text);
        let all = check(&program, &[]);
        assert_eq!(errors(&all), found(&expected), "{text}: {all}");
    }
}

#[test]
fn a_dwell_that_is_meant_in_milliseconds_is_a_warning() {
    let workshop = Workshop::new();
    let program = workshop.write("dwell.ngc", "G21\no1 repeat [5]\nG4 P500\no1 endrepeat\nM2\n");
    let all = check(&program, &[]);
    assert_eq!(errors(&all), []);
    assert_eq!(all["warnings"].as_array().map(Vec::len), Some(1), "{all}");
    assert_eq!(all["warnings"][0]["line"], 3);
    let machine = repository().join("config/machines/mill-3axis.toml");
    let words = [
        "check",
        program.to_str().expect("UTF-8"),
        "--machine",
        machine.to_str().expect("UTF-8"),
    ];
    let shown = run(words).expect_code(&[0]).err;
    assert!(
        shown.contains("dwell.ngc:3: G4 P500 waits 500 seconds"),
        "{shown}"
    );
}

/// The shipped cycles, and those of LinuxCNC's users, test a contact in both directions.
#[test]
fn moves_after_a_test_of_the_contact_are_checked() {
    let workshop = Workshop::new();
    let mill = std::fs::read_to_string(repository().join("config/machines/mill-3axis.toml"))
        .expect("a machine file");
    let machine = workshop.write("probe.toml", mill + "\n[probe]\novertravel_mm = 2\n");
    let folder = repository().join("config/probing");
    for probing in [
        "o<probe_corner> call [20] [20] [3] [100] [50] [2]\n",
        "o<probe_boss> call [20] [5] [5] [3] [100] [50] [2]\n",
        "o<probe_bore> call [20] [3] [100] [50] [2]\n",
        "G38.2 Z-20 F100\no100 if [#5070 EQ 0]\n(ABORT, no contact)\no100 endif\n",
        "G38.3 Z-20 F100\no100 if [#5070 EQ 1]\n(ABORT, the tool touches the part: G49 or G10)\no100 endif\n",
        "G38.3 Z-20 F100\no100 if [#5070 EQ 1]\nM2\no100 endif\n",
        "G38.2 Z-20 F100\no100 if [#5063 LT -15]\n(MSG, too deep)\nM30\no100 endif\n",
        // A guard with lengths, as in measuring macros of LinuxCNC's forum.
        "G38.3 Z-20 F100\no<far> if [#5063 LT -15]\n(ABORT, contact too low: reset G92, check T)\n\
         o<far> endif\n",
    ] {
        let text = format!("G21 G90 G94 G17\nG0 X10 Y10 Z10\n{probing}G0 Z10\nG0 X9999\nG53 G0 Y-9999\nM2\n");
        let line = 4 + probing.lines().count() as u64;
        let program = workshop.write("guard.ngc", &text);
        let options = ["--subroutines", folder.to_str().expect("UTF-8")];
        let all = command("check", &program, &machine, &options, &[0, 1]);
        assert_eq!(
            errors(&all),
            found(&[("G0801", line), ("G0801", line + 1)]),
            "{probing}: {all}"
        );
    }
}

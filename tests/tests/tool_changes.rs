//! M6, spindle and coolant: the operator's confirmation, and the values on the bus while the program waits.
#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail as tests do, and say what they left out"
)]

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use evolvent_bus::Status;
use evolvent_tests::job_result::{DONE, STOPPED};
use evolvent_tests::{
    Domain, Launch, Operator, Scene, Workshop, command, evolvent, repository, unless_disturbed,
};

/// A mill with more program settings in its machine file.
fn mill(workshop: &Workshop, name: &str, program: &str) -> PathBuf {
    let text = std::fs::read_to_string(workshop.mill(name, &[])).expect("a machine file");
    workshop.write(
        &format!("{name}-program.toml"),
        format!("{text}\n[program]\n{program}\n"),
    )
}

#[track_caller]
fn waits_at_line(operator: &mut Operator, line: u32) -> Status {
    operator.waits("a stop", |status| status.state == 7 && status.line == line)
}

#[test]
fn m6_waits_for_the_operator_and_names_the_tool() {
    unless_disturbed(|| {
        let scene = Scene::new("tc-serve");
        let program = scene.workshop.write(
            "change.ngc",
            "G21 G90 F6000\nG1 X5\nT4 M6\nG1 X10\nT4 M6\nT0 M6\nG1 X0\nM2\n",
        );
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says("START").job;
        let status = waits_at_line(&mut operator, 3);
        assert_eq!((status.tool_change, status.tool_wanted, status.tool), (1, 4, 0));
        assert!(
            status.operator_message().contains("put tool 4 into the spindle"),
            "{}",
            status.operator_message()
        );
        assert_eq!(status.position_machine[0], 5.0);
        // It waits until it is confirmed.
        std::thread::sleep(std::time::Duration::from_millis(300));
        assert_eq!(operator.now().line, 3);
        operator.says("RESUME");
        // The tool is in the spindle: the second M6 needs no confirmation, the third empties the spindle.
        let status = waits_at_line(&mut operator, 6);
        assert_eq!((status.tool_change, status.tool_wanted, status.tool), (1, 0, 4));
        assert!(
            status.operator_message().contains("take tool 4 out"),
            "{}",
            status.operator_message()
        );
        operator.says("RESUME");
        let status = operator.sees_end(job);
        assert_eq!((status.job_result, status.tool_change, status.tool), (DONE, 0, 0));
        // A tool that one block of MDI selects is used by a later block, and by a program.
        operator.says_number("MODE", 2);
        for (select, change, tool) in [("T5", "M6", 5), ("G0 X1 T6", "G0 X2", 5), ("G4 P0", "M6", 6)] {
            for block in [select, change] {
                let job = operator.says_text("MDI", block).job;
                if block == "M6" {
                    let status = operator.waits("the change", |status| status.tool_change == 1);
                    assert_eq!(status.tool_wanted, tool);
                    operator.says("RESUME");
                }
                assert_eq!(operator.sees_end(job).job_result, DONE, "{block}");
            }
            assert_eq!(operator.now().tool, tool);
        }
        let job = operator.says_text("MDI", "T8").job;
        operator.sees_end(job);
        let bare = scene.workshop.write("bare.ngc", "M6\nM61 Q0\nM2\n");
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", bare.to_str().expect("UTF-8"));
        let job = operator.says("START").job;
        let status = operator.waits("the change", |status| status.tool_change == 1);
        assert_eq!(status.tool_wanted, 8);
        operator.says("RESUME");
        assert_eq!(operator.sees_end(job).job_result, DONE);
        // In a block of MDI; a stop keeps the tool as it was.
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", "T9 M6").job;
        let status = operator.waits("the change", |status| status.tool_change == 1);
        assert_eq!((status.tool_wanted, status.tool), (9, 0));
        operator.says("STOP");
        let status = operator.sees_end(job);
        assert_eq!(
            (status.job_result, status.tool_change, status.tool),
            (STOPPED, 0, 0)
        );
        let message = status.operator_message();
        let abandoned = "the tool change to tool 9 was abandoned, and the spindle still counts as empty";
        assert!(message.starts_with(abandoned), "{message}");
        // Once confirmed, a change is not cancelled by a stop.
        let job = operator.says_text("MDI", "T9 M6 G4 P60").job;
        operator.waits("the change", |status| status.tool_change == 1);
        operator.says("RESUME");
        operator.waits("the tool", |status| status.tool == 9);
        operator.says("STOP");
        let status = operator.sees_end(job);
        assert_eq!((status.job_result, status.tool), (STOPPED, 9));
        assert!(!status.operator_message().contains("abandoned"));
        // An emergency stop also ends a change.
        operator.says_text("MDI", "T0 M6");
        operator.waits("the change", |status| status.tool_change == 1);
        operator.says("ESTOP");
        let status = operator.waits("the stop", |status| status.tool_change == 0);
        assert_eq!(status.tool, 9);
        let abandoned = "the tool change to an empty spindle was abandoned, and tool 9 still counts";
        operator.waits("the message", |status| {
            status.operator_message().starts_with(abandoned)
        });
        drop(operator);
        scene.end();
    });
}

#[test]
fn an_automatic_changer_is_run_and_its_failure_stops() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = mill(
            &workshop,
            "tc-auto",
            "tool_change = \"program\"\nuser_code_folder = \"codes\"",
        );
        std::fs::create_dir(workshop.path("codes")).expect("a folder");
        let log = workshop.path("said");
        let script = format!(
            "#!/bin/sh\necho \"$1 $2\" >> {}\n[ \"$1\" = 8 ] && exit 5\nexit 0\n",
            log.display()
        );
        let changer = workshop.write("codes/M6", script);
        std::fs::set_permissions(&changer, PermissionsExt::from_mode(0o755)).expect("permissions");
        let program = workshop.write(
            "two.ngc",
            "G21 G90 F6000\nT3 M6\nG1 X5\nT3 M6\nT8 M6\nG1 X9\nM2\n",
        );
        let run = || {
            Launch::in_real_time(&program, &machine, &domain)
                .no_trace()
                .finish()
        };
        let summary = run().expect_code(&[1]).json();
        assert_eq!(std::fs::read_to_string(&log).expect("its words"), "3 0\n8 3\n");
        assert_eq!(
            (&summary["alarm"], &summary["end_position"][0]),
            (&102.into(), &5.0.into())
        );
        assert!(summary["error"].to_string().contains("exit code 5"), "{summary}");
        // A missing changer is found before anything moves.
        std::fs::remove_file(&changer).expect("removed");
        let summary = run().expect_code(&[1]).json();
        assert_eq!(summary["cycles"], 0);
        assert!(summary["error"].to_string().contains("codes/M6"), "{summary}");
    });
}

#[test]
fn a_run_without_operator_refuses_m6_before_it_moves() {
    let (workshop, domain) = (Workshop::new(), Domain::new());
    let program = workshop.write("one.ngc", "G21 G90 F6000\nG1 X5\nT3 M6\nG1 X9\nM2\n");
    let machine = workshop.mill("tc-run", &[]);
    let run = |options: &[&str]| {
        Launch::in_real_time(&program, &machine, &domain)
            .no_trace()
            .with(&["--no-bus"])
            .with(options)
            .finish()
    };
    let refused = run(&[]).expect_code(&[1]).json();
    let error = refused["error"].to_string();
    assert!(
        error.contains("needs tool 3") && error.contains("one.ngc:3"),
        "{error}"
    );
    assert_eq!(refused["cycles"], 0);
    // Unchecked, the program stops there.
    let stopped = run(&["--unchecked"]).expect_code(&[1]).json();
    assert_eq!(stopped["end_position"][0], 5.0, "{stopped}");
    // With the tool in the spindle there is nothing to change.
    let done = run(&["--tool", "3"]).expect_code(&[0, 3]).json();
    assert_eq!(done["end_position"][0], 9.0);
    // A machine without a spindle continues, with a message.
    let bench = mill(&workshop, "tc-none", "tool_change = \"none\"");
    let done = Launch::in_real_time(&program, &bench, &domain)
        .no_trace()
        .with(&["--no-bus"])
        .finish();
    let done = done.expect_code(&[0, 3]).json();
    assert!(
        done["notes"]
            .to_string()
            .contains("1 tool change (M6) was counted as done"),
        "{done}"
    );
}

/// Output on a terminal of this kind for an operator who starts a program and types `steps`; `None` without
/// Python.
fn at_terminal(
    kind: &str,
    steps: &serde_json::Value,
    program: &Path,
    machine: &Path,
) -> Option<serde_json::Value> {
    let python = std::env::var_os("EVOLVENT_PYTHON").unwrap_or_else(|| "python3".into());
    let output = std::process::Command::new(python)
        .arg(repository().join("tests/python/terminal.py"))
        .arg(steps.to_string())
        .arg(evolvent().get_program())
        .arg("run")
        .arg(program)
        .arg("--machine")
        .arg(machine)
        .args(["--no-bus", "--no-trace"])
        .env("TERM", kind)
        .output();
    let Ok(output) = output else {
        println!("not run: no python3");
        return None;
    };
    let stdout = String::from_utf8_lossy(&output.stdout);
    let error = String::from_utf8_lossy(&output.stderr);
    Some(serde_json::from_str(&stdout).unwrap_or_else(|_| panic!("{stdout}\n{error}")))
}

#[test]
fn at_a_terminal_enter_confirms_the_tool() {
    let workshop = Workshop::new();
    let program = workshop.write(
        "one.ngc",
        "G21 G90 F6000\nG1 X5\nT3 M6\nG1 X9\nT3 M6\nG4 P0.1\nT0 M6\nG1 X0\nM2\n",
    );
    let machine = workshop.mill("tc-terminal", &[]);
    let first = "put tool 3 into the spindle";
    let steps = serde_json::json!([
        // Input before the machine has stopped there does not count as a confirmation.
        ["type", "\n"],
        ["see", first],
        ["see", "line 3: press Enter to continue"],
        ["silent", 0.7, "press Enter"],
        ["silent", 0.3, "done"],
        ["type", "\n"],
        // The tool of the second T3 M6 is in the spindle.
        ["see", "take tool 3 out of the spindle"],
        ["see", "line 7: press Enter to continue"],
        ["silent", 0.5, "done"],
        ["type", "\n"],
        ["see", "tc-terminal: done"]
    ]);
    let Some(played) = at_terminal("xterm", &steps, &program, &machine) else {
        return;
    };
    assert!(played["failed"].is_null(), "{played}");
    assert_eq!(played["code"], 0, "{played}");
    let screen = played["screen"].as_str().expect("a text");
    assert_eq!(screen.matches("press Enter").count(), 2, "{screen}");
    // Ctrl-C at the prompt ends the run there, with the tool unchanged.
    let steps = serde_json::json!([
        ["see", "press Enter to continue"],
        ["type", "\u{3}"],
        ["see", "tc-terminal: stopped"]
    ]);
    // A terminal that cannot move its cursor shows the prompt as well.
    let played = at_terminal("dumb", &steps, &program, &machine).expect("Python");
    assert!(played["failed"].is_null(), "{played}");
    assert_eq!(played["code"], 1, "{played}");
    // The end of the input (Ctrl-D) confirms nothing.
    let steps = serde_json::json!([
        ["see", "press Enter to continue"],
        ["type", "\u{4}"],
        ["silent", 1.0, "done"],
        ["type", "\u{3}"],
        ["see", "stopped"]
    ]);
    let played = at_terminal("xterm", &steps, &program, &machine).expect("Python");
    assert!(played["failed"].is_null(), "{played}");
}

/// Spindle, coolant and tool at each stop or dwell of the program below.
const SWITCHES: &str = "G21 G90 F6000 S800
G1 X2
M3
G4 P0.4
M8
M0
G1 X4
M5
M0
M9
G4 P0.4
G1 X6
M4 S300
M0
M2
";

#[test]
fn outputs_change_between_two_motions() {
    unless_disturbed(|| {
        let scene = Scene::new("tc-outputs");
        let program = scene.workshop.write("switches.ngc", SWITCHES);
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says("START").job;
        let dwell = |line: u32| move |status: &Status| status.state == 6 && status.line == line;
        let outputs = |status: &Status| (status.spindle_rpm, status.coolant);
        let status = operator.waits("the first dwell", dwell(4));
        assert_eq!(outputs(&status), (800.0, 0), "in the dwell after M3");
        let status = waits_at_line(&mut operator, 6);
        assert_eq!(outputs(&status), (800.0, 2), "at M0 after M8");
        operator.says("RESUME");
        let status = waits_at_line(&mut operator, 9);
        assert_eq!(outputs(&status), (0.0, 2), "at M0 after M5");
        operator.says("RESUME");
        let status = operator.waits("the second dwell", dwell(11));
        assert_eq!(outputs(&status), (0.0, 0), "in the dwell after M9");
        let status = waits_at_line(&mut operator, 14);
        assert_eq!(outputs(&status), (-300.0, 0), "at M0 after M4");
        // A stop switches the spindle off, at rest.
        operator.says("STOP");
        let status = operator.sees_end(job);
        assert_eq!(outputs(&status), (0.0, 0), "after a stop");
        drop(operator);
        scene.end();
    });
}

#[test]
fn no_status_in_motion_has_the_outputs_of_before() {
    unless_disturbed(|| {
        let scene = Scene::new("tc-order");
        let lines: String = (1..=20)
            .map(|k| format!("M3 S{}\nG1 X{}\n", 100 * k, if k % 2 == 1 { 3 } else { 0 }))
            .collect();
        let program = scene
            .workshop
            .write("order.ngc", format!("G21 G90 F3000\n{lines}M2\n"));
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says("START").job;
        let mut count = 0;
        operator.waits("the end", |status| {
            // Line 3 moves at 100 rpm, line 5 at 200 ...
            if status.job == job && status.feed_mm_s > 1.0 && status.line >= 3 {
                assert_eq!(
                    status.spindle_rpm,
                    f64::from(100 * (status.line / 2)),
                    "line {}",
                    status.line
                );
                count += 1;
            }
            status.job == job && status.job_result == DONE
        });
        assert!(count > 10, "{count} observations");
        drop(operator);
        scene.end();
    });
}

#[test]
fn mdi_keeps_spindle_and_coolant_until_switched() {
    unless_disturbed(|| {
        let scene = Scene::new("tc-mdi");
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 2);
        let mdi = |operator: &mut Operator, text: &str| {
            let job = operator.says_text("MDI", text).job;
            let status = operator.sees_end(job);
            assert_eq!(status.job_result, DONE, "{text}");
            (status.spindle_rpm, status.coolant)
        };
        assert_eq!(mdi(&mut operator, "M3 S700"), (700.0, 0));
        assert_eq!(mdi(&mut operator, "M8"), (700.0, 2));
        assert_eq!(mdi(&mut operator, "G0 X3"), (700.0, 2));
        assert_eq!(
            mdi(&mut operator, "S900"),
            (900.0, 2),
            "a new speed while it turns"
        );
        // Jogs do not change them, even when they are stopped.
        operator.says_number("MODE", 1);
        let mut jog = command("JOG");
        (jog.axes_mask, jog.index, jog.values[0]) = (1, 1, 1.0);
        let job = operator.does(&jog).job;
        operator.sees_end(job);
        assert_eq!(operator.now().spindle_rpm, 900.0);
        operator.says_number("MODE", 2);
        // A program ends with them off.
        let program = scene.workshop.write("end.ngc", "G21 G90 F6000\nG1 X0\nM2\n");
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says("START").job;
        let status = operator.sees_end(job);
        assert_eq!((status.spindle_rpm, status.coolant), (0.0, 0), "after M2");
        operator.says_number("MODE", 2);
        assert_eq!(mdi(&mut operator, "M4 S50"), (-50.0, 0));
        assert_eq!(mdi(&mut operator, "M5"), (0.0, 0));
        assert_eq!(mdi(&mut operator, "M3 S60 M7"), (60.0, 1));
        operator.says("ESTOP");
        let status = operator.waits("an emergency stop", |status| status.machine_state == 0);
        assert_eq!((status.spindle_rpm, status.coolant), (0.0, 0));
        drop(operator);
        scene.end();
    });
}

#[test]
fn a_run_says_on_the_bus_what_spindle_and_coolant_do() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let program = workshop.write(
            "outputs.ngc",
            "G21 G90 F6000\nG4 P1\nM3 S400\nM8\nG4 P1\nG1 X2\nM5\nG4 P1\nM2\n",
        );
        let machine = workshop.mill("tc-bus", &[]);
        let child = Launch::in_real_time(&program, &machine, &domain)
            .no_trace()
            .with(&["--tool", "12"])
            .start();
        let bus = domain.client("tc-bus");
        let mut reader = bus.status().expect("the status");
        let mut changes: Vec<(u32, f64, u32, u32)> = Vec::new();
        let begin = std::time::Instant::now();
        while begin.elapsed().as_secs() < 60 && !changes.iter().any(|(line, ..)| *line == 8) {
            if let Some(status) = reader.latest().expect("a status")
                && status.state == 6
            {
                let found = (status.line, status.spindle_rpm, status.coolant, status.tool);
                if changes.last() != Some(&found) {
                    changes.push(found);
                }
            }
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        assert_eq!(changes, [(2, 0.0, 0, 12), (5, 400.0, 2, 12), (8, 0.0, 2, 12)]);
        drop((reader, bus));
        evolvent_tests::wait(child).expect_code(&[0, 3]);
    });
}

/// A subroutine has the same moves and outputs with either clock.
#[test]
fn a_subroutine_tool_change_runs_in_virtual_time() {
    let workshop = Workshop::new();
    let _file = workshop.write("toolchange.ngc", "G21 G90 G53 G0 X50\nG53 G0 X0\n");
    let _file = workshop.write("tools.tbl", "T4 P4\n");
    let program = workshop.write("change.ngc", "G21 G90 F6000\nT4 M6\nG1 X10\nM2\n");
    for (name, changer, is_noted) in [
        ("tc-sub", "tool_change = \"subroutine\"", false),
        ("tc-none", "tool_change = \"none\"", true),
        ("tc-ask", "tool_change = \"operator\"", true),
    ] {
        let machine = mill(&workshop, name, &format!("tool_table = \"tools.tbl\"\n{changer}"));
        let finished = Launch::in_virtual_time(&program, &machine).no_trace().finish();
        let finished = finished.expect_code(&[0]);
        let printed = format!("{}{}", finished.out, finished.err);
        assert_eq!(
            printed.contains("1 tool change (M6)"),
            is_noted,
            "{changer}: {printed}"
        );
    }
}

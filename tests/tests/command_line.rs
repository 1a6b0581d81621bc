//! The interface for scripts: exit codes, one JSON object on standard output and nothing else, the fields of
//! the contract, options.

use std::path::Path;

use evolvent_tests::{Domain, Finished, Launch, Workshop, repository, run};
use serde_json::Value;

const MACHINE: &str = "config/machines/mill-3axis.toml";
/// Fields of the summary of `run` and of the JSON of `plan`.
const SUMMARY: [&str; 15] = [
    "axes",
    "cycles",
    "rate_hz",
    "duration_s",
    "path_length_mm",
    "late_cycles",
    "dropped_records",
    "max_chord_error_mm",
    "max_path_error_mm",
    "end_position",
    "per_axis",
    "max_velocity_mm_s",
    "max_acceleration_mm_s2",
    "max_jerk_mm_s3",
    "period_ns",
];

#[track_caller]
fn assert_fields(object: &Value, fields: &[&str]) {
    for field in fields {
        assert!(!object[field].is_null(), "{field} is missing in {object}");
    }
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

#[test]
fn json_of_run_and_plan_matches_the_contract() {
    let workshop = Workshop::new();
    let (program, machine) = (workshop.short_program(), workshop.mill("json", &[]));
    let summary = Launch::in_virtual_time(&program, &machine)
        .no_trace()
        .finish()
        .expect_code(&[0])
        .json();
    let plan = run(["plan", &text(&program), "--machine", &text(&machine), "--json"])
        .expect_code(&[0])
        .json();
    for object in [&summary, &plan] {
        assert_fields(object, &SUMMARY);
        assert_eq!(object["axes"], serde_json::json!(["X", "Y", "Z"]));
        for list in [
            "end_position",
            "max_velocity_mm_s",
            "velocity_ratio",
            "acceleration_ratio",
            "jerk_ratio",
            "per_axis",
        ] {
            assert_eq!(
                object[list].as_array().map(Vec::len),
                Some(3),
                "{list}: one entry an axis"
            );
        }
        let [cycles, period, duration] =
            ["cycles", "period_ns", "duration_s"].map(|name| object[name].as_f64().expect(name));
        assert!((cycles * period * 1e-9 - duration).abs() < 1e-9, "{object}");
    }
    // A plan is a run without a listener.
    for field in ["cycles", "end_position", "max_jerk_mm_s3", "path_length_mm"] {
        assert_eq!(summary[field], plan[field], "{field}");
    }
    assert_fields(&plan, &["needed_rate_hz", "longest_stop_mm", "warnings"]);
}

#[test]
fn json_of_other_commands_is_one_object() {
    let workshop = Workshop::new();
    let (program, machine) = (workshop.short_program(), workshop.mill("others", &[]));
    let trace = workshop.path("run.mcap");
    Launch::in_virtual_time(&program, &machine)
        .trace(&trace)
        .finish()
        .expect_code(&[0]);

    let check = run(["check", &text(&program), "--machine", &text(&machine), "--json"])
        .expect_code(&[0])
        .json();
    assert_eq!(check["errors"], serde_json::json!([]));
    let wrong = workshop.write("wrong.ngc", "G21\nG0 X1 Q7\nM2\n");
    let check = run(["check", &text(&wrong), "--machine", &text(&machine), "--json"])
        .expect_code(&[1])
        .json();
    assert_eq!(check["errors"][0]["line"], 2);
    assert_eq!(check["errors"][0]["column"], 7);

    let rate = run(["rate", "--machine", &text(&machine), "--json"])
        .expect_code(&[0])
        .json();
    assert_fields(
        &rate,
        &["rate_hz", "period_ns", "radius_mm", "feed_mm_min", "limited_by"],
    );
    let options = [
        "--acceleration-g",
        "1",
        "--jerk",
        "50",
        "--feed",
        "20000",
        "--increments-per-mm",
        "1000",
    ];
    let rate = run(["rate", "--json"].iter().chain(&options))
        .expect_code(&[0])
        .json();
    assert_fields(
        &rate,
        &["rate_hz", "period_ns", "radius_mm", "feed_mm_min", "limited_by"],
    );

    let info = run(["trace", "info", &text(&trace), "--json"])
        .expect_code(&[0])
        .json();
    assert_eq!(info["run"]["axes"], "XYZ");
    assert_eq!(info["run"]["clock"], "virtual");
    assert!(
        info["channels"]["/cycle"]["messages"].as_u64() > Some(100),
        "{info}"
    );
    let recovered = run(["trace", "recover", &text(&trace), "--json"])
        .expect_code(&[0])
        .json();
    assert_eq!(recovered["was_complete"], true);

    let doctor = run(["doctor", "--help"]).expect_code(&[0]);
    assert!(doctor.out.contains("--json"), "{}", doctor.out);
}

#[test]
fn exit_codes_are_those_of_the_contract() {
    let workshop = Workshop::new();
    let (program, machine) = (
        text(&workshop.short_program()),
        text(&workshop.mill("codes", &[])),
    );
    let cases: [(i32, &[&str]); 16] = [
        (0, &["--help"]),
        (0, &["--version"]),
        (0, &["check", &program, "--machine", &machine]),
        (0, &["plan", &program, "--machine", &machine, "--override", "50"]),
        (0, &["bore", "--hole", "40", "--tool", "16", "--pitch", "2"]),
        (2, &[]),
        (2, &["dance"]),
        (2, &["run"]),
        (2, &["run", &program]),
        (2, &["run", &program, "--machine", &machine, "--clock", "sundial"]),
        (2, &["run", &program, "--machine", &machine, "--override", "201"]),
        (2, &["plan", &program, "--machine", &machine, "--rate", "-1"]),
        (2, &["plan", &program, "--machine", &machine, "--rate", "1"]),
        (2, &["bore", "--hole", "16", "--tool", "40", "--pitch", "2"]),
        (2, &["trace", "info", "/none.mcap"]),
        (2, &["rate", "--jerk", "50"]),
    ];
    for (code, arguments) in cases {
        let finished: Finished = run(arguments).expect_code(&[code]);
        assert!(
            code == 0 || finished.out.is_empty(),
            "{arguments:?}: errors go to standard error
{}",
            finished.out
        );
    }
    // The error of an impossible hole names both numbers.
    let refused = run(["bore", "--hole", "16", "--tool", "40", "--pitch", "2"]).expect_code(&[2]);
    assert!(
        refused.err.contains("16") && refused.err.contains("40"),
        "{}",
        refused.err
    );
}

/// Output for scripts is not mixed with output for people, whatever the program prints.
#[test]
fn messages_of_the_program_go_to_standard_error() {
    let (workshop, domain) = (Workshop::new(), Domain::new());
    let program = workshop.write("talk.ngc", "G21 G90\n(MSG, look at me)\nG0 X1\nM0\nG0 X0\nM2\n");
    let machine = workshop.mill("talk", &[]);
    for launch in [
        Launch::in_virtual_time(&program, &machine),
        Launch::in_real_time(&program, &machine, &domain),
    ] {
        let finished = launch.no_trace().finish().expect_code(&[0, 3]);
        assert_eq!(
            finished.json()["outcome"],
            "done",
            "nobody is there to press a key at M0"
        );
        assert!(finished.err.contains("look at me"), "{}", finished.err);
        assert!(
            !finished.err.contains('\u{1b}'),
            "no progress bar where there is no terminal"
        );
    }
}

/// A trace is in the given file, or in `traces` under the name of the program, and no part file remains.
#[test]
fn traces_go_to_the_given_file_or_the_traces_folder() {
    let workshop = Workshop::new();
    let (program, machine) = (workshop.short_program(), workshop.mill("places", &[]));
    let deep = workshop.path("new/folder/run.mcap");
    Launch::in_virtual_time(&program, &machine)
        .trace(&deep)
        .finish()
        .expect_code(&[0]);
    assert!(deep.exists());
    let mut command = evolvent_tests::evolvent();
    command
        .current_dir(workshop.folder())
        .arg("run")
        .arg(&program)
        .arg("--machine")
        .arg(&machine);
    command.args(["--clock", "virtual", "--no-bus", "--json"]);
    let summary = Finished::from(command.output().expect("the binary to start"))
        .expect_code(&[0])
        .json();
    let named = summary["trace"].as_str().expect("the trace is named");
    assert!(
        named.starts_with("traces/short-") && named.ends_with(".mcap"),
        "{named}"
    );
    assert!(workshop.path(named).exists(), "{named}");
    assert_eq!(
        std::fs::read_dir(workshop.path("traces"))
            .expect("the folder")
            .count(),
        1
    );
}

#[test]
fn help_names_every_option_of_the_contract() {
    let options: [(&[&str], &[&str]); 7] = [
        (
            &["run"],
            &[
                "--machine",
                "--clock",
                "--rate",
                "--trace",
                "--no-trace",
                "--no-bus",
                "--override",
                "--json",
            ],
        ),
        (&["plan"], &["--machine", "--json", "--setpoints"]),
        (&["check"], &["--machine"]),
        (
            &["rate"],
            &[
                "--machine",
                "--acceleration-g",
                "--jerk",
                "--feed",
                "--increments-per-mm",
                "--json",
                "--plot",
            ],
        ),
        (
            &["bore"],
            &[
                "--hole",
                "--tool",
                "--pitch",
                "--allowance",
                "--finish",
                "--start",
                "--turns",
                "--climb",
                "--conventional",
                "--depth",
                "--step",
                "--center",
            ],
        ),
        (&["trace", "info"], &["--json"]),
        (&["trace", "recover"], &["--json", "--output"]),
    ];
    for (command, wanted) in options {
        let help = run(command.iter().chain(&["--help"])).expect_code(&[0]).out;
        for option in wanted {
            assert!(help.contains(option), "{command:?}: {option} is not in\n{help}");
        }
    }
}

/// The two commands of the README are those that continuous integration runs.
#[test]
fn the_readme_names_the_two_commands() {
    let readme = std::fs::read_to_string(repository().join("README.md")).expect("the README");
    let script = std::fs::read_to_string(repository().join(".ci/run")).expect("the script");
    let first = format!("run tests/programs/bore-200.ngc --machine {MACHINE}");
    assert!(readme.contains(&first), "{first}");
    assert!(readme.contains("\n    tools/test\n"), "tools/test");
    assert!(
        script.contains("run tests/programs/bore-200.ngc") && script.contains("tools/test"),
        ".ci/run runs both"
    );
}

#[test]
fn a_reader_that_goes_is_no_error_of_any_command() {
    let workshop = Workshop::new();
    let (program, machine) = (workshop.short_program(), workshop.mill("gone", &[]));
    let (program, machine) = (program.to_str().expect("UTF-8"), machine.to_str().expect("UTF-8"));
    let commands: [&[&str]; 4] = [
        &["bore", "--hole", "40", "--tool", "16", "--pitch", "2"],
        &["rate", "--machine", machine],
        &["check", program, "--machine", machine, "--json"],
        &["plan", program, "--machine", machine],
    ];
    for arguments in commands {
        let binary = evolvent_tests::evolvent();
        // The reader has gone before the first word is written.
        let script = "{ sleep 0.3; \"$0\" \"$@\"; } | true; exit ${PIPESTATUS[0]}";
        let output = std::process::Command::new("bash")
            .args(["-c", script])
            .arg(binary.get_program())
            .args(arguments)
            .output()
            .expect("bash");
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {stderr}");
        assert!(!stderr.contains("pipe"), "{arguments:?}: {stderr}");
    }
}

//! Results of runs: JSON, exit codes and traces.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use evolvent_trace::{EventKind, TraceFile};
use serde_json::Value;
use tempfile::TempDir;

/// Far longer than any run here takes.
const TOO_LONG: Duration = Duration::from_secs(60);
const MACHINE: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../../config/machines/mill-3axis.toml"
);
const STATE_STOPPED: u8 = 5;

/// Runs the command to its end, or fails if it does not end.
fn evolvent(arguments: &[&str]) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_evolvent"))
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > TOO_LONG {
            child.kill().unwrap();
            panic!("{arguments:?} does not end");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    child.wait_with_output().unwrap()
}

struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn program(&self, text: &str) -> PathBuf {
        let path = self.path("program.ngc");
        fs::write(&path, text).unwrap();
        path
    }

    fn plan(&self, text: &str) -> Output {
        let program = self.program(text);
        evolvent(&["plan", as_str(&program), "--machine", MACHINE, "--json"])
    }

    /// Runs with the virtual clock and records to `run.mcap`, without checking the whole program first.
    fn run(&self, text: &str) -> (Output, PathBuf) {
        let (program, trace) = (self.program(text), self.path("run.mcap"));
        let output = evolvent(&[
            "run",
            as_str(&program),
            "--machine",
            MACHINE,
            "--clock",
            "virtual",
            "--no-bus",
            "--trace",
            as_str(&trace),
            "--json",
            "--unchecked",
        ]);
        (output, trace)
    }
}

fn as_str(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Standard output as exactly one JSON object.
fn json(output: &Output) -> Value {
    let value: Value = serde_json::from_slice(&output.stdout).expect("one JSON value");
    assert!(value.is_object());
    value
}

#[test]
fn consecutive_program_stops_take_the_same_cycles() {
    let bench = Bench::new();
    let text = "G1 X1 F600\nM0\nM0\nM60\nG1 X2\nM0\nM2\n";
    let (first, second) = (bench.plan(text), bench.plan(text));
    assert_eq!(first.status.code(), Some(0));
    assert_eq!(json(&first), json(&second));
    // The moves alone take almost all cycles.
    let none = json(&bench.plan("G1 X1 F600\nG4 P0\nG1 X2\nM2\n"));
    let extra = json(&first)["cycles"].as_u64().unwrap() - none["cycles"].as_u64().unwrap();
    assert!(extra <= 10, "{extra} cycles");
}

#[test]
fn a_program_with_an_error_runs_up_to_it_and_fails() {
    let bench = Bench::new();
    let (output, trace) = bench.run("G61\nG1 X5 F600\nG1 Y5\nG6 X1\nG1 X0\nM2\n");
    assert_eq!(output.status.code(), Some(1));
    let summary = json(&output);
    assert_eq!(summary["outcome"], "failed");
    assert_eq!(summary["alarm"], 100);
    assert!(
        summary["error"].as_str().unwrap().contains("program.ngc:4:1"),
        "{summary}"
    );
    assert_eq!(summary["end_position"], serde_json::json!([5.0, 5.0, 0.0]));

    let mut trace = TraceFile::open(&trace).unwrap();
    let last = trace.cycles().last().unwrap().unwrap();
    assert_eq!(last.state, STATE_STOPPED, "not done");
    let alarms: Vec<_> = trace
        .events()
        .map(Result::unwrap)
        .filter(|event| event.kind == EventKind::Alarm)
        .collect();
    assert_eq!(alarms.len(), 1, "{alarms:?}");
    assert_eq!((alarms[0].code, alarms[0].sequence), (100, last.sequence));
    assert!(alarms[0].text.contains("program.ngc:4:1"), "{alarms:?}");
}

#[test]
fn a_later_error_prevents_motion_and_output() {
    let bench = Bench::new();
    // An error of the machine, not of the text: it has no probe, and its travel ends.
    let program = bench.program("G61\nG1 X5 F600\nG38.2 Z-1\nG1 X9000\nM2\n");
    let trace = bench.path("run.mcap");
    let run = |extra: &str| {
        let output = evolvent(&[
            "run",
            as_str(&program),
            "--machine",
            MACHINE,
            "--clock",
            "virtual",
            "--no-bus",
            "--trace",
            as_str(&trace),
            extra,
        ]);
        assert_eq!(output.status.code(), Some(1));
        assert!(!trace.exists());
        output
    };
    let text = String::from_utf8(run("--override=100").stderr).unwrap();
    for part in [
        "program.ngc:3:1",
        "program.ngc:4:4",
        "2 errors",
        "nothing was moved",
        "--unchecked",
    ] {
        assert!(text.contains(part), "{part} is missing in {text}");
    }
    let refused = json(&run("--json"));
    assert_eq!(refused["outcome"], "failed");
    assert_eq!(refused["alarm"], 100);
    assert_eq!(refused["errors"][1]["line"], 4);
}

#[test]
fn an_endless_program_is_checked_up_to_its_loop() {
    let bench = Bench::new();
    let program = bench.program("G61 F60000\nG1 X1\nO1 while [1]\nG1 X0\nG1 X1\nO1 endwhile\nG6\nM2\n");
    let output = evolvent(&["check", as_str(&program), "--machine", MACHINE, "--json"]);
    assert_eq!(output.status.code(), Some(3), "not as if it had no errors");
    let found = json(&output);
    assert_eq!(found["errors"], serde_json::json!([]));
    assert_eq!(found["up_to"], 5, "what follows the loop was not checked");
    assert_eq!(found["unchecked"]["reason"], "loop");
    assert_eq!(found["unchecked"]["line"], 3, "{found}");
    let text = |bounds: &[&str]| {
        let words = ["check", as_str(&program), "--machine", MACHINE];
        let output = evolvent(&[&words[..], bounds].concat());
        assert_eq!(output.status.code(), Some(3));
        String::from_utf8(output.stderr).unwrap()
    };
    let stderr = text(&[]);
    let why = "the loop that begins on line 3 has more than 1000000 commands";
    assert!(
        stderr.contains(why) && stderr.contains("--loop-limit"),
        "{stderr}"
    );
    let stderr = text(&["--loop-limit", "1000"]);
    assert!(stderr.contains("has more than 1000 commands"), "{stderr}");
}

#[test]
fn a_long_loop_is_checked_as_far_as_the_limit_says() {
    let bench = Bench::new();
    let body = "G1 X1\nG1 X0\n".repeat(50);
    let text = format!(
        "G61 F60000\nO<cut> sub\n{body}O<cut> endsub\nO1 repeat [60]\nO<cut> call\nO1 endrepeat\nG6\nM2\n"
    );
    let program = bench.program(&text);
    let check = |limit: &str| {
        let words = ["check", as_str(&program), "--machine", MACHINE, "--json"];
        let output = evolvent(&[&words[..], &["--loop-limit", limit]].concat());
        (output.status.code(), json(&output))
    };
    let (code, found) = check("5000");
    assert_eq!(
        (code, &found["unchecked"]["line"]),
        (Some(3), &104.into()),
        "{found}"
    );
    for enough in ["6000", "0"] {
        let (code, found) = check(enough);
        assert_eq!(
            (code, &found["errors"][0]["line"]),
            (Some(1), &107.into()),
            "{found}"
        );
        assert!(found["unchecked"].is_null(), "{found}");
    }
}

#[test]
fn a_run_says_what_was_not_checked() {
    let bench = Bench::new();
    let program = bench.program("G61 F60000\nO1 repeat [60000]\nG1 X0.001\nG1 X0\nO1 endrepeat\nG6\nM2\n");
    let mut run = Command::new(env!("CARGO_BIN_EXE_evolvent"))
        .args([
            "run",
            as_str(&program),
            "--machine",
            MACHINE,
            "--clock",
            "virtual",
            "--no-trace",
        ])
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut first = String::new();
    let mut stderr = std::io::BufReader::new(run.stderr.take().unwrap());
    std::io::BufRead::read_line(&mut stderr, &mut first).unwrap();
    run.kill().unwrap();
    run.wait().unwrap();
    assert!(
        first.starts_with("warning: ")
            && first.contains("the loop that begins on line 2 has more than 100000"),
        "{first}"
    );
}

#[test]
fn blocks_last_as_planned_despite_dwells_between() {
    let bench = Bench::new();
    let (output, trace) = bench.run("G61.1\nG4 P0.5\nG1 X5 F600\nG4 P2\nM0\nG1 Y5\nG1 X0\nG4 P1\nM2\n");
    let summary = json(&output);
    let period_s = summary["period_ns"].as_f64().unwrap() * 1e-9;
    let mut trace = TraceFile::open(&trace).unwrap();
    let blocks: Vec<_> = trace.blocks().map(Result::unwrap).collect();
    assert_eq!(
        blocks.iter().map(|block| block.line).collect::<Vec<_>>(),
        [3, 6, 7]
    );
    let mut total = 0.0;
    for block in &blocks {
        let off = (block.true_duration_s - block.planned_duration_s).abs();
        assert!(off <= 2.0 * period_s, "{block:?}");
        total += block.true_duration_s;
    }
    let whole = summary["duration_s"].as_f64().unwrap();
    assert!((whole - total - 3.5).abs() <= 12.0 * period_s, "{whole} {total}");
}

#[test]
fn every_message_is_in_the_trace_where_it_was_shown() {
    let bench = Bench::new();
    let mut text = String::new();
    for k in 0..500 {
        text.push_str(&format!("G0 X{}\n(MSG, number {k})\n", 0.001 * f64::from(k % 7)));
    }
    let (output, trace) = bench.run(&text);
    assert_eq!(output.status.code(), Some(0));
    let mut trace = TraceFile::open(&trace).unwrap();
    let shown: Vec<_> = trace
        .events()
        .map(Result::unwrap)
        .filter(|event| event.kind == EventKind::Message)
        .collect();
    let texts: Vec<_> = shown.iter().map(|event| event.text.clone()).collect();
    let expected: Vec<_> = (0..500).map(|k| format!("number {k}")).collect();
    assert_eq!(texts, expected);
    assert!(shown.is_sorted_by_key(|event| event.sequence));
}

#[test]
fn the_next_run_recovers_what_a_killed_run_has_left() {
    let bench = Bench::new();
    let (_, trace) = bench.run("G1 X5 F600\nG1 X0\nM2\n");
    let whole = fs::read(&trace).unwrap();
    fs::remove_file(&trace).unwrap();
    fs::write(bench.path("killed.mcap.part"), &whole[..whole.len() * 9 / 10]).unwrap();
    let (output, _) = bench.run("M2\n");
    assert_eq!(output.status.code(), Some(0));
    assert!(!bench.path("killed.mcap.part").exists());
    let mut recovered = TraceFile::open(&bench.path("killed.mcap")).unwrap();
    assert!(recovered.cycles().all(|cycle| cycle.is_ok()));
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(stderr.contains("killed.mcap.part"), "{stderr}");
}

#[test]
fn an_output_that_is_a_device_stays_one() {
    use std::os::unix::fs::FileTypeExt as _;
    let bench = Bench::new();
    // Not /dev/null itself: a failing test run as root would damage the host.
    let null = bench.path("null.csv");
    let null = null.to_str().unwrap();
    let made = Command::new("mknod").args([null, "c", "1", "3"]).status();
    if !made.is_ok_and(|status| status.success()) || fs::File::options().write(true).open(null).is_err() {
        eprintln!("not measured: no device can be made here");
        return;
    }
    let (_, trace) = bench.run("G1 X5 F600\nM2\n");
    let trace = trace.to_str().unwrap();
    let program = bench.program("G1 X5 F600\nM2\n");
    let program = program.to_str().unwrap();
    for arguments in [
        &["plan", program, "--machine", MACHINE, "--setpoints", null][..],
        &["plan", program, "--machine", MACHINE, "--plot", null],
        &[
            "run",
            program,
            "--machine",
            MACHINE,
            "--clock",
            "virtual",
            "--trace",
            null,
        ],
        &["trace", "export", trace, "--output", null],
        &["trace", "report", trace, "--output", null],
        &["trace", "recover", trace, "--output", null],
    ] {
        let output = evolvent(arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {output:?}");
        let found = fs::metadata(null).unwrap().file_type();
        assert!(found.is_char_device(), "{arguments:?}");
    }
}

#[test]
fn a_run_reads_and_saves_tools_and_parameters() {
    let bench = Bench::new();
    let text = "G43 H1\n#31 = [#31 + 1]\nG10 L2 P2 X7\nG10 L1 P1 R2\nO<lift> call [5]\nG1 X[#31] F600\n\
                (PRINT, %d#31)\nM2\n";
    let program = bench.program(text);
    fs::create_dir(bench.path("subs")).unwrap();
    fs::write(
        bench.path("subs/lift.ngc"),
        "O<lift> sub\nG0 Z[#1]\nO<lift> endsub\n",
    )
    .unwrap();
    fs::write(bench.path("mill.tbl"), "T1 P1 Z-20 D6 ;the mill\n").unwrap();
    fs::write(bench.path("mill.var"), "31 4\n").unwrap();
    // The machine file names all three, relative to its folder.
    let machine = fs::read_to_string(MACHINE).unwrap();
    let keys = "[program]\ntool_table = \"mill.tbl\"\nparameters = \"mill.var\"\nsubroutines = [\"subs\"]\n";
    fs::write(bench.path("mill.toml"), format!("{machine}\n{keys}")).unwrap();
    let run_by = |clock: &str, more: &[&str]| {
        let machine = bench.path("mill.toml");
        let mut arguments = vec!["run", as_str(&program), "--machine", as_str(&machine)];
        arguments.extend(["--clock", clock, "--no-bus", "--no-trace", "--json"]);
        arguments.extend(more);
        evolvent(&arguments)
    };
    let run = |more: &[&str]| run_by("virtual", more);
    let output = run(&[]);
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert_eq!(
        json(&output)["end_position"],
        serde_json::json!([5.0, 0.0, -15.0])
    );
    // Changes that no machine has measured are not saved.
    assert_eq!(fs::read_to_string(bench.path("mill.var")).unwrap(), "31 4\n");
    let tools = fs::read_to_string(bench.path("mill.tbl")).unwrap();
    assert_eq!(tools, "T1 P1 Z-20 D6 ;the mill\n");
    // In real time, where setpoints may be late.
    let output = run_by("realtime", &[]);
    assert!(
        matches!(output.status.code(), Some(0 | 3)),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let kept = fs::read_to_string(bench.path("mill.var")).unwrap();
    assert!(
        kept.contains("31\t5.0\n") && kept.contains("5241\t7.0\n"),
        "{kept}"
    );
    let tools = fs::read_to_string(bench.path("mill.tbl")).unwrap();
    assert_eq!(tools, "T1 P1 Z-20 D4 ;the mill\n");
    // The command line overrides the machine file; a plan saves nothing.
    fs::write(bench.path("other.var"), "31 9\n").unwrap();
    assert_eq!(
        json(&run(&["--parameters", as_str(&bench.path("other.var"))]))["end_position"][0],
        10.0
    );
    let machine = bench.path("mill.toml");
    let plan = evolvent(&["plan", as_str(&program), "--machine", as_str(&machine), "--json"]);
    assert_eq!(json(&plan)["end_position"][0], 6.0);
    assert_eq!(fs::read_to_string(bench.path("mill.var")).unwrap(), kept);
    // A run that fails saves nothing either.
    let broken = text.replace("M2", "G6");
    bench.program(&broken);
    assert_eq!(run(&[]).status.code(), Some(1));
    assert_eq!(fs::read_to_string(bench.path("mill.var")).unwrap(), kept);
    fs::write(bench.path("mill.var"), "nonsense\n").unwrap();
    let output = run(&[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("mill.var: line 1"));
}

#[test]
fn a_mid_program_start_is_shown_and_ends_as_the_whole() {
    let bench = Bench::new();
    let program = bench.program("G61 F1200\nG0 X10 Z5\nG1 Z-1\nG1 X20\nG1 Y7\nM2\n");
    let plan = |more: &[&str]| {
        let mut arguments = vec!["plan", as_str(&program), "--machine", MACHINE, "--json"];
        arguments.extend(more);
        evolvent(&arguments)
    };
    let (whole, rest) = (plan(&[]), plan(&["--start-line", "5"]));
    assert_eq!(json(&rest)["end_position"], json(&whole)["end_position"]);
    // Up, across, down, plunge at the feed, and the one remaining line.
    assert_eq!(json(&rest)["moves"], 5);
    let stderr = String::from_utf8_lossy(&rest.stderr).into_owned();
    for part in [
        "starting at line 5",
        "G61",
        "F1200",
        "X20.0000",
        "Z to -1.000, at 1200.0 mm/min",
    ] {
        assert!(stderr.contains(part), "{part}: {stderr}");
    }
    let beyond = plan(&["--start-line", "50"]);
    assert_eq!(beyond.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&beyond.stderr).contains("G0219"));
}

#[test]
fn a_trace_never_replaces_what_is_run() {
    let bench = Bench::new();
    let program = bench.program("G1 X1 F600\nM2\n");
    for target in [as_str(&program), as_str(bench.folder.path())] {
        let output = evolvent(&[
            "run",
            as_str(&program),
            "--machine",
            MACHINE,
            "--no-bus",
            "--clock",
            "virtual",
            "--trace",
            target,
        ]);
        assert_eq!(output.status.code(), Some(2), "{target}");
    }
    assert_eq!(fs::read_to_string(&program).unwrap(), "G1 X1 F600\nM2\n");
}

#[test]
fn negative_numbers_are_judged_as_numbers() {
    let output = evolvent(&["bore", "--hole", "20", "--tool", "8", "--pitch", "-1"]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr.contains("a pitch of -1 mm is impossible"), "{stderr}");
}

#[test]
fn a_run_that_could_never_move_is_refused() {
    let bench = Bench::new();
    let program = bench.program("G1 X1 F600\nM2\n");
    let output = evolvent(&["plan", as_str(&program), "--machine", MACHINE, "--override", "0"]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn a_message_or_the_next_tool_does_not_stop_the_path() {
    let bench = Bench::new();
    let plain = "G21 G61 F3000\nG1 X20\nX40\nX60\nM2\n";
    let with_words = "G21 G61 F3000\nG1 X20\n(MSG, half way)\nX40\nT2\nX60\nM2\n";
    let [plain, with_words] = [plain, with_words].map(|text| json(&bench.plan(text))["cycles"].clone());
    assert_eq!(plain, with_words);
    // 60 mm at 50 mm/s, and little more than one acceleration and one deceleration.
    let cycles = plain.as_f64().unwrap() * 0.001_264_809;
    assert!((1.2..1.3).contains(&cycles), "{cycles} s");
}

#[test]
fn the_machine_file_says_how_far_an_arc_may_be_off() {
    let bench = Bench::new();
    // Radius 10 at the start, 10.02 at the end.
    let program = bench.program("G21 F600\nG2 X10 Y10.02 I10 J0\nM2\n");
    let text = fs::read_to_string(MACHINE).unwrap();
    for (tolerance, code) in [("0.05", 0), ("0.001", 1)] {
        let machine = bench.path("machine.toml");
        let key = format!("[path]\narc_radius_tolerance_mm = {tolerance}");
        fs::write(&machine, text.replace("[path]", &key)).unwrap();
        let output = evolvent(&["check", as_str(&program), "--machine", as_str(&machine)]);
        assert_eq!(
            output.status.code(),
            Some(code),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
}

#[test]
fn a_signal_ends_a_stepped_replay_that_waits() {
    use std::io::{BufRead as _, BufReader};
    let bench = Bench::new();
    let (_, trace) = bench.run("G21 G90 F1000\nG1 X10\nM2\n");
    let prefix = format!("evst{}-", std::process::id());
    for signal in ["INT", "TERM"] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_evolvent"))
            .args([
                "trace",
                "replay",
                "--step",
                "--json",
                "--bus-prefix",
                &prefix,
                as_str(&trace),
            ])
            // The pipe stays open without input.
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut prompt = String::new();
        let mut err = BufReader::new(child.stderr.take().unwrap());
        err.read_line(&mut prompt).unwrap();
        assert!(prompt.contains("Enter for the next"), "{prompt}");
        let id = child.id().to_string();
        let sent = Command::new("kill").args(["-s", signal, &id]).status().unwrap();
        assert!(sent.success());
        let begun = Instant::now();
        let status = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break status;
            }
            if begun.elapsed() > TOO_LONG {
                child.kill().unwrap();
                panic!("SIG{signal} does not end it");
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        let summary = json(&child.wait_with_output().unwrap());
        assert_eq!(
            (status.code(), &summary["stopped"], &summary["setpoints"]),
            (Some(0), &true.into(), &0.into())
        );
    }
    evolvent_bus::remove_private_domain(&prefix).unwrap();
}

#[test]
fn a_turning_job_with_a_partial_trace_exits_lost_data() {
    let bench = Bench::new();
    let trace = bench.path("turn.mcap");
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../config");
    let job = format!("{shipped}/processes/turn-shaft.toml");
    let machine = format!("{shipped}/machines/lathe-2axis.toml");
    // Files of at most 1 MB simulate a full disk; the signal that the system would send first is ignored.
    let output = Command::new("bash")
        .args([
            "-c",
            "trap '' XFSZ; ulimit -f 1024; exec \"$0\" \"$@\"",
            env!("CARGO_BIN_EXE_evolvent"),
        ])
        .args([
            "turn",
            &job,
            "--machine",
            &machine,
            "--json",
            "--trace",
            as_str(&trace),
        ])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let err = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{err}");
    assert_eq!(json(&output)["outcome"], "done");
    assert_eq!(
        err.lines().filter(|line| line.contains("turn.mcap")).count(),
        1,
        "{err}"
    );
    assert!(err.contains("warning: "), "{err}");
}

#[test]
fn implausible_values_and_missing_folders_are_warned() {
    let bench = Bench::new();
    let program = bench.program("G21 G90 F9999999\nG1 X1\nX2 F8888888\nM2\n");
    let text = fs::read_to_string(MACHINE).unwrap();
    let key = "max_jerk_m_s3 = 200";
    assert!(text.contains(key));
    let text = text.replacen(key, "max_jerk_m_s3 = 0.5", 1);
    let machine = bench.path("machine.toml");
    // A key of another table with the same prefix, and the folder on a separate line.
    let folders = "[program]\nuser_codes = [] # subroutines\n\"subroutines\" = [\n  \".\",\n  \"gone\",\n]\n";
    fs::write(&machine, format!("{text}\n{folders}")).unwrap();
    let lines = text.lines().count() + 6;
    for command in ["check", "plan"] {
        let output = evolvent(&[command, as_str(&program), "--machine", as_str(&machine)]);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        for part in [
            "max_jerk_m_s3: axis X takes 10 s".to_owned(),
            format!("machine.toml:{lines}: program.subroutines[1]: there is no folder"),
        ] {
            assert_eq!(stderr.matches(&part).count(), 1, "{command}: {part}: {stderr}");
        }
        assert!(stderr.contains("warning: "), "{stderr}");
    }
    let output = evolvent(&["check", as_str(&program), "--machine", MACHINE]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    assert!(
        stderr.contains(":2: F9999999 is far above what the machine can do") && !stderr.contains("F8888888"),
        "{stderr}"
    );
    // At its line, like other warnings of a program.
    for command in ["plan", "run"] {
        let output = evolvent(&[command, as_str(&program), "--machine", MACHINE]);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        let words = "line 2: warning: F9999999 is far above what the machine can do";
        assert_eq!(stderr.matches(words).count(), 1, "{command}: {stderr}");
        assert!(!stderr.contains("F8888888"), "{command}: {stderr}");
    }
    // Inverse time, and a feed of a few times the machine's speed, which means as fast as possible.
    for text in ["G93\nG1 X0.001 F99999\nG94\nM2\n", "F100000\nG1 X1\nM2\n"] {
        let program = bench.program(text);
        let output = evolvent(&["check", as_str(&program), "--machine", MACHINE]);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!stderr.contains("warning"), "{stderr}");
    }
}

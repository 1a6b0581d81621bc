//! Bad input in large numbers: always an error with a position and never a panic; accepted input runs within
//! limits.
#![expect(clippy::expect_used, reason = "helpers of tests fail and talk as tests do")]

use std::fs;
use std::path::Path;
use std::sync::Arc;

use evolvent_gcode::Diagnostic;
use evolvent_machine::Machine;
use evolvent_runtime::{CheckBounds, Controls, Job, Notice, RunObserver, Setup, check};
use evolvent_tests::{Random, Workshop, repository, run};

const PROGRAMS: [&str; 6] = [
    "bore-200",
    "bracket-g61",
    "facing-inch",
    "letters",
    "pocket-helix",
    "relief",
];
/// Number of mutated programs to check, and of those to run as well.
const MUTANTS: usize = 1500;
const RUNS: usize = 150;
/// Limit of a run: a mutated feed may make it last for days.
const MAX_CYCLES: u64 = 100_000;

fn setup() -> Setup {
    let file = repository().join("config/machines/mill-3axis.toml");
    let text = fs::read_to_string(&file).expect("the machine file");
    let machine = Machine::load(&file).expect("the machine");
    Setup::new(machine, file, text, None).expect("the set-up")
}

fn program(name: &str) -> Vec<u8> {
    fs::read(repository().join(format!("tests/programs/{name}.ngc"))).expect("a program")
}

/// Checks a program and the positions of its errors.
#[track_caller]
fn errors(file: &Path, text: &[u8], setup: &Setup) -> Vec<Diagnostic> {
    fs::write(file, text).expect("a file");
    let found = check(file, setup, CheckBounds::while_one_waits(10))
        .expect("a readable file")
        .errors;
    let lines: Vec<&[u8]> = text.split(|byte| *byte == b'\n').collect();
    for error in &found {
        let line = error.line as usize;
        assert!(
            (1..=lines.len()).contains(&line),
            "{error}: there are {} lines",
            lines.len()
        );
        let columns = String::from_utf8_lossy(lines[line - 1]).chars().count();
        assert!(
            (1..=columns + 1).contains(&(error.column as usize)),
            "{error}: {columns} columns"
        );
        assert!(!error.message.is_empty());
        // Only a piece of a long line is shown, and unusual bytes are replaced: the column then refers to the
        // text shown.
        let plain =
            lines[line - 1].len() < 80 && lines[line - 1].iter().all(|byte| (b' '..=b'~').contains(byte));
        let column = if plain {
            error.column.to_string()
        } else {
            String::new()
        };
        let location = format!("part.ngc:{}:{column}", error.line);
        let shown = error.render("part.ngc");
        assert!(shown.contains(&location), "{location} is not in\n{shown}");
    }
    found
}

#[test]
fn truncated_programs_are_harmless_or_errors() {
    let (setup, workshop) = (setup(), Workshop::new());
    let file = workshop.path("cut.ngc");
    let mut refused = 0;
    for name in ["letters", "bracket-g61", "bore-200"] {
        let whole = program(name);
        for length in (0..whole.len()).step_by(7) {
            refused += usize::from(!errors(&file, &whole[..length], &setup).is_empty());
        }
    }
    println!("{refused} refused");
    assert!(refused > 100, "only {refused} refused");
}

/// Replaces, inserts, deletes or duplicates a piece.
fn mutate(text: &mut Vec<u8>, random: &mut Random) {
    const WORDS: [&str; 40] = [
        "NaN",
        "inf",
        "1e308",
        "-1e308",
        "X1e308",
        "F0",
        "F-1",
        "F1e-300",
        "X.",
        "Y-",
        "Q",
        "G999",
        "G2.2",
        "G3.2",
        "R1e-300",
        "R-1e15",
        "I0 J0",
        "I1e15",
        "J-1e-15",
        "G92 X1e9",
        "G20",
        "G21",
        "G91",
        "G90",
        "G93",
        "G95",
        "G61",
        "G64 P-1",
        "G64 P1e9",
        "G18",
        "G19",
        "G53",
        "P1e9",
        "P0",
        "(",
        ")",
        "%",
        "\0",
        "\u{e9}",
        "99999999999999999999",
    ];
    let at = random.below(text.len().max(1));
    match random.below(5) {
        0 if !text.is_empty() => text[at] = random.bits() as u8,
        1 if !text.is_empty() => {
            text.remove(at);
        }
        2 => drop(text.splice(at..at, random.one_of(&WORDS).bytes())),
        3 => {
            let digits = random.between(-1e3, 1e3).to_string();
            let number = text[at..]
                .iter()
                .position(u8::is_ascii_digit)
                .map_or(at, |offset| at + offset);
            drop(text.splice(number..number, digits.bytes()));
        }
        _ => {
            let end = (at + random.below(60)).min(text.len());
            let copy = text[at..end].to_vec();
            let to = random.below(text.len().max(1));
            drop(text.splice(to..to, copy));
        }
    }
}

struct Silent;

impl RunObserver for Silent {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, _: &str) {}
}

/// Runs any program with the virtual clock: the guard must reject nothing and the axes keep their limits.
fn assert_runs_within_limits(file: &Path, setup: &Setup) -> &'static str {
    let job = Job::new(file.to_owned(), setup.clone());
    let controls = Arc::new(Controls::new(1.0));
    let stop = Arc::clone(&controls);
    let outcome = evolvent_runtime::run(&job, &controls, &mut Silent, |setpoint| {
        if setpoint.sequence == MAX_CYCLES {
            stop.stop();
        }
    })
    .expect("a run that starts");
    assert_eq!(outcome.fault.as_deref(), None, "{}", file.display());
    let summary = outcome.summary;
    for (ratios, max) in [
        (&summary.velocity_ratio, 1.001),
        (&summary.acceleration_ratio, 1.001),
        (&summary.jerk_ratio, 1.02),
    ] {
        assert!(
            ratios.iter().all(|ratio| *ratio <= max),
            "{}: {summary:?}",
            file.display()
        );
    }
    assert!(
        summary.max_chord_error_mm <= summary.permitted_chord_error_mm * 1.000_001,
        "{summary:?}"
    );
    summary.outcome.name()
}

/// The printed seed reproduces the mutants of a failing run.
#[test]
fn mutated_programs_are_errors_or_keep_the_limits() {
    let mut random = Random::new();
    let (setup, workshop) = (setup(), Workshop::new());
    let file = workshop.path("mutant.ngc");
    let whole: Vec<Vec<u8>> = PROGRAMS.iter().map(|name| program(name)).collect();
    let (mut refused, mut runs) = (0, 0);
    for mutant in 0..MUTANTS {
        let mut text = random.one_of(&whole).clone();
        // Long programs are shortened: most of their lines are alike.
        text.truncate(6000);
        for _ in 0..=random.below(3) {
            mutate(&mut text, &mut random);
        }
        let is_refused = !errors(&file, &text, &setup).is_empty();
        refused += usize::from(is_refused);
        if mutant % (MUTANTS / RUNS) == 0 {
            let outcome = assert_runs_within_limits(&file, &setup);
            let fits = match outcome {
                // Text after the end of the program is checked, but not run.
                "done" | "stopped" => true,
                "failed" => is_refused,
                _ => false,
            };
            assert!(fits, "{outcome}, refused: {is_refused}");
            runs += 1;
        }
    }
    println!("{refused} of {MUTANTS} refused, {runs} run");
    assert!((MUTANTS / 10..MUTANTS).contains(&refused), "{refused} refused");
}

/// Each with a part of its error message.
#[test]
fn nonsense_is_refused_by_name() {
    let (setup, workshop) = (setup(), Workshop::new());
    let file = workshop.path("nonsense.ngc");
    let cases = [
        ("G0 XNaN", 1, "X"),
        ("G0 X1e308", 1, "X"),
        ("G1 X1", 1, "feed"),
        ("F100\nG1 X1000000000", 2, "travel"),
        ("G0 X399\nG0 X401", 2, "travel"),
        ("G0 X99999999999999999999999999", 1, "X"),
        ("G6", 1, "G6"),
        ("G0 D5", 1, "D"),
        ("M999", 1, "M999"),
        ("G1 X1 F-5", 1, "F"),
        ("F100\nG2 X1 Y1 R0.1", 2, "R"),
        ("F100\nG2 X10 I0 J0", 2, "radius"),
        ("F100\nG2 X1 Y1", 2, ""),
        ("F100\nG3.2 X1 Y1 I0 J0 R-1", 2, "R"),
        ("F100\nG3.2 X5 Y1 I-1 J0 R1e-300", 2, ""),
        ("G0 G1 X1", 1, "G"),
        ("G0 X1 X2", 1, "X"),
        ("G0 A1", 1, "A"),
        ("(no end", 1, "comment"),
        ("o100 sub", 2, "endsub"),
        ("G0 X[1+]", 1, ""),
        ("G64 P-1", 1, "P"),
        ("G4 P-1", 1, "P"),
        ("G4 P1e300", 1, "P"),
        ("S-1", 1, "S"),
        ("T-1", 1, "T"),
        ("\u{fffd}\u{0}", 1, ""),
    ];
    let mut wrong = Vec::new();
    for (text, line, word) in cases {
        let found = errors(&file, format!("{text}\nM2\n").as_bytes(), &setup);
        let Some(error) = found.first() else {
            wrong.push(format!("{text:?} is accepted"));
            continue;
        };
        let message = error.render("part.ngc");
        if error.line != line || !message.to_lowercase().contains(&word.to_lowercase()) {
            wrong.push(format!("{text:?}: {word:?} at line {line} is not in {message}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Through the binary: exit code 1 if the program is wrong, and the position as `file:line:column`.
#[test]
fn errors_name_file_line_and_column_with_exit_code_1() {
    let workshop = Workshop::new();
    let file = workshop.write("wrong.ngc", "G21 G90\nF600 G1 X10\n  G1 X20 Q3\nG1 X30\nM2\n");
    let path = file.display().to_string();
    let location = format!("{path}:3:10");
    let machine = ["--machine", "config/machines/mill-3axis.toml"];
    for command in ["check", "plan", "run"] {
        let extra: &[&str] = if command == "run" {
            &["--clock", "virtual", "--no-bus", "--no-trace"]
        } else {
            &[]
        };
        let finished = run([command, &path].iter().chain(&machine).chain(extra)).expect_code(&[1]);
        assert!(
            finished.err.contains(&location),
            "{command}: {location} is not in\n{}",
            finished.err
        );
        assert!(
            finished.err.contains("G1 X20 Q3"),
            "{command} shows the line:\n{}",
            finished.err
        );
    }
    // Everything before the error is run, to rest.
    let plan = run(["plan", &path, "--json"].iter().chain(&machine)).expect_code(&[1]);
    assert_eq!(plan.json()["end_position"][0], 10.0);
}

#[test]
fn programs_that_cannot_be_read_are_wrong_usage() {
    let workshop = Workshop::new();
    let folder = workshop.folder().display().to_string();
    let missing = workshop.path("missing.ngc").display().to_string();
    for command in ["check", "plan", "run"] {
        for path in [&folder, &missing] {
            let finished =
                run([command, path, "--machine", "config/machines/mill-3axis.toml"]).expect_code(&[2]);
            assert!(
                finished.err.contains(path.as_str()),
                "{command}: {}",
                finished.err
            );
        }
        let empty = workshop.write("empty.ngc", "").display().to_string();
        let mut arguments = vec![command, &empty, "--machine", "config/machines/mill-3axis.toml"];
        if command == "run" {
            arguments.extend(["--clock", "virtual", "--no-bus", "--no-trace"]);
        }
        run(arguments).expect_code(&[0, 1]);
    }
}

/// Each change with the key that the error must name and its position in the file.
#[test]
fn invalid_machine_files_name_file_line_and_key() {
    let changes = [
        ("travel_max_mm = 400", "travel_max_mm = -401", "travel"),
        ("travel_max_mm = 400", "travel_max_mm = nan", "travel_max_mm"),
        ("travel_max_mm = 400", "travel_max_mm = inf", "travel_max_mm"),
        ("home_mm = 0", "home_mm = 1e308", "home"),
        ("max_jerk_m_s3 = 200", "max_jerk_m_s3 = -200", "max_jerk"),
        ("max_jerk_m_s3 = 200", "max_jerk_m_s3 = 0", "max_jerk"),
        ("max_jerk_m_s3 = 200", "max_jerk = 200", "max_jerk"),
        (
            "max_velocity_mm_min = 30000",
            "max_velocity_mm_min = 1e308",
            "max_velocity",
        ),
        ("max_velocity_mm_min = 30000", "", "max_velocity"),
        ("letter = \"Y\"", "letter = \"X\"", "X"),
        ("letter = \"Y\"", "letter = \"Q\"", "letter"),
        ("letter = \"Y\"", "letter = 5", "letter"),
        ("kind = \"linear\"", "kind = \"curved\"", "kind"),
        (
            "increments_per_mm = 1000",
            "increments_per_mm = 0",
            "increments_per_mm",
        ),
        ("rate = \"rational\"", "rate = \"fast\"", "rate"),
        ("rate = \"rational\"", "rate = -5", "rate"),
        ("rate = \"rational\"", "rate = nan", "rate"),
        ("# lead_ms = 2 ", "lead_cycles = -2 # ", "lead_cycles"),
        ("# lead_ms = 2 ", "lead_ms = 0 # ", "lead_ms"),
        (
            "# lead_ms = 2 ",
            "lead_cycles = 2\nleed_cycles = 2 # ",
            "leed_cycles",
        ),
        ("# lead_ms = 2 ", "lead_cycles = 2\nlead_ms = 2 # ", "lead_ms"),
        (
            "blend_tolerance_mm = 0.01",
            "blend_tolerance_mm = -0.01",
            "blend_tolerance_mm",
        ),
        ("on_full = \"continue\"", "on_full = \"shrug\"", "on_full"),
        ("priority = 80", "priority = 8000", "priority"),
        ("[path]", "[path", ""),
        ("name = \"odd\"", "name = \"a/b\"", "name"),
    ];
    let workshop = Workshop::new();
    let program = workshop.short_program().display().to_string();
    for (old, new, key) in changes {
        let machine = workshop.mill("odd", &[(old, new)]).display().to_string();
        let finished = run(["check", &program, "--machine", &machine]).expect_code(&[2]);
        assert!(
            finished.err.contains(key),
            "{old} -> {new}: {key} is not in {}",
            finished.err
        );
        let rest = finished.err.split(&machine).nth(1);
        let line = rest
            .and_then(|rest| rest.strip_prefix(':'))
            .and_then(|rest| rest.chars().next());
        assert!(
            line.is_some_and(|digit| digit.is_ascii_digit()),
            "{old} -> {new}: no line in {}",
            finished.err
        );
    }
    for bytes in [
        &b""[..],
        b"\xff\xfe\0",
        b"name = 1",
        b"[[axis]]\n",
        &[b'['; 100_000],
    ] {
        let machine = workshop.write("odd.toml", bytes).display().to_string();
        let finished = run(["check", &program, "--machine", &machine]).expect_code(&[2]);
        assert!(finished.err.contains(&machine), "{}", finished.err);
    }
    for path in [workshop.path("missing.toml"), workshop.folder().to_owned()] {
        let path = path.display().to_string();
        let finished = run(["check", &program, "--machine", &path]).expect_code(&[2]);
        assert!(finished.err.contains(&path), "{}", finished.err);
    }
}

#[test]
fn run_rejects_a_machine_that_requires_drives() {
    let workshop = Workshop::new();
    let machine = workshop.mill(
        "requires-drives",
        &[("feedback = \"if_present\"", "feedback = \"required\"")],
    );
    let program = workshop.short_program();
    let finished = run([
        "run".as_ref(),
        program.as_os_str(),
        "--machine".as_ref(),
        machine.as_os_str(),
        "--no-trace".as_ref(),
    ])
    .expect_code(&[1]);
    assert!(finished.err.contains("drives.feedback"), "{}", finished.err);
    assert!(finished.err.contains("evolvent serve"), "{}", finished.err);
}

//! Several spindles: the spindle of a line (`$`), compared with LinuxCNC.
//!
//! The expected commands are those of `rs274` of LinuxCNC 2.9 with four spindles; SPECNOTES lists the
//! differences.

#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::fmt::Write as _;

use evolvent_gcode::{
    Action, Code, Diagnostic, Interpreter, MachineFeatures, SPINDLES, Settings, SpindleDirection,
};
use evolvent_random::{Random, cases, seed, seed_of_time};

use crate::rs274;

fn settings(spindles: [bool; SPINDLES]) -> Settings {
    Settings {
        features: MachineFeatures {
            lathe: false,
            spindles,
            ..MachineFeatures::default()
        },
        ..Settings::default()
    }
}

/// The actions up to the first error, and that error.
fn run_on(program: &str, spindles: [bool; SPINDLES]) -> (Vec<Action>, Option<Diagnostic>) {
    let mut actions = Vec::new();
    for item in Interpreter::new(program.as_bytes(), settings(spindles)) {
        match item {
            Ok(command) => actions.push(command.action),
            Err(error) => return (actions, Some(error)),
        }
    }
    (actions, None)
}

fn run(program: &str) -> Vec<Action> {
    let (actions, error) = run_on(program, [true; SPINDLES]);
    assert!(error.is_none(), "{program}: {error:?}");
    actions
}

/// Commands to spindles as text: `1 cw 200`.
fn spindles(actions: &[Action]) -> Vec<String> {
    let mut lines = Vec::new();
    for action in actions {
        match action {
            Action::Spindle {
                spindle,
                direction,
                speed_rpm,
            } => lines.push(format!("{spindle} {} {speed_rpm}", direction_name(*direction))),
            Action::SurfaceSpeed {
                spindle,
                direction,
                surface,
            } => lines.push(format!(
                "{spindle} {} {} m/min to {}",
                direction_name(*direction),
                surface.speed_m_min,
                surface.max_rpm
            )),
            Action::OrientSpindle { spindle, degrees, .. } => lines.push(format!("{spindle} at {degrees}")),
            Action::Thread { spindle, .. } => lines.push(format!("{spindle} thread")),
            Action::RigidTap { spindle, .. } => lines.push(format!("{spindle} tap")),
            _ => {}
        }
    }
    lines
}

fn direction_name(direction: SpindleDirection) -> &'static str {
    match direction {
        SpindleDirection::Stopped => "stop",
        SpindleDirection::Clockwise => "cw",
        SpindleDirection::CounterClockwise => "ccw",
    }
}

#[test]
fn speed_and_direction_are_those_of_the_named_spindle() {
    let reported = spindles(&run("S100 M3\nS200 $1\nM4 $1\nM5 $-1\nM2\n"));
    let expected = [
        "0 cw 100",
        "1 stop 200",
        "1 ccw 200",
        "0 stop 100",
        "1 stop 200",
        "2 stop 0",
        "3 stop 0",
    ];
    assert_eq!(reported, expected);
    // Without $ it is spindle 0, whatever spindle was named before.
    let reported = spindles(&run("S100 M3 $1\nM4\nM2\n"));
    assert_eq!(reported, ["1 cw 100", "0 ccw 0", "0 stop 0", "1 stop 100"]);
}

#[test]
fn all_spindles_are_those_of_the_machine() {
    let (actions, error) = run_on("S7 M3 $-1\nM2\n", [true, false, true, false]);
    assert!(error.is_none(), "{error:?}");
    assert_eq!(spindles(&actions), ["0 cw 7", "2 cw 7", "0 stop 7", "2 stop 7"]);
}

#[test]
fn modes_of_speed_are_of_each_spindle() {
    let reported = spindles(&run("G96 S100 D2000 $1\nM3 $1\nG97 S200 $1\nG96 S50 D500\nM2\n"));
    let expected = [
        "1 stop 100 m/min to 2000",
        "1 cw 100 m/min to 2000",
        "1 cw 200",
        "0 stop 50 m/min to 500",
        // The end: a surface speed ends with its program, also that of a stopped spindle.
        "0 stop 0",
        "1 stop 200",
    ];
    assert_eq!(reported, expected);
    // A tool change stops all.
    let reported = spindles(&run("M61 Q1\nM3 S300 $1\nM4 S7\nT0 M6\nM2\n"));
    assert_eq!(reported, ["1 cw 300", "0 ccw 7", "0 stop 7", "1 stop 300"]);
    // M72 restores spindle 0.
    let reported = spindles(&run("S4 M3\nM70\nS10 M3 $1\nM4 S30\nM72\nM2\n"));
    let expected = ["0 cw 4", "1 cw 10", "0 ccw 30", "0 cw 4", "0 stop 4", "1 stop 10"];
    assert_eq!(reported, expected);
}

#[test]
fn threads_follow_the_spindle_that_was_named_last() {
    let text = "S300 M3 $1\nG33 Z-5 K1 $1\nG33 Z-8 K1\nG33.1 Z-10 K1\nM3 S5\nG33 Z-11 K1 $0\nG33 Z-12 K1\n";
    let reported = spindles(&run(&format!("{text}G97 S300 $1\nG33 Z-13 K1\nM2\n")));
    // G94 without $ names spindle 0.
    let after = spindles(&run("S3 M3 $-1\nG33 Z-5 K1 $1\nG94\nG33 Z-8 K1\nM2\n"));
    assert!(
        after
            .iter()
            .filter(|line| line.contains("thread"))
            .eq(["1 thread", "0 thread"].iter())
    );
    let threads: Vec<_> = reported
        .iter()
        .filter(|line| line.contains("thread") || line.contains("tap"))
        .collect();
    let expected = [
        "1 thread", "1 thread", "1 tap", "0 thread", "0 thread", "1 thread",
    ];
    assert_eq!(threads, expected.iter().collect::<Vec<_>>());
    // M3 and S do not select a spindle for threads.
    let (_, error) = run_on("S300 M3 $1\nG33 Z-5 K1\nM2\n", [true; SPINDLES]);
    let error = error.expect("an error");
    assert_eq!(error.code, Code::SpindleSpeedMissing);
    assert!(error.to_string().contains("spindle 0"), "{error}");
    assert!(
        error.help.as_ref().is_some_and(|help| help.contains("write $1")),
        "{error}"
    );
}

#[test]
fn feed_per_revolution_is_of_the_spindle_of_g95() {
    let mut feeds = Vec::new();
    let program = "S300 M3 $1\nS60 M3\nG95 F1 S300 $1\nG1 X1\nG33 Z1 K1 $0\nG1 X2\nG95 F2\nG1 X3\nM2\n";
    for item in Interpreter::new(program.as_bytes(), settings([true; SPINDLES])) {
        let command = item.expect("no error");
        if let Action::Move(motion) = &command.action {
            feeds.push((command.feed_spindle, command.feed_mm_rev, motion.feed_mm_s));
        }
    }
    // 1 mm at 300 rpm, and 2 mm at 60 rpm.
    let expected = [(1, Some(1.0), 5.0), (1, Some(1.0), 5.0), (0, Some(2.0), 2.0)];
    assert_eq!(feeds, expected);
}

#[test]
fn an_orientation_leaves_the_other_codes_of_its_line() {
    let actions = run("M19 R90 M8\nM19 R0 $1 M49\nM19 R5 $2 M9 S700\nM2\n");
    let reported: Vec<&str> = actions
        .iter()
        .filter_map(|action| match action {
            Action::OrientSpindle { .. } => Some("orient"),
            Action::Coolant { flood: true, .. } => Some("flood"),
            Action::Coolant { .. } => Some("dry"),
            Action::Overrides { .. } => Some("overrides"),
            Action::Spindle { .. } => Some("spindle"),
            _ => None,
        })
        .take(6)
        .collect();
    assert_eq!(
        reported,
        ["orient", "flood", "orient", "overrides", "orient", "dry"]
    );
}

#[test]
fn overrides_apply_to_one_spindle_or_all() {
    let reported: Vec<[bool; SPINDLES]> = run("M51 P0 $1\nM51 P0\nM51 P1 $2\nM48\nM49\nM2\n")
        .iter()
        .filter_map(|action| match action {
            Action::Overrides { spindles, .. } => Some(*spindles),
            _ => None,
        })
        .collect();
    let expected = [
        [true, false, true, true],
        [false; 4],
        [false, false, true, false],
        [true; 4],
        [false; 4],
    ];
    assert_eq!(reported, expected);
}

#[test]
fn cycles_turn_the_named_spindle() {
    let reported = spindles(&run("S10 M3 $1\nG84 X1 Z-1 R1 F10 $1\nG80\nM2\n"));
    let expected = [
        "1 cw 10",
        "1 stop 10",
        "1 ccw 10",
        "1 stop 10",
        "1 cw 10",
        "1 stop 10",
    ];
    assert_eq!(reported, expected);
    let (_, error) = run_on("S10 M3 $1\nG86 X1 Z-1 R1 F10 P1 $2\n", [true; SPINDLES]);
    assert_eq!(error.expect("an error").code, Code::SpindleSpeedMissing);
}

#[test]
fn an_invalid_spindle_selection_is_an_error() {
    let cases = [
        ("M3 $4\n", Code::SpindleSelection, "numbers 0 to 3"),
        ("M3 $1.5\n", Code::SpindleSelection, "numbers 0 to 3"),
        ("M3 $-2\n", Code::SpindleSelection, "numbers 0 to 3"),
        ("M3 $2\n", Code::SpindleSelection, "the machine has no spindle 2"),
        ("M19 R5 $-1\n", Code::SpindleSelection, "all spindles"),
        ("M51 P0 $-1\n", Code::SpindleSelection, "all spindles"),
        ("G96 S5 $-1\n", Code::SpindleSelection, "all spindles"),
        ("M3\nG33 Z1 K1 $-1\n", Code::SpindleSelection, "all spindles"),
        ("G94 S3 $-1\n", Code::SpindleSelection, "all spindles"),
        ("G95 S3 $-1\n", Code::SpindleSelection, "all spindles"),
        ("G0 X1 $1\n", Code::UnusedWord, "uses $"),
        ("M49 $1\n", Code::UnusedWord, "uses $"),
    ];
    for (program, code, text) in cases {
        let (_, error) = run_on(program, [true, true, false, true]);
        let error = error.expect(program);
        assert!(
            error.code == code && error.to_string().contains(text),
            "{program}: {error}"
        );
    }
    let (_, error) = run_on("M3 $2\n", [true, true, false, true]);
    let help = error.expect("an error").help.expect("a cure");
    assert!(
        help.contains("$0, $1, $3") && help.contains("number = 2"),
        "{help}"
    );
}

#[test]
fn a_restart_commands_every_spindle() {
    let program = "S100 M3\nS200 M4 $1\nS300 $2\nG95 F0.1 S300 $2\nG96 S30 D900 M3 $3\nG4 P0.1\nM2\n";
    let mut interpreter = Interpreter::new(program.as_bytes(), settings([true; SPINDLES]));
    let restart = interpreter.start_at(6).expect("a restart");
    let expected = ["0 cw 100", "1 ccw 200", "3 cw 30 m/min to 900"];
    assert_eq!(spindles(&restart.actions), expected);
    for text in ["G95 $2", "S100 M3", "S200 M4 $1", "S30 G96 D900 M3 $3"] {
        assert!(restart.modes.contains(text), "{text}: {}", restart.modes);
    }
}

/// A program of lines with `$`, except those whose difference SPECNOTES lists.
fn random_program(random: &mut Random) -> String {
    let per_revolution = random.below(5) < 2;
    let mut text = "G21 G90\n".to_owned();
    for x in 1..=5 + random.below(21) {
        let speed = *random.one_of(&[0, 50, 120, 333, 900]);
        let named = named_spindle(random);
        let or_all_spindles = if random.below(7) == 0 {
            " $-1".to_owned()
        } else {
            named.clone()
        };
        let line = match random.below(16) {
            0..5 => format!("S{speed} M{}{or_all_spindles}", random.one_of(&[3, 3, 4, 5])),
            5 => format!("M{}{or_all_spindles}", random.one_of(&[3, 4, 5])),
            6 => format!("S{speed}{or_all_spindles}"),
            // rs274 assumes every spindle stopped after it.
            7 => format!("M19 R{}{named}\nM3 $-1", random.one_of(&[0, 90, 270])),
            8 => format!("G33 Z-{x} K{}{named}", random.one_of(&[1.0, 0.5])),
            9 => format!("G33.1 Z-{x} K1{named}"),
            10 if per_revolution => {
                format!("G95 F0.{} S{speed}{named}\nG1 X{x}", 1 + random.below(9))
            }
            10 => format!("G96 S{} D{}{named}", speed + 1, random.one_of(&[500, 2000])),
            11 if !per_revolution => format!("G97 S{speed}{named}"),
            // rs274 rejects $0 here.
            12 if named != " $0" => format!("M51 P{}{named}", random.below(2)),
            13 => format!("T{} M6", 1 + random.below(9)),
            14 if !per_revolution => {
                let speed = speed + 1;
                format!("G94 F100\nS{speed} M3{named}\nG84 X{x} Z-2 R1 S{speed}{named}\nG80")
            }
            15 => match random.below(4) {
                0 => format!("G4 P0.1{named}"),
                1 => format!("G94 F100\nG1 X{x}"),
                2 => format!("G76 P1 Z-{} I-1 J0.5 K1 R1 Q29 H0 E0 L0{named}", 40 + x),
                _ if !per_revolution => "M70\nS7 M3\nM72".to_owned(),
                _ => "M9".to_owned(),
            },
            _ => continue,
        };
        let _ = writeln!(text, "{line}");
    }
    text + "M2\n"
}

fn named_spindle(random: &mut Random) -> String {
    if random.below(5) == 0 {
        return String::new();
    }
    if random.below(40) == 0 {
        return format!(" ${}", random.one_of(&[-1, 4, -2]));
    }
    format!(" ${}", random.below(4))
}

#[test]
fn random_spindle_programs_match_linuxcnc() {
    let Some(folder) = rs274::linuxcnc() else { return };
    let mut random = Random::from_state(seed(seed_of_time()));
    let folder_of_programs = tempfile::tempdir().expect("a folder");
    let mut programs = Vec::new();
    for number in 0..cases(300) {
        let file = folder_of_programs.path().join(format!("{number}.ngc"));
        std::fs::write(&file, random_program(&mut random)).expect("a file");
        programs.push(file);
    }
    rs274::assert_equal(&folder, &[], &programs);
}

/// X of the last move.
fn last_x(program: &str) -> f64 {
    let end = run(program).into_iter().rev().find_map(|action| match action {
        Action::Move(motion) => Some(motion.curve.end()[0]),
        _ => None,
    });
    end.expect("a move")
}

#[test]
fn spindle_parameters_follow_the_thread_spindle() {
    let of = |lines: &str, name: &str| last_x(&format!("{lines}\nG0 X[#<{name}> + 1000]\nM2\n")) - 1000.0;
    let begun = "G97 S300 M4\nG97 S500 $1\nM3 $1";
    assert_eq!(of(begun, "_rpm"), 500.0);
    assert_eq!(of(begun, "_spindle_cw"), 1.0);
    // S and M3 do not select it.
    assert_eq!(of(&format!("{begun}\nS700 $2"), "_rpm"), 500.0);
    assert_eq!(of(&format!("{begun}\nG97"), "_rpm"), 300.0);
    assert_eq!(of(&format!("{begun}\nG97"), "_spindle_cw"), 0.0);
    assert_eq!(of("S400 M3", "_rpm"), 400.0);
    assert_eq!(of("M51 P0 $1\nG97 $1", "_speed_override"), 0.0);
    assert_eq!(of("M51 P0 $1", "_speed_override"), 1.0);
}

#[test]
fn turning_cycles_use_the_named_or_last_spindle() {
    let cycles = |program: &str| -> Vec<(u32, f64)> {
        let mut settings = settings([true; SPINDLES]);
        (settings.features.lathe, settings.features.load_channel) = (true, true);
        let actions = Interpreter::new(program.as_bytes(), settings).map(|item| item.expect(program).action);
        let found = actions.filter_map(|action| match action {
            Action::Turning(cycle) => Some((cycle.spindle, cycle.spindle_rpm)),
            _ => None,
        });
        found.collect()
    };
    let begin = "G7 G18 G21 F100 S300 M3\nS500 M3 $1\nG0 X60 Z2\n";
    assert_eq!(cycles(&format!("{begin}G82 X50 Z-20 Q1 $1\nM2\n")), [(1, 500.0)]);
    assert_eq!(cycles(&format!("{begin}G82 X50 Z-20 Q1\nM2\n")), [(0, 300.0)]);
    assert_eq!(
        cycles(&format!(
            "{begin}G97 $1\nG82 X50 Z-20 Q1\nG82 X50 Z-20 Q1 $0\nM2\n"
        )),
        [(1, 500.0), (0, 300.0)]
    );
    let mut lathe = settings([true, false, false, false]);
    lathe.features.lathe = true;
    let wrong = begin.replace("S500 M3 $1\n", "") + "G82 X50 Z-20 D1 $1\nM2\n";
    let error = Interpreter::new(wrong.as_bytes(), lathe).find_map(Result::err);
    assert_eq!(error.map(|error| error.code), Some(Code::SpindleSelection));
}

#[test]
fn restart_orients_spindles() {
    let after = |lines: &str| {
        let text = format!("{lines}\nG0 X1\nM2\n");
        let mut interpreter = Interpreter::new(text.as_bytes(), settings([true; SPINDLES]));
        let line = lines.lines().count() as u32 + 1;
        let restart = interpreter.start_at(line).expect(lines);
        (spindles(&restart.actions), restart.modes)
    };
    let (actions, modes) = after("M3 S200\nM19 R90 P1\nM19 R30 Q5 $2");
    assert_eq!(actions, ["0 at 90", "2 at 30"]);
    assert!(
        modes.contains("M19 R90 P1") && modes.contains("M19 R30 $2"),
        "{modes}"
    );
    for lines in [
        "M19 R90\nM5",
        "M19 R90\nM3 S100\nM5",
        "M19 R90 $1\nS50 $1",
        "M19 R90\nS10 M4\nM5 $-1",
    ] {
        let (actions, modes) = after(lines);
        assert!(
            actions.iter().all(|action| !action.contains("at")),
            "{lines}: {actions:?}"
        );
        assert!(!modes.contains("M19"), "{lines}: {modes}");
    }
    // Modes are restored without turning the spindle again.
    assert_eq!(after("M70\nM19 R45\nM72").0, ["0 at 45"]);
}

#[test]
fn program_end_releases_a_spindle_from_its_angle() {
    assert_eq!(spindles(&run("M19 R90 $1\nG0 X1\nM2\n")), ["1 at 90", "1 stop 0"]);
}

//! Random programs: invalid ones never make the interpreter fail, and valid ones are interpreted exactly.
//!
//! Each test prints its seed when it fails; set `EVOLVENT_SEED` to repeat it.

use evolvent_gcode::{Action, Interpreter, ProgramLimits, Settings, StartOffsets};
use evolvent_path::Axes;
use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

fn seed() -> u64 {
    let given = std::env::var("EVOLVENT_SEED")
        .ok()
        .and_then(|text| text.parse().ok());
    given.unwrap_or_else(|| {
        let time = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        time.map_or(1, |time| time.as_nanos() as u64)
    })
}

fn runner(cases: u32, seed: u64) -> TestRunner {
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    let config = Config {
        cases,
        failure_persistence: None,
        ..Config::default()
    };
    TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &bytes))
}

/// Runs a program to its end: all output is finite and in order, and every error has a position.
fn survive(program: &[u8]) -> Result<usize, TestCaseError> {
    let mut moves = 0;
    let lines = program.iter().filter(|byte| **byte == b'\n').count() + 1;
    let settings = Settings {
        limits: ProgramLimits {
            max_line_bytes: 300,
            ..ProgramLimits::default()
        },
        ..Settings::default()
    };
    let mut position = settings.start;
    let mut last = 0;
    let mut count = 0_usize;
    for item in Interpreter::new(program, settings) {
        count += 1;
        prop_assert!(count <= 20 * lines, "no end");
        match item {
            Ok(command) => {
                prop_assert!(command.line >= last && command.line as usize <= lines);
                last = command.line;
                match command.action {
                    Action::Move(step) => {
                        prop_assert_eq!(step.curve.start(), position);
                        position = step.curve.end();
                        moves += 1;
                        prop_assert!(position.iter().all(|value| value.is_finite()));
                        prop_assert!(step.feed_mm_s > 0.0 && step.curve.length() > 0.0);
                        let middle = step.curve.jet(step.curve.domain() / 2.0);
                        prop_assert!(middle.position.iter().all(|value| value.is_finite()));
                    }
                    Action::Dwell { seconds } => prop_assert!(seconds >= 0.0 && seconds.is_finite()),
                    Action::Spindle { speed_rpm, .. } => {
                        prop_assert!(speed_rpm >= 0.0 && speed_rpm.is_finite());
                    }
                    _ => {}
                }
            }
            Err(error) => {
                prop_assert!(error.line >= 1 && error.line as usize <= lines && error.column >= 1);
                prop_assert!(error.source.get(error.span.clone()).is_some());
                prop_assert!(!error.render("x").is_empty());
                last = last.max(error.line);
            }
        }
    }
    Ok(moves)
}

#[test]
fn arbitrary_bytes_terminate_without_panic() {
    let seed = seed();
    println!("EVOLVENT_SEED={seed}");
    runner(2000, seed)
        .run(&proptest::collection::vec(any::<u8>(), 0..600), |bytes| {
            survive(&bytes).map(drop)
        })
        .unwrap();
}

/// Random mixtures of pieces of real programs.
fn soup() -> impl Strategy<Value = String> {
    let codes = [
        "G0", "G1", "G2", "G3", "G2.2", "G3.2", "G4", "G17", "G18", "G19", "G20", "G21", "G53", "G54",
        "G59.3", "G61", "G61.1", "G64", "G80", "G90", "G91", "G90.1", "G91.1", "G92", "G92.1", "G92.2",
        "G92.3", "G93", "G94", "G95", "M0", "M3", "M5", "M6", "M7", "M9", "\n", "\n", "\n", "\n", "F100",
        "F1", "S100", "T1", "(MSG, a)", "(a)", ";", "/", "N10", "%", "O1", "#1", "[1]", "E5", "\r\n", "P1",
        "P2", " ", ".", "-",
    ];
    let word = (
        proptest::sample::select(b"XYZABCUVWIJKRPQFS".to_vec()),
        prop_oneof![
            (-5..5_i32).prop_map(|value| value.to_string()),
            (-50.0..50.0_f64).prop_map(|value| format!("{value:.3}")),
            (-1e9..1e9_f64).prop_map(|value| format!("{value}")),
        ],
    )
        .prop_map(|(letter, value)| format!("{}{value}", char::from(letter)));
    let code = proptest::sample::select(codes.to_vec()).prop_map(String::from);
    let piece = prop_oneof![3 => Just(String::from("\n")), 3 => word, 4 => code.clone()];
    let random_words = proptest::collection::vec(piece, 0..8).prop_map(|pieces| pieces.concat());
    let motion = proptest::sample::select(vec![
        "", "", "G0", "G1", "G1 F9", "G2", "G3", "G2.2", "G91 G3", "G53 G0",
    ]);
    let words = proptest::sample::subsequence(vec!["X", "Y", "Z", "A", "U", "I", "J", "R"], 1..4);
    let moved =
        (motion, words, proptest::array::uniform3(-20..20_i32)).prop_map(|(motion, words, values)| {
            let words: String = words
                .iter()
                .zip(values)
                .map(|(word, value)| format!(" {word}{value}"))
                .collect();
            format!("{motion}{words}")
        });
    let line = prop_oneof![6 => moved, 2 => code, 2 => random_words];
    proptest::collection::vec(line, 0..40).prop_map(|lines| format!("G21 F100 S9\n{}", lines.join("\n")))
}

#[test]
fn random_words_never_panic_and_moves_are_contiguous() {
    let moves = std::cell::Cell::new(0);
    let seed = seed();
    println!("EVOLVENT_SEED={seed}");
    runner(3000, seed)
        .run(&soup(), |program| {
            moves.set(moves.get() + survive(program.as_bytes())?);
            Ok(())
        })
        .unwrap();
    // The mixture is useful only if part of it is valid.
    assert!(moves.get() > 3000, "only {} moves", moves.get());
}

/// One move of a random but valid program.
#[derive(Clone, Debug)]
struct Step {
    incremental: bool,
    inches: bool,
    offset: usize,
    machine: bool,
    /// In thousandths of a program unit, so that the text represents the number exactly.
    words: [Option<i32>; 9],
    blanks: bool,
    lower: bool,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let word = proptest::option::weighted(0.4, -200_000..200_000_i32);
    let step = (
        any::<bool>(),
        any::<bool>(),
        0..9_usize,
        proptest::bool::weighted(0.2),
        proptest::array::uniform9(word),
        any::<bool>(),
        any::<bool>(),
    )
        .prop_map(
            |(incremental, inches, offset, machine, words, blanks, lower)| Step {
                incremental: incremental && !machine,
                inches,
                offset,
                machine,
                words,
                blanks,
                lower,
            },
        );
    proptest::collection::vec(step, 1..40)
}

fn write(step: &Step) -> String {
    let offset = ["54", "55", "56", "57", "58", "59", "59.1", "59.2", "59.3"][step.offset];
    let mut line = format!(
        "G{} G{} G{offset} ",
        if step.incremental { 91 } else { 90 },
        if step.inches { 20 } else { 21 }
    );
    if step.machine {
        line += "G53 ";
    }
    for (letter, word) in "XYZABCUVW".chars().zip(step.words) {
        if let Some(word) = word {
            line += &format!(
                "{letter}{}{}.{:03} ",
                if word < 0 { "-" } else { "" },
                word.abs() / 1000,
                word.abs() % 1000
            );
        }
    }
    line += if step.machine && step.words == [None; 9] {
        "G1 X0"
    } else {
        "G1"
    };
    if step.blanks {
        line = line.chars().flat_map(|character| [character, ' ']).collect();
    }
    if step.lower { line.to_lowercase() } else { line }
}

#[test]
fn positions_match_an_independent_computation() {
    let offsets: [Axes; 9] =
        std::array::from_fn(|index| Axes::from_fn(|axis, _| (index * 10 + axis) as f64 * 0.5 - 7.0));
    let seed = seed();
    println!("EVOLVENT_SEED={seed}");
    runner(500, seed)
        .run(&steps(), |steps| {
            let mut program = String::from("G21 F1000\n");
            let mut expected = Vec::new();
            let mut position = [0.0_f64; 9];
            for step in &steps {
                program += &write(step);
                program.push('\n');
                let before = position;
                for axis in 0..9 {
                    let word = match step.words[axis] {
                        Some(word) => word,
                        None if axis == 0 && step.machine && step.words == [None; 9] => 0,
                        None => continue,
                    };
                    let rotary = (3..6).contains(&axis);
                    let scale = if step.inches && !rotary { 25.4 } else { 1.0 };
                    let value = f64::from(word) / 1000.0 * scale;
                    position[axis] = if step.machine {
                        value
                    } else if step.incremental {
                        position[axis] + value
                    } else {
                        offsets[step.offset][axis] + value
                    };
                }
                if position != before {
                    expected.push(position);
                }
            }
            let settings = Settings {
                offsets: StartOffsets {
                    work: offsets,
                    ..StartOffsets::default()
                },
                ..Settings::default()
            };
            let mut found = Vec::new();
            for item in Interpreter::new(program.as_bytes(), settings) {
                let command = item.map_err(|error| TestCaseError::fail(error.render("random")))?;
                if let Action::Move(step) = command.action {
                    found.push(step.curve.end());
                }
            }
            prop_assert_eq!(found.len(), expected.len());
            for (found, expected) in found.iter().zip(&expected) {
                for axis in 0..9 {
                    prop_assert!(
                        (found[axis] - expected[axis]).abs() <= 1e-9,
                        "{} {}",
                        found[axis],
                        expected[axis]
                    );
                }
            }
            Ok(())
        })
        .unwrap();
}

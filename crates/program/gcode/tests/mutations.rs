//! Real programs with random damage: the interpreter neither panics nor hangs, and its output is always
//! valid.
//!
//! The corpus consists of the programs of `tests/programs`. The seed is printed; `EVOLVENT_SEED` and
//! `EVOLVENT_CASES` select another run and its length: `EVOLVENT_CASES=10000000 cargo test --release -p
//! evolvent-gcode --test all mutations`.

use evolvent_gcode::{Action, Interpreter, MachineFeatures, ProgramLimits, Settings, ToolTable};
use evolvent_random::{Random, cases, seed, seed_of_time};

/// Fragments of programs, to be inserted anywhere.
const DICTIONARY: &[&str] = &[
    "G0",
    "G1 ",
    "G2",
    "G3 ",
    "G2.2",
    "G3.2",
    "G4",
    "G5",
    "G5.1",
    "G5.2",
    "G5.3",
    "G7",
    "G8",
    "G10 L2 P1",
    "G10 L20 P2",
    "G10 L1 P1",
    "G12.2",
    "G13.2 D20 Q2 R1 Z-3",
    "G17",
    "G18",
    "G19",
    "G17.1",
    "G20",
    "G21",
    "G28",
    "G28.1",
    "G30",
    "G33",
    "G33.1",
    "G38.2",
    "G40",
    "G41",
    "G42",
    "G41.1 D2",
    "G42.1 D-3",
    "G43 H1",
    "G43.1",
    "G49",
    "G52",
    "G53",
    "G55",
    "G59.3",
    "G61",
    "G64 P.1",
    "G70 Q10 X20 Z1 P2",
    "G71 Q10 X20 Z1 D.3 I2",
    "G71.2 Q1",
    "G72 Q10 X30 Z4",
    "G73",
    "G75 X1 Z-9 K2",
    "G82 X9 Z-9 D1 H.1 R20 L-12 Q1",
    "G92.1 G92 X1",
    "G76",
    "G80",
    "G81",
    "G83",
    "G84",
    "G87",
    "G90",
    "G90.1",
    "G91",
    "G91.1",
    "G92",
    "G92.1",
    "G92.2",
    "G92.3",
    "G93",
    "G94",
    "G95",
    "G96",
    "G97",
    "G98",
    "G99",
    "M0",
    "M2",
    "M3",
    "M5",
    "M6",
    "M9",
    "M19 R5",
    "M61 Q1",
    "M62 P1",
    "M66 P1",
    "M70",
    "M72",
    "M73",
    "M98 P1",
    "M99",
    "M101",
    "O1 sub",
    "O1 endsub",
    "O1 call [1]",
    "O1 return [#1]",
    "O1 if [#1 LT 3]",
    "O1 elseif [0]",
    "O1 else",
    "O1 endif",
    "O1 while [#1 LT 4]",
    "O1 endwhile",
    "O1 do",
    "O1 repeat [3]",
    "O1 endrepeat",
    "O1 break",
    "O1 continue",
    "O<a b> sub",
    "O#1 call",
    "#1=[#1+1]",
    "#<a>=2",
    "#<_b>=#1",
    "#5221=3",
    "##1",
    "#[1+2]",
    "EXISTS[#<a>]",
    "SIN[30]",
    "ATAN[1]/[2]",
    " MOD ",
    "**",
    "[",
    "]",
    "(DEBUG, #1 #<a>)",
    "(PRINT,%.3f#2)",
    "(LOGOPEN,x)",
    "(ABORT,no)",
    "(",
    ")",
    ";",
    "%",
    "/",
    "@5",
    "^30",
    "$0",
    "-",
    "+",
    ".",
    "0",
    "1e9",
    "999999999",
    "0.0000001",
    "-1000000",
    "\n",
    "\r\n",
    " ",
    "F0",
    "F1e",
    "S",
    "T99999",
    "X",
    "Y-5",
    "Z.",
    "A1",
    "I",
    "J",
    "K1",
    "P",
    "Q1",
    "R-1",
    "L3",
    "H",
    "D",
    "E",
    "N",
    "\u{0}",
    "\u{e4}",
];

/// Damages a program at a few positions.
fn damage(program: &mut Vec<u8>, other: &[u8], random: &mut Random) {
    for _ in 0..=random.below(4) {
        let position = random.below(program.len() + 1);
        match random.below(9) {
            0 => {
                if let Some(byte) = program.get_mut(position) {
                    *byte ^= 1 << random.below(8);
                }
            }
            1 if position < program.len() => drop(program.remove(position)),
            2 => {
                let end = (position + random.below(30)).min(program.len());
                drop(program.drain(position..end));
            }
            3 => {
                // A piece of another program.
                let from = random.below(other.len());
                let to = (from + random.below(80)).min(other.len());
                drop(program.splice(position..position, other[from..to].iter().copied()));
            }
            4 => {
                // A line twice.
                let start = program[..position]
                    .iter()
                    .rposition(|byte| *byte == b'\n')
                    .map_or(0, |at| at + 1);
                let length = program[start..]
                    .iter()
                    .position(|byte| *byte == b'\n')
                    .unwrap_or(0);
                let line = program[start..(start + length + 1).min(program.len())].to_vec();
                drop(program.splice(start..start, line));
            }
            5 => {
                // Another digit.
                if let Some(byte) = program.get_mut(position)
                    && byte.is_ascii_digit()
                {
                    *byte = b'0' + random.below(10) as u8;
                }
            }
            _ => {
                let word = DICTIONARY[random.below(DICTIONARY.len())];
                drop(program.splice(position..position, word.bytes()));
            }
        }
    }
}

/// Runs a program; returns what is wrong with its output.
fn check(program: &[u8], settings: &Settings) -> Option<String> {
    let mut position = settings.start;
    let mut moves = 0;
    for item in Interpreter::new(program, settings.clone()).take(3000) {
        match item {
            Ok(command) => {
                let curve = match &command.action {
                    Action::Move(step) => {
                        if step.feed_mm_s.is_nan() || step.feed_mm_s <= 0.0 {
                            return Some(format!("line {}: a feed of {}", command.line, step.feed_mm_s));
                        }
                        &step.curve
                    }
                    Action::Thread { curve, pitch_mm, .. } if *pitch_mm > 0.0 => curve,
                    Action::Probe { curve, .. } => curve,
                    Action::Dwell { seconds } if seconds.is_nan() || *seconds < 0.0 => {
                        return Some("a negative dwell".to_owned());
                    }
                    _ => continue,
                };
                moves += 1;
                if curve.start() != position {
                    return Some(format!(
                        "line {}: a move begins at {} where the last one ended at {}",
                        command.line,
                        curve.start().transpose(),
                        position.transpose()
                    ));
                }
                position = curve.end();
                let middle = curve.jet(0.5 * curve.domain());
                let is_valid = curve.length() > 0.0
                    && position
                        .iter()
                        .chain(middle.position.iter())
                        .all(|value| value.is_finite());
                if !is_valid {
                    return Some(format!("line {}: a curve that is none", command.line));
                }
            }
            Err(error) => {
                if error.source.get(error.span.clone()).is_none() || error.line == 0 {
                    return Some(format!("an error without a place: {error}"));
                }
                if error.render("x").is_empty() {
                    return Some("an error without a text".to_owned());
                }
            }
        }
    }
    (moves > 1_000_000).then(|| "too many moves".to_owned())
}

#[test]
fn damaged_programs_neither_panic_nor_hang() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/programs");
    let mut corpus: Vec<_> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "ngc"))
        .collect();
    corpus.sort();
    let corpus: Vec<Vec<u8>> = corpus.iter().map(|path| std::fs::read(path).unwrap()).collect();
    let tools = ToolTable::parse(&std::fs::read_to_string(folder.join("tools.tbl")).unwrap()).unwrap();
    let settings = Settings {
        tools: Some(tools),
        features: MachineFeatures {
            user_codes: (100..200).collect(),
            ..MachineFeatures::default()
        },
        limits: ProgramLimits {
            max_silent_lines: 3000,
            max_body_bytes: 100_000,
            max_call_depth: 20,
            ..ProgramLimits::default()
        },
        ..Settings::default()
    };
    let lathe = Settings {
        features: MachineFeatures {
            lathe: true,
            load_channel: true,
            ..settings.clone().features
        },
        ..settings.clone()
    };
    let (seed, cases) = (seed(seed_of_time()), cases(8000) as u64);
    for case in 0..cases {
        // Each case has its own seed, so that it can be run alone.
        let mut random = Random::mixed(seed.wrapping_add(case));
        let mut program = corpus[random.below(corpus.len())].clone();
        let other = &corpus[random.below(corpus.len())];
        damage(&mut program, other, &mut random);
        // Every fourth machine is a lathe.
        let settings = if case % 4 == 0 { &lathe } else { &settings };
        let found = std::panic::catch_unwind(|| check(&program, settings));
        let shown = || {
            format!(
                "case {case} of EVOLVENT_SEED={seed}:\n{}",
                String::from_utf8_lossy(&program)
            )
        };
        match found {
            Ok(None) => {}
            Ok(Some(text)) => panic!("{text}\n{}", shown()),
            Err(_) => panic!("the interpreter panicked\n{}", shown()),
        }
    }
}

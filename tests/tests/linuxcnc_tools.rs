//! Tools and pockets as in LinuxCNC's own tests: their blocks and expected values are read from its source
//! package if `tools/get-linuxcnc` has fetched it, and executed here.
#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail as tests do, and say what they left out"
)]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use evolvent_gcode::{Action, Interpreter, MachineFeatures, Settings, ToolChanger, ToolTable};

/// The folder of the LinuxCNC package.
fn linuxcnc() -> Option<PathBuf> {
    let folder = std::env::var_os("EVOLVENT_LINUXCNC").map(PathBuf::from);
    if folder.is_none() {
        println!("not measured: no EVOLVENT_LINUXCNC (run tools/test on Debian)");
    }
    folder
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The blocks of one operator, each in the state left by the accepted ones before it.
struct Blocks {
    _folder: tempfile::TempDir,
    settings: Settings,
    accepted: String,
}

impl Blocks {
    /// A machine with a tool changer. The tables and programs of LinuxCNC are in the unit of their machine;
    /// here that is the millimetre.
    fn new(table: &str, is_random: bool, change: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("toolchange.ngc"), change).expect("a file");
        let tools = ToolTable::parse(table).expect("a table of LinuxCNC");
        // Pocket 0 of a random magazine is the spindle.
        let in_spindle = tools.tools().iter().find(|tool| is_random && tool.pocket == 0);
        let settings = Settings {
            subroutine_folders: vec![folder.path().to_path_buf()],
            tool: in_spindle.map_or(0, |tool| tool.number),
            tools: Some(tools),
            features: MachineFeatures {
                tool_change: Some(ToolChanger {
                    subroutine: "toolchange".to_owned(),
                    is_random,
                }),
                ..MachineFeatures::default()
            },
            ..Settings::default()
        };
        Self {
            _folder: folder,
            settings,
            accepted: "G21 G90\n".to_owned(),
        }
    }

    /// The last text that a program prints, or its error.
    fn run(&self, block: &str) -> Result<String, String> {
        let program = format!("{}{block}\n", self.accepted);
        let mut last = String::new();
        for item in Interpreter::new(program.as_bytes(), self.settings.clone()) {
            match item {
                Ok(command) => {
                    if let Action::Print(text) = command.action {
                        last = text;
                    }
                }
                Err(error) => return Err(error.to_string()),
            }
        }
        Ok(last)
    }

    /// Executes a block; returns whether it was accepted. A rejected one has no effect.
    fn executes(&mut self, block: &str) -> bool {
        let is_accepted = self.run(block).is_ok();
        if is_accepted {
            self.accepted.push_str(block);
            self.accepted.push('\n');
        }
        is_accepted
    }

    fn value(&self, parameter: &str) -> f64 {
        let printed = self.run(&format!("(PRINT,{parameter})")).expect("a parameter");
        printed.trim().parse().expect("a number")
    }
}

/// A line `NAME = VALUE` of the files with expected values.
fn expected_values(text: &str) -> Vec<(f64, Vec<f64>)> {
    let blocks = text.split("\n\n").filter(|block| !block.trim().is_empty());
    let numbers = |line: &str| -> f64 {
        let number = line.rsplit(' ').next().unwrap_or_default();
        number.parse().unwrap_or_else(|_| panic!("{line:?}"))
    };
    let values = blocks.map(|block| {
        let all: Vec<f64> = block.lines().map(numbers).collect();
        (all[0], all[1..].to_vec())
    });
    values.collect()
}

/// A test of LinuxCNC that prints X, Y, Z, #5400 and #5403 between blocks of MDI. `answers` replaces blocks
/// with known differences.
fn compare_script(
    script: &str,
    expected: &str,
    blocks: &mut Blocks,
    answers: impl Fn(&str) -> Option<&'static str>,
) -> usize {
    let mut expected = expected_values(expected).into_iter();
    let mut compared = 0;
    let mut history = String::new();
    for line in script.lines().map(str::trim) {
        let block = line.strip_prefix("echo set mdi ").or_else(|| {
            let quoted = line.strip_prefix("echo 'set mdi ")?.strip_suffix('\'')?;
            (!quoted.starts_with("m100")).then_some(quoted)
        });
        if let Some(block) = block {
            let is_accepted = blocks.executes(answers(block).unwrap_or(block));
            let _written = writeln!(history, "{block}: {is_accepted}");
            continue;
        }
        let Some(number) = line.strip_prefix("introspect ") else {
            continue;
        };
        let number: f64 = number.trim().parse().expect("a sequence number");
        let (at, values) = expected.next().expect("as many expected values as looks");
        assert_eq!(at, number, "the script and its values are of two versions");
        let names = ["#5420", "#5421", "#5422", "#5400", "#5403"];
        for (name, value) in names.into_iter().zip(&values) {
            let found = blocks.value(name);
            // An unknown tool in a random magazine is -1 there, and 0 (none) here.
            let value = if name == "#5400" { value.max(0.0) } else { *value };
            assert!(
                (found - value).abs() < 2e-6,
                "{number}: {name} is {found}, in LinuxCNC {value}, after\n{history}"
            );
            compared += 1;
        }
    }
    assert_eq!(expected.next(), None, "values without a look");
    compared
}

/// G43, G43 H and G10 L1, L10 and L11 with an empty spindle, with a tool and with T0, in both magazines.
#[test]
fn tool_lengths_match_linuxcnc() {
    let Some(folder) = linuxcnc() else { return };
    let tests = folder.join("tests/t0");
    let script = read(&tests.join("shared-test.sh"));
    // H0 is the tool in the spindle here, with both magazines. With a random magazine LinuxCNC uses the
    // length of T0, which is 0; without a T0 in the table it reports an error.
    let own = |_: &str| None;
    let zero = |block: &str| (block == "g43 h0").then_some("g49");
    // A spindle that was empty has left T0 in the pocket of T50 here, so T0 can be fetched although the table
    // initially had none.
    let refused = |block: &str| ["g43 h0", "t0 m6"].contains(&block).then_some("G9999");
    let mut compared = 0;
    for (name, is_random) in [
        ("nonrandom", false),
        ("random-with-t0", true),
        ("random-without-t0", true),
    ] {
        let table = read(&tests.join(name).join("tool.tbl.original"));
        let expected = read(&tests.join(name).join("expected-gcode-output"));
        let mut blocks = Blocks::new(&table, is_random, "G53 G0 Z0\n");
        println!("{name}");
        compared += match name {
            "nonrandom" => compare_script(&script, &expected, &mut blocks, own),
            "random-with-t0" => compare_script(&script, &expected, &mut blocks, zero),
            _ => compare_script(&script, &expected, &mut blocks, refused),
        };
    }
    assert!(compared >= 900, "{compared} values");
}

/// Tool numbers that differ from their pocket numbers, with lengths measured by G10 L10 in between.
#[test]
fn tools_in_other_pockets_match_linuxcnc() {
    let Some(folder) = linuxcnc() else { return };
    let tests = folder.join("tests/toolchanger");
    let script = read(&tests.join("toolno-pocket-differ/shared-test.sh"));
    let table = read(&tests.join("simpockets.tbl.original"));
    let mut compared = 0;
    for (name, is_random) in [("nonrandom", false), ("random", true)] {
        println!("{name}");
        let expected = read(&tests.join(format!("toolno-pocket-differ/{name}/expected-gcode-output")));
        // TOOL_CHANGE_POSITION of its configuration.
        let mut blocks = Blocks::new(&table, is_random, "G90 G53 G0 X0.111 Y0.222 Z0.333\n");
        compared += compare_script(&script, &expected, &mut blocks, |_| None);
    }
    assert!(compared >= 310, "{compared} values");
}

/// The text between quotes after a prefix of a line.
fn quoted<'a>(line: &'a str, prefix: &str) -> Option<&'a str> {
    let rest = line.strip_prefix(prefix)?;
    rest.split(['\'', '"']).nth(1)
}

#[test]
fn tool_parameters_after_m6_and_m61_match_linuxcnc() {
    let Some(folder) = linuxcnc() else { return };
    let tests = folder.join("tests/toolchanger");
    let script = read(&tests.join("m61/test-ui.py"));
    let table = read(&tests.join("simpockets.tbl.original"));
    let mut blocks = Blocks::new(&table, false, "G4 P0\n");
    let mut compared = 0;
    for line in script.lines() {
        if let Some(block) = quoted(line, "c.mdi(") {
            assert!(blocks.executes(block), "{block}: {:?}", blocks.run(block));
        }
        let Some(arguments) = line.strip_prefix("verify_interp_param(") else {
            continue;
        };
        let (arguments, _) = arguments.split_once(')').expect("arguments");
        let (number, value) = arguments.split_once(',').expect("two arguments");
        let value: f64 = value.trim().parse().expect("a number");
        let found = blocks.value(&format!("#{number}"));
        assert!(
            (found - value).abs() < 1e-9,
            "#{number} is {found}, in LinuxCNC {value}"
        );
        compared += 1;
    }
    assert!(compared >= 62, "{compared} values");
}

#[test]
fn named_tool_parameters_match_linuxcnc() {
    let Some(folder) = linuxcnc() else { return };
    let tests = folder.join("tests/tool-info");
    let mut compared = 0;
    for (name, is_random) in [
        ("non-random", false),
        ("random-no-startup-tool", true),
        ("random-with-startup-tool", true),
    ] {
        let own = tests.join(name).join("simpockets.tbl.original");
        let table = if own.exists() {
            own
        } else {
            tests.join("simpockets.tbl")
        };
        let mut blocks = Blocks::new(&read(&table), is_random, "G4 P0\n");
        for line in read(&tests.join(name).join("test-ui.py")).lines() {
            if let Some(block) = quoted(line, "c.mdi(").filter(|block| !block.starts_with('(')) {
                assert!(blocks.executes(block), "{block}: {:?}", blocks.run(block));
            }
            let Some((state, rest)) = line
                .strip_prefix("verify_interp_vars(state='")
                .and_then(|rest| rest.split_once('\''))
            else {
                continue;
            };
            for pair in rest.trim_matches([',', ' ', ')']).split(',') {
                let (word, value) = pair.trim().split_once('=').expect("an argument");
                let value: f64 = value.parse().expect("a number");
                let value = match (word, state) {
                    // Its documentation says -1 until a T word has been read, as here; its version 2.9 gives
                    // 0.
                    ("selected_tool", "init") => -1.0,
                    // An unknown tool is 0 (none) here.
                    ("current_tool", _) => value.max(0.0),
                    _ => value,
                };
                let found = blocks.value(&format!("#<_{word}>"));
                assert_eq!(found, value, "{name}: {word} {state}");
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 84);
}

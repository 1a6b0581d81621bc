//! The page's TypeScript matches the Rust types.

use std::path::Path;

use evolvent_control::{Alarm, AlarmKind};
use evolvent_screen::messages::{FromPage, RestartInfo, ToPage, TraceEntry, TraceJob};
use evolvent_wire::COMMANDS;
use ts_rs::{Config, TS};

/// `EVOLVENT_WRITE=1` regenerates them.
#[test]
fn the_generated_types_match() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("page/src/generated");
    let fresh = tempfile::tempdir().unwrap();
    let write = std::env::var_os("EVOLVENT_WRITE").is_some();
    let target = if write { folder.as_path() } else { fresh.path() };
    let config = Config::new().with_out_dir(target);
    ToPage::export_all(&config).unwrap();
    FromPage::export_all(&config).unwrap();
    TraceEntry::export_all(&config).unwrap();
    RestartInfo::export_all(&config).unwrap();
    TraceJob::export_all(&config).unwrap();
    write_numbers(target);
    write_commands(target);
    let list = |folder: &Path| {
        let mut files: Vec<(String, String)> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap())
            .map(|entry| {
                (
                    entry.file_name().into_string().unwrap(),
                    std::fs::read_to_string(entry.path()).unwrap(),
                )
            })
            .collect();
        files.sort();
        files
    };
    let made = list(target);
    assert!(made.len() > 8, "types were made");
    assert_eq!(made, list(&folder), "run this test with EVOLVENT_WRITE=1");
}

/// The page has a text for each number; a language without one does not compile.
fn write_numbers(folder: &Path) {
    for (name, what, is_rejection) in [
        (
            "AlarmNumber",
            "Alarms that are in force until they are cleared or a job starts.",
            false,
        ),
        (
            "RejectionNumber",
            "Why the core does not do what it is asked for.",
            true,
        ),
    ] {
        let numbers: Vec<String> = Alarm::ALL
            .iter()
            .filter(|alarm| (alarm.kind() == AlarmKind::Rejection) == is_rejection)
            .map(|alarm| alarm.number().to_string())
            .collect();
        let text = format!(
            "// This file is written by the test of the generated types.\n\n/** {what} */\nexport type {name} = {};\n",
            numbers.join(" | ")
        );
        assert!(std::fs::write(folder.join(format!("{name}.ts")), text).is_ok());
    }
}

/// The page has no number of a command of its own: a name without one does not compile.
fn write_commands(folder: &Path) {
    let lines: String = COMMANDS
        .iter()
        .map(|(name, number)| format!("  {}: {number},\n", name.to_lowercase()))
        .collect();
    let text = format!(
        "// This file is written by the test of the generated types.\n\n/** Commands by their numbers on the bus. */\nexport const COMMANDS = {{\n{lines}}} as const;\n"
    );
    assert!(std::fs::write(folder.join("Commands.ts"), text).is_ok());
}

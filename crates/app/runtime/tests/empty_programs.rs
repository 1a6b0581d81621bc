//! Checks of programs that do nothing.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::path::Path;

use evolvent_machine::Machine;
use evolvent_runtime::{CheckBounds, Setup, check};

/// The warnings about a program without errors.
fn warnings(program: &str) -> Vec<String> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let machine = Machine::parse(&text, "mill.toml").unwrap();
    let setup = Setup::new(machine, file, text, None).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part.ngc");
    std::fs::write(&path, program).unwrap();
    let found = check(&path, &setup, CheckBounds::whole(9)).unwrap();
    assert!(found.errors.is_empty(), "{:?}", found.errors);
    found
        .warnings
        .into_iter()
        .map(|warning| warning.message)
        .collect()
}

#[test]
fn a_program_without_a_block_is_warned_of() {
    for empty in ["", "\n \t\r\n", "%\n(part 7)\n; G0 X1\n%\n"] {
        let found = warnings(empty);
        assert!(
            found.len() == 1 && found[0].contains("contains no block"),
            "{empty:?}: {found:?}"
        );
    }
    for program in ["M2\n", "%\n(part 7) G21\n%\n", "#1=2\n", "; first\nG0 X1"] {
        assert_eq!(warnings(program), [] as [&str; 0], "{program:?}");
    }
}

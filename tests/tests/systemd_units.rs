//! The units for systemd: tight, and for any host. Needs `systemd-analyze`; without it the rating is "not measured".
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::PathBuf;
use std::process::Command;

use evolvent_tests::repository;

/// The worst rating that is permitted, in tenths.
const RATING: u32 = 30;

fn units() -> Vec<PathBuf> {
    let folder = repository().join("tools/systemd");
    let entries = std::fs::read_dir(folder).expect("the units");
    let units: Vec<PathBuf> = entries
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "service"))
        .collect();
    assert_eq!(units.len(), 2);
    units
}

#[test]
fn units_are_rated_as_safe_by_systemd() {
    for unit in units() {
        let analyzed = Command::new("systemd-analyze")
            .args(["security", "--offline=true"])
            .arg(format!("--threshold={RATING}"))
            .arg(&unit)
            .output();
        let Ok(analyzed) = analyzed else {
            println!("not measured: no systemd-analyze (apt-get install systemd)");
            return;
        };
        let said = String::from_utf8_lossy(&analyzed.stdout).into_owned();
        let rating = said.lines().last().unwrap_or_default();
        assert!(analyzed.status.success(), "{}: {rating}", unit.display());
    }
}

#[test]
fn units_name_no_core_that_a_host_may_not_have() {
    for unit in units() {
        let text = std::fs::read_to_string(&unit).expect("a unit");
        let names_core = text
            .lines()
            .any(|line| line.trim_start().starts_with("CPUAffinity="));
        assert!(!names_core, "{}", unit.display());
    }
}

//! LinuxCNC's own test and sample programs, in both interpreters.
//!
//! `tools/test` fetches them (`tools/get-linuxcnc`) and sets EVOLVENT_LINUXCNC to their folder.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use crate::rs274;

/// Folders whose programs need external configuration: remapped codes, panels, machines.
const CONFIGURED: [&str; 4] = ["remap", "gladevcp", "macros", "plasmac"];
/// A release has about 400; with far fewer, some were lost.
const MIN_PROGRAMS: usize = 300;

fn collect_programs(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in folder.read_dir().expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_symlink() {
            continue;
        }
        if path.is_dir() {
            collect_programs(&path, found);
        } else if path.extension().is_some_and(|end| end == "ngc" || end == "nc") {
            found.push(path);
        }
    }
}

#[test]
fn linuxcnc_programs_match_rs274() {
    let Some(folder) = rs274::linuxcnc() else { return };
    let mut programs = Vec::new();
    for part in ["tests", "nc_files"] {
        collect_programs(&folder.join(part), &mut programs);
    }
    programs.retain(|path| {
        let name = path.strip_prefix(&folder).expect("a file below the folder");
        !CONFIGURED
            .iter()
            .any(|word| name.to_string_lossy().contains(word))
    });
    programs.sort();
    assert!(programs.len() >= MIN_PROGRAMS, "only {} programs", programs.len());
    let [known, earlier] =
        ["linuxcnc-programs.known", "linuxcnc-programs.earlier"].map(|name| rs274::tools().join(name));
    let options = [
        OsStr::new("--own-tables"),
        OsStr::new("--known"),
        known.as_os_str(),
        OsStr::new("--earlier"),
        earlier.as_os_str(),
    ];
    rs274::assert_equal(&folder, &options, &programs);
}

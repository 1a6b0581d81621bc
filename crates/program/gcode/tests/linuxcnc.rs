//! LinuxCNC's own test and sample programs, in both interpreters.
//!
//! `tools/test` fetches them (`tools/get-linuxcnc`) and sets EVOLVENT_LINUXCNC to their folder.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::process::Command;

/// Folders whose programs need external configuration: remapped codes, panels, machines.
const CONFIGURED: [&str; 4] = ["remap", "gladevcp", "macros", "plasmac"];
/// A release has about 400; with far fewer, some were lost.
const FEWEST: usize = 300;

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
fn programs_of_linuxcnc_do_here_what_they_do_there() {
    let Some(folder) = std::env::var_os("EVOLVENT_LINUXCNC").map(PathBuf::from) else {
        println!("not measured: no EVOLVENT_LINUXCNC (run tools/test on Debian)");
        return;
    };
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
    assert!(programs.len() >= FEWEST, "only {} programs", programs.len());
    let tools = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tools");
    let canon = std::env::current_exe()
        .expect("a path")
        .with_file_name("../examples/canon");
    let output = Command::new("python3")
        .arg(tools.join("compare-rs274"))
        .args(["--own-tables", "--quiet", "--known"])
        .arg(tools.join("linuxcnc-programs.known"))
        .arg("--earlier")
        .arg(tools.join("linuxcnc-programs.earlier"))
        .arg("--canon")
        .arg(canon)
        .arg("--rs274")
        .arg(folder.join("rs274"))
        .args(programs)
        .output()
        .expect("python3");
    let text = String::from_utf8_lossy(&output.stdout);
    println!("{text}");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

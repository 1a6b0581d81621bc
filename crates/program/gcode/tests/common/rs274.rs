//! LinuxCNC's interpreter, with which programs are compared.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers of tests fail and talk as tests do"
)]

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The folder of LinuxCNC; without it, prints that nothing is measured.
pub(crate) fn linuxcnc() -> Option<PathBuf> {
    let folder = std::env::var_os("EVOLVENT_LINUXCNC").map(PathBuf::from);
    if folder.is_none() {
        println!("not measured: no EVOLVENT_LINUXCNC (run tools/test on Debian)");
    }
    folder
}

/// The folder `tools` of the repository.
pub(crate) fn tools() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tools")
}

/// Fails unless `tools/compare-rs274` with these options finds no difference between both interpreters.
pub(crate) fn assert_equal(folder: &Path, options: &[&OsStr], programs: &[PathBuf]) {
    let canon = std::env::current_exe()
        .expect("a path")
        .with_file_name("../examples/canon");
    let output = Command::new("python3")
        .arg(tools().join("compare-rs274"))
        .arg("--quiet")
        .args(options)
        .arg("--canon")
        .arg(canon)
        .arg("--rs274")
        .arg(folder.join("rs274"))
        .args(programs)
        .output()
        .expect("python3");
    println!("{}", String::from_utf8_lossy(&output.stdout));
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

//! A temporary folder with machine files and programs for one test.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

/// The folder of the repository.
#[must_use]
pub fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap_or(Path::new("."))
}

/// Every kind of curve, blends, exact path and a dwell in two seconds; begins and ends at zero in X and Y.
const SHORT: &str = "\
(lines, arcs, blends, a dwell and an involute)
G17 G21 G90 G94 G64 P0.01
M3 S1000
G0 X5 Y0
G1 X20 Y0 F6000
G3 X20 Y10 J5
G1 X0
G4 P0.1
G1 X-5 Y5 Z-1
G2 X-10 Y10 I-5
G61
G0 X0 Y0
G3.2 X0 Y-6.283185307179586 I-0.5 J0 R0.5
G64
G0 X5 Z2
G0 X0 Y0
M30
";

/// For a machine file: homing of Z and then X, with the switch positions of the simulated drives.
pub const HOMING: &str = "
[[homing]]
axis = \"Z\"
towards = \"negative\"
order = 0
search_mm_s = 100
latch_mm_s = 5
switch_mm = -390

[[homing]]
axis = \"X\"
towards = \"negative\"
order = 1
search_mm_s = 200
latch_mm_s = 5
switch_mm = -384
";

/// A folder that is removed on drop.
#[derive(Debug)]
pub struct Workshop(TempDir);

impl Workshop {
    /// An empty folder.
    ///
    /// # Panics
    /// If the system has no temporary folder.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "two of them are never equal")]
    pub fn new() -> Self {
        Self(
            tempfile::Builder::new()
                .prefix("evolvent-test-")
                .tempdir()
                .expect("a temporary folder"),
        )
    }

    /// The folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.0.path()
    }

    /// A path in it.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Names of all files in it, sorted.
    ///
    /// # Panics
    /// If the folder cannot be read.
    #[must_use]
    pub fn files(&self) -> Vec<String> {
        let entries = fs::read_dir(self.0.path()).expect("the folder");
        let mut names: Vec<_> = entries
            .flatten()
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    /// Writes a file in it.
    ///
    /// # Panics
    /// If it cannot be written.
    #[must_use]
    pub fn write(&self, name: &str, text: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, text).expect("a file in the temporary folder");
        path
    }

    /// A program of two seconds with lines, arcs, blends, a dwell and an involute.
    #[must_use]
    pub fn short_program(&self) -> PathBuf {
        self.write("short.ngc", SHORT)
    }

    /// A program that mills along a line for this number of seconds.
    #[must_use]
    pub fn long_program(&self, seconds: u32) -> PathBuf {
        let there_and_back = "G1 X100 Y50\nG1 X-100 Y-50\n".repeat(1 + seconds as usize / 4);
        self.write(
            "long.ngc",
            format!("G21 G90 G94 G61 F6000\n{there_and_back}M30\n"),
        )
    }

    /// The shipped three-axis mill with another name and pieces of its text replaced. It is never stopped for
    /// lateness, because tests run on busy machines.
    ///
    /// # Panics
    /// If a piece is not in the text.
    #[must_use]
    pub fn mill(&self, name: &str, changes: &[(&str, &str)]) -> PathBuf {
        let shipped = repository().join("config/machines/mill-3axis.toml");
        let mut text = fs::read_to_string(shipped).expect("the shipped mill");
        let own_name = format!("name = {name:?}");
        let usual = [
            ("name = \"mill-3axis\"", own_name.as_str()),
            ("# max_late_cycles = 1000", "max_late_cycles = 0"),
        ];
        for (old, new) in usual.iter().chain(changes) {
            assert!(text.contains(old), "{old} is not in the machine file");
            text = text.replace(old, new);
        }
        self.write(&format!("{name}.toml"), text)
    }
}

//! The binary under test.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;

use serde_json::Value;

use crate::repository;

/// A command that starts the binary in the folder of the repository, without standard input. The binary is
/// first brought up to date in the target folder and profile of the running test, unless the environment
/// variable `EVOLVENT_BINARY` names another one.
#[must_use]
pub fn evolvent() -> Command {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    let mut command = Command::new(BINARY.get_or_init(build));
    command.current_dir(repository()).stdin(Stdio::null());
    command
}

fn build() -> PathBuf {
    std::env::var_os("EVOLVENT_BINARY").map_or_else(|| build_program("evolvent"), Into::into)
}

/// Builds a program of this workspace in the profile of the tests and returns its path.
///
/// # Panics
/// If it cannot be built.
pub(crate) fn build_program(name: &str) -> PathBuf {
    build_targets(&["--bin", name]).join(name)
}

/// Builds targets of this workspace (arguments of `cargo build`) in the profile and the target folder of the
/// tests. Returns the folder of that profile.
///
/// # Panics
/// If they cannot be built.
pub(crate) fn build_targets(targets: &[&str]) -> PathBuf {
    let test = std::env::current_exe().expect("the path of this test");
    let profile_folder = test.ancestors().nth(2).expect("target/PROFILE/deps/TEST");
    let profile = match profile_folder.file_name().and_then(OsStr::to_str) {
        Some("debug") | None => "dev",
        Some(name) => name,
    };
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    // Variables of the package of the running test: build scripts that read them would run again, and what
    // depends on them would be compiled again.
    for (name, _) in std::env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_PKG_") || text.starts_with("CARGO_MANIFEST_") {
            cargo.env_remove(name);
        }
    }
    // The workspace with one of its tests: the same features of all dependencies as in
    // `cargo test --workspace`, so that nothing is compiled twice.
    let built = cargo
        .current_dir(repository())
        .args(["build", "--quiet", "--workspace", "--test", "runs"])
        .args(["--profile", profile])
        .args(targets)
        .arg("--target-dir")
        .arg(profile_folder.parent().unwrap_or(Path::new("target")))
        .output()
        .expect("cargo to start");
    assert!(
        built.status.success(),
        "{}",
        String::from_utf8_lossy(&built.stderr)
    );
    profile_folder.to_path_buf()
}

/// The result of a command.
#[derive(Clone, Debug)]
pub struct Finished {
    /// The exit code; `None` if a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub out: String,
    /// Standard error.
    pub err: String,
}

impl Finished {
    /// Standard output as the one JSON object that `--json` promises.
    ///
    /// # Panics
    /// If the output is anything else.
    #[must_use]
    pub fn json(&self) -> Value {
        let value: Value = serde_json::from_str(&self.out)
            .unwrap_or_else(|error| panic!("not one JSON value: {error}\n{}\n{}", self.out, self.err));
        assert!(value.is_object(), "not an object: {value}");
        value
    }

    /// Asserts the exit code; on failure it shows both outputs.
    ///
    /// # Panics
    /// If the exit code is another one.
    #[track_caller]
    pub fn expect_code(self, codes: &[i32]) -> Self {
        let fits = self.code.is_some_and(|code| codes.contains(&code));
        assert!(
            fits,
            "exit code {:?}, not {codes:?}\n{}\n{}",
            self.code, self.out, self.err
        );
        self
    }
}

impl From<Output> for Finished {
    fn from(output: Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self {
            code: output.status.code(),
            out: text(&output.stdout),
            err: text(&output.stderr),
        }
    }
}

/// Runs the binary to its end.
///
/// # Panics
/// It cannot be started.
pub fn run<I: IntoIterator<Item = S>, S: AsRef<OsStr>>(arguments: I) -> Finished {
    evolvent()
        .args(arguments)
        .output()
        .expect("the binary to start")
        .into()
}

/// Waits for the end of a process whose outputs are piped.
///
/// # Panics
/// Its end cannot be waited for.
#[must_use]
pub fn wait(child: Child) -> Finished {
    child.wait_with_output().expect("a process that ends").into()
}

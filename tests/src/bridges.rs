//! Bridges under test: the command of each, and the suite with several cases at once.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};

use serde_json::Value;

use crate::binary::build_targets;
use crate::{evolvent, repository};

/// Number of concurrent cases; each has its own bus.
const AT_ONCE: usize = 4;
/// Serialises the suites: they would slow each other down.
static ALONE: Mutex<()> = Mutex::new(());

/// Runs the conformance suite against a bridge (the simulated one if the command is empty), each case in its
/// own process. Returns the reports of the cases.
///
/// # Panics
/// If a case failed; with its reason.
pub fn hold_to_the_suite(options: &[&str], command: &[String]) -> Vec<Value> {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let list = evolvent()
        .args(["bridge", "test", "--list"])
        .output()
        .expect("the binary to start");
    let names: Vec<String> = String::from_utf8_lossy(&list.stdout)
        .lines()
        .filter_map(|line| line.split_whitespace().next().map(str::to_owned))
        .collect();
    assert!(names.len() >= 15, "{names:?}");
    let waiting = Mutex::new(names);
    let reports = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                loop {
                    let Some(name) = waiting.lock().expect("no panic").pop() else {
                        break;
                    };
                    let output = evolvent()
                        .args(["bridge", "test", "--json", "--moments", "2", "--only", &name])
                        .args(options)
                        .arg("--")
                        .args(command)
                        .stderr(Stdio::null())
                        .output()
                        .expect("the binary to start");
                    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
                    reports.lock().expect("no panic").push(report);
                }
            });
        }
    });
    let cases: Vec<Value> = reports
        .into_inner()
        .expect("no panic")
        .iter()
        .flat_map(|report| report["cases"].as_array().cloned().unwrap_or_default())
        .collect();
    for case in &cases {
        assert_ne!(case["verdict"], "failed", "{}: {}", case["case"], case["why"]);
        if case["verdict"] == "not measured" {
            println!("not measured: {}: {}", case["case"], case["why"]);
        }
    }
    cases
}

/// Compiles an example of `tools/examples` in C (`bridge` or `signals`) with the compiler of the system and
/// the library of this workspace. Returns the path of the program.
///
/// # Panics
/// If there is no compiler, or if it reports an error.
#[must_use]
pub fn c_example(name: &str, folder: &Path) -> PathBuf {
    let library = build_targets(&["--lib"]).join("libevolvent_bus_c.a");
    let program = folder.join(name);
    let compiled = Command::new("cc")
        .current_dir(repository())
        .args([
            "-std=gnu11",
            "-O2",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-Itools/include",
        ])
        .arg(format!("tools/examples/{name}.c"))
        .arg(library)
        .args(["-lpthread", "-ldl", "-lm", "-lrt", "-o"])
        .arg(&program)
        .output()
        .expect("a C compiler");
    assert!(
        compiled.status.success(),
        "{}",
        String::from_utf8_lossy(&compiled.stderr)
    );
    program
}

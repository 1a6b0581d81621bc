//! Names of public numbers: a number that could be in several units ends with its unit (ADR 67).
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::fs;
use std::path::{Path, PathBuf};

use evolvent_tests::repository;

/// Words for quantities that the project uses in several units.
const QUANTITIES: &[&str] = &[
    "angle",
    "delay",
    "depth",
    "diameter",
    "duration",
    "feed",
    "frequency",
    "period",
    "pitch",
    "radius",
    "speed",
    "time",
    "timeout",
];
/// Units, words for plain numbers, and the word for derivatives, which are per another number.
const UNITS: &[&str] = &[
    "deg",
    "error",
    "exponent",
    "factor",
    "fraction",
    "hz",
    "increments",
    "m",
    "min",
    "mm",
    "ms",
    "ns",
    "override",
    "per",
    "percent",
    "rad",
    "ratio",
    "rev",
    "rpm",
    "s",
    "turn",
    "turns",
    "u",
    "us",
];

fn sources(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            if path
                .file_name()
                .is_some_and(|name| name != "generated" && name != "tests")
            {
                sources(&path, into);
            }
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            into.push(path);
        }
    }
}

/// Names of the public `f64` fields, and of the `f64` parameters of public functions.
fn numbers(text: &str) -> Vec<&str> {
    let text = text.split("#[cfg(test)]").next().unwrap_or_default();
    let mut names = Vec::new();
    for item in text.lines().map(str::trim_start) {
        let Some(item) = item.strip_prefix("pub ") else {
            continue;
        };
        for part in item.split(['(', ',']) {
            if let Some((name, kind)) = part.trim().split_once(": ")
                && ["f64", "Option<f64", "[f64"]
                    .iter()
                    .any(|start| kind.starts_with(start))
            {
                names.push(name);
            }
        }
    }
    names
}

fn is_without_unit(name: &str) -> bool {
    let is_in = |list: &[&str]| name.split('_').any(|word| list.contains(&word));
    is_in(QUANTITIES) && !is_in(UNITS)
}

#[test]
fn public_numbers_name_their_unit() {
    let crates = repository().join("crates");
    let mut files = Vec::new();
    // The names of arguments and of messages of the screen are their interface.
    for folder in ["core", "program", "planning", "execution", "io", "process"] {
        for entry in fs::read_dir(crates.join(folder)).expect("a layer") {
            sources(&entry.expect("a crate").path().join("src"), &mut files);
        }
    }
    for name in ["analysis", "import", "inspect", "replay", "runtime"] {
        sources(&crates.join("app").join(name).join("src"), &mut files);
    }
    let (mut found, mut count) = (Vec::new(), 0);
    for file in files {
        let text = fs::read_to_string(&file).expect("a source");
        for name in numbers(&text) {
            count += 1;
            if is_without_unit(name) {
                found.push(format!("{}: {name}", file.display()));
            }
        }
    }
    assert!(count > 500, "{count} numbers");
    assert!(found.is_empty(), "without a unit:\n{}", found.join("\n"));
}

#[test]
fn a_number_without_unit_is_found() {
    let text = "pub struct Cut {\n    pub feed: f64,\n    pub depth_mm: f64,\n\
                }\n    pub fn go(&self, speed: f64, n: u32) {";
    let names = numbers(text);
    assert_eq!(names, ["feed", "depth_mm", "speed"]);
    let without: Vec<&str> = names.into_iter().filter(|name| is_without_unit(name)).collect();
    assert_eq!(without, ["feed", "speed"]);
}

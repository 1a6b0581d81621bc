//! For tests: shipped schemas are those of the code, and errors in files have their place.
//!
//! ```
//! use evolvent_file_tests::{assert_refused, edit};
//!
//! // A reader of files with one line `feed = NUMBER`.
//! let parse = |text: &str, file: &str| {
//!     let value = text.trim_end().strip_prefix("feed = ").unwrap_or_default();
//!     value.parse::<f64>().map_err(|error| format!("{file}:1:1: feed: {error}"))
//! };
//! assert_refused("feed = 200\n", &[edit("feed = 200", "feed = fast", "feed")], parse);
//! ```
#![allow(clippy::unwrap_used, clippy::panic, reason = "it fails as tests do")]

use std::path::{Path, PathBuf};

/// The folder of the files that ship.
#[must_use]
pub fn config() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config")
}

/// A file that ships: its text.
///
/// # Panics
/// Where it cannot be read.
#[must_use]
pub fn shipped(name: &str) -> String {
    let path = config().join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The schema that ships as `config/NAME` is this one; with `EVOLVENT_WRITE_SCHEMA` set it is written again.
///
/// # Panics
/// Where it is not. `package` tells whose tests write it.
pub fn assert_schema(name: &str, schema: &serde_json::Value, package: &str) {
    let path = config().join(name);
    let text = format!("{}\n", serde_json::to_string_pretty(schema).unwrap());
    if std::env::var_os("EVOLVENT_WRITE_SCHEMA").is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    assert!(
        std::fs::read_to_string(&path).unwrap_or_default() == text,
        "config/{name} is out of date: run EVOLVENT_WRITE_SCHEMA=1 cargo test -p {package} schema"
    );
}

/// A wrong edit of a good file.
#[derive(Clone, Copy, Debug)]
pub struct Edit<'a> {
    /// What stands in the good file, ...
    pub from: &'a str,
    /// ... and what it becomes.
    pub to: &'a str,
    /// Where the error is told: the first line of the good file that begins with this, ...
    pub line: &'a str,
    /// ... and the column, from 1.
    pub column: usize,
    /// What the error speaks of.
    pub key: &'a str,
}

/// An edit whose error is told at the beginning of the line that it changes.
#[must_use]
pub const fn edit<'a>(from: &'a str, to: &'a str, key: &'a str) -> Edit<'a> {
    Edit {
        from,
        to,
        line: from,
        column: 1,
        key,
    }
}

/// The good text is read, and each edit of it refused with file, line, column and key.
///
/// # Panics
/// Where one is not.
pub fn assert_refused<T, E: std::fmt::Display>(
    good: &str,
    edits: &[Edit<'_>],
    parse: impl Fn(&str, &str) -> Result<T, E>,
) {
    if let Err(error) = parse(good, "good.toml") {
        panic!("{error}");
    }
    for edit in edits {
        let Edit { from, to, .. } = edit;
        assert!(good.contains(from), "no {from:?} in the good file");
        let line = 1 + good
            .lines()
            .position(|line| line.starts_with(edit.line))
            .unwrap_or_else(|| panic!("no line that begins with {:?}", edit.line));
        let Err(error) = parse(&good.replacen(from, to, 1), "bad.toml") else {
            panic!("{to:?} was taken");
        };
        let error = error.to_string();
        let place = format!("bad.toml:{line}:{}:", edit.column);
        assert!(
            error.starts_with(&place) && error.contains(edit.key),
            "{to:?}: {error}\n  for {place} {}",
            edit.key
        );
    }
}

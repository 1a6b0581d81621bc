//! For tests: shipped schemas match the code, and errors in files have their position.
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

/// The folder of the shipped files.
#[must_use]
pub fn config() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config")
}

/// Reads the text of a shipped file.
///
/// # Panics
/// If it cannot be read.
#[must_use]
pub fn shipped(name: &str) -> String {
    let path = config().join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Asserts that the shipped schema `config/NAME` equals this one. With `EVOLVENT_WRITE_SCHEMA` set, it is
/// written again.
///
/// # Panics
/// If they differ. The message names `package`, whose tests write the schema.
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
    /// Text of the good file, ...
    pub from: &'a str,
    /// ... and its replacement.
    pub to: &'a str,
    /// Position of the error: the first line of the good file that begins with this, ...
    pub line: &'a str,
    /// ... and the column, from 1.
    pub column: usize,
    /// Key that the error names.
    pub key: &'a str,
}

/// An edit whose error is reported at the beginning of the changed line.
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

/// Asserts that the good text is accepted, and that each edit of it is refused with file, line, column and
/// key.
///
/// # Panics
/// If the good text is refused or an edit is not.
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
        let location = format!("bad.toml:{line}:{}:", edit.column);
        assert!(
            error.starts_with(&location) && error.contains(edit.key),
            "{to:?}: {error}\n  for {location} {}",
            edit.key
        );
    }
}

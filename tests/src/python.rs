//! Foreign clients in Python.

use std::process::{Command, Stdio};

use crate::repository;

/// A script of `tests/python`, ready to start. `None` if no Python is set up, which is printed.
#[must_use]
pub fn python(script: &str) -> Option<Command> {
    let Some(interpreter) = std::env::var_os("EVOLVENT_PYTHON") else {
        println!("skipped: run tools/test");
        return None;
    };
    let mut command = Command::new(interpreter);
    command
        .arg(repository().join("tests/python").join(script))
        .stdin(Stdio::null());
    Some(command)
}

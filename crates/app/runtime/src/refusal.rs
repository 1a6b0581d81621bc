//! The machine's objections to a line of a program, as diagnostics with a position.

use std::fmt::Display;
use std::io::{BufRead, BufReader};
use std::path::Path;

use evolvent_config::open_regular;
use evolvent_gcode::{CanonicalCommand, Code, Diagnostic};
use evolvent_planner::PlanError;

/// Why a program cannot run to its end.
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// The file cannot be read.
    #[error("{file}: {source}; name a readable part program")]
    Read {
        /// The file.
        file: String,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The text has an error.
    #[error("{}", .diagnostic.render(.file))]
    Text {
        /// The file.
        file: String,
        /// The error and its position.
        diagnostic: Box<Diagnostic>,
    },
}

/// A diagnostic about a command's line. `build` receives file and line, which are those of a subroutine if
/// the command comes from one. The diagnostic lists the calls that lead there.
pub(crate) fn at_origin(
    command: &CanonicalCommand,
    program: &Path,
    build: impl FnOnce(&Path, u32) -> Diagnostic,
) -> Diagnostic {
    let (file, line) = match &command.origin {
        Some(origin) => (Path::new(&*origin.file), origin.line),
        None => (program, command.line),
    };
    let mut diagnostic = build(file, line);
    diagnostic.file = command.origin.as_ref().map(|origin| Box::from(&*origin.file));
    diagnostic.calls = command.calls.innermost_first();
    diagnostic
}

/// A diagnostic about a line that cannot be carried out.
pub(crate) fn about_line(message: String, program: &Path, line: u32) -> Diagnostic {
    let text = line_text(program, line).unwrap_or_default();
    Diagnostic::about_line(Code::MissingAbility, line, &text, None, message)
}

/// The same with a remedy.
pub(crate) fn about_line_with(
    message: String,
    help: Option<String>,
    program: &Path,
    line: u32,
) -> Diagnostic {
    let mut diagnostic = about_line(message, program, line);
    diagnostic.help = help.map(String::into).or(diagnostic.help);
    diagnostic
}

/// A turning cycle that does not fit, with its position.
pub(crate) fn cannot_turn(what: String, program: &Path, line: u32) -> Diagnostic {
    let text = line_text(program, line).unwrap_or_default();
    Diagnostic::about_line(Code::MoveRefused, line, &text, Some('Q'), what)
}

/// A rejected move with its position.
pub(crate) fn explain<E: Display>(error: &PlanError<E>, program: &Path, line: u32) -> Diagnostic {
    let (code, letter) = match error {
        PlanError::Travel { axis, .. } => (Code::BeyondTravel, Some(axis.letter())),
        _ => (Code::MoveRefused, None),
    };
    // The planner lags behind the line that is being read.
    let line = match error {
        PlanError::NoMotion { line } if *line > 0 => *line,
        _ => line,
    };
    let text = line_text(program, line).unwrap_or_default();
    Diagnostic::about_line(code, line, &text, letter, error.to_string())
}

/// The text of one line of a file; empty if it does not exist.
fn line_text(program: &Path, line: u32) -> std::io::Result<Vec<u8>> {
    let mut reader = BufReader::new(open_regular(program)?);
    let mut bytes = Vec::new();
    for _ in 0..line {
        bytes.clear();
        if reader.read_until(b'\n', &mut bytes)? == 0 {
            break;
        }
    }
    Ok(bytes)
}

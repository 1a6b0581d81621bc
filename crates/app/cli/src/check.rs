//! `evolvent check`: lists the errors of a program, without moving anything.

use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;

use clap::Args;
use evolvent_analysis::{ChatterWarnings, chatter_warnings, sort_process_files};
use evolvent_runtime::{CheckBound, CheckBounds, Checked, Clock, Unchecked};

use crate::program::ProgramArgs;
use crate::{CommandError, Ending};

/// Options of `evolvent check`.
#[derive(Debug, Args)]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    program: ProgramArgs,
    /// Stop after this many errors.
    #[arg(long, value_name = "N", default_value_t = 50)]
    limit: usize,
    /// Check a loop, or a line that repeats a subroutine, up to this many commands; 0 for any number (an
    /// endless loop is then checked until Ctrl-C). Exit code 3 if that leaves a part of the program
    /// unchecked.
    #[arg(long, value_name = "COMMANDS", default_value_t = CheckBounds::LOOP_COMMANDS)]
    loop_limit: u64,
    /// The cutting process: a case file of `evolvent chatter` warns of turning cuts that are predicted to
    /// vibrate; a process file of `evolvent turn` lets cycles with Q1 compute their passes. At most one of
    /// each.
    #[arg(long, value_name = "FILE.toml")]
    process: Vec<PathBuf>,
    /// Print the errors as one JSON object, for editors.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(
    args: &CheckArgs,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let mut setup = args.program.setup()?;
    // The warnings of the check include folders that do not exist.
    crate::program::warn_of_values(&setup.machine, err);
    let case = sort_process_files(&mut setup, &args.process, Clock::Realtime)?;
    let start = args.program.tell_start(&setup, err);
    let file_name = args.program.program.display().to_string();
    let limit = args.limit.max(1);
    let mut bounds = CheckBounds::whole(limit);
    bounds.round = match args.loop_limit {
        0 => u64::MAX,
        commands => commands,
    };
    let found = evolvent_runtime::check(&args.program.program, &setup, bounds).map_err(|error| {
        CommandError::Usage(format!("{file_name}: {error}; give a readable part program"))
    })?;
    let chatter = match case {
        Some(case) => Some(chatter_warnings(&args.program.program, &setup, case, bounds)?),
        None => None,
    };
    if let Some(chatter) = chatter.as_ref().filter(|_| !args.json) {
        crate::chatter::write_warnings(chatter, err, &file_name);
    }
    let written = if args.json {
        writeln!(out, "{}", to_json(&file_name, &found, chatter.as_ref()))
    } else {
        write_text(err, &file_name, &found, io::stderr().is_terminal())
    };
    written.map_err(|error| CommandError::Failed(format!("the errors cannot be written: {error}")))?;
    Ok(if found.errors.is_empty() {
        // A program with errors cannot start in its middle either; that message would repeat them.
        start?;
        let is_partial = chatter.is_some_and(|chatter| !chatter.omissions().is_empty());
        if found.unchecked.is_some() || is_partial {
            Ending::Incomplete
        } else {
            Ending::Clean
        }
    } else {
        Ending::Negative
    })
}

/// Writes errors like a compiler, each with its source line, and a last line that counts them.
///
/// # Errors
/// `out` cannot be written.
pub(crate) fn write_text(
    out: &mut dyn Write,
    file_name: &str,
    found: &Checked,
    colours: bool,
) -> io::Result<()> {
    for diagnostic in &found.errors {
        let shown = if colours {
            diagnostic.render_styled(file_name)
        } else {
            diagnostic.render(file_name)
        };
        writeln!(out, "{shown}\n")?;
    }
    for warning in &found.warnings {
        let file = warning.file.as_deref().unwrap_or(file_name);
        writeln!(out, "warning: {file}:{}: {}\n", warning.line, warning.message)?;
    }
    let count = match found.errors.len() {
        0 => "no errors".to_owned(),
        1 => "1 error".to_owned(),
        count => format!("{count} errors"),
    };
    match &found.unchecked {
        None => writeln!(out, "{file_name}: {count}"),
        Some(Unchecked { up_to, bound }) => {
            write!(
                out,
                "{file_name}: {count} up to line {up_to}; the rest was not checked: {bound}"
            )?;
            match bound {
                CheckBound::Errors => writeln!(out),
                bound if bound.is_of_loops() => writeln!(
                    out,
                    "; `evolvent check --loop-limit COMMANDS` checks more of it, 0 all"
                ),
                _ => writeln!(out, "; `evolvent check` checks all"),
            }
        }
    }
}

/// The errors as one JSON value for editors: `{"file", "errors": [{"code", "line", "column", "length", "message",
/// "help", "source", "span", "calls"}], "warnings": [{"file", "line", "message"}], "up_to": line or null,
/// "unchecked": {"reason", "line", "file", "message"} or null, "chatter": [...], "chatter_omissions":
/// [...]}`.
fn to_json(file_name: &str, found: &Checked, chatter: Option<&ChatterWarnings>) -> serde_json::Value {
    serde_json::json!({
        "file": file_name,
        "errors": found.errors,
        "warnings": found.warnings,
        "up_to": found.unchecked.as_ref().map(|unchecked| unchecked.up_to),
        "unchecked": found.unchecked.as_ref().map(|unchecked| unchecked_json(&unchecked.bound)),
        "chatter": chatter.map_or(&[][..], ChatterWarnings::found),
        "chatter_omissions": chatter.map_or(&[][..], ChatterWarnings::omissions),
    })
}

/// The reason why a part of the program was not checked, with line and file of the loop that caused it.
pub(crate) fn unchecked_json(bound: &CheckBound) -> serde_json::Value {
    let (file, line) = match bound {
        CheckBound::Loop { start, .. } => (start.file.as_deref(), Some(start.line)),
        CheckBound::Line { line, .. } => (None, Some(*line)),
        CheckBound::Errors | CheckBound::Commands { .. } | CheckBound::Cancelled => (None, None),
    };
    serde_json::json!({
        "reason": bound.name(),
        "line": line,
        "file": file,
        "message": bound.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use evolvent_gcode::{Interpreter, Settings};

    use super::*;

    fn errors(program: &str) -> Checked {
        let errors = Interpreter::new(program.as_bytes(), Settings::default()).filter_map(Result::err);
        Checked {
            errors: errors.collect(),
            warnings: Vec::new(),
            unchecked: None,
        }
    }

    fn text(found: &Checked) -> String {
        let mut out = Vec::new();
        write_text(&mut out, "part.ngc", found, false).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn text_shows_place_and_count() {
        assert_eq!(text(&errors("G0 X1\nM2\n")), "part.ngc: no errors\n");
        let one = text(&errors("G0 X1\nG6\n"));
        assert!(
            one.contains("part.ngc:2:1") && one.ends_with("part.ngc: 1 error\n"),
            "{one}"
        );
        let two = text(&errors("G0 X1\nG6\nX?\nM2\n"));
        assert!(two.ends_with("part.ngc: 2 errors\n"), "{two}");
    }

    #[test]
    fn text_says_what_was_not_looked_at() {
        let bounded = Checked {
            unchecked: Some(Unchecked {
                up_to: 7,
                bound: CheckBound::Line {
                    line: 7,
                    commands: 1000,
                },
            }),
            ..errors("G0 X1\nM2\n")
        };
        let shown = text(&bounded);
        assert!(
            shown.contains("no errors up to line 7; ")
                && shown.contains("line 7 has more than 1000 commands; `evolvent check --loop-limit"),
            "{shown}"
        );
    }

    #[test]
    fn json_has_the_place_in_numbers() {
        let json = to_json("part.ngc", &errors("G0 X1 Q2\n"), None);
        assert_eq!(json["errors"][0]["code"], "G0307");
        assert_eq!(json["errors"][0]["line"], 1);
        assert_eq!(json["errors"][0]["column"], 7);
        assert!(json["up_to"].is_null() && json["unchecked"].is_null());
    }
}

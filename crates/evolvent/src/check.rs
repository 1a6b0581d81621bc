//! `evolvent check`: what is wrong with a program, without moving anything.

use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;

use clap::Args;
use evolvent_daemon::Clock;
use evolvent_gcode::Diagnostic;

use crate::chatter::{Warning, warnings};
use crate::process;
use crate::program::ProgramArgs;
use crate::{CommandError, Ending};

/// Options of `evolvent check`.
#[derive(Debug, Args)]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    program: ProgramArgs,
    /// Stop after so many errors.
    #[arg(long, value_name = "N", default_value_t = 50)]
    limit: usize,
    /// What the cut is like: a case file as of `evolvent chatter` warns of turning cuts that are predicted to vibrate; a file
    /// as of `evolvent turn` lets cycles with Q1 find their passes. Once each.
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
    let case = process::sort_out(&mut setup, &args.process, Clock::Realtime)?;
    let start = args.program.tell_start(&setup, err);
    let file_name = args.program.program.display().to_string();
    let limit = args.limit.max(1);
    let found = evolvent_daemon::check(&args.program.program, &setup, limit).map_err(|error| {
        CommandError::Usage(format!("{file_name}: {error}; name a readable part program"))
    })?;
    let chatter = match case {
        Some(case) => Some(warnings(&args.program.program, &setup, case)?),
        None => None,
    };
    if let Some(chatter) = chatter.as_ref().filter(|_| !args.json) {
        chatter.write(err, &file_name);
    }
    let written = if args.json {
        let chatter = chatter.as_ref().map_or(&[][..], |chatter| &chatter.found);
        writeln!(out, "{}", to_json(&file_name, &found, chatter))
    } else {
        write_text(err, &file_name, &found, limit, io::stderr().is_terminal())
    };
    written.map_err(|error| CommandError::Failed(format!("the errors cannot be written: {error}")))?;
    Ok(if found.is_empty() {
        // A wrong program cannot begin in its middle either; that would say the same again.
        start?;
        Ending::Clean
    } else {
        Ending::Negative
    })
}

/// Writes errors as a compiler would, each with its source line, and a last line that counts them.
///
/// # Errors
/// `out` cannot be written.
fn write_text(
    out: &mut dyn Write,
    file_name: &str,
    diagnostics: &[Diagnostic],
    limit: usize,
    colours: bool,
) -> io::Result<()> {
    for diagnostic in diagnostics {
        let shown = if colours {
            diagnostic.render_styled(file_name)
        } else {
            diagnostic.render(file_name)
        };
        writeln!(out, "{shown}\n")?;
    }
    match diagnostics.len() {
        0 => writeln!(out, "{file_name}: no errors"),
        1 => writeln!(out, "{file_name}: 1 error"),
        count if count < limit => writeln!(out, "{file_name}: {count} errors"),
        count => writeln!(
            out,
            "{file_name}: {count} errors; the rest of the file was not looked at"
        ),
    }
}

/// The errors as one JSON value for editors: `{"file", "errors": [{"code", "line", "column", "length", "message",
/// "help", "source", "span"}], "chatter": [...]}`.
fn to_json(file_name: &str, diagnostics: &[Diagnostic], chatter: &[Warning]) -> serde_json::Value {
    serde_json::json!({ "file": file_name, "errors": diagnostics, "chatter": chatter })
}

#[cfg(test)]
mod tests {
    use evolvent_gcode::{Interpreter, Settings};

    use super::*;

    fn errors(program: &str) -> Vec<Diagnostic> {
        Interpreter::new(program.as_bytes(), Settings::default())
            .filter_map(Result::err)
            .take(3)
            .collect()
    }

    #[test]
    fn errors_are_counted_up_to_the_limit() {
        assert_eq!(errors("G0 X1\nM2\n").len(), 0);
        assert_eq!(errors("G0 X1\nG6\nX?\nM2\n").len(), 2);
        assert_eq!(errors(&"G6\n".repeat(10)).len(), 3);
    }

    #[test]
    fn text_shows_place_and_count() {
        let found = errors("G0 X1\nG6\n");
        let mut out = Vec::new();
        write_text(&mut out, "part.ngc", &found, 3, false).unwrap();
        let text = String::from_utf8(out).unwrap();
        assert!(
            text.contains("part.ngc:2:1") && text.ends_with("part.ngc: 1 error\n"),
            "{text}"
        );
    }

    #[test]
    fn json_has_the_place_in_numbers() {
        let found = errors("G0 X1 Q2\n");
        let json = to_json("part.ngc", &found, &[]);
        assert_eq!(json["errors"][0]["code"], "G0307");
        assert_eq!(json["errors"][0]["line"], 1);
        assert_eq!(json["errors"][0]["column"], 7);
    }
}

//! `evolvent check`: what is wrong with a program, without moving anything.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::Path;

use evolvent_gcode::{Diagnostic, Interpreter, Settings};

/// Errors in a program that are shown before it is taken for no program at all.
pub(crate) const DEFAULT_LIMIT: usize = 50;

/// The errors of the program at `path`, in the order of its lines, at most `limit` of them. One a line: a faulty
/// line counts as not written, so what follows from it may show up as further errors.
///
/// # Errors
/// The file cannot be opened. (If reading fails later on, the last diagnostic says so.)
pub(crate) fn diagnose(path: &Path, settings: Settings, limit: usize) -> io::Result<Vec<Diagnostic>> {
    let file = File::open(path)?;
    Ok(errors_of(
        BufReader::with_capacity(1 << 16, file),
        settings,
        limit,
    ))
}

fn errors_of(program: impl BufRead, settings: Settings, limit: usize) -> Vec<Diagnostic> {
    Interpreter::new(program, settings)
        .filter_map(Result::err)
        .take(limit)
        .collect()
}

/// Writes errors as a compiler would, each with its source line, and a last line that counts them.
///
/// # Errors
/// `out` cannot be written.
pub(crate) fn write_text(
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
/// "help", "source", "span"}]}`.
pub(crate) fn to_json(file_name: &str, diagnostics: &[Diagnostic]) -> serde_json::Value {
    serde_json::json!({ "file": file_name, "errors": diagnostics })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors(program: &str) -> Vec<Diagnostic> {
        errors_of(program.as_bytes(), Settings::default(), 3)
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
        let json = to_json("part.ngc", &found);
        assert_eq!(json["errors"][0]["code"], "G0307");
        assert_eq!(json["errors"][0]["line"], 1);
        assert_eq!(json["errors"][0]["column"], 7);
    }

    #[test]
    fn a_file_that_is_not_there_is_an_error_of_its_own() {
        assert!(diagnose(Path::new("/nowhere/part.ngc"), Settings::default(), 3).is_err());
    }
}

//! `evolvent trace compare`.

use std::io::{self, Write};
use std::path::Path;

use evolvent_inspect::{ComparedRun, Comparison, compare_runs};

use super::{inspect_error, write_error};
use crate::{CommandError, Ending};

/// Maximum number of lines shown.
const SHOWN: usize = 12;

pub(super) fn run(
    a: (&Path, Option<u32>),
    b: (&Path, Option<u32>),
    json: bool,
    out: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let run = |(trace, job)| ComparedRun { trace, job };
    let comparison = compare_runs(run(a), run(b)).map_err(|error| inspect_error(&error))?;
    let written = if json {
        serde_json::to_string(&comparison)
            .map_err(io::Error::from)
            .and_then(|text| writeln!(out, "{text}"))
    } else {
        write_comparison(out, &comparison)
    };
    written.map_err(write_error)?;
    Ok(Ending::Clean)
}

fn write_comparison(out: &mut dyn Write, c: &Comparison) -> io::Result<()> {
    let [a_s, b_s] = c.common_s;
    writeln!(
        out,
        "A took {:.3} s for {:.3} mm of path, B {:.3} s for {:.3} mm",
        c.duration_s[0], c.path_mm[0], c.duration_s[1], c.path_mm[1]
    )?;
    let slower = match a_s.partial_cmp(&b_s) {
        Some(std::cmp::Ordering::Less) => format!(
            "B was {:.3} s slower ({:+.2} %)",
            b_s - a_s,
            100.0 * (b_s / a_s - 1.0)
        ),
        Some(std::cmp::Ordering::Greater) => {
            format!(
                "A was {:.3} s slower ({:+.2} %)",
                a_s - b_s,
                100.0 * (a_s / b_s - 1.0)
            )
        }
        _ => "both took the same time".to_owned(),
    };
    writeln!(out, "on the {:.3} mm that both drove, {slower}", c.common_path_mm)?;
    match c.first_deviation {
        None if c.max_rotary_deviation_deg.is_some() => writeln!(
            out,
            "their positions agree within a nanometre and a millionth of a degree"
        )?,
        None => writeln!(out, "their positions agree within a nanometre")?,
        Some((path_mm, line)) => {
            writeln!(
                out,
                "their positions differ from {path_mm:.3} mm on (line {line}), by at most {:.6} mm, at \
                 {:.3} mm (line {})",
                c.max_deviation_mm, c.deviation_at_mm, c.deviation_line
            )?;
            if let Some(degrees) = c.max_rotary_deviation_deg {
                writeln!(
                    out,
                    "their rotary axes differ by at most {degrees:.6} degrees, at {:.3} mm (line {})",
                    c.rotary_deviation_at_mm, c.rotary_deviation_line
                )?;
            }
        }
    }
    for note in &c.notes {
        writeln!(out, "note: {note}")?;
    }
    if c.lines.is_empty() {
        return Ok(());
    }
    writeln!(
        out,
        "\n{:>8}  {:>10}  {:>10}  {:>10}  why",
        "line", "A, s", "B, s", "B - A, s"
    )?;
    for line in c.lines.iter().take(SHOWN) {
        let text = match &line.b_text {
            None => line.text.clone(),
            Some(b_text) => format!("A: {}   B: {}", shown(&line.text), shown(b_text)),
        };
        writeln!(
            out,
            "{:>8}  {:>10.3}  {:>10.3}  {:>+10.3}  {}; A: {}, B: {}   {text}",
            line.line,
            line.a_s,
            line.b_s,
            line.b_s - line.a_s,
            line.why,
            line.a_limit,
            line.b_limit,
        )?;
    }
    Ok(())
}

/// The text of a line that may be missing in one run.
fn shown(text: &str) -> &str {
    if text.is_empty() { "no such line" } else { text }
}

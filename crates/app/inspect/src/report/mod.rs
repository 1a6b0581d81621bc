//! A run on one self-contained page for a browser.

mod data;
mod gather;
mod line_runs;
mod trail;
mod verdict;

use std::io;
use std::path::{Path, PathBuf};

use evolvent_config::write_whole;

use crate::opened::{InspectError, Opened};

const PAGE: &str = include_str!("page.html");
const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// Why the page could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// Error of the trace.
    #[error(transparent)]
    Inspect(#[from] InspectError),
    /// The page cannot be written.
    #[error("{} cannot be written: {source}; free some space or give another file with -o", .path.display())]
    Write {
        /// Where to.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
}

/// Writes the page of a trace completely or not at all; returns its size in bytes.
///
/// # Errors
/// [`ReportError`].
pub fn write_report(trace: &Path, output: &Path) -> Result<u64, ReportError> {
    let page = report_page(trace)?;
    write_whole(output, page.as_bytes()).map_err(|source| ReportError::Write {
        path: output.to_owned(),
        source,
    })?;
    Ok(page.len() as u64)
}

/// The page of a trace, as [`write_report`] writes it.
///
/// # Errors
/// [`InspectError`].
pub fn report_page(trace: &Path) -> Result<String, InspectError> {
    let mut opened = Opened::open(trace)?;
    let gathered = gather::gather(&mut opened)?;
    Ok(page(&opened, &gathered))
}

/// The data that the page of a trace draws, as JSON, with the data that a viewer needs to convert between
/// time and line: `line_runs`, the cycles with which a line begins, and `texts`, the lines of each job.
///
/// # Errors
/// [`InspectError`].
pub fn report_data(trace: &Path) -> Result<String, InspectError> {
    let mut opened = Opened::open(trace)?;
    let gathered = gather::gather(&mut opened)?;
    let mut value = data::value(&opened, &gathered);
    data::link_lines(&mut value, &opened, &gathered);
    Ok(value.to_string())
}

fn page(opened: &Opened, gathered: &gather::Gathered) -> String {
    let title = format!("{} on {}", opened.run.program_name, opened.run.machine_name);
    let verdict = verdict::verdict(opened, gathered);
    let words: String = verdict
        .iter()
        .map(|sentence| {
            let class = match sentence.gravity {
                verdict::Gravity::Good => "good",
                verdict::Gravity::Note => "note",
                verdict::Gravity::Bad => "bad",
            };
            format!("<li class=\"{class}\">{}</li>\n", data::escaped(&sentence.text))
        })
        .collect();
    PAGE.replace("{{title}}", &data::escaped(&title))
        .replace("{{verdict}}", &words)
        .replace("{{run}}", &data::run_rows(opened, gathered))
        .replace("{{style}}", STYLE)
        .replace("{{script}}", SCRIPT)
        // Replaced last, because the contents of the trace are arbitrary.
        .replace("{{data}}", &data::json(opened, gathered))
}

//! The program that the core has loaded without an upload from a page: another client has loaded it, or a
//! page by its name. Pages show the program that START would start, so it is read and shown like an upload.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, SystemTime};

use evolvent_bus::TEXT_BYTES;
use evolvent_config::open_regular;

use crate::messages::{LogFact, LogKind, ProgramInfo};
use crate::server::{Server, name_of};
use crate::upload::{MAX_PROGRAM, look_through};

/// Poll interval. A program is shown when two consecutive polls find it: the first status after an upload may
/// be older.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// Metadata of a file. Different metadata means a different text.
#[derive(Clone, Debug, PartialEq, Eq)]
struct FileSummary {
    bytes: u64,
    changed: Option<SystemTime>,
}

/// A program that was sent to pages from here.
struct Reported {
    number: u64,
    summary: Result<FileSummary, String>,
}

/// Sends the program of the status to pages whenever they show another one, while the server runs.
pub(crate) async fn watch_loaded(server: Arc<Server>) {
    let mut reported: Option<Reported> = None;
    let mut before = String::new();
    loop {
        tokio::time::sleep(POLL_INTERVAL).await;
        let Some(status) = server.hub.present() else {
            continue;
        };
        let loaded = status.program_name().to_owned();
        // An upload sends its program itself, and holds this permit from before its LOAD until then.
        if server.receiving.available_permits() == 0 || loaded.is_empty() {
            continue;
        }
        let is_settled = loaded == before;
        before.clone_from(&loaded);
        let (shown, beside) = server.hub.shown_program();
        let is_shown = shown.as_ref().is_some_and(|shown| is_named(&shown.file, &loaded));
        let is_told_here =
            reported.as_ref().map(|reported| reported.number) == shown.as_ref().map(|shown| shown.upload);
        // The text of an upload never changes, and a rejected one is shown until another program is loaded.
        if !is_settled || (is_shown && !is_told_here) || (!is_shown && beside.as_ref() == Some(&loaded)) {
            continue;
        }
        let file = PathBuf::from(&loaded);
        let of_thread = file.clone();
        let Ok(summary) = tokio::task::spawn_blocking(move || read_summary(&of_thread)).await else {
            continue;
        };
        if is_shown
            && reported
                .as_ref()
                .is_some_and(|reported| reported.summary == summary)
        {
            continue;
        }
        let number = 1 + server.uploads.fetch_add(1, Ordering::Relaxed);
        let info = info_of(&file, number, &summary);
        if server
            .hub
            .replace_program(shown.map(|shown| shown.upload), info.clone())
        {
            let program = info.name.clone();
            let fact = if is_shown {
                LogFact::ProgramChanged { program }
            } else {
                LogFact::LoadedElsewhere { program }
            };
            server
                .hub
                .log_fact(LogKind::Command, None, fact, info.problem.clone());
            if info.problem.is_none() {
                look_through(&server, file, info);
            }
            reported = Some(Reported { number, summary });
        }
    }
}

/// Whether a file is the one in a status, which truncates long names at a character boundary.
fn is_named(file: &str, loaded: &str) -> bool {
    file == loaded || (file.starts_with(loaded) && loaded.len() + 4 > TEXT_BYTES)
}

fn read_summary(file: &Path) -> Result<FileSummary, String> {
    if file.as_os_str().len() + 4 > TEXT_BYTES {
        return Err(format!(
            "its name has {} bytes or more, and the status truncates it",
            TEXT_BYTES - 3
        ));
    }
    let facts = open_regular(file).and_then(|opened| opened.metadata());
    let facts = facts.map_err(|error| format!("{}: {error}", file.display()))?;
    if facts.len() > MAX_PROGRAM {
        return Err(format!(
            "pages show programs of at most {} MiB",
            MAX_PROGRAM >> 20
        ));
    }
    Ok(FileSummary {
        bytes: facts.len(),
        changed: facts.modified().ok(),
    })
}

fn info_of(file: &Path, number: u64, summary: &Result<FileSummary, String>) -> ProgramInfo {
    ProgramInfo {
        name: name_of(file),
        upload: number,
        file: file.display().to_string(),
        problem: summary.as_ref().err().cloned(),
        bytes: summary.as_ref().map_or(0, |summary| summary.bytes),
        errors: Vec::new(),
        warnings: Vec::new(),
        checked: summary.is_err(),
        planned_s: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_truncated_name_in_a_status_matches_its_file() {
        assert!(is_named("/parts/a.ngc", "/parts/a.ngc"));
        assert!(!is_named("/parts/a.ngc", "/parts/a"));
        let long = format!("/{}.ngc", "x".repeat(200));
        for bytes in [TEXT_BYTES - 3, TEXT_BYTES] {
            assert!(is_named(&long, &long[..bytes]));
        }
        assert!(!is_named(&long, &long[..TEXT_BYTES - 4]));
    }

    #[test]
    fn what_cannot_be_read_is_told_with_its_reason() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("part.ngc");
        let missing = read_summary(&file);
        assert!(info_of(&file, 1, &missing).problem.unwrap().contains("part.ngc"));
        std::fs::write(&file, "M2\n").unwrap();
        let found = read_summary(&file);
        let info = info_of(&file, 2, &found);
        assert_eq!(
            (info.problem, info.bytes, info.name.as_str()),
            (None, 3, "part.ngc")
        );
        std::fs::write(&file, "M30\n").unwrap();
        assert_ne!(read_summary(&file), found);
        assert!(read_summary(folder.path()).is_err());
        let long = folder.path().join("x".repeat(120));
        assert!(read_summary(&long).unwrap_err().contains("truncates"));
    }
}

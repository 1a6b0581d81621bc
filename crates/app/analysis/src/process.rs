//! Process files: cutting data for load-adaptive turning cycles, and files of adaptive feed control.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use evolvent_config::ConfigDocument;
use evolvent_runtime::{Clock, Setup};
use evolvent_turning::{AdaptiveSettings, TurningJob};
use serde::de::IgnoredAny;

use crate::error::AnalysisError;
use crate::user_file::read_text;

/// Reads and checks a process file.
///
/// # Errors
/// An unreadable or invalid file.
pub fn read_process(file: &Path) -> Result<TurningJob, AnalysisError> {
    let text = read_text(file, "process file")?;
    TurningJob::parse(&text, &file.display().to_string())
        .map_err(|error| AnalysisError::Input(error.to_string()))
}

/// Adds a process file to the setup of a machine that moves.
///
/// # Errors
/// As [`read_process`]; a machine without load measurement, or a file without stock with the virtual clock.
pub fn install_process_file(setup: &mut Setup, file: &Path, clock: Clock) -> Result<(), AnalysisError> {
    let job = read_process(file)?;
    install_process(setup, job, &file.display().to_string(), clock)
}

/// Adds a process to the setup; `name` identifies it in errors.
///
/// # Errors
/// A machine without load measurement, or a process without stock with the virtual clock.
pub(crate) fn install_process(
    setup: &mut Setup,
    job: TurningJob,
    name: &str,
    clock: Clock,
) -> Result<(), AnalysisError> {
    let usage = |what: &str| Err(AnalysisError::Input(format!("{name}: {what}")));
    if !setup.machine.program.load_channel {
        return usage(
            "load-adaptive passes need a measured cutting load: if this machine measures one, set \
             load_channel = true under [program] in its machine file",
        );
    }
    if clock == Clock::Virtual && job.blank.is_none() {
        return usage(
            "with the virtual clock the load is that of a simulated stock, and there is no [stock]: add \
             one, or run in real \
             time",
        );
    }
    setup.process = Some(Arc::new(job));
    Ok(())
}

/// The property that distinguishes the files: only a process file of turning has feeds.
#[derive(serde::Deserialize)]
struct ProcessKind {
    feed: Option<IgnoredAny>,
}

/// Distinguishes the files of `--process` for commands without motion: a process file of turning cycles is
/// added to the setup, a case file of `evolvent chatter` is returned.
///
/// # Errors
/// As [`read_process`]; two files of one kind.
pub fn sort_process_files<'a>(
    setup: &mut Setup,
    files: &'a [PathBuf],
    clock: Clock,
) -> Result<Option<&'a Path>, AnalysisError> {
    let mut case = None;
    for file in files {
        let text = read_text(file, "process file")?;
        let name = file.display().to_string();
        let is_turning = ConfigDocument::parse(&text, &name)
            .and_then(|document| document.read::<ProcessKind>())
            .map_err(|error| AnalysisError::Input(error.to_string()))?
            .feed
            .is_some();
        let is_second = if is_turning {
            setup.process.is_some()
        } else {
            case.is_some()
        };
        if is_second {
            return Err(AnalysisError::Input(format!(
                "{}: a second file of its kind; give --process at most once with a process file of \
                 `evolvent turn` and once with a case file of `evolvent chatter`",
                file.display()
            )));
        }
        if is_turning {
            install_process_file(setup, file, clock)?;
        } else {
            case = Some(file.as_path());
        }
    }
    Ok(case)
}

/// Reads and checks a file of adaptive feed control for a control period.
///
/// # Errors
/// An unreadable file, or keys that are unknown, missing or invalid.
pub fn read_adaptive(file: &Path, period_ns: u64) -> Result<AdaptiveSettings, AnalysisError> {
    let name = file.display().to_string();
    let text = read_text(file, "adaptive file")?;
    AdaptiveSettings::parse(&text, &name, 1e-9 * period_ns as f64)
        .map_err(|error| AnalysisError::Input(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::load_setup;

    #[test]
    fn the_kind_of_a_file_is_that_of_its_keys() {
        let folder = tempfile::tempdir().unwrap();
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config");
        let good = std::fs::read_to_string(config.join("processes/turn-shaft.toml")).unwrap();
        let case = "# as in\n# [feed]\nname = \"\"\"\n[feed]\"\"\"\n";
        let file = folder.path().join("p.toml");
        for (text, is_turning) in [
            (good.replace("[feed]", "[ feed ]"), true),
            (good.replace("[feed]", "[\"feed\"]"), true),
            (good, true),
            (case.to_owned(), false),
        ] {
            std::fs::write(&file, &text).unwrap();
            let mut setup = load_setup(&config.join("machines/lathe-2axis.toml"), None).unwrap();
            let files = [file.clone()];
            let found = sort_process_files(&mut setup, &files, Clock::Virtual).unwrap();
            assert_eq!(
                (setup.process.is_some(), found.is_none()),
                (is_turning, is_turning),
                "{text}"
            );
        }
    }
}

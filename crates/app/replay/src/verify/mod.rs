//! Verification that a run is reproducible.

mod comparing;
mod lots;
mod one;
mod served;
mod signals;
mod watch;

use std::collections::VecDeque;
use std::path::Path;
use std::thread;

use evolvent_trace::TraceFile;

use evolvent_inspect::LimitCheck;
use evolvent_inspect::{InspectError, Opened};

/// The first position at which recorded and recomputed setpoint differ.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Difference {
    /// The cycle.
    pub sequence: u64,
    /// Its path time, s.
    pub time_s: f64,
    /// The program's line there, as recorded.
    pub line: u32,
    /// The text of that line.
    pub text: String,
    /// The differing quantity, for example `position X`.
    pub quantity: String,
    /// The recorded value.
    pub recorded: f64,
    /// The recomputed value.
    pub recomputed: f64,
}

/// Result of a verification.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Verified {
    /// Number of recorded cycles.
    pub cycles: u64,
    /// Number of cycles recomputed and compared.
    pub compared: u64,
    /// Number of cycles missing in the trace.
    pub missing: u64,
    /// Whether the run was recomputed at all; if not, `notes` give the reason.
    pub recomputed: bool,
    /// Number of compared setpoints that differ.
    pub differing: u64,
    /// The first of them.
    pub first_difference: Option<Difference>,
    /// Maximum difference of a position, mm or degrees.
    pub greatest_difference: f64,
    /// Possible reasons for a difference: another version, another kind of processor, a planner that was
    /// late.
    pub explanations: Vec<String>,
    /// Number of samples that exceed a limit, by differences of the recorded positions alone.
    pub limit_violations: u64,
    /// All violations found by the independent checks, as text.
    pub violations: Vec<String>,
    /// Maximum distance from the programmed path, mm; `None` if the path was not checked.
    pub max_path_error_mm: Option<f64>,
    /// Number of jobs of a served machine: programs, blocks of MDI, jogs and moves of homing.
    pub jobs: u64,
    /// Number of recorded cycles whose source of motion is unknown, so that they were not compared; `notes`
    /// give the reasons.
    pub uncompared: u64,
    /// Further notes.
    pub notes: Vec<String>,
}

impl Verified {
    /// Whether the recomputed part has no difference, and the checks found no violation.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.differing == 0 && self.first_difference.is_none() && self.violations.is_empty()
    }

    /// Whether the trace is incomplete: cycles are missing, or the program for recomputation is.
    #[must_use]
    pub fn lacks_data(&self) -> bool {
        self.cycles == 0 || self.missing > 0 || !self.recomputed || self.uncompared > 0
    }
}

/// Recomputes a recorded run, or every job of a served machine, from the attachments and the recorded inputs,
/// and compares every setpoint bit for bit. In addition, every recorded position is checked against limits
/// and path, without a planner.
///
/// # Errors
/// [`InspectError`]: the trace is damaged or cannot be understood.
pub fn verify(path: &Path) -> Result<Verified, InspectError> {
    let mut opened = Opened::open(path)?;
    // The parts that recomputation does not need are checked too.
    opened.trace.check_whole()?;
    let mut verified = Verified::default();
    explain_surroundings(&opened, &mut verified);
    if opened.run.extra.contains_key("served") {
        served::verify(opened, path, verified)
    } else {
        one::verify(opened, verified)
    }
}

fn text_of(lines: &[String], line: u32) -> String {
    (line as usize)
        .checked_sub(1)
        .and_then(|at| lines.get(at))
        .cloned()
        .unwrap_or_default()
}

/// Another version or another kind of processor may give other bits.
fn explain_surroundings(opened: &Opened, verified: &mut Verified) {
    let own = env!("CARGO_PKG_VERSION");
    let recorded = opened
        .run
        .versions
        .get("evolvent")
        .map_or("unknown", String::as_str);
    if recorded != own {
        verified.explanations.push(format!(
            "the trace was recorded by version {recorded}, this is {own}: planners of two versions may differ"
        ));
    }
    let platform = evolvent_runtime::platform();
    let recorded = opened.run.extra.get("platform").map_or("unknown", String::as_str);
    if recorded != platform {
        verified.explanations.push(format!(
            "the trace was recorded on {recorded}, this is {platform}: floating point is the same by the \
             standard, compilers may not be"
        ));
    }
    let hash = evolvent_trace::configuration_hash(&[opened.machine_text.as_bytes()]);
    if hash != opened.run.configuration_hash {
        verified
            .explanations
            .push("the attached machine file is not the one whose hash was recorded".to_owned());
    }
    let info = opened.trace.info();
    if !info.recovery.is_empty() {
        let damaged = info.damaged_places();
        let lost = if damaged > 0 {
            format!("{damaged} damaged places were skipped")
        } else {
            "its end may be missing".to_owned()
        };
        verified.notes.push(format!("the trace was recovered; {lost}"));
    }
}

/// A temporary folder for attachments.
fn folder() -> Result<tempfile::TempDir, InspectError> {
    tempfile::tempdir().map_err(|source| InspectError::Io {
        what: "a temporary folder for the attached program".to_owned(),
        source,
    })
}

/// The name of a recorded file without any folder, since traces are untrusted.
fn file_name(recorded: &str) -> &str {
    Path::new(recorded)
        .file_name()
        .and_then(|name| name.to_str())
        .unwrap_or("program.ngc")
}

fn write(file: &Path, text: &[u8]) -> Result<(), InspectError> {
    std::fs::write(file, text).map_err(|source| InspectError::Io {
        what: "the attached program".to_owned(),
        source,
    })
}

/// Writes the attached subroutine files, whose names begin with `prefix`, next to the program.
fn write_subroutines(trace: &mut TraceFile, prefix: &str, folder: &Path) -> Result<(), InspectError> {
    let names: Vec<String> = trace
        .info()
        .attachments
        .iter()
        .filter_map(|(name, _)| name.strip_prefix(prefix).map(str::to_owned))
        .collect();
    for name in names {
        let file = folder.join(file_name(&name));
        // A program that calls a file of its own name calls itself.
        if !file.exists()
            && let Some(text) = trace.attachment(&format!("{prefix}{name}"))?
        {
            write(&file, &text)?;
        }
    }
    Ok(())
}

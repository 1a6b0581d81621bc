//! Everything in a configuration except its axes: name, kind, rate, path, program.

use std::path::{Path, PathBuf};

use evolvent_path::AxisLetter;

use crate::axes::AxisValues;
use crate::error::ImportError;
use crate::ini::{Entry, Ini, resolve};
use crate::report::{Dropped, Report};
use crate::spindles::{SpindleValues, spindles};

/// Everything in a machine file except its axes.
#[derive(Debug)]
pub(crate) struct Settings {
    pub(crate) name: String,
    pub(crate) description: String,
    pub(crate) is_lathe: bool,
    pub(crate) rate_hz: Option<f64>,
    pub(crate) max_feed_mm_s: Option<f64>,
    pub(crate) path: PathMode,
    pub(crate) tool_table: Option<Entry>,
    pub(crate) parameters: Option<Entry>,
    pub(crate) subroutines: Vec<PathBuf>,
    /// Folder of user-defined M codes, and the existing ones.
    pub(crate) user_codes: Option<(PathBuf, Vec<u32>)>,
    pub(crate) spindles: Vec<SpindleValues>,
}

/// Meaning of G64 or G61 in the start-up code.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum PathMode {
    Unknown,
    Exact,
    Tolerance(f64),
}

/// Rates that a machine file permits, Hz.
const RATES_HZ: std::ops::RangeInclusive<f64> = 250.0..=35_000.0;

impl Settings {
    pub(crate) fn read(
        ini: &mut Ini,
        axes: &[AxisValues],
        mm_per_unit: f64,
        report: &mut Report,
    ) -> Result<Self, ImportError> {
        let description = ini
            .first("EMC", "MACHINE")
            .map_or_else(String::new, |entry| entry.value);
        let stem = ini
            .path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let name = [&description, &stem].into_iter().find_map(|text| name_of(text));
        let has = |letter| axes.iter().any(|axis| axis.letter == letter);
        let is_turning = has(AxisLetter::X) && has(AxisLetter::Z);
        let says_lathe = ini.first("DISPLAY", "LATHE").is_some_and(|entry| entry.is_true());
        let feed = ini
            .number("TRAJ", "MAX_LINEAR_VELOCITY")?
            .filter(|feed| *feed > 0.0);
        if feed.is_none() {
            ini.first("TRAJ", "MAX_LINEAR_VELOCITY");
        }
        Ok(Self {
            name: name.unwrap_or_else(|| "machine".to_owned()),
            description,
            is_lathe: is_turning && (says_lathe || !has(AxisLetter::Y)),
            rate_hz: rate(ini, report)?,
            max_feed_mm_s: feed.map(|feed| feed * mm_per_unit),
            path: path_mode(ini, mm_per_unit, report),
            tool_table: ini.first("EMCIO", "TOOL_TABLE"),
            parameters: ini.first("RS274NGC", "PARAMETER_FILE"),
            subroutines: subroutines(ini, report),
            user_codes: user_codes(ini, report),
            spindles: spindles(ini, report)?,
        })
    }
}

/// A text as a valid name of services and files.
pub(crate) fn name_of(text: &str) -> Option<String> {
    let mut name = String::new();
    for c in text.chars() {
        if c.is_ascii_alphanumeric() || c == '_' {
            name.push(c.to_ascii_lowercase());
        } else if !name.is_empty() && !name.ends_with('-') {
            name.push('-');
        }
    }
    let name: String = name
        .trim_start_matches('_')
        .trim_end_matches('-')
        .chars()
        .take(64)
        .collect();
    (!name.is_empty()).then_some(name)
}

fn rate(ini: &mut Ini, report: &mut Report) -> Result<Option<f64>, ImportError> {
    let Some(period_ns) = ini.number("EMCMOT", "SERVO_PERIOD")? else {
        report.choose("rate", "rational: SERVO_PERIOD is missing");
        return Ok(None);
    };
    let rate = 1e9 / period_ns;
    if RATES_HZ.contains(&rate) {
        return Ok(Some(rate));
    }
    report.choose(
        "rate",
        format!("rational: SERVO_PERIOD of {period_ns} ns is outside 250 Hz to 35 kHz"),
    );
    Ok(None)
}

fn path_mode(ini: &mut Ini, mm_per_unit: f64, report: &mut Report) -> PathMode {
    let mut mode = PathMode::Unknown;
    if let Some(entry) = ini.first("RS274NGC", "RS274NGC_STARTUP_CODE") {
        let text = entry.value.to_ascii_uppercase().replace(' ', "");
        let words = words(&text);
        let has = |letter: char, value: f64| words.contains(&(letter, value));
        let unit = match (has('G', 20.0), has('G', 21.0)) {
            (true, _) => 25.4,
            (_, true) => 1.0,
            _ => mm_per_unit,
        };
        if has('G', 61.0) || has('G', 61.1) {
            mode = PathMode::Exact;
        } else if let Some((_, tolerance)) = words.iter().find(|(letter, _)| *letter == 'P')
            && has('G', 64.0)
            && *tolerance > 0.0
        {
            mode = PathMode::Tolerance(tolerance * unit);
        }
        drop_entry(
            report,
            &entry,
            "only G61 and G64 P are carried over: write the other words into the program",
        );
    }
    if mode == PathMode::Unknown {
        report.choose(
            "path.blend_tolerance_mm",
            "0.01: the start-up code has no G64 P, where LinuxCNC rounds corners without a bound",
        );
    }
    mode
}

/// Words of a program line without comments and expressions.
fn words(text: &str) -> Vec<(char, f64)> {
    let starts = text.char_indices().filter(|(_, c)| c.is_ascii_alphabetic());
    let word = |(at, letter): (usize, char)| {
        let rest = text.get(at + 1..)?;
        let end = rest
            .find(|c: char| !(c.is_ascii_digit() || "+-.".contains(c)))
            .unwrap_or(rest.len());
        Some((letter, rest.get(..end)?.parse().ok()?))
    };
    starts.filter_map(word).collect()
}

fn folders(ini: &Ini, value: &str) -> Vec<PathBuf> {
    let names = value.split(':').map(str::trim).filter(|name| !name.is_empty());
    names.map(|name| resolve(Some(ini.folder()), name)).collect()
}

fn subroutines(ini: &mut Ini, report: &mut Report) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in ini.all("RS274NGC", "SUBROUTINE_PATH") {
        for folder in folders(ini, &entry.value) {
            match folder.canonicalize() {
                Ok(folder) if folder.is_dir() && !found.contains(&folder) => found.push(folder),
                Ok(_) => {}
                Err(_) => drop_entry(report, &entry, &format!("{} is not there", folder.display())),
            }
        }
    }
    found
}

/// Executables M100 to M199 in the folders that LinuxCNC searches. A machine file has one such folder.
fn user_codes(ini: &mut Ini, report: &mut Report) -> Option<(PathBuf, Vec<u32>)> {
    let mut entries = ini.all("RS274NGC", "USER_M_PATH");
    entries.extend(ini.first("DISPLAY", "PROGRAM_PREFIX"));
    let mut found: Option<(PathBuf, Vec<u32>)> = None;
    for entry in entries {
        for folder in folders(ini, &entry.value) {
            let codes: Vec<u32> = (100..=199)
                .filter(|code| is_executable(&folder.join(format!("M{code}"))))
                .collect();
            let Ok(folder) = folder.canonicalize() else {
                continue;
            };
            match &found {
                _ if codes.is_empty() => {}
                None => found = Some((folder, codes)),
                Some((first, _)) if *first == folder => {}
                Some(_) => drop_entry(
                    report,
                    &entry,
                    &format!(
                        "one folder of user-defined M codes: those of {} are left out",
                        folder.display()
                    ),
                ),
            }
        }
    }
    found
}

fn is_executable(file: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt;
    std::fs::metadata(file).is_ok_and(|facts| facts.is_file() && facts.permissions().mode() & 0o111 != 0)
}

/// Reports a used entry as one without effect.
pub(crate) fn drop_entry(report: &mut Report, entry: &Entry, reason: &str) {
    report.dropped.push(Dropped {
        file: entry.file.display().to_string(),
        line: entry.line,
        section: entry.section.clone(),
        key: entry.key.clone(),
        value: entry.value.clone(),
        reason: reason.to_owned(),
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_fit_into_services() {
        assert_eq!(
            name_of("Sherline-3Axis mill / inch").as_deref(),
            Some("sherline-3axis-mill-inch")
        );
        assert_eq!(name_of("  __ "), None);
        assert_eq!(name_of("\u{e4}\u{f6}"), None);
    }

    #[test]
    fn words_of_a_start_up_code() {
        assert_eq!(words("G20G64P0.001"), [('G', 20.0), ('G', 64.0), ('P', 0.001)]);
        assert_eq!(words("G\u{e4}#<A>"), []);
    }
}

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
    pub(crate) starts_in_inches: bool,
    /// Value of `start_plane`; `None` for XY.
    pub(crate) start_plane: Option<&'static str>,
    pub(crate) starts_in_diameters: bool,
    /// Whether LinuxCNC keeps offsets in inches.
    pub(crate) is_in_inches: bool,
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

/// Millimetres per inch.
const INCH_MM: f64 = 25.4;

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
        let is_lathe = is_turning && (says_lathe || !has(AxisLetter::Y));
        if is_lathe && !says_lathe {
            report.choose("kind", "lathe: it has X and Z, and no Y; write mill if it is one");
        }
        let feed = ini
            .number("TRAJ", "MAX_LINEAR_VELOCITY")?
            .filter(|feed| *feed > 0.0);
        if feed.is_none() {
            ini.first("TRAJ", "MAX_LINEAR_VELOCITY");
        }
        let start = start(ini, mm_per_unit, report);
        Ok(Self {
            name: name.unwrap_or_else(|| "machine".to_owned()),
            description,
            is_lathe,
            rate_hz: rate(ini, report)?,
            max_feed_mm_s: feed.map(|feed| feed * mm_per_unit),
            path: start.path,
            starts_in_inches: start.inches,
            start_plane: start.plane,
            starts_in_diameters: start.diameters,
            is_in_inches: is_inch(mm_per_unit),
            tool_table: ini.first("EMCIO", "TOOL_TABLE"),
            parameters: ini.first("RS274NGC", "PARAMETER_FILE"),
            subroutines: subroutines(ini, report),
            user_codes: user_codes(ini, report),
            spindles: spindles(ini, report)?,
        })
    }
}

/// A text converted to a valid name of services and files.
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

/// The start of programs according to the start-up code and the units of the configuration.
struct Start {
    inches: bool,
    plane: Option<&'static str>,
    diameters: bool,
    path: PathMode,
}

/// Words of a start-up code, in tenths of the number, that are in force at the start of a program anyway.
const AT_THE_START: [i64; 10] = [80, 170, 400, 490, 800, 900, 911, 940, 970, 990];

fn start(ini: &mut Ini, mm_per_unit: f64, report: &mut Report) -> Start {
    let mut start = Start {
        inches: is_inch(mm_per_unit),
        plane: None,
        diameters: false,
        path: PathMode::Unknown,
    };
    let Some(entry) = ini.first("RS274NGC", "RS274NGC_STARTUP_CODE") else {
        choose_tolerance(report);
        return start;
    };
    let words = words(&entry.value);
    let has = |letter: char, value: f64| words.contains(&(letter, value));
    if has('G', 20.0) || has('G', 21.0) {
        start.inches = has('G', 20.0);
    }
    start.diameters = has('G', 7.0);
    start.plane = [(18.0, "zx"), (19.0, "yz")]
        .into_iter()
        .find_map(|(code, plane)| has('G', code).then_some(plane));
    let unit = if start.inches { INCH_MM } else { 1.0 };
    let tolerance = words.iter().find(|(letter, _)| *letter == 'P');
    if has('G', 61.0) || has('G', 61.1) {
        start.path = PathMode::Exact;
    } else if let Some((_, tolerance)) = tolerance
        && has('G', 64.0)
        && *tolerance > 0.0
    {
        start.path = PathMode::Tolerance(tolerance * unit);
    }
    if has('G', 61.1) {
        report.choose(
            "path.mode",
            "exact, as G61, for G61.1 of the start-up code: the path is the same, and the machine stops \
             only where it has to; write G61.1 into programs that need a stop after every move",
        );
    }
    if start.path == PathMode::Unknown {
        choose_tolerance(report);
    }
    let is_carried = |(letter, value): &(char, f64)| match letter {
        'G' => {
            let tenths = (value * 10.0).round() as i64;
            [70, 180, 190, 200, 210, 610, 611, 640].contains(&tenths) || AT_THE_START.contains(&tenths)
        }
        'P' => matches!(start.path, PathMode::Tolerance(_)),
        _ => false,
    };
    let lost: Vec<String> = (words.iter())
        .filter(|word| !is_carried(word))
        .map(|(letter, value)| format!("{letter}{value}"))
        .collect();
    if entry.value.contains(['#', '[', '<']) {
        drop_entry(
            report,
            &entry,
            "parameters, expressions and subroutines are not carried over: write them into the program",
        );
    } else if !lost.is_empty() {
        let reason = format!(
            "{} not carried over: write it at the beginning of every program (only units, planes, G7, G61 \
             and G64 P have a counterpart)",
            lost.join(" ")
        );
        drop_entry(report, &entry, &reason);
    }
    start
}

fn choose_tolerance(report: &mut Report) {
    report.choose(
        "path.blend_tolerance_mm",
        "0.01: the start-up code has no G64 P, where LinuxCNC rounds corners without a limit",
    );
}

/// Whether LinuxCNC treats this unit of a configuration as inches.
fn is_inch(mm_per_unit: f64) -> bool {
    (mm_per_unit / INCH_MM - 1.0).abs() < 1e-3
}

/// Words of a program line without comments and expressions.
fn words(text: &str) -> Vec<(char, f64)> {
    let text = without_comments(text);
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

/// In capitals, without spaces and comments.
fn without_comments(text: &str) -> String {
    let mut out = String::new();
    let mut is_comment = false;
    for c in text.chars() {
        match c {
            '(' => is_comment = true,
            ')' => is_comment = false,
            ';' if !is_comment => break,
            c if !is_comment && !c.is_whitespace() => out.push(c.to_ascii_uppercase()),
            _ => {}
        }
    }
    out
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
                Err(_) => drop_entry(report, &entry, &format!("{} does not exist", folder.display())),
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
                        "one folder of user-defined M codes: those of {} are omitted",
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
        assert_eq!(words("g20 (not G21) g 90 ; G91"), [('G', 20.0), ('G', 90.0)]);
    }
}

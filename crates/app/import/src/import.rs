//! Conversion of an INI file to the files of a machine.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use evolvent_config::{check_outputs, read_regular, write_whole};
use evolvent_machine::Machine;
use evolvent_path::AxisLetter;

use crate::axes::{AxisValues, Units, axes};
use crate::error::ImportError;
use crate::hal::{connects_probe, hardware};
use crate::ini::{Entry, Ini, resolve};
use crate::reasons::reason;
use crate::report::{Dropped, Report};
use crate::screws;
use crate::settings::{Settings, drop_entry};
use crate::tables;
use crate::text::{self, Names};

/// Maximum number of invalid lines of a tool table that are reported.
const MAX_ODD_LINES: usize = 20;
/// Maximum size of a tool table or parameter file.
const MAX_TABLE_BYTES: u64 = 4 << 20;

/// A machine read from a configuration; nothing is written yet.
#[derive(Debug)]
pub struct Import {
    machine: String,
    /// Name and text.
    tables: Vec<(String, String)>,
    report: Report,
    /// Every file of the configuration, with its description.
    inputs: Vec<(PathBuf, &'static str)>,
}

/// Reads a configuration of LinuxCNC: the INI file, its includes, its tool table, parameters and HAL files.
/// `stem` is the name of the files that [`Import::write`] creates, without extension.
///
/// # Errors
/// Unreadable files, invalid numbers, kinematics other than `trivkins`, and values that give no valid machine
/// file. Each error has the file, the line if there is one, and the remedy.
pub fn import(ini: &Path, stem: &str) -> Result<Import, ImportError> {
    let mut report = Report::default();
    let mut ini = Ini::read(ini, &mut report)?;
    let units = Units::read(&mut ini, &mut report)?;
    let axes = axes(&mut ini, units, &mut report)?;
    let mut settings = Settings::read(&mut ini, &axes, units.linear, &mut report)?;
    let inputs = inputs(&ini, &settings, &axes);
    let mut tables = Vec::new();
    // LinuxCNC writes this file when it ends: a configuration that never ran has none.
    let is_new = |entry: &Entry| !resolve(Some(ini.folder()), &entry.value).exists();
    if let Some(entry) = settings.parameters.take_if(|entry| is_new(entry)) {
        report.choose(
            "program.parameters",
            format!("a new file: {} does not exist", entry.value),
        );
        tables.push((format!("{stem}.var"), String::new()));
    }
    let new_parameters = tables.first().map(|(name, _): &(String, String)| name.clone());
    // Invalid lines of the tool table (line, text and error), and their number.
    let odd_lines = Cell::new(Vec::new());
    let count_odd = Cell::new(0);
    let mut table =
        |entry: &Option<Entry>, ending: &str, convert: &dyn Fn(&str) -> Result<String, String>| {
            let entry = entry.as_ref()?;
            match converted(&ini, entry, convert) {
                Ok(text) => {
                    let name = format!("{stem}.{ending}");
                    tables.push((name.clone(), text));
                    Some(name)
                }
                Err(why) => {
                    drop_entry(&mut report, entry, &why);
                    None
                }
            }
        };
    let names = Names {
        tool_table: table(&settings.tool_table, "tbl", &|text| {
            let (table, odd) = tables::tool_table(text, units.linear);
            match odd.first() {
                Some(error) if table.tools().is_empty() => return Err(error.to_string()),
                _ => {}
            }
            let content = |line: usize| text.lines().nth(line - 1).unwrap_or_default();
            let shown = odd.iter().take(MAX_ODD_LINES);
            odd_lines.set(
                shown
                    .map(|error| (error.line(), content(error.line()).to_owned(), error.to_string()))
                    .collect(),
            );
            count_odd.set(odd.len());
            Ok(table.to_text())
        }),
        parameters: table(&settings.parameters, "var", &|text| {
            let fault = |line| format!("line {line} is not a parameter number with a value");
            tables::parameters(text, units.linear).map_err(fault)
        })
        .or(new_parameters),
        screws: Vec::new(),
    };
    if let Some(entry) = &settings.tool_table {
        let file = resolve(Some(ini.folder()), &entry.value);
        drop_odd_lines(&mut report, entry, &file, odd_lines.take(), count_odd.get());
    }
    let names = Names {
        screws: screw_tables(&ini, &axes, stem, &mut tables, &mut report),
        ..names
    };
    leave_out(&mut ini, &mut report);
    let source = ini
        .path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let machine = machine_file(&source, stem, (&settings, &axes), names, &mut tables, &mut report).map_err(
        |reason| ImportError::Machine {
            path: ini.path,
            reason,
        },
    )?;
    sort(&mut report);
    Ok(Import {
        machine,
        tables,
        report,
        inputs,
    })
}

/// The text of the machine file, without the screw tables that are too rough for the limits: they are removed
/// from `tables`. The error is that of the machine file.
fn machine_file(
    source: &str,
    stem: &str,
    (settings, axes): (&Settings, &[AxisValues]),
    mut names: Names,
    tables: &mut Vec<(String, String)>,
    report: &mut Report,
) -> Result<String, String> {
    let machine = loop {
        let machine = text::machine(source, settings, axes, &names);
        let Err(error) = checked(&machine, stem, tables) else {
            break machine;
        };
        // A table that is too rough for the limits is omitted; the rest of the machine is converted.
        let of_table = names
            .screws
            .iter()
            .position(|(_, name)| error.contains(name.as_str()));
        let Some(index) = of_table.or_else(|| names.screws.len().checked_sub(1)) else {
            return Err(error);
        };
        let (letter, name) = names.screws.remove(index);
        tables.retain(|(table, _)| *table != name);
        let axis = axes.iter().find(|axis| axis.letter == letter);
        if let Some(table) = axis.and_then(|axis| axis.screws.table.as_ref()) {
            drop_entry(report, &table.entry, &error);
        }
    };
    for (letter, _) in &names.screws {
        let axis = axes.iter().find(|axis| axis.letter == *letter);
        for entry in axis.iter().flat_map(|axis| &axis.screws.backlash_entries) {
            drop_entry(
                report,
                entry,
                "it has no effect together with COMP_FILE, as in LinuxCNC",
            );
        }
    }
    Ok(machine)
}

/// The files that belong to LinuxCNC, with their descriptions. No output may replace one of them.
fn inputs(ini: &Ini, settings: &Settings, axes: &[AxisValues]) -> Vec<(PathBuf, &'static str)> {
    let named = |entry: &Entry, what| (resolve(Some(ini.folder()), &entry.value), what);
    let mut inputs: Vec<_> = ini
        .files
        .iter()
        .map(|file| (file.clone(), "a file of LinuxCNC's configuration"))
        .collect();
    let files = [
        (&settings.tool_table, "LinuxCNC's tool table"),
        (&settings.parameters, "LinuxCNC's parameter file"),
    ];
    inputs.extend(
        files
            .iter()
            .filter_map(|(entry, what)| Some(named(entry.as_ref()?, *what))),
    );
    for axis in axes {
        let table = axis.screws.table.as_ref();
        inputs.extend(table.map(|table| named(&table.entry, "LinuxCNC's table of screw errors")));
    }
    for entry in ini.peek("HAL", "HALFILE") {
        let name = entry.value.split_whitespace().next().unwrap_or_default();
        inputs.push((resolve(Some(ini.folder()), name), "LinuxCNC's HAL file"));
    }
    inputs
}

fn sort(report: &mut Report) {
    report
        .dropped
        .sort_by(|a, b| (&a.file, a.line).cmp(&(&b.file, b.line)));
}

/// Reports invalid lines of the tool table; the other lines are converted.
fn drop_odd_lines(
    report: &mut Report,
    entry: &Entry,
    file: &Path,
    lines: Vec<(usize, String, String)>,
    count: usize,
) {
    let more = count - lines.len();
    for (line, text, reason) in lines {
        report.dropped.push(Dropped {
            file: file.display().to_string(),
            line: u32::try_from(line).unwrap_or(u32::MAX),
            section: entry.section.clone(),
            key: entry.key.clone(),
            value: text,
            reason,
        });
    }
    if more > 0 {
        drop_entry(
            report,
            entry,
            &format!("{more} more lines are not valid lines of a tool table"),
        );
    }
}

/// The tables of screw errors, converted.
fn screw_tables(
    ini: &Ini,
    axes: &[AxisValues],
    stem: &str,
    tables: &mut Vec<(String, String)>,
    report: &mut Report,
) -> Vec<(AxisLetter, String)> {
    let mut names = Vec::new();
    for axis in axes {
        let Some(table) = &axis.screws.table else { continue };
        let is_rotary = axis.letter.is_rotary();
        let convert = |text: &str| screws::table(text, table.is_trims, axis.unit, is_rotary);
        match converted(ini, &table.entry, &convert) {
            Ok(text) => {
                let name = format!("{stem}-{}.csv", axis.letter.letter().to_ascii_lowercase());
                tables.push((name.clone(), text));
                names.push((axis.letter, name));
            }
            Err(why) => drop_entry(report, &table.entry, &why),
        }
    }
    names
}

/// The error of the machine file, with these files next to it.
fn checked(machine: &str, stem: &str, tables: &[(String, String)]) -> Result<(), String> {
    let read = |name: &Path| {
        let table = tables.iter().find(|(table, _)| Path::new(table) == name);
        match table {
            Some((_, text)) => Ok(text.clone().into_bytes()),
            None => Err(io::ErrorKind::NotFound.into()),
        }
    };
    Machine::parse_with(machine, &format!("{stem}.toml"), read)
        .map(|_| ())
        .map_err(|error| error.to_string())
}

fn converted(
    ini: &Ini,
    entry: &Entry,
    convert: &dyn Fn(&str) -> Result<String, String>,
) -> Result<String, String> {
    let file = resolve(Some(ini.folder()), &entry.value);
    let bytes =
        read_regular(&file, MAX_TABLE_BYTES).map_err(|error| format!("{}: {error}", file.display()))?;
    let text = String::from_utf8_lossy(&bytes);
    convert(&text).map_err(|why| format!("{}: {why}", file.display()))
}

/// Reports what has no effect: hardware of HAL files, joints that share an axis, unused entries.
fn leave_out(ini: &mut Ini, report: &mut Report) {
    for entry in ini.all("HAL", "HALFILE") {
        let name = entry.value.split_whitespace().next().unwrap_or_default();
        let file = resolve(Some(ini.folder()), name);
        let found = hardware(&file);
        let found: Vec<String> = found
            .iter()
            .map(|(name, what)| format!("{name} ({what})"))
            .collect();
        let mut reason = if found.is_empty() {
            "wiring: the bridge to the drives does this".to_owned()
        } else {
            format!(
                "wiring: the bridge to the drives does this; it loads {}",
                found.join(", ")
            )
        };
        if connects_probe(&file) {
            reason.push_str(
                "; it connects a touch probe (motion.probe-input): G38 is rejected until the machine file \
                 has [probe] and a bridge reports the probe: the EtherCAT bridge does (touch_probe), the \
                 Mesa bridge has no probe input",
            );
        }
        drop_entry(report, &entry, &reason);
    }
    let mut seconds = BTreeMap::new();
    if let Some(entry) = ini.first("KINS", "KINEMATICS") {
        let driven = entry.value.split("coordinates=").nth(1).unwrap_or_default();
        let driven = driven
            .split_whitespace()
            .next()
            .unwrap_or_default()
            .to_ascii_uppercase();
        for letter in "XYZABCUVW".chars() {
            let joints: Vec<String> = driven
                .chars()
                .enumerate()
                .filter(|(_, c)| *c == letter)
                .map(|(joint, _)| joint.to_string())
                .collect();
            for joint in joints.iter().skip(1) {
                seconds.insert(format!("JOINT_{joint}"), letter);
            }
            if joints.len() > 1 {
                drop_entry(
                    report,
                    &entry,
                    &format!(
                        "joints {} both drive {letter}: one axis here; the bridge drives and squares both \
                         motors",
                        joints.join(" and ")
                    ),
                );
            }
        }
    }
    for entry in ini.unused() {
        let second = seconds
            .get(&entry.section)
            .and_then(|letter| of_second_motor(entry, *letter));
        let repeated = entry
            .is_repeated
            .then(|| "the key is given twice: the first one applies, as in LinuxCNC".to_owned());
        if let Some(reason) = repeated.or(second).or_else(|| reason(entry).map(str::to_owned)) {
            report.dropped.push(Dropped {
                file: entry.file.display().to_string(),
                line: entry.line,
                section: entry.section.clone(),
                key: entry.key.clone(),
                value: entry.value.clone(),
                reason,
            });
        }
    }
}

/// Why the homing of the second motor of a gantry has no effect on a machine file.
fn of_second_motor(entry: &Entry, letter: char) -> Option<String> {
    if !entry.key.starts_with("HOME") {
        return None;
    }
    let reason = if entry.key == "HOME_OFFSET" {
        "the difference of the two HOME_OFFSETs is squaring_offset there"
    } else {
        "it has its own home switch there, and the beam is squared by both"
    };
    Some(format!(
        "the second motor of {letter} is in the file of the bridge ([axis.gantry] or [device.axis.gantry]): \
         {reason}"
    ))
}

impl Import {
    /// The machine file.
    #[must_use]
    pub fn machine(&self) -> &str {
        &self.machine
    }

    /// The chosen values and the omitted lines.
    #[must_use]
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// Writes the machine file, and the tables next to it. Returns the names of all files.
    ///
    /// # Errors
    /// A file is one of the configuration's, even if `force` is true; two files are one; the extension of the
    /// machine file is not `.toml`; or a file with one of the names exists and `force` is false: then nothing
    /// is written. A file cannot be written: the previous ones are complete, none is incomplete.
    pub fn write(&self, machine: &Path, force: bool) -> Result<Vec<PathBuf>, ImportError> {
        let folder = machine.parent().unwrap_or(Path::new(""));
        let mut files: Vec<(PathBuf, &str)> = self
            .tables
            .iter()
            .map(|(name, text)| (folder.join(name), text.as_str()))
            .collect();
        files.push((machine.to_owned(), &self.machine));
        if !machine
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("toml"))
        {
            return Err(ImportError::Extension {
                path: machine.to_owned(),
            });
        }
        check_outputs(
            files.iter().map(|(path, _)| path.as_path()),
            self.inputs.iter().map(|(path, what)| (path.as_path(), *what)),
        )?;
        if let Some((path, _)) = files.iter().find(|(path, _)| !force && path.exists()) {
            return Err(ImportError::Exists { path: path.clone() });
        }
        for (path, text) in &files {
            write_whole(path, text.as_bytes()).map_err(|source| ImportError::Write {
                path: path.clone(),
                source,
            })?;
        }
        Ok(files.into_iter().map(|(path, _)| path).collect())
    }
}

//! Backlash and screw errors: `BACKLASH`, `COMP_FILE` and `COMP_FILE_TYPE` of `[JOINT_n]`.

use std::fmt::Write as _;

use crate::error::ImportError;
use crate::ini::{Entry, Ini};
use crate::report::Report;
use crate::settings::drop_entry;

/// The largest backlash of a machine file, mm or degrees.
const MAX_BACKLASH: f64 = 10.0;

/// The screws of an axis's joints.
#[derive(Debug, Default)]
pub(crate) struct ScrewValues {
    /// In mm or degrees.
    pub(crate) backlash: Option<f64>,
    /// The lines of the backlash.
    pub(crate) backlash_entries: Vec<Entry>,
    pub(crate) table: Option<ScrewTable>,
}

/// A table of LinuxCNC.
#[derive(Debug)]
pub(crate) struct ScrewTable {
    pub(crate) entry: Entry,
    /// Type 1: corrections instead of actual positions.
    pub(crate) is_trims: bool,
}

/// Reads backlash and tables; `unit` is in mm or degrees.
pub(crate) fn screws(
    ini: &mut Ini,
    joints: &[usize],
    unit: f64,
    report: &mut Report,
) -> Result<ScrewValues, ImportError> {
    let mut backlash = Vec::new();
    let mut tables = Vec::new();
    for joint in joints {
        let section = format!("JOINT_{joint}");
        if let Some(entry) = ini.first(&section, "BACKLASH") {
            let value = entry.number()?;
            backlash.push((entry, value));
        }
        let kind = ini.number(&section, "COMP_FILE_TYPE")?;
        if let Some(entry) = ini.first(&section, "COMP_FILE") {
            tables.push(ScrewTable {
                entry,
                is_trims: kind.is_some_and(|kind| kind != 0.0),
            });
        }
    }
    let mut drop_all = |entries: &mut dyn Iterator<Item = &Entry>, reason: &str| {
        entries.for_each(|entry| drop_entry(report, entry, reason));
    };
    if joints.len() > 1 && !tables.is_empty() {
        let reason = "several joints drive this axis: measure the axis and give it one table";
        drop_all(&mut tables.iter().map(|table| &table.entry), reason);
        tables.clear();
    }
    backlash.retain(|(_, value)| *value != 0.0);
    let mut screws = ScrewValues {
        backlash: None,
        backlash_entries: Vec::new(),
        table: tables.pop(),
    };
    let Some(&(_, first)) = backlash.first() else {
        return Ok(screws);
    };
    let entries = &mut backlash.iter().map(|(entry, _)| entry);
    if backlash.len() < joints.len() || backlash.iter().any(|(_, value)| *value != first) {
        drop_all(
            entries,
            "the joints that drive this axis have different backlash: enter that of the axis",
        );
    } else if !(0.0..=MAX_BACKLASH).contains(&(first * unit)) {
        drop_all(entries, "this is outside the range of the backlash of a machine");
    } else {
        // It has no effect if there is a table that can be converted.
        screws.backlash = Some(first * unit);
        screws.backlash_entries = backlash.into_iter().map(|(entry, _)| entry).collect();
    }
    Ok(screws)
}

/// Converts a table of LinuxCNC to errors in both directions; `unit` is in mm or degrees.
pub(crate) fn table(text: &str, is_trims: bool, unit: f64, is_rotary: bool) -> Result<String, String> {
    let (position, error) = if is_rotary { ("deg", "mdeg") } else { ("mm", "um") };
    let mut out = format!("position_{position},forward_error_{error},reverse_error_{error}\n");
    let mut end = None;
    for (index, line) in text.lines().enumerate() {
        let numbers: Vec<f64> = line
            .split_whitespace()
            .take(3)
            .map_while(|word| word.parse().ok().filter(|value: &f64| value.is_finite()))
            .collect();
        let (&[nominal, forward, reverse], None) = (&numbers[..], end) else {
            if line.trim().is_empty() {
                end.get_or_insert(index);
                continue;
            }
            return Err(format!(
                "line {} is not three numbers, or follows an empty line, at which LinuxCNC ends the table",
                end.unwrap_or(index) + 1
            ));
        };
        let mut errors = [forward, reverse];
        for error in &mut errors {
            let off = if is_trims { -*error } else { *error - nominal };
            *error = 1000.0 * unit * off;
        }
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{},{},{}", nominal * unit, errors[0], errors[1]);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers are from LinuxCNC's manual, in inches.
    #[test]
    fn tables_of_both_types_become_errors_in_micrometres() {
        let expected = [[-25.4, -127.0, 127.0], [0.0, 50.8, -76.2], [25.4, 76.2, -50.8]];
        for (text, is_trims) in [
            (
                "-1.000 -1.005 -0.995\n0.000 0.002 -0.003\n1.000 1.003 0.998\n\n",
                false,
            ),
            (
                "-1.000 0.005 -0.005\n0.000 -0.002 0.003\n1.000 -0.003 0.002",
                true,
            ),
        ] {
            let csv = table(text, is_trims, 25.4, false).unwrap();
            let rows = csv.lines().skip(1).zip(expected);
            assert_eq!(rows.clone().count(), 3);
            for (row, expected) in rows {
                let found = row.split(',').map(|value| value.parse::<f64>().unwrap());
                assert!(found.zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{row}");
            }
        }
        assert!(
            table("0 0 0\n\n1 0 0\n", true, 1.0, false)
                .unwrap_err()
                .contains("line 2")
        );
        assert!(
            table("0 0 0\n1 0\n", true, 1.0, false)
                .unwrap_err()
                .contains("line 2")
        );
    }
}

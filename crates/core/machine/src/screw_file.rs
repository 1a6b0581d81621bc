//! Tables of screw errors: CSV, JSON, and LinuxCNC's COMP_FILE.
//!
//! CSV and JSON contain the result of a laser or gauge measurement: the error, position reached minus
//! position commanded. LinuxCNC's type 0 contains the position reached, type 1 the correction. All become
//! corrections in mm or degrees.

use evolvent_compensation::{ScrewTable, TableError};
use evolvent_config::{ConfigDocument, ConfigError, shortened};
use serde::Deserialize;

use crate::corrections::{TableFormat, TableUnit};

/// Maximum length of a table file, bytes.
pub(crate) const MAX_TABLE_BYTES: u64 = 4 << 20;

/// Properties of the table that are not in the text.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TableKind {
    pub(crate) format: TableFormat,
    pub(crate) unit: TableUnit,
    pub(crate) is_rotary: bool,
}

impl TableKind {
    fn unit_name(self) -> &'static str {
        if self.is_rotary { "deg" } else { "mm" }
    }

    /// Errors of linear axes are in um, those of rotary axes in thousandths of a degree.
    fn error_unit_name(self) -> &'static str {
        if self.is_rotary { "mdeg" } else { "um" }
    }
}

/// Reads a table; also returns whether it distinguishes the directions.
pub(crate) fn read(text: &str, file: &str, kind: TableKind) -> Result<(ScrewTable, bool), ConfigError> {
    match kind.format {
        TableFormat::Csv => Lines::csv(text, file, kind)?.table(),
        TableFormat::LinuxCnc0 | TableFormat::LinuxCnc1 => Lines::linuxcnc(text, file, kind)?.table(),
        TableFormat::Json => json(text, file, kind),
    }
}

/// The points, with the position of each number in the text.
struct Lines<'a> {
    file: &'a str,
    positions: Vec<f64>,
    forward: Vec<f64>,
    reverse: Option<Vec<f64>>,
    /// Line of each point.
    lines: Vec<usize>,
}

/// The column (in characters, from 1) and text of a field.
type Field<'a> = (usize, &'a str);

fn error(file: &str, position: (usize, usize), key: &str, what: String, advice: &str) -> ConfigError {
    ConfigError::Key {
        file: file.to_owned(),
        line: position.0,
        column: position.1,
        key: key.to_owned(),
        what,
        advice: advice.to_owned(),
    }
}

fn number(file: &str, line: usize, key: &str, (column, text): Field<'_>) -> Result<f64, ConfigError> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(error(
            file,
            (line, column),
            key,
            format!("{:?} is not a number", shortened(text)),
            "write a number such as -12.5",
        )),
    }
}

/// Comma-separated fields without surrounding spaces.
fn comma_fields(line: &str) -> Vec<Field<'_>> {
    let mut column = 1;
    line.split(',')
        .map(|field| {
            let lead = field.chars().take_while(|c| c.is_whitespace()).count();
            let at = column + lead;
            column += field.chars().count() + 1;
            (at, field.trim())
        })
        .collect()
}

/// Space-separated fields.
fn space_fields(line: &str) -> Vec<Field<'_>> {
    let mut fields = Vec::new();
    let mut rest = line;
    let mut column = 1;
    while let Some(start) = rest.find(|c: char| !c.is_whitespace()) {
        column += rest[..start].chars().count();
        let field = rest[start..]
            .split(char::is_whitespace)
            .next()
            .unwrap_or_default();
        fields.push((column, field));
        column += field.chars().count();
        rest = &rest[start + field.len()..];
    }
    fields
}

impl<'a> Lines<'a> {
    fn new(file: &'a str, is_both: bool) -> Self {
        Self {
            file,
            positions: Vec::new(),
            forward: Vec::new(),
            reverse: is_both.then(Vec::new),
            lines: Vec::new(),
        }
    }

    fn csv(text: &str, file: &'a str, kind: TableKind) -> Result<Self, ConfigError> {
        let (unit, errors) = (kind.unit_name(), kind.error_unit_name());
        let position = format!("position_{unit}");
        let one = [position.clone(), format!("error_{errors}")];
        let both = [
            position,
            format!("forward_error_{errors}"),
            format!("reverse_error_{errors}"),
        ];
        let advice = format!("start with the line {} or {}", one.join(","), both.join(","));
        let mut lines = text
            .lines()
            .enumerate()
            .map(|(index, line)| (index + 1, line.trim_end()))
            .filter(|(_, line)| !line.trim().is_empty() && !line.trim_start().starts_with('#'));
        let Some((line, first)) = lines.next() else {
            return Err(error(
                file,
                (1, 1),
                "the table",
                "it is empty".to_owned(),
                &advice,
            ));
        };
        // Some programs start tables with a byte order mark.
        let names = comma_fields(first.trim_start_matches('\u{feff}'));
        let is = |expected: &[String]| {
            names
                .iter()
                .map(|(_, name)| *name)
                .eq(expected.iter().map(String::as_str))
        };
        let is_both = is(&both);
        if !is_both && !is(&one) {
            let what = format!("{:?} is not a header of a table", shortened(first));
            return Err(error(file, (line, 1), "columns", what, &advice));
        }
        let keys: &[String] = if is_both { &both } else { &one };
        let mut table = Self::new(file, is_both);
        for (line, text) in lines {
            let fields = comma_fields(text);
            if fields.len() != keys.len() {
                let what = format!("{} numbers instead of {}", fields.len(), keys.len());
                let column = fields
                    .get(keys.len())
                    .map_or(text.chars().count() + 1, |field| field.0);
                return Err(error(
                    file,
                    (line, column),
                    "point",
                    what,
                    &format!("write {}", keys.join(",")),
                ));
            }
            table.positions.push(number(file, line, &keys[0], fields[0])?);
            table
                .forward
                .push(-1e-3 * number(file, line, &keys[1], fields[1])?);
            if let Some(reverse) = &mut table.reverse {
                reverse.push(-1e-3 * number(file, line, &keys[2], fields[2])?);
            }
            table.lines.push(line);
        }
        Ok(table)
    }

    fn linuxcnc(text: &str, file: &'a str, kind: TableKind) -> Result<Self, ConfigError> {
        let scale = match kind.unit {
            TableUnit::Inch if !kind.is_rotary => 25.4,
            _ => 1.0,
        };
        let mut table = Self::new(file, true);
        for (index, text) in text.lines().enumerate() {
            let line = index + 1;
            let fields = space_fields(text);
            if fields.is_empty() {
                continue;
            }
            if fields.len() < 3 {
                return Err(error(
                    file,
                    (line, text.chars().count() + 1),
                    "point",
                    format!(
                        "{} numbers instead of 3; LinuxCNC silently ends the table here",
                        fields.len()
                    ),
                    "write nominal, forward and reverse on each line, or remove the line",
                ));
            }
            let value = |key, field| Ok::<f64, ConfigError>(scale * number(file, line, key, field)?);
            let nominal = value("nominal", fields[0])?;
            let (forward, reverse) = (value("forward", fields[1])?, value("reverse", fields[2])?);
            let correction = |given: f64| match kind.format {
                TableFormat::LinuxCnc0 => nominal - given,
                _ => given,
            };
            table.positions.push(nominal);
            table.forward.push(correction(forward));
            if let Some(all) = &mut table.reverse {
                all.push(correction(reverse));
            }
            table.lines.push(line);
        }
        Ok(table)
    }

    fn table(&self) -> Result<(ScrewTable, bool), ConfigError> {
        let table = ScrewTable::new(&self.positions, &self.forward, self.reverse.as_deref());
        let is_both = self.reverse.is_some();
        table.map(|table| (table, is_both)).map_err(|problem| {
            let last = self.lines.last().map_or(1, |line| line + 1);
            let line = index_of(&problem).and_then(|index| self.lines.get(index).copied());
            error(
                self.file,
                (line.unwrap_or(last), 1),
                "point",
                problem.to_string(),
                advice_on(&problem),
            )
        })
    }
}

fn index_of(problem: &TableError) -> Option<usize> {
    match problem {
        TableError::Order { index, .. } | TableError::Value { index, .. } => Some(*index),
        TableError::Points(_) | TableError::Lengths { .. } => None,
    }
}

fn advice_on(problem: &TableError) -> &'static str {
    match problem {
        TableError::Points(_) => "measure at more positions, or remove points",
        TableError::Lengths { .. } => "give as many errors as positions",
        TableError::Order { .. } => "sort the points by position, without duplicates",
        TableError::Value { .. } => "check the unit",
    }
}

/// A table in JSON, for a linear or a rotary axis.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct JsonTable {
    positions_mm: Option<Vec<f64>>,
    errors_um: Option<Vec<f64>>,
    forward_errors_um: Option<Vec<f64>>,
    reverse_errors_um: Option<Vec<f64>>,
    positions_deg: Option<Vec<f64>>,
    errors_mdeg: Option<Vec<f64>>,
    forward_errors_mdeg: Option<Vec<f64>>,
    reverse_errors_mdeg: Option<Vec<f64>>,
}

fn json(text: &str, file: &str, kind: TableKind) -> Result<(ScrewTable, bool), ConfigError> {
    // Independent of the actual file name.
    let name = if file.to_ascii_lowercase().ends_with(".json") {
        file.to_owned()
    } else {
        format!("{file} (JSON).json")
    };
    let document = ConfigDocument::parse(text, &name)?;
    let raw: JsonTable = document.read()?;
    let (unit, errors) = (kind.unit_name(), kind.error_unit_name());
    let mine = [
        raw.positions_mm,
        raw.errors_um,
        raw.forward_errors_um,
        raw.reverse_errors_um,
    ];
    let others = [
        raw.positions_deg,
        raw.errors_mdeg,
        raw.forward_errors_mdeg,
        raw.reverse_errors_mdeg,
    ];
    let (mine, others) = if kind.is_rotary {
        (others, mine)
    } else {
        (mine, others)
    };
    let keys = [
        format!("positions_{unit}"),
        format!("errors_{errors}"),
        format!("forward_errors_{errors}"),
        format!("reverse_errors_{errors}"),
    ];
    let shape = format!(
        "give {} with {}, or with {} and {}",
        keys[0], keys[1], keys[2], keys[3]
    );
    if others.iter().any(Option::is_some) {
        let what = "there are keys for another kind of axis".to_owned();
        return Err(document.error("", what, shape));
    }
    let [Some(positions), one, forward, reverse] = mine else {
        return Err(document.error(&keys[0], "missing".to_owned(), shape));
    };
    let (forward, reverse, key) = match (one, forward, reverse) {
        (Some(one), None, None) => (one, None, &keys[1]),
        (None, Some(forward), Some(reverse)) => (forward, Some(reverse), &keys[2]),
        _ => {
            let what = "the errors are missing, given twice, or given for one direction only".to_owned();
            return Err(document.error("", what, shape));
        }
    };
    let corrections = |errors: &[f64]| errors.iter().map(|error| -1e-3 * error).collect::<Vec<_>>();
    let back = reverse.as_deref().map(corrections);
    let table = ScrewTable::new(&positions, &corrections(&forward), back.as_deref());
    table.map(|table| (table, back.is_some())).map_err(|problem| {
        let key = match &problem {
            TableError::Order { index, .. } => format!("{}[{index}]", keys[0]),
            TableError::Value { index, value } if positions.get(*index) == Some(value) => {
                format!("{}[{index}]", keys[0])
            }
            TableError::Value { index, .. } => format!("{key}[{index}]"),
            TableError::Lengths { .. } => key.clone(),
            TableError::Points(_) => keys[0].clone(),
        };
        document.error(&key, problem.to_string(), advice_on(&problem))
    })
}

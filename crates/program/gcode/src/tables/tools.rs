//! The tool table.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use evolvent_path::{AXES, Axes, AxisLetter};

use crate::StoreError;
use crate::tables::store::{read_text, replace_file};

/// A tool: its number and geometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tool {
    /// Number used by T and H, from 1.
    pub number: u32,
    /// Pocket in the tool changer.
    pub pocket: u32,
    /// From the spindle's reference point to the tool tip, mm and degrees: the offset of G43.
    pub offset: Axes,
    /// Diameter in mm; 0 if unknown.
    pub diameter_mm: f64,
    /// Front angle of a turning tool, degrees.
    pub front_angle_deg: f64,
    /// Back angle of a turning tool, degrees.
    pub back_angle_deg: f64,
    /// Orientation of the tip of a turning tool, 1 to 9; 0 for a mill. G41 and G42 in G18 use it: they guide
    /// the centre of the nose, whereas `offset` refers to the tip.
    pub orientation: u32,
}

/// Maximum [`Tool::orientation`].
pub(crate) const MAX_ORIENTATION: u32 = 9;

/// The reason why a tool table is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ToolTableError {
    /// An invalid word.
    #[error(
        "line {line} of the tool table: \"{word}\" is not a letter with a number; write words such as T1 P1 \
         D6 Z12.5"
    )]
    Word {
        /// Line, from 1.
        line: usize,
        /// As written.
        word: String,
    },
    /// A line without T.
    #[error("line {line} of the tool table names no tool; start it with T and the tool number")]
    NoTool {
        /// Line, from 1.
        line: usize,
    },
    /// An invalid orientation of the tip.
    #[error(
        "line {line} of the tool table: \"{word}\": the orientation of a turning tool is Q1 to Q9, that of \
         a mill Q0"
    )]
    Orientation {
        /// Line, from 1.
        line: usize,
        /// As written.
        word: String,
    },
    /// A word occurs twice on a line.
    #[error("line {line} of the tool table has {letter} twice; keep one of the words")]
    Repeated {
        /// Line, from 1.
        line: usize,
        /// The letter.
        letter: char,
    },
    /// A tool occurs twice.
    #[error("line {line} of the tool table names tool {tool} again; keep one of the lines")]
    Twice {
        /// Line, from 1.
        line: usize,
        /// The tool.
        tool: u32,
    },
}

impl ToolTableError {
    /// The line, from 1.
    #[must_use]
    pub fn line(&self) -> usize {
        match self {
            Self::Word { line, .. }
            | Self::NoTool { line }
            | Self::Orientation { line, .. }
            | Self::Repeated { line, .. }
            | Self::Twice { line, .. } => *line,
        }
    }
}

/// All tools of a machine.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ToolTable {
    tools: Vec<Tool>,
    /// The text after `;` on the line of a tool.
    remarks: BTreeMap<u32, String>,
}

impl ToolTable {
    /// The text after `;` on the line of a tool; empty without one.
    #[must_use]
    pub fn remark(&self, number: u32) -> &str {
        self.remarks.get(&number).map_or("", |remark| remark.trim())
    }
}

impl Tool {
    /// A tool without data.
    #[must_use]
    pub fn new(number: u32) -> Self {
        Self {
            number,
            pocket: number,
            offset: Axes::zeros(),
            diameter_mm: 0.0,
            front_angle_deg: 0.0,
            back_angle_deg: 0.0,
            orientation: 0,
        }
    }
}

impl ToolTable {
    /// A table of these tools; of several with the same number the first is used.
    #[must_use]
    pub fn new(tools: Vec<Tool>) -> Self {
        Self {
            tools,
            remarks: BTreeMap::new(),
        }
    }

    /// Reads a file in LinuxCNC's format; see [`ToolTable::parse`].
    ///
    /// # Errors
    /// [`StoreError`] if the file does not exist, cannot be read or is invalid.
    pub fn load(path: &Path) -> Result<Self, StoreError> {
        let file = || path.display().to_string();
        let text = read_text(path)?.ok_or_else(|| StoreError::Read {
            file: file(),
            source: std::io::ErrorKind::NotFound.into(),
        })?;
        Self::parse(&text).map_err(|source| StoreError::Tools { file: file(), source })
    }

    /// Replaces a file atomically: written under another name, then renamed.
    ///
    /// # Errors
    /// [`StoreError`] if the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), StoreError> {
        replace_file(path, &self.to_text())
    }

    /// The table in LinuxCNC's format, one tool per line in the order read; remarks are kept.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        for tool in &self.tools {
            // Writing to a string cannot fail; all digits, so that a value is reproduced bit for bit.
            let _ = write!(text, "T{} P{}", tool.number, tool.pocket);
            let lengths = AxisLetter::ALL.map(|axis| (axis.letter(), tool.offset[axis.index()]));
            let geometry = [
                ('D', tool.diameter_mm),
                ('I', tool.front_angle_deg),
                ('J', tool.back_angle_deg),
            ];
            for (letter, value) in lengths.into_iter().chain(geometry) {
                if value != 0.0 {
                    let _ = write!(text, " {letter}{value}");
                }
            }
            if tool.orientation != 0 {
                let _ = write!(text, " Q{}", tool.orientation);
            }
            if let Some(remark) = self.remarks.get(&tool.number) {
                let _ = write!(text, " ;{remark}");
            }
            text.push('\n');
        }
        text
    }

    /// Parses a table in LinuxCNC's format: one tool per line, words `T P X Y Z A B C U V W D I J Q`, `;`
    /// before a remark. Lengths in mm.
    ///
    /// # Errors
    /// [`ToolTableError`] for the first invalid word, a line without T, or a tool that occurs twice.
    pub fn parse(text: &str) -> Result<Self, ToolTableError> {
        let (table, errors) = Self::parse_lines(text);
        errors.into_iter().next().map_or(Ok(table), Err)
    }

    /// Reads the valid lines, and returns an error for each of the others.
    #[must_use]
    pub fn parse_lines(text: &str) -> (Self, Vec<ToolTableError>) {
        let mut table = Self::default();
        let mut known = BTreeSet::new();
        let mut errors = Vec::new();
        for (index, content) in text.lines().enumerate() {
            let line = index + 1;
            let (content, remark) = content.split_once(';').unwrap_or((content, ""));
            match parse_tool(content, line) {
                Ok(None) => {}
                Ok(Some(tool)) if !known.insert(tool.number) => errors.push(ToolTableError::Twice {
                    line,
                    tool: tool.number,
                }),
                Ok(Some(tool)) => {
                    if !remark.trim().is_empty() {
                        table.remarks.insert(tool.number, remark.to_owned());
                    }
                    table.tools.push(tool);
                }
                Err(error) => errors.push(error),
            }
        }
        (table, errors)
    }

    /// The tool with this number.
    #[must_use]
    pub fn get(&self, number: u32) -> Option<&Tool> {
        self.tools.iter().find(|tool| tool.number == number)
    }

    /// All tools in the order read.
    #[must_use]
    pub fn tools(&self) -> &[Tool] {
        &self.tools
    }

    /// Adds or replaces a tool. Its data are checked when a program uses them.
    pub fn set(&mut self, tool: Tool) {
        match self
            .tools
            .iter_mut()
            .find(|existing| existing.number == tool.number)
        {
            Some(existing) => *existing = tool,
            None => self.tools.push(tool),
        }
    }

    /// Records the exchange of a random tool changer: tool `present` is now in the pocket of tool `new`,
    /// which is in the spindle, pocket 0. An empty pocket is a tool with number 0.
    pub fn swap_pockets(&mut self, new: u32, present: u32) {
        let Some(pocket) = self
            .get(new)
            .map(|tool| tool.pocket)
            .filter(|pocket| *pocket != 0)
        else {
            return;
        };
        if new == present {
            return;
        }
        for (number, pocket) in [(new, 0), (present, pocket)] {
            match self.tools.iter_mut().find(|tool| tool.number == number) {
                Some(tool) => tool.pocket = pocket,
                None => self.tools.push(Tool {
                    pocket,
                    ..Tool::new(number)
                }),
            }
        }
    }

    /// Removes a tool; false if it does not exist.
    pub fn remove(&mut self, number: u32) -> bool {
        let before = self.tools.len();
        self.tools.retain(|tool| tool.number != number);
        self.remarks.remove(&number);
        self.tools.len() < before
    }
}

/// The tool of a line, without its remark; `None` on an empty line.
fn parse_tool(content: &str, line: usize) -> Result<Option<Tool>, ToolTableError> {
    let mut tool = Tool::new(0);
    let mut has_number = false;
    let mut has_words = false;
    let mut letters = BTreeSet::new();
    for word in content.split_whitespace() {
        has_words = true;
        let invalid_word = || ToolTableError::Word {
            line,
            word: word.to_owned(),
        };
        let letter = word.chars().next().unwrap_or_default().to_ascii_uppercase();
        let number = word
            .get(letter.len_utf8()..)
            .and_then(|text| text.parse::<f64>().ok());
        let value = number
            .filter(|value| value.is_finite() && value.abs() <= 1e6)
            .ok_or_else(invalid_word)?;
        if !letters.insert(letter) {
            return Err(ToolTableError::Repeated { line, letter });
        }
        let integer = |value: f64| {
            let is_valid = value.fract() == 0.0 && value >= 0.0;
            is_valid.then_some(value as u32).ok_or_else(invalid_word)
        };
        match letter {
            'T' => (tool.number, has_number) = (integer(value)?, true),
            'P' => tool.pocket = integer(value)?,
            'D' => tool.diameter_mm = value,
            'I' => tool.front_angle_deg = value,
            'J' => tool.back_angle_deg = value,
            'Q' if value <= f64::from(MAX_ORIENTATION) => tool.orientation = integer(value)?,
            'Q' => {
                return Err(ToolTableError::Orientation {
                    line,
                    word: word.to_owned(),
                });
            }
            _ => {
                let axis = "XYZABCUVW".find(letter).filter(|axis| *axis < AXES);
                tool.offset[axis.ok_or_else(invalid_word)?] = value;
            }
        }
    }
    if !has_words {
        return Ok(None);
    }
    if !has_number {
        return Err(ToolTableError::NoTool { line });
    }
    Ok(Some(tool))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_of_linuxcnc_is_read() {
        let text = "T1 P4 Z12.5 D+3.175 ; mill\n\n; nothing\nt99 p5 x-1 q6 i95 j155\n";
        let table = ToolTable::parse(text).unwrap();
        let mill = table.get(1).unwrap();
        assert_eq!((mill.pocket, mill.diameter_mm, mill.offset[2]), (4, 3.175, 12.5));
        let turning = table.get(99).unwrap();
        assert_eq!(
            (
                turning.orientation,
                turning.front_angle_deg,
                turning.back_angle_deg
            ),
            (6, 95.0, 155.0)
        );
        assert_eq!(turning.offset[0], -1.0);
        assert!(table.get(2).is_none());
        let again = ToolTable::parse(&table.to_text()).unwrap();
        assert_eq!(again, table);
        assert!(table.to_text().contains("; mill"), "{}", table.to_text());
    }

    #[test]
    fn tables_round_trip_bit_for_bit() {
        let mut table = ToolTable::parse("T1 P1 Z1 ;one\nT2 P2\n").unwrap();
        let mut tool = Tool::new(7);
        tool.offset[2] = 0.1 + 0.2;
        tool.diameter_mm = 1.0 / 3.0;
        table.set(tool);
        assert!(table.remove(2) && !table.remove(2));
        let file = std::env::temp_dir().join(format!("evolvent-tools-{}.tbl", std::process::id()));
        table.save(&file).unwrap();
        assert_eq!(ToolTable::load(&file).unwrap(), table);
        std::fs::remove_file(&file).unwrap();
        assert!(matches!(ToolTable::load(&file), Err(StoreError::Read { .. })));
    }

    #[test]
    fn invalid_tables_are_rejected_with_their_line() {
        assert_eq!(
            ToolTable::parse("T1\nP2"),
            Err(ToolTableError::NoTool { line: 2 })
        );
        assert_eq!(
            ToolTable::parse("T1\nT1 Z2"),
            Err(ToolTableError::Twice { line: 2, tool: 1 })
        );
        assert_eq!(
            ToolTable::parse("T1 Z5\nT2 Z50 D3 z61"),
            Err(ToolTableError::Repeated { line: 2, letter: 'Z' })
        );
        assert!(matches!(
            ToolTable::parse("T1 Q9\nT2 Q10"),
            Err(ToolTableError::Orientation { line: 2, .. })
        ));
        for word in ["T1.5", "T-1", "Tx", "T1 Znan", "T1 Z1e9", "T1 E3", "T1 é"] {
            assert!(
                matches!(ToolTable::parse(word), Err(ToolTableError::Word { line: 1, .. })),
                "{word}"
            );
        }
    }
}

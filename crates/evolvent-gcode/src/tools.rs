//! The tool table.

use evolvent_path::{AXES, Axes};

/// A tool: its number and what is known of its shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tool {
    /// The number that T and H name, from 1.
    pub number: u32,
    /// Where the changer keeps it.
    pub pocket: u32,
    /// From the spindle's reference to the tool's tip, mm and degrees: what G43 adds.
    pub offset: Axes,
    /// In mm; 0 if unknown.
    pub diameter_mm: f64,
    /// Angle of the front edge of a turning tool, degrees.
    pub front_angle: f64,
    /// Angle of the back edge of a turning tool, degrees.
    pub back_angle: f64,
    /// Where the tip of a turning tool points, 1 to 9; 0 for a mill.
    pub orientation: u32,
}

/// Why a tool table cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ToolTableError {
    /// A word that is none.
    #[error(
        "line {line} of the tool table: \"{word}\" is no letter with a number; write words such as T1 P1 D6 Z12.5"
    )]
    Word {
        /// From 1.
        line: usize,
        /// As written.
        word: String,
    },
    /// A line without T.
    #[error("line {line} of the tool table names no tool; begin it with T and the tool's number")]
    NoTool {
        /// From 1.
        line: usize,
    },
    /// One tool twice.
    #[error("line {line} of the tool table names tool {tool} again; keep one of the lines")]
    Twice {
        /// From 1.
        line: usize,
        /// The tool.
        tool: u32,
    },
}

/// All tools that a machine knows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ToolTable {
    tools: Vec<Tool>,
}

impl Tool {
    /// A tool about which nothing is known.
    #[must_use]
    pub fn new(number: u32) -> Self {
        Self {
            number,
            pocket: number,
            offset: Axes::zeros(),
            diameter_mm: 0.0,
            front_angle: 0.0,
            back_angle: 0.0,
            orientation: 0,
        }
    }
}

impl ToolTable {
    /// A table of these tools; of several with one number the first counts.
    #[must_use]
    pub fn new(tools: Vec<Tool>) -> Self {
        Self { tools }
    }

    /// Reads a table in LinuxCNC's format: a tool a line, words `T P X Y Z A B C U V W D I J Q`, `;` before a
    /// remark. Lengths in mm.
    ///
    /// # Errors
    /// The first word that cannot be read, a line without T, a tool that is there twice.
    pub fn parse(text: &str) -> Result<Self, ToolTableError> {
        let mut tools: Vec<Tool> = Vec::new();
        for (index, content) in text.lines().enumerate() {
            let line = index + 1;
            let content = content.split(';').next().unwrap_or_default();
            let mut tool = Tool::new(0);
            let mut named = false;
            let mut any = false;
            for word in content.split_whitespace() {
                any = true;
                let bad = || ToolTableError::Word {
                    line,
                    word: word.to_owned(),
                };
                let letter = word.chars().next().unwrap_or_default().to_ascii_uppercase();
                let number = word
                    .get(letter.len_utf8()..)
                    .and_then(|text| text.parse::<f64>().ok());
                let value = number
                    .filter(|value| value.is_finite() && value.abs() <= 1e6)
                    .ok_or_else(bad)?;
                let whole = |value: f64| {
                    let right = value.fract() == 0.0 && value >= 0.0;
                    right.then_some(value as u32).ok_or_else(bad)
                };
                match letter {
                    'T' => (tool.number, named) = (whole(value)?, true),
                    'P' => tool.pocket = whole(value)?,
                    'D' => tool.diameter_mm = value,
                    'I' => tool.front_angle = value,
                    'J' => tool.back_angle = value,
                    'Q' => tool.orientation = whole(value)?,
                    _ => {
                        let axis = "XYZABCUVW".find(letter).filter(|axis| *axis < AXES);
                        tool.offset[axis.ok_or_else(bad)?] = value;
                    }
                }
            }
            if !any {
                continue;
            }
            if !named {
                return Err(ToolTableError::NoTool { line });
            }
            if tools.iter().any(|known| known.number == tool.number) {
                return Err(ToolTableError::Twice {
                    line,
                    tool: tool.number,
                });
            }
            tools.push(tool);
        }
        Ok(Self { tools })
    }

    /// The tool of a number.
    #[must_use]
    pub fn get(&self, number: u32) -> Option<&Tool> {
        self.tools.iter().find(|tool| tool.number == number)
    }

    /// For G10: writes a tool, new or known.
    pub(crate) fn set(&mut self, tool: Tool) {
        match self.tools.iter_mut().find(|known| known.number == tool.number) {
            Some(known) => *known = tool,
            None => self.tools.push(tool),
        }
    }
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
            (turning.orientation, turning.front_angle, turning.back_angle),
            (6, 95.0, 155.0)
        );
        assert_eq!(turning.offset[0], -1.0);
        assert!(table.get(2).is_none());
    }

    #[test]
    fn what_is_no_table_is_refused_with_its_line() {
        assert_eq!(
            ToolTable::parse("T1\nP2"),
            Err(ToolTableError::NoTool { line: 2 })
        );
        assert_eq!(
            ToolTable::parse("T1\nT1 Z2"),
            Err(ToolTableError::Twice { line: 2, tool: 1 })
        );
        for word in ["T1.5", "T-1", "Tx", "T1 Znan", "T1 Z1e9", "T1 E3", "T1 é"] {
            assert!(
                matches!(ToolTable::parse(word), Err(ToolTableError::Word { line: 1, .. })),
                "{word}"
            );
        }
    }
}

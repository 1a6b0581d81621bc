//! A file that marks a tool change in progress. If power is lost during the change, the tool in the spindle
//! is unknown.

use std::path::{Path, PathBuf};

use evolvent_config::read_regular;
use evolvent_gcode::{StoreError, replace_file};

/// Name of the file in the state folder. It exists while a change is in progress.
const FILE: &str = "tool-change";

/// Maximum length of a valid file, bytes.
const MAX_BYTES: u64 = 200;

/// Highest tool number.
const MAX_TOOL: u32 = 99_999;

/// The tools of a change that began and is not known to be complete; `None` if the file cannot be read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ChangeMark {
    pub tools: Option<(u32, u32)>,
}

impl ChangeMark {
    pub(crate) fn new(from: u32, to: u32) -> Self {
        Self {
            tools: Some((from, to)),
        }
    }

    fn file(folder: &Path) -> PathBuf {
        folder.join(FILE)
    }

    /// The change that was in progress when the core last ended, if any. An unreadable file counts as one.
    pub(crate) fn read(folder: &Path) -> Option<Self> {
        let bytes = match read_regular(&Self::file(folder), MAX_BYTES) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return None,
            Err(_) => return Some(Self::default()),
        };
        let text = std::str::from_utf8(&bytes).unwrap_or_default();
        let words: Vec<&str> = text.split_whitespace().collect();
        let number = |word: &str| word.parse().ok().filter(|tool| *tool <= MAX_TOOL);
        let tools = match words.as_slice() {
            ["from", from, "to", to] => number(from).zip(number(to)),
            _ => None,
        };
        Some(Self { tools })
    }

    /// The tool in the spindle is unknown because its record cannot be read.
    pub(crate) const UNKNOWN: Self = Self { tools: None };

    /// Writes the file and syncs it to disk.
    pub(crate) fn write(self, folder: &Path) -> Result<(), StoreError> {
        let text = match self.tools {
            Some((from, to)) => format!("from {from} to {to}\n"),
            None => "unknown\n".to_owned(),
        };
        replace_file(&Self::file(folder), &text)
    }

    /// Removes the file: the change is complete, or never began.
    pub(crate) fn remove(folder: &Path) -> Result<(), StoreError> {
        let file = Self::file(folder);
        match std::fs::remove_file(&file) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(StoreError::Write {
                file: file.display().to_string(),
                source: error,
            }),
            _ => Ok(()),
        }
    }

    /// What is unknown, and the remedy.
    pub(crate) fn sentence(self) -> String {
        format!(
            "{}, so the tool in the spindle is unknown: check the spindle, check that the changer is clear, \
             and set the tool by MDI, such as M61 Q3, or M61 Q0 for none",
            self.what()
        )
    }

    /// The same after `failure`, which comes first: the status holds one sentence, and the alarm adds the
    /// advice.
    pub(crate) fn sentence_behind(self, failure: &str) -> String {
        format!("{failure}; {}: set the tool by MDI, such as M61 Q3", self.what())
    }

    fn what(self) -> String {
        match self.tools {
            Some((from, to)) => {
                let tool = |number: u32| match number {
                    0 => "no tool".to_owned(),
                    number => format!("tool {number}"),
                };
                format!("the change from {} to {} was interrupted", tool(from), tool(to))
            }
            None => "a tool change was interrupted, or the saved tool cannot be read".to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_comes_back_and_a_damaged_one_is_one_too() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        assert_eq!(ChangeMark::read(at), None);
        let mark = ChangeMark::new(3, 0);
        mark.write(at).unwrap();
        assert_eq!(ChangeMark::read(at), Some(mark));
        assert!(
            mark.sentence().contains("from tool 3 to no tool"),
            "{}",
            mark.sentence()
        );
        let file = at.join(FILE);
        for text in [
            "",
            "from 3",
            "from 3 to -1",
            "from 3 to 100000",
            "from x to 2",
            "\u{0}",
            &"x".repeat(300),
        ] {
            std::fs::write(&file, text).unwrap();
            assert_eq!(ChangeMark::read(at), Some(ChangeMark::default()), "{text:?}");
        }
        std::fs::remove_file(&file).unwrap();
        std::fs::create_dir(&file).unwrap();
        assert_eq!(ChangeMark::read(at), Some(ChangeMark::default()));
        assert!(ChangeMark::remove(at).is_err());
        std::fs::remove_dir(&file).unwrap();
        ChangeMark::remove(at).unwrap();
        assert_eq!(ChangeMark::read(at), None);
    }
}

//! The file of macros: buttons of the page, each with blocks of MDI.

use std::path::Path;
use std::time::SystemTime;

use evolvent_config::{ConfigDocument, ConfigError, FILE_TIMEOUT, read_regular, within};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::messages::{MacroButton, ToPage};

/// Maximum size of a file of macros.
const MAX_FILE_BYTES: u64 = 256 << 10;
/// Maximum number of buttons in a file.
const MAX_MACROS: usize = 60;
/// Maximum number of blocks of a button.
const MAX_BLOCKS: usize = 50;
/// Maximum length of a block, bytes, as for MDI.
const MAX_BLOCK: usize = 1000;
/// Maximum length of name and note, characters.
const MAX_NAME: usize = 40;
const MAX_NOTE: usize = 200;

/// Macros of the screen: `macros.toml` in the state folder, or `--screen-macros FILE`.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Evolvent macros file")]
struct MacroFile {
    /// The buttons, in this order.
    #[serde(default, rename = "macro")]
    macros: Vec<MacroEntry>,
}

/// A button.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct MacroEntry {
    /// Its label, up to 40 characters.
    #[schemars(length(min = 1, max = 40))]
    name: String,
    /// What it does, for the operator, up to 200 characters.
    #[serde(default)]
    #[schemars(length(max = 200))]
    note: String,
    /// Blocks of MDI. Each runs when the one before it is done; one that is rejected, stopped or fails ends the macro.
    #[schemars(length(min = 1, max = 50))]
    blocks: Vec<String>,
    /// The operator is asked first.
    #[serde(default)]
    confirm: bool,
}

/// Reads the text of a file; `file` names it in errors.
///
/// # Errors
/// Text that is not TOML, keys that are unknown, missing or make no sense: with line and column.
pub fn parse_macros(text: &str, file: &str) -> Result<Vec<MacroButton>, ConfigError> {
    let document = ConfigDocument::toml(text, file)?;
    let read: MacroFile = document.read()?;
    if read.macros.len() > MAX_MACROS {
        let what = format!("{} macros are listed", read.macros.len());
        return Err(document.error("macro", what, format!("list at most {MAX_MACROS}")));
    }
    for (i, entry) in read.macros.iter().enumerate() {
        entry.check(&document, &format!("macro[{i}]"))?;
        if read.macros[..i].iter().any(|other| other.name == entry.name) {
            let what = format!("another macro is named `{}`", entry.name);
            return Err(document.error(
                &format!("macro[{i}].name"),
                what,
                "give each macro a different name",
            ));
        }
    }
    let button = |entry: MacroEntry| MacroButton {
        name: entry.name,
        note: entry.note,
        blocks: entry.blocks,
        confirm: entry.confirm,
    };
    Ok(read.macros.into_iter().map(button).collect())
}

impl MacroEntry {
    fn check(&self, document: &ConfigDocument<'_>, key: &str) -> Result<(), ConfigError> {
        let error = |key: &str, what: String, advice: String| Err(document.error(key, what, advice));
        let is_name = (1..=MAX_NAME).contains(&self.name.trim().chars().count());
        if !is_name || self.name.chars().any(char::is_control) {
            let advice = format!("give 1 to {MAX_NAME} characters in one line");
            return error(
                &format!("{key}.name"),
                format!("`{}` is not a name", self.name.escape_debug()),
                advice,
            );
        }
        if self.note.chars().count() > MAX_NOTE {
            let what = format!("the note has {} characters", self.note.chars().count());
            return error(&format!("{key}.note"), what, format!("give at most {MAX_NOTE}"));
        }
        let count = self.blocks.len();
        if !(1..=MAX_BLOCKS).contains(&count) {
            let advice = format!("give 1 to {MAX_BLOCKS}; a subroutine may hold more, called by one block");
            return error(
                &format!("{key}.blocks"),
                format!("{count} blocks are listed"),
                advice,
            );
        }
        for (i, block) in self.blocks.iter().enumerate() {
            let is_block = !block.trim().is_empty() && block.len() <= MAX_BLOCK;
            if !is_block || block.chars().any(char::is_control) {
                let what = format!("block {} is not a block of MDI", i + 1);
                let advice = format!("give one line of 1 to {MAX_BLOCK} bytes, such as \"G53 G0 Z0\"");
                return error(&format!("{key}.blocks"), what, advice);
            }
        }
        Ok(())
    }
}

/// The schema of the file, for editors.
#[must_use]
pub fn macros_schema() -> serde_json::Value {
    schemars::schema_for!(MacroFile).to_value()
}

/// The macros of a file that may change while pages are open.
#[derive(Debug, Default)]
pub(crate) struct MacroWatch {
    seen: Option<(SystemTime, u64)>,
    looked: bool,
}

impl MacroWatch {
    /// The message for pages if the file has changed since the last call. A missing file counts as one
    /// without macros, unless it must exist.
    pub(crate) fn poll(&mut self, file: &Path, must_exist: bool) -> Option<ToPage> {
        let facts = std::fs::metadata(file).and_then(|facts| Ok((facts.modified()?, facts.len())));
        let seen = facts.as_ref().ok().copied();
        if self.looked && seen == self.seen {
            return None;
        }
        (self.looked, self.seen) = (true, seen);
        let read = match facts {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound && !must_exist => Ok(Vec::new()),
            Err(error) => Err(unreadable(file, &error)),
            Ok(_) => read(file),
        };
        let (macros, problem) = match read {
            Ok(macros) => (macros, None),
            Err(problem) => (Vec::new(), Some(problem)),
        };
        Some(ToPage::Macros { macros, problem })
    }
}

fn unreadable(file: &Path, error: &std::io::Error) -> String {
    format!(
        "{}: cannot read the macros: {error}; check the path and its permissions",
        file.display()
    )
}

fn read(file: &Path) -> Result<Vec<MacroButton>, String> {
    let path = file.to_path_buf();
    let bytes = within(FILE_TIMEOUT, move || read_regular(&path, MAX_FILE_BYTES));
    let bytes = bytes.map_err(|error| unreadable(file, &error))?;
    let name = file.display().to_string();
    let text =
        String::from_utf8(bytes).map_err(|_| format!("{name}: not UTF-8 text; save the file as UTF-8"))?;
    parse_macros(&text, &name).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_again_when_it_has_changed() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("macros.toml");
        let mut watch = MacroWatch::default();
        let none = ToPage::Macros {
            macros: Vec::new(),
            problem: None,
        };
        assert_eq!(watch.poll(&file, false), Some(none));
        assert_eq!(watch.poll(&file, false), None, "a change is reported once");
        std::fs::write(&file, "[[macro]]\nname = \"Park\"\nblocks = [\"G53 G0 Z0\"]\n").unwrap();
        let Some(ToPage::Macros {
            macros,
            problem: None,
        }) = watch.poll(&file, false)
        else {
            panic!("no macros");
        };
        assert_eq!(macros[0].blocks, ["G53 G0 Z0"]);
        std::fs::write(&file, "[[macro]]\nname = \"Park\"\n").unwrap();
        let Some(ToPage::Macros {
            macros,
            problem: Some(problem),
        }) = watch.poll(&file, false)
        else {
            panic!("no problem");
        };
        assert!(
            macros.is_empty() && problem.contains("macros.toml:1") && problem.contains("blocks"),
            "{problem}"
        );
        std::fs::remove_file(&file).unwrap();
        let gone = watch.poll(&file, true);
        assert!(
            matches!(gone, Some(ToPage::Macros { problem: Some(_), .. })),
            "{gone:?}"
        );
    }
}

//! INI files as LinuxCNC reads them: repeated keys, `#INCLUDE`, continued lines, the position of every key.
//!
//! A separate implementation, because no maintained crate keeps line numbers and repeated keys and follows
//! includes.

use std::path::{Path, PathBuf};

use evolvent_config::read_regular;

use crate::error::ImportError;
use crate::report::{Dropped, Report};

/// Maximum size of a file.
const MAX_BYTES: u64 = 4 << 20;
/// Maximum depth of includes, as in LinuxCNC.
const MAX_DEPTH: usize = 16;
/// Maximum number of lines of all files together.
const MAX_ENTRIES: usize = 100_000;

/// One `KEY = VALUE`.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    pub(crate) file: PathBuf,
    pub(crate) line: u32,
    pub(crate) section: String,
    pub(crate) key: String,
    pub(crate) value: String,
    is_used: bool,
    /// LinuxCNC uses an earlier entry of the same key.
    pub(crate) is_repeated: bool,
}

impl Entry {
    pub(crate) fn error(&self, what: String, advice: impl Into<String>) -> ImportError {
        ImportError::Line {
            path: self.file.clone(),
            line: self.line,
            what,
            advice: advice.into(),
        }
    }

    /// The first word of the value: a comment may follow.
    pub(crate) fn word(&self) -> &str {
        self.value.split([' ', '\t', '#', ';']).next().unwrap_or_default()
    }

    /// The number at the start of the value.
    pub(crate) fn number(&self) -> Result<f64, ImportError> {
        let word = self.word();
        match word.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(self.error(
                format!(
                    "[{}] {} = {:?} is not a number",
                    self.section, self.key, self.value
                ),
                "give a decimal number",
            )),
        }
    }

    /// The value as a boolean, according to LinuxCNC's rules.
    pub(crate) fn is_true(&self) -> bool {
        let word = self.word();
        ["1", "yes", "true", "on", "y", "t"].contains(&word.to_ascii_lowercase().as_str())
    }
}

/// The entries of an INI file and of its includes. [`Ini::first`] and [`Ini::all`] mark what they return as
/// used.
#[derive(Debug)]
pub(crate) struct Ini {
    pub(crate) path: PathBuf,
    entries: Vec<Entry>,
    /// The file itself and its includes.
    pub(crate) files: Vec<PathBuf>,
}

impl Ini {
    pub(crate) fn read(path: &Path, report: &mut Report) -> Result<Self, ImportError> {
        let mut ini = Self {
            path: path.to_owned(),
            entries: Vec::new(),
            files: Vec::new(),
        };
        let mut section = String::new();
        ini.read_file(path, &mut section, &mut Vec::new(), report)?;
        Ok(ini)
    }

    fn read_file(
        &mut self,
        path: &Path,
        section: &mut String,
        open: &mut Vec<PathBuf>,
        report: &mut Report,
    ) -> Result<(), ImportError> {
        let bytes = read_regular(path, MAX_BYTES).map_err(|source| ImportError::Read {
            path: path.to_owned(),
            source,
        })?;
        let text = String::from_utf8_lossy(&bytes);
        // Editors of other systems begin a file with a byte order mark.
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        self.files.push(path.to_owned());
        open.push(path.to_owned());
        let mut continued = String::new();
        for (index, line) in text.lines().enumerate() {
            let number = u32::try_from(index + 1).unwrap_or(u32::MAX);
            let line = line.trim_end();
            if let Some(begin) = line.strip_suffix('\\') {
                continued.push_str(begin);
                continue;
            }
            continued.push_str(line);
            let line = std::mem::take(&mut continued);
            if let Some(name) = line.strip_prefix("#INCLUDE") {
                self.include(path, number, name.trim(), (section, open), report)?;
            } else {
                self.read_line(path, number, line.trim_start(), section, report)?;
            }
        }
        open.pop();
        Ok(())
    }

    fn include(
        &mut self,
        path: &Path,
        line: u32,
        name: &str,
        (section, open): (&mut String, &mut Vec<PathBuf>),
        report: &mut Report,
    ) -> Result<(), ImportError> {
        let file = resolve(path.parent(), name);
        let fault = |what: String, advice: &str| ImportError::Line {
            path: path.to_owned(),
            line,
            what,
            advice: advice.to_owned(),
        };
        if name.is_empty() {
            // LinuxCNC reports it and reads on.
            report.dropped.push(Dropped {
                file: path.display().to_string(),
                line,
                section: section.clone(),
                key: "#INCLUDE".to_owned(),
                value: String::new(),
                reason: "it names no file".to_owned(),
            });
            return Ok(());
        }
        if open.contains(&file) || open.len() >= MAX_DEPTH {
            let what = format!("#INCLUDE {name}: the includes form a cycle");
            return Err(fault(what, "remove one of the includes"));
        }
        match self.read_file(&file, section, open, report) {
            Err(ImportError::Read { path, source }) => Err(fault(
                format!("#INCLUDE {name}: {}: {source}", path.display()),
                "put the file there, or remove the line",
            )),
            result => result,
        }
    }

    fn read_line(
        &mut self,
        path: &Path,
        line: u32,
        text: &str,
        section: &mut String,
        report: &mut Report,
    ) -> Result<(), ImportError> {
        if text.is_empty() || text.starts_with(['#', ';']) {
            return Ok(());
        }
        let mut ignore = |reason: &str| {
            report.dropped.push(Dropped {
                file: path.display().to_string(),
                line,
                section: section.clone(),
                key: text.chars().take(60).collect(),
                value: String::new(),
                reason: reason.to_owned(),
            });
            Ok(())
        };
        if let Some(rest) = text.strip_prefix('[') {
            let Some((name, _)) = rest.split_once(']') else {
                return ignore("no section: the closing bracket is missing");
            };
            *section = name.trim().to_owned();
            return Ok(());
        }
        let Some((key, value)) = text.split_once('=') else {
            return ignore("neither a section nor a key with a value");
        };
        if section.is_empty() {
            return ignore("a key before the first section");
        }
        if self.entries.len() >= MAX_ENTRIES {
            return Err(ImportError::Line {
                path: path.to_owned(),
                line,
                what: format!("more than {MAX_ENTRIES} lines"),
                advice: "this is not a machine configuration".to_owned(),
            });
        }
        self.entries.push(Entry {
            file: path.to_owned(),
            line,
            section: section.clone(),
            key: key.trim().to_owned(),
            value: value.trim().trim_matches('"').to_owned(),
            is_used: false,
            is_repeated: false,
        });
        Ok(())
    }

    /// The first entry of this key, which LinuxCNC uses.
    pub(crate) fn first(&mut self, section: &str, key: &str) -> Option<Entry> {
        let wanted = |entry: &&mut Entry| entry.section == section && entry.key == key;
        let mut found = self.entries.iter_mut().filter(wanted);
        let first = found.next()?;
        first.is_used = true;
        found.for_each(|other| other.is_repeated = true);
        Some(first.clone())
    }

    /// All entries of this key.
    pub(crate) fn all(&mut self, section: &str, key: &str) -> Vec<Entry> {
        let wanted = |entry: &&mut Entry| entry.section == section && entry.key == key;
        let take = |entry: &mut Entry| {
            entry.is_used = true;
            entry.clone()
        };
        self.entries.iter_mut().filter(wanted).map(take).collect()
    }

    /// All entries of this key, which are not marked as used.
    pub(crate) fn peek(&self, section: &str, key: &str) -> impl Iterator<Item = &Entry> {
        self.entries
            .iter()
            .filter(move |entry| entry.section == section && entry.key == key)
    }

    /// The first number of this key.
    pub(crate) fn number(&mut self, section: &str, key: &str) -> Result<Option<f64>, ImportError> {
        self.first(section, key).map(|entry| entry.number()).transpose()
    }

    /// Whether this section has any entry.
    pub(crate) fn has(&self, section: &str) -> bool {
        self.entries.iter().any(|entry| entry.section == section)
    }

    /// Entries that were not used.
    pub(crate) fn unused(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter().filter(|entry| !entry.is_used)
    }

    /// The folder that relative names refer to.
    pub(crate) fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    pub(crate) fn missing(&self, what: impl Into<String>, advice: impl Into<String>) -> ImportError {
        ImportError::Missing {
            path: self.path.clone(),
            what: what.into(),
            advice: advice.into(),
        }
    }
}

/// A file named by a configuration: `~` is the user's home, other relative names refer to the folder.
pub(crate) fn resolve(folder: Option<&Path>, name: &str) -> PathBuf {
    if let Some(rest) = name.strip_prefix("~/")
        && let Some(home) = std::env::var_os("HOME")
    {
        return Path::new(&home).join(rest);
    }
    folder.unwrap_or(Path::new("")).join(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(files: &[(&str, &str)]) -> Result<(Ini, Report), ImportError> {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        let mut report = Report::default();
        let ini = Ini::read(&folder.path().join(files[0].0), &mut report)?;
        Ok((ini, report))
    }

    #[test]
    fn first_of_repeated_keys_counts_and_lines_go_on() {
        let text = "# x\n[A]\nK = 1 # one\nK = 2\nLONG = a \\\n  b\n\n[ B ] trailing\nK=\"3\"\nnonsense\n";
        let (mut ini, report) = read(&[("m.ini", text)]).unwrap();
        assert_eq!(ini.number("A", "K").unwrap(), Some(1.0));
        let repeated: Vec<u32> = ini
            .unused()
            .filter(|entry| entry.is_repeated)
            .map(|entry| entry.line)
            .collect();
        assert_eq!(repeated, [4]);
        assert_eq!(ini.all("A", "K").len(), 2);
        assert_eq!(ini.first("A", "LONG").unwrap().value, "a   b");
        assert_eq!(ini.first("A", "LONG").unwrap().line, 6);
        assert_eq!(ini.first("B", "K").unwrap().value, "3");
        assert_eq!(ini.unused().count(), 0);
        assert_eq!((report.dropped.len(), report.dropped[0].line), (1, 10));
    }

    #[test]
    fn a_byte_order_mark_is_no_text() {
        let (mut ini, report) = read(&[
            ("m.ini", "\u{feff}[A]\r\n#INCLUDE b.inc\r\n"),
            ("b.inc", "\u{feff}K\t=\t1\r\n"),
        ])
        .unwrap();
        assert_eq!(ini.number("A", "K").unwrap(), Some(1.0));
        assert_eq!(report.dropped.len(), 0);
    }

    #[test]
    fn includes_keep_their_own_lines_and_loops_end() {
        let (mut ini, _) = read(&[
            ("m.ini", "[A]\n#INCLUDE b.inc\nL = 1\n"),
            ("b.inc", "\nK = x\n[C]\n"),
        ])
        .unwrap();
        let entry = ini.first("A", "K").unwrap();
        assert!(entry.file.ends_with("b.inc") && entry.line == 2);
        assert!(ini.first("C", "L").is_some());
        let (mut ini, report) = read(&[("m.ini", "[A]\n#INCLUDE\nL = 1\n")]).unwrap();
        assert_eq!((report.dropped.len(), report.dropped[0].line), (1, 2));
        assert!(ini.first("A", "L").is_some());
        let error = read(&[("m.ini", "#INCLUDE m.ini\n")]).unwrap_err().to_string();
        assert!(
            error.contains("m.ini:1: #INCLUDE m.ini: the includes form a cycle"),
            "{error}"
        );
        let error = read(&[("m.ini", "\n#INCLUDE no.inc\n")]).unwrap_err().to_string();
        assert!(error.contains("m.ini:2: #INCLUDE no.inc"), "{error}");
    }
}

//! Lines that are stored to be read again: bodies of loops and subroutines, subroutine files.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc as Shared;

use crate::parameters::names::NameId;

/// Lines in one block of memory.
#[derive(Debug, Default)]
pub(crate) struct Lines {
    bytes: Vec<u8>,
    /// End of each line, and its number in its file.
    ends: Vec<(usize, u32)>,
    /// The file, if it is not the program itself.
    pub(crate) file: Option<Shared<str>>,
}

impl Lines {
    pub(crate) fn of_file(file: Option<Shared<str>>) -> Self {
        Self {
            file,
            ..Self::default()
        }
    }

    pub(crate) fn push(&mut self, line: u32, text: &[u8]) {
        self.bytes.extend_from_slice(text);
        self.ends.push((self.bytes.len(), line));
    }

    /// A line and its number.
    pub(crate) fn get(&self, index: usize) -> Option<(&[u8], u32)> {
        let &(end, line) = self.ends.get(index)?;
        let start = if index == 0 { 0 } else { self.ends[index - 1].0 };
        Some((&self.bytes[start..end], line))
    }

    /// All lines, separated by line feeds.
    fn text(&self) -> Vec<u8> {
        let mut text = Vec::with_capacity(self.bytes.len() + self.len());
        for index in 0..self.len() {
            if index > 0 {
                text.push(b'\n');
            }
            if let Some((line, _)) = self.get(index) {
                text.extend_from_slice(line);
            }
        }
        text
    }

    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Memory in use.
    pub(crate) fn size(&self) -> usize {
        self.bytes.len() + self.ends.len() * size_of::<(usize, u32)>()
    }

    pub(crate) fn clear(&mut self) {
        self.bytes.clear();
        self.ends.clear();
    }
}

/// Position of a subroutine's first line.
#[derive(Clone, Debug)]
pub(crate) struct Subroutine {
    pub(crate) lines: Shared<Lines>,
    pub(crate) first: usize,
}

/// All known subroutines.
#[derive(Debug, Default)]
pub(crate) struct Library {
    known: BTreeMap<NameId, Subroutine>,
    /// Memory of the bodies.
    pub(crate) size: usize,
    /// Files that were read, by the requested name.
    files: Vec<(String, Shared<Lines>)>,
}

impl Library {
    pub(crate) fn get(&self, name: NameId) -> Option<&Subroutine> {
        self.known.get(&name)
    }

    /// Records a file that was read.
    pub(crate) fn record_file(&mut self, name: &str, lines: &Shared<Lines>) {
        self.files.push((format!("{name}.ngc"), Shared::clone(lines)));
    }

    /// Files read so far: name, and text as read.
    pub(crate) fn files(&self) -> impl Iterator<Item = (&str, Vec<u8>)> {
        self.files
            .iter()
            .map(|(name, lines)| (name.as_str(), lines.text()))
    }

    pub(crate) fn file_count(&self) -> usize {
        self.files.len()
    }

    /// Stores a subroutine, replacing one with the same name.
    pub(crate) fn insert(&mut self, name: NameId, subroutine: Subroutine) {
        // The subroutines of one file share its lines.
        let is_stored = (self.known.values()).any(|known| Shared::ptr_eq(&known.lines, &subroutine.lines));
        if !is_stored {
            self.size += subroutine.lines.size();
        }
        if let Some(old) = self.known.insert(name, subroutine)
            && Shared::strong_count(&old.lines) == 1
        {
            self.size = self.size.saturating_sub(old.lines.size());
        }
    }
}

/// The reason why a subroutine file cannot be used.
#[derive(Debug)]
pub(crate) enum FileFault {
    Io(PathBuf, std::io::Error),
    TooLong(PathBuf),
}

/// Reads `NAME.ngc` from the first folder that contains it; `None` if none does.
pub(crate) fn find_file(
    name: &str,
    folders: &[PathBuf],
    max_bytes: usize,
) -> Result<Option<Lines>, FileFault> {
    // A name in a program must not lead out of the folders.
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-' | b'.');
    if !name.bytes().all(plain) || name.starts_with('.') {
        return Ok(None);
    }
    for folder in folders {
        let path = folder.join(format!("{name}.ngc"));
        let bytes = match evolvent_config::read_regular(&path, max_bytes as u64) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
            Err(error) => return Err(FileFault::Io(path, error)),
        };
        if bytes.len() > max_bytes {
            return Err(FileFault::TooLong(path));
        }
        let mut lines = Lines::of_file(Some(path.display().to_string().into()));
        let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
        for (index, line) in text.split(|byte| *byte == b'\n').enumerate() {
            let end = line
                .iter()
                .rposition(|byte| *byte != b'\r')
                .map_or(0, |last| last + 1);
            let line = &line[..end];
            lines.push(u32::try_from(index + 1).unwrap_or(u32::MAX), line);
        }
        return Ok(Some(lines));
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_lines_are_unchanged() {
        let mut lines = Lines::default();
        for (line, text) in [(3, "G1"), (4, ""), (9, "X1 Y2")] {
            lines.push(line, text.as_bytes());
        }
        assert_eq!(lines.get(0), Some((&b"G1"[..], 3)));
        assert_eq!(lines.get(1), Some((&b""[..], 4)));
        assert_eq!(lines.get(2), Some((&b"X1 Y2"[..], 9)));
        assert_eq!(lines.get(3), None);
    }

    #[test]
    fn names_do_not_escape_the_folders() {
        for name in ["../secret", "/etc/passwd", ".hidden", "a/b", "a b"] {
            assert!(
                matches!(find_file(name, &[PathBuf::from("/")], 10), Ok(None)),
                "{name}"
            );
        }
    }
}

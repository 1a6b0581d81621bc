//! Bytes that are needed again only at the end of a trace. A served machine records for weeks with its memory
//! locked: data that grow with the trace are stored on disk meanwhile.

use std::fs::File;
use std::io;
use std::path::PathBuf;

/// Gathered in memory before it goes to the file.
const PIECE_BYTES: usize = 8 * 1024;

/// Bytes in the order of arrival: most of them in an unnamed file, which disappears with the process, the
/// rest in memory. If there can be no such file, or the disk is full, they stay in memory.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    /// Folder for the file; `None` after the attempt to create it.
    folder: Option<PathBuf>,
    file: Option<File>,
    /// Number of bytes that are safely in the file.
    filed: u64,
    tail: Vec<u8>,
}

impl Scratch {
    /// Uses a file in this folder.
    pub(crate) fn in_folder(folder: PathBuf) -> Self {
        Self {
            folder: Some(folder),
            // Locked memory is used as soon as it is reserved: all of it now rather than in steps later.
            tail: Vec::with_capacity(2 * PIECE_BYTES),
            ..Self::default()
        }
    }

    /// All bytes so far.
    pub(crate) fn len(&self) -> u64 {
        self.filed + self.tail.len() as u64
    }

    /// The part of them in memory.
    #[cfg(test)]
    pub(crate) fn in_memory(&self) -> usize {
        self.tail.len()
    }

    /// Appends a record.
    pub(crate) fn push(&mut self, record: &[u8]) {
        self.tail.extend_from_slice(record);
        self.settle();
    }

    /// Moves the tail to the file when it is long enough.
    fn settle(&mut self) {
        if self.tail.len() < PIECE_BYTES {
            return;
        }
        if let Some(folder) = self.folder.take() {
            self.file = nameless_file(&folder);
        }
        let Some(file) = &self.file else { return };
        // A full disk may have space later: the next attempt overwrites the incomplete output of this one.
        if write_at(file, &self.tail, self.filed).is_ok() {
            self.filed += self.tail.len() as u64;
            self.tail.clear();
        }
    }

    /// Passes all bytes to `take`, piece by piece.
    ///
    /// # Errors
    /// The file cannot be read, and those of `take`.
    pub(crate) fn read(&self, take: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
        let mut piece = [0; PIECE_BYTES];
        let mut at = 0;
        while let Some(file) = self.file.as_ref().filter(|_| at < self.filed) {
            let length = PIECE_BYTES.min(usize::try_from(self.filed - at).unwrap_or(PIECE_BYTES));
            read_at(file, &mut piece[..length], at)?;
            take(&piece[..length])?;
            at += length as u64;
        }
        take(&self.tail)
    }
}

/// Creates a file without a name.
#[cfg(target_os = "linux")]
fn nameless_file(folder: &std::path::Path) -> Option<File> {
    use rustix::fs::{Mode, OFlags, open};
    let flags = OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC;
    open(folder, flags, Mode::RUSR | Mode::WUSR).ok().map(File::from)
}

#[cfg(target_os = "linux")]
fn write_at(file: &File, bytes: &[u8], at: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, at)
}

#[cfg(target_os = "linux")]
fn read_at(file: &File, bytes: &mut [u8], at: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, at)
}

#[cfg(not(target_os = "linux"))]
fn nameless_file(_folder: &std::path::Path) -> Option<File> {
    None
}

#[cfg(not(target_os = "linux"))]
fn write_at(_file: &File, _bytes: &[u8], _at: u64) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

#[cfg(not(target_os = "linux"))]
fn read_at(_file: &File, _bytes: &mut [u8], _at: u64) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all_of(scratch: &Scratch) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut take = |piece: &[u8]| {
            bytes.extend_from_slice(piece);
            Ok(())
        };
        scratch.read(&mut take).unwrap();
        bytes
    }

    fn fill(scratch: &mut Scratch, bytes: usize) -> Vec<u8> {
        let all: Vec<u8> = (0..bytes).map(|at| (at * 7 + at / 251) as u8).collect();
        for record in all.chunks(90) {
            scratch.push(record);
        }
        all
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn what_grows_lies_on_disk_and_comes_back_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let mut scratch = Scratch::in_folder(folder.path().to_owned());
        let all = fill(&mut scratch, 1_000_000);
        assert!(scratch.in_memory() < PIECE_BYTES + 90, "{}", scratch.in_memory());
        assert!(
            scratch.tail.capacity() <= 2 * PIECE_BYTES,
            "{}",
            scratch.tail.capacity()
        );
        assert_eq!(scratch.len(), 1_000_000);
        assert!(all_of(&scratch) == all, "other bytes");
        // Nothing that a killed process would leave.
        assert_eq!(folder.path().read_dir().unwrap().count(), 0);
    }

    #[test]
    fn without_a_folder_bytes_stay_in_memory() {
        let folder = tempfile::tempdir().unwrap();
        for mut scratch in [
            Scratch::default(),
            Scratch::in_folder(folder.path().join("missing")),
        ] {
            let all = fill(&mut scratch, 50_000);
            assert_eq!((scratch.len(), scratch.in_memory()), (50_000, 50_000));
            assert!(all_of(&scratch) == all, "other bytes");
        }
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn failed_writes_stay_in_memory_until_written() {
        let folder = tempfile::tempdir().unwrap();
        let mut scratch = Scratch::in_folder(folder.path().to_owned());
        let mut all = fill(&mut scratch, 20_000);
        let readable = folder.path().join("readable");
        std::fs::write(&readable, "").unwrap();
        let file = scratch.file.replace(File::open(readable).unwrap());
        let filed = scratch.filed;
        all.extend(fill(&mut scratch, 20_000));
        assert_eq!((scratch.filed, scratch.len()), (filed, 40_000));
        scratch.file = file;
        all.extend(fill(&mut scratch, 20_000));
        assert!(scratch.in_memory() < PIECE_BYTES + 90, "{}", scratch.in_memory());
        assert!(all_of(&scratch) == all, "other bytes");
    }
}

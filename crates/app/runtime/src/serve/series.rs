//! The traces of a served machine: one file per hour, within a size limit for all of them.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicU64;
use std::time::{Duration, Instant, SystemTime};

use crate::file_stamp::file_stamp;

/// Age after which a trace continues in a new file, once nothing moves.
const FILE_AGE: Duration = Duration::from_secs(3600);
/// Reciprocal of the fraction of the limit that the present file may take before it continues in a new one
/// even in motion. The other files have the rest.
const FILE_FRACTION: u64 = 4;
const ENDINGS: [&str; 3] = [".mcap", ".mcap.part", ".mcap.damaged"];

/// Progress of the recorder.
#[derive(Debug, Default)]
pub(crate) struct FileProgress {
    /// Bytes of the present file.
    pub(crate) bytes: AtomicU64,
    /// Files begun after the first.
    pub(crate) files: AtomicU64,
}

/// Files `NAME-TIME.mcap` in one folder, time in UTC.
#[derive(Clone, Debug)]
pub(crate) struct TraceSeries {
    folder: PathBuf,
    name: String,
    limit_bytes: u64,
}

impl TraceSeries {
    pub(crate) fn new(folder: PathBuf, name: &str, limit_bytes: u64) -> Self {
        Self {
            folder,
            name: name.to_owned(),
            limit_bytes,
        }
    }

    /// The path of a file that begins now.
    pub(crate) fn file_of_now(&self) -> PathBuf {
        let stamp = file_stamp(SystemTime::now());
        self.folder.join(format!("{}-{stamp}.mcap", self.name))
    }

    /// Whether the present file should end: it is old and the machine is idle, or it has reached its fraction
    /// of the limit.
    pub(crate) fn is_due(&self, begun: Instant, bytes: u64, is_idle: bool) -> bool {
        (is_idle && begun.elapsed() >= FILE_AGE) || bytes >= self.limit_bytes / FILE_FRACTION
    }

    /// Removes the oldest files of this machine until the others and one more file fit within the limit.
    /// Returns the number of files removed.
    ///
    /// # Errors
    /// The folder cannot be read. A file that cannot be removed is left.
    pub(crate) fn trim(&self, present: &Path) -> io::Result<usize> {
        let mut files = self.files()?;
        files.retain(|(path, _)| !path.starts_with(present) && *path != part_of(present));
        let keep = self.limit_bytes - self.limit_bytes / FILE_FRACTION;
        let mut total: u64 = files.iter().map(|(_, bytes)| bytes).sum();
        let mut removed = 0;
        for (path, bytes) in files {
            if total <= keep {
                break;
            }
            if fs::remove_file(&path).is_ok() {
                total -= bytes;
                removed += 1;
            }
        }
        Ok(removed)
    }

    /// Files of this machine with their sizes, oldest first.
    fn files(&self) -> io::Result<Vec<(PathBuf, u64)>> {
        let mut files = Vec::new();
        for entry in fs::read_dir(&self.folder)? {
            let entry = entry?;
            let name = entry.file_name();
            let Some(name) = name.to_str() else { continue };
            if self.is_own(name) && entry.file_type()?.is_file() {
                // A file that has just been renamed has no size any more.
                let bytes = entry.metadata().map_or(0, |metadata| metadata.len());
                files.push((entry.path(), bytes));
            }
        }
        // The alphabetical order of the names is their order in time.
        files.sort();
        Ok(files)
    }

    /// Whether a file belongs to this series. No other file is ever removed.
    fn is_own(&self, name: &str) -> bool {
        let Some(rest) = name
            .strip_prefix(&self.name)
            .and_then(|rest| rest.strip_prefix('-'))
        else {
            return false;
        };
        let Some(time) = ENDINGS.iter().find_map(|ending| rest.strip_suffix(ending)) else {
            return false;
        };
        time.len() == "20261122T002752.770Z".len()
            && time.bytes().enumerate().all(|(at, byte)| match at {
                8 => byte == b'T',
                15 => byte == b'.',
                19 => byte == b'Z',
                _ => byte.is_ascii_digit(),
            })
    }
}

fn part_of(file: &Path) -> PathBuf {
    let mut part = file.as_os_str().to_owned();
    part.push(".part");
    part.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_oldest_traces_go_to_keep_the_size_limit() {
        let folder = tempfile::tempdir().unwrap();
        let series = TraceSeries::new(folder.path().to_owned(), "mill", 1000);
        let write = |name: &str, bytes: usize| fs::write(folder.path().join(name), vec![0; bytes]).unwrap();
        for hour in 0..5 {
            write(&format!("mill-20261122T{hour:02}0000.000Z.mcap"), 300);
        }
        write("mill-20261121T000000.000Z.mcap.damaged", 300);
        let present = folder.path().join("mill-20261122T050000.000Z.mcap");
        write("mill-20261122T050000.000Z.mcap.part", 900);
        let others = [
            "mill-2-20261122T000000.000Z.mcap",
            "mill-best.mcap",
            "lathe-20261122T000000.000Z.mcap",
            "mill-20261122T000000.000Z.mcap.txt",
        ];
        others.iter().for_each(|name| write(name, 5000));
        assert_eq!(series.trim(&present).unwrap(), 4);
        let mut left: Vec<String> = fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .filter(|name| !others.contains(&name.as_str()))
            .collect();
        left.sort();
        assert_eq!(
            left,
            [
                "mill-20261122T030000.000Z.mcap",
                "mill-20261122T040000.000Z.mcap",
                "mill-20261122T050000.000Z.mcap.part",
            ]
        );
        assert!(others.iter().all(|name| folder.path().join(name).exists()));
        assert_eq!(series.trim(&present).unwrap(), 0, "once");
    }

    #[test]
    fn a_file_ends_when_it_is_old_and_idle_or_too_large() {
        let series = TraceSeries::new(PathBuf::new(), "mill", 1000);
        let now = Instant::now();
        // A host that was started less than an hour ago has no such time.
        if let Some(long_ago) = now.checked_sub(FILE_AGE) {
            assert!(series.is_due(long_ago, 0, true));
            assert!(!series.is_due(long_ago, 0, false), "a job is not cut");
        }
        assert!(!series.is_due(now, 249, true));
        assert!(series.is_due(now, 250, false));
    }
}

//! A separate domain of shared memory.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Once;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use evolvent_bus::{ClientBus, ClientConfig, bus_folders, remove_private_domain};

use crate::served::PATIENCE;

/// Time limit for the end of processes that no test waits for, on a busy host too.
const ENDING: Duration = Duration::from_secs(20);

/// A unique iceoryx2 prefix. On drop its files are removed, and it is checked that none remains.
#[derive(Debug)]
pub struct Domain {
    /// The prefix, for `--bus-prefix`.
    pub prefix: String,
}

impl Domain {
    /// A new one.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "two of them are never equal")]
    pub fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        static FIRST: Once = Once::new();
        FIRST.call_once(remove_domains_of_killed_tests);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        Self {
            prefix: format!("evts{}-{number}-", std::process::id()),
        }
    }

    /// A client of a machine; waits for its core.
    ///
    /// # Panics
    /// If the core does not start within two minutes.
    #[must_use]
    pub fn client(&self, machine: &str) -> ClientBus {
        let config = ClientConfig {
            prefix: Some(self.prefix.clone()),
            wait: PATIENCE,
            ..ClientConfig::new(machine)
        };
        ClientBus::open(&config).expect("a core on the bus")
    }

    /// Its files.
    #[must_use]
    pub fn files(&self) -> Vec<PathBuf> {
        files_where(&self.prefix, |name| name.starts_with(&self.prefix))
    }
}

/// Files and folders of the bus whose names meet a condition.
fn files_where(prefix: &str, is_meant: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let ours = bus_folders(Some(prefix)).expect("the bus's folders");
    let mut folders = vec![PathBuf::from("/dev/shm")];
    // One file may be in shared memory itself.
    folders.extend(
        ours.into_iter()
            .map(|(folder, _)| folder)
            .filter(|folder| !folder.starts_with("/dev/shm")),
    );
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            if is_meant(&entry.file_name().to_string_lossy()) {
                found.push(entry.path());
            } else if entry.path().is_dir() {
                folders.push(entry.path());
            }
        }
    }
    found
}

/// Tests that were killed could not do so themselves, and whatever joins a bus looks through the files of all.
fn remove_domains_of_killed_tests() {
    let of_killed = |name: &str| {
        let (process, rest) = name.strip_prefix("evts")?.split_once('-')?;
        let (number, _) = rest.split_once('-')?;
        let is_gone = process.parse::<u32>().is_ok() && !Path::new("/proc").join(process).exists();
        is_gone.then(|| format!("evts{process}-{number}-"))
    };
    let prefixes: BTreeSet<String> = files_where("evts", |name| of_killed(name).is_some())
        .iter()
        .filter_map(|path| of_killed(&path.file_name()?.to_string_lossy()))
        .collect();
    for prefix in prefixes {
        // Another process of tests may be removing it too.
        let _removed = remove_private_domain(&prefix);
    }
}

impl Drop for Domain {
    fn drop(&mut self) {
        let (begin, mut removed) = (Instant::now(), remove_private_domain(&self.prefix));
        if std::thread::panicking() {
            return;
        }
        // Processes keep their files until they have ended.
        while removed.is_ok() && !self.files().is_empty() && begin.elapsed() < ENDING {
            std::thread::sleep(Duration::from_millis(20));
            removed = remove_private_domain(&self.prefix);
        }
        removed.expect("the domain to be swept");
        assert_eq!(self.files(), Vec::<PathBuf>::new(), "left in shared memory");
    }
}

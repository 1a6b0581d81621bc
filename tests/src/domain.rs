//! A separate domain of shared memory.

use std::path::PathBuf;
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
        let mut found = Vec::new();
        let ours = bus_folders(Some(&self.prefix)).expect("the bus's folders");
        let mut folders = vec![PathBuf::from("/dev/shm")];
        // One file may be in shared memory itself.
        folders.extend(
            ours.into_iter()
                .map(|(folder, _)| folder)
                .filter(|folder| !folder.starts_with("/dev/shm")),
        );
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
                if entry.file_name().to_string_lossy().starts_with(&self.prefix) {
                    found.push(entry.path());
                } else if entry.path().is_dir() {
                    folders.push(entry.path());
                }
            }
        }
        found
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

//! A private domain for each test, with a check that nothing of it is left behind.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use evolvent_bus::{BusConfig, ClientBus, ClientConfig, bus_folders, remove_private_domain};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

pub(crate) const PERIOD_NS: u64 = 1_000_000;

/// Time limit for processes to end that no test waits for: a busy host may need that.
const ENDING: Duration = Duration::from_secs(20);

/// A unique prefix; its domain is removed at the end of the test.
pub(crate) struct PrivateDomain {
    pub(crate) prefix: String,
}

impl PrivateDomain {
    pub(crate) fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        Self {
            prefix: format!("evt{}-{number}-", std::process::id()),
        }
    }

    pub(crate) fn core(&self, name: &str) -> BusConfig {
        BusConfig {
            prefix: Some(self.prefix.clone()),
            ..BusConfig::new(name, "XYZ", PERIOD_NS)
        }
    }

    pub(crate) fn client_config(&self, name: &str) -> ClientConfig {
        let wait = Duration::from_secs(60);
        ClientConfig {
            prefix: Some(self.prefix.clone()),
            wait,
            ..ClientConfig::new(name)
        }
    }

    pub(crate) fn client(&self, name: &str) -> ClientBus {
        ClientBus::open(&self.client_config(name)).expect("a core to be there")
    }

    /// Files of this domain in shared memory and in iceoryx2's folder.
    pub(crate) fn files(&self) -> Vec<PathBuf> {
        let mut found = Vec::new();
        let ours = bus_folders(Some(&self.prefix)).expect("the bus's folders");
        let mut folders = vec![PathBuf::from("/dev/shm")];
        // A folder may be in shared memory itself.
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

impl Drop for PrivateDomain {
    fn drop(&mut self) {
        let (begin, mut removed) = (Instant::now(), remove_private_domain(&self.prefix));
        if std::thread::panicking() {
            return;
        }
        // Processes and threads that are ending keep their files until then.
        while removed.is_ok() && !self.files().is_empty() && begin.elapsed() < ENDING {
            std::thread::sleep(Duration::from_millis(20));
            removed = remove_private_domain(&self.prefix);
        }
        removed.expect("the domain to be cleared");
        assert_eq!(self.files(), Vec::<PathBuf>::new(), "left behind");
    }
}

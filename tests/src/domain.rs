//! A separate domain of shared memory.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Once;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use evolvent_bus::{ClientBus, ClientConfig, bus_folders, remove_private_domain};

use crate::served::PATIENCE;

/// Time limit for the end of processes that no test waits for, on a busy host too.
const ENDING: Duration = Duration::from_secs(20);

/// A test whose process this computer does not show may run in a container beside this one.
const OLD: Duration = Duration::from_secs(60);

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
fn files_where(prefix: &str, matches: impl Fn(&str) -> bool) -> Vec<PathBuf> {
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
            if matches(&entry.file_name().to_string_lossy()) {
                found.push(entry.path());
            } else if entry.path().is_dir() {
                folders.push(entry.path());
            }
        }
    }
    found
}

/// Removes the domains of test processes that were killed, and those of their `evolvent bridge test`: a process
/// that joins a bus examines the nodes of every domain.
fn remove_domains_of_killed_tests() {
    // iceoryx2's prefix ends with a name of the folder. Files of other users and of lost folders stay.
    let Ok(folders) = bus_folders(Some("-")) else {
        return;
    };
    let ends: Vec<&str> = folders.iter().map(|(_, prefix)| &prefix[1..]).collect();
    let prefix_of_killed_test = |name: &str| {
        let end = ends.iter().find_map(|end| name.find(end))?;
        let prefix = &name[..end];
        // `evtsPROCESS-NUMBER-` or `btPROCESS_`
        let process = match prefix.strip_prefix("evts") {
            Some(rest) => rest.split_once('-')?.0,
            None => prefix.strip_prefix("bt")?.strip_suffix('_')?,
        };
        let is_gone = process.parse::<u32>().is_ok() && !Path::new("/proc").join(process).exists();
        is_gone.then(|| prefix.to_owned())
    };
    let is_old = |path: &Path| {
        let modified = path.symlink_metadata().and_then(|facts| facts.modified());
        modified.is_ok_and(|time| time.elapsed().is_ok_and(|age| age > OLD))
    };
    let mut prefixes: BTreeMap<String, bool> = BTreeMap::new();
    for path in files_where("-", |name| prefix_of_killed_test(name).is_some()) {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if let Some(prefix) = prefix_of_killed_test(&name) {
            *prefixes.entry(prefix).or_insert(true) &= is_old(&path);
        }
    }
    for prefix in prefixes
        .iter()
        .filter_map(|(prefix, is_old)| is_old.then_some(prefix))
    {
        // Another process of tests may be removing it too.
        let _removed = remove_private_domain(prefix);
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

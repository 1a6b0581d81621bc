//! Resources of killed processes that iceoryx2 0.10.0 does not remove.
//!
//! Five kinds persist if a process dies within the moment in which it creates them:
//! - the description of a service that was written but not released: every later opening waits for it and
//!   fails;
//! - the folder of a node in which a tag was started: every later cleaning fails on it;
//! - the folder of a node that has no monitor yet: nothing looks for it;
//! - the files of a node whose monitor is incomplete: whether it is alive cannot be determined;
//! - a segment of shared memory that is not complete: a process that opens it waits for that forever.
//!
//! The mode marks incomplete resources: iceoryx2 makes a file read-only, a segment readable, when it is
//! complete.
//!
//! Only cores create services, and they do so under the [`OpeningLock`]: its holder knows that every
//! incomplete resource is left over.

use crate::deadline::Deadline;
use crate::domain::Ipc;
use crate::error::BusError;
use core::time::Duration;
use iceoryx2::node::NodeView;
use iceoryx2::prelude::*;
use iceoryx2::service::service_hash::ServiceHash;
use std::collections::BTreeSet;
use std::fs::{DirEntry, File, Metadata, TryLockError, read_dir, remove_dir, remove_file};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path as StdPath, PathBuf};

/// Lets one core at a time open its services. The operating system releases it when the process dies.
#[derive(Debug)]
pub(crate) struct OpeningLock {
    _folder: File,
}

impl OpeningLock {
    /// Waits for the lock on iceoryx2's folder, which must exist.
    pub(crate) fn acquire(config: &Config, deadline: Deadline) -> Result<Self, BusError> {
        let folder = path(config.global.root_path());
        let failed = |cause: String| BusError::Domain { cause };
        let file = File::open(&folder).map_err(|cause| failed(format!("{}: {cause}", folder.display())))?;
        loop {
            match file.try_lock() {
                Ok(()) => return Ok(Self { _folder: file }),
                Err(TryLockError::Error(cause)) => {
                    return Err(failed(format!("{}: {cause}", folder.display())));
                }
                Err(TryLockError::WouldBlock) if deadline.has_passed() => {
                    return Err(failed("another core hangs while it opens".to_owned()));
                }
                Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(2)),
            }
        }
    }
}

/// A segment that is still incomplete after this number of checks, at this interval, is left over. Its age
/// proves nothing: while the host suspends all processes, its creator cannot complete it.
const LOOKS: u32 = 100;
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// Removes segments of shared memory whose creator died before they were complete. iceoryx2 would wait for
/// one forever, so this comes before any other call.
///
/// A live creator is in that state for milliseconds, in which it fills the segment; one that is still
/// incomplete after a second is left over. If it were removed while its creator is alive, that process would
/// continue, and no other could reach it.
pub(crate) fn clear_unborn_segments(config: &Config) {
    clear_unborn_in(StdPath::new("/dev/shm"), &config.global.prefix.to_string());
}

fn clear_unborn_in(folder: &StdPath, prefix: &str) {
    let number_of_unborn = |file: &PathBuf| {
        let facts = file.metadata().ok()?;
        is_unborn(&facts).then(|| facts.ino())
    };
    let mut unborn: Vec<(PathBuf, u64)> = files_of(folder, prefix)
        .filter_map(|file| {
            let number = number_of_unborn(&file)?;
            Some((file, number))
        })
        .collect();
    for _ in 0..LOOKS {
        if unborn.is_empty() {
            return;
        }
        std::thread::sleep(LOOK_EVERY);
        // A file of that name that was created meanwhile is a different one.
        unborn.retain(|(file, number)| number_of_unborn(file) == Some(*number));
    }
    for (file, _) in unborn {
        let _ = remove_file(&file);
    }
}

/// Removes the description of a service that was started and not finished. The lock must be held.
pub(crate) fn clear_half_made_service(
    _lock: &OpeningLock,
    config: &Config,
    name: &ServiceName,
    pattern: MessagingPattern,
) {
    let file = service_file(config, name, pattern);
    if is_half_made(&file) {
        // If it cannot be removed, opening fails and reports it.
        let _ = remove_file(file);
    }
}

/// The file that describes a service.
pub(crate) fn service_file(config: &Config, name: &ServiceName, pattern: MessagingPattern) -> PathBuf {
    let hash = ServiceHash::new::<<Ipc as Service>::ServiceNameHasher>(name, pattern);
    let file = format!(
        "{}{}{}",
        config.global.prefix,
        hash.as_str(),
        config.global.service.static_config_storage_suffix
    );
    path(&config.global.service_dir()).join(file)
}

/// Removes the folders of dead nodes that iceoryx2's own cleaning has left, if nothing in them is complete
/// and so nothing depends on them.
pub(crate) fn clear_dead_nodes(config: &Config) {
    let mut dead = Vec::new();
    // If a domain cannot be listed, its files stay; nothing else depends on it.
    let _ = Node::<Ipc>::list(config, |state| {
        if let NodeState::Dead(view) = state {
            dead.push(view.id().value());
        }
        CallbackProgression::Continue
    });
    let nodes = path(&config.global.node_dir());
    let prefix = config.global.prefix.to_string();
    for id in dead {
        let folder = nodes.join(id.to_string());
        let tags: Vec<PathBuf> = files(&folder).filter(|file| is_tag(file, config)).collect();
        if tags.iter().any(|tag| !is_half_made(tag)) {
            continue;
        }
        for file in files_of(&folder, &prefix) {
            let _ = remove_file(file);
        }
        // The monitor comes last: without it the rest could not be found again.
        if remove_dir(&folder).is_ok() || !folder.exists() {
            for file in files_of(&nodes, &format!("{prefix}{id}.")) {
                let _ = remove_file(file);
            }
        }
    }
}

/// No process takes this long to create a node: an older incomplete one is left over.
pub(crate) const LEFT_AFTER: Duration = Duration::from_secs(60);

/// Removes the remains of nodes that died before they were visible: described, but without a monitor that
/// shows whether they are alive. A live node is in that state for less than a millisecond; only nodes at
/// least this old count as left over.
///
/// Folders have no prefix, and domains share their parent folder. An empty folder may belong to any domain:
/// it is removed with its monitor, or, if it has none, once it is so old that no process can be creating it.
pub(crate) fn clear_unborn_nodes(config: &Config, at_least: Duration) {
    let nodes = path(&config.global.node_dir());
    let prefix = config.global.prefix.to_string();
    // Some monitors are complete and still carry no information: their creator died before it held their
    // lock.
    let mut told = Vec::new();
    let listed = Node::<Ipc>::list(config, |state| {
        if !matches!(state, NodeState::Undefined(_)) {
            told.push(state.node_id().value().to_string());
        }
        CallbackProgression::Continue
    });
    let suffix = config.global.node.monitor_suffix.to_string();
    // Listed once: all domains share the folder, and killed processes of another one may have left hundreds
    // of files in it.
    let (folders, all_monitors) = listing(&nodes);
    for id in node_numbers(folders, &all_monitors, &prefix, &suffix) {
        let folder = nodes.join(&id);
        let monitor = format!("{prefix}{id}{suffix}");
        let monitors: Vec<PathBuf> = (all_monitors.range(monitor.clone()..))
            .take_while(|name| name.starts_with(&monitor))
            .map(|name| nodes.join(name))
            .collect();
        let content: Vec<PathBuf> = files(&folder).collect();
        let age_that_counts = match (content.is_empty(), monitors.is_empty()) {
            (false, _) if !content.iter().all(|file| begins_with(file, &prefix)) => continue,
            (true, true) if is_monitored(&all_monitors, &id, &suffix) => continue,
            (true, true) => at_least.max(LEFT_AFTER),
            _ => at_least,
        };
        let is_old = |file: &StdPath| {
            let made = file.metadata().and_then(|facts| facts.modified());
            // If the clock was set back it looks younger: it is removed later.
            made.is_ok_and(|made| made.elapsed().is_ok_and(|age| age >= age_that_counts))
        };
        // Some have no folder any more but still a monitor.
        let is_left = if folder.is_dir() {
            is_old(&folder)
        } else {
            monitors.iter().all(|file| is_old(file))
        };
        // Its owner may not read a monitor that is being created.
        let is_complete = |file: PathBuf| {
            file.metadata()
                .is_ok_and(|facts| facts.permissions().mode() & 0o400 != 0)
        };
        let is_born = || is_complete(nodes.join(&monitor)) && (listed.is_err() || told.contains(&id));
        if !is_left || is_born() {
            continue;
        }
        for file in content {
            let _ = remove_file(file);
        }
        // The monitor comes last: without it the owner of the folder would be unknown.
        if remove_dir(&folder).is_ok() || !folder.exists() {
            for file in monitors {
                let _ = remove_file(file);
            }
        }
    }
}

/// Names of the folders and of the files in a folder.
fn listing(folder: &StdPath) -> (BTreeSet<String>, BTreeSet<String>) {
    let named = entries(folder).filter_map(|entry| Some((entry.file_name().into_string().ok()?, entry)));
    let (folders, files): (Vec<_>, Vec<_>) =
        named.partition(|(_, entry)| entry.file_type().is_ok_and(|kind| kind.is_dir()));
    let names = |list: Vec<(String, DirEntry)>| list.into_iter().map(|(name, _)| name).collect();
    (names(folders), names(files))
}

/// Numbers of nodes that have a folder, or a monitor with this prefix.
fn node_numbers(
    folders: BTreeSet<String>,
    monitors: &BTreeSet<String>,
    prefix: &str,
    suffix: &str,
) -> BTreeSet<String> {
    let mut numbers = folders;
    numbers.extend(monitors.iter().filter_map(|name| {
        let (id, _) = name.strip_prefix(prefix)?.split_once(suffix)?;
        (!id.is_empty() && id.bytes().all(|byte| byte.is_ascii_digit())).then(|| id.to_owned())
    }));
    numbers
}

/// Whether any domain has a monitor of this node.
fn is_monitored(monitors: &BTreeSet<String>, id: &str, suffix: &str) -> bool {
    let monitor = format!("{id}{suffix}");
    monitors.iter().any(|name| name.contains(&monitor))
}

fn is_tag(file: &StdPath, config: &Config) -> bool {
    let name = file.to_string_lossy();
    let node = &config.global.node;
    [&node.service_tag_suffix, &node.port_tag_suffix]
        .iter()
        .any(|suffix| name.ends_with(&suffix.to_string()))
}

/// iceoryx2 makes a file read-only when it is complete.
fn is_half_made(file: &StdPath) -> bool {
    file.metadata().is_ok_and(|facts| !facts.permissions().readonly())
}

/// iceoryx2 keeps a segment and a monitor unreadable, for its owner too, while it creates them. One that is
/// readable and has no size was truncated: a process that opens it would wait for its size forever.
fn is_unborn(facts: &Metadata) -> bool {
    facts.permissions().mode() & 0o400 == 0 || facts.len() == 0
}

fn begins_with(file: &StdPath, prefix: &str) -> bool {
    file.file_name()
        .is_some_and(|name| name.to_string_lossy().starts_with(prefix))
}

fn files(folder: &StdPath) -> impl Iterator<Item = PathBuf> {
    files_of(folder, "")
}

/// Files whose names begin with a prefix. The listing tells their type, without a `stat` per file.
fn files_of(folder: &StdPath, prefix: &str) -> impl Iterator<Item = PathBuf> {
    entries(folder)
        .filter(move |entry| entry.file_name().to_string_lossy().starts_with(prefix))
        .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file()))
        .map(|entry| entry.path())
}

fn entries(folder: &StdPath) -> impl Iterator<Item = DirEntry> {
    read_dir(folder).into_iter().flatten().flatten()
}

fn path(path: &Path) -> PathBuf {
    PathBuf::from(path.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::Permissions;
    use std::time::SystemTime;

    /// A segment that is being created, begun before the host stood still for an hour.
    fn begun(folder: &StdPath, name: &str) -> PathBuf {
        let path = folder.join(name);
        let file = File::create(&path).unwrap();
        file.set_len(100).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(3600))
            .unwrap();
        file.set_permissions(Permissions::from_mode(0o200)).unwrap();
        path
    }

    #[test]
    fn segment_of_running_creator_stays_however_old() {
        let folder = tempfile::tempdir().unwrap();
        let [completed, other] = ["p-completed", "q-other"].map(|name| begun(folder.path(), name));
        std::thread::scope(|scope| {
            let path = completed.clone();
            scope.spawn(move || {
                std::thread::sleep(Duration::from_millis(50));
                std::fs::set_permissions(path, Permissions::from_mode(0o600)).unwrap();
            });
            clear_unborn_in(folder.path(), "p-");
        });
        assert!(completed.exists() && other.exists());
    }

    #[test]
    fn a_segment_that_nobody_completes_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let left = ["p-begun", "p-empty"].map(|name| begun(folder.path(), name));
        std::fs::set_permissions(&left[1], Permissions::from_mode(0o600)).unwrap();
        File::options()
            .write(true)
            .open(&left[1])
            .and_then(|file| file.set_len(0))
            .unwrap();
        clear_unborn_in(folder.path(), "p-");
        assert!(left.iter().all(|file| !file.exists()));
    }

    /// Domains share the folder of nodes: an empty one there may belong to any.
    #[test]
    fn remains_of_nodes_go_and_those_of_other_domains_stay() {
        let root = tempfile::tempdir().unwrap();
        let folder = crate::folder::BusFolder {
            path: root.path().to_path_buf(),
            prefix: "p-".to_owned(),
        };
        let config = crate::domain::configuration(&folder).unwrap();
        let nodes = path(&config.global.node_dir());
        let hour_ago = SystemTime::now() - Duration::from_secs(3600);
        let old_folder = |id: &str| {
            let folder = nodes.join(id);
            std::fs::create_dir_all(&folder).unwrap();
            let opened = File::open(&folder).unwrap();
            opened.set_modified(hour_ago).unwrap();
            folder
        };
        let [unmonitored, monitored_by_other, incomplete] = ["11", "22", "33"].map(old_folder);
        let [of_other, without_folder, with_folder] =
            ["q-22.node_monitor", "p-44.node_monitor", "p-33.node_monitor"].map(|name| begun(&nodes, name));
        let young = nodes.join("55");
        std::fs::create_dir(&young).unwrap();
        clear_unborn_nodes(&config, LEFT_AFTER);
        assert!(!unmonitored.exists() && !without_folder.exists());
        assert!(!incomplete.exists() && !with_folder.exists());
        assert!(monitored_by_other.exists() && of_other.exists() && young.exists());
    }
}

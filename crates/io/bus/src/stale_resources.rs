//! What killed processes leave and iceoryx2 0.10.0 does not clear away by itself.
//!
//! Five things stay for ever where a process dies within the microseconds in which it makes them:
//! - the description of a service that was written but not released: every later opening waits for it and fails;
//! - the folder of a node in which a tag was begun: every later cleaning stumbles over it;
//! - the folder of a node that has no monitor yet: nobody looks for it;
//! - the files of a node whose monitor is not whole: nobody can tell whether it lives;
//! - a segment of shared memory that has no size (any more): who opens it waits for its size without end.
//!
//! What is half made is told by its mode: iceoryx2 makes a file read-only, a segment readable, when it is complete.
//!
//! Only cores make services, and they do so under the [`OpeningLock`]: who holds it knows that whatever is half
//! made was left.

use crate::domain::Ipc;
use crate::error::BusError;
use core::time::Duration;
use iceoryx2::node::NodeView;
use iceoryx2::prelude::*;
use iceoryx2::service::service_hash::ServiceHash;
use std::collections::BTreeSet;
use std::fs::{File, Metadata, TryLockError, read_dir, remove_dir, remove_file};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path as StdPath, PathBuf};
use std::time::Instant;

/// Lets one core at a time open its services. The operating system gives it back when the process dies.
#[derive(Debug)]
pub(crate) struct OpeningLock {
    _folder: File,
}

impl OpeningLock {
    /// Waits for the lock on iceoryx2's folder, which must exist.
    pub(crate) fn acquire(config: &Config, deadline: Instant) -> Result<Self, BusError> {
        let folder = path(config.global.root_path());
        let failed = |cause: String| BusError::Domain { cause };
        let file = File::open(&folder).map_err(|cause| failed(format!("{}: {cause}", folder.display())))?;
        loop {
            match file.try_lock() {
                Ok(()) => return Ok(Self { _folder: file }),
                Err(TryLockError::Error(cause)) => {
                    return Err(failed(format!("{}: {cause}", folder.display())));
                }
                Err(TryLockError::WouldBlock) if Instant::now() >= deadline => {
                    return Err(failed("another core hangs while it opens".to_owned()));
                }
                Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(2)),
            }
        }
    }
}

/// Removes segments of shared memory whose maker died before they had a size. iceoryx2 would wait for one without end,
/// so this comes before anything else is asked of it.
///
/// A living maker is in that state for microseconds; what is younger than a quarter of a second is waited for.
pub(crate) fn clear_unborn_segments(config: &Config) {
    const AGE: Duration = Duration::from_millis(250);
    let prefix = config.global.prefix.to_string();
    for file in files(StdPath::new("/dev/shm")).filter(|file| begins_with(file, &prefix)) {
        let age = || match file.metadata() {
            Ok(facts) if is_unborn(&facts) => facts.modified().ok()?.elapsed().ok(),
            _ => None,
        };
        let Some(rest) = age().map(|age| AGE.saturating_sub(age)) else {
            continue;
        };
        std::thread::sleep(rest);
        if age().is_some() {
            let _ = remove_file(&file);
        }
    }
}

/// Removes the description of a service that was begun and not finished. The lock must be held.
pub(crate) fn clear_half_made_service(
    _lock: &OpeningLock,
    config: &Config,
    name: &ServiceName,
    pattern: MessagingPattern,
) {
    let file = service_file(config, name, pattern);
    if is_half_made(&file) {
        // Where it cannot be removed, opening fails and says so.
        let _ = remove_file(file);
    }
}

/// Where a service is described.
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

/// Removes the folders of dead nodes that iceoryx2's own cleaning has left, where nothing in them is complete and
/// so nothing depends on them.
pub(crate) fn clear_dead_nodes(config: &Config) {
    let mut dead = Vec::new();
    // A domain that cannot be listed keeps its files; nothing else depends on it.
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
        for file in files(&folder).filter(|file| begins_with(file, &prefix)) {
            let _ = remove_file(file);
        }
        // The monitor goes last: without it nobody would find the rest again.
        if remove_dir(&folder).is_ok() || !folder.exists() {
            let monitor = format!("{prefix}{id}.");
            for file in files(&nodes).filter(|file| begins_with(file, &monitor)) {
                let _ = remove_file(file);
            }
        }
    }
}

/// Nobody makes a node this slowly: what is older and still not whole was left.
pub(crate) const LEFT_AFTER: Duration = Duration::from_secs(60);

/// Removes what is left of nodes that died before they could be seen: described, but without a monitor that tells whether they
/// live. A living node is in that state for less than a millisecond; only what is at least this old is taken for left.
///
/// Folders bear no prefix, and domains share the folder they lie in. One in which nothing lies may be anybody's: it goes
/// with its monitor, and where it has none, once it is so old that nobody can be making it.
pub(crate) fn clear_unborn_nodes(config: &Config, at_least: Duration) {
    let nodes = path(&config.global.node_dir());
    let prefix = config.global.prefix.to_string();
    // Some monitors are complete and tell nothing all the same: their maker died before it held their lock.
    let mut told = Vec::new();
    let listed = Node::<Ipc>::list(config, |state| {
        if !matches!(state, NodeState::Undefined(_)) {
            told.push(state.node_id().value().to_string());
        }
        CallbackProgression::Continue
    });
    let suffix = config.global.node.monitor_suffix.to_string();
    for id in node_numbers(&nodes, &prefix, &suffix) {
        let folder = nodes.join(&id);
        let monitor = format!("{prefix}{id}{suffix}");
        let monitors: Vec<PathBuf> = files(&nodes).filter(|file| begins_with(file, &monitor)).collect();
        let content: Vec<PathBuf> = files(&folder).collect();
        let age_that_counts = match (content.is_empty(), monitors.is_empty()) {
            (false, _) if !content.iter().all(|file| begins_with(file, &prefix)) => continue,
            (true, true) if is_monitored(&nodes, &id, &suffix) => continue,
            (true, true) => at_least.max(LEFT_AFTER),
            _ => at_least,
        };
        let is_old = |file: &StdPath| {
            let made = file.metadata().and_then(|facts| facts.modified());
            // A clock that was set back makes it look younger: it is taken later.
            made.is_ok_and(|made| made.elapsed().is_ok_and(|age| age >= age_that_counts))
        };
        // Of some, the folder is gone and the monitor is not.
        let is_left = if folder.is_dir() {
            is_old(&folder)
        } else {
            monitors.iter().all(|file| is_old(file))
        };
        // Its owner may not read a monitor that is being made.
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
        // The monitor goes last: without it nobody would know whose the folder is.
        if remove_dir(&folder).is_ok() || !folder.exists() {
            for file in monitors {
                let _ = remove_file(file);
            }
        }
    }
}

/// Numbers of nodes that have a folder, or a monitor with this prefix.
fn node_numbers(nodes: &StdPath, prefix: &str, suffix: &str) -> BTreeSet<String> {
    read_dir(nodes)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| {
            let name = entry.file_name().to_str()?.to_owned();
            if entry.path().is_dir() {
                return Some(name);
            }
            let (id, _) = name.strip_prefix(prefix)?.split_once(suffix)?;
            (!id.is_empty() && id.bytes().all(|byte| byte.is_ascii_digit())).then(|| id.to_owned())
        })
        .collect()
}

/// Whether any domain has a monitor of this node.
fn is_monitored(nodes: &StdPath, id: &str, suffix: &str) -> bool {
    let monitor = format!("{id}{suffix}");
    files(nodes).any(|file| {
        file.file_name()
            .is_some_and(|name| name.to_string_lossy().contains(&monitor))
    })
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

/// iceoryx2 keeps a segment and a monitor unreadable, for its owner too, while it makes them. One that is readable and has
/// no size was cut off: who opens it would wait for its size without end.
fn is_unborn(facts: &Metadata) -> bool {
    facts.permissions().mode() & 0o400 == 0 || facts.len() == 0
}

fn begins_with(file: &StdPath, prefix: &str) -> bool {
    file.file_name()
        .is_some_and(|name| name.to_string_lossy().starts_with(prefix))
}

fn files(folder: &StdPath) -> impl Iterator<Item = PathBuf> {
    read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.is_file())
}

fn path(path: &Path) -> PathBuf {
    PathBuf::from(path.to_string())
}

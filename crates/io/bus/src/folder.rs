//! The folder of the bus: where iceoryx2 keeps its files, and who owns it.
//!
//! iceoryx2's own default is `/tmp/iceoryx2`, one folder for everybody, owned by the first user. Here each
//! user has a folder that nobody else can write to. Segments of shared memory are always in `/dev/shm`, which
//! belongs to everybody, so their names start with a number derived from the folder's path and inode: two
//! folders never share a segment, and a name cannot be taken before its folder exists.

use std::fs::{DirBuilder, Metadata};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use crate::error::BusError;

/// Environment variable: a folder to use instead, which must be this user's.
pub const RUNTIME_FOLDER: &str = "EVOLVENT_RUNTIME_DIR";

/// A service manager makes this for the user of the service (`RuntimeDirectory=evolvent`).
const SERVICE_FOLDER: &str = "/run/evolvent";

/// Parent of the users' folders that logind creates and removes.
const SESSION_FOLDERS: &str = "/run/user";

/// Shared memory of all users.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";

/// Start of the segment names if no prefix is given.
const DEFAULT_PREFIX: &str = "evolvent-";

/// Names of sockets are at most 107 bytes long, and iceoryx2 appends 37 to folder and prefix.
const MAX_FOLDER_AND_PREFIX: usize = 70;

/// The user of this process.
pub(crate) fn this_user() -> u32 {
    rustix::process::geteuid().as_raw()
}

/// A folder of this user that has been checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct BusFolder {
    pub(crate) path: PathBuf,
    /// Start of the segment names.
    pub(crate) prefix: String,
}

impl BusFolder {
    /// The folder in which a core of this user opens its services, created if necessary.
    pub(crate) fn of_core(prefix: Option<&str>) -> Result<Self, BusError> {
        check_prefix(prefix)?;
        let candidates = candidates()?;
        // There always is one: the last needs only /dev/shm.
        let first = candidates.into_iter().next().unwrap_or_else(last_resort);
        Self::enter(&first, prefix)
    }

    /// Every existing folder of this user: a core that was started in a session and one that was not use
    /// different ones. A folder taken by another user is an error only if there is no other.
    pub(crate) fn existing(prefix: Option<&str>) -> Result<Vec<Self>, BusError> {
        check_prefix(prefix)?;
        let (mut found, mut wrong) = (Vec::new(), None);
        for path in candidates()? {
            if path.symlink_metadata().is_ok() {
                match Self::enter(&path, prefix) {
                    Ok(folder) => found.push(folder),
                    Err(error) => wrong = wrong.or(Some(error)),
                }
            }
        }
        match wrong {
            Some(error) if found.is_empty() => Err(error),
            _ => Ok(found),
        }
    }

    /// Checks a folder, creating it if necessary.
    fn enter(path: &Path, prefix: Option<&str>) -> Result<Self, BusError> {
        let failed = |reason: String| BusError::Folder {
            path: path.display().to_string(),
            reason,
        };
        match DirBuilder::new().mode(0o700).create(path) {
            Ok(()) => {}
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(error) => {
                return Err(failed(format!(
                    "cannot be created ({error}): create it, or name another folder in {RUNTIME_FOLDER}"
                )));
            }
        }
        // Not through a link, whose target may change.
        let facts = path
            .symlink_metadata()
            .map_err(|error| failed(format!("cannot be examined ({error})")))?;
        check(&facts, this_user()).map_err(&failed)?;
        let prefix = full_prefix(prefix, path, &facts);
        if path.as_os_str().len() + 1 + prefix.len() > MAX_FOLDER_AND_PREFIX {
            return Err(failed(format!(
                "and the prefix {prefix} are longer than {MAX_FOLDER_AND_PREFIX} bytes together, which is \
                 too long for \
                 sockets: shorten the prefix, or name a shorter folder in {RUNTIME_FOLDER}"
            )));
        }
        Ok(Self {
            path: path.to_owned(),
            prefix,
        })
    }
}

/// Possible folders of this user; a core uses the first.
fn candidates() -> Result<Vec<PathBuf>, BusError> {
    if let Some(path) = std::env::var_os(RUNTIME_FOLDER).filter(|path| !path.is_empty()) {
        let path = PathBuf::from(path);
        if !path.is_absolute() || path.to_str().is_none() {
            return Err(BusError::Folder {
                path: path.display().to_string(),
                reason: format!("in {RUNTIME_FOLDER} is not an absolute UTF-8 path: use one"),
            });
        }
        return Ok(vec![path]);
    }
    let user = this_user();
    let is_ours = |path: &Path| {
        path.symlink_metadata()
            .is_ok_and(|facts| facts.is_dir() && facts.uid() == user)
    };
    let mut found = Vec::new();
    if is_ours(Path::new(SERVICE_FOLDER)) {
        found.push(PathBuf::from(SERVICE_FOLDER));
    }
    // `su` and `sudo -E` pass on the variable of another user.
    let session = std::env::var_os("XDG_RUNTIME_DIR")
        .map(PathBuf::from)
        .filter(|path| path.is_absolute() && path.to_str().is_some() && is_ours(path))
        .or_else(|| Some(Path::new(SESSION_FOLDERS).join(user.to_string())).filter(|path| is_ours(path)));
    found.extend(session.map(|path| path.join("evolvent")));
    found.push(last_resort());
    Ok(found)
}

fn last_resort() -> PathBuf {
    Path::new(SHARED_MEMORY).join(format!("evolvent-{}", this_user()))
}

/// Whether a folder may be used.
fn check(facts: &Metadata, user: u32) -> Result<(), String> {
    if !facts.is_dir() {
        return Err(format!(
            "is not a folder; {} created it: let that user or root remove it",
            user_name(facts.uid())
        ));
    }
    if facts.uid() != user {
        let owner = user_name(facts.uid());
        return Err(format!(
            "belongs to {owner} and not to {}: run this as {owner}, or let {owner} or root remove it, or \
             name your own folder in {RUNTIME_FOLDER}",
            user_name(user)
        ));
    }
    let mode = facts.permissions().mode() & 0o777;
    if mode & 0o022 != 0 {
        return Err(format!(
            "may be written to by others (mode {mode:03o}), who could stop every client: `chmod 700` it"
        ));
    }
    Ok(())
}

/// Start of the segment names: the given prefix and eight digits of this folder.
fn full_prefix(prefix: Option<&str>, path: &Path, facts: &Metadata) -> String {
    let prefix = prefix.unwrap_or(DEFAULT_PREFIX);
    let identity = format!("{}:{}:{}", path.display(), facts.dev(), facts.ino());
    // FNV-1a, 32 bits: clients in other languages compute it too.
    let hash = identity.bytes().fold(0x811c_9dc5_u32, |hash, byte| {
        (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
    });
    format!("{prefix}{hash:08x}-")
}

fn check_prefix(prefix: Option<&str>) -> Result<(), BusError> {
    let good = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    match prefix {
        Some(prefix) if prefix.is_empty() || prefix.len() > 32 || !prefix.chars().all(good) => {
            Err(BusError::Prefix {
                prefix: prefix.chars().take(64).collect(),
            })
        }
        _ => Ok(()),
    }
}

/// The name in the system's list of users.
pub(crate) fn login_name(user: u32) -> Option<String> {
    let list = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    list.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(user)).then(|| name.to_owned())
    })
}

/// `user evolvent (998)`, if the system's list of users has the name.
pub(crate) fn user_name(user: u32) -> String {
    login_name(user).map_or_else(|| format!("user {user}"), |name| format!("user {name} ({user})"))
}

/// Other users that have services with this prefix on this computer, found by their segments, which are
/// visible to everybody.
pub(crate) fn other_users(prefix: Option<&str>) -> Vec<u32> {
    let prefix = prefix.unwrap_or(DEFAULT_PREFIX);
    let user = this_user();
    let mut others: Vec<u32> = std::fs::read_dir(SHARED_MEMORY)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            name.starts_with(prefix) && name.ends_with(".dynamic")
        })
        .filter_map(|entry| entry.path().symlink_metadata().ok())
        .map(|facts| facts.uid())
        .filter(|owner| *owner != user)
        .collect();
    others.sort_unstable();
    others.dedup();
    others
}

/// The existing folders of this user's bus, and the start of the segment names in each, for tools that look
/// for leftovers.
///
/// # Errors
/// A folder taken by another user, or an invalid prefix.
pub fn bus_folders(prefix: Option<&str>) -> Result<Vec<(PathBuf, String)>, BusError> {
    let folders = BusFolder::existing(prefix)?;
    Ok(folders
        .into_iter()
        .map(|folder| (folder.path, folder.prefix))
        .collect())
}

/// Folders that a client of this user's bus writes to, for a process that gives up all others afterwards.
/// Creates the folder that a core uses first if it is missing. Reads iceoryx2's configuration, which is in
/// another folder, now.
///
/// # Errors
/// The folder belongs to another user, or the prefix is invalid.
pub fn writable_folders(prefix: Option<&str>) -> Result<Vec<PathBuf>, BusError> {
    let first = BusFolder::of_core(prefix)?;
    crate::domain::configuration(&first)?;
    let folders = BusFolder::existing(prefix)?.into_iter().map(|folder| folder.path);
    // Segments of shared memory are there for every folder.
    Ok(folders.chain([PathBuf::from(SHARED_MEMORY)]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts(folder: &Path) -> Metadata {
        folder.symlink_metadata().unwrap()
    }

    #[test]
    fn a_folder_of_another_or_open_to_others_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let user = this_user();
        assert_eq!(check(&facts(folder.path()), user), Ok(()));
        let complaint = check(&facts(folder.path()), user + 1).unwrap_err();
        assert!(
            complaint.contains("belongs to user") && complaint.contains(RUNTIME_FOLDER),
            "{complaint}"
        );
        for (mode, is_good) in [
            (0o700, true),
            (0o755, true),
            (0o770, false),
            (0o702, false),
            (0o777, false),
        ] {
            std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(mode)).unwrap();
            let checked = check(&facts(folder.path()), user);
            assert_eq!(checked.is_ok(), is_good, "{mode:o} {checked:?}");
        }
    }

    #[test]
    fn a_link_is_no_folder_wherever_it_points() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(folder.path(), &link).unwrap();
        assert!(matches!(
            BusFolder::enter(&link, None),
            Err(BusError::Folder { .. })
        ));
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        assert!(matches!(
            BusFolder::enter(&file, None),
            Err(BusError::Folder { .. })
        ));
    }

    #[test]
    fn every_folder_has_a_prefix_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let first = BusFolder::enter(&path, Some("p-")).unwrap();
        assert_eq!(facts(&path).permissions().mode() & 0o777, 0o700);
        assert_eq!(
            BusFolder::enter(&path, Some("p-")).unwrap(),
            first,
            "as long as it is there"
        );
        let other = BusFolder::enter(&folder.path().join("b"), Some("p-")).unwrap();
        assert_ne!(other.prefix, first.prefix);
        assert!(
            first.prefix.starts_with("p-") && first.prefix.len() == 11,
            "{}",
            first.prefix
        );
    }
}

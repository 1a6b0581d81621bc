//! iceoryx2's node counter: the one segment whose name is known beforehand and whose mode iceoryx2 sets to
//! 0666.
//!
//! iceoryx2 0.10.0 keeps a counter of nodes per prefix and maps it whenever a node is created. With its mode
//! anybody may truncate it, and then every client of every user waits for its size forever. So it is created
//! here, complete and for its owner only, before iceoryx2 looks for it; one of another user is never mapped.

use std::fs::{File, OpenOptions, Permissions, hard_link, remove_file};
use std::io::Write;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use crate::error::BusError;
use crate::folder::{SHARED_MEMORY, this_user, user_name};

/// iceoryx2 puts the SHA-1 of the payload's type name, `iceoryx2::node::global_management_segment::State`,
/// into the file's name.
const NAME: &str = "9204dd183d1c4d8e1ff592a30766ffa6765aa8b5_node.0_10_0.global_mgmt";

/// iceoryx2's version, by which a reader recognizes a complete segment: major, minor, patch in 16 bits each.
const VERSION: u64 = 10 << 16;

/// End of the names of such segments.
const SUFFIX: &str = ".global_mgmt";

/// Creates the counter of a prefix, or checks and repairs the existing one.
pub(crate) fn secure(prefix: &str) -> Result<(), BusError> {
    secure_in(Path::new(SHARED_MEMORY), prefix)
}

fn secure_in(folder: &Path, prefix: &str) -> Result<(), BusError> {
    let path = folder.join(format!("{prefix}{NAME}"));
    // Another process may remove or create it meanwhile; that does not happen three times in a row.
    for _ in 0..3 {
        check_all(folder, prefix)?;
        if path.symlink_metadata().is_ok() {
            return Ok(());
        }
        make(&path).map_err(|error| BusError::Domain {
            cause: format!("{}: {error}", path.display()),
        })?;
    }
    Ok(())
}

/// Checks owner and mode of every counter of a prefix; with another compiler iceoryx2's own may have another
/// name.
pub(crate) fn check(prefix: &str) -> Result<(), BusError> {
    check_all(Path::new(SHARED_MEMORY), prefix)
}

fn check_all(folder: &Path, prefix: &str) -> Result<(), BusError> {
    let entries = folder.read_dir().into_iter().flatten().flatten();
    for entry in entries {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with(prefix) && name.ends_with(SUFFIX) {
            check_one(&entry.path())?;
        }
    }
    Ok(())
}

fn check_one(path: &Path) -> Result<(), BusError> {
    let Ok(facts) = path.symlink_metadata() else {
        return Ok(());
    };
    if facts.uid() != this_user() || !facts.is_file() {
        return Err(BusError::Foreign {
            path: path.display().to_string(),
            owner: user_name(facts.uid()),
        });
    }
    // A truncated counter counts nothing; one without a size makes its readers wait forever. Owned by this
    // user, it may be replaced: node numbers also contain the process's number and time.
    if facts.len() < 16 {
        let _gone = remove_file(path);
        return Ok(());
    }
    if facts.permissions().mode() & 0o077 != 0 {
        let _gone = File::open(path).and_then(|file| file.set_permissions(Permissions::from_mode(0o600)));
    }
    Ok(())
}

/// Creates it under another name first, so that it is never visible in part.
fn make(path: &Path) -> std::io::Result<()> {
    let aside = aside(path);
    let mut file = OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(&aside)?;
    let mut bytes = [0; 16];
    bytes[..8].copy_from_slice(&VERSION.to_ne_bytes());
    let made = file.write_all(&bytes).and_then(|()| hard_link(&aside, path));
    let _gone = remove_file(&aside);
    match made {
        Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => Ok(()),
        made => made,
    }
}

fn aside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    let thread = std::thread::current().id();
    name.push(format!(".{}-{thread:?}.new", std::process::id()).replace(['(', ')'], ""));
    PathBuf::from(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_counter_is_complete_and_its_owners_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(format!("p-{NAME}"));
        secure_in(folder.path(), "p-").unwrap();
        assert_eq!(
            std::fs::read(&path).unwrap(),
            [0, 0, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
        );
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(folder.path().read_dir().unwrap().count(), 1, "nothing left aside");
    }

    #[test]
    fn one_that_is_open_or_cut_off_is_repaired() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(format!("p-{NAME}"));
        for (bytes, mode) in [(16, 0o666), (0, 0o666), (0, 0o600), (7, 0o600)] {
            std::fs::write(&path, vec![1; bytes]).unwrap();
            std::fs::set_permissions(&path, Permissions::from_mode(mode)).unwrap();
            secure_in(folder.path(), "p-").unwrap();
            let facts = path.metadata().unwrap();
            assert_eq!((facts.len(), facts.permissions().mode() & 0o777), (16, 0o600));
        }
    }

    #[test]
    fn what_is_no_file_of_this_user_is_never_used() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(format!("p-{NAME}"));
        std::os::unix::fs::symlink("/etc/hostname", &path).unwrap();
        let error = secure_in(folder.path(), "p-").unwrap_err();
        assert!(matches!(error, BusError::Foreign { .. }), "{error}");
        assert!(secure_in(folder.path(), "q-").is_ok(), "another prefix");
    }
}

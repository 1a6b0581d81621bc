use std::ffi::OsString;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use crate::output_file::is_stream;

/// Why files cannot be written under their names: one would replace another.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum OutputConflict {
    /// An output is a file that is read.
    #[error("{} is {what} itself; name another file to write to", path.display())]
    Input {
        /// The output.
        path: PathBuf,
        /// Description of the input, for example "the program".
        what: String,
    },
    /// Two outputs are the same file.
    #[error("{} and {} are one file, named for two outputs; name two files", first.display(), path.display())]
    Twice {
        /// The first output.
        first: PathBuf,
        /// The second output.
        path: PathBuf,
    },
    /// An output is a folder.
    #[error("{} is a folder; name another file to write to", path.display())]
    Folder {
        /// The output.
        path: PathBuf,
    },
}

/// Compares the files that a command writes with those that it reads, and with each other, before anything is
/// written.
///
/// Files are equal if device and inode are equal: other spellings of the path and links of both kinds name
/// the same file. Devices, pipes and sockets are exempt: several outputs may name the same one.
///
/// ```
/// # let folder = tempfile::tempdir()?;
/// # let job = folder.path().join("job.toml");
/// # std::fs::write(&job, "")?;
/// use evolvent_config::check_outputs;
/// let same = folder.path().join("./job.toml");
/// let error = check_outputs([same.as_path()], [(job.as_path(), "the job file")]).unwrap_err();
/// assert!(error.to_string().ends_with("is the job file itself; name another file to write to"));
/// # Ok::<(), std::io::Error>(())
/// ```
///
/// # Errors
/// [`OutputConflict`], with the first output that is in conflict.
pub fn check_outputs<'a>(
    outputs: impl IntoIterator<Item = &'a Path>,
    inputs: impl IntoIterator<Item = (&'a Path, &'a str)>,
) -> Result<(), OutputConflict> {
    let inputs: Vec<_> = inputs
        .into_iter()
        .map(|(path, what)| (Identity::of(path), what))
        .collect();
    let mut earlier: Vec<(Identity, &Path)> = Vec::new();
    for output in outputs {
        let path = output.to_owned();
        if output.is_dir() {
            return Err(OutputConflict::Folder { path });
        }
        if is_stream(output) {
            continue;
        }
        let own = Identity::of(output);
        if let Some((_, what)) = inputs.iter().find(|(input, _)| *input == own) {
            let what = (*what).to_owned();
            return Err(OutputConflict::Input { path, what });
        }
        if let Some((_, first)) = earlier.iter().find(|(other, _)| *other == own) {
            let first = (*first).to_owned();
            return Err(OutputConflict::Twice { first, path });
        }
        earlier.push((own, output));
    }
    Ok(())
}

/// The identity of the file that a path names.
#[derive(Debug, PartialEq, Eq)]
enum Identity {
    /// Device and inode.
    File(u64, u64),
    /// An unused name in a folder, by device and inode of the folder.
    Free(u64, u64, OsString),
    /// A path in a folder that does not exist or cannot be examined.
    Unknown(PathBuf),
}

impl Identity {
    fn of(path: &Path) -> Self {
        if let Ok(found) = std::fs::metadata(path) {
            return Self::File(found.dev(), found.ino());
        }
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        match (
            std::fs::metadata(folder.unwrap_or(Path::new("."))),
            path.file_name(),
        ) {
            (Ok(folder), Some(name)) => Self::Free(folder.dev(), folder.ino(), name.to_owned()),
            _ => Self::Unknown(path.to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_file_is_found_under_all_its_names() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("inner")).unwrap();
        std::fs::write(at("a"), "").unwrap();
        std::fs::hard_link(at("a"), at("hard")).unwrap();
        std::os::unix::fs::symlink(at("a"), at("soft")).unwrap();
        for same in ["a", "./a", "inner/../a", "hard", "soft"] {
            let output = at(same);
            let input = at("a");
            let error = check_outputs([output.as_path()], [(input.as_path(), "the trace")]);
            assert!(
                matches!(&error, Err(OutputConflict::Input { what, .. }) if what == "the trace"),
                "{same}: {error:?}"
            );
        }
        // Neither of the two exists yet.
        let (new, again) = (at("new"), at("inner/../new"));
        let error = check_outputs([new.as_path(), &again], []).unwrap_err();
        assert!(matches!(error, OutputConflict::Twice { .. }), "{error}");
        let (x, y) = (at("no/x"), at("no/y"));
        assert_eq!(
            check_outputs([x.as_path(), &y, &new], [(at("a").as_path(), "it")]),
            Ok(())
        );
        let inner = at("inner");
        assert!(matches!(
            check_outputs([inner.as_path()], []),
            Err(OutputConflict::Folder { .. })
        ));
    }
}

//! The files of uploaded programs. Each upload has its own folder, so that the text of a loaded program never
//! changes: `programs/.UPLOAD/NAME`, where UPLOAD is its number. The folder also contains links to the other
//! programs, because subroutines are searched in the program's folder. `programs/NAME` is the newest program
//! of that name that the core has loaded.

use std::io;
use std::os::unix::fs::{MetadataExt, symlink};
use std::path::{Path, PathBuf};

/// Prefix of the names of files that are being received or replaced.
const PART: &str = ".upload-";

/// Folder of uploaded programs.
#[derive(Clone, Debug)]
pub(crate) struct ProgramStore {
    folder: PathBuf,
}

impl ProgramStore {
    /// The store below a state folder, without the remains of interrupted uploads.
    pub(crate) fn open(state_folder: &Path) -> io::Result<Self> {
        let folder = state_folder.join("programs");
        std::fs::create_dir_all(&folder)?;
        let folder = folder.canonicalize()?;
        for entry in std::fs::read_dir(&folder)? {
            let entry = entry?;
            if entry.file_name().to_string_lossy().starts_with(PART) {
                std::fs::remove_file(entry.path())?;
            }
        }
        Ok(Self { folder })
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// The file of an upload.
    pub(crate) fn file(&self, upload: u64, name: &str) -> PathBuf {
        self.of_upload(upload).join(name)
    }

    /// The newest file of a name that the core has loaded.
    pub(crate) fn newest(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    // Names of programs never begin with a dot.
    fn of_upload(&self, upload: u64) -> PathBuf {
        self.folder.join(format!(".{upload}"))
    }

    /// The file that receives an upload.
    pub(crate) fn part(&self, upload: u64) -> PathBuf {
        self.folder.join(format!("{PART}{upload}"))
    }

    /// The highest number of an upload so far.
    pub(crate) fn last_upload(&self) -> io::Result<u64> {
        Ok(self.uploads()?.into_iter().max().unwrap_or(0))
    }

    fn uploads(&self) -> io::Result<Vec<u64>> {
        let mut uploads = Vec::new();
        for entry in std::fs::read_dir(&self.folder)? {
            let entry = entry?;
            let number = entry
                .file_name()
                .to_string_lossy()
                .strip_prefix('.')
                .and_then(|text| text.parse().ok());
            if let Some(number) = number.filter(|_| entry.path().is_dir()) {
                uploads.push(number);
            }
        }
        Ok(uploads)
    }

    /// Moves a received upload to its file, whose path it returns.
    pub(crate) fn put(&self, upload: u64, name: &str) -> io::Result<PathBuf> {
        let file = self.file(upload, name);
        let own = self.of_upload(upload);
        std::fs::create_dir(&own)?;
        for entry in std::fs::read_dir(&self.folder)? {
            let other = entry?;
            let other_name = other.file_name();
            let is_program = !other_name.to_string_lossy().starts_with('.') && other.file_type()?.is_file();
            if is_program && other_name != name {
                symlink(Path::new("..").join(&other_name), own.join(&other_name))?;
            }
        }
        std::fs::rename(self.part(upload), &file)?;
        Ok(file)
    }

    /// Publishes an upload that the core has loaded: programs find it under its name. Uploads other than it
    /// and the one before are removed.
    pub(crate) fn accept(&self, upload: u64, name: &str) -> io::Result<()> {
        // Atomically, so that there is always a file of this name.
        let part = self.part(upload);
        std::fs::hard_link(self.file(upload, name), &part)?;
        std::fs::rename(&part, self.newest(name))?;
        let before = self.uploads()?.into_iter().filter(|&other| other < upload).max();
        self.keep(&[Some(upload), before])
    }

    /// Removes all uploads except these.
    pub(crate) fn keep(&self, uploads: &[Option<u64>]) -> io::Result<()> {
        for other in self.uploads()? {
            if !uploads.contains(&Some(other)) {
                self.remove(other)?;
            }
        }
        Ok(())
    }

    /// Removes an upload.
    pub(crate) fn remove(&self, upload: u64) -> io::Result<()> {
        std::fs::remove_dir_all(self.of_upload(upload))
    }

    /// Size of all stored programs, bytes.
    pub(crate) fn stored(&self) -> io::Result<u64> {
        let mut folders = vec![self.folder.clone()];
        folders.extend(self.uploads()?.into_iter().map(|upload| self.of_upload(upload)));
        let mut bytes = 0;
        for folder in &folders {
            for entry in std::fs::read_dir(folder)? {
                // Links are not followed; a file with two names counts half for each.
                let data = entry?.metadata()?;
                bytes += if data.is_file() {
                    data.len() / data.nlink().max(1)
                } else {
                    0
                };
            }
        }
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn store() -> (tempfile::TempDir, ProgramStore) {
        let folder = tempfile::tempdir().unwrap();
        let store = ProgramStore::open(folder.path()).unwrap();
        (folder, store)
    }

    fn put(store: &ProgramStore, upload: u64, name: &str, text: &str) -> PathBuf {
        std::fs::write(store.part(upload), text).unwrap();
        store.put(upload, name).unwrap()
    }

    #[test]
    fn the_text_of_a_loaded_program_never_changes() {
        let (_folder, store) = store();
        let first = put(&store, 1, "part.ngc", "first");
        store.accept(1, "part.ngc").unwrap();
        // The core rejects the next one.
        let second = put(&store, 2, "part.ngc", "second");
        let read = |file: &Path| std::fs::read_to_string(file).unwrap();
        assert_eq!((read(&first), read(&second)), ("first".into(), "second".into()));
        assert_eq!(read(&store.newest("part.ngc")), "first");
        store.remove(2).unwrap();
        assert_eq!(read(&first), "first");
        let third = put(&store, 3, "part.ngc", "third");
        store.accept(3, "part.ngc").unwrap();
        assert_eq!((read(&first), read(&third)), ("first".into(), "third".into()));
        assert_eq!(read(&store.newest("part.ngc")), "third");
    }

    #[test]
    fn subroutines_of_other_uploads_are_beside_a_program() {
        let (_folder, store) = store();
        put(&store, 1, "sub.ngc", "o<sub> sub");
        store.accept(1, "sub.ngc").unwrap();
        let main = put(&store, 2, "main.ngc", "o<sub> call");
        let beside = main.with_file_name("sub.ngc");
        assert_eq!(std::fs::read_to_string(&beside).unwrap(), "o<sub> sub");
        put(&store, 3, "sub.ngc", "o<sub> sub (new)");
        store.accept(3, "sub.ngc").unwrap();
        assert_eq!(std::fs::read_to_string(&beside).unwrap(), "o<sub> sub (new)");
    }

    #[test]
    fn what_is_stored_is_bounded_and_counted_once() {
        let (folder, store) = store();
        for upload in 1..=40 {
            put(&store, upload, "part.ngc", &"x".repeat(1000));
            store.accept(upload, "part.ngc").unwrap();
        }
        let mut kept = store.uploads().unwrap();
        kept.sort_unstable();
        assert_eq!(kept, [39, 40]);
        assert_eq!(store.stored().unwrap(), 2000);
        // Numbers continue after a restart, and remains are removed.
        std::fs::write(store.part(41), "half").unwrap();
        let again = ProgramStore::open(folder.path()).unwrap();
        assert_eq!(again.last_upload().unwrap(), 40);
        assert!(!again.part(41).exists());
    }
}

//! Data shared by all requests.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use evolvent_runtime::{Setup, TraceTo};
use tokio::sync::Semaphore;

use crate::chatter::ChatterCase;
use crate::dispatch::Dispatch;
use crate::hub::Hub;
use crate::program_store::ProgramStore;
use crate::programs::is_good_name;
use crate::turns::Turns;

/// Maximum number of program texts sent at the same time, each by a thread.
pub(crate) const MAX_TEXTS: usize = 16;

/// Maximum number of programmed paths sent at the same time, each by a thread.
pub(crate) const MAX_PROGRAMMED: usize = 4;

/// Data of every request.
pub(crate) struct Server {
    pub(crate) hub: Arc<Hub>,
    pub(crate) dispatch: Dispatch,
    pub(crate) setup: Setup,
    /// Uploaded programs; `None` if pages only watch.
    pub(crate) programs: Option<ProgramStore>,
    /// The service's state folder; `None` for the screen of a run.
    pub(crate) state_folder: Option<PathBuf>,
    /// Recorded runs that pages may read.
    pub(crate) traces: TraceTo,
    /// The only program of a run.
    pub(crate) run: Option<PathBuf>,
    /// Checks one program after another.
    pub(crate) checkers: Arc<Semaphore>,
    /// Plans one program at a time, in parallel with a check, for which its path must not wait.
    pub(crate) planners: Turns,
    /// Programmed paths sent at the same time: a page shows one within a second or two even if another waits
    /// for a plan.
    pub(crate) programmed: Turns,
    /// Texts of programs that are sent at the same time.
    pub(crate) texts: Turns,
    pub(crate) chatter: ChatterCase,
    /// Computes one approach at a time.
    pub(crate) restarts: Arc<Semaphore>,
    /// File of macros, and whether it must exist; `None` if pages only watch.
    pub(crate) macros: Option<(PathBuf, bool)>,
    /// Reads one trace at a time for pages that operate, and one for those that watch.
    pub(crate) readers: Turns,
    /// Disk space that copies of open traces occupy, bytes.
    pub(crate) copies: AtomicU64,
    /// Receives one upload after another.
    pub(crate) receiving: Semaphore,
    /// Number of the newest upload.
    pub(crate) uploads: AtomicU64,
    /// Number of the newest upload that the core has loaded; 0 before the first.
    pub(crate) loaded_upload: AtomicU64,
    pub(crate) is_encrypted: bool,
}

impl Server {
    /// The file of a program that pages may read, and the number of its text. With `upload`, only the text of
    /// that number.
    pub(crate) fn file_of(&self, name: &str, upload: Option<u64>) -> Option<(PathBuf, u64)> {
        if let Some(run) = &self.run {
            return (name_of(run) == name).then(|| (run.clone(), 0));
        }
        // The program that pages show, even if the core has rejected it or it is not an upload.
        let shown = self.hub.shown_program().0.filter(|shown| shown.name == name);
        if let Some(shown) = shown.filter(|shown| upload.is_none_or(|upload| upload == shown.upload)) {
            return shown.problem.is_none().then(|| (shown.file.into(), shown.upload));
        }
        let programs = self.programs.as_ref().filter(|_| is_good_name(name))?;
        let file = match upload {
            Some(upload) => programs.file(upload, name),
            None => programs.newest(name),
        };
        file.is_file().then(|| (file, upload.unwrap_or(0)))
    }
}

/// The number of a text in a request, which is the complete query.
pub(crate) fn upload_of(query: Option<&str>) -> Option<u64> {
    query?.parse().ok()
}

pub(crate) fn name_of(file: &Path) -> String {
    file.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

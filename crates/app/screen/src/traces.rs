//! Recorded runs for pages: listed here, and read by `evolvent-inspect` on a thread of low priority.

use std::fs::{File, Metadata};
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::UNIX_EPOCH;

use axum::extract::{Extension, Path as UrlPath, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use evolvent_inspect::{ComparedRun, compare_runs, recorded_jobs, report_data, report_page};
use evolvent_runtime::TraceTo;
use evolvent_trace::{TraceFile, recover};
use tokio::sync::oneshot;

use crate::gate::{Framed, Role};
use crate::messages::{TraceEntry, TraceJob};
use crate::programs::{background, is_good_name};
use crate::server::Server;
use crate::streaming::{body, streamed};

/// Maximum number of traces listed, newest first.
const MAX_LISTED: usize = 200;
/// Maximum number of jobs of a trace listed.
const MAX_LISTED_JOBS: usize = 500;
/// Maximum size of an open trace, which is read from a copy.
const MAX_COPY: u64 = 2 << 30;
/// Maximum number of waiting requests per role.
const MAX_WAITING: usize = 16;
/// Disk space that copies leave free for the recorder, the state and uploads.
const RESERVE: u64 = 1 << 30;
/// Prefix of the folders of copies.
const COPY_PREFIX: &str = ".reading-";
/// Ending of a trace that is being written.
const OPEN: &str = ".mcap.part";

const JSON: &str = "application/json";

/// Why a trace is not shown.
type Refusal = (StatusCode, String);

/// Removes copies left by a killed process.
pub(crate) fn remove_copies(state_folder: &Path) {
    let Ok(entries) = std::fs::read_dir(state_folder) else {
        return;
    };
    for entry in entries.flatten() {
        if entry.file_name().to_string_lossy().starts_with(COPY_PREFIX) {
            // A copy that cannot be removed does no harm.
            let _left = std::fs::remove_dir_all(entry.path());
        }
    }
}

pub(crate) async fn list(State(server): State<Arc<Server>>, Extension(role): Extension<Role>) -> Response {
    let listed = |server: &Server| serde_json::to_string(&listed(&server.traces)).map_err(unreadable);
    read(&server, role, JSON, listed).await
}

/// The jobs of a trace, programs and blocks of MDI; empty for a run of one program.
pub(crate) async fn jobs(
    State(server): State<Arc<Server>>,
    Extension(role): Extension<Role>,
    UrlPath((_key, name)): UrlPath<(String, String)>,
) -> Response {
    let jobs = move |server: &Server| {
        let trace = Readable::open(server, &name)?;
        let mut trace = TraceFile::open(&trace.file).map_err(unreadable)?;
        let period_s = (trace.info().run.as_ref()).map_or(0.0, |run| run.period_ns as f64 * 1e-9);
        let jobs = recorded_jobs(&mut trace).map_err(unreadable)?;
        let jobs: Vec<TraceJob> = jobs
            .iter()
            .filter(|job| job.is_program())
            .rev()
            .take(MAX_LISTED_JOBS)
            .map(|job| TraceJob {
                job: job.job,
                name: job.name(),
                start_s: job.sequence as f64 * period_s,
            })
            .collect();
        serde_json::to_string(&jobs).map_err(unreadable)
    };
    read(&server, role, JSON, jobs).await
}

pub(crate) async fn report(
    State(server): State<Arc<Server>>,
    Extension(role): Extension<Role>,
    UrlPath((_key, name)): UrlPath<(String, String)>,
) -> Response {
    let page = move |server: &Server| {
        let trace = Readable::open(server, &name)?;
        report_page(&trace.file).map_err(unreadable)
    };
    let mut response = read(&server, role, "text/html; charset=utf-8", page).await;
    response.extensions_mut().insert(Framed);
    response
}

pub(crate) async fn data(
    State(server): State<Arc<Server>>,
    Extension(role): Extension<Role>,
    UrlPath((_key, name)): UrlPath<(String, String)>,
) -> Response {
    let data = move |server: &Server| {
        let trace = Readable::open(server, &name)?;
        report_data(&trace.file).map_err(unreadable)
    };
    read(&server, role, JSON, data).await
}

/// Key; file and job of the first run; file and job of the second. Job 0 is all of a trace.
type TwoRuns = (String, String, u32, String, u32);

pub(crate) async fn comparison(
    State(server): State<Arc<Server>>,
    Extension(role): Extension<Role>,
    UrlPath((_key, a, job_a, b, job_b)): UrlPath<TwoRuns>,
) -> Response {
    let found = move |server: &Server| {
        let first = Readable::open(server, &a)?;
        // For two jobs of one session, an open trace is copied once.
        let second = (a != b).then(|| Readable::open(server, &b)).transpose()?;
        let b = second.as_ref().unwrap_or(&first);
        let found = compare_runs(first.run(job_a), b.run(job_b)).map_err(unreadable)?;
        serde_json::to_string(&found).map_err(unreadable)
    };
    read(&server, role, JSON, found).await
}

fn unreadable(error: impl std::fmt::Display) -> Refusal {
    (StatusCode::UNPROCESSABLE_ENTITY, error.to_string())
}

/// Reads on a separate thread, one request at a time, and sends the result from there. There is one large
/// result at a time for each role, however many clients ask and however slowly they receive it.
async fn read(
    server: &Arc<Server>,
    role: Role,
    kind: &'static str,
    work: impl FnOnce(&Server) -> Result<String, Refusal> + Send + 'static,
) -> Response {
    let Some(permit) = server.readers.take_behind(role, MAX_WAITING).await else {
        let text = "too many traces are being read; try again";
        return (StatusCode::TOO_MANY_REQUESTS, text).into_response();
    };
    let (outcome, receiver) = oneshot::channel();
    let of_thread = Arc::clone(server);
    let started = background("screen-traces", move || {
        match work(&of_thread) {
            Ok(text) => {
                let (writer, pieces) = body();
                if outcome.send(Ok(pieces)).is_ok() {
                    writer.hand_over_text(text);
                }
            }
            Err(refusal) => {
                // The page may have gone.
                let _gone = outcome.send(Err(refusal));
            }
        }
        drop(permit);
    });
    if let Err(error) = started {
        return (StatusCode::SERVICE_UNAVAILABLE, error.to_string()).into_response();
    }
    match receiver.await {
        Ok(Ok(pieces)) => streamed(kind, pieces),
        Ok(Err(refusal)) => refusal.into_response(),
        Err(_) => StatusCode::SERVICE_UNAVAILABLE.into_response(),
    }
}

/// The files that may be shown, newest first.
fn files(traces: &TraceTo) -> Vec<(PathBuf, Metadata)> {
    let candidates: Vec<PathBuf> = match traces {
        TraceTo::Nowhere => Vec::new(),
        TraceTo::File(file) => vec![evolvent_trace::part_path(file), file.clone()],
        TraceTo::Folder { folder, .. } => {
            let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
            entries.map(|entry| entry.path()).collect()
        }
    };
    let mut files: Vec<_> = candidates
        .into_iter()
        .filter(|file| {
            let name = name_of(file);
            is_good_name(&name) && (name.ends_with(".mcap") || name.ends_with(OPEN))
        })
        // Excludes symbolic links and devices.
        .filter_map(|file| Some((file.clone(), std::fs::symlink_metadata(&file).ok()?)))
        .filter(|(_, metadata)| metadata.is_file())
        .collect();
    files.sort_by_key(|(_, metadata)| std::cmp::Reverse(modified(metadata)));
    files
}

fn name_of(file: &Path) -> String {
    let name = file.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

fn modified(metadata: &Metadata) -> u64 {
    let since = metadata
        .modified()
        .unwrap_or(UNIX_EPOCH)
        .duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_millis() as u64)
}

fn listed(traces: &TraceTo) -> Vec<TraceEntry> {
    let entry = |(file, metadata): (PathBuf, Metadata)| {
        let name = name_of(&file);
        let entry = TraceEntry {
            is_open: name.ends_with(OPEN),
            name,
            bytes: metadata.len(),
            modified: modified(&metadata),
            ..TraceEntry::default()
        };
        if entry.is_open {
            return entry;
        }
        match TraceFile::open(&file) {
            Ok(trace) => {
                let info = trace.info();
                let run = info.run.clone().unwrap_or_default();
                TraceEntry {
                    machine: run.machine_name,
                    program: run.program_name,
                    started: info.start_time_ns / 1_000_000,
                    duration_s: info.duration_s(),
                    ..entry
                }
            }
            Err(error) => TraceEntry {
                problem: error.to_string(),
                ..entry
            },
        }
    };
    files(traces).into_iter().take(MAX_LISTED).map(entry).collect()
}

/// A readable trace: the file itself, or a complete copy of one that is being written.
struct Readable {
    file: PathBuf,
    /// Removed after reading.
    _copy: Option<tempfile::TempDir>,
}

/// Disk space reserved for a copy until it is made.
struct Reservation<'a> {
    taken: &'a AtomicU64,
    bytes: u64,
}

impl<'a> Reservation<'a> {
    /// Reserves space for a copy of `size` bytes and the complete trace made from it, if `free` bytes are
    /// left.
    fn take(taken: &'a AtomicU64, size: u64, free: u64) -> Result<Self, Refusal> {
        let bytes = size.saturating_mul(2);
        let before = taken.fetch_add(bytes, Ordering::Relaxed);
        // Released on drop from here on.
        let reservation = Self { taken, bytes };
        let needed = bytes.saturating_add(before).saturating_add(RESERVE);
        if free < needed {
            let text = format!(
                "it is being written, and the disk of the state folder has no space for a copy of it: {} \
                 MiB are free, {} MiB needed; read it when it has ended",
                free >> 20,
                needed >> 20
            );
            return Err((StatusCode::INSUFFICIENT_STORAGE, text));
        }
        Ok(reservation)
    }
}

impl Drop for Reservation<'_> {
    fn drop(&mut self) {
        self.taken.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// Bytes that a user can still write to the file system of a folder.
fn free_bytes(folder: &Path) -> std::io::Result<u64> {
    let metadata = rustix::fs::statvfs(folder)?;
    Ok(metadata.f_bavail.saturating_mul(metadata.f_frsize))
}

impl Readable {
    fn open(server: &Server, name: &str) -> Result<Self, Refusal> {
        let found = files(&server.traces)
            .into_iter()
            .find(|(file, _)| name_of(file) == name);
        let (file, metadata) = found.ok_or((StatusCode::NOT_FOUND, "there is no such trace".to_owned()))?;
        if !name.ends_with(OPEN) {
            return Ok(Self { file, _copy: None });
        }
        let folder = server.state_folder.as_deref().unwrap_or(Path::new("."));
        let free = free_bytes(folder).map_err(unreadable)?;
        let _reservation = Reservation::take(&server.copies, metadata.len(), free)?;
        Self::copy(&file, &metadata, folder).map_err(|error| {
            let text = format!("{name} is being written, and a copy of it cannot be read: {error}");
            (StatusCode::UNPROCESSABLE_ENTITY, text)
        })
    }

    fn run(&self, job: u32) -> ComparedRun<'_> {
        ComparedRun {
            trace: &self.file,
            job: (job > 0).then_some(job),
        }
    }

    /// A complete trace of the part of an open one that is on disk. Its recorder is not disturbed.
    fn copy(open: &Path, metadata: &Metadata, folder: &Path) -> std::io::Result<Self> {
        if metadata.len() > MAX_COPY {
            let text = format!(
                "it has more than {} GiB; read it when it has ended",
                MAX_COPY >> 30
            );
            return Err(std::io::Error::other(text));
        }
        let own = tempfile::Builder::new().prefix(COPY_PREFIX).tempdir_in(folder)?;
        let (torn, whole) = (own.path().join("torn.mcap.part"), own.path().join("present.mcap"));
        let mut from = File::open(open)?.take(metadata.len());
        let mut to = File::create(&torn)?;
        std::io::copy(&mut from, &mut to)?;
        to.flush()?;
        drop(to);
        recover(&torn, Some(&whole)).map_err(std::io::Error::other)?;
        std::fs::remove_file(&torn)?;
        Ok(Self {
            file: whole,
            _copy: Some(own),
        })
    }
}

/// The present time, ms since 1970.
#[cfg(test)]
fn now_ms() -> u64 {
    std::time::SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| since.as_millis() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_traces_are_listed_newest_first() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &[u8]| std::fs::write(folder.path().join(name), text).unwrap();
        write("old.mcap", b"no trace");
        std::thread::sleep(std::time::Duration::from_millis(20));
        write("now.mcap.part", b"");
        write("secret.txt", b"");
        write(".hidden.mcap", b"");
        std::os::unix::fs::symlink("/etc/passwd", folder.path().join("link.mcap")).unwrap();
        std::fs::create_dir(folder.path().join("folder.mcap")).unwrap();
        let traces = TraceTo::Folder {
            folder: folder.path().to_owned(),
            limit_bytes: 1 << 30,
        };
        let entries = listed(&traces);
        let names: Vec<_> = entries.iter().map(|entry| entry.name.as_str()).collect();
        assert_eq!(names, ["now.mcap.part", "old.mcap"]);
        assert!(entries[0].is_open && entries[0].problem.is_empty());
        assert!(!entries[1].is_open && !entries[1].problem.is_empty());
        assert!(entries[1].modified.abs_diff(now_ms()) < 600_000);
        assert!(listed(&TraceTo::Nowhere).is_empty());
        let gone = TraceTo::Folder {
            folder: folder.path().join("gone"),
            limit_bytes: 1 << 30,
        };
        assert!(listed(&gone).is_empty());
    }

    #[test]
    fn a_copy_leaves_room_for_the_recorder() {
        let taken = AtomicU64::new(0);
        let gib = 1 << 30;
        // 1 GiB twice, and 1 GiB that stays free.
        let first = Reservation::take(&taken, gib, 3 * gib).ok().unwrap();
        // A second copy needs the same again.
        let refused = Reservation::take(&taken, gib, 5 * gib - 1).err().unwrap();
        assert_eq!(refused.0, StatusCode::INSUFFICIENT_STORAGE);
        assert!(refused.1.contains("5120 MiB needed"), "{}", refused.1);
        let second = Reservation::take(&taken, gib, 5 * gib).ok().unwrap();
        drop((first, second));
        assert_eq!(taken.load(Ordering::Relaxed), 0);
        assert!(Reservation::take(&taken, gib, 3 * gib - 1).is_err());
        assert_eq!(taken.load(Ordering::Relaxed), 0);
        assert!(free_bytes(Path::new("/")).unwrap() > 0);
    }

    #[test]
    fn copies_that_a_killed_process_has_left_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join(".reading-abc")).unwrap();
        std::fs::create_dir(folder.path().join("programs")).unwrap();
        remove_copies(folder.path());
        assert!(!folder.path().join(".reading-abc").exists());
        assert!(folder.path().join("programs").exists());
    }
}

//! The path of a program for pages, in chunks: first the programmed path, within a second or two for a
//! million lines, then the planned path, which takes as many minutes.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::{Extension, Path as UrlPath, RawQuery, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use evolvent_analysis::{FeedWords, LimitClassifier, Limiting};
use evolvent_bus::flags;
use evolvent_runtime::{Controls, Job, Notice, RunObserver, Setup, run};
use tokio::sync::oneshot;

use crate::gate::Role;
use crate::kept::present_setup;
use crate::messages::{PathChunk, PathKind};
use crate::programmed_path::ProgrammedPath;
use crate::programs::{background, work_for_minutes};
use crate::server::{Server, upload_of};
use crate::streaming::{BodyWriter, body, streamed};

/// Vertices per chunk.
const CHUNK: usize = 16_384;
/// The first chunk is small, so that it is shown at once.
const FIRST_CHUNK: usize = 64;
/// A chunk that is not full is sent after this time, so a slow plan is drawn as it grows.
const CHUNK_TIME: Duration = Duration::from_millis(250);
/// Maximum number of vertices of the planned path: a program may loop forever.
const MAX_PLANNED: usize = 8_000_000;
/// Maximum number of vertices of the programmed path, of which a page keeps what the planned path has not
/// replaced.
const MAX_PROGRAMMED: usize = 4_000_000;
/// Number of commands between two checks that the page still receives, since commands may draw nothing.
const LOOK_COMMANDS: u32 = 4096;
/// Time between two vertices of the planned path, ns.
const VERTEX_NS: u64 = 8_000_000;

pub(crate) async fn path(
    State(server): State<Arc<Server>>,
    Extension(role): Extension<Role>,
    UrlPath((_key, name)): UrlPath<(String, String)>,
    RawQuery(query): RawQuery,
) -> Response {
    let Some((file, upload)) = server.file_of(&name, upload_of(query.as_deref())) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let Some(turn) = server.programmed.take(role).await else {
        return StatusCode::SERVICE_UNAVAILABLE.into_response();
    };
    let (writer, pieces) = body();
    let (sender, programmed) = oneshot::channel();
    let of_thread = Arc::clone(&server);
    let started = background("screen-path", move || {
        let setup = present_setup(&of_thread.setup, of_thread.state_folder.as_deref());
        let mut chunks = ChunkWriter::new(PathKind::Programmed, writer, FIRST_CHUNK);
        if send_programmed(&file, &setup, &mut chunks) {
            // The page may have gone.
            let _gone = sender.send((chunks.body, file, setup));
        }
        drop(turn);
    });
    if started.is_err() {
        return StatusCode::SERVICE_UNAVAILABLE.into_response();
    }
    tokio::spawn(async move {
        if let Ok((writer, file, setup)) = programmed.await {
            plan(server, role, name, upload, writer, file, setup).await;
        }
    });
    streamed("application/octet-stream", pieces)
}

/// Sends the planned path when it gets a turn.
async fn plan(
    server: Arc<Server>,
    role: Role,
    name: String,
    upload: u64,
    writer: BodyWriter,
    file: PathBuf,
    setup: Setup,
) {
    let turn = tokio::select! {
        turn = server.planners.take(role) => turn,
        () = writer.closed() => return,
    };
    // A dropped body reports to its page that it is incomplete.
    let _started = background("screen-plan", move || {
        work_for_minutes();
        let planned_s = send_planned(file, setup, ChunkWriter::new(PathKind::Planned, writer, CHUNK));
        if planned_s.is_some() {
            server.hub.tell_planned(&name, upload, planned_s);
        }
        drop(turn);
    });
}

/// Collects vertices and sends them in chunks.
struct ChunkWriter {
    kind: PathKind,
    body: BodyWriter,
    chunk: PathChunk,
    /// Maximum number of vertices of the present chunk.
    full: usize,
    sent_at: Instant,
    sent: usize,
}

impl ChunkWriter {
    fn new(kind: PathKind, body: BodyWriter, first: usize) -> Self {
        Self {
            kind,
            body,
            chunk: PathChunk::default(),
            full: first,
            sent_at: Instant::now(),
            sent: 0,
        }
    }

    /// Whether the chunk has to be sent: it is full, or its first vertex has waited.
    fn is_due(&self) -> bool {
        self.chunk.len() >= self.full || (self.full == CHUNK && self.sent_at.elapsed() >= CHUNK_TIME)
    }

    /// Sends the chunk; `replaced`: see [`PathChunk::take_bytes`]. Returns `false` if the page no longer
    /// receives.
    fn send(&mut self, replaced: u32) -> bool {
        self.sent += self.chunk.len();
        self.full = CHUNK;
        let is_received = self
            .body
            .hand_over(self.chunk.take_bytes(self.kind, replaced).into());
        self.sent_at = Instant::now();
        is_received
    }
}

/// Sends the programmed path; returns `false` if the page no longer receives.
fn send_programmed(file: &Path, setup: &Setup, writer: &mut ChunkWriter) -> bool {
    // The run reports a program that cannot be opened.
    let Ok(mut path) = ProgrammedPath::open(file, setup) else {
        return true;
    };
    let unplanned = Limiting::Nothing.index() as u8;
    for commands in 1_u32.. {
        let chunk = &mut writer.chunk;
        let goes_on = path.advance(&mut |vertex| {
            chunk.push(vertex.position, vertex.feed_mm_s, vertex.line, unplanned);
        });
        if !goes_on || writer.sent > MAX_PROGRAMMED {
            break;
        }
        if writer.is_due() && !writer.send(0) {
            return false;
        }
        if commands % LOOK_COMMANDS == 0 && writer.body.is_closed() {
            return false;
        }
    }
    writer.chunk.is_empty() || writer.send(0)
}

struct Quiet;

impl RunObserver for Quiet {
    fn progress(&mut self, _controls: &Controls) {}
    fn notice(&mut self, _notice: &Notice) {}
    fn note(&mut self, _text: &str) {}
}

/// Plans a program and sends its path while the page receives. Returns the planned time, s, if it reached the
/// end.
fn send_planned(file: PathBuf, setup: Setup, mut writer: ChunkWriter) -> Option<f64> {
    let every = (VERTEX_NS / setup.period_ns.max(1)).max(1);
    let job = Job::new(file, setup);
    let controls = Arc::new(Controls::new(1.0));
    let classifier = LimitClassifier::new(&job.setup.machine, job.setup.period_ns as f64 * 1e-9);
    // The run reports a program that cannot be opened.
    let mut feeds = FeedWords::open(&job.program, &job.setup).ok();
    let mut programmed = ProgrammedPath::open(&job.program, &job.setup).ok();
    let mut replaced = move |block| {
        let path = programmed.as_mut();
        path.map_or(0, |path| path.vertices_through(block))
    };
    let mut line = u32::MAX;
    let mut block = 0;
    let mut is_received = true;
    let outcome = run(&job, &controls, &mut Quiet, |setpoint| {
        if setpoint.sequence % every != 0 && setpoint.line == line {
            return;
        }
        (line, block) = (setpoint.line, setpoint.block);
        let [x, y, z] = [0, 1, 2].map(|axis| setpoint.position[axis] as f32);
        let is_rapid = setpoint.flags & flags::RAPID != 0;
        let feed = if is_rapid {
            -setpoint.feed_mm_s
        } else {
            setpoint.feed_mm_s
        };
        let word = feeds.as_mut().and_then(|feeds| feeds.at(block, setpoint.path_mm));
        let limit = classifier.classify(setpoint, word).index() as u8;
        writer.chunk.push([x, y, z], feed as f32, line, limit);
        if writer.is_due() && is_received {
            let is_enough = writer.sent > MAX_PLANNED;
            is_received = is_enough || writer.send(replaced(block));
            if is_enough || !is_received {
                controls.stop();
            }
        }
    });
    let is_whole = outcome
        .as_ref()
        .is_ok_and(|outcome| outcome.program.is_ok() && outcome.fault.is_none() && !controls.is_stopping());
    // Vertices after the last move belong to no block.
    let at_end = if is_whole { u32::MAX } else { replaced(block) };
    if is_received && writer.send(at_end) {
        writer.body.finish();
    }
    outcome
        .ok()
        .filter(|_| is_whole)
        .map(|outcome| outcome.summary.duration_s)
}

//! Programs from pages: received, stored, loaded, checked.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::{Extension, Path as UrlPath, State};
use axum::http::header::{CONTENT_LENGTH, CONTENT_TYPE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use evolvent_bus::ControlRequest;
use evolvent_control::{Alarm, CommandCode};
use futures_util::StreamExt;
use tokio::sync::mpsc;

use crate::gate::Role;
use crate::hub::Term;
use crate::messages::{LogFact, LogKind, ProgramInfo, Refusal};
use crate::orders::Answer;
use crate::program_store::ProgramStore;
use crate::programs::{background, checked, is_good_name};
use crate::routes::session_of;
use crate::server::Server;

/// Maximum size of a program, bytes.
pub(crate) const MAX_PROGRAM: u64 = 256 << 20;
/// Maximum size of all stored programs together, bytes.
const MAX_STORED: u64 = 4 << 30;
/// Maximum pause of an upload.
const PAUSE: Duration = Duration::from_secs(20);

/// Header with the number of the page that uploads.
const PAGE: &str = "evolvent-page";

type Refused = (StatusCode, Answer);

pub(crate) async fn upload(
    State(server): State<Arc<Server>>,
    Extension(role): Extension<Role>,
    UrlPath((_key, name)): UrlPath<(String, String)>,
    headers: HeaderMap,
    body: Body,
) -> Response {
    let (status, answer) = match store(&server, role, &name, &headers, body).await {
        Ok(answer) => (StatusCode::OK, answer),
        Err(refused) => refused,
    };
    let Answer {
        accepted,
        alarm,
        text,
        refusal,
    } = answer;
    let json = serde_json::json!({"accepted": accepted, "alarm": alarm, "text": text, "refusal": refusal});
    (status, [(CONTENT_TYPE, "application/json")], json.to_string()).into_response()
}

async fn store(
    server: &Arc<Server>,
    role: Role,
    name: &str,
    headers: &HeaderMap,
    body: Body,
) -> Result<Answer, Refused> {
    let refuse = |status, refusal: Refusal| Err((status, refusal.into()));
    let Some(programs) = server.programs.as_ref().filter(|_| role == Role::Operate) else {
        return refuse(StatusCode::FORBIDDEN, Refusal::WatchOnly);
    };
    let page = headers
        .get(PAGE)
        .and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
    let term = page
        .zip(session_of(headers))
        .and_then(|(page, session)| server.hub.term_of_request(page, &session));
    let Some(term) = term else {
        return refuse(StatusCode::FORBIDDEN, Refusal::NoControl);
    };
    if !is_good_name(name) {
        return refuse(StatusCode::BAD_REQUEST, Refusal::BadName);
    }
    let announced = headers
        .get(CONTENT_LENGTH)
        .and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
    if announced.is_some_and(|bytes| bytes > MAX_PROGRAM) {
        return Err(too_large());
    }
    let (server, programs, name) = (Arc::clone(server), programs.clone(), name.to_owned());
    // The request of a page that closes its connection is dropped at any point. Between LOAD and the
    // following steps, the core would have a program that the store does not know.
    let task = tokio::spawn(async move {
        let Ok(_turn) = server.receiving.try_acquire() else {
            return Err((StatusCode::TOO_MANY_REQUESTS, Refusal::Receiving.into()));
        };
        take(&server, &programs, term, &name, body).await
    });
    task.await.unwrap_or_else(|error| Err(failed(&error)))
}

/// Receives a program, stores it and loads it.
async fn take(
    server: &Arc<Server>,
    programs: &ProgramStore,
    term: Term,
    name: &str,
    body: Body,
) -> Result<Answer, Refused> {
    let upload = 1 + server.uploads.fetch_add(1, Ordering::Relaxed);
    let part = programs.part(upload);
    let received = match receive(body, programs, part.clone()).await {
        Ok(_) if !server.hub.is_present(term) => Err((StatusCode::FORBIDDEN, Refusal::NotLoaded.into())),
        // The file of the loaded program is a different one, so a rejected upload does not change it.
        Ok(bytes) => match programs.put(upload, name) {
            Ok(file) => Ok((bytes, file)),
            Err(error) => Err(failed(&error)),
        },
        Err(refused) => Err(refused),
    };
    let (bytes, file) = received.inspect_err(|_| {
        // The received part is of no use.
        let _removed = std::fs::remove_file(&part);
    })?;
    let mut request = ControlRequest {
        command: CommandCode::Load as u32,
        ..ControlRequest::default()
    };
    if !request.set_text(&file.display().to_string()) {
        let _removed = programs.remove(upload);
        let text = "the state folder's name is too long";
        return Err((StatusCode::BAD_REQUEST, Answer::refused(text)));
    }
    let answer = server.dispatch.load(request, term).await;
    let alarm = (answer.alarm != 0).then_some(answer.alarm);
    let program = name.to_owned();
    let fact = if answer.accepted {
        LogFact::Loaded { program }
    } else {
        LogFact::NotLoaded {
            program,
            reason: answer.text.clone(),
            refusal: answer.refusal,
        }
    };
    server.hub.log_fact(LogKind::Command, alarm, fact, None);
    // The errors of a program are shown with its lines; START checks it again.
    let faults = [Alarm::SoftLimit, Alarm::BadProgram].map(Alarm::number);
    if !answer.accepted && !faults.contains(&answer.alarm) {
        let _removed = programs.remove(upload);
        return Ok(answer);
    }
    // If removing or linking fails, the program itself is still there.
    let _kept = if answer.accepted {
        server.loaded_upload.store(upload, Ordering::Relaxed);
        programs.accept(upload, name)
    } else {
        match server.loaded_upload.load(Ordering::Relaxed) {
            // The core's program is from before this service.
            0 => Ok(()),
            loaded => programs.keep(&[Some(upload), Some(loaded)]),
        }
    };
    let info = ProgramInfo {
        name: name.to_owned(),
        // 0 is the program of a run.
        upload,
        file: file.display().to_string(),
        problem: None,
        bytes,
        errors: Vec::new(),
        warnings: Vec::new(),
        checked: false,
        planned_s: None,
    };
    if answer.accepted {
        server.hub.tell_program(info.clone());
    } else {
        let present = server.hub.present();
        let loaded = present.map_or_else(String::new, |status| status.program_name().to_owned());
        server.hub.tell_rejected(info.clone(), loaded);
    }
    look_through(server, file, info);
    Ok(Answer {
        accepted: true,
        alarm: 0,
        text: String::new(),
        refusal: None,
    })
}

/// Checks a program when it gets a turn.
pub(crate) fn look_through(server: &Arc<Server>, file: PathBuf, info: ProgramInfo) {
    let server = Arc::clone(server);
    tokio::spawn(async move {
        let Ok(permit) = Arc::clone(&server.checkers).acquire_owned().await else {
            return;
        };
        // Without a thread the program stays unchecked; START checks it.
        let _started = background("screen-check", move || {
            let found = checked(&file, &info, &server.setup, server.state_folder.as_deref());
            server.hub.tell_checked(found);
            drop(permit);
        });
    });
}

/// Writes a body to a file and returns its size. The disk may block the writing thread, which has ended when
/// this returns.
async fn receive(body: Body, programs: &ProgramStore, part: PathBuf) -> Result<u64, Refused> {
    let max_bytes = programs.stored().map_or(MAX_PROGRAM, |stored| {
        MAX_PROGRAM.min(MAX_STORED.saturating_sub(stored))
    });
    let (sender, mut receiver) = mpsc::channel::<Bytes>(4);
    let writer = tokio::task::spawn_blocking(move || write_chunks(&part, &mut receiver));
    let received = forward(body, sender, max_bytes, programs).await;
    let written = writer.await.map_err(|error| failed(&error))?;
    let bytes = received?;
    written.map_err(|error| failed(&error))?;
    Ok(bytes)
}

/// Passes a body to the writer; returns its size, which is smaller if the writer has failed.
async fn forward(
    body: Body,
    sender: mpsc::Sender<Bytes>,
    max_bytes: u64,
    programs: &ProgramStore,
) -> Result<u64, Refused> {
    let mut stream = body.into_data_stream();
    let mut bytes = 0;
    loop {
        let paused = |_| (StatusCode::REQUEST_TIMEOUT, Refusal::Paused.into());
        let Some(chunk) = tokio::time::timeout(PAUSE, stream.next()).await.map_err(paused)? else {
            return Ok(bytes);
        };
        let chunk = chunk.map_err(|error| {
            (
                StatusCode::BAD_REQUEST,
                Answer::refused(format!("the upload was interrupted: {error}")),
            )
        })?;
        bytes += chunk.len() as u64;
        if bytes > max_bytes {
            if max_bytes == MAX_PROGRAM {
                return Err(too_large());
            }
            let text = format!(
                "the programs in {} take {} GiB; remove some",
                programs.folder().display(),
                MAX_STORED >> 30
            );
            return Err((StatusCode::PAYLOAD_TOO_LARGE, Answer::refused(text)));
        }
        if sender.send(chunk).await.is_err() {
            return Ok(bytes);
        }
    }
}

fn failed(cause: &dyn std::fmt::Display) -> Refused {
    let text = format!("the program cannot be stored: {cause}");
    (StatusCode::INSUFFICIENT_STORAGE, Answer::refused(text))
}

fn too_large() -> Refused {
    (StatusCode::PAYLOAD_TOO_LARGE, Refusal::TooLarge.into())
}

fn write_chunks(part: &Path, chunks: &mut mpsc::Receiver<Bytes>) -> std::io::Result<()> {
    let mut file = std::fs::File::create(part)?;
    while let Some(chunk) = chunks.blocking_recv() {
        file.write_all(&chunk)?;
    }
    file.sync_all()
}

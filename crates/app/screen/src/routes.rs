//! The response of each address.

use std::borrow::Cow;
use std::sync::Arc;

use axum::Router;
use axum::body::Bytes;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{Extension, Path as UrlPath, RawQuery, State};
use axum::http::header::{CONTENT_TYPE, COOKIE, SET_COOKIE};
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::middleware::from_fn_with_state;
use axum::response::{Html, IntoResponse, Response};
use axum::routing::get;
use rust_embed::RustEmbed;

use crate::chatter::chatter;
use crate::connection;
use crate::documents::document;
use crate::gate::{Gate, Role, pass, random_hex};
use crate::hub::Visitor;
use crate::path_stream::path;
use crate::programs::background;
use crate::restart::restart;
use crate::server::{Server, upload_of};
use crate::slots::Client;
use crate::streaming::{BodyWriter, body, streamed};
use crate::traces;
use crate::upload::upload;

/// Maximum size of a page's message.
const MAX_MESSAGE: usize = 16 << 10;
/// Shown if no page was built.
const NO_PAGE: &str = "<!doctype html><title>Evolvent</title><p>The page of the screen is not part of this \
     program: see crates/app/screen/page.</p>";

#[derive(RustEmbed)]
#[folder = "page/dist"]
#[allow_missing = true]
struct Page;

pub(crate) fn router(server: Arc<Server>, gate: Gate) -> Router {
    Router::new()
        .route("/{key}/", get(index))
        .route("/{key}/ws", get(socket))
        .route("/{key}/programs/{name}", get(text).put(upload))
        .route("/{key}/path/{name}", get(path))
        .route("/{key}/chatter", get(chatter))
        .route("/{key}/docs/{theme}/{file}", get(document))
        .route("/{key}/restart/{name}/{line}", get(restart))
        .route("/{key}/traces", get(traces::list))
        .route("/{key}/traces/{name}/jobs", get(traces::jobs))
        .route("/{key}/traces/{name}/report", get(traces::report))
        .route("/{key}/traces/{name}/data", get(traces::data))
        .route(
            "/{key}/comparison/{a}/{job_a}/{b}/{job_b}",
            get(traces::comparison),
        )
        .route("/{key}/{*file}", get(file))
        .layer(from_fn_with_state(gate, pass))
        .with_state(server)
}

/// The session of a page, from its cookie.
pub(crate) fn session_of(headers: &HeaderMap) -> Option<String> {
    let cookies = headers.get(COOKIE)?.to_str().ok()?;
    let found = cookies
        .split(';')
        .find_map(|cookie| cookie.trim().strip_prefix("evolvent_page="))?;
    (found.len() == 32).then(|| found.to_owned())
}

async fn index(State(server): State<Arc<Server>>, uri: Uri, headers: HeaderMap) -> Response {
    let mut response = embedded("index.html").unwrap_or_else(|| Html(NO_PAGE).into_response());
    let secure = if server.is_encrypted { "; Secure" } else { "" };
    let folder = uri.path();
    if session_of(&headers).is_none()
        && let Ok(session) = random_hex()
        && let Ok(cookie) =
            format!("evolvent_page={session}; Path={folder}; HttpOnly; SameSite=Strict{secure}").parse()
    {
        response.headers_mut().insert(SET_COOKIE, cookie);
    }
    response
}

fn embedded(name: &str) -> Option<Response> {
    let file = Page::get(name)?;
    let kind = match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        Some("json") => "application/json",
        _ => "application/octet-stream",
    };
    // Part of the binary: a slow client does not occupy a copy of it.
    let bytes = match file.data {
        Cow::Borrowed(bytes) => Bytes::from_static(bytes),
        Cow::Owned(bytes) => bytes.into(),
    };
    Some(([(CONTENT_TYPE, kind)], bytes).into_response())
}

async fn file(UrlPath((_key, name)): UrlPath<(String, String)>) -> Response {
    embedded(&name).unwrap_or_else(|| StatusCode::NOT_FOUND.into_response())
}

async fn socket(
    State(server): State<Arc<Server>>,
    Extension(role): Extension<Role>,
    Extension(Client(client)): Extension<Client>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    let visitor = Visitor {
        session: session_of(&headers).unwrap_or_default(),
        role,
        client,
    };
    upgrade
        .max_message_size(MAX_MESSAGE)
        .max_frame_size(MAX_MESSAGE)
        .on_upgrade(move |socket| connection::serve(server, socket, visitor))
}

async fn text(
    State(server): State<Arc<Server>>,
    Extension(role): Extension<Role>,
    UrlPath((_key, name)): UrlPath<(String, String)>,
    RawQuery(query): RawQuery,
) -> Response {
    let upload = upload_of(query.as_deref());
    let of_file = Arc::clone(&server);
    let open = move || {
        of_file
            .file_of(&name, upload)
            .map(|(file, _)| std::fs::File::open(file))
    };
    let Ok(Some(Ok(opened))) = tokio::task::spawn_blocking(open).await else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let Some(turn) = server.texts.take(role).await else {
        return StatusCode::SERVICE_UNAVAILABLE.into_response();
    };
    let (writer, pieces) = body();
    // A stalled reader must not block a shared thread.
    let reading = background("screen-text", move || {
        read_chunks(opened, writer);
        drop(turn);
    });
    match reading {
        Ok(()) => streamed("text/plain; charset=utf-8", pieces),
        Err(_) => StatusCode::SERVICE_UNAVAILABLE.into_response(),
    }
}

fn read_chunks(mut file: std::fs::File, mut writer: BodyWriter) {
    use std::io::Read;
    let mut buffer = vec![0; 1 << 16];
    // If the file cannot be read to its end, the body ends with an error.
    while let Ok(count) = file.read(&mut buffer) {
        if count == 0 {
            return writer.finish();
        }
        if !writer.hand_over(Bytes::copy_from_slice(&buffer[..count])) {
            return;
        }
    }
}

//! The web server.

use std::io::Write;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{Path as UrlPath, State};
use axum::http::header::{CONTENT_TYPE, COOKIE, SET_COOKIE};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Json, Response};
use axum::routing::get;
use evolvent_bus::{ClientConfig, ControlRequest};
use evolvent_control::CommandCode;
use evolvent_machine::{Machine, MachineKind};
use evolvent_runtime::Setup;
use futures_util::StreamExt;
use rust_embed::RustEmbed;
use tokio::sync::{Semaphore, mpsc};

use crate::config::{ScreenConfig, ScreenError};
use crate::connection;
use crate::gate::{Gate, pass};
use crate::hub::Hub;
use crate::messages::{AxisInfo, LogKind, MachineInfo, ProgramInfo, ToPage};
use crate::orders::{Answer, Orders};
use crate::programs::{checked, is_good_name, kept, plan};
use crate::watcher;

/// Largest program.
const MAX_PROGRAM: u64 = 256 << 20;
/// Largest message of a page.
const MAX_MESSAGE: usize = 16 << 10;
/// How often offsets and tools are looked at.
const KEPT: Duration = Duration::from_millis(500);
/// How long a LOAD may wait for commands before it.
const LOAD_AGE: Duration = Duration::from_secs(12);
/// Shown where no page was built.
const NO_PAGE: &str = "<!doctype html><title>Evolvent</title><p>The page of the screen is not part of this program: see \
     crates/app/screen/page.</p>";

#[derive(RustEmbed)]
#[folder = "page/dist"]
#[allow_missing = true]
struct Page;

/// What every request finds.
pub(crate) struct Server {
    pub(crate) hub: Arc<Hub>,
    /// Commands that stop.
    pub(crate) stops: Orders,
    /// Jogs and their renewals, which the core takes from one client only.
    pub(crate) jogs: Orders,
    /// All others.
    pub(crate) commands: Orders,
    pub(crate) programs: PathBuf,
    /// A page has jogged since jogs were stopped.
    pub(crate) jogged: AtomicBool,
    setup: Setup,
    state_folder: PathBuf,
    /// Checks and plans one after the other.
    workers: Arc<Semaphore>,
    uploads: AtomicU64,
    key: String,
}

/// A screen at work. It ends when it is dropped.
#[derive(Debug)]
pub struct Screen {
    address: String,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Screen {
    /// Listens, and starts the threads, which wait for the core. The priority of the caller is theirs.
    ///
    /// # Errors
    /// The address is not of this computer, or taken; no folder for programs, no threads.
    pub fn start(config: ScreenConfig) -> Result<Self, ScreenError> {
        if !config.address.ip().is_loopback() {
            return Err(ScreenError::NotLoopback(config.address));
        }
        let listening = |source| ScreenError::Listen {
            address: config.address,
            source,
        };
        let listener = TcpListener::bind(config.address).map_err(listening)?;
        listener.set_nonblocking(true)?;
        let local = listener.local_addr()?;
        let programs = config.state_folder.join("programs");
        std::fs::create_dir_all(&programs)?;
        let programs = programs.canonicalize()?;
        let key = random_hex()?;
        let gate = Gate::new(key.clone(), local.port());
        let address = format!("http://{local}/{key}/");

        let stop = Arc::new(AtomicBool::new(false));
        let client = ClientConfig {
            prefix: config.bus_prefix.clone(),
            wait: Duration::from_secs(2),
            ..ClientConfig::new(&config.setup.machine.name)
        };
        let hub = Arc::new(Hub::new(ToPage::Machine {
            machine: machine_info(&config.setup.machine),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        }));
        let orders = |name| Orders::spawn(name, client.clone(), Arc::clone(&stop));
        let (stops, first) = orders("screen-stops")?;
        let (jogs, second) = orders("screen-jogs")?;
        let (commands, third) = orders("screen-orders")?;
        let bus = watcher::spawn(client.clone(), Arc::clone(&hub), Arc::clone(&stop))?;
        let server = Arc::new(Server {
            hub,
            stops,
            jogs,
            commands,
            programs,
            jogged: AtomicBool::new(false),
            setup: config.setup,
            state_folder: config.state_folder,
            workers: Arc::new(Semaphore::new(1)),
            uploads: AtomicU64::new(0),
            key,
        });
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(4)
            .build()?;
        let ending = Arc::clone(&stop);
        let web = std::thread::Builder::new().name("screen-web".into()).spawn(move || {
            runtime.block_on(listen(server, gate, listener, ending));
            // A plan that nobody takes any more ends by itself.
            runtime.shutdown_background();
        })?;
        Ok(Self {
            address,
            stop,
            threads: vec![first, second, third, bus, web],
        })
    }

    /// What to open in a browser. Whoever has it may command.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // One that panicked has ended.
            let _ended = thread.join();
        }
    }
}

fn random_hex() -> std::io::Result<String> {
    use std::io::Read;
    let mut bytes = [0; 16];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn machine_info(machine: &Machine) -> MachineInfo {
    let axes = machine.axes.iter().map(|axis| AxisInfo {
        letter: axis.letter.letter().to_string(),
        kind: if axis.letter.is_rotary() { "rotary" } else { "linear" },
        min: axis.travel_min,
        max: axis.travel_max,
        max_velocity: axis.max_velocity,
        has_home_switch: machine.homing.iter().any(|homing| homing.axis == axis.letter),
    });
    MachineInfo {
        name: machine.name.clone(),
        description: machine.description.clone(),
        kind: match machine.kind {
            MachineKind::Mill => "mill",
            MachineKind::Lathe => "lathe",
        },
        axes: axes.collect(),
    }
}

async fn listen(server: Arc<Server>, gate: Gate, listener: TcpListener, stop: Arc<AtomicBool>) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else {
        return;
    };
    tokio::spawn(watch_kept(Arc::clone(&server)));
    let router = Router::new()
        .route("/{key}/", get(index))
        .route("/{key}/ws", get(socket))
        .route("/{key}/programs/{name}", get(text).put(upload))
        .route("/{key}/path/{name}", get(path))
        .route("/{key}/{*file}", get(file))
        .layer(from_fn_with_state(gate, pass))
        .with_state(server);
    let ended = async {
        while !stop.load(Ordering::Relaxed) {
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::select! {
        _ = axum::serve(listener, router) => {}
        () = ended => {}
    }
}

async fn watch_kept(server: Arc<Server>) {
    loop {
        let of_thread = Arc::clone(&server);
        let read = move || of_thread.hub.tell_kept(kept(&of_thread.setup, &of_thread.state_folder));
        // It is read again soon.
        let _read = tokio::task::spawn_blocking(read).await;
        tokio::time::sleep(KEPT).await;
    }
}

/// The session of a page, from its cookie.
fn session_of(headers: &HeaderMap) -> Option<String> {
    let cookies = headers.get(COOKIE)?.to_str().ok()?;
    let found = cookies.split(';').find_map(|cookie| cookie.trim().strip_prefix("evolvent_page="))?;
    (found.len() == 32).then(|| found.to_owned())
}

async fn index(State(server): State<Arc<Server>>, headers: HeaderMap) -> Response {
    let mut response = embedded("index.html").unwrap_or_else(|| axum::response::Html(NO_PAGE).into_response());
    if session_of(&headers).is_none()
        && let Ok(session) = random_hex()
        && let Ok(cookie) = format!("evolvent_page={session}; Path=/{}/; HttpOnly; SameSite=Strict", server.key).parse()
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
    Some(([(CONTENT_TYPE, kind)], file.data.into_owned()).into_response())
}

async fn file(UrlPath((_key, name)): UrlPath<(String, String)>) -> Response {
    embedded(&name).unwrap_or_else(|| StatusCode::NOT_FOUND.into_response())
}

async fn socket(State(server): State<Arc<Server>>, headers: HeaderMap, upgrade: WebSocketUpgrade) -> Response {
    let session = session_of(&headers).unwrap_or_default();
    upgrade
        .max_message_size(MAX_MESSAGE)
        .max_frame_size(MAX_MESSAGE)
        .on_upgrade(move |socket| connection::serve(server, socket, session))
}

async fn text(State(server): State<Arc<Server>>, UrlPath((_key, name)): UrlPath<(String, String)>) -> Response {
    if !is_good_name(&name) {
        return StatusCode::NOT_FOUND.into_response();
    }
    let (sender, receiver) = mpsc::channel(4);
    let file = server.programs.join(name);
    let Ok(Ok(opened)) = tokio::task::spawn_blocking(move || std::fs::File::open(file)).await else {
        return StatusCode::NOT_FOUND.into_response();
    };
    tokio::task::spawn_blocking(move || read_chunks(opened, &sender));
    streamed("text/plain; charset=utf-8", receiver)
}

fn read_chunks(mut file: std::fs::File, sender: &mpsc::Sender<Bytes>) {
    use std::io::Read;
    let mut buffer = vec![0; 1 << 16];
    while let Ok(count @ 1..) = file.read(&mut buffer) {
        if sender.blocking_send(Bytes::copy_from_slice(&buffer[..count])).is_err() {
            return;
        }
    }
}

fn streamed(kind: &'static str, receiver: mpsc::Receiver<Bytes>) -> Response {
    let stream = futures_util::stream::unfold(receiver, |mut receiver| async {
        receiver.recv().await.map(|bytes| (Ok::<_, std::io::Error>(bytes), receiver))
    });
    ([(CONTENT_TYPE, kind)], Body::from_stream(stream)).into_response()
}

async fn path(State(server): State<Arc<Server>>, UrlPath((_key, name)): UrlPath<(String, String)>) -> Response {
    let file = server.programs.join(&name);
    if !is_good_name(&name) || !file.is_file() {
        return StatusCode::NOT_FOUND.into_response();
    }
    let Ok(permit) = Arc::clone(&server.workers).acquire_owned().await else {
        return StatusCode::SERVICE_UNAVAILABLE.into_response();
    };
    let (sender, receiver) = mpsc::channel(4);
    tokio::task::spawn_blocking(move || {
        let planned_s = plan(file, &server.setup, &server.state_folder, &sender);
        server.hub.tell_planned(&name, planned_s);
        drop(permit);
    });
    streamed("application/octet-stream", receiver)
}

async fn upload(
    State(server): State<Arc<Server>>,
    UrlPath((_key, name)): UrlPath<(String, String)>,
    headers: HeaderMap,
    body: Body,
) -> (StatusCode, Json<serde_json::Value>) {
    let (status, answer) = match store(&server, &name, &headers, body).await {
        Ok(answer) => (StatusCode::OK, answer),
        Err((status, text)) => (status, Answer::refused(text)),
    };
    let Answer { accepted, alarm, text } = answer;
    (
        status,
        Json(serde_json::json!({"accepted": accepted, "alarm": alarm, "text": text})),
    )
}

async fn store(server: &Arc<Server>, name: &str, headers: &HeaderMap, body: Body) -> Result<Answer, (StatusCode, String)> {
    if !session_of(headers).is_some_and(|session| server.hub.session_holds(&session)) {
        let text = "this page does not have control; take it first".to_owned();
        return Err((StatusCode::FORBIDDEN, text));
    }
    if !is_good_name(name) {
        let text = format!("{name:?} cannot be a program's name: letters, digits and . _ - + ( ), up to 100 bytes");
        return Err((StatusCode::BAD_REQUEST, text));
    }
    let file = server.programs.join(name);
    let number = server.uploads.fetch_add(1, Ordering::Relaxed);
    let part = server.programs.join(format!(".upload-{number}"));
    let received = receive(body, part.clone()).await;
    let bytes = match received {
        Ok(bytes) => bytes,
        Err(text) => {
            // What came is of no use.
            let _removed = std::fs::remove_file(&part);
            return Err((StatusCode::PAYLOAD_TOO_LARGE, text));
        }
    };
    std::fs::rename(&part, &file).map_err(|error| (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    let mut request = ControlRequest {
        command: CommandCode::Load as u32,
        ..ControlRequest::default()
    };
    if !request.set_text(&file.display().to_string()) {
        let text = "the state folder's name is too long".to_owned();
        return Err((StatusCode::BAD_REQUEST, text));
    }
    let answer = server.commands.give(request, LOAD_AGE).await;
    let alarm = (answer.alarm != 0).then_some(answer.alarm);
    server.hub.log(LogKind::Command, alarm, format!("LOAD {name}: {}", if answer.accepted { "accepted" } else { &answer.text }), None);
    let info = ProgramInfo {
        name: name.to_owned(),
        bytes,
        errors: Vec::new(),
        warnings: Vec::new(),
        checked: false,
        planned_s: None,
    };
    server.hub.tell_program(info.clone());
    let worker = Arc::clone(server);
    tokio::spawn(async move {
        let Ok(_permit) = worker.workers.acquire().await else {
            return;
        };
        let of_thread = Arc::clone(&worker);
        let look = move || of_thread.hub.tell_program(checked(&file, &info, &of_thread.setup, &of_thread.state_folder));
        // A check that panics leaves the program unchecked; START judges it.
        let _checked = tokio::task::spawn_blocking(look).await;
    });
    Ok(answer)
}

/// Writes a body to a file, in a thread that the disk may hold up; its size.
async fn receive(body: Body, part: PathBuf) -> Result<u64, String> {
    let (sender, mut receiver) = mpsc::channel::<Bytes>(4);
    let writer = tokio::task::spawn_blocking(move || write_chunks(&part, &mut receiver));
    let mut stream = body.into_data_stream();
    let mut bytes = 0;
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|error| format!("the upload broke off: {error}"))?;
        bytes += chunk.len() as u64;
        if bytes > MAX_PROGRAM {
            return Err(format!("programs have at most {} MiB", MAX_PROGRAM >> 20));
        }
        if sender.send(chunk).await.is_err() {
            break;
        }
    }
    drop(sender);
    let written = writer.await.map_err(|error| error.to_string())?;
    written.map_err(|error| format!("the program cannot be written: {error}"))?;
    Ok(bytes)
}

fn write_chunks(part: &Path, chunks: &mut mpsc::Receiver<Bytes>) -> std::io::Result<()> {
    let mut file = std::fs::File::create(part)?;
    while let Some(chunk) = chunks.blocking_recv() {
        file.write_all(&chunk)?;
    }
    Ok(())
}

//! A running screen: its start, its addresses, its end.

use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use evolvent_bus::ClientConfig;
use evolvent_runtime::TraceTo;
use qrcode::QrCode;
use qrcode::render::unicode::Dense1x2;
use tokio::sync::Semaphore;
use tokio_rustls::TlsAcceptor;

use crate::chatter::ChatterCase;
use crate::config::{ScreenConfig, ScreenError, ScreenScope};
use crate::dispatch::Dispatch;
use crate::gate::{Gate, Role, random_hex};
use crate::hub::Hub;
use crate::kept::watch_kept;
use crate::listener::listen;
use crate::loaded_program::watch_loaded;
use crate::messages::{EndOf, MachineInfo, ProgramInfo, ToPage};
use crate::names::{public_host, server_names};
use crate::orders::{BusCore, Orders};
use crate::program_store::ProgramStore;
use crate::routes::router;
use crate::server::{MAX_PROGRAMMED, MAX_TEXTS, Server, name_of};
use crate::tls::encryption;
use crate::traces::remove_copies;
use crate::turns::Turns;
use crate::watcher;

/// Time for the last message to reach the pages.
const FAREWELL: Duration = Duration::from_millis(150);
/// Poll interval of the end.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// A running screen. It ends when dropped.
#[derive(Debug)]
pub struct Screen {
    address: String,
    watch_address: Option<String>,
    is_remote: bool,
    fingerprint: Option<String>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Screen {
    /// Starts to listen, and starts the threads, which wait for the core. They inherit the priority of the
    /// caller: call it before the caller becomes a real-time thread.
    ///
    /// # Errors
    /// The address is in use or does not belong to this computer, a certificate cannot be used, or there is
    /// no folder for programs or no thread.
    pub fn start(config: ScreenConfig) -> Result<Self, ScreenError> {
        let listening = |source| ScreenError::Listen {
            address: config.address,
            source,
        };
        let listener = TcpListener::bind(config.address).map_err(listening)?;
        listener.set_nonblocking(true)?;
        let local = listener.local_addr()?;
        let is_remote = !local.ip().is_loopback();
        let shown = ShownFiles::open(&config.scope)?;
        let host = public_host(local);
        let names = server_names(&config.setup.machine.name, &config.hosts, host);
        let encryption = encryption(&config, shown.state_folder.as_deref(), is_remote, &names)?;
        let is_encrypted = encryption.is_some();
        let (acceptor, fingerprint) = encryption
            .map(|found| (found.acceptor, found.fingerprint))
            .unzip();
        let (operate, watch) = (random_hex()?, random_hex()?);
        let of_operate = if shown.run.is_some() {
            Role::Watch
        } else {
            Role::Operate
        };
        let keys = vec![(operate.clone(), of_operate), (watch.clone(), Role::Watch)];
        let gate = Gate::new(keys, local, &names, is_encrypted);
        let scheme = if is_encrypted { "https" } else { "http" };
        let url = |key: &str| format!("{scheme}://{}/{key}/", SocketAddr::new(host, local.port()));

        let stop = Arc::new(AtomicBool::new(false));
        let (server, mut threads) = start_server(config, shown, is_encrypted, &stop)?;
        threads.push(spawn_web(server, gate, listener, acceptor, &stop)?);
        Ok(Self {
            address: url(&operate),
            watch_address: (of_operate == Role::Operate).then(|| url(&watch)),
            is_remote,
            fingerprint,
            stop,
            threads,
        })
    }

    /// The address to open in a browser. It permits operating the machine, except for the screen of a run.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The address that only permits watching; `None` if no page may operate.
    #[must_use]
    pub fn watch_address(&self) -> Option<&str> {
        self.watch_address.as_deref()
    }

    /// SHA-256 of the certificate, as browsers show it; `None` if connections are not encrypted.
    #[must_use]
    pub fn fingerprint(&self) -> Option<&str> {
        self.fingerprint.as_deref()
    }

    /// The address as a QR code of block characters, if other computers can reach it.
    #[must_use]
    pub fn code(&self) -> Option<String> {
        let code = QrCode::new(&self.address).ok().filter(|_| self.is_remote)?;
        // Terminals are usually dark, so the light parts of the code are drawn.
        let mut image = code.render::<Dense1x2>();
        let image = image.dark_color(Dense1x2::Light).light_color(Dense1x2::Dark);
        Some(image.build())
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A thread that panicked has ended.
            let _ended = thread.join();
        }
    }
}

/// The files that pages may read or write.
struct ShownFiles {
    programs: Option<ProgramStore>,
    state_folder: Option<PathBuf>,
    traces: TraceTo,
    /// File of macros, and whether it must exist.
    macros: Option<(PathBuf, bool)>,
    /// The only program of a run.
    run: Option<PathBuf>,
    chatter: Option<PathBuf>,
}

impl ShownFiles {
    fn open(scope: &ScreenScope) -> Result<Self, ScreenError> {
        match scope.clone() {
            ScreenScope::Operate {
                state_folder,
                traces,
                macros,
                chatter,
            } => {
                remove_copies(&state_folder);
                let is_named = macros.is_some();
                let macros = macros.unwrap_or_else(|| state_folder.join("macros.toml"));
                Ok(Self {
                    programs: Some(ProgramStore::open(&state_folder)?),
                    state_folder: Some(state_folder),
                    traces,
                    macros: Some((macros, is_named)),
                    run: None,
                    chatter,
                })
            }
            ScreenScope::Watch { program } => Ok(Self {
                programs: None,
                state_folder: None,
                traces: TraceTo::Nowhere,
                macros: None,
                run: Some(program),
                chatter: None,
            }),
        }
    }
}

/// Starts the threads that exchange messages with the core, and makes the server of pages.
fn start_server(
    config: ScreenConfig,
    shown: ShownFiles,
    is_encrypted: bool,
    stop: &Arc<AtomicBool>,
) -> Result<(Arc<Server>, Vec<JoinHandle<()>>), ScreenError> {
    let client = ClientConfig {
        prefix: config.bus_prefix.clone(),
        wait: Duration::from_secs(2),
        ..ClientConfig::new(&config.setup.machine.name)
    };
    let hub = Arc::new(Hub::new(ToPage::Machine {
        machine: Box::new(MachineInfo::new(&config.setup, shown.chatter.is_some())),
        version: env!("CARGO_PKG_VERSION").to_owned(),
    }));
    if let Some(file) = &shown.run {
        hub.tell_program(program_of_run(file));
    }
    let is_commanded = shown.run.is_none();
    let orders = |name| {
        let client = client.clone();
        Orders::spawn(name, move || BusCore::new(client, is_commanded), &hub, stop)
    };
    let (stops, first) = orders("screen-stops")?;
    let (jogs, second) = orders("screen-jogs")?;
    let (commands, third) = orders("screen-orders")?;
    let signals = config.setup.machine.signals.clone();
    let bus = watcher::spawn(client.clone(), signals, Arc::clone(&hub), Arc::clone(stop))?;
    let last_upload = shown.programs.as_ref().map_or(Ok(0), ProgramStore::last_upload)?;
    let server = Server {
        dispatch: Dispatch::new(Arc::clone(&hub), stops, jogs, commands),
        hub,
        setup: config.setup,
        programs: shown.programs,
        state_folder: shown.state_folder,
        traces: shown.traces,
        run: shown.run,
        checkers: Arc::new(Semaphore::new(1)),
        planners: Turns::new(1),
        programmed: Turns::new(MAX_PROGRAMMED),
        restarts: Arc::new(Semaphore::new(1)),
        macros: shown.macros,
        texts: Turns::new(MAX_TEXTS),
        chatter: ChatterCase::new(shown.chatter),
        readers: Turns::new(1),
        copies: AtomicU64::new(0),
        receiving: Semaphore::new(1),
        uploads: AtomicU64::new(last_upload),
        loaded_upload: AtomicU64::new(0),
        is_encrypted,
    };
    Ok((Arc::new(server), vec![first, second, third, bus]))
}

/// The program of a run, as sent to pages.
fn program_of_run(file: &Path) -> ProgramInfo {
    ProgramInfo {
        name: name_of(file),
        upload: 0,
        file: file.display().to_string(),
        problem: None,
        bytes: std::fs::metadata(file).map_or(0, |data| data.len()),
        errors: Vec::new(),
        warnings: Vec::new(),
        checked: true,
        planned_s: None,
    }
}

/// Starts the thread that serves pages.
fn spawn_web(
    server: Arc<Server>,
    gate: Gate,
    listener: TcpListener,
    acceptor: Option<TlsAcceptor>,
    stop: &Arc<AtomicBool>,
) -> Result<JoinHandle<()>, ScreenError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(8)
        .thread_name("screen-files")
        .build()?;
    let ending = Arc::clone(stop);
    let web = std::thread::Builder::new().name("screen-web".into());
    Ok(web.spawn(move || {
        runtime.block_on(serve(server, gate, listener, acceptor, ending));
        // A plan without a receiver ends by itself.
        runtime.shutdown_background();
    })?)
}

async fn serve(
    server: Arc<Server>,
    gate: Gate,
    listener: TcpListener,
    encryption: Option<TlsAcceptor>,
    stop: Arc<AtomicBool>,
) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else {
        return;
    };
    let hub = Arc::clone(&server.hub);
    let what = if server.run.is_some() {
        EndOf::Run
    } else {
        EndOf::Service
    };
    tokio::spawn(watch_kept(Arc::clone(&server)));
    if server.run.is_none() {
        tokio::spawn(watch_loaded(Arc::clone(&server)));
    }
    let ended = async {
        while !stop.load(Ordering::Relaxed) {
            tokio::time::sleep(POLL_INTERVAL).await;
        }
        // With this message, pages can distinguish the end from a lost connection.
        hub.tell_end(what);
        tokio::time::sleep(FAREWELL).await;
    };
    tokio::select! {
        never = listen(listener, router(server, gate), encryption) => match never {},
        () = ended => {}
    }
}

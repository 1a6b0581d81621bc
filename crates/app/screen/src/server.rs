//! The server: data shared by its threads, its start and its end.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use evolvent_bus::ClientConfig;
use evolvent_machine::MachineKind;
use evolvent_runtime::{Setup, TraceTo};
use qrcode::QrCode;
use qrcode::render::unicode::Dense1x2;
use tokio::sync::Semaphore;
use tokio_rustls::TlsAcceptor;

use crate::chatter::ChatterCase;
use crate::config::{ScreenConfig, ScreenError, ScreenScope};
use crate::gate::{Gate, Role};
use crate::hub::Hub;
use crate::listener::listen;
use crate::macro_file::MacroWatch;
use crate::messages::{AxisInfo, HandwheelInfo, MachineInfo, ProcessInfo, ProgramInfo, SignalInfo, ToPage};
use crate::orders::Orders;
use crate::programs::{is_good_name, kept};
use crate::routes::router;
use crate::traces::remove_copies;
use crate::{tls, watcher};

/// Texts of programs that are sent at the same time, each by a thread.
const MAX_TEXTS: usize = 16;
/// Poll interval of offsets and tools.
const KEPT: Duration = Duration::from_millis(500);
/// Poll interval of the end.
const LOOK: Duration = Duration::from_millis(100);

/// Data of every request.
pub(crate) struct Server {
    pub(crate) hub: Arc<Hub>,
    /// Commands that stop.
    pub(crate) stops: Orders,
    /// Jogs and their renewals, which the core accepts from one client only.
    pub(crate) jogs: Orders,
    /// All others.
    pub(crate) commands: Orders,
    /// A page has jogged since jogs were stopped.
    pub(crate) jogged: AtomicBool,
    pub(crate) setup: Setup,
    /// Folder of uploaded programs; none if pages only watch.
    pub(crate) programs: Option<PathBuf>,
    /// The service's state; none if a run is watched.
    pub(crate) state_folder: Option<PathBuf>,
    /// Recorded runs that pages may look into.
    pub(crate) traces: TraceTo,
    /// The only program of a run.
    run: Option<PathBuf>,
    /// Checks one program after another.
    pub(crate) checkers: Arc<Semaphore>,
    /// Plans one program after another, beside a check: its picture must not wait for that.
    pub(crate) planners: Arc<Semaphore>,
    /// Texts of programs that are sent at the same time.
    pub(crate) texts: Arc<Semaphore>,
    pub(crate) chatter: ChatterCase,
    /// Calculates one approach after another.
    pub(crate) restarts: Arc<Semaphore>,
    /// File of macros, and whether it must exist; none if pages only watch.
    macros: Option<(PathBuf, bool)>,
    /// Reads one trace after another.
    pub(crate) readers: Arc<Semaphore>,
    /// Receives one upload after another.
    pub(crate) receiving: Semaphore,
    pub(crate) uploads: AtomicU64,
    pub(crate) is_encrypted: bool,
}

impl Server {
    /// The file of a program that pages may read.
    pub(crate) fn file_of(&self, name: &str) -> Option<PathBuf> {
        if let Some(run) = &self.run {
            return (name_of(run) == name).then(|| run.clone());
        }
        let file = self.programs.as_ref()?.join(name);
        (is_good_name(name) && file.is_file()).then_some(file)
    }
}

fn name_of(file: &Path) -> String {
    file.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// A running screen. It ends when it is dropped.
#[derive(Debug)]
pub struct Screen {
    address: String,
    watch_address: Option<String>,
    is_remote: bool,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Screen {
    /// Listens, and starts the threads, which wait for the core. They inherit the priority of the caller:
    /// call it before the caller becomes a real-time thread.
    ///
    /// # Errors
    /// The address is taken or not this computer's; a certificate that cannot be used; no folder for
    /// programs, no threads.
    pub fn start(config: ScreenConfig) -> Result<Self, ScreenError> {
        let listening = |source| ScreenError::Listen {
            address: config.address,
            source,
        };
        let listener = TcpListener::bind(config.address).map_err(listening)?;
        listener.set_nonblocking(true)?;
        let local = listener.local_addr()?;
        let is_remote = !local.ip().is_loopback();
        let chatter = match &config.scope {
            ScreenScope::Operate { chatter, .. } => chatter.clone(),
            ScreenScope::Watch { .. } => None,
        };
        let (programs, state_folder, traces, macros, run) = match config.scope.clone() {
            ScreenScope::Operate {
                state_folder,
                traces,
                macros,
                ..
            } => {
                remove_copies(&state_folder);
                let is_named = macros.is_some();
                let macros = macros.unwrap_or_else(|| state_folder.join("macros.toml"));
                (
                    Some(programs_folder(&state_folder)?),
                    Some(state_folder),
                    traces,
                    Some((macros, is_named)),
                    None,
                )
            }
            ScreenScope::Watch { program } => (None, None, TraceTo::Nowhere, None, Some(program)),
        };
        let host = public_host(local);
        let names = names(&config, host);
        let encryption = encryption(&config, state_folder.as_deref(), is_remote, &names)?;
        let is_encrypted = encryption.is_some();
        let (operate, watch) = (random_hex()?, random_hex()?);
        let of_operate = if run.is_some() { Role::Watch } else { Role::Operate };
        let keys = vec![(operate.clone(), of_operate), (watch.clone(), Role::Watch)];
        let gate = Gate::new(keys, local, &names, is_encrypted);
        let scheme = if is_encrypted { "https" } else { "http" };
        let url = |key: &str| format!("{scheme}://{}/{key}/", SocketAddr::new(host, local.port()));

        let stop = Arc::new(AtomicBool::new(false));
        let client = ClientConfig {
            prefix: config.bus_prefix.clone(),
            wait: Duration::from_secs(2),
            ..ClientConfig::new(&config.setup.machine.name)
        };
        let hub = Arc::new(Hub::new(ToPage::Machine {
            machine: Box::new(machine_info(&config.setup, chatter.is_some())),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        }));
        if let Some(file) = &run {
            hub.tell_program(ProgramInfo {
                name: name_of(file),
                upload: 0,
                bytes: std::fs::metadata(file).map_or(0, |data| data.len()),
                errors: Vec::new(),
                warnings: Vec::new(),
                checked: true,
                planned_s: None,
            });
        }
        let orders = |name| Orders::spawn(name, client.clone(), Arc::clone(&stop));
        let (stops, first) = orders("screen-stops")?;
        let (jogs, second) = orders("screen-jogs")?;
        let (commands, third) = orders("screen-orders")?;
        let signals = config.setup.machine.signals.clone();
        let bus = watcher::spawn(client.clone(), signals, Arc::clone(&hub), Arc::clone(&stop))?;
        let server = Arc::new(Server {
            hub,
            stops,
            jogs,
            commands,
            jogged: AtomicBool::new(false),
            setup: config.setup,
            programs,
            state_folder,
            traces,
            run,
            checkers: Arc::new(Semaphore::new(1)),
            planners: Arc::new(Semaphore::new(1)),
            restarts: Arc::new(Semaphore::new(1)),
            macros,
            texts: Arc::new(Semaphore::new(MAX_TEXTS)),
            chatter: ChatterCase::new(chatter),
            readers: Arc::new(Semaphore::new(1)),
            receiving: Semaphore::new(1),
            uploads: AtomicU64::new(0),
            is_encrypted,
        });
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(8)
            .thread_name("screen-files")
            .build()?;
        let ending = Arc::clone(&stop);
        let web = std::thread::Builder::new()
            .name("screen-web".into())
            .spawn(move || {
                runtime.block_on(serve(server, gate, listener, encryption, ending));
                // A plan without a receiver ends by itself.
                runtime.shutdown_background();
            })?;
        Ok(Self {
            address: url(&operate),
            watch_address: (of_operate == Role::Operate).then(|| url(&watch)),
            is_remote,
            stop,
            threads: vec![first, second, third, bus, web],
        })
    }

    /// The address to open in a browser. It permits operating the machine, except if a run is watched.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The address that only permits watching; none if no page may operate.
    #[must_use]
    pub fn watch_address(&self) -> Option<&str> {
        self.watch_address.as_deref()
    }

    /// The address as a QR code of block characters, if other computers can reach it.
    #[must_use]
    pub fn code(&self) -> Option<String> {
        let code = QrCode::new(&self.address).ok().filter(|_| self.is_remote)?;
        // Terminals are usually dark: the light parts of the code are drawn.
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

/// The folder of uploaded programs, without the remains of interrupted uploads.
fn programs_folder(state_folder: &Path) -> std::io::Result<PathBuf> {
    let folder = state_folder.join("programs");
    std::fs::create_dir_all(&folder)?;
    let folder = folder.canonicalize()?;
    for entry in std::fs::read_dir(&folder)? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with(".upload-") {
            std::fs::remove_file(entry.path())?;
        }
    }
    Ok(folder)
}

fn encryption(
    config: &ScreenConfig,
    state_folder: Option<&Path>,
    is_remote: bool,
    names: &[String],
) -> Result<Option<TlsAcceptor>, ScreenError> {
    if let Some((certificate, key)) = &config.certificate {
        return tls::acceptor(certificate, key).map(Some);
    }
    if !is_remote {
        return Ok(None);
    }
    let folder = state_folder.ok_or(ScreenError::NoCertificate)?.join("screen");
    let (certificate, key) = tls::own_certificate(&folder, names)?;
    tls::acceptor(&certificate, &key).map(Some)
}

/// The address for other computers: for "all addresses" the one by which this computer reaches others.
fn public_host(local: SocketAddr) -> IpAddr {
    if !local.ip().is_unspecified() {
        return local.ip();
    }
    let (any, far): (IpAddr, IpAddr) = if local.is_ipv4() {
        (Ipv4Addr::UNSPECIFIED.into(), Ipv4Addr::new(192, 0, 2, 1).into())
    } else {
        (
            Ipv6Addr::UNSPECIFIED.into(),
            Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, 1).into(),
        )
    };
    // Connecting a datagram socket chooses a route and sends nothing.
    let routed = UdpSocket::bind((any, 0)).and_then(|socket| {
        socket.connect((far, 9))?;
        socket.local_addr()
    });
    routed.map_or(local.ip(), |address| address.ip())
}

/// Names and addresses of this computer, for its certificate and for `Host`.
fn names(config: &ScreenConfig, host: IpAddr) -> Vec<String> {
    let system = rustix::system::uname();
    let own = system.nodename().to_string_lossy().into_owned();
    let mut names = config.hosts.clone();
    names.extend([
        format!("{own}.local"),
        own,
        "localhost".to_owned(),
        host.to_string(),
    ]);
    names.retain(|name| !name.is_empty());
    names
}

/// 128 random bits.
pub(crate) fn random_hex() -> std::io::Result<String> {
    use std::io::Read;
    let mut bytes = [0; 16];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn machine_info(setup: &Setup, has_chatter: bool) -> MachineInfo {
    let machine = &setup.machine;
    let axes = machine.axes.iter().map(|axis| AxisInfo {
        letter: axis.letter.letter().to_string(),
        kind: if axis.letter.is_rotary() {
            "rotary"
        } else {
            "linear"
        },
        // An unlimited axis is shown within a turn.
        min: axis.unlimited.map_or(axis.travel_min, |_| 0.0),
        max: axis.unlimited.map_or(axis.travel_max, |_| 360.0),
        max_velocity: axis.max_velocity,
        is_unlimited: axis.unlimited.is_some(),
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
        process: setup.process.as_deref().map(ProcessInfo::from),
        inputs: machine.signals.inputs.iter().map(SignalInfo::from).collect(),
        outputs: machine.signals.outputs.iter().map(SignalInfo::from).collect(),
        spindles: machine
            .signals
            .spindles
            .iter()
            .map(|spindle| spindle.number)
            .collect(),
        handwheel: machine.handwheel.as_ref().map(HandwheelInfo::from),
        has_chatter,
    }
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
    tokio::spawn(watch_kept(Arc::clone(&server)));
    let ended = async {
        while !stop.load(Ordering::Relaxed) {
            tokio::time::sleep(LOOK).await;
        }
    };
    tokio::select! {
        never = listen(listener, router(server, gate), encryption) => match never {},
        () = ended => {}
    }
}

async fn watch_kept(server: Arc<Server>) {
    let macros = Arc::new(Mutex::new(MacroWatch::default()));
    loop {
        let (of_thread, macros) = (Arc::clone(&server), Arc::clone(&macros));
        let read = move || {
            let kept = kept(&of_thread.setup, of_thread.state_folder.as_deref());
            of_thread.hub.tell_kept(kept);
            let mut macros = macros.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some((file, must_exist)) = &of_thread.macros
                && let Some(told) = macros.look(file, *must_exist)
            {
                of_thread.hub.tell_macros(told);
            }
        };
        // It is read again soon.
        let _read = tokio::task::spawn_blocking(read).await;
        tokio::time::sleep(KEPT).await;
    }
}
